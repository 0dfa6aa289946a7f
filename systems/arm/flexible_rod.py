"""A slender rod with a mass at its tip, clamped at its base: modes, masses of modes, sag.

The rod is an Euler-Bernoulli beam of constant section that bends in two planes. With z from the
clamp along the straight rod, its deflection in a plane is a sum of mode shapes,

    w(z, t) = sum_k phi_k(z) q_k(t),

those of a clamped beam with a point mass at its free end, without gravity. Their wave numbers
lambda_k solve

    1 + cos l cosh l + (M / m) l (cos l sinh l - sin l cosh l) = 0,  l = lambda,

with the rod's mass m and the tip's M (Meirovitch, Fundamentals of Vibrations, 2001, section 8.3),
and omega_k = lambda_k^2 sqrt(B / (m L^3)) with the bending stiffness B = E I. Shapes are
normalised to modal masses of one: the integral of phi_j phi_k over all mass is 1 for j = k and 0
otherwise, and that of B phi_j'' phi_k'' is omega_k^2 or 0.

What accelerates the clamp loads the modes by their participations: the integrals of phi_k and of
z phi_k over all mass. What a sum of few modes leaves out of the deflection under a load that
changes slowly is `residual`. A load along the rod, such as the weight of an upright one, softens
it: `softening` is the integral of P phi_j' phi_k', where P is the mass beyond z.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq  # type: ignore[import-untyped]

from parapod.systems.core.elementwise import Elementwise
from parapod.systems.core.vectors import Array

# Modes a plane at most: shapes of higher ones lose digits to hyperbolic functions.
MOST_MODES = 3
# Nodes of the quadrature along the rod: exact to the last digits for that many modes.
_NODES = 48
# End of the first mode's bracket: beyond the wave number of a rod without a tip mass, 1.8751.
_FIRST = 1.88
_POSITIVE = ("length", "mass", "tip_mass", "bending_stiffness")


class Sag(NamedTuple):
    """Displacement of the tip in a plane of the rod, at rest under a load.

    Attributes:
        across: across the rod [m].
        slope: turn of the tip [rad].
        along: towards the clamp, as the rod keeps its length [m].
    """

    across: Elementwise
    slope: Elementwise
    along: Elementwise


@dataclass(frozen=True)
class FlexibleRod:
    """A clamped rod with a point mass at its tip; the defaults are the paper's arm.

    Length, mass and what the tip carries are those of sections 4, 5 and 7; the stiffness is that
    of a carbon tube of 20 and 17.2 mm, and the damping ratio is small: assumptions.

    Attributes:
        length: distance from clamp to tip [m].
        mass: mass of the rod, spread evenly [kg].
        tip_mass: mass of the point at its tip [kg].
        bending_stiffness: E I for bending in the plane of x and in that of y [N m^2].
        damping_ratio: damping ratio of every mode [-].
        modes: number n of modes in each plane, 1 to 3.
    """

    length: float = 2.02
    mass: float = 0.27
    tip_mass: float = 0.73
    bending_stiffness: tuple[float, float] = (430.0, 430.0)
    damping_ratio: float = 0.005
    modes: int = 2

    def __post_init__(self) -> None:
        """Refuses what no rod has.

        Raises:
            ValueError: names the attribute, and the admissible values.
        """
        for name in _POSITIVE:
            least = np.min(getattr(self, name))
            if not (least > 0.0 or (name == "tip_mass" and least == 0.0)):
                raise ValueError(f"{name} = {getattr(self, name)} must be above 0")
        if not 0.0 <= self.damping_ratio < 1.0:
            raise ValueError(f"damping_ratio = {self.damping_ratio} must be 0 or more, below 1")
        if self.modes not in range(1, MOST_MODES + 1):
            raise ValueError(f"modes = {self.modes} must be 1 to {MOST_MODES}")

    @cached_property
    def wave_numbers(self) -> Array:
        """The numbers lambda_k (n) [-]."""
        ratio = self.tip_mass / self.mass

        def condition(x: float) -> float:
            # By cosh x, so that it does not grow.
            hyperbolic, by_cosh = math.tanh(x), 1.0 / math.cosh(x)
            return by_cosh + math.cos(x) + ratio * x * (math.cos(x) * hyperbolic - math.sin(x))

        # Each is between that of a pinned tip, no mass moves that, and that of a free one.
        brackets = [(1e-9, _FIRST)]
        brackets += [(k * math.pi, (k + 0.55) * math.pi) for k in range(1, self.modes)]
        return np.array([brentq(condition, *ends, xtol=1e-15, rtol=1e-15) for ends in brackets])

    @cached_property
    def frequencies(self) -> Array:
        """Angular frequencies omega_k (2, n) in the planes of x and y, undamped [rad/s]."""
        stiffness = np.array(self.bending_stiffness)[:, np.newaxis]
        return self.wave_numbers**2 * np.sqrt(stiffness / (self.mass * self.length**3))

    def loaded_frequencies(self, along: float) -> Array:
        """Angular frequencies (2, n) of the rod under a constant load along it [rad/s].

        Args:
            along: component of the specific force along the rod, 9.81 for an upright one [m/s^2].
        """
        stiffness = [np.diag(omega**2) - along * self.softening for omega in self.frequencies]
        loaded: Array = np.sqrt(np.linalg.eigvalsh(stiffness))
        return loaded

    def shape(self, z: ArrayLike) -> Array:
        """Mode shapes phi_k (..., n) [1/sqrt(kg)] at places along the rod (...) [m]."""
        return self._scale * self._curve(z, 0)

    def slope(self, z: ArrayLike) -> Array:
        """Their derivatives (..., n) by z [1/(m sqrt(kg))]."""
        return self._scale * self._curve(z, 1) * self.wave_numbers / self.length

    @cached_property
    def translation(self) -> Array:
        """Participation of the modes (n) in a translation of the clamp across [sqrt(kg)]."""
        return self._over_mass(self.shape)

    @cached_property
    def rotation(self) -> Array:
        """Participation of the modes (n) in a rotation about the clamp [m sqrt(kg)]."""
        return self._over_mass(lambda z: z[..., np.newaxis] * self.shape(z))

    @cached_property
    def softening(self) -> Array:
        """Stiffness (n, n) that an acceleration along the rod takes away [1/m].

        It is that per m/s^2 of the specific force along z, as gravity has it on an upright rod.
        """
        per_length = self.mass / self.length
        return self._over_slopes(lambda z: self.tip_mass + per_length * (self.length - z))

    @cached_property
    def stiffening(self) -> Array:
        """Stiffness (n, n) by the square of a rate of rotation about an axis across [-]."""
        long, per_length = self.length, self.mass / self.length
        return self._over_slopes(
            lambda z: self.tip_mass * long + 0.5 * per_length * (long**2 - z**2)
        )

    @cached_property
    def shortening(self) -> Array:
        """Matrix N (n, n) of the tip's way towards the clamp, q^T N q / 2 [1/(m kg)]."""
        return self._over_slopes(np.ones_like)

    @cached_property
    def residual(self) -> Array:
        """Static displacement (2, 2, 2) that the modes leave out.

        For the planes of x and y: rows for deflection [m] and slope [rad] of the tip, columns
        for a unit of acceleration across [m/s^2] and of angular acceleration [rad/s^2].
        """
        m, tip, long = self.mass / self.length, self.tip_mass, self.length
        whole = -np.array(
            [
                [tip * long**3 / 3 + m * long**4 / 8, tip * long**4 / 3 + 11 * m * long**5 / 120],
                [tip * long**2 / 2 + m * long**3 / 6, tip * long**3 / 2 + m * long**4 / 8],
            ]
        )
        at_tip = np.stack([self.shape(self.length), self.slope(self.length)])
        loads = np.stack([self.translation, self.rotation])
        return np.stack(
            [
                whole / stiffness + (at_tip / omega**2) @ loads.T
                for stiffness, omega in zip(self.bending_stiffness, self.frequencies, strict=True)
            ]
        )

    @cached_property
    def tip_residual(self) -> Array:
        """Static deflection [m] and slope [rad] that modes leave out (2, 2), by a tip's force.

        Rows for the planes of x and y; for a unit of force across at the tip [N].
        """
        long = self.length
        at_tip = np.stack([self.shape(long), self.slope(long)])
        return np.stack(
            [
                np.array([long**3 / 3.0, long**2 / 2.0]) / stiffness
                - (at_tip / omega**2) @ self.shape(long)
                for stiffness, omega in zip(self.bending_stiffness, self.frequencies, strict=True)
            ]
        )

    def coordinates_from(self, other: "FlexibleRod") -> Array:
        """Matrix (n, n) to coordinates of this rod's modes from those of another.

        Both have one length and one distribution of mass but at the tip; deflections are alike in
        the mean over this rod's mass.

        Args:
            other: the other rod.
        """
        size = (self.modes, other.modes)
        both = self._over_mass(
            lambda z: (
                self.shape(z)[..., :, np.newaxis] * other.shape(z)[..., np.newaxis, :]
            ).reshape(*np.shape(z), -1)
        )
        return both.reshape(size)

    def rest(self, across: float, along: float, plane: int) -> Array:
        """Modal coordinates (n) at rest under a constant specific force.

        Args:
            across: its component across the rod in the plane [m/s^2].
            along: its component along the rod, 9.81 for an upright one [m/s^2].
            plane: 0 for bending in the plane of x, 1 for that of y.
        """
        stiffness = np.diag(self.frequencies[plane] ** 2) - along * self.softening
        return np.linalg.solve(stiffness, -across * self.translation)

    def sag(self, across: Elementwise, along: Elementwise, plane: int = 0) -> Sag:
        """Displacement of the tip at rest, in closed form and elementwise.

        The pencil of stiffness and softening is diagonal in coordinates of its own, in which a
        load along the rod scales each term.

        Args:
            across: component of the specific force across the rod in the plane [m/s^2].
            along: its component along the rod, 9.81 for an upright one [m/s^2].
            plane: 0 for bending in the plane of x, 1 for that of y.
        """
        softnesses, loads, tips, slopes, shortening = self._pencils[plane]
        terms = [
            -across * load / (1.0 - along * softness)
            for softness, load in zip(softnesses, loads, strict=True)
        ]
        deflection, turn = self.residual[plane, :, 0].tolist()
        w, slope, short = across * deflection, across * turn, 0.0
        for i, term in enumerate(terms):
            w, slope = w + tips[i] * term, slope + slopes[i] * term
            for j, other in enumerate(terms):
                short = short + 0.5 * shortening[i][j] * term * other
        return Sag(w, slope, short)

    @cached_property
    def buckling(self) -> float:
        """Acceleration along the rod at which it buckles [m/s^2]; gravity's must be below it."""
        return 1.0 / max(max(softnesses) for softnesses, *_ in self._pencils)

    @cached_property
    def _pencils(self) -> list[tuple[list[float], list[float], list[float], list[float], list]]:
        """For each plane softness, load, tip's deflection and slope, shortening of its terms."""
        pencils = []
        for omega in self.frequencies:
            by_omega = np.diag(1.0 / omega)
            softness, turned = np.linalg.eigh(by_omega @ self.softening @ by_omega)
            basis = by_omega @ turned  # q = basis @ terms, of unit stiffness
            pencils.append(
                tuple(
                    part.tolist()
                    for part in (
                        softness,
                        basis.T @ self.translation,
                        basis.T @ self.shape(self.length),
                        basis.T @ self.slope(self.length),
                        basis.T @ self.shortening @ basis,
                    )
                )
            )
        return pencils

    def _curve(self, z: ArrayLike, derivative: int) -> Array:
        """Shapes (..., n) of any size, or their derivative by lambda z / L."""
        numbers = self.wave_numbers
        x = np.asarray(z, dtype=float)[..., np.newaxis] / self.length * numbers
        ratio = (np.cosh(numbers) + np.cos(numbers)) / (np.sinh(numbers) + np.sin(numbers))
        if derivative:
            return np.sinh(x) + np.sin(x) - ratio * (np.cosh(x) - np.cos(x))
        return np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))

    @cached_property
    def _scale(self) -> Array:
        """Factors (n) that make modal masses one."""
        return 1.0 / np.sqrt(self._over_mass(lambda z: self._curve(z, 0) ** 2))

    def _over_mass(self, value: Callable[[Array], Array]) -> Array:
        """Integral over all mass of a function of the place along the rod (...) [m]."""
        z, weights = self._quadrature
        per_length = self.mass / self.length
        return per_length * weights @ value(z) + self.tip_mass * value(np.array(self.length))

    def _over_slopes(self, load: Callable[[Array], Array]) -> Array:
        """Integral (n, n) along the rod of phi_j' phi_k' times a load."""
        z, weights = self._quadrature
        slopes = self.slope(z)
        return (slopes * (weights * load(z))[:, np.newaxis]).T @ slopes

    @cached_property
    def _quadrature(self) -> tuple[Array, Array]:
        """Places (_NODES) along the rod and their weights, after Gauss [m]."""
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        return 0.5 * self.length * (1.0 + nodes), 0.5 * self.length * weights
