"""Base of the systems that need to know how the ground is really inclined."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.ports import elements


class OnInclinedGround(LeafSystem):
    """A LeafSystem whose Context holds the ground's roll and pitch, numeric parameter 0 (2) [rad].

    The inclination is a parameter and not a constructor's argument so that one diagram serves a
    sweep over grounds.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclareNumericParameter(BasicVector(np.zeros(2)))

    def set_ground(self, context: Context, ground: ArrayLike) -> None:
        """Inclines the ground: roll and pitch (2) [rad]."""
        context.get_mutable_numeric_parameter(0).SetFromVector(np.asarray(ground, dtype=float))

    def _ground_of(self, context: Context) -> list[float]:
        return elements(context.get_numeric_parameter(0))
