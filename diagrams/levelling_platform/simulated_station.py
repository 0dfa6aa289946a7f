"""The levelling platform's station with a simulated plant, which can be exchanged."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import (
    DiscreteTimeDelay,
    Multiplexer,
    RandomSource,
    StateInterpolatorWithDiscreteDerivative,
)

from parapod.diagrams.levelling_platform.kinematic_plant import add_kinematic_plant
from parapod.diagrams.levelling_platform.model import geometry_as_built
from parapod.diagrams.levelling_platform.multibody_plant import add_multibody_plant
from parapod.diagrams.levelling_platform.plant import Drives, Plant, PlantMaker
from parapod.diagrams.levelling_platform.ports import STATUS_PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.model import LIMIT_SWITCHES, WHEEL_COUNT, PlatformModel
from parapod.systems.levelling_platform.plane import to_platform
from parapod.systems.levelling_platform.supervisor import SupervisorParams
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE, WheelGeometry
from parapod.systems.sensors.device_status import DeviceStatus
from parapod.systems.sensors.encoder import Encoder
from parapod.systems.sensors.imu import STANDARD_GRAVITY, Imu, ImuParams, add_imu, seed_noise
from parapod.systems.sensors.limit_switches import LimitSwitches

PLANTS: dict[str, PlantMaker] = {
    "multibody": add_multibody_plant,
    "kinematic": add_kinematic_plant,
}
_GRAVITY = 9.81  # of both plants [m/s^2]
_STOPS = LinearActuatorParams()


@dataclass(frozen=True)
class SimulatedStation(Station[LevellingScenario]):
    """A built station and the handles that a simulation needs to begin.

    Attributes:
        plant: its plant.
    """

    plant: Plant
    _actuators: LinearActuator
    _imu: Imu
    _noise: RandomSource

    @property
    def model(self) -> PlatformModel | None:
        """Bodies and joints of the plant; None where none are simulated."""
        return self.plant.model

    def reset(self, root_context: Context, scenario: LevellingScenario | None = None) -> None:
        """Puts the platform on feet or wheels and draws gains, biases and noise from the seed.

        The same station serves any ground, seed and imperfection: nothing is rebuilt.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its ground, initial extension, gain error, biases and seed are taken; None
                for what the station was built from. What is built in, such as the plant with its
                dimensions, the sensors' resolution and the job's times, stays.
        """
        scenario = scenario or self.scenario
        random = np.random.default_rng(scenario.seed)
        ground, foot_offsets = scenario.ground.inclination, scenario.ground.foot_offsets
        geometry = geometry_as_built(self.scenario)
        on_wheels = scenario.job.start == "wheels"
        extension, posture = (_raised if on_wheels else _touchdown)(geometry, scenario)

        actuators = self._actuators.GetMyMutableContextFromRoot(root_context)
        self._actuators.set_extension(actuators, extension)
        error = scenario.actuators.gain_error
        gain_scale = 1.0 + random.uniform(-error, error, LEG_COUNT)
        self._actuators.set_gain_scale(actuators, gain_scale)

        signs = random.choice([-1.0, 1.0], 6)
        self._imu.set_turn_on_bias(
            self._imu.GetMyMutableContextFromRoot(root_context),
            gyro=math.radians(scenario.sensors.gyro_bias_deg_s) * signs[:3],
            accel=1e-3 * STANDARD_GRAVITY * scenario.sensors.accel_bias_mg * signs[3:],
        )
        seed_noise(self._noise, root_context, int(random.integers(2**31)))

        for system in self.plant.on_ground:
            system.set_ground(
                system.GetMyMutableContextFromRoot(root_context), ground, foot_offsets
            )
        at_rest = {
            "attitude": np.array([*posture[:2], 0.0]),
            "angular_velocity": np.zeros(3),
            "specific_force": np.array(to_platform((0.0, 0.0, _GRAVITY), *posture[:2].tolist())),
        }
        for name, hold in self.plant.holds.items():
            context = hold.GetMyMutableContextFromRoot(root_context)
            hold.SetVectorState(context, at_rest[name])
        if self.model is not None:
            plant_context = self.model.plant.GetMyMutableContextFromRoot(root_context)
            if on_wheels:
                x = scenario.job.start_x_m
                self.model.stand_on_wheels(plant_context, extension, posture, ground, x)
            else:
                self.model.stand(plant_context, extension, ground, foot_offsets)


def _raised(
    geometry: PlatformGeometry, scenario: LevellingScenario
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Extensions (4) with the legs up, and the posture of a platform on its wheels.

    Raises:
        ScenarioError: ground that is lower under a foot than under the wheels.
    """
    if min(scenario.ground.foot_offsets) < 0.0:
        key = "ground.foot_heights_mm"
        raise ScenarioError(f"{key} must be 0 or more on wheels, which stand on the plane", key)
    extension = np.full(LEG_COUNT, SupervisorParams().raised)
    posture = [*scenario.ground.inclination, WheelGeometry().standing_height]
    return extension, np.array(posture)


def _touchdown(
    geometry: PlatformGeometry, scenario: LevellingScenario
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Extensions (4) with which all four feet touch, and the posture that follows.

    Raises:
        UnreachablePosture: the fourth foot does not reach the ground.
    """
    ground, foot_offsets = scenario.ground.inclination, scenario.ground.foot_offsets
    extension = np.full(LEG_COUNT, 1e-3 * scenario.job.initial_extension_mm)
    if geometry.deviations or any(foot_offsets):
        posture = forward_kinematics(geometry, extension, ground, (0, 1, 2), foot_offsets)
        whole = replace(geometry, extension_min=_STOPS.stop_min, extension_max=_STOPS.stop_max)
        extension = inverse_kinematics(whole, posture, ground, foot_offsets)
    return extension, forward_kinematics(geometry, extension, ground, (0, 1, 2), foot_offsets)


def make_simulated_station(
    scenario: LevellingScenario, meshcat: Meshcat | None = None
) -> SimulatedStation:
    """Builds the station of a simulated backend.

    Args:
        scenario: what to build; its `backend` decides about the plant.
        meshcat: draws the machine there; None for no drawing.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    actuators = add(
        builder,
        LinearActuator(
            scenario.actuators.params,
            time_step=scenario.plant.time_step if scenario.backend == "multibody" else period,
        ),
    )
    builder.ExportInput(actuators.GetInputPort("voltage"), "legs.voltage")
    builder.ExportInput(actuators.GetInputPort("stop"), "legs.stop")
    wheels = add(builder, VelocityServo(WHEEL_DRIVE, WHEEL_COUNT, period), "wheel_drive")
    builder.ExportInput(wheels.GetInputPort("velocity_command"), "wheels.velocity_command")
    builder.ExportInput(wheels.GetInputPort("brake"), "wheels.brake")
    drives = _add_arm_drive(builder, period, actuators, wheels)

    plant = PLANTS[scenario.backend](builder, scenario, drives, meshcat)
    connect(builder, plant.signals["load_force"], actuators.GetInputPort("load_force"))
    imu, noise = _add_sensors(builder, scenario, actuators, wheels, plant)
    for name in ("posture", "contact_force", "foot_height", "load_force", "loop_error"):
        builder.ExportOutput(plant.signals[name], f"truth.{name}")
    builder.ExportOutput(actuators.GetOutputPort("extension"), "truth.extension")

    diagram = builder.Build()
    diagram.set_name("station")
    return SimulatedStation(diagram, scenario, plant, actuators, imu, noise)


def _add_arm_drive(
    builder: DiagramBuilder, period: float, actuators: LinearActuator, wheels: VelocityServo
) -> Drives:
    """Position commands of turntable and arm, with the velocity that goes with them."""
    command = add(builder, Multiplexer(2), "arm_command")
    drive = add(builder, StateInterpolatorWithDiscreteDerivative(2, period), "arm_drive")
    connect(builder, command.get_output_port(), drive.get_input_port())
    builder.ExportInput(command.get_input_port(1), "arm.position_command")
    builder.ExportInput(command.get_input_port(0), "turntable.position_command")
    return Drives(
        rods=actuators,
        wheels=wheels.GetOutputPort("state"),
        arm=drive.get_output_port(),
        arm_angles=command.get_output_port(),
    )


def _add_sensors(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    actuators: LinearActuator,
    wheels: VelocityServo,
    plant: Plant,
) -> tuple[Imu, RandomSource]:
    """Encoders, limit switches, inertial sensor and device status, exported."""
    sensors = scenario.sensors
    encoder = add(
        builder,
        Encoder(
            resolution=1e-3 * sensors.encoder_resolution_mm, gate_time=scenario.control.period
        ),
    )
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    builder.ExportOutput(encoder.GetOutputPort("position_measured"), "legs.extension")
    builder.ExportOutput(encoder.GetOutputPort("velocity_measured"), "legs.velocity")

    switches = add(builder, LimitSwitches(params=LIMIT_SWITCHES))
    connect(builder, actuators.GetOutputPort("extension"), switches.GetInputPort("extension"))
    connect(builder, plant.signals["contact_force"], switches.GetInputPort("contact_force"))
    builder.ExportOutput(switches.GetOutputPort("limits"), "legs.limits")

    imu, noise = add_imu(builder, ImuParams() if sensors.imu_noise else ImuParams.ideal())
    for name in ("angular_velocity", "specific_force", "attitude"):
        connect(builder, plant.signals[name], imu.GetInputPort(name))
    late = round(1e-3 * sensors.imu_delay_ms / imu.period)
    for name in ("gyro", "accel", "mag"):
        sample = imu.GetOutputPort(name)
        if late:
            # It takes what was shown before the sample of the same instant: one more period.
            delay = add(builder, DiscreteTimeDelay(imu.period, late - 1, 3), f"delayed_{name}")
            connect(builder, sample, delay.get_input_port())
            sample = delay.get_output_port()
        builder.ExportOutput(sample, f"imu.{name}")

    for name in ("position", "velocity"):
        builder.ExportOutput(wheels.GetOutputPort(f"{name}_measured"), f"wheels.{name}")
    status = add(
        builder,
        DeviceStatus(
            STATUS_PARTS,
            (0.0, imu.period, scenario.control.period, 0.0),
            (0.0, late * imu.period, 0.0, 0.0),
        ),
    )
    for name in ("age", "fault"):
        builder.ExportOutput(status.GetOutputPort(name), f"status.{name}")
    return imu, noise
