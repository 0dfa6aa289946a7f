"""One leg whose foot is led round a circle: nodes, position controllers, drives (Fig. 10)."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, VectorLogSink

from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.compound_position_controller import (
    CompoundPositionController,
    CompoundPositionControllerParams,
)
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.planner import CircleReference
from parapod.systems.walking_chair.trajectories import FootCircle

_BRANCHES = 3


def _assumed_drive() -> VelocityServoParams:
    return VelocityServoParams(resolution=5e-6, time_constant=0.04, max_velocity=0.08)


@dataclass(frozen=True)
class LegLoopParams:
    """Parameters of the loop; the drives' values are assumptions, as the paper prints none.

    Attributes:
        circle: path of the foot, Eq. (49).
        controller: gains and mode of the position controllers.
        period: period of these [s].
        drive: each of the three drives; end stops are put at the ends of the strokes.
        drive_step: step of the drives' model, and between samples of the log [s].
        gain: (3) velocity of each drive by its command [-].
        offset: (3) velocity of each drive at a command of zero [m/s].
        geometry: the leg.
    """

    circle: FootCircle = field(default_factory=FootCircle)
    controller: CompoundPositionControllerParams = field(
        default_factory=CompoundPositionControllerParams
    )
    period: float = 0.01
    drive: VelocityServoParams = field(default_factory=_assumed_drive)
    drive_step: float = 1e-3
    gain: tuple[float, float, float] = (1.02, 0.985, 1.01)
    offset: tuple[float, float, float] = (-1e-3, -1e-3, -1e-3)
    geometry: LegGeometry = field(default_factory=LegGeometry)


@dataclass(frozen=True)
class LegLoop:
    """A leg that can be simulated.

    Attributes:
        diagram: the whole.
        params: parameters that it was made with.
        drives: the drives in it.
        log: true state of the drives (6) [m, m/s].
    """

    diagram: Diagram
    params: LegLoopParams
    drives: VelocityServo
    log: VectorLogSink

    def reset(self, context: Context) -> None:
        """Puts the foot to rest where the circle begins."""
        self.diagram.SetDefaultContext(context)
        context.SetTime(0.0)
        self.log.FindMutableLog(context).Clear()

    def recorded(
        self, context: Context
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Times (n) [s], positions (n, 3) [m] and velocities (n, 3) [m/s] of the drives."""
        log = self.log.FindLog(context)
        position, velocity = np.split(log.data().T.copy(), 2, axis=-1)
        return log.sample_times().copy(), position, velocity


def make_leg_loop(params: LegLoopParams = LegLoopParams()) -> LegLoop:
    """Wires the loop; the foot is at rest where the circle begins."""
    builder = DiagramBuilder()
    reference = add(builder, CircleReference(params.circle, params.geometry, params.period))
    position = CompoundPositionController(params.controller, _BRANCHES, params.period)
    controller = add(builder, position)
    # At full speed to a node the drives' own loops run; otherwise they hold their commands.
    runs_alone = params.controller.mode == "position"
    sampled = params.drive_step if runs_alone else params.period
    servo = VelocityServo(
        _with_stops(params),
        _BRANCHES,
        sampled,
        params.drive_step,
        position=leg_inverse(params.geometry, params.circle.motion(0.0).position),
        gain=params.gain,
        offset=params.offset,
    )
    drives = add(builder, servo)
    brake = add(builder, ConstantVectorSource(np.zeros(1)), "brake_released")
    for source, sink in (
        (reference.GetOutputPort("position_node"), controller.GetInputPort("position_node")),
        (controller.GetOutputPort("velocity_command"), drives.GetInputPort("velocity_command")),
        (brake.get_output_port(), drives.GetInputPort("brake")),
        (drives.GetOutputPort("position_measured"), controller.GetInputPort("position_measured")),
    ):
        connect(builder, source, sink)
    log = LogVectorOutput(drives.GetOutputPort("state"), builder, params.drive_step)
    diagram = builder.Build()
    diagram.set_name("leg_loop")
    return LegLoop(diagram, params, drives, log)


def _with_stops(params: LegLoopParams) -> VelocityServoParams:
    low, high = params.geometry.strokes.T.tolist()
    return replace(params.drive, stop_min=tuple(low), stop_max=tuple(high))
