"""Dimensions of the machining centres (Figures 5 and 11, Section VI-D), and of others alike."""

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

LIMB_COUNTS = (3, 4, 5, 6)
_USUAL_HALF_ANGLE = math.pi / 4.0  # theta of Section VI-D [rad]
LEGS_OF_LIMB = ("left", "right")


@dataclass(frozen=True)
class CentreGeometry:
    """A centre of three to six limbs; the defaults are the paper's tripod, and assumptions.

    The platform's frame {P} has its origin P_O in the middle of the pivots, its first axis to the
    limb 1, its third away from the feet. A limb is two legs, prismatic actuators, from two pivots
    P_L and P_R of the platform to one foot A. Seen from above the left pivot is clockwise of the
    limb's middle: with the other order the joints' zeros of the paper's Figure 6 do not come out.

    Attributes:
        limbs: 3 for the tripod, 4 for the quadruped; 5 or 6.
        platform_radius: radius r_p of the circle of the pivots [m].
        half_angle: angle theta from a limb's middle to its pivots [rad]; None: pi / 4, or as much
            as there is room for.
        pattern_radius: radius r_pattern of the circle on which the feet stand at home [m].
        stroke_min: shortest leg, between pivot and foot [m].
        stroke_max: longest leg [m].
        tool_length: distance from P_O to the drill's tip, along the third axis backwards [m].
        foot_height: height of an ankle's centre, the origin of {A}, above what it stands on [m].
        foot_diameter: diameter of a foot's plate [m].
    """

    limbs: int = 3
    platform_radius: float = 0.1
    half_angle: float = None  # type: ignore[assignment]  # filled in below
    pattern_radius: float = 0.18
    stroke_min: float = 0.39
    stroke_max: float = 0.65
    tool_length: float = 0.48
    foot_height: float = 0.042
    foot_diameter: float = 0.1

    def __post_init__(self) -> None:
        if self.limbs not in LIMB_COUNTS:
            counts = ", ".join(map(str, LIMB_COUNTS))
            raise ValueError(
                f"limbs must be one of {counts} (3 the tripod, 4 the quadruped), not "
                f"{self.limbs!r}"
            )
        if self.half_angle is None:
            widest = min(_USUAL_HALF_ANGLE, math.pi / self.limbs)
            object.__setattr__(self, "half_angle", widest)
        for field in fields(self)[1:]:
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{field.name} must be positive and finite, not {value!r}")
        if self.half_angle > (1.0 + 1e-12) * math.pi / self.limbs:
            raise ValueError(
                f"half_angle = {self.half_angle:g} rad must be at most pi / limbs = "
                f"{math.pi / self.limbs:g} rad: pivots of neighbouring limbs would change places"
            )
        if not self.stroke_min < self.stroke_max:
            raise ValueError(
                f"stroke_min = {self.stroke_min:g} m must be less than "
                f"stroke_max = {self.stroke_max:g} m"
            )

    @property
    def size(self) -> float:
        """Mean length of a leg by that of the paper's centre [-]."""
        usual: type[CentreGeometry] = CentreGeometry
        return (self.stroke_min + self.stroke_max) / (usual.stroke_min + usual.stroke_max)

    @property
    def legs(self) -> int:
        """Number of legs: two a limb."""
        return 2 * self.limbs

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """(n) directions psi_i of the limbs, about the third axis from the first one [rad]."""
        turn = 2.0 * math.pi / self.limbs
        return _constant(np.array([turn * i for i in range(self.limbs)]))

    @cached_property
    def pivots(self) -> NDArray[np.float64]:
        """(2n, 3) pivots P_L1, P_R1, P_L2, ... in {P} [m]."""
        angles = self.angles[:, None] + np.array((-self.half_angle, self.half_angle))
        return _constant(self.platform_radius * _directions(angles.ravel()))

    @cached_property
    def middles(self) -> NDArray[np.float64]:
        """(n, 3) middles P_C of the pivots of each limb in {P} [m]."""
        return _constant(0.5 * (self.pivots[0::2] + self.pivots[1::2]))

    @cached_property
    def footholds(self) -> NDArray[np.float64]:
        """(n, 6) poses of the feet's frames {A} at home: first axis outwards, third axis up.

        Four limbs' fourth direction is 3 pi / 2; angles are not wrapped.
        """
        zeros = np.zeros((self.limbs, 3))
        poses = np.hstack((self.pattern_radius * _directions(self.angles), zeros))
        poses[:, 5] = self.angles
        return _constant(poses)


def leg_name(leg: int) -> str:
    """A leg's name, as in "left leg of limb 2".

    Args:
        leg: its index among the legs, from 0.
    """
    return f"{LEGS_OF_LIMB[leg % 2]} leg of limb {leg // 2 + 1}"


def _constant(values: NDArray[np.float64]) -> NDArray[np.float64]:
    values.setflags(write=False)
    return values


def _directions(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)), axis=-1)
