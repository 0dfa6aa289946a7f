"""Dimensions of the levelling platform (Tables 1 and 2) and of each of its legs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

LEG_COUNT = 4
ACTIVE_LEGS = (0, 1, 2)  # legs 1 to 3; leg 4 is passive
# From the platform's centre F to the base of the arm, on the turntable's axis [m]. Not printed, as
# Eq. (13) is lost: the round value that fits the paper's surfaces of the workspace.
ARM_BASE = (0.0, 0.020, 0.145)


@dataclass(frozen=True)
class LegGeometry:
    """One leg: where its hip is, and the parallelogram whose diagonal is the actuator.

    Attributes:
        l_x: x of the vector P_E^F from the hip E to the platform's centre F [m].
        l_y: y of P_E^F [m].
        l_z: z of P_E^F [m].
        beta: yaw of the leg's frame D in the platform's frame [rad].
        l_3: short side of the parallelogram [m].
        l_4: long side of the parallelogram [m].
        l_6: coupler from the parallelogram to the foot's column [m].
        l_7: foot's column [m].
        alpha: inclination of the parallelogram's short side [rad].
        foot_radius: radius of the foot's roller [m]; 0 for the paper's point foot.
        extension_min: smallest extension of the stroke used on the ground [m].
        extension_max: largest extension of the stroke used on the ground [m].
    """

    l_x: float
    l_y: float
    l_z: float
    beta: float
    l_3: float
    l_4: float
    l_6: float
    l_7: float
    alpha: float
    foot_radius: float
    extension_min: float
    extension_max: float

    @cached_property
    def e_a(self) -> tuple[float, float]:
        """(cos alpha, sin alpha): direction of the parallelogram's short side."""
        return math.cos(self.alpha), math.sin(self.alpha)

    @cached_property
    def e_b(self) -> tuple[float, float]:
        """(cos beta, sin beta): direction of the leg's x axis in the platform's xy plane."""
        return math.cos(self.beta), math.sin(self.beta)

    @cached_property
    def p_MF(self) -> tuple[float, float, float]:
        """Vector to F from the point that the foot would take if the long side had no length.

        The foot's position is this constant plus the long side turned by psi, which is what
        makes the inverse kinematics a single linear trigonometric equation.
        """
        ca, sa = self.e_a
        cb, sb = self.e_b
        return (
            self.l_x + cb * self.l_6 * ca,
            self.l_y + sb * self.l_6 * ca,
            self.l_z + (self.l_7 - self.foot_radius) + self.l_6 * sa,
        )

    @cached_property
    def constants(self) -> tuple[float, ...]:
        """Constants of the parallelogram, to be unpacked in one go.

        e_a (2), l_3 [m], l_4^2, l_3^2 - l_4^2 and l_3^2 + l_4^2 [m^2].
        """
        l_3, l_3_squared, l_4_squared = self.l_3, self.l_3 * self.l_3, self.l_4 * self.l_4
        sums = l_4_squared, l_3_squared - l_4_squared, l_3_squared + l_4_squared
        return (*self.e_a, l_3, *sums)


@dataclass(frozen=True)
class LegDeviation:
    """Difference of one leg as built from its drawing; each is added to the field of that name.

    The parallelogram stays one: opposite sides differ by the same amount.

    Attributes:
        l_x: [m].
        l_y: [m].
        l_z: [m].
        beta: [rad].
        l_3: [m].
        l_4: [m].
        l_6: [m].
        l_7: [m].
        alpha: [rad].
    """

    l_x: float = 0.0
    l_y: float = 0.0
    l_z: float = 0.0
    beta: float = 0.0
    l_3: float = 0.0
    l_4: float = 0.0
    l_6: float = 0.0
    l_7: float = 0.0
    alpha: float = 0.0


# Names of a leg's dimensions, in the order of `LegDeviation`'s fields, and which are angles.
DIMENSIONS = tuple(field.name for field in fields(LegDeviation))
ANGLES = ("beta", "alpha")


@dataclass(frozen=True)
class PlatformGeometry:
    """The whole platform; the defaults are the paper's Tables 1 and 2.

    Attributes:
        l_c1: half distance of the hips along x [m].
        l_c2: half distance of the hips along y [m].
        l_c3: height of the platform's centre F above the hips [m].
        l_3: short sides l_2 = l_3 of the parallelogram [m].
        l_4: long sides l_4 = l_5 of the parallelogram [m].
        l_6: coupler from the parallelogram to the foot's column [m].
        l_7: foot's column [m].
        alpha: inclination of the parallelogram's short sides [rad].
        beta: yaw of the legs [rad].
        foot_radius: radius of the foot's rollers [m]; the paper's model has points, 0.
        extension_min: smallest extension of the actuators on the ground (highest pose) [m].
        extension_max: largest extension on the ground (the wheels touch) [m].
        own_legs: legs that are not alike (4), as drawn; empty: the dimensions above hold for all.
        deviations: deviations of each leg from its drawing (4); empty for legs as drawn.
    """

    l_c1: float = 0.400
    l_c2: float = 0.170
    l_c3: float = 0.113
    l_3: float = 0.080
    l_4: float = 0.440
    l_6: float = 0.165
    l_7: float = 0.205
    alpha: float = math.radians(61.0)
    beta: float = math.radians(49.0)
    foot_radius: float = 0.0
    extension_min: float = 0.390
    extension_max: float = 0.420
    own_legs: tuple[LegGeometry, ...] = ()
    deviations: tuple[LegDeviation, ...] = ()

    def __post_init__(self) -> None:
        for name in ("deviations", "own_legs"):
            count = len(getattr(self, name))
            if count not in (0, LEG_COUNT):
                raise ValueError(f"{name} must be 0 or {LEG_COUNT}, not {count}")
        if not self.extension_min < self.extension_max:
            raise ValueError(
                f"extension_min = {self.extension_min:g} m must be less than "
                f"extension_max = {self.extension_max:g} m"
            )

    @cached_property
    def legs(self) -> tuple[LegGeometry, ...]:
        """The four legs as built, in the paper's order: Table 2 and the angles beta_i."""
        if not self.deviations:
            return self.drawn_legs
        legs = zip(self.drawn_legs, self.deviations, strict=True)
        return tuple(
            replace(leg, **{name: getattr(leg, name) + getattr(own, name) for name in DIMENSIONS})
            for leg, own in legs
        )

    def on_points(self) -> "PlatformGeometry":
        """The same platform on point feet, as in the paper's model."""
        legs = tuple(replace(leg, foot_radius=0.0) for leg in self.own_legs)
        return replace(self, foot_radius=0.0, own_legs=legs)

    def with_stroke(self, stroke: tuple[float, float]) -> "PlatformGeometry":
        """The same platform, its actuators used from end to end.

        Args:
            stroke: smallest and largest extension [m].
        """
        low, high = stroke
        legs = tuple(replace(leg, extension_min=low, extension_max=high) for leg in self.own_legs)
        return replace(self, extension_min=low, extension_max=high, own_legs=legs)

    @cached_property
    def drawn_legs(self) -> tuple[LegGeometry, ...]:
        """The four legs without their deviations."""
        if self.own_legs:
            return self.own_legs
        quadrants = (
            (1.0, -1.0, -self.beta),
            (1.0, 1.0, self.beta),
            (-1.0, 1.0, math.pi - self.beta),
            (-1.0, -1.0, math.pi + self.beta),
        )
        return tuple(
            LegGeometry(
                l_x=sign_x * self.l_c1,
                l_y=sign_y * self.l_c2,
                l_z=self.l_c3,
                beta=beta,
                l_3=self.l_3,
                l_4=self.l_4,
                l_6=self.l_6,
                l_7=self.l_7,
                alpha=self.alpha,
                foot_radius=self.foot_radius,
                extension_min=self.extension_min,
                extension_max=self.extension_max,
            )
            for sign_x, sign_y, beta in quadrants
        )


def three_legs(legs: Sequence[int]) -> tuple[int, ...]:
    """These indices 0..3 of three legs, checked.

    Raises:
        ValueError: not three different legs.
    """
    chosen = tuple(int(leg) for leg in legs)
    if len(chosen) != 3 or len(set(chosen)) != 3 or not set(chosen) <= set(range(LEG_COUNT)):
        raise ValueError(f"legs must be three different indices out of 0, 1, 2, 3, not {legs}")
    return chosen


def drawn_deviations(
    random: np.random.Generator, length: float, angle: float
) -> tuple[LegDeviation, ...]:
    """Deviations (4) of which each dimension is uniform within a tolerance.

    Args:
        random: generator from which they are drawn.
        length: tolerance of the lengths, either way [m].
        angle: tolerance of the angles, either way [rad].
    """
    tolerance = np.array([angle if name in ANGLES else length for name in DIMENSIONS])
    deviations = tolerance * random.uniform(-1.0, 1.0, (LEG_COUNT, len(DIMENSIONS)))
    return tuple(LegDeviation(*row) for row in deviations.tolist())
