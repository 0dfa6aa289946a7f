"""Motion of a flexible rod whose clamp is moved: a step of its modes, its tip, its wrench.

In axes that move with the clamp, z along the straight rod, the modes q of the plane of x obey

    q'' + 2 d Omega q' + (Omega^2 - f_z S) q = - T f_x - R (a_y + w_x w_z)
        - (w_x^2 + w_y^2) C q + (w_y^2 + w_z^2) q - w_x w_y p + a_z p + 2 w_z p'

with the clamp's specific force f (acceleration less gravity), angular velocity w and angular
acceleration a. T and R are the participations in translation and rotation, S and C what softens
and stiffens the rod (see `FlexibleRod`); p are the modes of the plane of y, whose equations follow
by symmetry. A step is the exact solution for a motion of the clamp, and loads of the second line,
that are constant over it; f_z may change from step to step, as steps are polynomials in it.
Coriolis forces, the last term, act as a rotation of the rates by halves before and after it.

The wrench on the clamp is the resultant of d'Alembert's forces of all mass, to first order in the
deflection; among them is the weight that the deflection moves aside, and, of second order, what
it takes to draw the rod's mass nearer to the clamp. Functions are elementwise:
the numbers of a state and of a motion are floats, or arrays of one shape.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm  # type: ignore[import-untyped]

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.core.elementwise import Elementwise, sin_cos, sumprod
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.triples import cross, plus
from parapod.systems.core.vectors import Array

type Vector3 = tuple[Elementwise, Elementwise, Elementwise]
type State = list[Elementwise]

# Largest product of a mode's angular frequency and the period [rad]: nine tenths of Nyquist's.
_LARGEST_ANGLE = 0.9 * math.pi
# Acceleration along the rod up to which steps are exact, by gravity's or by that at which the rod
# buckles; degree of the polynomials, exact to rounding.
_LARGEST_ALONG, _SHARE_OF_BUCKLING = 50.0, 0.8
_DEGREE = 7


NO_FORCE: Vector3 = (0.0, 0.0, 0.0)


class ClampMotion(NamedTuple):
    """Motion of the clamp, along its own axes, and a force at the tip.

    Attributes:
        force: specific force, acceleration less gravity (3) [m/s^2].
        turning: angular velocity (3) [rad/s].
        spinning: angular acceleration (3) [rad/s^2].
        tip_force: force on the tip (3) along the same axes [N]; `NO_FORCE`, that very tuple, for
            none. Its part along the rod does not soften it.
    """

    force: Vector3
    turning: Vector3 = (0.0, 0.0, 0.0)
    spinning: Vector3 = (0.0, 0.0, 0.0)
    tip_force: Vector3 = NO_FORCE


class Tip(NamedTuple):
    """Tip of the rod beside that of a straight one, along the clamp's axes.

    Attributes:
        place: displacement (3) [m].
        turn: small rotation (3) [rad].
        velocity: rate of the displacement (3) [m/s].
        turning: rate of the rotation (3) [rad/s].
    """

    place: Vector3
    turn: Vector3
    velocity: Vector3
    turning: Vector3


# Sums over the modes that make the wrench: in the planes of x and y the first moment of mass that
# the deflection moves and the product of inertia, then their rates, and second derivatives.
_SUMS = 12


class RodMotion:
    """Steps of a rod's modes.

    A state (4n) has the modal coordinates in the planes of x and y, then their rates.

    Attributes:
        rod: the rod.
        period: length of a step [s].
    """

    def __init__(self, rod: FlexibleRod, period: float):
        """Works out the steps.

        Args:
            rod: the rod.
            period: length of a step [s].

        Raises:
            ValueError: as `check_rod`.
        """
        check_rod(rod, period)
        self.rod, self.period = rod, period
        self._n = n = rod.modes
        self._whole = min(_LARGEST_ALONG, _SHARE_OF_BUCKLING * rod.buckling)
        nodes = np.cos(math.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
        steps = np.array([_exact_step(rod, period, self._whole * node) for node in nodes])
        steps = np.linalg.solve(np.vander(nodes, increasing=True), steps.reshape(len(nodes), -1))
        self._flat, self._shape = steps, (4 * n, steps.shape[1] // (4 * n))
        self._forms = _forms_of(rod)
        self._by_half = _exact_step(rod, 0.5 * period, 0.0)[:, 4 * n : 4 * n + 4].tolist()
        self._at_tip = [at(rod.length).tolist() for at in (rod.shape, rod.slope)]
        self._rows = range(_SUMS, _SUMS + 6 * n, 2 * n)
        self._shortening = rod.shortening.tolist()
        self._residual, self._tip_residual = rod.residual.tolist(), rod.tip_residual.tolist()
        per_length, long = rod.mass / rod.length, rod.length
        self._mass = rod.mass + rod.tip_mass
        self._first = 0.5 * per_length * long**2 + rod.tip_mass * long
        self._second = per_length * long**3 / 3.0 + rod.tip_mass * long**2

    def rest(self, force: Sequence[float]) -> list[float]:
        """State (4n) at rest under a specific force (3) along the clamp's axes [m/s^2]."""
        rests = [self.rod.rest(force[plane], force[2], plane).tolist() for plane in range(2)]
        return rests[0] + rests[1] + [0.0] * (2 * self._n)

    def corrected(self, state: State, motion: ClampMotion, assumed: ClampMotion) -> State:
        """State after half a step in a motion, from that after half a step in an assumed one.

        To first order in what the clamp's acceleration differs by.
        """
        (f_x, g_x), (f_y, g_y) = _across(motion)
        (e_x, h_x), (e_y, h_y) = _across(assumed)
        gained = f_x - e_x, g_x - h_x, f_y - e_y, g_y - h_y
        return [q + sumprod(row, gained) for q, row in zip(state, self._by_half, strict=True)]

    def step(self, state: State, motion: ClampMotion) -> State:
        """State one period later, in a constant motion of the clamp."""
        angle = motion.turning[2] * self.period
        numbers = self._turned(state, angle) + self._loads(state, motion)
        share = motion.force[2] / self._whole
        if type(share) is float and type(numbers[0]) is float:
            share = -1.0 if share < -1.0 else min(share, 1.0)
            powers = np.array([share**k for k in range(_DEGREE + 1)])
            step = powers.dot(self._flat).reshape(self._shape)
            return self._turned(step.dot(np.array(numbers)).tolist(), angle)
        powers = np.clip(share, -1.0, 1.0)[..., np.newaxis] ** np.arange(_DEGREE + 1)
        step = (powers @ self._flat).reshape(*powers.shape[:-1], *self._shape)
        ahead = np.einsum("...ij,...j->...i", step, np.stack(np.broadcast_arrays(*numbers), -1))
        return self._turned(list(np.moveaxis(ahead, -1, 0)), angle)

    def tip(self, state: State, motion: ClampMotion) -> Tip:
        """Tip of the rod; what the modes leave out follows the load without delay."""
        n, short, shortens = self._n, 0.0, 0.0
        places, turns, rates, spins = [], [], [], []
        shape, slope = self._at_tip
        for plane, (across, growth) in enumerate(_across(motion)):
            q, rate = (state[i * n : (i + 1) * n] for i in (plane, plane + 2))
            (by_force, by_turn), (slope_force, slope_turn) = self._residual[plane]
            places.append(sumprod(shape, q) + by_force * across + by_turn * growth)
            turns.append(sumprod(slope, q) + slope_force * across + slope_turn * growth)
            if motion.tip_force is not NO_FORCE:
                by_place, by_slope = self._tip_residual[plane]
                places[plane] += by_place * motion.tip_force[plane]
                turns[plane] += by_slope * motion.tip_force[plane]
            rates.append(sumprod(shape, rate))
            spins.append(sumprod(slope, rate))
            for row, a, v in zip(self._shortening, q, rate, strict=True):
                stretched = sumprod(row, q)
                short, shortens = short + 0.5 * stretched * a, shortens + stretched * v
        none = 0.0 * turns[0]
        return Tip(
            (places[0], places[1], -short),
            (-turns[1], turns[0], none),
            (rates[0], rates[1], -shortens),
            (-spins[1], spins[0], none),
        )

    def rigid_wrench(self, motion: ClampMotion) -> tuple[Vector3, Vector3]:
        """Moment about the clamp [N m] and force [N] of a rigid rod, along the clamp's axes."""
        (f_x, f_y, f_z), (w_x, w_y, _), _, _ = motion
        (_, by_x), (_, by_y) = _across(motion)
        m, first, second = self._mass, self._first, self._second
        force = (
            -m * f_x - first * by_x,
            -m * f_y - first * by_y,
            -m * f_z + first * (w_x * w_x + w_y * w_y),
        )
        return (first * f_y + second * by_y, -first * f_x - second * by_x, 0.0 * f_x), force

    def bending_wrench(self, state: State, motion: ClampMotion) -> tuple[Vector3, Vector3]:
        """The same of the rod as it bends, less that of a rigid one; with a force at the tip."""
        n, half = self._n, 2 * self._n
        (f_x, f_y, f_z), (w_x, w_y, w_z), (a_x, a_y, a_z), at_tip = motion
        twice, q, rates = 2.0 * w_z, state[:half], state[half:]
        numbers = state + self._loads(state, motion)
        numbers += [twice * v for v in rates[n:]] + [-twice * v for v in rates[:n]]
        forms = _product(self._forms, numbers + [f_z * x for x in q])
        moved_x, turned_x, moved_y, turned_y = forms[:4]
        moving_x, turning_x, moving_y, turning_y = forms[4:8]
        bends_x, spins_x, bends_y, spins_y = forms[8:_SUMS]
        second, softened, softened_rates = (forms[i : i + half] for i in self._rows)
        # Euler's, centrifugal and Coriolis forces of the first moment that is moved aside.
        along = w_x * moved_x + w_y * moved_y
        square = w_x * w_x + w_y * w_y + w_z * w_z
        force = (
            a_z * moved_y - w_x * along + square * moved_x + twice * moving_y - bends_x,
            -a_z * moved_x - w_y * along + square * moved_y - twice * moving_x - bends_y,
            a_y * moved_x
            - a_x * moved_y
            - w_z * along
            - 2.0 * (w_x * moving_y - w_y * moving_x)
            # The rod comes nearer to the clamp as it bends.
            + sumprod(softened, second)
            + sumprod(softened_rates, rates),
        )
        # The products of inertia that the deflection makes, times w and a.
        i_x, i_y = -turned_x * w_z, -turned_y * w_z
        i_z = -turned_x * w_x - turned_y * w_y
        about = sumprod(q[:n], second[n:]) - sumprod(q[n:], second[:n])
        moment = (
            -moved_y * f_z + turned_x * a_z - w_y * i_z + w_z * i_y + spins_y + twice * turning_x,
            moved_x * f_z + turned_y * a_z - w_z * i_x + w_x * i_z - spins_x + twice * turning_y,
            moved_y * f_x
            - moved_x * f_y
            + turned_x * a_x
            + turned_y * a_y
            - w_x * i_y
            + w_y * i_x
            - about,
        )
        if at_tip is not NO_FORCE:
            shape, _ = self._at_tip
            place = sumprod(shape, q[:n]), sumprod(shape, q[n:]), self.rod.length
            force, moment = plus(force, at_tip), plus(moment, cross(place, at_tip))
        return moment, force

    def energy(self, state: State, force: Sequence[float]) -> float:
        """Energy of the modes over a clamp at rest under a specific force (3) [J]."""
        n, rod = self._n, self.rod
        q, rate = np.array(state[: 2 * n]), np.array(state[2 * n :])
        loads = np.concatenate([rod.translation * force[0], rod.translation * force[1]])
        return float(0.5 * rate @ rate + 0.5 * q @ _stiffness(rod, force[2]) @ q + q @ loads)

    def _turned(self, state: State, angle: Elementwise) -> State:
        """A state whose rates Coriolis forces have turned from one plane into the other."""
        n, (sine, cosine) = self._n, sin_cos(angle)
        x, y = state[2 * n : 3 * n], state[3 * n :]
        turned = state[: 2 * n]
        turned += [cosine * u + sine * v for u, v in zip(x, y, strict=True)]
        turned += [cosine * v - sine * u for u, v in zip(x, y, strict=True)]
        return turned

    def _loads(self, state: State, motion: ClampMotion) -> State:
        """Numbers (4n + 4) that load the modes, by `_loads_of`."""
        n, a_z = self._n, motion.spinning[2]
        w_x, w_y, w_z = motion.turning
        x, y = state[:n], state[n : 2 * n]
        xx, yy, zz, xy = w_x * w_x, w_y * w_y, w_z * w_z, w_x * w_y
        by_x, by_y, inwards = yy + zz, xx + zz, -xx - yy
        (across_x, growth_x), (across_y, growth_y) = _across(motion)
        numbers = [across_x, growth_x, across_y, growth_y]
        along_x = [by_x * q + (a_z - xy) * p for q, p in zip(x, y, strict=True)]
        along_y = [by_y * p - (a_z + xy) * q for q, p in zip(x, y, strict=True)]
        if motion.tip_force is not NO_FORCE:
            shape, (push_x, push_y, _) = self._at_tip[0], motion.tip_force
            along_x = [load + phi * push_x for load, phi in zip(along_x, shape, strict=True)]
            along_y = [load + phi * push_y for load, phi in zip(along_y, shape, strict=True)]
        numbers += along_x + along_y
        return numbers + [inwards * q for q in state[: 2 * n]]


def longest_period(rod: FlexibleRod) -> float:
    """Longest period that carries all modes of a rod [s]."""
    return _LARGEST_ANGLE / float(rod.frequencies.max())


def carried_modes(rod: FlexibleRod, period: float) -> int:
    """Number of the modes of a rod that a period [s] carries."""
    return int((rod.frequencies.max(axis=0) * period <= _LARGEST_ANGLE).sum())


def check_rod(rod: FlexibleRod, period: float) -> None:
    """Refuses a rod that does not stand upright, and modes above what a period can carry.

    Args:
        rod: the rod.
        period: length of a step [s].

    Raises:
        ValueError: names the attribute, and the admissible values.
    """
    if rod.buckling <= GRAVITY:
        softest = min(rod.bending_stiffness)
        raise ValueError(
            f"bending_stiffness = {softest:g} N m^2: upright, the rod buckles under its own "
            f"weight; it must be above {softest * GRAVITY / rod.buckling:.3g}"
        )
    carried = carried_modes(rod, period)
    if carried < rod.modes:
        hertz = rod.frequencies.max(axis=0) / (2.0 * math.pi)
        fewer = f"at most {carried} modes, or " if carried else ""
        raise ValueError(
            f"modes = {rod.modes}: mode {carried + 1} of the rod has {hertz[carried]:.3g} Hz, "
            f"more than a period of {period:g} s carries; {fewer}a period of at most "
            f"{longest_period(rod):.2g} s would do"
        )


def _stiffness(rod: FlexibleRod, along: float) -> Array:
    """Stiffness (2n, 2n) of the modes under a specific force along the rod [m/s^2]."""
    zero = np.zeros_like(rod.softening)
    x, y = (np.diag(omega**2) - along * rod.softening for omega in rod.frequencies)
    return np.block([[x, zero], [zero, y]])


def _exact_step(rod: FlexibleRod, period: float, along: float) -> Array:
    """Matrix (4n, 8n + 4) from a state and its `_loads_of` to the state a period later."""
    n, loads = rod.modes, _loads_of(rod)
    damping = np.diag(2.0 * rod.damping_ratio * rod.frequencies.ravel())
    whole = np.zeros((8 * n + 4, 8 * n + 4))
    q, rate, load = slice(0, 2 * n), slice(2 * n, 4 * n), slice(4 * n, None)
    whole[q, rate], whole[rate, q] = np.eye(2 * n), -_stiffness(rod, along)
    whole[rate, rate], whole[rate, load] = -damping, loads
    step: Array = expm(period * whole)[: 4 * n]
    return step


def _loads_of(rod: FlexibleRod) -> Array:
    """Matrix (2n, 4n + 4) from what loads the modes to their second derivatives.

    That are the clamp's acceleration across and its growth along the rod in both planes, loads of
    the modes (2n), and the coordinates times what stiffens the rod as a rotation does (2n).
    """
    both, by_clamp = np.eye(2), -np.stack([rod.translation, rod.rotation], axis=-1)
    whole = np.eye(2 * rod.modes)
    return np.hstack([np.kron(both, by_clamp), whole, np.kron(both, rod.stiffening)])


def _forms_of(rod: FlexibleRod) -> Array:
    """Matrix (_SUMS + 6n, 12n + 4) from a state and loads to what makes the wrench.

    Behind the state and its `_loads_of` come further loads of the modes (2n), and the coordinates
    times what softens the rod (2n). Behind `_SUMS` come the second derivatives, and coordinates
    and rates times the softening (2n each).
    """
    n, omega, soft = rod.modes, rod.frequencies.ravel(), np.kron(np.eye(2), rod.softening)
    pull = -np.hstack([np.diag(omega**2), np.diag(2.0 * rod.damping_ratio * omega)])
    second = np.hstack([pull, _loads_of(rod), np.eye(2 * n), soft])
    moments = np.stack([rod.translation, rod.rotation])
    of_state = np.vstack([np.kron(np.eye(4), moments), np.kron(np.eye(2), soft)])
    of_state = np.hstack([of_state, np.zeros((8 + 4 * n, second.shape[1] - 4 * n))])
    by_second = np.kron(np.eye(2), moments) @ second
    return np.vstack([of_state[:8], by_second, second, of_state[8:]])


def _across(motion: ClampMotion) -> tuple[tuple[Elementwise, Elementwise], ...]:
    """For both planes the clamp's acceleration across the rod, and its growth along it."""
    (f_x, f_y, _), (w_x, w_y, w_z), (a_x, a_y, _), _ = motion
    return (f_x, a_y + w_x * w_z), (f_y, w_y * w_z - a_x)


def _product(matrix: NDArray[Any], numbers: State) -> State:
    """Product of a matrix with a column of elementwise numbers."""
    if type(numbers[0]) is float:
        product: State = matrix.dot(np.array(numbers)).tolist()
        return product
    return list(np.tensordot(matrix, np.stack(np.broadcast_arrays(*numbers)), 1))
