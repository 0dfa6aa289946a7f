"""The platform's four wheels: where they are, how they are driven, and skid steering."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.triples import Vector3

# Reduction n between motor and wheel [-] (section 2.1).
WHEEL_GEAR = 26.0
# Maxon motors on EPOS2 24/5 (assumptions): 500 lines with four edges, 8000 rpm at the motor.
WHEEL_DRIVE = VelocityServoParams(
    resolution=2.0 * math.pi / (2000.0 * WHEEL_GEAR),
    time_constant=0.05,
    max_velocity=8000.0 * 2.0 * math.pi / 60.0 / WHEEL_GEAR,
    acceleration=20.0,
)


@dataclass(frozen=True)
class WheelGeometry:
    """Axles in the platform's frame; wheels 1 to 4 stand beside legs 1 to 4.

    The paper gives no dimensions of the wheels; these let the platform stand on them at the
    height of its lowest pose on the legs, 390 mm (assumption).

    Attributes:
        half_base: half distance of the axles along x [m].
        half_track: half distance of the wheels along y [m].
        height: z of the axles from the platform's centre F [m].
        radius: radius of the wheels [m].
    """

    half_base: float = 0.26
    half_track: float = 0.20
    height: float = -0.265
    radius: float = 0.125

    @cached_property
    def axles(self) -> tuple[Vector3, ...]:
        """Centres of the four wheels, from F [m]."""
        x, y, z = self.half_base, self.half_track, self.height
        return (-x, y, z), (-x, -y, z), (x, -y, z), (x, y, z)

    @property
    def standing_height(self) -> float:
        """Height of F above the ground on which the wheels stand [m]."""
        return self.radius - self.height

    def skid_steering(self) -> NDArray[np.float64]:
        """(4, 2) wheels' velocities [rad/s] by forward speed [m/s] and yaw rate [rad/s].

        Wheels of one side turn alike; the wheels' sideways slip in a turn is not modelled, so
        that a real turn is slower than the one asked for.
        """
        sides = [-y for _, y, _ in self.axles]
        return np.array([[1.0, side] for side in sides]) / self.radius
