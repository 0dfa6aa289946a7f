"""Base of the systems that need to know what the ground is really like."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.core.ports import elements
from parapod.systems.levelling_platform.geometry import LEG_COUNT


class OnInclinedGround(LeafSystem):
    """A LeafSystem whose Context holds the ground as numeric parameters.

    Parameters 0 (2) are its roll and pitch [rad], parameters 1 (4) how far it is above its plane
    under each foot [m]. They are parameters and not a constructor's arguments so that one diagram
    serves a sweep over grounds.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclareNumericParameter(BasicVector(np.zeros(2)))
        self.DeclareNumericParameter(BasicVector(np.zeros(LEG_COUNT)))

    def set_ground(
        self, context: Context, ground: ArrayLike, foot_offsets: ArrayLike | None = None
    ) -> None:
        """Sets roll and pitch (2) [rad], and the heights under the feet (4) [m]; None for zero."""
        offsets = np.zeros(LEG_COUNT) if foot_offsets is None else np.asarray(foot_offsets)
        context.get_mutable_numeric_parameter(0).SetFromVector(np.asarray(ground, dtype=float))
        context.get_mutable_numeric_parameter(1).SetFromVector(offsets.astype(float))

    def _ground_of(self, context: Context) -> list[float]:
        return elements(context.get_numeric_parameter(0))

    def _offsets_of(self, context: Context) -> list[float]:
        return elements(context.get_numeric_parameter(1))
