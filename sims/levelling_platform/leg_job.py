"""Legs that an experiment drives itself, simulated or on the real machine under its guard."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, System

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import Parts
from parapod.diagrams.guard import Trip, Tripped
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.leg_control import make_leg_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    ControlScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
)
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import idle_inputs
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.run import Monitor, Run
from parapod.sims.lab.runner import Runner
from parapod.systems.core.errors import RefusedRequest
from parapod.systems.levelling_platform.geometry import LEG_COUNT

# Time at the beginning of a job in which nothing is commanded, so that it can be refused [s].
AT_REST = 0.5
# Largest tilt of the platform while no controller holds it level [rad].
_TILT = np.radians(3.0)


class DrivenScenario(Protocol):
    """Settings that the scenarios of such experiments have in common."""

    backend: str
    seed: int
    plant: PlantScenario
    machine: PlatformDesign
    control: ControlScenario
    hardware: HardwareScenario


def on_level_ground(
    scenario: DrivenScenario, sensors: SensorScenario, initial_extension_mm: float | None
) -> LevellingScenario:
    """The machine of a scenario, standing on level ground.

    Args:
        scenario: its backend, seed, machine, plant, control and hardware are taken.
        sensors: the machine's sensors.
        initial_extension_mm: extension of all legs [mm]; None: that of a job.
    """
    return LevellingScenario(
        backend=scenario.backend,
        seed=scenario.seed,
        machine=replace(scenario.machine, sensors=sensors),
        ground=GroundScenario(0.0, 0.0),
        plant=scenario.plant,
        control=scenario.control,
        job=JobScenario(initial_extension_mm=initial_extension_mm),
        hardware=scenario.hardware,
    )


def make_simulator(builder: DiagramBuilder, station: Station[LevellingScenario]) -> Simulator:
    """A simulator, to be initialized, of a diagram in which the machine stands on its feet.

    Args:
        builder: has the station and what drives it; ports that nothing drives are idle.
        station: the machine.
    """
    idle_inputs(builder, station, {port.name: port.idle for port in station.machine.inputs})
    return simulator_of(builder.Build())


class LegJob(LoopExperiment[LevellingScenario, Run]):
    """The loop that such an experiment runs, as the runner wants it."""

    machine = PLATFORM
    backends = PLATFORM.backends

    def __init__(
        self,
        name: str,
        sources: Callable[[], Sequence[System]],
        until: float,
        rate: float,
        **options: bool,
    ):
        """Describes the job.

        Args:
            name: name of the experiment.
            sources: makes the sources of `extension_request`, `legs_enable` and whatever else is
                asked for.
            until: end of the job [s].
            rate: largest rate of a leg that is led to a request [m/s].
            options: options of `make_leg_controller`.
        """
        super().__init__(name)
        self._sources, self._until = sources, until
        self._rate, self._options = rate, options

    def duration(self, scenario: LevellingScenario) -> float:
        """End of the job [s]."""
        return self._until

    def loop(self, scenario: LevellingScenario, **options: Any) -> ClosedLoop[LevellingScenario]:
        """The machine with the legs' controller and the sources."""
        controller = make_leg_controller(scenario, self._rate, **self._options)
        return ClosedLoop(
            PLATFORM, scenario, controller=controller, sources=self._sources(), **options
        )


class LegWatch:
    """Notes what a leg job measures, and ends one that goes wrong beside what the guard sees.

    Attributes:
        tilt_limit: largest roll or pitch [rad].
        signals: names of the signals that it notes.
        rows: values at each tick by signal; `t` is the time at which the legs were read [s].
        is_over: true if the job is done before its end.
        run: the run, once it is over.
    """

    run: Run

    tilt_limit: ClassVar[float] = _TILT
    signals: ClassVar[Sequence[str]] = (
        "legs.extension",
        "legs.voltage",
        "legs.limits",
        "attitude_estimated",
        "imu.gyro",
    )

    def __init__(self, loop: ClosedLoop[Any]):
        """Begins to watch.

        Args:
            loop: loop of a `LegJob`.
        """
        self._loop = loop
        self._readings: dict[str, Callable[[], NDArray[Any]]] = {}
        self.is_over, self._is_begun, self._ticks = False, False, 0
        self.rows: dict[str, list[Any]] = {name: [] for name in ("t", *self.signals)}

    @property
    def machine(self) -> PlatformDesign:
        """The platform that it watches."""
        machine: PlatformDesign = self._loop.scenario.machine
        return machine

    def look(self, root: Context) -> bool:
        """Notes the newest tick, once; returns whether it is new.

        Raises:
            RefusedRequest: see `check_beginning`.
            Tripped: the platform tilts.
        """
        if root.get_time() < self._ticks * self._loop.scenario.control.period - 1e-9:
            return False
        self._ticks += 1
        self.rows["t"].append(read_at(self._loop, root))
        self._readings = self._readings or dict(self._loop.readings(root, self.signals))
        for name, value in self._readings.items():
            self.rows[name].append(value().copy())
        if not self._is_begun and root.get_time() > 0.5 * AT_REST:
            self._is_begun = True
            self.check_beginning()
        tilt = np.abs(self.rows["attitude_estimated"][-1]).max()
        if not tilt <= self.tilt_limit:
            degrees, most = np.degrees([tilt, self.tilt_limit])
            sign = f"a platform that is inclined by {degrees:.1f} deg, more than {most:g} deg"
            raise Tripped(Trip("tilt", sign))
        return True

    def check_beginning(self) -> None:
        """Refuses a machine that does not stand as the job needs it, before anything moves.

        Raises:
            RefusedRequest: names the leg.
        """

    def newest(self, name: str) -> NDArray[np.float64]:
        """Newest value of a signal."""
        value: NDArray[np.float64] = self.rows[name][-1]
        return value

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Feet (4) whose contact switches are closed."""
        closed: NDArray[np.bool_] = self.newest("legs.limits")[2 * LEG_COUNT :] > 0.5
        return closed

    def column(self, name: str) -> NDArray[np.float64]:
        """All values (n, ...) of a signal."""
        return np.array(self.rows[name])


def carry_out[W: LegWatch](
    job: LoopExperiment[LevellingScenario, Any],
    scenario: LevellingScenario,
    runner: Runner,
    make_watch: Callable[[ClosedLoop[Any]], W],
) -> W:
    """Runs a job on the scenario's machine; returns what watched it.

    Raises:
        ParapodError: the watch has ended it, or on the real machine its guard or a device.
    """
    watches: list[W] = []

    def monitor(loop: ClosedLoop[Any], meshcat: Meshcat | None) -> Monitor:
        watches.append(make_watch(loop))

        def look(root: Context) -> EventStatus:
            watches[-1].look(root)
            if watches[-1].is_over:
                return EventStatus.ReachedTermination(loop, "done")
            return EventStatus.DidNothing()

        return look

    run = job.run_loop(scenario, runner, monitor=monitor)
    watches[-1].run = run
    return watches[-1]


def read_at(loop: ClosedLoop[Any], root: Context) -> float:
    """Time at which the extensions that a loop sees were read [s].

    On the real machine that is by the clock of this computer, whatever the loop has left out.
    """
    parts = loop.station.behind.handle
    if not isinstance(parts, Parts):
        return root.get_time()
    reader = parts.readers["legs"]
    stamp: Any = reader.GetOutputPort("stamp").Eval(reader.GetMyContextFromRoot(root))
    return float(stamp[0])


def refuse_beginning(leg: int, what: str) -> RefusedRequest:
    """The error of a machine that does not stand as a job needs it; nothing has moved.

    Args:
        leg: index 0..3.
        what: present and required state of the leg.
    """
    return RefusedRequest(f"leg {leg + 1} {what}", "place")


def refuse_unless_standing(watch: LegWatch) -> None:
    """Refuses a machine that does not stand on all its feet.

    Raises:
        RefusedRequest: names the leg.
    """
    low, high = (1e3 * limit for limit in watch.machine.standing_stroke)
    begin = f"begin on level ground, with all feet on it at {low:g}..{high:g} mm"
    lengths = 1e3 * watch.newest("legs.extension")
    for leg, (length, touches) in enumerate(zip(lengths, watch.touching, strict=True)):
        if not touches:
            raise refuse_beginning(leg, f"does not touch the ground; {begin}")
        if not low <= length <= high:
            raise refuse_beginning(leg, f"is at {length:.1f} mm; {begin}")
