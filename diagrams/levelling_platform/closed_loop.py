"""Station, controller and the job they are given, in one diagram, with its signals logged."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.closed_loop import ClosedLoop as SimulatedLoop
from parapod.diagrams.closed_loop import log_ports, output_ports
from parapod.diagrams.idle import idle_inputs
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.fault_points import FaultPoints
from parapod.diagrams.levelling_platform.ports import IDLE
from parapod.diagrams.levelling_platform.scenario import JobScenario, LevellingScenario
from parapod.diagrams.levelling_platform.station import make_station
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.scripts import PostureScript, Waypoint


@dataclass(frozen=True)
class ClosedLoop(SimulatedLoop[LevellingScenario]):
    """A levelling platform that can be simulated.

    Attributes:
        faults: where faults are injected.
    """

    faults: FaultPoints

    def reset(self, context: Context, scenario: LevellingScenario | None = None) -> None:
        """Puts everything at its beginning; see `Station.reset`."""
        super().reset(context, scenario)
        if scenario is not None:
            self.faults.set_faults(context, scenario.faults, scenario.seed)


def make_closed_loop(
    scenario: LevellingScenario,
    meshcat: Meshcat | None = None,
    command: LeafSystem | None = None,
    on_unreachable: Literal["raise", "clamp"] = "raise",
    log: Collection[str] | None = None,
) -> ClosedLoop:
    """Builds the closed loop of a scenario.

    Args:
        scenario: what to build.
        meshcat: where to draw it; None for no drawing.
        command: a system with output `posture_command` (3) and inputs `ground` (2) and `enable`
            (1); None for the scenario's script.
        on_unreachable: what happens to a command outside the workspace.
        log: names of the ports to record at the controller's period; None for all of them.
    """
    builder = DiagramBuilder()
    station = make_station(scenario, meshcat)
    machine = add(builder, station.diagram)
    controller = add(builder, make_controller(scenario, on_unreachable))
    script = add(builder, command or make_script(scenario))

    faults = FaultPoints(builder, scenario.control.period, scenario.faults, scenario.seed)
    for name in ("legs.extension", "imu.gyro", "imu.accel"):
        seen = faults.seen(machine.GetOutputPort(name), name)
        connect(builder, seen, controller.GetInputPort(name))
    faults.seen(machine.GetOutputPort("legs.limits"), "legs.limits")  # for the log only
    voltage = faults.seen(controller.GetOutputPort("legs.voltage"), "legs.voltage")
    connect(builder, voltage, machine.GetInputPort("legs.voltage"))
    connect(builder, controller.GetOutputPort("ground_estimated"), script.GetInputPort("ground"))
    connect(builder, controller.GetOutputPort("ground_valid"), script.GetInputPort("enable"))
    if script.HasInputPort("foot_offsets"):
        offsets = controller.GetOutputPort("foot_offsets_estimated")
        connect(builder, offsets, script.GetInputPort("foot_offsets"))
    asked = faults.seen(script.GetOutputPort("posture_command"), "posture_command")
    connect(builder, asked, controller.GetInputPort("posture_command"))
    _add_job(builder, scenario.job, machine, controller)

    ports = output_ports(machine, controller)
    ports |= {"posture_command": script.GetOutputPort("posture_command")} | faults.ports()
    logs = log_ports(builder, ports, scenario.control.period, log)
    diagram = builder.Build()
    diagram.set_name("levelling_platform")
    return ClosedLoop(diagram, station, controller, ports, logs, faults)


def make_script(scenario: LevellingScenario) -> PostureScript:
    """The postures that a scenario asks for."""
    job = scenario.job
    waypoints = [
        Waypoint(w.time, math.radians(w.roll_deg), math.radians(w.pitch_deg), 1e-3 * w.height_mm)
        for w in job.waypoints
    ]
    return PostureScript(
        MODEL_GEOMETRY, 1e-3 * job.height_mm, waypoints, period=scenario.control.period
    )


def _add_job(
    builder: DiagramBuilder, job: JobScenario, machine: Diagram, controller: Diagram
) -> None:
    """Everything that is commanded apart from postures: trigger, arm; the rest is idle."""
    trigger = PiecewisePolynomial.ZeroOrderHold(
        [0.0, job.estimate_at, job.estimate_at + 1e6], [[0.0, 1.0, 1.0]]
    )
    start = job.estimate_at + job.arm.start
    angle = math.radians(job.arm.angle_deg)
    # At rest before and after the swing; a cubic in between.
    knots = [0.0, start, start + job.arm.duration, start + job.arm.duration + 1e6]
    arm = PiecewisePolynomial.CubicHermite(knots, [[0.0, 0.0, angle, angle]], [[0.0] * 4])
    for name, trajectory, port in (
        ("trigger", trigger, controller.GetInputPort("estimate_ground")),
        ("arm_trajectory", arm, machine.GetInputPort("arm.position_command")),
    ):
        source = add(builder, TrajectorySource(trajectory), name)
        connect(builder, source.get_output_port(), port)
    idle_inputs(builder, machine, IDLE)
