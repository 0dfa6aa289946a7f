"""Pushes on bodies of Drake's plant."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array


class PushForces(LeafSystem):
    """Moments and forces at places of bodies, as a `MultibodyPlant` takes them.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pushes` | 6k | N m, N | moment and force of each, by the world's axes |
    | out `applied_spatial_force` | abstract | - | an `ExternallyAppliedSpatialForce` each |

    State: none.

    Bad input: a push with a number that is not finite counts as none.
    """

    def __init__(
        self,
        bodies: Sequence[BodyIndex] = (BodyIndex(1),),
        places: ArrayLike = ((0.0, 0.0, 0.0),),
        weights: Sequence[int] = (),
    ):
        """Creates the system.

        Args:
            bodies: bodies (k) that are pushed.
            places: places (k, 3) of the pushes, from the bodies' origins by their axes [m].
            weights: indices of pushes that are left out: weights of masses that bodies have.
        """
        super().__init__()
        self.set_name("push_forces")
        self._bodies, self._weights = list(bodies), frozenset(weights)
        self._places = np.asarray(places, dtype=float).reshape(len(self._bodies), 3)
        self._pushes = self.DeclareVectorInputPort("pushes", 6 * len(self._bodies))
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            Value[list[ExternallyAppliedSpatialForce]],
            self._calc_forces,
            {self._pushes.ticket()},
        )

    def _calc_forces(self, context: Context, output: Any) -> None:
        pushes = read_array(self._pushes, context).reshape(-1, 6)
        forces = []
        parts = zip(self._bodies, self._places, pushes, strict=True)
        for i, (body, place, push) in enumerate(parts):
            if i in self._weights:
                continue
            force = ExternallyAppliedSpatialForce()
            force.body_index, force.p_BoBq_B = body, place
            finite = push if np.isfinite(push).all() else np.zeros(6)
            force.F_Bq_W = SpatialForce(tau=finite[:3], f=finite[3:])
            forces.append(force)
        output.set_value(forces)
