"""A station without a machine: it answers every command as if it had been carried out."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, InputPort
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from parapod.diagrams.levelling_platform.ports import INPUTS, STATUS_PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.linear_actuator import LinearActuator
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.model import LIMIT_SWITCHES, MODEL_GEOMETRY, WHEEL_COUNT
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE
from parapod.systems.sensors.device_status import DeviceStatus
from parapod.systems.sensors.imu import ImuParams
from parapod.systems.sensors.limit_switches import LimitSwitches

# At once and without counts; as fast as the real ones.
_WHEELS = VelocityServoParams(0.0, 1e-9, WHEEL_DRIVE.max_velocity)


@dataclass(frozen=True)
class MockStation(Station[LevellingScenario]):
    """See `make_mock_station`."""

    _actuators: LinearActuator

    def reset(self, root_context: Context, scenario: LevellingScenario | None = None) -> None:
        """Puts the legs to the job's initial extension."""
        scenario = scenario or self.scenario
        context = self._actuators.GetMyMutableContextFromRoot(root_context)
        self._actuators.set_extension(context, 1e-3 * scenario.job.initial_extension_mm)


def make_mock_station(scenario: LevellingScenario, meshcat: Meshcat | None = None) -> MockStation:
    """Builds a station that mirrors commands to measurements, exactly and without dynamics.

    Legs extend at K times their voltage, wheels turn as commanded, the platform stands on level
    ground as its legs say, and every sensor shows what is so. There are no `truth` ports: nothing
    is hidden. What it is for: to try out a program around the ports where neither a plant's nor
    the hardware's peculiarities matter.

    Args:
        scenario: period, job, actuators' supply.
        meshcat: not used; there is nothing to draw.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    params = replace(scenario.actuators.params, model="integrator", coulomb_friction=0.0)
    actuators = add(builder, LinearActuator(params, time_step=period))
    wheels = add(builder, VelocityServo(_WHEELS, WHEEL_COUNT, period), "wheel_drive")
    builder.ExportInput(actuators.GetInputPort("voltage"), "legs.voltage")
    builder.ExportInput(actuators.GetInputPort("stop"), "legs.stop")
    builder.ExportInput(wheels.GetInputPort("velocity_command"), "wheels.velocity_command")
    builder.ExportInput(wheels.GetInputPort("brake"), "wheels.brake")
    for spec in INPUTS:
        if spec.name.endswith(".position_command"):
            builder.ExportInput(_ignored(builder, spec.name, spec.size), spec.name)

    switches = add(builder, LimitSwitches(params=LIMIT_SWITCHES))
    extension = actuators.GetOutputPort("extension")
    connect(builder, extension, switches.GetInputPort("extension"))
    platform = add(builder, KinematicPlatform(MODEL_GEOMETRY))
    for name in ("extension", "velocity"):
        connect(builder, actuators.GetOutputPort(name), platform.GetInputPort(name))
    force = platform.GetOutputPort("contact_force")
    connect(builder, force, switches.GetInputPort("contact_force"))
    builder.ExportOutput(extension, "legs.extension")
    builder.ExportOutput(actuators.GetOutputPort("velocity"), "legs.velocity")
    builder.ExportOutput(switches.GetOutputPort("limits"), "legs.limits")
    builder.ExportOutput(platform.GetOutputPort("angular_velocity"), "imu.gyro")
    builder.ExportOutput(platform.GetOutputPort("specific_force"), "imu.accel")
    field = add(builder, ConstantVectorSource(np.array(ImuParams().magnetic_field)), "mag")
    builder.ExportOutput(field.get_output_port(), "imu.mag")
    for name in ("position", "velocity"):
        builder.ExportOutput(wheels.GetOutputPort(f"{name}_measured"), f"wheels.{name}")
    status = add(builder, DeviceStatus(STATUS_PARTS, (0.0,) * len(STATUS_PARTS)))
    for name in ("age", "fault"):
        builder.ExportOutput(status.GetOutputPort(name), f"status.{name}")
    diagram = builder.Build()
    diagram.set_name("station")
    return MockStation(diagram, scenario, actuators)


def _ignored(builder: DiagramBuilder, name: str, size: int) -> InputPort:
    """An input that leads nowhere."""
    sink = add(builder, PassThrough(size), name)
    port: InputPort = sink.get_input_port()
    return port
