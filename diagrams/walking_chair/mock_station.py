"""A station without a chair: drives that are where their commands have brought them."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.ports import STATUS_PARTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.simulated_station import drive_params
from parapod.diagrams.wiring import add
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.sensors.device_status import DeviceStatus
from parapod.systems.walking_chair.gait import starting_lengths
from parapod.systems.walking_chair.geometry import BRANCHES
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY


@dataclass(frozen=True)
class MockStation(Station[ChairScenario]):
    """See `make_mock_station`."""

    _drives: VelocityServo

    def reset(self, root_context: Context, scenario: ChairScenario | None = None) -> None:
        """Puts the branches where the walk begins."""
        lengths = starting_lengths(CHAIR_GEOMETRY, self.scenario.gait.walk)
        self._drives.set_position(root_context, lengths.ravel())


def make_mock_station(scenario: ChairScenario, meshcat: Meshcat | None = None) -> MockStation:
    """Builds a station that mirrors commands to measurements, exactly and without dynamics.

    Branches move at their commanded velocities, within their stroke and their speed; the motors
    draw no current. There are no `truth` ports: nothing is hidden. What it is for: to try out a
    program around the ports where neither a plant's nor the hardware's peculiarities matter.

    Args:
        scenario: period, drives' limits, walk.
        meshcat: not used; there is nothing to draw.
    """
    builder = DiagramBuilder()
    exact = replace(drive_params(scenario), resolution=0.0, time_constant=1e-9)
    drives = add(builder, VelocityServo(exact, len(BRANCHES), scenario.control.period), "drives")
    builder.ExportInput(drives.GetInputPort("velocity_command"), "legs.velocity_command")
    builder.ExportInput(drives.GetInputPort("brake"), "legs.brake")
    for name in ("position", "velocity"):
        builder.ExportOutput(drives.GetOutputPort(f"{name}_measured"), f"legs.{name}")
    current = add(builder, ConstantVectorSource(np.zeros(len(BRANCHES))), "motor_current")
    builder.ExportOutput(current.get_output_port(), "legs.current")
    status = add(builder, DeviceStatus(STATUS_PARTS, (0.0,) * len(STATUS_PARTS)))
    for name in ("age", "fault"):
        builder.ExportOutput(status.GetOutputPort(name), f"status.{name}")
    diagram = builder.Build()
    diagram.set_name("station")
    return MockStation(diagram, scenario, drives)
