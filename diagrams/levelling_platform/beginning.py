"""Beginning of a scenario: stance of the platform, and what is drawn from the seed."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY, STANDARD_GRAVITY
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.model import PlatformModel
from parapod.systems.levelling_platform.plane import to_platform


@dataclass(frozen=True, eq=False)
class Beginning:
    """Beginning of a scenario, in the quantities that the parts of the machine are set to.

    Attributes:
        ground: roll and pitch of the ground [rad].
        foot_offsets: heights under the feet (4) above the ground's plane [m].
        on_wheels: true if the platform stands on its wheels instead of its feet.
        x: distance on wheels from the places of the feet, along the platform's x axis [m].
        extension: extensions of the legs (4) [m].
        posture: roll, pitch, height [rad, rad, m].
        gain_scale: factors of the actuators' nominal gains (4) [-].
        gyro_bias: turn-on bias of the gyro (3) [rad/s].
        accel_bias: turn-on bias of the accelerometer (3) [m/s^2].
        noise_seed: seed of the inertial sensor's noise.
    """

    ground: tuple[float, float]
    foot_offsets: tuple[float, ...]
    on_wheels: bool
    x: float
    extension: NDArray[np.float64]
    posture: NDArray[np.float64]
    gain_scale: NDArray[np.float64]
    gyro_bias: tuple[float, float, float]
    accel_bias: tuple[float, float, float]
    noise_seed: int

    @classmethod
    def from_scenario(cls, geometry: PlatformGeometry, scenario: LevellingScenario) -> Self:
        """Works out the beginning of a scenario.

        Args:
            geometry: dimensions of the machine as built.
            scenario: its ground, initial extension, gain error, biases and seed are taken.

        Raises:
            ScenarioError: ground that is lower under a foot than under the wheels.
            UnreachablePosture: a foot does not reach the ground.
        """
        on_wheels = scenario.job.start == "wheels"
        extension, posture = (_raised if on_wheels else _touchdown)(geometry, scenario)
        # One stream for all of it: the order of these three is part of what a seed means.
        random = np.random.default_rng(scenario.seed)
        error = scenario.machine.actuators.gain_error
        gain_scale = 1.0 + random.uniform(-error, error, LEG_COUNT)
        signs = random.choice([-1.0, 1.0], 6)
        noise_seed = int(random.integers(2**31))
        sensors = scenario.machine.sensors
        gyro = (math.radians(sensors.gyro_bias_deg_s) * signs[:3]).tolist()
        accel = (1e-3 * STANDARD_GRAVITY * sensors.accel_bias_mg * signs[3:]).tolist()
        return cls(
            ground=scenario.ground.inclination,
            foot_offsets=scenario.ground.foot_offsets,
            on_wheels=on_wheels,
            x=scenario.job.start_x_m,
            extension=extension,
            posture=posture,
            gain_scale=gain_scale,
            gyro_bias=(gyro[0], gyro[1], gyro[2]),
            accel_bias=(accel[0], accel[1], accel[2]),
            noise_seed=noise_seed,
        )

    def positions(self, model: PlatformModel) -> NDArray[np.float64]:
        """All positions of a plant of rigid bodies."""
        if self.on_wheels:
            return model.positions_on_wheels(self.extension, self.posture, self.ground, self.x)
        return model.standing_positions(self.extension, self.ground, self.foot_offsets)

    @property
    def inertial_motion(self) -> NDArray[np.float64]:
        """True attitude [rad], angular velocity [rad/s] and specific force [m/s^2] (9)."""
        roll, pitch, _ = self.posture.tolist()
        specific_force = to_platform((0.0, 0.0, GRAVITY), roll, pitch)
        return np.array((roll, pitch, 0.0, 0.0, 0.0, 0.0, *specific_force))


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
    extension = np.full(LEG_COUNT, scenario.machine.raised)
    posture = [*scenario.ground.inclination, scenario.machine.wheel_geometry.standing_height]
    return extension, np.array(posture)


def _touchdown(
    geometry: PlatformGeometry, scenario: LevellingScenario
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Extensions (4) with which all four feet touch, and the posture that follows.

    Raises:
        UnreachablePosture: the fourth foot does not reach the ground.
    """
    ground, foot_offsets = scenario.ground.inclination, scenario.ground.foot_offsets
    extension = np.array(scenario.initial_extensions)
    if geometry.deviations or geometry.own_legs or any(foot_offsets):
        posture = forward_kinematics(geometry, extension, ground, (0, 1, 2), foot_offsets)
        whole = geometry.with_stroke(scenario.machine.stops)
        extension = inverse_kinematics(whole, posture, ground, foot_offsets)
    return extension, forward_kinematics(geometry, extension, ground, (0, 1, 2), foot_offsets)
