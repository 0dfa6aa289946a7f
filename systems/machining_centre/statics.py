"""Weight of a centre, and the forces of its legs at rest."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.batching import row_by_row
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read_batch
from parapod.systems.core.rows import answer_of
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian


@dataclass(frozen=True)
class CentreMasses:
    """Masses of a centre; the defaults are assumptions, those of the models as they are drawn.

    Attributes:
        platform: platform with spindle and tool [kg].
        limb: a limb: mount, hinge, two legs, ankle, foot [kg].
    """

    platform: float = 10.2
    limb: float = 5.2

    def weight(self, geometry: CentreGeometry) -> Array:
        """Wrench (6) of the weight that the legs hold up, at P_O in the world [N m, N].

        Half of each limb counts: the other half is on its foot.
        """
        carried = self.platform + 0.5 * self.limb * geometry.limbs
        return np.array((0.0, 0.0, 0.0, 0.0, 0.0, -carried * GRAVITY))


class CentreStatics(LeafSystem):
    """Forces with which clamped legs hold weight and drill.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose` | 6 | m, rad | of the platform |
    | in `feet` | 6n | m, rad | of the feet |
    | in `clamps_closed` | n | 0/1 | which feet are clamped |
    | in `tool_force` | 2 | N, N m | thrust along the platform's third axis, torque about it |
    | out `leg_force` | 2n | N | positive where a leg pushes; 0 of a loose limb |

    Of all forces that balance the load these are the smallest: of eight legs, or of four as far as
    they can.

    No state.

    Bad input: a posture that is not finite gives forces that are not finite.

    Args:
        geometry: the centre.
        masses: its masses.
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        masses: CentreMasses = CentreMasses(),
    ):
        super().__init__()
        self.set_name("statics")
        self._geometry, n = geometry, geometry.limbs
        self._weight = masses.weight(geometry)
        self._pose = self.DeclareVectorInputPort("pose", 6)
        self._feet = self.DeclareVectorInputPort("feet", 6 * n)
        self._clamps = self.DeclareVectorInputPort("clamps_closed", n)
        self._tool = self.DeclareVectorInputPort("tool_force", 2)
        self.DeclareVectorOutputPort(
            "leg_force",
            geometry.legs,
            self._calc,
            {p.ticket() for p in (self._pose, self._feet, self._clamps, self._tool)},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        pose, feet = read_batch(self._pose, context), read_batch(self._feet, context)
        tool = read_batch(self._tool, context)
        batch_shape = pose.shape[:-1]
        if not answer_of(np.isfinite(np.concatenate((pose, feet, tool), axis=-1)).all(axis=-1)):
            output.SetFromVector(np.full((*batch_shape, self._geometry.legs), np.nan))
            return
        out = Rotation.from_euler("xyz", pose[..., 3:]).as_matrix()[..., 2]
        wrench = self._weight + np.concatenate((tool[..., 1:] * out, tool[..., :1] * out), axis=-1)
        standing = np.repeat(read_batch(self._clamps, context) > 0.5, 2, axis=-1)
        rows = jacobian(self._geometry, pose, feet.reshape(*batch_shape, -1, 6))
        rows = rows * standing[..., np.newaxis]
        output.SetFromVector(-row_by_row(_smallest_forces, 2, rows, wrench))


def _smallest_forces(rows: Array, wrench: Array) -> Array:
    forces: Array = np.linalg.lstsq(rows.T, wrench, rcond=None)[0]
    return forces
