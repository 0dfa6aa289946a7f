"""Dimensions of the walking chair (Table 1, Figures 3 and 4), of its legs and branches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

LEG_COUNT = 4


def by_legs(branches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (12) of the branches as those of each leg (4, 3), of one chair or a batch of them."""
    return branches.reshape(*branches.shape[:-1], LEG_COUNT, 3)


def _constant(values: object) -> NDArray[np.float64]:
    """An array that cannot be changed, as frozen dataclasses share theirs."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class LegGeometry:
    """One 2-UPS+UP leg; the defaults are the paper's Table 1.

    The frame {A1} has its origin where the UP branch hangs on the upper platform's face, z up, y
    from the UPS branches towards the UP branch, x from A2 to A3. The foot's frame {E1} has its
    origin at the corner E1 on the lower platform's face, and is parallel to {A1} while the leg
    hangs straight. Branches are numbered 1 (UP), 2 and 3 (UPS) everywhere.

    Attributes:
        a: side of the upper platform's equilateral triangle A1 A2 A3 [m].
        b: side of the lower platform's equilateral triangle E1 E2 E3 [m].
        t1: thickness t_1 of the upper platform [m].
        t2: thickness t_2 of the lower platform, between the corners E and the sole [m].
        d1: upper platform's face to connector 1, d_1 [m].
        d2: connecting hole of a universal joint to its centre, d_2 [m].
        d3: between the holes of connector 2, d_3 [m].
        d4: between the holes of connector 3, d_4 [m]; no distance between joints depends on it.
        d5: connector 4 to the lower platform's face, d_5 [m].
        d6: rotation joint of a UPS branch, d_6 [m].
        actuator_min: actuator's length (P joint) fully retracted [m].
        actuator_max: actuator's length fully extended [m].
        up_extra: length l_11 of the UP branch beyond its actuator's [m]. No sum of Table 1's
            sizes; it follows from the branch's printed range 591.4..891.4 mm.
    """

    a: float = 0.200
    b: float = 0.120
    t1: float = 0.010
    t2: float = 0.010
    d1: float = 0.021
    d2: float = 0.023
    d3: float = 0.025
    d4: float = 0.044
    d5: float = 0.020
    d6: float = 0.062
    actuator_min: float = 0.441
    actuator_max: float = 0.741
    up_extra: float = 0.1504

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{field.name} must be a positive length in m, not {value!r}")
        if not self.actuator_min < self.actuator_max:
            raise ValueError(
                f"actuator_min = {self.actuator_min:g} m must be less than "
                f"actuator_max = {self.actuator_max:g} m"
            )

    @property
    def stroke(self) -> float:
        """Way of an actuator between its ends [m]."""
        return self.actuator_max - self.actuator_min

    @property
    def x1(self) -> float:
        """x_1: from the upper platform's face down to the upper universal joints [m]."""
        return self.t1 + self.d1 + self.d2

    @property
    def x2(self) -> float:
        """x_2: from the lower platform's face up to the end of the UP branch, U_14 [m]."""
        return self.d5

    @property
    def x3(self) -> float:
        """x_3: from the lower platform's face up to the spherical joints U_15 and U_16 [m]."""
        return self.d2 + self.d5

    @property
    def ups_extra(self) -> float:
        """Length of a UPS branch beyond its actuator's [m]: 133 mm."""
        return 2.0 * self.d2 + self.d3 + self.d6

    @property
    def up_stroke(self) -> tuple[float, float]:
        """Smallest and largest length l_11 of the UP branch, between its joints' centres [m]."""
        return self.actuator_min + self.up_extra, self.actuator_max + self.up_extra

    @property
    def ups_stroke(self) -> tuple[float, float]:
        """Smallest and largest length l_12, l_13 of the UPS branches, between centres [m]."""
        return self.actuator_min + self.ups_extra, self.actuator_max + self.ups_extra

    @property
    def size(self) -> float:
        """Stroke of an actuator by that of the paper's [-]."""
        return self.stroke / (LegGeometry.actuator_max - LegGeometry.actuator_min)

    @property
    def retracted_height(self) -> float:
        """H_0: the upper platform's face above the foot's, the leg straight and retracted [m].

        The UP branch is at its end, or the two others are before.
        """
        aside = min(self.a - self.b, self.ups_stroke[0])
        below = math.sqrt(self.ups_stroke[0] ** 2 - aside**2)
        return self.x1 + max(self.up_stroke[0] + self.x2, below + self.x3)

    @cached_property
    def strokes(self) -> NDArray[np.float64]:
        """(3, 2) smallest and largest length of the branches UP, UPS, UPS [m]."""
        return _constant((self.up_stroke, self.ups_stroke, self.ups_stroke))

    @cached_property
    def upper_joints(self) -> NDArray[np.float64]:
        """(3, 3) centres U_11, U_12, U_13 of the upper universal joints in {A1} [m], Eq. (2)."""
        return _constant(_triangle(self.a, -self.x1, -self.x1))

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """(3, 3) corners E_1, E_2, E_3 of the lower platform in {E1} [m], Eq. (3)."""
        return _constant(_triangle(self.b, 0.0, 0.0))

    @cached_property
    def lower_joints(self) -> NDArray[np.float64]:
        """(3, 3) lower ends U_14, U_15, U_16 of the branches in {E1} [m], Eq. (4)."""
        return _constant(_triangle(self.b, self.x2, self.x3))


def _triangle(side: float, z_first: float, z_others: float) -> list[list[float]]:
    """Corners of an equilateral triangle, the first at x = y = 0 and the others at -y."""
    half, height = 0.5 * side, 0.5 * math.sqrt(3.0) * side
    return [[0.0, 0.0, z_first], [-half, -height, z_others], [half, -height, z_others]]


@dataclass(frozen=True)
class LegPlacement:
    """Place of an upper platform's centroid (the paper's frame {n}) on the connection plate.

    Attributes:
        x: to the right of the body's centre S [m].
        y: ahead of S [m].
        turned: true if the leg is turned by half a turn about z, so that its UP branch is the
            rearmost; otherwise it is the foremost. No other angle makes branches 2 and 3 of each
            leg move alike, as the paper's do.
    """

    x: float
    y: float
    turned: bool

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x) and math.isfinite(self.y)):
            raise ValueError(f"a leg cannot be placed at x = {self.x!r}, y = {self.y!r}")


# Assumed: the arrangement itself is in a figure alone. The text gives the values c_1 = c_3 = 155
# mm and c_2 = c_4 = 142.3 mm, taken here across and along to the centroids, and the symmetry of
# legs 1 and 4 and of 2 and 3, which puts each pair on one side, turned against each other. With
# the UP branches inwards the feet of one side would run into each other.
ASSUMED_PLACEMENTS = (
    LegPlacement(x=-0.155, y=-0.1423, turned=True),
    LegPlacement(x=0.155, y=-0.1423, turned=True),
    LegPlacement(x=0.155, y=0.1423, turned=False),
    LegPlacement(x=-0.155, y=0.1423, turned=False),
)


@dataclass(frozen=True)
class ChairGeometry:
    """The whole chair.

    The body's frame {S} has its origin S in the plane of the upper platforms' faces, in the middle
    of the legs, x to the right, y ahead, z up. Lengths of the branches depend on the legs'
    directions alone, so the assumed places matter to stability and not to kinematics.

    Attributes:
        leg: the legs, which are equal.
        placements: placements of the four legs, in the paper's order 1..4; assumed, not printed.
        seat_height: height of the seat above S [m] (assumption).
    """

    leg: LegGeometry = LegGeometry()
    placements: tuple[LegPlacement, ...] = ASSUMED_PLACEMENTS
    seat_height: float = 0.198

    def __post_init__(self) -> None:
        if len(self.placements) != LEG_COUNT:
            raise ValueError(f"placements must be {LEG_COUNT}, not {len(self.placements)}")
        if not (math.isfinite(self.seat_height) and self.seat_height > 0.0):
            raise ValueError(f"seat_height must be positive, not {self.seat_height!r}")

    @cached_property
    def R_SA(self) -> NDArray[np.float64]:
        """(4, 3, 3) rotations of the legs' frames {A1} in the body's frame {S}."""
        signs = [-1.0 if placement.turned else 1.0 for placement in self.placements]
        return _constant([np.diag((sign, sign, 1.0)) for sign in signs])

    @cached_property
    def p_SA(self) -> NDArray[np.float64]:
        """(4, 3) origins A_1 of the legs' frames, from S in {S} [m]."""
        to_hinge = np.array((0.0, self.leg.a / math.sqrt(3.0), 0.0))
        centroids = np.array([(place.x, place.y, 0.0) for place in self.placements])
        return _constant(centroids + self.R_SA @ to_hinge)


# Branches of a leg: the UP branch, and the two UPS branches.
BRANCHES_OF_LEG = (1, 2, 3)
LEGS = tuple(range(1, LEG_COUNT + 1))


def branch_names(legs: Sequence[int] = LEGS) -> tuple[str, ...]:
    """Names as in "branch 12" (leg 1, first UPS branch) of the legs' branches, leg by leg."""
    return tuple(f"branch {leg}{branch}" for leg in legs for branch in BRANCHES_OF_LEG)


BRANCHES = branch_names()
