"""The fourth leg: kept on the ground by calculation, Eqs. (30)-(31)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    Context,
    LeafSystem_,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematic_feedforward import ACTIVE_LEGS, moving_plane
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    extension_rate_on_plane,
    foot_motion,
)
from parapod.systems.levelling_platform.plane import dot
from parapod.systems.ports import read, read_or_zeros


@TemplateSystem.define("PassiveLegSolver_")
def PassiveLegSolver_(T: Any) -> Any:
    """Scalar-convertible form of `PassiveLegSolver` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """All four extensions from those of the three active legs (section 6.3).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `active_desired_state` | 6 | m, m/s | extensions of the active legs, their rates |
        | in `posture_desired_state` | 6 | rad, rad, m and rates | for its attitude (Eq. 31) |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
        | out `extension_desired_state` | 8 | m, m/s | of legs 1..4, and their rates |

        State: none. The height comes from the first active leg, i_1 of Eq. (31).

        Bad input: NaN for the passive leg where it cannot reach the ground.
        """

        def _construct(
            self,
            geometry: PlatformGeometry = PlatformGeometry(),
            active_legs: Sequence[int] = ACTIVE_LEGS,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("passive_leg_solver")
            self.geometry, self.active_legs = geometry, tuple(active_legs)
            (self._passive,) = set(range(LEG_COUNT)) - set(active_legs)
            self._active = self.DeclareVectorInputPort("active_desired_state", 6)
            self._posture = self.DeclareVectorInputPort("posture_desired_state", 6)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
            self.DeclareVectorOutputPort(
                "extension_desired_state",
                2 * LEG_COUNT,
                self._calc_desired_state,
                {
                    self._active.ticket(),
                    self._posture.ticket(),
                    self._ground.ticket(),
                    self._offsets.ticket(),
                },
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.geometry, other.active_legs, converter=converter)

        def _calc_desired_state(self, context: Context, output: Any) -> None:
            active = read(self._active, context)
            posture = read(self._posture, context)
            g, g_rate = moving_plane(read(self._ground, context), posture[0:2], posture[3:5])
            first = self.geometry.legs[self.active_legs[0]]
            passive = self.geometry.legs[self._passive]
            foot, slope = foot_motion(first, active[0])
            height_rate = dot(g, slope) * active[3] + dot(g_rate, foot)
            offsets = read_or_zeros(self._offsets, context)
            rise = offsets[self.active_legs[0]] - offsets[self._passive]
            extension = extension_on_plane(passive, g, dot(g, foot) + rise)
            rate = extension_rate_on_plane(passive, extension, g, g_rate, height_rate)
            desired = [extension] * LEG_COUNT + [rate] * LEG_COUNT
            for k, leg in enumerate(self.active_legs):
                desired[leg], desired[LEG_COUNT + leg] = active[k], active[3 + k]
            output.SetFromVector(np.array(desired))

    return Impl


PassiveLegSolver = PassiveLegSolver_[None]
