"""Force cells under the plate: what they show, and the foot's force from it.

Three cells bear the tread on the plate's carrier: two across it, towards the rear and the front
end, and one along it. The paper has no force sensing; places and masses are assumptions.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.batching import columns, stack
from parapod.systems.core.elementwise import Elementwise, both, is_finite, sin_cos, where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import has_value, read_array
from parapod.systems.core.vectors import Array


@dataclass(frozen=True)
class CellsGeometry:
    """Place of the cells, and the tread that they bear.

    Attributes:
        apart: distance of each of the two cells across the plate from its middle [m].
        mass: mass of the tread [kg].
        inertia: moment of inertia of the tread about its centre of mass [kg m^2].
        centre: its centre of mass along the plate and off it, from the plate's middle [m].
    """

    apart: float = 0.05
    mass: float = 0.6
    inertia: float = 0.000739998
    centre: tuple[float, float] = (0.0, -0.01)


def cell_forces(cells: CellsGeometry, load: ArrayLike) -> Array:
    """Forces (..., 3) of the cells, rear, front and along [N], under a load on the tread.

    Args:
        cells: their places.
        load: (..., 3) F_x', F_z', M_y at the plate's middle, in the plate's frame [N, N, N m].
    """
    ((f_x, f_z, m_y),), shape = columns((load, 3, "load"))
    by_moment = m_y / cells.apart
    return stack((0.5 * (-f_z - by_moment), 0.5 * (-f_z + by_moment), f_x), shape)


def load_of_cells(cells: CellsGeometry, force: ArrayLike) -> Array:
    """Load (..., 3) F_x', F_z', M_y on the tread, of which the cells show forces (..., 3)."""
    ((rear, front, along),), shape = columns((force, 3, "force"))
    return stack((along, -(rear + front), cells.apart * (front - rear)), shape)


def inertial_load(cells: CellsGeometry, motion: ArrayLike) -> Array:
    """Load (..., 3) on the cells by the tread's own weight and motion, in the plate's frame.

    Args:
        cells: the tread.
        motion: (..., 9) pose of the plate, its rates and the rates of these [m, rad, s].
    """
    ((_, _, phi, _, _, rate, ddx, ddz, ddphi),), shape = columns((motion, 9, "motion"))
    s, c = sin_cos(phi)
    ahead, above = cells.centre
    r_x, r_z = c * ahead + s * above, c * above - s * ahead
    # Acceleration of the centre of mass, less gravity.
    a_x = ddx + ddphi * r_z - rate * rate * r_x
    a_z = ddz - ddphi * r_x - rate * rate * r_z + GRAVITY
    f_x, f_z = -cells.mass * (c * a_x - s * a_z), -cells.mass * (s * a_x + c * a_z)
    m_y = -cells.inertia * ddphi + above * f_x - ahead * f_z
    return stack((f_x, f_z, m_y), shape)


class ForceCells(LeafSystem):
    """Force cells of a bench of rigid bodies.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `reaction_forces` | abstract | - | of the plant, at its joints |
    | in `noise` | 3 | - | unit white noise; unconnected: none |
    | out `force` | 3 | N | rear, front and along; to be sampled |

    State: none.

    Bad input: noise that is not finite is shown as it is.

    Args:
        cells: their places.
        joint: index of the joint by which the tread is fixed to the plate, whose frame is the
            plate's, with its origin in the pivot P.
        p_PO: (2) x, z of the plate's middle in that frame [m].
        deviation: standard deviation of each reading [N].
    """

    def __init__(
        self,
        cells: CellsGeometry = CellsGeometry(),
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
        _, m_y, _, f_x, _, f_z = bearing.get_coeffs().tolist()
        x, z = self._p_PO
        # What bears the tread is opposite to what loads it; its moment is about P.
        load = (-f_x, -f_z, z * f_x - x * f_z - m_y)
        readings = cell_forces(self._cells, load)
        if self._deviation and has_value(self._noise, context):
            readings = readings + self._deviation * read_array(self._noise, context)
        output.SetFromVector(readings)


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

    def __init__(self, cells: CellsGeometry = CellsGeometry()):
        super().__init__()
        self.set_name("foot_force")
        self._cells = cells
        self._force = self.DeclareVectorInputPort("force", 3)
        self._motion = self.DeclareVectorInputPort("plate_motion", 9)
        self.DeclareVectorOutputPort("load", 3, self._calc_load, {self.all_input_ports_ticket()})

    def _calc_load(self, context: Context, output: BasicVector) -> None:
        motion = read_array(self._motion, context)
        phi: Elementwise = motion.tolist()[2]
        load = load_of_cells(self._cells, read_array(self._force, context))
        f_x, f_z, m_y = (load - inertial_load(self._cells, motion)).tolist()
        s, c = sin_cos(phi)
        in_plate = (c * f_x + s * f_z, c * f_z - s * f_x, m_y)
        finite = reduce(both, map(is_finite, in_plate))
        output.SetFromVector(np.array([where(finite, part, 0.0) for part in in_plate]))
