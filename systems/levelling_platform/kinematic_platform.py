"""Quasi-static plant of the levelling platform: at every instant at rest on its feet."""

import functools
import weakref

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.ports import declare_cached, read
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.inclined_ground import (
    LEVEL_GROUND,
    NO_OFFSETS,
    OnInclinedGround,
)
from parapod.systems.levelling_platform.model import standing_pose
from parapod.systems.levelling_platform.statics import (
    KinematicPlatformParams,
    Stance,
    stand,
    stand_on_feet_and_wheels,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry


class KinematicPlatform(OnInclinedGround):
    """The platform as a body at rest on what carries it: no dynamics, no integration.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | actuator extensions |
    | in `velocity` | 4 | m/s | their rates |
    | in `arm_position` | 2 | rad | turntable and arm angle; unconnected: upright |
    | out `posture` | 3 | rad, rad, m | roll, pitch, height |
    | out `attitude` | 3 | rad | roll, pitch, yaw (zero) |
    | out `angular_velocity` | 3 | rad/s | of the platform, in its own frame |
    | out `specific_force` | 3 | m/s^2 | at rest: minus gravity, in the platform's frame |
    | out `inertial_motion` | 9 | rad, rad/s, m/s^2 | the three above |
    | out `contact_force` | 4 | N | of the ground on the feet, normal to the ground |
    | out `load_force` | 4 | N | force with which the actuators hold, positive to extend |
    | out `foot_height` | 4 | m | of the feet above the ground, zero where they carry |
    | out `base_pose` | 7 | -, m | quaternion (w, x, y, z) and position, above the origin |

    Four springs on a rigid ground share the load when the feet nearly lie in one plane; where
    one would have to pull, its foot lifts and the other three carry. With wheels these carry
    where the feet do not. Ideal friction: the feet stay where they stand sideways, and yaw is
    zero; where the wheels have driven to is left out.

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.

    Bad input: NaN where an extension cannot be built; with wheels also where it tips over.
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
        self._geometry, self._params, self._wheels = geometry, params, wheels
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._velocity = self.DeclareVectorInputPort("velocity", LEG_COUNT)
        self._arm = self.DeclareVectorInputPort("arm_position", 2)
        self._stance = declare_cached(
            self,
            "stance",
            self._calc_stance,
            {
                self._extension.ticket(),
                self._velocity.ticket(),
                self._arm.ticket(),
                self.all_parameters_ticket(),
            },
        )
        for name, size in (
            ("posture", 3),
            ("attitude", 3),
            ("angular_velocity", 3),
            ("specific_force", 3),
            ("inertial_motion", 9),
            ("contact_force", 4),
            ("load_force", 4),
            ("foot_height", 4),
        ):
            calc = functools.partial(_copy_signal, weakref.ref(self), name)
            self.DeclareVectorOutputPort(name, size, calc, {self._stance.ticket})
        self.DeclareVectorOutputPort(
            "base_pose",
            7,
            self._calc_base_pose,
            {self._stance.ticket, self.all_parameters_ticket()},
        )

    def signal(self, context: Context, name: str) -> NDArray[np.float64]:
        """The signal of that name, from the one solution that all of them share."""
        return np.array(getattr(self._stance.of(self, context), name))

    def _calc_base_pose(self, context: Context, output: BasicVector) -> None:
        posture = self._stance.of(self, context).posture
        output.SetFromVector(standing_pose(posture, self._ground_of(context)))

    def _calc_stance(self, context: Context) -> Stance:
        arm = read(self._arm, context) if self._arm.HasValue(context) else [0.0, 0.0]
        state = (
            self._params,
            read(self._extension, context),
            read(self._velocity, context),
            self._ground_of(context),
            arm,
            self._offsets_of(context),
        )
        if self._wheels is None:
            return stand(self._geometry, *state)
        return stand_on_feet_and_wheels(self._geometry, self._wheels, *state)


def _copy_signal(
    platform: weakref.ref[KinematicPlatform], name: str, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = platform()
    assert system is not None
    output.SetFromVector(system.signal(context, name))
