"""Base of the systems that need to know what the ground is really like."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements
from parapod.systems.levelling_platform.geometry import LEG_COUNT

LEVEL_GROUND = (0.0, 0.0)
NO_OFFSETS = (0.0,) * LEG_COUNT


class OnInclinedGround(LeafSystem):
    """A LeafSystem whose Context holds the ground as numeric parameters.

    Parameters 0 (2) are its roll and pitch [rad], parameters 1 (4) how far it is above its plane
    under each foot [m]. They are parameters and not a constructor's arguments so that one diagram
    serves a sweep over grounds.
    """

    def __init__(
        self, ground: ArrayLike = LEVEL_GROUND, foot_offsets: ArrayLike = NO_OFFSETS
    ) -> None:
        """Declares the parameters.

        Args:
            ground: roll and pitch (2) in a default context [rad].
            foot_offsets: heights under the feet (4) in a default context [m].
        """
        super().__init__()
        self.DeclareNumericParameter(BasicVector(np.array(ground, dtype=float)))
        self.DeclareNumericParameter(BasicVector(np.array(foot_offsets, dtype=float)))

    def set_ground(
        self, context: Context, ground: ArrayLike, foot_offsets: ArrayLike = NO_OFFSETS
    ) -> None:
        """Sets roll and pitch (2) [rad], and the heights under the feet (4) [m]."""
        for index, value in enumerate((ground, foot_offsets)):
            parameter = context.get_mutable_numeric_parameter(index)
            parameter.SetFromVector(np.array(value, dtype=float))

    def _ground_of(self, context: Context) -> list[float]:
        return elements(context.get_numeric_parameter(0))

    def _offsets_of(self, context: Context) -> list[float]:
        return elements(context.get_numeric_parameter(1))
