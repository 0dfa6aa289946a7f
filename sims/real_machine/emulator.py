"""Emulated devices run for a controller in another program, and made to misbehave."""

import gc
import itertools
import math
import multiprocessing
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, InputPort, OutputPort
from rich.console import Console

from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import Machine
from parapod.diagrams.ports import Port
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.station import Station
from parapod.sims.output.logs.live import LiveLog
from parapod.sims.real_machine.disturbances import (
    CIRCUITS,
    CLOSED,
    DRIVES,
    EMERGENCY_STOP,
    MEASURE,
    SWITCHES,
    Circuit,
    DeviceFaultRequest,
    Schedule,
    disturbable,
)
from parapod.sims.real_machine.privileges import EMULATED, FIFO, take_priority
from parapod.sims.real_machine.real_time import SWITCH_INTERVAL, RealTimeLoop, undisturbed
from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError
from parapod.systems.core.ports import read_array
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario
from parapod.systems.hardware.addresses import (
    WIRES,
    emulator_directory,
    emulator_lock,
    make_emulator_directory,
)
from parapod.systems.hardware.clock import CLOCK, EmulatedClock, following, going_by, monotonic
from parapod.systems.hardware.emulation.harness import SUPPLY, Misbehaviour, SharedHarness
from parapod.systems.hardware.exclusive import InUse, is_kept, only_program
from parapod.systems.hardware.signals import ended_by_signals

# Time a process may take until its device answers: Drake is imported in each [s].
_TIMEOUT = 60.0
# Time it may take to end [s].
_ENDING = 5.0
_READY = "ready"
# Delay with which the physics still follows the clock [s].
_PATIENCE = 0.2
# Time between two looks at switches [s]: contacts bounce for some milliseconds, and those that
# depend on forces have the plant's contacts solved for once more.
_SWITCH_PERIOD = 0.01
# Lag above which the emulation is reported as too late [s].
_TOO_LATE = 0.05
# Lag for which an emulated time waits [s].
_SLACK = 3e-3
# Rates at which emulated time may run [-], and what is tried to choose one: some times a piece of
# the physics [s], which is to take this share of a processor [-], where there are two.
_RATES = (1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)
_TRIED, _TRIES, _SHARE, _PROCESSORS = 0.04, 6, 0.4, 2
# Time between two remarks on physics that are late [s].
_REMARK_PERIOD = 10.0


@contextmanager
def emulated_devices(
    groups: Sequence[Sequence[Driver]],
    path: Path,
    sizes: dict[str, int],
    idle: dict[str, float],
    parts: Sequence[str],
    seed: int,
) -> Iterator[None]:
    """While it lasts the drivers' devices are emulated, those of a group by one process.

    The processes end with this one, however it ends.

    Args:
        groups: drivers whose devices are emulated, one group for each process.
        path: path of the wires, see `SharedHarness`; it must exist.
        sizes: sizes of the signals on them.
        idle: value of each command while its part is neutral.
        parts: parts of the machine that can misbehave.
        seed: seed of garbage.

    Raises:
        ScenarioError: a driver has no emulator, or an address that is not the emulator's.
        OutputError: an emulator cannot begin.
    """
    context = multiprocessing.get_context("spawn")
    processes: list[tuple[SpawnProcess, Connection]] = []
    try:
        for group in groups:
            ours, theirs = context.Pipe()
            name = ", ".join(f"{type(driver).__name__} ({driver.part})" for driver in group)
            process = context.Process(
                target=_serve,
                args=(group, path, sizes, idle, parts, seed, theirs),
                name=name,
                daemon=True,
            )
            process.start()
            theirs.close()
            processes.append((process, ours))
        for process, connection in processes:
            _wait_for(process.name, connection)
        yield
    finally:
        for _, connection in processes:
            connection.close()
        for process, _ in processes:
            process.join(_ENDING)
            if process.is_alive():
                process.kill()


def _wait_for(name: str, connection: Connection) -> None:
    try:
        answer = connection.recv() if connection.poll(_TIMEOUT) else "does not begin"
    except EOFError:
        answer = "has ended at once"
    if isinstance(answer, ParapodError):
        raise answer
    if answer != _READY:
        raise OutputError(f"the emulator of {name}: {answer}")


def _serve(
    drivers: Sequence[Driver],
    path: Path,
    sizes: dict[str, int],
    idle: dict[str, float],
    parts: Sequence[str],
    seed: int,
    connection: Connection,
) -> None:
    """Emulates devices until the other end of the connection is closed."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    take_priority(priority=EMULATED)  # a real device waits for no other program
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for all; the first process ends us
    try:
        harness = SharedHarness(path, sizes, parts, idle=idle)
        with following(path.with_name(CLOCK)), ExitStack() as stack:
            for driver in drivers:
                misbehaviour = harness.misbehaviour(driver.part, seed)
                stack.enter_context(driver.emulate(harness, misbehaviour))
            # A collection would look through all of this for 50 ms, while no device answers.
            gc.collect()
            gc.freeze()
            _tell(connection, _READY)
            connection.poll(None)
    except ScenarioError as error:
        _tell(connection, error)
    except (ParapodError, OSError) as error:
        _tell(connection, " ".join(str(error).split()))


def _tell(connection: Connection, answer: object) -> None:
    """Answers, unless no one listens any more: another device has refused already."""
    with suppress(ConnectionError):
        connection.send(answer)


class EmulatedMachine:
    """A simulated station whose ports are wires to emulated devices.

    Attributes:
        machine: the machine.
        harness: the wires.
        misbehaviours: misbehaviour of the devices, by part of the machine.
        circuits: circuits beside the devices that can break too, by the names of `disturbed`.
        period: between two exchanges of wires and physics [s].
        clock: time by which all of it goes; None: the computer's.
        lost: time by which the physics have fallen behind the clock for good [s].
        late: delay of the physics behind the clock now [s].
    """

    def __init__(self, machine: Machine[Any], scenario: Any, rate: float | None = None):
        """Builds the machine, in the state in which the scenario begins.

        Args:
            machine: the machine.
            scenario: one of its scenarios; its backend must be a simulated one; its drivers are
                emulated.
            rate: emulated seconds in one of the computer's [-], 1 at most; 1: the machine goes by
                the computer's clock, as a real one; None: as fast as this computer is found to
                follow, by a clock that waits for programs that are late.

        Raises:
            ScenarioError: no machine's, another backend, or an emulator runs already.
        """
        self.machine = machine = machine.for_scenario(scenario)
        if scenario.backend not in machine.plants or not machine.real.exchange:
            raise ScenarioError(
                f"backend = '{scenario.backend}' cannot be behind emulated devices; "
                f"there are: {', '.join(machine.plants)}",
                "backend",
            )
        self._scenario = scenario
        # With a longer step of the plant the exchange is rarer.
        step = 0.0 if scenario.backend == "kinematic" else scenario.plant.time_step
        self.period = max(machine.real.exchange[scenario.backend], step)
        self.lost = self.late = 0.0
        self._looks = itertools.count()
        self._look_every = max(1, round(_SWITCH_PERIOD / self.period))
        self._station = Station(machine, machine.real.emulated(scenario, self.period))
        self._simulator = simulator_of(self._station)
        self._context = self._simulator.get_mutable_context()
        self._sizes = {spec.name: spec.size for spec in (*machine.inputs, *machine.outputs)}
        self._sizes[SUPPLY] = 1
        self.drivers = machine.drivers(scenario)
        self._parts = sorted({driver.part for driver in self.drivers})
        self._wires = make_emulator_directory() / WIRES
        self._program = _only_emulator()
        self.harness = SharedHarness(self._wires, self._sizes, self._parts, is_new=True)
        self.circuits = {name: Circuit() for name in CIRCUITS}
        self._drives = Misbehaviour(scenario.seed)
        self.misbehaviours = {part: self.harness.misbehaviour(part) for part in self._parts}
        station = self._station
        self._outputs: list[tuple[str, OutputPort]]
        self._outputs = [(spec.name, station.GetOutputPort(spec.name)) for spec in machine.outputs]
        for spec in machine.inputs:
            self.harness.set(spec.name, [spec.idle] * spec.size)
            self._port(spec).FixValue(self._context, self.harness.get(spec.name))
        clock = self._wires.with_name(CLOCK)
        clock.unlink(missing_ok=True)
        self.clock: EmulatedClock | None = None
        if rate != 1.0:
            self.clock = EmulatedClock(clock, rate or self._sustainable_rate())
        self._show()

    def _sustainable_rate(self) -> float:
        """Rate at which the physics leave time for devices and a controller [-]."""
        simulator = simulator_of(self._station, self._context.Clone())
        root = simulator.get_mutable_context()
        simulator.Initialize()
        steps = max(1, round(_TRIED / self.period))
        took = math.inf
        # The quickest try counts: in others the computer may have been disturbed.
        for _ in range(_TRIES):
            started = time.monotonic()
            for _ in range(steps):
                simulator.AdvanceTo(root.get_time() + self.period)
                for _, port in self._outputs:
                    port.Eval(root)
            took = min(took, time.monotonic() - started)
        share = took / (steps * self.period) / _SHARE / min(1.0, _processors() / _PROCESSORS)
        return next((rate for rate in _RATES if rate * share <= 1.0), _RATES[-1])

    def _port(self, spec: Port) -> InputPort:
        return self._station.GetInputPort(spec.name)

    @contextmanager
    def devices(self) -> Iterator[None]:
        """While it lasts the emulated devices answer at the addresses of the scenario's drivers.

        Raises:
            ScenarioError: a driver has no emulator, or an address that is not the emulator's.
        """
        drivers = [one for one in self.drivers if not one.is_timeless]
        # A real device does not wait for another one: by the computer's clock these must not for
        # Python's interpreter lock, and have a process each. An emulated time waits for them.
        alone = [[one] for one in drivers if not one.is_program]
        together = [one for one in drivers if one.is_program]
        groups = [*alone, *filter(None, [together])] if self.clock is None else [drivers]
        seed = self._scenario.seed
        neutral = {spec.name: spec.neutral for spec in self.machine.inputs}
        try:
            with (
                going_by(self.clock),
                emulated_devices(groups, self._wires, self._sizes, neutral, self._parts, seed),
            ):
                yield
        finally:
            self._wires.with_name(CLOCK).unlink(missing_ok=True)
            self._wires.unlink(missing_ok=True)
            self._program.close()

    def run(self, duration: float, on_tick: Callable[[Context], None]) -> None:
        """Simulates in the time of `clock`, within `devices`.

        What a busy computer delays by a moment is made up for; what is later is lost, and counted.

        Args:
            duration: [s].
            on_tick: called with the context after each tick.
        """
        inputs = [(spec.name, self._port(spec)) for spec in self.machine.inputs]

        fixed: dict[str, tuple[float, ...]] = {}
        between = self._station.behind.between_steps

        def exchange(root: Context) -> None:
            self.lost = loop.timing.missed * self.period
            self.late = loop.timing.late[-1] if loop.timing.late else 0.0
            if self.clock is not None:
                self.clock.is_well = not any(one.kind for one in self.misbehaviours.values())
            if between is not None:
                between(root)
            is_cut = self._is_pressed or self.circuits[SUPPLY].is_broken
            cut = self.machine.real.cut if is_cut else {}
            for name, port in inputs:
                command = self.harness.get(name)
                if name in self.machine.real.drives:
                    command = self._driven(command)
                received = (cut[name],) * len(command) if name in cut else tuple(command)
                # A value that is fixed anew has all that depends on it calculated anew.
                if received != fixed.get(name):
                    port.FixValue(root, received)
                    fixed[name] = received
            # After the commands: the forces of contacts, which some outputs show, depend on them,
            # and so they are solved for once, for this and for the plant's next step.
            self._show()
            on_tick(root)

        self._simulator.Initialize()
        loop = RealTimeLoop(
            *(self._simulator, self.period, exchange),
            is_strict=False,
            patience=_PATIENCE,
            hold=None if self.clock is None else self.clock.keeper(),
            slack=_SLACK,
        )
        loop.run(duration)

    @property
    def _is_pressed(self) -> bool:
        return self.circuits[EMERGENCY_STOP].is_broken

    def _driven(self, command: Sequence[float]) -> tuple[float, ...]:
        """Commands that reach the motors through drives that are not devices of their own."""
        now = monotonic()
        reached = self._drives.shown(command, now)
        return reached if self._drives.answers(now) else (0.0,) * len(reached)

    def disturbed(self) -> dict[str, Misbehaviour | Circuit]:
        """Everything that can be made to misbehave, by its name."""
        may: dict[str, Misbehaviour | Circuit]
        may = {**self.misbehaviours, DRIVES: self._drives, **self.circuits}
        return {name: may[name] for name in disturbable(self.machine, self._parts)}

    def _show(self) -> None:
        """Puts what the station shows on the wires."""
        pressed, switches = [float(self._is_pressed)], self.circuits[SWITCHES].state
        self.harness.set(SUPPLY, [0.0 if self.circuits[SUPPLY].is_broken else 1.0])
        is_looking = next(self._looks) % self._look_every == 0
        for name, port in self._outputs:
            if name in self.machine.real.switches and not is_looking:
                continue
            is_button = name.endswith(f".{EMERGENCY_STOP}")
            value = pressed if is_button else np.asarray(port.Eval(self._context)).tolist()
            if switches and name in self.machine.real.switches:
                value = [float(switches == CLOSED)] * len(value)
            self.harness.set(name, value)

    def ports(self) -> tuple[dict[str, str], list[int]]:
        """Units by the names of what can be logged, and their sizes."""
        machine = self.machine
        specs = (*machine.inputs, *machine.outputs, *machine.truth)
        return {spec.name: spec.unit for spec in specs}, [spec.size for spec in specs]

    def values(self, root: Context) -> list[NDArray[np.float64]]:
        """Values of all ports that can be logged."""
        machine, station = self.machine, self._station
        inputs = [read_array(self._port(spec), root) for spec in self.machine.inputs]
        specs = (*machine.outputs, *machine.truth)
        values = [np.asarray(station.GetOutputPort(spec.name).Eval(root)) for spec in specs]
        return inputs + values

    def measured(self, root: Context) -> str:
        """The true state, as an instrument would show it beside the machine."""
        if self.machine.real.instrument is None:
            return f"nothing: there is no instrument for {self.machine.title}"
        names = [spec.name for spec in self.machine.truth]
        station = self._station
        return self.machine.real.instrument(
            {name: np.asarray(station.GetOutputPort(name).Eval(root)) for name in names}
        )


def _only_emulator() -> ExitStack:
    """Keeps other emulators from the folder until it is closed or the process ends.

    Raises:
        ScenarioError: another one runs in it.
    """
    with ExitStack() as stack, suppress(InUse):
        if not is_kept(emulator_lock()):  # nor may this program have two
            stack.enter_context(only_program(emulator_lock()))
            return stack.pop_all()
    raise ScenarioError(
        f"an emulator runs in {quoted_path(emulator_directory())} already; end it, or name "
        "another folder in the environment's PARAPOD_EMULATOR"
    )


class Lateness:
    """Remarks on physics that this computer cannot simulate as fast as the clock runs."""

    def __init__(self, machine: Machine[Any], backend: str, say: Callable[[str], None]):
        """Prepares them.

        Args:
            machine: the machine.
            backend: its plant.
            say: takes a remark.
        """
        cheaper = "kinematic" if "kinematic" in machine.plants else backend
        self._advice = "" if cheaper == backend else f"; --backend {cheaper} needs less"
        self._say, self._lost, self._next = say, 0.0, -math.inf

    def judge(self, now: float, late: float, lost_time: float) -> None:
        """Says that the physics are late, at most every ten seconds.

        Args:
            now: time of the simulation [s].
            late: see `EmulatedMachine` [s].
            lost_time: see there [s].
        """
        if now >= self._next and (late > _TOO_LATE or lost_time > self._lost):
            self._say(
                f"{now:.2f} s: this computer is too slow or too busy for these physics: they are "
                f"{late:.2f} s late, and {lost_time - self._lost:.2f} s are lost; controllers "
                f"will find legs that do not follow, or measurements that are too old"
                f"{self._advice}"
            )
            self._lost, self._next = lost_time, now + _REMARK_PERIOD


_LOG_PERIOD = 0.01  # [s]
_FOREVER = 1e6  # [s]


def emulate(
    machine: Machine[Any],
    scenario: Any,
    requests: Sequence[DeviceFaultRequest] = (),
    duration: float = math.inf,
    log: Path | None = None,
    console: Console | None = None,
    experiment: str | None = None,
    options: Sequence[str] = (),
    rate: float | None = None,
) -> None:
    """Runs emulated devices until Ctrl-C, or for a time.

    Meanwhile each line on standard input, such as "imu garbage" or "imu well", begins or ends a
    device's misbehaviour; "measure" prints what an instrument beside the machine shows.

    Args:
        machine: the machine.
        scenario: one of its scenarios, with the drivers whose devices are emulated.
        requests: misbehaviours at their times.
        duration: duration of the emulation [s].
        log: file for all ports, the truth among them, in MCAP; or None.
        console: console for remarks.
        experiment: experiment that another program may run with it; None: the machine's own.
        options: options with which that program may run it.
        rate: see `EmulatedMachine` [-].

    Raises:
        ScenarioError: see `EmulatedMachine`.
        OutputError: the log cannot be written.
    """
    screen = console or Console(stderr=True)
    emulated = EmulatedMachine(machine, scenario, rate)
    schedule = Schedule(emulated.disturbed(), requests, screen)
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        metadata = {
            "experiment": experiment or machine.experiment,
            "parapod": version("parapod"),
            "scenario": dump_scenario(scenario),
        }
        record: LiveLog | None = None
        if log is not None:
            units, sizes = emulated.ports()
            record = stack.enter_context(LiveLog(log, units, sizes, metadata, schedule.say))
        stack.enter_context(emulated.devices())
        _introduce(emulated, scenario, experiment or machine.experiment, options, screen)
        schedule.listen()
        every = max(1, round(_LOG_PERIOD / emulated.period))
        ticks = itertools.count()
        lateness = Lateness(emulated.machine, scenario.backend, schedule.say)

        def on_tick(root: Context) -> None:
            now = root.get_time()
            schedule.advance(now)
            lateness.judge(now, emulated.late, emulated.lost)
            if schedule.is_measuring():
                schedule.say(f"{now:.2f} s: {MEASURE}d {emulated.measured(root)}")
            if record is not None and next(ticks) % every == 0:
                record.write(now, emulated.values(root))

        with undisturbed((FIFO,)):
            emulated.run(min(duration, _FOREVER), on_tick)


def _introduce(
    emulated: EmulatedMachine,
    scenario: Any,
    experiment: str,
    options: Sequence[str],
    console: Console,
) -> None:
    hardware: HardwareScenario = scenario.hardware
    tags = ", ".join(f"{type(d).__name__} ({d.part})" for d in hardware.drivers)
    run = shlex.join(("parapod", "run", experiment, "--backend", "hardware", *options))
    for line in (
        f"emulated: {tags}",
        f"in {emulator_directory()}; physics: {scenario.backend}",
        f"time: {_described(emulated.clock)}",
        f"ready: in another terminal, {run}",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _processors() -> int:
    """Number of processors on which this program may run."""
    return (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )


def _described(clock: EmulatedClock | None) -> str:
    """The time by which emulated devices go, for people."""
    if clock is None:
        return "the computer's, at rate 1"
    waits = "waits for programs that are late"
    if clock.rate == 1.0:
        return f"rate 1, as on the real machine; {waits}"
    return f"rate {clock.rate:g}, {1.0 / clock.rate:.3g} s for each second; {waits}"
