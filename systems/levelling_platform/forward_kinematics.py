"""The posture that the measured extensions make, as a system."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem_  # type: ignore[attr-defined]
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematic_feedforward import ACTIVE_LEGS
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import (
    attitude_seeing,
    dot,
    normal_of,
    normal_over,
)
from parapod.systems.ports import read, read_or_zeros


@TemplateSystem.define("ForwardKinematics_")
def ForwardKinematics_(T: Any) -> Any:
    """Scalar-convertible form of `ForwardKinematics` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Posture of a platform that stands on its active legs, Eqs. (10)-(12) in closed form.

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `extension` | 4 | m | extensions of the legs |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
        | out `posture` | 3 | rad, rad, m | roll, pitch, height |

        State: none.

        Bad input: NaN where an extension cannot be built.
        """

        def _construct(
            self, geometry: PlatformGeometry = PlatformGeometry(), converter: Any = None
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("forward_kinematics")
            self.geometry = geometry
            self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
            self.DeclareVectorOutputPort(
                "posture",
                3,
                self._calc_posture,
                {self._extension.ticket(), self._ground.ticket(), self._offsets.ticket()},
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.geometry, converter=converter)

        def _calc_posture(self, context: Context, output: Any) -> None:
            extension = read(self._extension, context)
            offsets = read_or_zeros(self._offsets, context)
            feet = [foot_to_centre(self.geometry.legs[i], extension[i]) for i in ACTIVE_LEGS]
            g = normal_over(feet, [offsets[i] for i in ACTIVE_LEGS])
            height = dot(g, feet[0]) + offsets[0] + self.geometry.foot_radius
            n = normal_of(*read(self._ground, context))
            output.SetFromVector(np.array([*attitude_seeing(g, n), height]))

    return Impl


ForwardKinematics = ForwardKinematics_[None]
