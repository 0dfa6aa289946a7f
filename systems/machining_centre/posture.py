"""Places of platform and feet, from the legs' lengths and what is clamped and locked.

Clamped feet stay where they were clamped, and locked joints keep the values at which they were
locked: so the centre knows where it has walked. The same reckoning is a plant without dynamics.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import batch, declare_cached, read_batch
from parapod.systems.core.rows import common, number_of
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    feet_of,
    forward_kinematics,
    poses_alone,
)
from parapod.systems.machining_centre.swing import (
    LOCKABLE,
    Locks,
    LockSet,
    SingularSwing,
    swing_forward,
    swung_alone,
)

LOCKS_OF_LIMB = len(LOCKABLE)
# Newton's method ends with a step that leaves some micrometres at most, and nothing at rest [m].
_LAST_STEP = 2e-3
_INDICES = [joint - 1 for joint in LOCKABLE]


class Posture(NamedTuple):
    """Platform and feet.

    Attributes:
        pose: (6) of the platform [m, rad].
        feet: (n, 6) of the feet's frames [m, rad].
    """

    pose: Array
    feet: Array


def lockable_joints(geometry: CentreGeometry, posture: Posture) -> Array:
    """(n, 4) values of the joints that carry locks, q_1, q_2, q_3 and q_6 of each limb [rad]."""
    return branch_joints(geometry, posture.pose, posture.feet, along="left")[..., _INDICES]


def closed_locks(
    geometry: CentreGeometry, limb: int, values: Array, feet: Array, closed: NDArray[np.bool_]
) -> Locks:
    """The locks that are closed while a limb is loose.

    Args:
        geometry: the centre.
        limb: the loose limb, counted from 1; its own locks are taken to be closed.
        values: (n, 4) at which joints were locked, or those of each row [rad].
        feet: (n, 6) poses of the feet's frames, or those of each row [m, rad].
        closed: (n, 4) which locks are.

    Raises:
        ValueError: fewer locks than hold the platform.
    """
    standing = tuple(
        (other, joint)
        for other in range(1, geometry.limbs + 1)
        for k, joint in enumerate(LOCKABLE)
        if other != limb and closed[other - 1, k]
    )
    lock_set = LockSet(limb, standing)
    lock_set.check(geometry)
    chosen = [values[..., other - 1, LOCKABLE.index(joint)] for other, joint in lock_set.joints]
    return Locks(lock_set, np.stack(chosen, axis=-1), feet, "left")


def posture_of(
    geometry: CentreGeometry,
    lengths: Array,
    before: Posture,
    values: Array,
    locked: NDArray[np.bool_],
    clamped: NDArray[np.bool_],
) -> Posture | None:
    """Platform and feet at lengths near a posture before; None if nothing determines them.

    Args:
        geometry: the centre.
        lengths: (2n) of the legs [m].
        before: a moment ago.
        values: (n, 4) at which joints were locked [rad].
        locked: (n, 4) which locks are closed.
        clamped: (n) which feet are clamped.
    """
    loose = np.flatnonzero(~clamped) + 1
    if not np.isfinite(lengths).all() or len(loose) > 1:
        return None
    try:
        if len(loose) == 0:
            pose = forward_kinematics(
                geometry, lengths, before.pose, before.feet, last_step=_LAST_STEP * geometry.size
            )
            return Posture(pose.pose, before.feet) if np.isfinite(pose.pose).all() else None
        (limb,) = map(int, loose)
        if not locked[limb - 1].all():
            return None
        locks = closed_locks(geometry, limb, values, before.feet, locked)
        last = _LAST_STEP * geometry.size
        swung = swing_forward(geometry, lengths, locks, before.pose, last_step=last)
    except (SingularSwing, ValueError):  # too few locks, or legs that do not meet
        return None
    feet = before.feet.copy()
    feet[limb - 1] = swung.foot_pose
    return Posture(swung.pose, feet)


def _postures_of(
    geometry: CentreGeometry,
    lengths: Array,
    before: Posture,
    values: Array,
    locked: NDArray[np.bool_],
    clamped: NDArray[np.bool_],
) -> tuple[Posture, NDArray[np.bool_]]:
    """Postures by `posture_of`, or those before, and whether they are determined.

    Arguments may be those of rows, but for `clamped`; rows with other locks part.
    """
    if lengths.ndim == 1:
        posture = posture_of(geometry, lengths, before, values, locked, clamped)
        return posture or before, np.array(posture is not None)
    loose, last = np.flatnonzero(~clamped).tolist(), _LAST_STEP * geometry.size
    (poses, feet), nowhere = before, (before, np.zeros(len(lengths), dtype=np.bool_))
    if not loose:
        poses = poses_alone(geometry, lengths, poses, feet, last)
    elif len(loose) > 1 or not (closed := common(locked, 2))[loose].all():
        return nowhere
    else:
        try:
            locks = closed_locks(geometry, loose[0] + 1, values, feet, closed)
        except ValueError:  # too few locks
            return nowhere
        feet = feet.copy()
        poses, feet[:, loose[0]] = swung_alone(geometry, lengths, locks, poses, last)
    is_determined = np.isfinite(poses).all(axis=-1) & np.isfinite(feet).all(axis=(-2, -1))
    chosen = is_determined[:, np.newaxis]
    return Posture(
        np.where(chosen, poses, before.pose),
        np.where(chosen[..., np.newaxis], feet, before.feet),
    ), is_determined


class _Found(NamedTuple):
    """Posture, values at which joints are locked, which are, and whether it is determined."""

    posture: Posture
    values: Array
    locked: NDArray[np.bool_]
    is_determined: NDArray[np.bool_]


class CentrePosture(LeafSystem):
    """Follows platform and feet by the legs' lengths.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 2n | m | lengths of the legs |
    | in `locks_closed` | 4n | 0/1 | locks of q_1, q_2, q_3, q_6 of each limb |
    | in `clamps_closed` | n | 0/1 | clamps of the feet |
    | out `pose` | 6 | m, rad | x, y, z, roll, pitch, yaw of the platform |
    | out `feet` | 6n | m, rad | the same of each foot |
    | out `joints` | 4n | rad | q_1, q_2, q_3, q_6 of each limb, along its left leg |
    | out `locked_at` | 4n | rad | values at which joints were locked last |
    | out `is_determined` | 1 | 0/1 | whether lengths, locks and clamps determine all this |

    Lengths must be known often enough for one posture to be near the next.

    State: discrete; pose (6), feet (6n), values at which joints were locked (4n), which locks were
    closed (4n), and whether the posture was determined (1), updated every period.

    Bad input: where nothing determines the posture, as with two loose feet or lengths that are
    not finite, the last one stays, and `is_determined` is 0.
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        period: float = 0.01,
        pose: ArrayLike = (0.0, 0.0, 0.48, 0.0, 0.0, 0.0),
        footholds: ArrayLike | None = None,
        is_sampled: bool = False,
    ):
        """Creates the system.

        Args:
            geometry: the centre.
            period: between two updates [s].
            pose: (6) of the platform near which it begins in a default context [m, rad].
            footholds: (n, 6) on which it stands there; None for the paper's pattern.
            is_sampled: true if the outputs are those of the last update.
        """
        super().__init__()
        self.set_name("centre_posture")
        self._geometry, n = geometry, geometry.limbs
        self._position = self.DeclareVectorInputPort("position", geometry.legs)
        self._locks = self.DeclareVectorInputPort("locks_closed", LOCKS_OF_LIMB * n)
        self._clamps = self.DeclareVectorInputPort("clamps_closed", n)
        self.DeclareDiscreteState(_beginning(geometry, pose, footholds))
        inputs = {port.ticket() for port in (self._position, self._locks, self._clamps)}
        self._found = declare_cached(self, "posture", self._calc, inputs | {self.xd_ticket()})
        state_entry = declare_cached(self, "shown", self._calc_shown, {self.xd_ticket()})
        self._shown = state_entry if is_sampled else self._found
        for name, size, calc in (
            ("pose", 6, self._calc_pose),
            ("feet", 6 * n, self._calc_feet),
            ("joints", LOCKS_OF_LIMB * n, self._calc_joints),
            ("locked_at", LOCKS_OF_LIMB * n, self._calc_locked_at),
            ("is_determined", 1, self._calc_is_determined),
        ):
            self.DeclareVectorOutputPort(name, size, calc, {self._shown.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def stand(
        self, root_context: Context, pose: ArrayLike, footholds: ArrayLike | None = None
    ) -> None:
        """Puts it on footholds, at a pose nearby, with all locks open."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.SetDiscreteState(_beginning(self._geometry, pose, footholds))

    def _calc_shown(self, context: Context) -> _Found:
        """Finding of the last update."""
        n, locks = self._geometry.limbs, LOCKS_OF_LIMB * self._geometry.limbs
        state = batch(context.get_discrete_state(0), context)
        pose, feet, values, locked, is_determined = np.split(
            state, np.cumsum((6, 6 * n, locks, locks)), axis=-1
        )
        shape = *state.shape[:-1], n, -1
        posture = Posture(pose, feet.reshape(shape))
        return _Found(
            posture,
            values.reshape(shape),
            locked.reshape(shape) > 0.5,
            is_determined[..., 0] > 0.5,
        )

    def _calc(self, context: Context) -> _Found:
        before, values, was, _ = self._calc_shown(context)
        locked = (read_batch(self._locks, context) > 0.5).reshape(was.shape)
        clamped = common(read_batch(self._clamps, context) > 0.5)
        closing = locked & ~was
        if closing.any():  # at the values that they had a moment ago
            values = np.where(closing, lockable_joints(self._geometry, before), values)
        lengths = read_batch(self._position, context)
        posture, is_determined = _postures_of(
            self._geometry, lengths, before, values, locked, clamped
        )
        return _Found(posture, values, locked, is_determined)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        posture = self._found.value(self, context)
        pose, feet = posture.posture
        parts = (pose, *map(_flat, (feet, posture.values, posture.locked)))
        state.set_value(
            0, np.concatenate((*parts, posture.is_determined[..., np.newaxis]), axis=-1)
        )

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._shown.value(self, context).posture.pose)

    def _calc_feet(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(_flat(self._shown.value(self, context).posture.feet))

    def _calc_joints(self, context: Context, output: BasicVector) -> None:
        posture = self._shown.value(self, context).posture
        output.SetFromVector(_flat(lockable_joints(self._geometry, posture)))

    def _calc_locked_at(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(_flat(self._shown.value(self, context).values))

    def _calc_is_determined(self, context: Context, output: BasicVector) -> None:
        output[0] = number_of(self._shown.value(self, context).is_determined.astype(float))


def _flat(of_limbs: NDArray[Any]) -> NDArray[Any]:
    """Values (n, k) of the limbs as a vector, of one centre or of rows of them."""
    return of_limbs.reshape(*of_limbs.shape[:-2], -1)


def _beginning(geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None) -> Array:
    feet = feet_of(geometry, footholds)
    nothing = np.zeros(2 * LOCKS_OF_LIMB * geometry.limbs)
    return np.concatenate((np.asarray(pose, dtype=float), feet.ravel(), nothing, (1.0,)))
