"""The fourth leg: kept on the ground by calculation, Eqs. (30)-(31)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    Context,
    LeafSystem_,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.caching import declare_cached
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematic_feedforward import ACTIVE_LEGS, moving_plane
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    extension_rate_on_plane,
    foot_motion,
)
from parapod.systems.levelling_platform.plane import dot
from parapod.systems.ports import read


@TemplateSystem.define("PassiveLegSolver_")
def PassiveLegSolver_(T: Any) -> Any:
    """Scalar-convertible form of `PassiveLegSolver` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """All four extensions from those of the three active legs (section 6.3).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `extension_active` | 3 | m | extensions of the active legs |
        | in `extension_rate_active` | 3 | m/s | their rates |
        | in `posture_desired` | 3 | rad, rad, m | posture; Eq. (31) uses its attitude |
        | in `posture_rate_desired` | 3 | rad/s, rad/s, m/s | its rate |
        | in `ground` | 2 | rad | roll and pitch of the ground |
        | out `extension_desired` | 4 | m | of all legs, in the order 1..4 |
        | out `extension_rate_desired` | 4 | m/s | their rates |

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
            self._active = self.DeclareVectorInputPort("extension_active", 3)
            self._active_rate = self.DeclareVectorInputPort("extension_rate_active", 3)
            self._posture = self.DeclareVectorInputPort("posture_desired", 3)
            self._posture_rate = self.DeclareVectorInputPort("posture_rate_desired", 3)
            self._ground = self.DeclareVectorInputPort("ground", 2)
            self._motion = declare_cached(
                self,
                "motion",
                self._calc_motion,
                {
                    self._active.ticket(),
                    self._active_rate.ticket(),
                    self._posture.ticket(),
                    self._posture_rate.ticket(),
                    self._ground.ticket(),
                },
            )
            motion = {self._motion.ticket}
            self.DeclareVectorOutputPort("extension_desired", 4, self._calc_extension, motion)
            self.DeclareVectorOutputPort("extension_rate_desired", 4, self._calc_rate, motion)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.geometry, other.active_legs, converter=converter)

        def _calc_extension(self, context: Context, output: Any) -> None:
            output.SetFromVector(self._motion.of(self, context)[0])

        def _calc_rate(self, context: Context, output: Any) -> None:
            output.SetFromVector(self._motion.of(self, context)[1])

        def _calc_motion(self, context: Context) -> Any:
            """Extensions and their rates, which share the plane that they stand on."""
            active = read(self._active, context)
            active_rate = read(self._active_rate, context)
            g, g_rate = moving_plane(
                read(self._ground, context),
                read(self._posture, context)[:2],
                read(self._posture_rate, context)[:2],
            )
            first = self.geometry.legs[self.active_legs[0]]
            passive = self.geometry.legs[self._passive]
            foot, slope = foot_motion(first, active[0])
            height_rate = dot(g, slope) * active_rate[0] + dot(g_rate, foot)
            extension = extension_on_plane(passive, g, dot(g, foot))
            rate = extension_rate_on_plane(passive, extension, g, g_rate, height_rate)
            return self._merge(active, extension), self._merge(active_rate, rate)

        def _merge(self, active: Sequence[Any], passive: Any) -> NDArray[Any]:
            merged = [passive] * LEG_COUNT
            for i, value in zip(self.active_legs, active, strict=True):
                merged[i] = value
            return np.array(merged)

    return Impl


PassiveLegSolver = PassiveLegSolver_[None]
