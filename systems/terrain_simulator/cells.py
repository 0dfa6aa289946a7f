"""Force cells under the plate: what they show, and what that tells of the foot's force.

Three cells bear the tread on the plate's carrier: two across it, towards the rear and the front
end, and one along it. The paper has no force sensing; places and masses are assumptions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.support import GRAVITY


@dataclass(frozen=True)
class CellsGeometry:
    """Place of the cells, and the tread that they bear.

    Attributes:
        apart: distance of each of the two cells across the plate from its middle [m].
        mass: mass of the tread [kg].
        inertia: moment of inertia of the tread about its centre of mass [kg m^2].
        below: depth of its centre of mass below the plate's middle [m].
    """

    apart: float
    mass: float
    inertia: float
    below: float


# Cells and tread of each configuration, as `parapod.urdf.terrain_simulator` has them.
CELLS = {
    "pedal": CellsGeometry(0.05, 0.6, 0.00073999800, 0.01),
    "treadmill": CellsGeometry(0.25, 7.0, 0.211458625, 0.025),
}


def cell_forces(cells: CellsGeometry, load: Array) -> Array:
    """Forces (..., 3) of the cells, rear, front and along [N], under a load on the tread.

    Args:
        cells: their places.
        load: (..., 3) F_x', F_z', M_y at the plate's middle, in the plate's frame [N, N, N m].
    """
    f_x, f_z, m_y = np.moveaxis(np.asarray(load), -1, 0)
    turned = m_y / cells.apart
    return np.stack((0.5 * (-f_z - turned), 0.5 * (-f_z + turned), f_x), axis=-1)


def load_of_cells(cells: CellsGeometry, force: Array) -> Array:
    """Load (..., 3) F_x', F_z', M_y on the tread, of which the cells show forces (..., 3)."""
    rear, front, along = np.moveaxis(np.asarray(force), -1, 0)
    return np.stack((along, -(rear + front), cells.apart * (front - rear)), axis=-1)


def inertial_load(cells: CellsGeometry, motion: Array) -> Array:
    """Load (..., 3) on the cells by the tread's own weight and motion, in the plate's frame.

    Args:
        cells: the tread.
        motion: (..., 9) pose of the plate, its rates and the rates of these [m, rad, s].
    """
    phi, rate = motion[..., 2], motion[..., 5]
    ddx, ddz, ddphi = np.moveaxis(motion[..., 6:], -1, 0)
    s, c = np.sin(phi), np.cos(phi)
    # Acceleration of the centre of mass, which is below O', less gravity.
    a_x = ddx - cells.below * (c * ddphi - s * rate**2)
    a_z = ddz + cells.below * (s * ddphi + c * rate**2) + GRAVITY
    f_x, f_z = -cells.mass * (c * a_x - s * a_z), -cells.mass * (s * a_x + c * a_z)
    return np.stack((f_x, f_z, -cells.inertia * ddphi - cells.below * f_x), axis=-1)


class ForceCells(LeafSystem):
    """Force cells of a bench of rigid bodies.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `reaction_forces` | abstract | - | of the plant, at its joints |
    | in `noise` | 3 | - | unit white noise; unconnected: none |
    | out `force` | 3 | N | rear, front and along; to be sampled |

    State: none.

    Bad input: noise that is no number is shown as it is.

    Args:
        cells: their places.
        joint: index of the joint by which the tread is fixed to the plate, whose frame is the
            plate's, with its origin in the pivot P.
        p_PO: (2) x, z of the plate's middle in that frame [m].
        deviation: standard deviation of each reading [N].
    """

    def __init__(
        self,
        cells: CellsGeometry = CELLS["pedal"],
        joint: int = 0,
        p_PO: tuple[float, float] = (0.0, 0.0),
        deviation: float = 0.0,
    ):
        super().__init__()
        self.set_name("force_cells")
        self._cells, self._joint, self._p_PO, self._deviation = cells, joint, p_PO, deviation
        self._forces = self.DeclareAbstractInputPort(
            "reaction_forces", Value[list[SpatialForce]]([])
        )
        self._noise = self.DeclareVectorInputPort("noise", 3)
        self.DeclareVectorOutputPort(
            "force", 3, self._calc_force, {self._forces.ticket(), self._noise.ticket()}
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        forces: Any = self._forces.Eval(context)
        bearing = forces[self._joint]
        (f_x, _, f_z), m_y = bearing.translational(), bearing.rotational()[1]
        x, z = self._p_PO
        # What bears the tread is opposite to what loads it; its moment is told about P.
        load = -np.array((f_x, f_z, m_y - (z * f_x - x * f_z)))
        shown = cell_forces(self._cells, load)
        if self._deviation and self._noise.HasValue(context):
            shown = shown + self._deviation * read_array(self._noise, context)
        output.SetFromVector(shown)


class FootForce(LeafSystem):
    """Force of the foot on the plate, as the cells tell it.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `force` | 3 | N | of the cells: rear, front and along |
    | in `plate_motion` | 9 | m, rad, s | pose of the plate, its rates, and the rates of these |
    | out `load` | 3 | N, N, N m | F_x, F_z, M_y on the plate at its middle, in the base frame |

    The weight of the tread, and the forces of its own motion, are taken off: the motion that the
    plate is led through tells them, which it follows to a tenth of a millimetre.

    State: none.

    Bad input: with a number that is not finite the load is zero.

    Args:
        cells: their places, and the tread.
    """

    def __init__(self, cells: CellsGeometry = CELLS["pedal"]):
        super().__init__()
        self.set_name("foot_force")
        self._cells = cells
        self._force = self.DeclareVectorInputPort("force", 3)
        self._motion = self.DeclareVectorInputPort("plate_motion", 9)
        self.DeclareVectorOutputPort("load", 3, self._calc_load, {self.all_input_ports_ticket()})

    def _calc_load(self, context: Context, output: BasicVector) -> None:
        motion = read_array(self._motion, context)
        load = load_of_cells(self._cells, read_array(self._force, context))
        load = load - inertial_load(self._cells, motion)
        s, c = np.sin(motion[2]), np.cos(motion[2])
        f_x, f_z, m_y = load
        turned = np.array((c * f_x + s * f_z, c * f_z - s * f_x, m_y))
        output.SetFromVector(turned if np.isfinite(turned).all() else np.zeros(3))
