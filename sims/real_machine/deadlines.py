"""Deadlines of the controller under several settings, in turns, simulated or on emulated devices.

The settings see the same disturbances: each has a turn of some seconds, then the next one, and
again. On emulated devices a turn is a job as on the real machine: drivers, protocols, sockets,
threads of the devices, guard and, where asked for, the log's process.
"""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import Parts
from parapod.diagrams.machine import Machine
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import progress
from parapod.sims.real_machine.job import logged, run_on_hardware
from parapod.sims.real_machine.own_emulator import own_emulator
from parapod.sims.real_machine.privileges import CORE, FIFO, MEMORY, PRIVILEGES, Outcome
from parapod.sims.real_machine.punctuality import three_digits
from parapod.sims.real_machine.real_time import (
    USUAL,
    RealTimeLoop,
    Timing,
    percentiles,
    rehearse,
    undisturbed,
)
from parapod.sims.real_machine.wake_up import wake_up_latency
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.scenario_file import dump_scenario
from parapod.systems.hardware.signals import ended_by_signals

# Longest turn, and the time for which only waking up is measured after each [s].
_TURN, _ALONE = 5.0, 1.0


@dataclass(frozen=True)
class Setting:
    """Privileges that a turn asks the kernel for, and whether it has a log.

    Attributes:
        name: for people.
        asked: names of the privileges.
        is_logged: true if all ports are logged.
    """

    name: str
    asked: tuple[str, ...]
    is_logged: bool = False


ORDINARY = Setting("ordinary", ())
AS_A_JOB = Setting("as a job", USUAL)
SIDE_BY_SIDE = (
    ORDINARY,
    *(Setting(name, (name,)) for name in (FIFO, MEMORY, CORE)),
    Setting("all three", PRIVILEGES),
)


def settings_of(is_compared: bool, is_logged: bool) -> tuple[Setting, ...]:
    """Settings of a measurement.

    Args:
        is_compared: each privilege by itself, and none, and all of them; else as a job has them.
        is_logged: each with a log as well as without.
    """
    settings = SIDE_BY_SIDE if is_compared else (AS_A_JOB,)
    if not is_logged:
        return settings
    both = ((one, replace(one, name=f"{one.name}, log", is_logged=True)) for one in settings)
    return tuple(setting for pair in both for setting in pair)


@dataclass
class Measured:
    """Turns of one setting at one rate.

    Attributes:
        setting: the setting.
        rate: rate of the loop [Hz].
        late: delay of each tick after its deadline [s].
        period_error: difference of the time between two ticks from the period [s].
        cost: duration of each tick [s].
        ages: age of measurements at the writes of commands made of them [s]; none in simulation.
        wake_up: delays of a program that does nothing but wake up, under the same setting [s].
        ticks: number of ticks.
        missed: deadlines without a tick.
        page_faults: pages that were touched first meanwhile.
        disk_faults: pages that were read from the disk meanwhile.
        ended: why turns ended early, as a job would have.
        outcomes: the kernel's answers to what was asked, by privilege.
    """

    setting: Setting
    rate: float
    late: list[float] = field(default_factory=list)
    period_error: list[float] = field(default_factory=list)
    cost: list[float] = field(default_factory=list)
    ages: list[float] = field(default_factory=list)
    wake_up: list[float] = field(default_factory=list)
    ticks: int = 0
    missed: int = 0
    page_faults: int = 0
    disk_faults: int = 0
    ended: list[str] = field(default_factory=list)
    outcomes: dict[str, Outcome] = field(default_factory=dict)

    def add(self, timing: Timing) -> None:
        """Notes the loop of a turn."""
        self.late += timing.late
        self.period_error += timing.period_error
        self.cost += timing.cost
        self.ticks += timing.ticks
        self.missed += timing.missed
        self.page_faults += timing.page_faults
        self.disk_faults += timing.disk_faults

    def as_json(self) -> dict[str, Any]:
        """The figures by their names [ms]."""
        values: dict[str, Any] = {
            "setting": self.setting.name,
            "asked": list(self.setting.asked),
            "log": self.setting.is_logged,
            "rate_hz": self.rate,
            "kernel": {name: one.text for name, one in self.outcomes.items()},
            "ended_early": self.ended,
        }
        for name in ("ticks", "missed", "page_faults", "disk_faults"):
            values[name] = getattr(self, name)
        for name in ("late", "period_error", "cost", "ages", "wake_up"):
            for which, value in zip(
                ("p50", "p99", "max"), percentiles(getattr(self, name)), strict=True
            ):
                values[f"{name}_{which}_ms"] = None if np.isnan(value) else 1e3 * float(value)
        return values


def compare_settings(
    machine: Machine[Any],
    experiment: str,
    scenario: Any,
    rates: Sequence[float],
    seconds: float,
    settings: Sequence[Setting],
    console: Console,
) -> list[Measured]:
    """Measures settings in turns, at each rate.

    With the backend "hardware" the machine's emulator is begun for each turn, in a process and a
    folder of its own; it refuses other devices than its own before anything is opened.

    Args:
        machine: the machine.
        experiment: experiment that names the machine to `parapod emulate`.
        scenario: one of its scenarios; its `control.period` is replaced.
        rates: rates of the loop [Hz].
        seconds: duration of all turns of a setting at a rate [s].
        settings: settings to compare.
        console: console for progress.

    Raises:
        OutputError: the emulator does not begin; has its words.
    """
    turns = max(1, round(seconds / _TURN))
    turn = seconds / turns
    results = [[Measured(setting, rate) for setting in settings] for rate in rates]
    steps = turns * len(settings) * len(rates)
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        report = stack.enter_context(progress(console, "real time", steps * (turn + _ALONE)))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pp")))
        settings_done = 0
        for rate, measured in zip(rates, results, strict=True):
            control = replace(scenario.control, period=1.0 / rate)
            at_rate = replace(scenario, control=control)
            for _ in range(turns):
                for one in measured:
                    log = folder / "log.mcap" if one.setting.is_logged else None
                    if scenario.backend == "hardware":
                        _emulated_turn(machine, experiment, at_rate, turn, one, log)
                    else:
                        _simulated_turn(machine, at_rate, turn, one, log)
                    with undisturbed(one.setting.asked) as outcomes:
                        one.outcomes = {outcome.name: outcome for outcome in outcomes}
                        one.wake_up += wake_up_latency(1.0 / rate, _ALONE)
                    settings_done += 1
                    report(settings_done * (turn + _ALONE))
    return [one for measured in results for one in measured]


def _simulated_turn(
    machine: Machine[Any], scenario: Any, duration: float, measured: Measured, log: Path | None
) -> None:
    """A turn without devices."""
    loop = ClosedLoop(machine, scenario, log=())
    simulator = loop.simulator()
    root = simulator.get_mutable_context()
    options = RunOptions(log=log, console=Console(quiet=True))
    with ExitStack() as stack:
        write = stack.enter_context(logged(options, loop, root, "bench-rt"))
        stack.enter_context(undisturbed(measured.setting.asked))
        stack.enter_context(loop.station.active())
        loop.reset(root)
        simulator.Initialize()
        rehearse(loop, root)
        running = RealTimeLoop(
            simulator,
            scenario.control.period,
            lambda context: write(context.get_time()),
            is_strict=False,
            kept=None,
        )
        running.run(duration)
    measured.add(running.timing)


def _emulated_turn(
    machine: Machine[Any],
    experiment: str,
    scenario: Any,
    duration: float,
    measured: Measured,
    log: Path | None,
) -> None:
    """Runs a job of a given duration, on a machine at the beginning of its scenario."""
    timings: list[Timing] = []
    options = RunOptions(log=log, console=Console(quiet=True))
    simulated = "kinematic" if "kinematic" in machine.plants else next(iter(machine.plants))
    with tempfile.TemporaryDirectory(prefix="pp") as folder:
        path = Path(folder, "machine.yaml")
        path.write_text(dump_scenario(replace(scenario, backend=simulated)))
        # It refuses the drivers of other devices: none is opened here before it runs.
        with own_emulator(experiment, f"--scenario={path}", "--rate=1"):  # by this clock
            loop = ClosedLoop(machine, scenario, log=())  # its devices' addresses are in there
            try:
                run_on_hardware(
                    *(loop, loop.simulator(), duration, options, "bench-rt"),
                    requests=measured.setting.asked,
                    announce=timings.append,
                )
            except ParapodError as error:
                if not timings:
                    raise
                measured.ended.append(str(error))
    for timing in timings:
        measured.add(timing)
    for thread in loop.station.behind.handle_as(Parts).all_threads:
        if thread.device.measures:
            measured.ages += thread.write_ages


def print_settings(results: Sequence[Measured], console: Console) -> None:
    """Prints a table a rate, in milliseconds, and what each setting changed."""
    for rate in dict.fromkeys(one.rate for one in results):
        here = [one for one in results if one.rate == rate]
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        table.add_column(f"{rate:g} Hz", no_wrap=True)
        has_ages = any(one.ages for one in here)
        names = ["period error", "missed", *(["age at write"] if has_ages else []), "faults"]
        for name in (*names, "wake-up alone"):
            table.add_column(name, justify="right", no_wrap=True)
        for one in here:
            cells = [_pair(one.period_error), f"{one.missed} / {one.ticks + one.missed}"]
            cells += [_pair(one.ages)] if has_ages else []
            cells += [f"{one.page_faults} / {one.disk_faults}", _pair(one.wake_up)]
            table.add_row(one.setting.name, *cells)
        console.print(table)
    console.print(
        "99 % / largest, in milliseconds; faults: pages first touched / read from the disk",
        highlight=False,
    )
    for line in settings_lines(results):
        console.print(line, markup=False, highlight=False)


def settings_lines(results: Sequence[Measured]) -> list[str]:
    """Answers of the kernel, what each privilege changed, and turns that ended early."""
    lines = []
    for name in PRIVILEGES:
        having = [one for one in results if name in one.outcomes]
        if not having:
            continue
        alone = [one for one in having if one.setting == Setting(name, (name,))]
        outcome = having[0].outcomes[name]
        lines.append(outcome.text)
        for one in alone if outcome.is_taken else ():
            base = _ordinary_of(one, results)
            if base is not None:
                lines.append(f"  at {one.rate:g} Hz {_changed(base, one)}")
    for one in results:
        where = f"{one.rate:g} Hz, {one.setting.name}"
        lines += [f"{where}: a job would have been ended: {words}" for words in one.ended]
    return lines


def _ordinary_of(one: Measured, results: Sequence[Measured]) -> Measured | None:
    """The same without privileges; None for itself."""
    alike = (
        other
        for other in results
        if not other.setting.asked
        and (other.rate, other.setting.is_logged) == (one.rate, one.setting.is_logged)
        and other is not one
    )
    return next(alike, None)


def _changed(base: Measured, one: Measured) -> str:
    """Figures from one to the other."""
    parts = [f"period error {_pair(base.period_error)} -> {_pair(one.period_error)} ms"]
    parts.append(f"missed {base.missed} -> {one.missed}")
    if one.ages and base.ages:
        parts.append(f"age {_pair(base.ages)} -> {_pair(one.ages)} ms")
    return ", ".join(parts)


def _pair(values: Sequence[float]) -> str:
    """99th percentile and maximum [ms]."""
    pair: NDArray[np.float64] = 1e3 * percentiles(values)[1:]
    return " / ".join("-" if np.isnan(value) else three_digits(value) for value in pair)
