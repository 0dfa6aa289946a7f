"""Inclination of the platform that moves a rod on it across, besides what is asked for."""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.arm.vibration import LumpedRod
from parapod.systems.core.elementwise import all_finite, clamp
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read, read_or_zeros
from parapod.systems.core.triples import cross, plus
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import extension_on_plane
from parapod.systems.levelling_platform.plane import normal_of, seen_moving

# Least determinant of the inclination's effect on both planes, by that of an upright rod [-].
_LEAST = 1e-3


class DampedPosture(LeafSystem):
    """Adds the roll and pitch that displace the first modes of an arm's rod.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `posture_desired_state` | 6 | rad, rad, m and rates | what is asked for |
    | in `displacement` | 4 | m, m/s | of the modes' places across, in x and y, and rates |
    | in `arm_position` | n | rad or m | positions of the arm's joints |
    | in `ground` | 2 | rad | roll and pitch of the ground |
    | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
    | out `posture_damped_state` | 6 | rad, rad, m and rates | what the legs are asked for |

    The platform turns about the ground under its middle: its legs keep their feet where they are.
    What is added is limited, and shrinks to what the stroke leaves: no leg is asked for more than
    the posture itself asks for, or than the stroke has. The height stays.

    State: none.

    Bad input: a displacement that is not finite, or at joints that are not, adds nothing; a
    desired state that is not finite is passed on.
    """

    def __init__(
        self,
        rod: LumpedRod,
        arm: SerialArm,
        geometry: PlatformGeometry = PlatformGeometry(),
        limit: float = math.radians(3.0),
    ):
        """Creates the system.

        Args:
            rod: the modes.
            arm: the arm that carries the rod as its last link.
            geometry: the platform.
            limit: largest inclination that is added to roll and to pitch, either way [rad].
        """
        super().__init__()
        self.set_name("damped_posture")
        self._rod, self._arm, self._geometry, self._limit = rod, arm, geometry, limit
        self._desired = self.DeclareVectorInputPort("posture_desired_state", 6)
        self._displacement = self.DeclareVectorInputPort("displacement", 4)
        self._position = self.DeclareVectorInputPort("arm_position", arm.count)
        self._ground = self.DeclareVectorInputPort("ground", 2)
        self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
        tickets = {self.get_input_port(i).ticket() for i in range(self.num_input_ports())}
        self.DeclareVectorOutputPort("posture_damped_state", 6, self._calc_state, tickets)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        posture = read(self._desired, context)
        displacement = read(self._displacement, context)
        position = read(self._position, context)
        if any(displacement) and all_finite(displacement + position + posture):
            added = self._inclination(displacement, position, posture[2])
            share = self._share(context, posture, added)
            posture[0] += share * added[0]
            posture[1] += share * added[1]
            if share == 1.0:
                posture[3] += added[2]
                posture[4] += added[3]
        output.SetFromVector(np.array(posture))

    def _inclination(
        self, displacement: Sequence[float], position: Sequence[float], height: float
    ) -> list[float]:
        """Roll, pitch and their rates that displace the modes."""
        (a, b, _), (c, d, _) = (
            cross(plus(place, (0.0, 0.0, height)), axis)
            for place, axis in self._rod.places(self._arm, position)
        )
        determinant = a * d - b * c
        smallest = _LEAST * self._rod.distances[0] * self._rod.distances[1]
        if abs(determinant) < smallest:
            determinant = math.copysign(smallest, determinant)
        x, y, x_rate, y_rate = displacement
        roll, pitch = (d * x - b * y) / determinant, (a * y - c * x) / determinant
        rates = (d * x_rate - b * y_rate) / determinant, (a * y_rate - c * x_rate) / determinant
        limited = [clamp(angle, -self._limit, self._limit) for angle in (roll, pitch)]
        still = [
            rate if inside == angle else 0.0
            for rate, inside, angle in zip(rates, limited, (roll, pitch), strict=True)
        ]
        return limited + still

    def _share(self, context: Context, posture: Sequence[float], added: Sequence[float]) -> float:
        """Share of an inclination for which the stroke is long enough."""
        normal = normal_of(*read(self._ground, context))
        offsets = read_or_zeros(self._offsets, context)
        low, high, share = self._geometry.extension_min, self._geometry.extension_max, 1.0
        roll, pitch, height = posture[:3]
        here, _ = seen_moving(normal, roll, pitch, 0.0, 0.0)
        there, _ = seen_moving(normal, roll + added[0], pitch + added[1], 0.0, 0.0)
        for leg, offset in zip(self._geometry.legs, offsets, strict=True):
            above = height - leg.foot_radius - offset
            begin, end = (extension_on_plane(leg, g, above) for g in (here, there))
            edge = clamp(end, min(low, begin), max(high, begin))
            if edge != end:
                share = min(share, (edge - begin) / (end - begin) if end == end else 0.0)
        return share
