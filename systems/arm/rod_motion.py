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
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm  # type: ignore[import-untyped]

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.core.elementwise import Elementwise, sin_cos
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.vectors import Array

type Vector3 = tuple[Elementwise, Elementwise, Elementwise]
type State = list[Elementwise]

# Largest product of a mode's angular frequency and the period [rad]: nine tenths of Nyquist's.
_LARGEST_ANGLE = 0.9 * math.pi
# Acceleration along the rod up to which steps are exact, by gravity's or by that at which the rod
# buckles; degree of the polynomials, exact to rounding.
_LARGEST_ALONG, _SHARE_OF_BUCKLING = 50.0, 0.8
_DEGREE = 7


class ClampMotion(NamedTuple):
    """Motion of the clamp, along its own axes.

    Attributes:
        force: specific force, acceleration less gravity (3) [m/s^2].
        turning: angular velocity (3) [rad/s].
        spinning: angular acceleration (3) [rad/s^2].
    """

    force: Vector3
    turning: Vector3 = (0.0, 0.0, 0.0)
    spinning: Vector3 = (0.0, 0.0, 0.0)


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


class _Sums(NamedTuple):
    """Sums over the modes of one plane, or over their rates, that make wrench and tip."""

    moved: Elementwise  # first moment of mass that the deflection moves, T q
    product: Elementwise  # product of inertia, R q
    moving: Elementwise  # T q'
    producing: Elementwise  # R q'
    across: Elementwise  # tip's deflection, without what the modes leave out
    slope: Elementwise
    across_rate: Elementwise
    slope_rate: Elementwise


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
        self._flat, self._shape = steps, (4 * n, 6 * n + 4)
        self._sums = np.concatenate([_sums_of(rod, plane) for plane in range(2)])
        omega = rod.frequencies.ravel()
        self._pull = np.hstack([np.diag(omega**2), np.diag(2.0 * rod.damping_ratio * omega)])
        self._soft = np.kron(np.eye(2), rod.softening)
        self._loads = rod.translation.tolist(), rod.rotation.tolist()
        self._stiffening, self._shortening = rod.stiffening.tolist(), rod.shortening.tolist()
        self._residual = rod.residual.tolist()
        per_length, long = rod.mass / rod.length, rod.length
        self._mass = rod.mass + rod.tip_mass
        self._first = 0.5 * per_length * long**2 + rod.tip_mass * long
        self._second = per_length * long**3 / 3.0 + rod.tip_mass * long**2

    def rest(self, force: Sequence[float]) -> list[float]:
        """State (4n) at rest under a specific force (3) along the clamp's axes [m/s^2]."""
        rests = [self.rod.rest(force[plane], force[2], plane).tolist() for plane in range(2)]
        return rests[0] + rests[1] + [0.0] * (2 * self._n)

    def step(self, state: State, motion: ClampMotion) -> State:
        """State one period later, in a constant motion of the clamp."""
        angle = motion.turning[2] * self.period
        turned = self._turned(state, angle)
        (across_x, growth_x), (across_y, growth_y) = _across(motion)
        small = self._small_loads(state, motion)
        numbers = [*turned, across_x, growth_x, across_y, growth_y, *small]
        share = motion.force[2] / self._whole
        if type(share) is float and type(numbers[0]) is float:
            share = -1.0 if share < -1.0 else min(share, 1.0)
            powers = np.array([share**k for k in range(_DEGREE + 1)])
            step = (powers @ self._flat).reshape(self._shape)
            return self._turned((step @ np.array(numbers)).tolist(), angle)
        powers = np.clip(share, -1.0, 1.0)[..., np.newaxis] ** np.arange(_DEGREE + 1)
        step = (powers @ self._flat).reshape(*powers.shape[:-1], *self._shape)
        ahead = np.einsum("...ij,...j->...i", step, np.stack(np.broadcast_arrays(*numbers), -1))
        return self._turned(list(np.moveaxis(ahead, -1, 0)), angle)

    def tip(self, state: State, motion: ClampMotion) -> Tip:
        """Tip of the rod; what the modes leave out follows the load without delay."""
        x, y = self._sums_in(state)
        (u_x, v_x), (u_y, v_y) = (
            (
                own.across + by_force * across + by_turn * turning,
                own.slope + slope_force * across + slope_turn * turning,
            )
            for own, (across, turning), ((by_force, by_turn), (slope_force, slope_turn)) in zip(
                (x, y), _across(motion), self._residual, strict=True
            )
        )
        n, short, rate = self._n, 0.0, 0.0
        for plane in range(2):
            q, q_rate = (state[i * n : (i + 1) * n] for i in (plane, plane + 2))
            for row, a, v in zip(self._shortening, q, q_rate, strict=True):
                stretched = _dot(row, q)
                short, rate = short + 0.5 * stretched * a, rate + stretched * v
        none = 0.0 * v_x
        return Tip(
            (u_x, u_y, -short),
            (-v_y, v_x, none),
            (x.across_rate, y.across_rate, -rate),
            (-y.slope_rate, x.slope_rate, none),
        )

    def rigid_wrench(self, motion: ClampMotion) -> tuple[Vector3, Vector3]:
        """Moment about the clamp [N m] and force [N] of a rigid rod, along the clamp's axes."""
        (f_x, f_y, f_z), (w_x, w_y, _), _ = motion
        (_, by_x), (_, by_y) = _across(motion)
        m, first, second = self._mass, self._first, self._second
        force = (
            -m * f_x - first * by_x,
            -m * f_y - first * by_y,
            -m * f_z + first * (w_x * w_x + w_y * w_y),
        )
        return (first * f_y + second * by_y, -first * f_x - second * by_x, 0.0 * f_x), force

    def bending_wrench(self, state: State, motion: ClampMotion) -> tuple[Vector3, Vector3]:
        """The same of the rod as it bends, less that of a rigid one."""
        n, (x, y) = self._n, self._sums_in(state)
        (f_x, f_y, f_z), (w_x, w_y, w_z), (a_x, a_y, a_z) = motion
        second, softened = self._accelerations(state, motion)
        bend_x, bend_y, turn_x, turn_y = (
            _dot(by, part) for by in self._loads for part in (second[:n], second[n:])
        )
        # Euler's, centrifugal and Coriolis forces of the first moment that is moved aside.
        along = w_x * x.moved + w_y * y.moved
        square = w_x * w_x + w_y * w_y + w_z * w_z
        force = (
            a_z * y.moved - w_x * along + square * x.moved + 2.0 * w_z * y.moving - bend_x,
            -a_z * x.moved - w_y * along + square * y.moved - 2.0 * w_z * x.moving - bend_y,
            a_y * x.moved
            - a_x * y.moved
            - w_z * along
            - 2.0 * (w_x * y.moving - w_y * x.moving)
            # The rod comes nearer to the clamp as it bends.
            + _dot(softened, second)
            + _dot(_product(self._soft, state[2 * n :]), state[2 * n :]),
        )
        # The products of inertia that the deflection makes, times w and a.
        i_x, i_y = -x.product * w_z, -y.product * w_z
        i_z = -x.product * w_x - y.product * w_y
        moment = (
            -y.moved * f_z + x.product * a_z - w_y * i_z + w_z * i_y + turn_y,
            x.moved * f_z + y.product * a_z - w_z * i_x + w_x * i_z - turn_x,
            y.moved * f_x - x.moved * f_y + x.product * a_x + y.product * a_y,
        )
        coriolis = 2.0 * w_z * x.producing, 2.0 * w_z * y.producing
        about = _dot(state[:n], second[n:]) - _dot(state[n : 2 * n], second[:n])
        spun = moment[2] - w_x * i_y + w_y * i_x - about
        return (moment[0] + coriolis[0], moment[1] + coriolis[1], spun), force

    def energy(self, state: State, force: Sequence[float]) -> float:
        """Energy of the modes over a clamp at rest under a specific force (3) [J]."""
        n, rod = self._n, self.rod
        q, rate = np.array(state[: 2 * n]), np.array(state[2 * n :])
        loads = np.concatenate([rod.translation * force[0], rod.translation * force[1]])
        return float(0.5 * rate @ rate + 0.5 * q @ _stiffness(rod, force[2]) @ q + q @ loads)

    def _sums_in(self, state: State) -> tuple[_Sums, _Sums]:
        sums = _product(self._sums, state)
        size = len(_Sums._fields)
        return _Sums(*sums[:size]), _Sums(*sums[size:])

    def _turned(self, state: State, angle: Elementwise) -> State:
        """A state whose rates Coriolis forces have turned from one plane into the other."""
        n, (sine, cosine) = self._n, sin_cos(angle)
        rates = list(zip(state[2 * n : 3 * n], state[3 * n :], strict=True))
        x = [cosine * u + sine * v for u, v in rates]
        return [*state[: 2 * n], *x, *(cosine * v - sine * u for u, v in rates)]

    def _small_loads(self, state: State, motion: ClampMotion) -> State:
        """Loads (2n) of the modes by rotation, but Coriolis forces."""
        n = self._n
        w_x, w_y, w_z = motion.turning
        a_z, both = motion.spinning[2], w_x * w_y
        q, p = state[:n], state[n : 2 * n]
        across = w_x * w_x + w_y * w_y
        loads = []
        for own, other, square, spin in (
            (q, p, w_y * w_y + w_z * w_z, a_z - both),
            (p, q, w_x * w_x + w_z * w_z, -a_z - both),
        ):
            for x, y, row in zip(own, other, self._stiffening, strict=True):
                loads.append(square * x + spin * y - across * _dot(row, own))
        return loads

    def _accelerations(self, state: State, motion: ClampMotion) -> tuple[State, State]:
        """Second derivatives (2n) of the modal coordinates, and S times the coordinates."""
        n = self._n
        pulled = _product(self._pull, state)
        softened = _product(self._soft, state[: 2 * n])
        small, turn = self._small_loads(state, motion), 2.0 * motion.turning[2]
        coriolis = [turn * v for v in state[3 * n :]] + [-turn * v for v in state[2 * n : 3 * n]]
        by_clamp = [
            -(by_force * across + by_turn * growth)
            for across, growth in _across(motion)
            for by_force, by_turn in zip(*self._loads, strict=True)
        ]
        rows = zip(pulled, softened, small, coriolis, by_clamp, strict=True)
        f_z = motion.force[2]
        return [f_z * s + c + load + d - p for p, s, c, load, d in rows], softened


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
    fastest = rod.frequencies.max(axis=0)
    carried = int((fastest * period <= _LARGEST_ANGLE).sum())
    if carried < rod.modes:
        hertz = fastest / (2.0 * math.pi)
        fewer = f"at most {carried} modes, or " if carried else ""
        longest = _LARGEST_ANGLE / fastest[-1]
        raise ValueError(
            f"modes = {rod.modes}: mode {carried + 1} of the rod has {hertz[carried]:.3g} Hz, "
            f"more than a period of {period:g} s carries; {fewer}a period of at most "
            f"{longest:.2g} s would do"
        )


def _stiffness(rod: FlexibleRod, along: float) -> Array:
    """Stiffness (2n, 2n) of the modes under a specific force along the rod [m/s^2]."""
    zero = np.zeros_like(rod.softening)
    x, y = (np.diag(omega**2) - along * rod.softening for omega in rod.frequencies)
    return np.block([[x, zero], [zero, y]])


def _exact_step(rod: FlexibleRod, period: float, along: float) -> Array:
    """Matrix (4n, 6n + 4) from a state and what loads it constantly to the state a period later.

    Loads are the clamp's acceleration across and its growth along the rod in both planes, and
    those of the modes (2n).
    """
    n = rod.modes
    by_clamp = -np.stack([rod.translation, rod.rotation], axis=-1)
    loads = np.hstack([np.kron(np.eye(2), by_clamp), np.eye(2 * n)])
    damping = np.diag(2.0 * rod.damping_ratio * rod.frequencies.ravel())
    whole = np.zeros((6 * n + 4, 6 * n + 4))
    q, rate, load = slice(0, 2 * n), slice(2 * n, 4 * n), slice(4 * n, None)
    whole[q, rate], whole[rate, q] = np.eye(2 * n), -_stiffness(rod, along)
    whole[rate, rate], whole[rate, load] = -damping, loads
    step: Array = expm(period * whole)[: 4 * n]
    return step


def _sums_of(rod: FlexibleRod, plane: int) -> Array:
    """Rows (., 4n) that make `_Sums` of a plane from a state."""
    n = rod.modes
    translation, rotation, zero = rod.translation, rod.rotation, np.zeros(rod.modes)
    tip, slope = rod.shape(rod.length), rod.slope(rod.length)
    of_both: dict[str, tuple[Array, Array]] = {  # of the coordinates, of their rates
        "moved": (translation, zero),
        "product": (rotation, zero),
        "moving": (zero, translation),
        "producing": (zero, rotation),
        "across": (tip, zero),
        "slope": (slope, zero),
        "across_rate": (zero, tip),
        "slope_rate": (zero, slope),
    }
    rows = np.zeros((len(_Sums._fields), 4 * n))
    for row, name in zip(rows, _Sums._fields, strict=True):
        for i, part in zip((plane, plane + 2), of_both[name], strict=True):
            row[i * n : (i + 1) * n] = part
    return rows


def _across(motion: ClampMotion) -> tuple[tuple[Elementwise, Elementwise], ...]:
    """For both planes the clamp's acceleration across the rod, and its growth along it."""
    (f_x, f_y, _), (w_x, w_y, w_z), (a_x, a_y, _) = motion
    return (f_x, a_y + w_x * w_z), (f_y, w_y * w_z - a_x)


def _product(matrix: NDArray[Any], numbers: State) -> State:
    """Product of a matrix with a column of elementwise numbers."""
    if type(numbers[0]) is float:
        product: State = (matrix @ np.array(numbers)).tolist()
        return product
    return list(np.tensordot(matrix, np.stack(np.broadcast_arrays(*numbers)), 1))


def _dot(a: Sequence[Elementwise], b: Sequence[Elementwise]) -> Elementwise:
    return sum(map(mul, a, b))
