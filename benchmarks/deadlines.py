"""Deadlines of both machines on emulated devices, with a log: ten minutes idle, and beside others.

The platform's parts are also driven behind buses, for two minutes, and the platform is served on
them at 1 kHz, without a controller and with one in another program.

No deadline is to be missed on an idle computer. Whether it was idle tell programs that only wake
up, one a core, with a higher priority than the controller: a deadline that is missed while they
wake up in time as well is ours. They see neither what the host of a virtual machine takes while
they wait nor cores that are slow: so the kernel's count of the one, and what a loop that only
computes for as long as the machine's ticks do misses right afterwards, stand beside, and excuse
nothing.
"""

import io
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from benchmarks.alone import missed_alone
from benchmarks.report import Measurement
from benchmarks.wake_ups import WakeUps, wake_ups
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import Parts
from parapod.diagrams.drivers.bus import parts_on_bus
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, WaypointScenario
from parapod.diagrams.machine import Machine
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.job import run_on_hardware
from parapod.sims.real_machine.own_emulator import own_emulator
from parapod.sims.real_machine.real_time import Timing
from parapod.sims.real_machine.serve import serve
from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.buses.address import KINDS

_IDLE, _BUSY, _BUS, _ALONE = 600.0, 60.0, 120.0, 120.0  # [s]
# Age of a measurement when its command is written, of a part behind a bus: in 99 % [s].
_AGE = 12e-3
# A machine that is served to the examples [s].
_SERVED, _SERVED_PERIOD = 20.0, 1e-3
_EXAMPLES = Path(__file__).parents[1] / "examples" / "buses"
_OTHERS = 4
# A missed deadline is the computer's if cores stood still for this part of a period, added up [-],
# within this time before it [s].
_SPAN, _EXCUSE = 0.1, 0.5
_CYCLE = 50.0  # period of the chair's gait, rounded down [s]


class Run(NamedTuple):
    """Outcome of a run on emulated devices.

    Attributes:
        timing: timing of its loop.
        ages: age of measurements when commands made of them had been written [s], by part.
        wake_ups: programs that only woke up meanwhile.
        ended: why it ended early; "": it did not.
        begun: time at which the loop began, by the monotonic clock [s].
        at: time at which it ended.
        missed_alone: share of deadlines that a loop with work alone missed afterwards [-].
    """

    timing: Timing
    ages: dict[str, list[float]]
    wake_ups: WakeUps
    ended: str
    begun: float
    at: float
    missed_alone: float

    @property
    def failures(self) -> list[tuple[float, float, float]]:
        """Times of its being late, or ended, and times before for which cores stood still, and for
        which the host took them [s]."""
        at = np.array([*self.timing.missed_at, *([self.at] if self.ended else [])])
        before = self.wake_ups.before(at, _SPAN), self.wake_ups.steal_before(at, _SPAN)
        return list(zip(at - self.begun, *before, strict=True))

    @property
    def unexcused(self) -> int:
        """Number of times that it was late, or ended, although the computer was on time."""
        least = _EXCUSE * self.timing.period if self.wake_ups.is_judge else np.inf
        return sum(lost < least for _, lost, _ in self.failures)


def run(console: Console) -> list[Measurement]:
    """Ten minutes of each machine, and a minute of each beside four programs that compute."""
    results = []
    for name, machine, physics, job in (
        ("platform", PLATFORM, "kinematic", _levelling),
        ("chair", CHAIR, "multibody", _walking),
    ):
        idle = driven(machine, job(_IDLE), physics, _IDLE, console)
        results += _judged(f"{name}, {_IDLE:g} s idle", idle, console)
        with busy(_OTHERS):
            beside = driven(machine, job(_BUSY), physics, _BUSY, console)
        words = f"{name}, {_BUSY:g} s beside {_OTHERS} busy programs"
        _tell(words, beside, console)
        late = 0 if beside.ended else beside.unexcused
        results += [
            Measurement(f"{words}: deadlines missed", beside.timing.missed, ""),
            Measurement(f"{words}: late, cores on time, no safe end", late, "", 0, None, True),
        ]
    return results + buses(console)


def buses(console: Console) -> list[Measurement]:
    """Two minutes of the platform with all its parts behind a bus of each kind, and a third of one
    of the platform served on it, idle and controlled."""
    results = []
    for kind in KINDS:
        scenario = _levelling(_BUS)
        scenario.hardware.drivers = parts_on_bus(PLATFORM.for_scenario(scenario), kind)
        one = driven(PLATFORM, scenario, "kinematic", _BUS, console, f"--{kind}")
        words = f"platform over {kind}, {_BUS:g} s idle"
        results += _judged(words, one, console, _AGE)
        results += served(kind, is_controlled=False) + served(kind, is_controlled=True)
    return results


def served(kind: str, is_controlled: bool) -> list[Measurement]:
    """Punctuality of the kinematic platform, served on a bus at 1 kHz.

    Args:
        kind: one of `KINDS`.
        is_controlled: an example answers each instant, in another program, which takes a core.
    """
    scenario = LevellingScenario(backend="kinematic")
    scenario.control.period = _SERVED_PERIOD
    text = io.StringIO()
    with ExitStack() as stack:
        if is_controlled:
            stack.enter_context(_program(sys.executable, f"level_{kind}.py", folder=_EXAMPLES))
        timing = serve(
            *(PLATFORM, scenario, f"{kind}://", RunOptions(console=Console(file=text)), _SERVED)
        )
    cost = np.percentile(timing.cost, [50.0, 99.0])
    words = f"served on {kind} at {1.0 / _SERVED_PERIOD:g} Hz"
    words = f"{words}, {'controlled' if is_controlled else 'idle'}"
    bound = None if is_controlled else 0.0
    times = text.getvalue().count("legs is controlled")
    return [
        Measurement(f"{words}: deadlines missed", timing.missed, "", bound, None, True),
        Measurement(f"{words}: median cost of a tick", 1e3 * cost[0], "ms"),
        Measurement(f"{words}: cost of a tick in 99 %", 1e3 * cost[1], "ms"),
        Measurement(f"{words}: taken over by a controller", times, "times", float(is_controlled)),
    ]


def _walking(duration: float) -> ChairScenario:
    """A walk that is not over before."""
    cycles = math.ceil(duration / _CYCLE)
    return ChairScenario(backend="hardware", gait=GaitScenario(cycles=cycles))


def _levelling(duration: float) -> LevellingScenario:
    """A job with a posture every few seconds."""
    scenario = LevellingScenario(backend="hardware")
    scenario.job.waypoints = [
        WaypointScenario(7.0 + 4.0 * i, 0.5 * (-1) ** i, 0.5 * (i % 3), 5.0 * (i % 2))
        for i in range(int(duration / 4.0))
    ]
    return scenario


def driven(
    machine: Machine[Any],
    scenario: Any,
    physics: str,
    duration: float,
    console: Console,
    *of_emulator: str,
) -> Run:
    """Drives a machine on emulated devices for a while, with a log.

    Args:
        machine: the machine.
        scenario: one of its scenarios.
        physics: backend of the emulated machine.
        duration: [s].
        console: console for what happens.
        of_emulator: further options of the emulator.
    """
    timings: list[tuple[Timing, float]] = []
    ended = ""

    def begun(timing: Timing) -> None:
        timings.append((timing, time.monotonic()))

    # In the computer's own time, by which it is judged.
    emulator = own_emulator(machine.experiment, "--rate=1", "--backend", physics, *of_emulator)
    with emulator, tempfile.TemporaryDirectory() as folder:
        loop = ClosedLoop(machine, scenario, log=())
        options = RunOptions(console=console, log=Path(folder, "log.mcap"))
        with wake_ups() as counts:
            try:
                run_on_hardware(
                    *(loop, Simulator(loop), duration, options, "deadlines"), announce=begun
                )
            except ParapodError as error:
                ended = str(error)
            at = time.monotonic()
    ages = {
        part: [age for thread in threads for age in thread.write_ages]
        for part, threads in loop.station.behind.handle_as(Parts).threads.items()
        if any(thread.device.measures and thread.write_ages for thread in threads)
    }
    timing, since = timings[0]
    cost = float(np.median(timing.cost))
    missed = missed_alone(cost, timing.period, min(duration, _ALONE))
    return Run(timing, ages, counts, ended, since, at, missed)


def _tell(words: str, run: Run, console: Console) -> None:
    """Says when a run was late, and whether it was ended."""
    seconds = run.timing.ticks * run.timing.period
    ended = f"ended after {seconds:.0f} s: {run.ended}" if run.ended else "to its end"
    console.print(f"  {words}: {ended}", highlight=False)
    for when, lost, steal in run.failures:
        console.print(
            f"  {words}: late at {when:.2f} s; before, cores stood still for {1e3 * lost:.1f} ms, "
            f"and the host took {1e3 * steal:.0f} ms",
            highlight=False,
        )


def _judged(
    words: str, run: Run, console: Console, oldest: float | None = None
) -> list[Measurement]:
    """Judges a run on a computer that nothing else uses, by the share of fresh measurements or,
    where it is given, the age that 99 % of them stay below."""
    _tell(words, run, console)
    timing = run.timing
    seconds = timing.ticks * timing.period
    alone = run.missed_alone * (timing.ticks + timing.missed)
    results = [
        Measurement(f"{words}: driven", seconds, "s"),
        Measurement(f"{words}: deadlines missed", timing.missed, ""),
        Measurement(f"{words}: a loop with work alone would have missed", alone, ""),
        Measurement(f"{words}: a core stood still for", 1e3 * run.wake_ups.latest, "ms"),
        Measurement(f"{words}: the host took cores for", run.wake_ups.steal[:, 1].sum(), "s"),
        Measurement(f"{words}: late or ended, cores on time", run.unexcused, "", 0, None, True),
    ]
    for part, ages in run.ages.items():
        young = 100.0 * float(np.mean(np.array(ages) < timing.period))
        median, age = 1e3 * np.percentile(ages, [50.0, 99.0])
        results += [
            Measurement(f"{words}: {part}, median age of measurements when written", median, "ms"),
            Measurement(f"{words}: {part}, writes younger than a period", young, "%", 99.0)
            if oldest is None
            else Measurement(f"{words}: {part}, age in 99 %", age, "ms", 1e3 * oldest, None, True),
        ]
    return results


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Number of other programs that compute meanwhile."""
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(_program(sys.executable, "-c", "while True: pass"))
        yield


@contextmanager
def _program(*command: str, folder: Path | None = None) -> Iterator[None]:
    """Another program meanwhile."""
    process = subprocess.Popen(command, cwd=folder)
    try:
        yield
    finally:
        process.kill()
        process.wait()
