"""Slip of the feet while the legs lift the platform and while the arm swings: section 7, Fig. 23.

The legs raise the platform at level attitude; then the actuators are braked, at 0 V behind
self-locking screws, and the arm swings. The solver's own creep, which the arm has no part in, is
measured apart, on an inclined ground.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.scenario import (
    ActuatorScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
)
from parapod.diagrams.levelling_platform.station import Station, make_station
from parapod.diagrams.scenario import choice, dump_scenario, quantity
from parapod.diagrams.wiring import add, connect
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.figures import Figure, plot_lines
from parapod.sims.outputs import write_log
from parapod.sims.results import Metric, Result
from parapod.sims.simulate import simulate
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.errors import OutputError
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY
from parapod.systems.ports import read

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

BACKENDS = ("multibody",)
_POLE = 10.0  # of the lift's position control [1/s]
_PERIOD = 0.01  # of the recording [s]
_LEVEL = (0.0, 0.0)  # roll and pitch of the ground [rad]
# At the smallest one Drake's stiction tolerance, 0.1 mm/s, is what the creep goes by [s].
_CREEP_STEPS = (1e-3, 2e-3, 4e-3)
_BEGIN = 0.5  # at rest before the lift, and before the creep counts [s]


def _nominal_actuators() -> ActuatorScenario:
    return ActuatorScenario(gain_error=0.0)


@dataclass
class LiftScenario:
    """The lift, at level attitude.

    Attributes:
        initial_extension_mm: of all legs [mm].
        height_mm: at the end, above the ground's plane [mm].
        duration: [s].
        rest: from its end, with braked actuators, until the arm swings [s].
    """

    initial_extension_mm: float = quantity(410.0, 390.0, 420.0)
    height_mm: float = quantity(520.0, 395.0, 600.0)
    duration: float = quantity(4.0, 0.5, 60.0)
    rest: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SwingScenario:
    """The arm's swing.

    Attributes:
        angle_deg: forward from upright [deg].
        duration: [s].
        rest: after it [s].
    """

    angle_deg: float = quantity(45.0, -90.0, 90.0)
    duration: float = quantity(1.0, 0.1, 60.0)
    rest: float = quantity(1.0, 0.0, 60.0)


@dataclass
class CreepScenario:
    """The platform stands still on inclined ground.

    Attributes:
        pitch_deg: of the ground [deg].
        duration: over which the creep is measured [s].
    """

    pitch_deg: float = quantity(5.0, 0.5, 10.0)
    duration: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SlipScenario:
    """One study of slip.

    Attributes:
        backend: "multibody".
        seed: of the gains' and dimensions' errors, if there are any.
        lift: see `LiftScenario`.
        arm: see `SwingScenario`.
        creep: see `CreepScenario`.
        plant: see `PlantScenario`; the creep is measured at time steps of its own.
        actuators: nominal by default; see `ActuatorScenario`.
    """

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    lift: LiftScenario = field(default_factory=LiftScenario)
    arm: SwingScenario = field(default_factory=SwingScenario)
    creep: CreepScenario = field(default_factory=CreepScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=_nominal_actuators)

    @property
    def machine(self) -> LevellingScenario:
        """The machine with perfect sensors on level ground."""
        return LevellingScenario(
            backend=self.backend,
            seed=self.seed,
            ground=GroundScenario(0.0, 0.0),
            plant=self.plant,
            actuators=self.actuators,
            sensors=SensorScenario(0.0, False, 0.0, 0.0, 0.0),
            job=JobScenario(initial_extension_mm=self.lift.initial_extension_mm),
        )

    @property
    def braked_at(self) -> float:
        """When the lift is over and the actuators are braked [s]."""
        return _BEGIN + self.lift.duration

    @property
    def swing_at(self) -> float:
        """When the arm begins to swing [s]."""
        return self.braked_at + self.lift.rest

    @property
    def end(self) -> float:
        """[s]."""
        return self.swing_at + self.arm.duration + self.arm.rest


@dataclass(frozen=True)
class Recording:
    """What the plant did.

    Attributes:
        time: (n) [s].
        feet: (n, 4, 3) support points of the legs, in the world [m].
        posture: (n, 3) roll, pitch, height [rad, rad, m].
        arm: (n) angle of the arm [rad].
        normal: (3) of the ground.
    """

    time: NDArray[np.float64]
    feet: NDArray[np.float64]
    posture: NDArray[np.float64]
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


class LiftAndBrake(LeafSystem):
    """Voltages that follow extensions until the actuators are braked, and 0 V from then on.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | of the encoders |
    | out `voltage` | 4 | V | rate and error by the gain K; 0 once braked |

    Args:
        desired: extensions (4) over time [m].
        brake_at: [s].
    """

    def __init__(self, desired: PiecewisePolynomial, brake_at: float) -> None:
        super().__init__()
        self.set_name("lift_and_brake")
        self._desired, self._rate = desired, desired.MakeDerivative()
        self._brake_at, self._gain = brake_at, LinearActuatorParams().gain
        self._extension: Any = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self.DeclareVectorOutputPort("voltage", LEG_COUNT, self._calc_voltage)

    def _calc_voltage(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        if time >= self._brake_at:
            output.SetFromVector(np.zeros(LEG_COUNT))
            return
        error = self._desired.value(time)[:, 0] - np.array(read(self._extension, context))
        output.SetFromVector((self._rate.value(time)[:, 0] + _POLE * error) / self._gain)


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
    extensions = np.array(
        [inverse_kinematics(MODEL_GEOMETRY, posture, _LEVEL) for posture in postures]
    )
    knots = [0.0, *(_BEGIN + scenario.lift.duration * times), scenario.end + 1.0]
    values = [row[:, None] for row in (extensions[0], *extensions, extensions[-1])]
    return PiecewisePolynomial.CubicShapePreserving(knots, values, True)


def swing_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """Angle of the arm: a cubic from rest to rest [rad]."""
    start, angle = scenario.swing_at, np.radians(scenario.arm.angle_deg)
    knots = [0.0, start, start + scenario.arm.duration, scenario.end + 1.0]
    return PiecewisePolynomial.CubicHermite(knots, [[0.0, 0.0, angle, angle]], [[0.0] * 4])


def lift_and_swing(scenario: SlipScenario, options: RunOptions) -> Recording:
    """The movement of Fig. 23, on level ground."""
    arm = TrajectorySource(swing_trajectory(scenario))
    command = LiftAndBrake(lift_trajectory(scenario), scenario.braked_at)
    return _simulate(scenario.machine, command, arm, scenario.end, options, "lift and swing")


def creep(scenario: SlipScenario, time_step: float, options: RunOptions) -> float:
    """Speed of the support points while everything stands still on inclined ground [m/s]."""
    machine = replace(
        scenario.machine,
        ground=GroundScenario(0.0, scenario.creep.pitch_deg),
        plant=replace(scenario.plant, time_step=time_step),
    )
    until = _BEGIN + scenario.creep.duration
    braked = ConstantVectorSource(np.zeros(LEG_COUNT))
    upright = ConstantVectorSource(np.zeros(1))
    what = f"creep at {1e3 * time_step:g} ms"
    recording = _simulate(machine, braked, upright, until, options, what)
    return float(recording.displacement(_BEGIN)[-1].mean()) / scenario.creep.duration


def _simulate(
    scenario: LevellingScenario,
    legs: Any,
    arm: Any,
    until: float,
    options: RunOptions,
    what: str,
) -> Recording:
    """Simulates a machine whose legs and arm are commanded by the given systems."""
    builder = DiagramBuilder()
    station = make_station(scenario)
    machine = add(builder, station.diagram)
    add(builder, legs, "legs")
    if legs.num_input_ports():
        connect(builder, machine.GetOutputPort("legs.extension"), legs.get_input_port(0))
    connect(builder, legs.get_output_port(0), machine.GetInputPort("legs.voltage"))
    add(builder, arm, "arm")
    connect(builder, arm.get_output_port(0), machine.GetInputPort("arm.position_command"))
    for name, value in (
        ("wheels.velocity_command", [0.0] * 4),
        ("wheels.brake", [1.0]),
        ("turntable.position_command", [0.0]),
    ):
        idle = add(builder, ConstantVectorSource(np.array(value)), f"idle.{name}")
        connect(builder, idle.get_output_port(), machine.GetInputPort(name))
    simulator = Simulator(builder.Build())
    station.reset(simulator.get_mutable_context())
    rows: list[tuple[Any, ...]] = []
    simulator.set_monitor(_monitor(station, scenario, rows))
    simulator.Initialize()
    simulate(simulator, until, options.console, what)
    time, feet, posture, angle = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(time, feet, posture, angle, np.array(normal_of(*scenario.ground.inclination)))


def _monitor(
    station: Station, scenario: LevellingScenario, rows: list[tuple[Any, ...]]
) -> Callable[[Context], EventStatus]:
    """Appends time, support points, posture and the arm's angle, once per `_PERIOD`."""
    model = station.model
    assert model is not None
    rollers = model.leg_bodies("roller")
    below = MODEL_GEOMETRY.foot_radius * np.array(normal_of(*scenario.ground.inclination))
    posture = station.diagram.GetOutputPort("truth.posture")
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
            at = posture.Eval(station.diagram.GetMyContextFromRoot(root_context))
            rows.append((time, feet, np.array(at), angle))
        return EventStatus.DidNothing()

    return record


def run(scenario: SlipScenario, options: RunOptions) -> Result:
    """Lifts, swings, and measures the creep apart.

    Raises:
        UnreachablePosture: a height outside the stroke.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    for option in ("html", "graphviz", "meshcat"):
        if asked := getattr(options, option):
            message = f"--{option} is not supported: the slip is shown by --figures"
            raise OutputError(message, None if asked is True else asked)
    recording = lift_and_swing(scenario, options)
    if options.log is not None:
        _write(scenario, options, recording)
    speeds = [1e3 * creep(scenario, dt, options) for dt in _CREEP_STEPS]
    metrics = (*_slip_metrics(scenario, recording), *_creep_metrics(scenario, speeds))
    figures = _figures(scenario, recording)
    return Result("slip", scenario.backend, scenario.seed, metrics, _NOTES, figures)


_NOTES = (
    "The creep is the solver's: its friction is regularised, so that a foot under a tangential "
    "force never quite stands still. It carries the whole platform down the slope, not its "
    "posture. With full legs it goes with the time step from 2 ms on; at 1 ms, and with reduced "
    "legs at any step, it is at the floor that Drake's stiction tolerance of 0.1 mm/s sets for "
    "lagged and similar contact; with full legs and sap it goes with the time step throughout.",
    "Most of the arm's slip is elastic and comes back; arm_slip_left_mm is what stays.",
)


def _slip_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    lifted = 1e3 * recording.displacement(_BEGIN, scenario.braked_at)
    waiting = 1e3 * recording.displacement(scenario.braked_at + 0.1, scenario.swing_at)
    swinging = 1e3 * recording.displacement(scenario.swing_at)
    level = recording.time <= scenario.swing_at
    tilt = np.degrees(np.abs(recording.posture[level, :2]))
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
            20.0,
            paper=3.0,
            at_least=1.0,
            meaning="largest of a leg while the actuators lift the platform",
        ),
        Metric("rest_slip_mm", float(waiting.max()), "mm", meaning="between lift and swing"),
        Metric("lift_tilt_deg", float(tilt.max()), "deg", meaning="largest until the swing"),
    )


def _creep_metrics(scenario: SlipScenario, speeds: list[float]) -> tuple[Metric, ...]:
    still = f"standing still on {scenario.creep.pitch_deg:g} deg"
    # Reduced legs creep at the floor, whatever the step.
    is_full = scenario.plant.leg_model == "full"
    keys = ("creep_mm_s", "creep_2ms_mm_s", "creep_4ms_mm_s")
    return (
        *(
            Metric(key, speed, "mm/s", meaning=f"{still}, steps of {1e3 * step:g} ms")
            for key, speed, step in zip(keys, speeds, _CREEP_STEPS, strict=True)
        ),
        Metric(
            "creep_ratio",
            speeds[2] / speeds[1],
            bound=2.4 if is_full else None,
            at_least=1.6 if is_full else None,
            meaning="4 ms to 2 ms: 2 says that the creep is in proportion to the time step",
        ),
    )


def _write(scenario: SlipScenario, options: RunOptions, recording: Recording) -> None:
    assert options.log is not None
    signals = {
        "truth.support_points": recording.feet,
        "truth.posture": recording.posture,
        "truth.arm_position": recording.arm,
    }
    units = dict(zip(signals, ("m", "rad, rad, m", "rad"), strict=True))
    metadata = {"experiment": "slip", "scenario": dump_scenario(scenario), "units": units}
    write_log(options.log, recording.time, signals, metadata)


def _figures(scenario: SlipScenario, recording: Recording) -> tuple[Figure, ...]:
    return (
        Figure(
            "fig23a_height_and_arm",
            "Height of the platform and angle of the arm",
            "First the actuators lift the platform, then they are braked and the arm swings "
            "(Fig. 23a).",
            partial(_draw_motion, recording),
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


def _draw_motion(recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    upper.plot(recording.time, 1e3 * recording.posture[:, 2])
    upper.set_ylabel("height [mm]")
    lower.plot(recording.time, np.degrees(recording.arm))
    lower.set_ylabel("arm [deg]")
    lower.set_xlabel("time [s]")


def _draw_slip(scenario: SlipScenario, recording: Recording, canvas: "Canvas") -> None:
    for axes, since, unit, name in zip(
        canvas.subplots(2, 1),
        (0.0, scenario.swing_at),
        (1e3, 1e6),
        ("since the start [mm]", "since the swing [um]"),
        strict=True,
    ):
        moved = unit * recording.displacement(since)
        time = recording.time[-len(moved) :].tolist()
        lines = [(f"leg {i + 1}", moved[:, i].tolist()) for i in range(LEG_COUNT)]
        plot_lines(axes, time, lines, name)


EXPERIMENT = Experiment(
    name="slip",
    summary="How far the feet slip while the legs lift the platform and while the arm swings.",
    scenario=SlipScenario,
    backends=BACKENDS,
    run=run,
)
