"""From the pose that platform or foot is to have to the lengths of the legs."""

import math
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import batch, declare_cached, read, read_batch
from parapod.systems.core.rows import answer_of, common, number_of, shared
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import swung_alone_to, swung_to
from parapod.systems.machining_centre.platform_mode import leg_lengths, within_stroke
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB, closed_locks
from parapod.systems.machining_centre.swing import SingularSwing


class _Led(NamedTuple):
    """Lengths a period from now, what they hold, and whether none were found."""

    lengths: Array
    pose: Array
    foot: Array
    more: Array
    is_stuck: Array


class CentreFeedforward(LeafSystem):
    """Leads the legs so that platform or loose foot go where they are to go.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `mode` | 1 | - | what moves: 0 nothing, 1 the platform, 2 the loose foot |
    | in `target` | 6 | m, rad | of what moves, a period from now |
    | in `toward` | 6 | m, rad | of the platform then, as far as it is open; NaN: no matter |
    | in `loose_limb` | 1 | - | limb whose foot is loose; 0: none |
    | in `feet` | 6n | m, rad | poses of the feet's frames |
    | in `locked_at` | 4n | rad | values at which joints were locked |
    | in `locks_closed` | 4n | 0/1 | which locks are closed |
    | in `pose` | 6 | m, rad | of the platform, as far as is known |
    | in `position_measured` | 2n | m | lengths of the legs |
    | out `position_command` | 2n | m | lengths that the legs are to have a period from now |
    | out `pose_desired` | 6 | m, rad | of the platform now |
    | out `foot_desired` | 6 | m, rad | of the loose foot now; zeros where none is |
    | out `length_error` | 2n | m | lengths of the legs less those that they are to have now |
    | out `is_stuck` | 1 | 0/1 | whether no lengths lead on; the last ones are held |

    Where nothing moves the lengths are held, the first ones that are measured at the beginning,
    and what is desired is what is known. A motion begins from there: its lengths are those of the
    kinematics and, all the time, what the held ones were more, as those of legs that yield are.

    State: discrete; lengths (2n), pose (6) and foot (6) for now, what lengths are more than those
    of the kinematics (2n), and whether there are any (1).

    Bad input: targets out of reach, or not finite, are not followed; where
    nothing moves, what is known is shown as it is.
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        period: float = 0.01,
    ):
        """Creates the system.

        Args:
            geometry: the centre.
            period: between two updates [s].
        """
        super().__init__()
        self.set_name("feedforward")
        n = geometry.limbs
        self._geometry = geometry
        self._ports = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("mode", 1),
                ("target", 6),
                ("toward", 6),
                ("loose_limb", 1),
                ("feet", 6 * n),
                ("locked_at", LOCKS_OF_LIMB * n),
                ("locks_closed", LOCKS_OF_LIMB * n),
                ("pose", 6),
                ("position_measured", 2 * n),
            )
        }
        self.DeclareDiscreteState(4 * n + 13)
        now = {
            self.xd_ticket(),
            *(self._ports[name].ticket() for name in ("pose", "position_measured", "mode")),
            *(self._ports[name].ticket() for name in ("feet", "loose_limb")),
        }
        self._cached = declare_cached(self, "now", self._calc_now, now)
        everything = {port.ticket() for port in self._ports.values()} | {self.xd_ticket()}
        self._led = declare_cached(self, "led", self._calc_led, everything)
        measured = {self._ports["position_measured"].ticket()}
        dependencies, now = {self._led.ticket}, {self._cached.ticket}
        for name, size, calc, tickets in (
            ("position_command", 2 * n, self._calc_command, dependencies),
            ("pose_desired", 6, self._calc_pose, now),
            ("foot_desired", 6, self._calc_foot, now),
            ("length_error", 2 * n, self._calc_error, now | measured),
            ("is_stuck", 1, self._calc_is_stuck, dependencies),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _now(self, context: Context) -> _Led:
        now: _Led = self._cached.value(self, context)
        return now

    def _calc_now(self, context: Context) -> _Led:
        """Lengths and poses that are to be now: where nothing moves, those that are known."""
        state = batch(context.get_discrete_state(0), context)
        legs = self._geometry.legs
        lengths, pose, foot, more, known_lengths = np.split(
            state, np.cumsum((legs, 6, 6, legs)), axis=-1
        )
        is_stuck = np.zeros(state.shape[:-1])
        is_known = answer_of(known_lengths[..., 0] > 0.5)
        if not is_known:
            lengths = read_batch(self._ports["position_measured"], context)
        if is_known and self._mode(context) != 0:
            return _Led(lengths, pose, foot, more, is_stuck)
        pose, feet = read_batch(self._ports["pose"], context), self._feet(context)
        limb = self._whole("loose_limb", context)
        foot = feet[..., limb - 1, :] if self._is_limb(limb) else np.zeros_like(pose)
        more = lengths - leg_lengths(self._geometry, pose, feet)
        return _Led(lengths, pose, foot, more, is_stuck)

    def _mode(self, context: Context) -> int:
        return self._whole("mode", context)

    def _whole(self, name: str, context: Context) -> int:
        """Whole number at an input; 0 if it is not finite."""
        (value,) = read(self._ports[name], context)
        return shared(_rounded, value)

    def _is_limb(self, number: int) -> bool:
        return 1 <= number <= self._geometry.limbs

    def _feet(self, context: Context) -> Array:
        return self._of_limbs("feet", context)

    def _of_limbs(self, name: str, context: Context) -> Array:
        """Values (n, k) at an input."""
        values = read_batch(self._ports[name], context)
        return values.reshape(*values.shape[:-1], self._geometry.limbs, -1)

    def _calc_led(self, context: Context) -> _Led:
        now, mode = self._now(context), self._mode(context)
        if mode == 0:
            return now
        target, feet = read_batch(self._ports["target"], context), self._feet(context)
        stuck = now._replace(is_stuck=np.ones_like(now.is_stuck))
        if mode == 1:
            lengths = leg_lengths(self._geometry, target, feet)
            if not answer_of(within_stroke(self._geometry, lengths).all(axis=-1)):
                return stuck
            return now._replace(lengths=lengths + now.more, pose=target)
        limb = self._whole("loose_limb", context)
        if not self._is_limb(limb):
            return stuck
        values, closed = (self._of_limbs(name, context) for name in ("locked_at", "locks_closed"))
        toward = read_batch(self._ports["toward"], context)
        goal = toward if answer_of(np.isfinite(toward).all(axis=-1)) else None
        which = common(closed > 0.5, 2)
        try:
            locks = closed_locks(self._geometry, limb, values, feet, which)
            if target.ndim > 1:
                swung = swung_alone_to(self._geometry, locks, target, now.pose, goal)
            else:
                one = swung_to(self._geometry, locks, target, now.pose, toward=goal)
                swung = one.lengths, one.pose, one.foot_pose
        except (UnreachablePosture, SingularSwing, ValueError):
            return stuck
        lengths, pose, foot = swung
        if not answer_of(np.isfinite(lengths).all(axis=-1)):
            return stuck
        return now._replace(lengths=lengths + now.more, pose=pose, foot=foot)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        *parts, is_stuck = self._led.value(self, context)
        one = np.ones_like(is_stuck)[..., np.newaxis]
        state.set_value(0, np.concatenate((*parts, one), axis=-1))

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._led.value(self, context).lengths)

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._now(context).pose)

    def _calc_foot(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._now(context).foot)

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        measured = read_batch(self._ports["position_measured"], context)
        output.SetFromVector(measured - self._now(context).lengths)

    def _calc_is_stuck(self, context: Context, output: BasicVector) -> None:
        output[0] = number_of(self._led.value(self, context).is_stuck)


def _rounded(value: float) -> int:
    return round(value) if math.isfinite(value) else 0
