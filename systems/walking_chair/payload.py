"""Payload of the walking chair: the largest one, and an estimate from the motors' currents.

The paper's Eqs. (50) and (54) ask that the branches' forces stay within +-F_N; how a redundantly
supported chair spreads them is open. The largest payload over all ways of spreading them bounds
what any distribution can reach; what a real chair reaches lies below it, and follows from how
stiff its branches are.

The ground pushes on each corner along rays: straight up without friction, otherwise along the
edges of the pyramid |f_x| + |f_y| <= mu f_z, which is inside the cone of friction. Forces are
sums of rays with factors that are not negative.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context
from scipy.optimize import linprog, nnls  # type: ignore[import-untyped]

from parapod.systems.core.batching import row_by_row
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import batch, read_batch
from parapod.systems.core.rows import answer_of
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, ChairGeometry, by_legs
from parapod.systems.walking_chair.leg import leg_corners, up_of_lengths
from parapod.systems.walking_chair.masses import ChairMasses
from parapod.systems.walking_chair.rates import corner_jacobians

# F_N of Eq. (53) [N].
FORCE_LIMIT = 427.3

# Weight of the balance of forces against the energy in `elastic_forces`, and largest error of the
# balance as a share of the weight.
_BALANCE = 1e4
_MISSED = 1e-4


class Stand(NamedTuple):
    """Stance of the chair at an instant; its body is level.

    Attributes:
        force_map: (12, 12, 3) see `statics.force_map`.
        corners: (12, 3) of the feet from S, along the body's axes [m].
        touching: (12) whether each corner is on the ground.
        chair_mass: without payload, its centre of mass above or below S [kg].
        payload_place: (2) centre of mass of the payload, x and y from S [m].
    """

    force_map: NDArray[np.float64]
    corners: NDArray[np.float64]
    touching: NDArray[np.bool_]
    chair_mass: float
    payload_place: ArrayLike = (0.0, 0.0)

    def wrench(self, mass: float) -> NDArray[np.float64]:
        """(6) force and moment about S that balance the weight with a payload [N, N m]."""
        own, payload = _unit_weight((0.0, 0.0)), _unit_weight(self.payload_place)
        return GRAVITY * (self.chair_mass * own + mass * payload)


class Payload(NamedTuple):
    """A payload and the forces that carry it.

    Attributes:
        mass: [kg]; minus infinity if there is none with which the chair can stand.
        forces: (12, 3) of the ground on the corners [N]; NaN if none will do.
        branch_forces: (12) forces of the branches [N].
    """

    mass: float
    forces: NDArray[np.float64]
    branch_forces: NDArray[np.float64]


class _Rays(NamedTuple):
    """Along which the ground pushes: n of them.

    Attributes:
        corner: (n) number 0..11 of the corner that each pushes on.
        direction: (n, 3) force for a factor of 1.
        branches: (12, n) forces of the branches.
        wrenches: (6, n) force and moment about S.
    """

    corner: NDArray[np.intp]
    direction: NDArray[np.float64]
    branches: NDArray[np.float64]
    wrenches: NDArray[np.float64]

    def carrying(self, mass: float, factors: NDArray[np.float64]) -> Payload:
        """A payload that these factors (n) carry."""
        forces = np.zeros((3 * LEG_COUNT, 3))
        np.add.at(forces, self.corner, factors[:, np.newaxis] * self.direction)
        return Payload(mass, forces, self.branches @ factors)


_NOTHING = Payload(-np.inf, np.full((3 * LEG_COUNT, 3), np.nan), np.full(3 * LEG_COUNT, np.nan))


def largest_payload(stand: Stand, friction: float = 0.0, limit: float = FORCE_LIMIT) -> Payload:
    """The largest payload that some distribution of forces carries.

    Args:
        stand: the chair.
        friction: coefficient.
        limit: largest force of a branch, either way [N].

    Raises:
        ValueError: numbers that are not finite.
    """
    rays = _rays(stand, friction)
    count = len(rays.corner)
    solution = _solve(
        np.append(np.zeros(count), -1.0),
        _both_ways(rays.branches, 0.0),
        limit,
        np.column_stack((rays.wrenches, -GRAVITY * _unit_weight(stand.payload_place))),
        stand.wrench(0.0),
    )
    return _NOTHING if solution is None else rays.carrying(float(solution[-1]), solution[:-1])


def least_branch_force(stand: Stand, mass: float, friction: float = 0.0) -> Payload:
    """Forces that carry a payload with as small a largest force of a branch as there can be.

    The largest is unique; the forces of other branches need not be.

    Args:
        stand: the chair.
        mass: mass of the payload [kg].
        friction: coefficient.

    Raises:
        ValueError: numbers that are not finite.
    """
    rays = _rays(stand, friction)
    count = len(rays.corner)
    solution = _solve(
        np.append(np.zeros(count), 1.0),
        _both_ways(rays.branches, -1.0),
        0.0,
        np.column_stack((rays.wrenches, np.zeros(6))),
        stand.wrench(mass),
    )
    return _NOTHING if solution is None else rays.carrying(mass, solution[:-1])


def elastic_forces(
    stand: Stand, mass: float, friction: float = 0.0, ups_stiffness: float = 1.0
) -> Payload:
    """Forces that carry a payload on branches that give, between rigid feet and a rigid body.

    Of all distributions it is the one with the least energy stored in the branches; all branches
    of a kind give alike.

    Args:
        stand: the chair.
        mass: mass of the payload [kg].
        friction: coefficient.
        ups_stiffness: axial stiffness of a UPS branch by that of a UP branch.

    Raises:
        ValueError: numbers that are not finite.
    """
    rays = _rays(stand, friction)
    by_energy = np.tile((1.0, *(ups_stiffness,) * 2), LEG_COUNT) ** -0.5
    load_wrench = stand.wrench(mass)
    if not len(rays.corner):
        return _NOTHING
    factors, _ = nnls(
        np.vstack((by_energy[:, np.newaxis] * rays.branches, _BALANCE * rays.wrenches)),
        np.concatenate((np.zeros(len(by_energy)), _BALANCE * load_wrench)),
    )
    missing = np.abs(rays.wrenches @ factors - load_wrench).max()
    return _NOTHING if missing > _MISSED * load_wrench[2] else rays.carrying(mass, factors)


# Distance from S at which a moment counts as much as a force in `unexplained_forces`, for a chair
# of the paper's size [m]: that of a leg.
LEVER = 0.2


def unexplained_forces(
    stand: Stand,
    mass: float,
    forces: NDArray[np.float64],
    foot_weight: float = 0.0,
    friction: float = 0.5,
    lever: float = LEVER,
) -> NDArray[np.float64]:
    """Parts of the branches' forces that no ground under the touching corners can explain.

    However stiff branches, legs and ground are, the ground only pushes, within its cone of
    friction, on corners that touch it, and balances the weight. What is nearest to the measured
    forces among all that it can do explains them; the rest is returned. It is not zero where a
    drive shows a force that is not there, lacks one that must be, or a foot in the air is held.

    Args:
        stand: the chair.
        mass: mass of the payload [kg].
        forces: (12) of the branches, positive where they push [N].
        foot_weight: weight of a foot below its actuators [N].
        friction: largest coefficient that there may be.
        lever: distance from S at which a moment counts as much as a force [m].

    Returns:
        (12) [N].
    """
    own = stand.force_map[..., 2] @ np.full(len(stand.corners), foot_weight / 3.0)
    weights = np.array((1.0, 1.0, 1.0, *(1.0 / lever,) * 3))
    rays = _rays(stand, friction)
    rows = np.vstack((rays.branches, weights[:, np.newaxis] * rays.wrenches))
    load_wrench = np.concatenate((forces + own, weights * stand.wrench(mass)))
    factors = nnls(rows, load_wrench)[0] if len(rays.corner) else np.zeros(0)
    unexplained: NDArray[np.float64] = forces + own - rays.branches @ factors
    return unexplained


def _rays(stand: Stand, friction: float) -> _Rays:
    sides = [(friction, 0.0), (-friction, 0.0), (0.0, friction), (0.0, -friction)]
    edges = [(x, y, 1.0) for x, y in sides] if friction > 0.0 else [(0.0, 0.0, 1.0)]
    touching = np.flatnonzero(stand.touching)
    corner = np.repeat(touching, len(edges))
    direction = np.tile(np.array(edges), (len(touching), 1))
    branches = np.einsum("bna,na->bn", stand.force_map[:, corner], direction)
    moments = np.cross(stand.corners[corner], direction)
    return _Rays(corner, direction, branches, np.hstack((direction, moments)).T)


def _unit_weight(place: ArrayLike) -> NDArray[np.float64]:
    """(6) force and moment about S that balance a unit of weight at a place (2)."""
    x, y = np.asarray(place, dtype=np.float64)
    return np.array((0.0, 0.0, 1.0, y, -x, 0.0))


def _both_ways(branches: NDArray[np.float64], last: float) -> NDArray[np.float64]:
    """Rows for forces of branches (12, n), either way, with a column for the last unknown."""
    rows = np.vstack((branches, -branches))
    return np.column_stack((rows, np.full(len(rows), last)))


def _solve(
    cost: NDArray[np.float64],
    at_most_rows: NDArray[np.float64],
    at_most: float,
    equal_rows: NDArray[np.float64],
    equal: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Unknowns, none of them negative, of the least cost; None if there are none."""
    solution = linprog(
        cost,
        A_ub=at_most_rows,
        b_ub=np.full(len(at_most_rows), at_most),
        A_eq=equal_rows,
        b_eq=equal,
        bounds=(0.0, None),
    )
    return solution.x if solution.success else None


# A payload that is lighter has no place that is worth knowing [kg].
_LIGHT = 5.0


@dataclass(frozen=True)
class PayloadEstimatorParams:
    """Parameters by which currents become forces, and forces a payload.

    Attributes:
        force_per_current: C_t of Eq. (55) [N/A]: the largest thrust (Eq. 53) at the rated 3 A.
        time_constant: time constant of the estimate's filter [s].
    """

    force_per_current: float = 427.3 / 3.0
    time_constant: float = 0.5


class PayloadEstimator(LeafSystem):
    """Mass and place of the payload from currents, Eq. (55), while the chair hardly accelerates.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 12 | m | lengths of the branches |
    | in `current` | 12 | A | of their motors, positive where they push |
    | out `payload` | 3 | kg, m, m | mass of the payload, and x and y of its centre from S |

    The forces of a leg's three branches determine the forces on its foot's three corners, as far
    as these are vertical: of the ground's less the foot's own weight, whether it stands or hangs.
    Over all legs they add up to the weight above the feet, and their centre is below the centre
    of mass. Friction forces between the feet do no work when the body rises, so that they leave
    the mass alone; the centre they shift, by some millimetres.

    State: discrete, the filtered estimate (3), updated every period; the first sample is taken
    as it is.

    Bad input: a sample with a value that is not finite, with lengths of which no leg can be
    built, or of a chair that does not bear its own weight (as before the first measurement) is
    left out.

    Args:
        params: see `PayloadEstimatorParams`.
        geometry: the chair.
        masses: masses of the chair without payload.
        period: between samples [s].
    """

    def __init__(
        self,
        params: PayloadEstimatorParams = PayloadEstimatorParams(),
        geometry: ChairGeometry = ChairGeometry(),
        masses: ChairMasses = ChairMasses(),
        period: float = 0.2,
    ):
        super().__init__()
        self.set_name("payload_estimator")
        self._params, self._geometry, self._masses = params, geometry, masses
        self._share = -math.expm1(-period / params.time_constant)
        count = len(BRANCHES)
        self._position = self.DeclareVectorInputPort("position", count)
        self._current = self.DeclareVectorInputPort("current", count)
        estimate = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(1)  # whether there has been a sample
        self.DeclareStateOutputPort("payload", estimate)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_estimate)

    def _update_estimate(self, context: Context, discrete_state: Any) -> None:
        position, current = read_batch(self._position, context), read_batch(self._current, context)
        up = up_of_lengths(self._geometry.leg, by_legs(position))
        jacobians = corner_jacobians(self._geometry.leg, up)
        sample = row_by_row(self._sample, 2, up, jacobians, by_legs(current))
        if not answer_of(np.isfinite(sample).all(axis=-1)):
            return
        last = batch(context.get_discrete_state(0), context)
        beginning: Any = context.get_discrete_state(1)
        share = self._share if beginning[0] > 0.5 else 1.0
        discrete_state.set_value(0, last + share * (sample - last))
        discrete_state.set_value(1, np.ones(1))

    def _sample(
        self,
        up: NDArray[np.float64],
        jacobians: NDArray[np.float64],
        current: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Mass and place (3); NaN for what is not determined."""
        unknown = np.full(3, np.nan)
        leg, masses = self._geometry.leg, self._masses
        if not (np.isfinite(up).all() and np.isfinite(current).all()):
            return unknown
        loads = self._vertical_forces(jacobians, current) / GRAVITY
        mass = loads.sum() - (masses.total - LEG_COUNT * masses.foot_end)
        if mass < -_LIGHT:
            return unknown
        if mass < _LIGHT:
            return np.array((mass, 0.0, 0.0))
        corners = np.einsum("lij,lkj->lki", self._geometry.R_SA, leg_corners(leg, up))
        corners = corners + self._geometry.p_SA[:, None, :]
        place = np.einsum("lk,lki->i", loads, corners)[:2] / mass
        return np.array((mass, *place))

    def _vertical_forces(
        self, jacobians: NDArray[np.float64], current: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(4, 3) vertical forces on the corners that follow from the branches' forces [N]."""
        thrust = self._params.force_per_current * current
        by_branch = -jacobians[..., 2, :]  # (4, corner, branch)
        solved = np.linalg.solve(np.swapaxes(by_branch, -1, -2), thrust[..., None])
        return solved[..., 0]
