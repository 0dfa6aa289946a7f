"""Slip of a simulated platform: of its feet while it moves, and the solver's own creep."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus
from pydrake.systems.primitives import TrajectorySource

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    LevellingScenario,
)
from parapod.diagrams.simulated import Simulation
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.leg_job import make_simulator
from parapod.sims.levelling_platform.slip.scenario import (
    ACTUATOR_SLIP,
    BEGIN,
    HEIGHT_BOUND,
    SlipScenario,
    control_trajectory,
    lift_trajectory,
    swing_trajectory,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.plane import normal_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_PERIOD = 0.01  # period of the recording [s]
# After the brakes close the rods come to rest first [s].
_STOPPING = 0.1


@dataclass(frozen=True)
class Recording:
    """Recording of the plant.

    Attributes:
        time: (n) [s].
        feet: (n, 4, 3) support points of the legs, in the world [m].
        posture: (n, 3) roll, pitch, height [rad, rad, m].
        extension: (n, 4) of the actuators [m].
        arm: (n, m) positions of the arm's joints [rad or m].
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
        displacement = self.feet[counts] - self.feet[counts][0]
        displacement -= (displacement @ self.normal)[..., None] * self.normal
        return np.linalg.norm(displacement, axis=-1)


# Time steps; at the smallest, Drake's stiction tolerance (0.1 mm/s) sets the creep [s].
CREEP_STEPS = (1e-3, 2e-3, 4e-3)


def lift_and_swing(scenario: SlipScenario, runner: Runner) -> Recording:
    """The movement of Fig. 23, on level ground.

    Raises:
        UnreachablePosture: a height outside the stroke.
    """
    builder = DiagramBuilder()
    station = add(builder, Station(PLATFORM, scenario.levelling))
    _add_lift(builder, station, scenario)
    if scenario.levelling.machine.masses.arm.count:
        arm = add(builder, TrajectorySource(swing_trajectory(scenario)), "arm")
        connect(builder, arm.get_output_port(), station.GetInputPort("arm.position_command"))
    return _record(builder, station, scenario.end, runner, "lift and swing")


def creep(scenario: SlipScenario, time_step: float, runner: Runner) -> float:
    """Speed of the support points while everything stands still on inclined ground [m/s]."""
    inclined = replace(
        scenario.levelling,
        ground=GroundScenario(0.0, scenario.creep.pitch_deg),
        plant=replace(scenario.plant, time_step=time_step),
    )
    builder = DiagramBuilder()
    station = add(builder, Station(PLATFORM, inclined))
    until = BEGIN + scenario.creep.duration
    recording = _record(builder, station, until, runner, f"creep at {1e3 * time_step:g} ms")
    return float(recording.displacement(BEGIN)[-1].mean()) / scenario.creep.duration


def _add_lift(
    builder: DiagramBuilder, machine: Station[LevellingScenario], scenario: SlipScenario
) -> None:
    """The platform's own position controllers follow the lift; then they are switched off.

    Their integral action takes up friction and load, with which a proportional law stays below
    the commanded height.
    """
    settings = scenario.levelling
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
    runner: Runner,
    what: str,
) -> Recording:
    simulator = make_simulator(builder, station)
    normal = np.array(normal_of(*station.scenario.ground.inclination))
    rows: list[tuple[Any, ...]] = []
    simulator.set_monitor(_monitor(station, normal, rows))
    simulator.Initialize()
    runner.simulate(simulator, until, what)
    time, feet, posture, extension, arm = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(time, feet, posture, extension, arm, normal)


def _monitor(
    station: Station[LevellingScenario], normal: NDArray[np.float64], rows: list[tuple[Any, ...]]
) -> Callable[[Context], EventStatus]:
    """Appends a recording's columns but for the normal, once per `_PERIOD`."""
    model = station.behind.handle_as(Simulation).plant.model
    assert model is not None
    rollers = model.leg_bodies("roller")
    below = model.geometry.foot_radius * normal
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
            arm = np.array([joint.GetOnePosition(context) for joint in model.arm_joints])
            machine = station.GetMyContextFromRoot(root_context)
            posture, extension = (np.array(port.Eval(machine)) for port in ports)
            rows.append((time, feet, posture, extension, arm))
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
            meaning="largest slip of a leg from the arm's swing on, actuators braked",
        ),
        Metric(
            "arm_slip_left_mm",
            float(swinging[-1].max()),
            "mm",
            meaning="slip of a leg by the arm's swing, at the end",
        ),
        Metric(
            "actuator_slip_mm",
            float(lifted.max()),
            "mm",
            ACTUATOR_SLIP[1],
            paper=3.0,
            at_least=ACTUATOR_SLIP[0],
            meaning="largest slip of a leg while the actuators lift the platform",
        ),
        Metric(
            "rest_slip_mm",
            float(waiting.max()),
            "mm",
            meaning="largest slip of a leg between lift and swing",
        ),
    )


def lift_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    """Measure whether the lift was level, and reached the height."""
    lifting = recording.time <= scenario.swing_at + 1e-9
    tilt = np.degrees(np.abs(recording.posture[lifting, :2]))
    reached = 1e3 * float(recording.posture[lifting, 2][-1])
    return (
        Metric(
            "lift_height_error_mm",
            reached - 1e3 * scenario.height,
            "mm",
            HEIGHT_BOUND * scenario.machine.size,
            meaning="error of the height when the arm begins to swing",
        ),
        Metric("lift_tilt_deg", float(tilt.max()), "deg", meaning="largest tilt until the swing"),
    )


def creep_metrics(scenario: SlipScenario, speeds: list[float]) -> tuple[Metric, ...]:
    """The creep beside the time steps.

    Args:
        scenario: scenario that was run.
        speeds: at each of `CREEP_STEPS` [m/s].
    """
    still = f"creep of the feet at rest on ground of {scenario.creep.pitch_deg:g} deg"
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
            meaning="ratio of the creep with steps of 4 ms to that with 2 ms: 2 if in proportion",
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
        displacement = unit * recording.displacement(since)
        time = recording.time[-len(displacement) :]
        for leg in range(LEG_COUNT):
            width = 2.8 - 0.6 * leg
            axes.plot(time, displacement[:, leg], label=f"leg {leg + 1}", linewidth=width)
        axes.set_ylabel(label)
        axes.set_xlabel("time [s]")
        axes.set_xlim(since, scenario.end)
        axes.set_ylim(bottom=0.0)
    handles, labels = upper.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8)
