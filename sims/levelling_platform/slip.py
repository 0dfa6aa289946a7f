"""Measure the slip of the feet while the legs lift the platform and while the arm swings.

Section 7 of the paper, Fig. 23. The legs raise the platform at level attitude; once it has settled
the actuators are braked, at 0 V behind self-locking screws, and the arm swings. The solver's own
creep, which the arm has no part in, is measured apart, on an inclined ground. Of a real machine,
which has to stand on its feet on level ground, as much is measured as its own sensors tell.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, System
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.controller import pi_params
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    ActuatorScenario,
    ControlScenario,
    GroundScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
    emulated_hardware,
)
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect, named_source
from parapod.sims.lab.bench import Bench
from parapod.sims.lab.experiment import Experiment, LogDrawing, Logged
from parapod.sims.lab.figures import Figure
from parapod.sims.lab.results import Metric
from parapod.sims.levelling_platform.driven import make_simulator, on_level_ground
from parapod.sims.levelling_platform.leg_job import AT_REST
from parapod.sims.levelling_platform.slip_measured import (
    Measured,
    Times,
    measure_lift,
    measured_figures,
    measured_metrics,
    measured_notes,
)
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.core.errors import ScenarioError, UnreachablePosture
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.plane import normal_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

BEGIN = 0.5  # at rest before the lift, and before the creep counts [s]
_LEVEL = (0.0, 0.0)  # roll and pitch of the ground [rad]
_PERIOD = 0.01  # of the recording [s]
# After the brakes close the rods come to rest first [s].
_STOPPING = 0.1
_HEIGHT_BOUND = 0.1  # [mm]
_ACTUATOR_SLIP = (1.0, 20.0)  # while the legs lift, which is the curve of the feet [mm]
_NOTES = (
    "The creep is the solver's: its friction is regularised, so that a foot under a tangential "
    "force never quite stands still. It carries the whole platform down the slope, not its "
    "posture. With full legs it goes with the time step from 2 ms on; at 1 ms, and with reduced "
    "legs at any step, it is at the floor that Drake's stiction tolerance of 0.1 mm/s sets for "
    "lagged and similar contact; with sap, which has no such floor, it goes with the time step "
    "throughout.",
    "Most of the arm's slip is elastic and comes back; arm_slip_left_mm is what stays.",
)


@dataclass
class LiftScenario(Schema):
    """The lift, at level attitude.

    Attributes:
        initial_extension_mm: extension of all legs at the beginning [mm].
        height_mm: height at the end, above the ground's plane [mm].
        duration: duration of the lift [s].
        settle: time from the end of the lift until the actuators are braked, so that they arrive
            first [s].
        rest: time with braked actuators until the arm swings [s].
    """

    initial_extension_mm: float = quantity(410.0, 390.0, 420.0)
    height_mm: float = quantity(520.0, 395.0, 600.0)
    duration: float = quantity(4.0, 0.5, 60.0)
    settle: float = quantity(1.0, 0.0, 60.0)
    rest: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SwingScenario(Schema):
    """The arm's swing.

    Attributes:
        angle_deg: angle forward from upright [deg].
        duration: duration of the swing [s].
        rest: time at rest after the swing [s].
    """

    angle_deg: float = quantity(45.0, -90.0, 90.0)
    duration: float = quantity(1.0, 0.1, 60.0)
    rest: float = quantity(1.0, 0.0, 60.0)


@dataclass
class CreepScenario(Schema):
    """The solver's creep on inclined ground, at time steps of 1, 2 and 4 ms.

    Attributes:
        pitch_deg: pitch of the ground [deg].
        duration: time over which the creep is measured [s].
    """

    pitch_deg: float = quantity(5.0, 0.5, 10.0)
    duration: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SlipScenario(Schema):
    """One study of slip.

    The legs lift the level platform; once it has settled the actuators are braked and the arm
    swings: section 7, Fig. 23.

    Attributes:
        backend: plant: "multibody"; or the real machine, "hardware".
        seed: seed of the errors of gains and dimensions.
        lift: see `LiftScenario`.
        arm: see `SwingScenario`.
        creep: see `CreepScenario`.
        plant: see `PlantScenario`; the creep is measured at time steps of its own.
        actuators: see `ActuatorScenario`.
        control: see `ControlScenario`; its position controllers lift the platform.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    backend: str = choice("multibody", ("multibody", "hardware"))
    seed: int = quantity(0, 0, 2**31 - 1)
    lift: LiftScenario = field(default_factory=LiftScenario)
    arm: SwingScenario = field(default_factory=SwingScenario)
    creep: CreepScenario = field(default_factory=CreepScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=ActuatorScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def machine(self) -> LevellingScenario:
        """The machine with perfect sensors on level ground."""
        perfect = SensorScenario(0.0, False, 0.0, 0.0, 0.0)
        return on_level_ground(self, perfect, self.lift.initial_extension_mm)

    @property
    def braked_at(self) -> float:
        """Time at which the lift has settled and the actuators are braked [s]."""
        return BEGIN + self.lift.duration + self.lift.settle

    @property
    def swing_at(self) -> float:
        """Time at which the arm begins to swing [s]."""
        return self.braked_at + self.lift.rest

    @property
    def end(self) -> float:
        """End of the study [s]."""
        return self.swing_at + self.arm.duration + self.arm.rest


@dataclass(frozen=True)
class Recording:
    """Recording of the plant.

    Attributes:
        time: (n) [s].
        feet: (n, 4, 3) support points of the legs, in the world [m].
        posture: (n, 3) roll, pitch, height [rad, rad, m].
        extension: (n, 4) of the actuators [m].
        arm: (n) angle of the arm [rad].
        normal: (3) of the ground.
    """

    time: NDArray[np.float64]
    feet: NDArray[np.float64]
    posture: NDArray[np.float64]
    extension: NDArray[np.float64]
    arm: NDArray[np.float64]
    normal: NDArray[np.float64]

    def displacement(self, since: float, until: float = np.inf) -> NDArray[np.float64]:
        """(m, 4) how far the support points are from where they were, in the ground's plane [m].

        Args:
            since: they are measured from here [s].
            until: the last time that counts [s].
        """
        counts = (self.time >= since - 1e-9) & (self.time <= until + 1e-9)
        moved = self.feet[counts] - self.feet[counts][0]
        moved -= (moved @ self.normal)[..., None] * self.normal
        return np.linalg.norm(moved, axis=-1)


# At the smallest one Drake's stiction tolerance, 0.1 mm/s, is what the creep goes by [s].
CREEP_STEPS = (1e-3, 2e-3, 4e-3)


@dataclass(frozen=True)
class Slipped:
    """Lift and swing, and the creep apart.

    Attributes:
        recording: the lift with the swing that follows it, or as a real machine measures it.
        creep: speed of the support points on inclined ground for each of `CREEP_STEPS` [m/s];
            empty for a real machine.
    """

    recording: Recording | Measured
    creep: list[float]


class Slip(Experiment[SlipScenario, Slipped]):
    """Lifts, swings, and measures the creep apart."""

    schema = SlipScenario
    machine = PLATFORM
    drawing = LogDrawing(
        PLATFORM,
        {"legs.extension": "truth.extension", "arm.position_command": "truth.arm_position"},
        plots=("truth.posture[0:2]", "truth.posture[2]", "truth.extension", "truth.arm_position"),
    )
    backends = ("multibody", "hardware")
    takes = "30 s"

    def machine_scenario(self, scenario: SlipScenario) -> LevellingScenario:
        """The machine with sensors as they are, for its emulation."""
        return replace(scenario.machine, sensors=SensorScenario())

    def check(self, scenario: SlipScenario) -> None:
        """Refuses a height that the legs do not reach.

        Raises:
            ScenarioError: names the key.
        """
        key, height = "lift.height_mm", scenario.lift.height_mm
        try:
            inverse_kinematics(MODEL_GEOMETRY, (0.0, 0.0, 1e-3 * height), _LEVEL)
        except UnreachablePosture as error:
            raise ScenarioError(f"{key} = {height:g} is out of reach: {error}", key) from error

    def run(self, scenario: SlipScenario, bench: Bench) -> Slipped:
        """Lifts and swings on level ground, then stands still on a slope.

        Raises:
            RefusedRequest: a real machine that does not stand on its feet.
        """
        if scenario.backend == "hardware":
            times = Times.of(scenario, BEGIN)
            machine = scenario.machine
            return Slipped(measure_lift(scenario, machine, times, lift_sources, bench), [])
        recording = lift_and_swing(scenario, bench)
        return Slipped(recording, [creep(scenario, step, bench) for step in CREEP_STEPS])

    def logged(self, scenario: SlipScenario, data: Slipped) -> Logged:
        """Signals of lift and swing."""
        recording = data.recording
        assert isinstance(recording, Recording)  # a real machine's log is written meanwhile
        signals = {
            "truth.support_points": (recording.feet, "m"),
            "truth.posture": (recording.posture, "rad, rad, m"),
            "truth.extension": (recording.extension, "m"),
            "truth.arm_position": (recording.arm, "rad"),
        }
        return recording.time, signals

    def measure(self, scenario: SlipScenario, data: Slipped) -> Iterator[Metric]:
        """Slip of lift and swing, errors of the lift, creep by time step."""
        if isinstance(data.recording, Measured):
            bounds = (*_ACTUATOR_SLIP, _HEIGHT_BOUND)
            yield from measured_metrics(scenario, data.recording, bounds)
            return
        yield from slip_metrics(scenario, data.recording)
        yield from lift_metrics(scenario, data.recording)
        yield from creep_metrics(scenario, data.creep)

    def note(self, scenario: SlipScenario, data: Slipped) -> Iterable[str]:
        """The creep's cause, or what a real machine does not see."""
        if isinstance(data.recording, Measured):
            return measured_notes(data.recording)
        return _NOTES

    def draw(self, scenario: SlipScenario, data: Slipped) -> Iterable[Figure]:
        """Motion and slip (Fig. 23)."""
        if isinstance(data.recording, Measured):
            return measured_figures(data.recording)
        return figures(scenario, data.recording)


def lift_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """Extensions (4) that raise the level platform from rest to rest [m].

    Raises:
        UnreachablePosture: a height outside the stroke.
    """
    start = np.full(LEG_COUNT, 1e-3 * scenario.lift.initial_extension_mm)
    low = forward_kinematics(MODEL_GEOMETRY, start, _LEVEL)[2]
    high = 1e-3 * scenario.lift.height_mm
    times = np.linspace(0.0, 1.0, 21)
    heights = low + (high - low) * times**2 * (3.0 - 2.0 * times)
    postures = np.column_stack([np.zeros((times.size, 2)), heights])
    extensions = inverse_kinematics(MODEL_GEOMETRY, postures, _LEVEL)
    knots = [0.0, *(BEGIN + scenario.lift.duration * times), scenario.end + 1.0]
    values = [row[:, None] for row in (extensions[0], *extensions, extensions[-1])]
    return PiecewisePolynomial.CubicShapePreserving(knots, values, True)


def control_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """1 while the actuators are controlled, 0 once they are braked."""
    knots = [0.0, scenario.braked_at, scenario.end + 1.0]
    return PiecewisePolynomial.ZeroOrderHold(knots, [[1.0, 0.0, 0.0]])


def swing_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """Angle of the arm: a cubic from rest to rest [rad]."""
    start, angle = scenario.swing_at, np.radians(scenario.arm.angle_deg)
    knots = [0.0, start, start + scenario.arm.duration, scenario.end + 1.0]
    return PiecewisePolynomial.CubicHermite(knots, [[0.0, 0.0, angle, angle]], [[0.0] * 4])


def lift_sources(scenario: SlipScenario, times: Times) -> tuple[System, ...]:
    """Sources for a real machine, which is brought to where the lift begins first."""
    control = PiecewisePolynomial.ZeroOrderHold(
        [0.0, AT_REST, times.braked, times.end + 1.0], [[0.0, 1.0, 0.0, 0.0]]
    )
    lift, swing = lift_trajectory(scenario), swing_trajectory(scenario)
    for trajectory in (lift, swing):
        trajectory.shiftRight(times.begin)
    return (
        named_source("extension_request", _held_before(lift), 1),
        named_source("legs_enable", control),
        named_source("arm.position_command", _held_before(swing)),
    )


def _held_before(trajectory: PiecewisePolynomial) -> PiecewisePolynomial:
    """A trajectory that begins later, with its first value from 0 on."""
    first = trajectory.value(trajectory.start_time())
    held = PiecewisePolynomial.CubicHermite(
        [0.0, trajectory.start_time()],
        np.hstack([first, first]).tolist(),
        [[0.0] * 2] * first.size,
    )
    held.ConcatenateInTime(trajectory)
    return held


def lift_and_swing(scenario: SlipScenario, bench: Bench) -> Recording:
    """The movement of Fig. 23, on level ground.

    Raises:
        UnreachablePosture: a height outside the stroke.
    """
    builder = DiagramBuilder()
    station = add(builder, Station(PLATFORM, scenario.machine))
    _add_lift(builder, station, scenario)
    arm = add(builder, TrajectorySource(swing_trajectory(scenario)), "arm")
    connect(builder, arm.get_output_port(), station.GetInputPort("arm.position_command"))
    return _record(builder, station, scenario.end, bench, "lift and swing")


def creep(scenario: SlipScenario, time_step: float, bench: Bench) -> float:
    """Speed of the support points while everything stands still on inclined ground [m/s]."""
    inclined = replace(
        scenario.machine,
        ground=GroundScenario(0.0, scenario.creep.pitch_deg),
        plant=replace(scenario.plant, time_step=time_step),
    )
    builder = DiagramBuilder()
    station = add(builder, Station(PLATFORM, inclined))
    until = BEGIN + scenario.creep.duration
    recording = _record(builder, station, until, bench, f"creep at {1e3 * time_step:g} ms")
    return float(recording.displacement(BEGIN)[-1].mean()) / scenario.creep.duration


def _add_lift(
    builder: DiagramBuilder, machine: Station[LevellingScenario], scenario: SlipScenario
) -> None:
    """The platform's own position controllers follow the lift; then they are switched off.

    Their integral action takes up friction and load, with which a proportional law stays below
    the commanded height.
    """
    settings = scenario.machine
    pi = add(builder, PiController(pi_params(settings), period=settings.control.period))
    lift = TrajectorySource(lift_trajectory(scenario), output_derivative_order=1)
    control = TrajectorySource(control_trajectory(scenario))
    for source, name, port in ((lift, "lift", "desired_state"), (control, "control", "enable")):
        output = add(builder, source, name).get_output_port()
        connect(builder, output, pi.GetInputPort(port))
    connect(builder, machine.GetOutputPort("legs.extension"), pi.GetInputPort("measured"))
    connect(builder, pi.GetOutputPort("voltage"), machine.GetInputPort("legs.voltage"))


def _record(
    builder: DiagramBuilder,
    station: Station[LevellingScenario],
    until: float,
    bench: Bench,
    what: str,
) -> Recording:
    simulator = make_simulator(builder, station)
    normal = np.array(normal_of(*station.scenario.ground.inclination))
    rows: list[tuple[Any, ...]] = []
    simulator.set_monitor(_monitor(station, normal, rows))
    simulator.Initialize()
    bench.simulate(simulator, until, what)
    time, feet, posture, extension, arm = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(time, feet, posture, extension, arm, normal)


def _monitor(
    station: Station[LevellingScenario], normal: NDArray[np.float64], rows: list[tuple[Any, ...]]
) -> Callable[[Context], EventStatus]:
    """Appends a recording's columns but for the normal, once per `_PERIOD`."""
    model = station.behind.handle.model
    assert model is not None
    rollers = model.leg_bodies("roller")
    below = MODEL_GEOMETRY.foot_radius * normal
    ports = [station.GetOutputPort(f"truth.{name}") for name in ("posture", "extension")]
    due = 0.0

    def record(root_context: Context) -> EventStatus:
        nonlocal due
        time = root_context.get_time()
        if time >= due - 1e-9:
            due += _PERIOD
            context = model.plant.GetMyContextFromRoot(root_context)
            poses = [model.plant.EvalBodyPoseInWorld(context, roller) for roller in rollers]
            feet = np.array([pose.translation() - below for pose in poses])
            angle = float(model.plant.GetPositions(context, model.arm)[-1])
            machine = station.GetMyContextFromRoot(root_context)
            posture, extension = (np.array(port.Eval(machine)) for port in ports)
            rows.append((time, feet, posture, extension, angle))
        return EventStatus.DidNothing()

    return record


def slip_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    """Measure how far the support points move during lift, rest and swing of the arm."""
    lifted = 1e3 * recording.displacement(BEGIN, scenario.braked_at)
    waiting = 1e3 * recording.displacement(scenario.braked_at + _STOPPING, scenario.swing_at)
    swinging = 1e3 * recording.displacement(scenario.swing_at)
    return (
        Metric(
            "arm_slip_mm",
            float(swinging.max()),
            "mm",
            0.01,
            paper="< 0.01",
            meaning="largest of a leg from the arm's swing on, actuators braked",
        ),
        Metric("arm_slip_left_mm", float(swinging[-1].max()), "mm", meaning="at the end"),
        Metric(
            "actuator_slip_mm",
            float(lifted.max()),
            "mm",
            _ACTUATOR_SLIP[1],
            paper=3.0,
            at_least=_ACTUATOR_SLIP[0],
            meaning="largest of a leg while the actuators lift the platform",
        ),
        Metric("rest_slip_mm", float(waiting.max()), "mm", meaning="between lift and swing"),
    )


def lift_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    """Whether the lift was what the experiment takes it for: level, and to the height."""
    lifting = recording.time <= scenario.swing_at + 1e-9
    tilt = np.degrees(np.abs(recording.posture[lifting, :2]))
    reached = 1e3 * float(recording.posture[lifting, 2][-1])
    return (
        Metric(
            "lift_height_error_mm",
            reached - scenario.lift.height_mm,
            "mm",
            _HEIGHT_BOUND,
            meaning="when the arm begins to swing, against the commanded height",
        ),
        Metric("lift_tilt_deg", float(tilt.max()), "deg", meaning="largest until the swing"),
    )


def creep_metrics(scenario: SlipScenario, speeds: list[float]) -> tuple[Metric, ...]:
    """The creep beside the time steps.

    Args:
        scenario: scenario that was run.
        speeds: at each of `CREEP_STEPS` [m/s].
    """
    still = f"standing still on {scenario.creep.pitch_deg:g} deg"
    # Reduced legs creep at the floor, whatever the step.
    is_full = scenario.plant.leg_model == "full"
    keys = ("creep_mm_s", "creep_2ms_mm_s", "creep_4ms_mm_s")
    return (
        *(
            Metric(key, 1e3 * speed, "mm/s", meaning=f"{still}, steps of {1e3 * step:g} ms")
            for key, speed, step in zip(keys, speeds, CREEP_STEPS, strict=True)
        ),
        Metric(
            "creep_ratio",
            speeds[2] / speeds[1],
            bound=2.4 if is_full else None,
            at_least=1.6 if is_full else None,
            meaning="4 ms to 2 ms: 2 says that the creep is in proportion to the time step",
        ),
    )


def figures(scenario: SlipScenario, recording: Recording) -> tuple[Figure, ...]:
    """The two parts of the paper's Fig. 23."""
    return (
        Figure(
            "fig23a_height_and_arm",
            "Height of the platform and angle of the arm",
            "First the actuators lift the platform, then they are braked (shaded) and the arm "
            "swings (Fig. 23a).",
            partial(_draw_motion, scenario, recording),
            (7.0, 4.2),
        ),
        Figure(
            "fig23b_slip",
            "Displacement of the support points in the plane of the ground",
            "Above from the start of the lift, below from the start of the arm's swing, which "
            "shows the slip with braked actuators (Fig. 23b).",
            partial(_draw_slip, scenario, recording),
            (7.0, 4.6),
        ),
    )


def _shade_braked(axes: "Axes", scenario: SlipScenario) -> None:
    axes.axvspan(scenario.braked_at, scenario.end, color="0.92", zorder=0, label="braked")
    axes.set_xlim(0.0, scenario.end)


def _draw_motion(scenario: SlipScenario, recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    for axes, values, label in (
        (upper, 1e3 * recording.posture[:, 2], "height [mm]"),
        (lower, np.degrees(recording.arm), "arm [deg]"),
    ):
        _shade_braked(axes, scenario)
        axes.plot(recording.time, values)
        axes.set_ylabel(label)
    lower.set_xlabel("time [s]")
    upper.legend(loc="upper left", fontsize=8)


def _draw_slip(scenario: SlipScenario, recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1)
    _shade_braked(upper, scenario)
    for axes, since, unit, label in (
        (upper, 0.0, 1e3, "since the start [mm]"),
        (lower, scenario.swing_at, 1e6, "since the swing [µm]"),
    ):
        moved = unit * recording.displacement(since)
        time = recording.time[-len(moved) :]
        for leg in range(LEG_COUNT):
            width = 2.8 - 0.6 * leg
            axes.plot(time, moved[:, leg], label=f"leg {leg + 1}", linewidth=width)
        axes.set_ylabel(label)
        axes.set_xlabel("time [s]")
        axes.set_xlim(since, scenario.end)
        axes.set_ylim(bottom=0.0)
    handles, labels = upper.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8)
