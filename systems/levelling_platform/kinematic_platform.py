"""Quasi-static plant of the levelling platform: at every instant at rest on its feet."""

import functools
import math
import weakref
from collections.abc import Sequence
from operator import add
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.ports import has_value, read, read_array
from parapod.systems.core.remembered import Remembered
from parapod.systems.levelling_platform.geometry import LEG_COUNT, LegGeometry, PlatformGeometry
from parapod.systems.levelling_platform.inclined_ground import (
    LEVEL_GROUND,
    NO_OFFSETS,
    OnInclinedGround,
)
from parapod.systems.levelling_platform.leg import Point, footprint, pose_on_feet
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.statics import (
    KinematicPlatformParams,
    Load,
    stand,
    stand_on_feet_and_wheels,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry

# Signals of the solution, where they are in it.
STANCE = {
    "posture": slice(0, 3),
    "attitude": slice(3, 6),
    "angular_velocity": slice(6, 9),
    "specific_force": slice(9, 12),
    "inertial_motion": slice(3, 12),
    "contact_force": slice(12, 16),
    "load_force": slice(16, 20),
    "foot_height": slice(20, 24),
}
_STANCE_SIZE = 24
_FARTHEST = 1e3  # way or rate of ground that no ground moves [m, m/s]


class KinematicPlatform(OnInclinedGround):
    """The platform as a body at rest on what carries it: no dynamics, no integration.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | actuator extensions |
    | in `velocity` | 4 | m/s | their rates |
    | in `arm_position` | n | rad or m | positions of the arm's joints; unconnected: zero |
    | in `load` | 6 | N m, N | about F, by the platform's axes, besides weight; unconnected: 0 |
    | in `rising` | 8 | m, m/s | how far the ground under each foot has risen; unconnected: 0 |
    | out `posture` | 3 | rad, rad, m | roll, pitch, height |
    | out `attitude` | 3 | rad | roll, pitch, yaw (zero) |
    | out `angular_velocity` | 3 | rad/s | of the platform, in its own frame |
    | out `specific_force` | 3 | m/s^2 | at rest: minus gravity, in the platform's frame |
    | out `inertial_motion` | 9 | rad, rad/s, m/s^2 | the three above |
    | out `contact_force` | 4 | N | of the ground on the feet, normal to the ground |
    | out `load_force` | 4 | N | force with which the actuators hold, positive to extend |
    | out `foot_height` | 4 | m | of the feet above the ground, zero where they carry |
    | out `base_pose` | 7 | -, m | quaternion (w, x, y, z) and position |
    | out `stance` | 24 | as these | posture, inertial motion, contact, load, heights of the feet |

    `load` is that of what bends, whose mass the arm of `params` does not have, and of what pushes.
    Ground that gives way under a foot rises by less than nothing; behind the ways come their
    rates.

    Four springs on a rigid ground share the load when the feet nearly lie in one plane; where
    one would have to pull, its foot lifts and the other three carry. With wheels these carry
    where the feet do not. Ideal friction: the feet slip only by what legs of different lengths
    spread them, and turn the platform by that (`base_pose`; its rate is left out); where the
    wheels have driven to is left out.

    The middle of the four feet is at the world's origin. With legs of one length yaw is zero.

    All of it is one solution, and `stance` shows it in one vector: where several signals are read
    at every step, a C++ `Demultiplexer` behind `stance` costs less than their own ports.

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.

    Bad input: NaN where an extension cannot be built, where a load lifts it off, and on ground
    that moves absurdly; with wheels also where it tips over.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: KinematicPlatformParams = KinematicPlatformParams(),
        wheels: WheelGeometry | None = None,
        ground: ArrayLike = LEVEL_GROUND,
        foot_offsets: ArrayLike = NO_OFFSETS,
    ):
        """Creates the plant.

        Args:
            geometry: the platform.
            params: masses and compliances.
            wheels: on which it stands where the feet do not hold it up; None for none.
            ground: roll and pitch (2) of the ground in a default context [rad].
            foot_offsets: heights under the feet (4) in a default context [m].
        """
        super().__init__(ground, foot_offsets)
        self.set_name("kinematic_platform")
        self._solved = Remembered(functools.partial(_solved, geometry, params, wheels))
        self._legs = geometry.legs
        self._footprint = Remembered(functools.partial(_footprint, self._legs))
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._velocity = self.DeclareVectorInputPort("velocity", LEG_COUNT)
        self._at_zero = [0.0] * params.arm.count
        self._arm = self.DeclareVectorInputPort("arm_position", params.arm.count)
        self._load = self.DeclareVectorInputPort("load", 6)
        self._rising = self.DeclareVectorInputPort("rising", 2 * LEG_COUNT)
        tickets = {
            self._extension.ticket(),
            self._velocity.ticket(),
            self._arm.ticket(),
            self._load.ticket(),
            self._rising.ticket(),
            self.all_parameters_ticket(),
        }
        for name, part in STANCE.items():
            calc = functools.partial(_copy_part, weakref.ref(self), part)
            size = part.stop - part.start
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        self.DeclareVectorOutputPort("base_pose", 7, self._calc_base_pose, tickets)
        self._stance: Any = self.DeclareVectorOutputPort(
            "stance", _STANCE_SIZE, self._calc_stance, tickets
        )

    def part(self, context: Context, part: slice) -> NDArray[np.float64]:
        """Part of the one solution that all ports share."""
        part_of_stance: NDArray[np.float64] = read_array(self._stance, context)[part]
        return part_of_stance

    def _calc_base_pose(self, context: Context, output: BasicVector) -> None:
        roll, pitch, height = self.part(context, STANCE["posture"]).tolist()
        ground = self._ground_of(context)
        normal, extension = normal_of(*ground), read(self._extension, context)
        # F is over the middle of the feet, which turn it as they slip.
        on_feet = pose_on_feet(
            self._legs, extension, (roll, pitch), normal, self._footprint(ground)
        )
        output.SetFromVector(np.array(on_feet.pose((roll, pitch, height), normal)))

    def _calc_stance(self, context: Context, output: BasicVector) -> None:
        arm = read(self._arm, context) if has_value(self._arm, context) else self._at_zero
        offsets, rates = self._offsets_of(context), [0.0] * LEG_COUNT
        if has_value(self._rising, context):
            rising = read(self._rising, context)
            if not sum(map(abs, rising)) < _FARTHEST:
                output.SetFromVector(np.full(_STANCE_SIZE, math.nan))
                return
            offsets, rates = list(map(add, offsets, rising)), rising[LEG_COUNT:]
        stance = self._solved(
            read(self._extension, context),
            read(self._velocity, context),
            self._ground_of(context),
            arm,
            offsets,
            read(self._load, context) if has_value(self._load, context) else [],
            rates,
        )
        output.SetFromVector(stance)


def _footprint(legs: Sequence[LegGeometry], ground: list[float]) -> list[Point]:
    roll, pitch = ground
    return footprint(legs, (roll, pitch))


def _solved(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    wheels: WheelGeometry | None,
    extension: list[float],
    velocity: list[float],
    ground: list[float],
    arm: list[float],
    foot_offsets: list[float],
    wrench: list[float],
    foot_rates: list[float],
) -> NDArray[np.float64]:
    """The stance as its port shows it."""
    load = None
    if any(wrench):
        m_x, m_y, m_z, f_x, f_y, f_z = wrench
        load = Load((m_x, m_y, m_z), (f_x, f_y, f_z))
    state = extension, velocity, ground, arm, foot_offsets, load, foot_rates
    if wheels is None:
        stance = stand(geometry, params, *state)
    else:
        stance = stand_on_feet_and_wheels(geometry, wheels, params, *state)
    return np.array(
        [
            *stance.posture,
            *stance.attitude,
            *stance.angular_velocity,
            *stance.specific_force,
            *stance.contact_force,
            *stance.load_force,
            *stance.foot_height,
        ]
    )


def _copy_part(
    platform: weakref.ref[KinematicPlatform], part: slice, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = platform()
    assert system is not None
    output.SetFromVector(system.part(context, part))
