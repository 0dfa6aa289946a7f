"""The lift with the swing that follows it, and the creep on inclined ground, simulated."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus
from pydrake.systems.primitives import TrajectorySource

from parapod.diagrams.levelling_platform.posture_chain import pi_params
from parapod.diagrams.levelling_platform.scenario import GroundScenario
from parapod.diagrams.levelling_platform.simulated_station import SimulatedStation
from parapod.diagrams.levelling_platform.station import LevellingStation, make_station
from parapod.diagrams.wiring import add, connect
from parapod.sims.driven_machine import make_simulator
from parapod.sims.experiment import RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.simulate import simulate
from parapod.sims.slip_scenario import (
    BEGIN,
    SlipScenario,
    control_trajectory,
    lift_trajectory,
    swing_trajectory,
)
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.plane import normal_of

_PERIOD = 0.01  # of the recording [s]


@dataclass(frozen=True)
class Recording:
    """What the plant did.

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


def lift_and_swing(scenario: SlipScenario, options: RunOptions) -> Recording:
    """The movement of Fig. 23, on level ground.

    Raises:
        UnreachablePosture: a height outside the stroke.
    """
    builder = DiagramBuilder()
    station = make_station(scenario.machine)
    machine = add(builder, station.diagram)
    _add_lift(builder, machine, scenario)
    arm = add(builder, TrajectorySource(swing_trajectory(scenario)), "arm")
    connect(builder, arm.get_output_port(), machine.GetInputPort("arm.position_command"))
    return _record(builder, station, scenario.end, options, "lift and swing")


def creep(scenario: SlipScenario, time_step: float, options: RunOptions) -> float:
    """Speed of the support points while everything stands still on inclined ground [m/s]."""
    inclined = replace(
        scenario.machine,
        ground=GroundScenario(0.0, scenario.creep.pitch_deg),
        plant=replace(scenario.plant, time_step=time_step),
    )
    builder = DiagramBuilder()
    station = make_station(inclined)
    add(builder, station.diagram)
    until = BEGIN + scenario.creep.duration
    recording = _record(builder, station, until, options, f"creep at {1e3 * time_step:g} ms")
    return float(recording.displacement(BEGIN)[-1].mean()) / scenario.creep.duration


def _add_lift(builder: DiagramBuilder, machine: Diagram, scenario: SlipScenario) -> None:
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
    station: LevellingStation,
    until: float,
    options: RunOptions,
    what: str,
) -> Recording:
    simulator = make_simulator(builder, station)
    normal = np.array(normal_of(*station.scenario.ground.inclination))
    rows: list[tuple[Any, ...]] = []
    simulator.set_monitor(_monitor(station, normal, rows))
    simulator.Initialize()
    simulate(simulator, until, options.console, what)
    time, feet, posture, extension, arm = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(time, feet, posture, extension, arm, normal)


def _monitor(
    station: LevellingStation, normal: NDArray[np.float64], rows: list[tuple[Any, ...]]
) -> Callable[[Context], EventStatus]:
    """Appends a recording's columns but for the normal, once per `_PERIOD`."""
    assert isinstance(station, SimulatedStation)
    model = station.model
    assert model is not None
    rollers = model.leg_bodies("roller")
    below = MODEL_GEOMETRY.foot_radius * normal
    ports = [station.diagram.GetOutputPort(f"truth.{name}") for name in ("posture", "extension")]
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
            machine = station.diagram.GetMyContextFromRoot(root_context)
            posture, extension = (np.array(port.Eval(machine)) for port in ports)
            rows.append((time, feet, posture, extension, angle))
        return EventStatus.DidNothing()

    return record


def write_recording(scenario: SlipScenario, options: RunOptions, recording: Recording) -> None:
    """Writes the log, if one is asked for.

    Raises:
        OutputError: the file cannot be written.
    """
    if options.log is None:
        return
    signals = {
        "truth.support_points": (recording.feet, "m"),
        "truth.posture": (recording.posture, "rad, rad, m"),
        "truth.extension": (recording.extension, "m"),
        "truth.arm_position": (recording.arm, "rad"),
    }
    write_experiment_log(options.log, "slip", scenario, recording.time, signals)
