"""From the pose that platform or foot is to have to the lengths of the legs."""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.ports import declare_cached, read, read_array
from parapod.systems.core.vectors import Array
from parapod.systems.machining_center.geometry import CenterGeometry
from parapod.systems.machining_center.job import Job, swung_to
from parapod.systems.machining_center.platform_mode import inverse_kinematics
from parapod.systems.machining_center.posture import LOCKS_OF_LIMB, closed_locks
from parapod.systems.machining_center.swing import SingularSwing


class _Led(NamedTuple):
    """Lengths a period from now, what they hold, and whether none were found."""

    lengths: Array
    pose: Array
    foot: Array
    is_stuck: bool


class CenterFeedforward(LeafSystem):
    """Leads the legs so that platform or loose foot go where they are to go.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `mode` | 1 | - | what moves: 0 nothing, 1 the platform, 2 the loose foot |
    | in `target` | 6 | m, rad | of what moves, a period from now |
    | in `share` | 1 | - | of its motion that has passed then |
    | in `loose_limb` | 1 | - | limb whose foot is loose; 0: none |
    | in `feet` | 6n | m, rad | poses of the feet's frames |
    | in `locked_at` | 4n | rad | values at which joints were locked |
    | in `locks_closed` | 4n | 0/1 | which locks are closed |
    | in `pose_measured` | 6 | m, rad | of the platform, with which the first update begins |
    | in `position_measured` | 2n | m | lengths of the legs |
    | out `position_command` | 2n | m | lengths that the legs are to have a period from now |
    | out `pose_desired` | 6 | m, rad | of the platform now |
    | out `foot_desired` | 6 | m, rad | of the loose foot now, or the last one |
    | out `length_error` | 2n | m | lengths of the legs less those that they are to have now |
    | out `is_stuck` | 1 | 0/1 | whether no lengths lead on; the last ones are held |

    Where nothing moves the lengths are held: it begins with those that are measured first.

    State: discrete; lengths (2n), pose (6) and foot (6) for now, and whether there are any (1).

    Bad input: targets that no lengths reach, or that are no numbers, are not followed.
    """

    def __init__(
        self,
        geometry: CenterGeometry = CenterGeometry(),
        job: Job | None = None,
        period: float = 0.01,
    ):
        """Creates the system.

        Args:
            geometry: the centre.
            job: its drift is taken.
            period: between two updates [s].
        """
        super().__init__()
        self.set_name("feedforward")
        n = geometry.limbs
        self._geometry, self._job, self._period = geometry, job or Job(), period
        self._ports = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("mode", 1),
                ("target", 6),
                ("share", 1),
                ("loose_limb", 1),
                ("feet", 6 * n),
                ("locked_at", LOCKS_OF_LIMB * n),
                ("locks_closed", LOCKS_OF_LIMB * n),
                ("pose_measured", 6),
                ("position_measured", 2 * n),
            )
        }
        self.DeclareDiscreteState(2 * n + 13)
        everything = {port.ticket() for port in self._ports.values()} | {self.xd_ticket()}
        self._led = declare_cached(self, "led", self._calc_led, everything)
        led = {self._led.ticket}
        now = {
            self.xd_ticket(),
            self._ports["pose_measured"].ticket(),
            self._ports["position_measured"].ticket(),
        }
        for name, size, calc, tickets in (
            ("position_command", 2 * n, self._calc_command, led),
            ("pose_desired", 6, self._calc_pose, now),
            ("foot_desired", 6, self._calc_foot, now),
            ("length_error", 2 * n, self._calc_error, now),
            ("is_stuck", 1, self._calc_is_stuck, led),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _now(self, context: Context) -> _Led:
        """What is to be now; at the beginning what is measured."""
        state: Any = context.get_discrete_state(0).value()
        legs = self._geometry.legs
        lengths, pose, foot, known = np.split(state, (legs, legs + 6, legs + 12))
        if known[0] > 0.5:
            return _Led(lengths.copy(), pose.copy(), foot.copy(), False)
        lengths = read_array(self._ports["position_measured"], context)
        return _Led(lengths, read_array(self._ports["pose_measured"], context), np.zeros(6), False)

    def _calc_led(self, context: Context) -> _Led:
        now, ports = self._now(context), self._ports
        mode = round(read(ports["mode"], context)[0])
        if mode == 0:
            return now
        target = read_array(ports["target"], context)
        feet = read_array(ports["feet"], context).reshape(-1, 6)
        try:
            if mode == 1:
                return _Led(
                    inverse_kinematics(self._geometry, target, feet), target, now.foot, False
                )
            return self._swung(context, now, target, feet)
        except (UnreachablePosture, SingularSwing):
            return now._replace(is_stuck=True)

    def _swung(self, context: Context, now: _Led, target: Array, feet: Array) -> _Led:
        ports, n = self._ports, self._geometry.limbs
        limb = round(read(ports["loose_limb"], context)[0])
        values = read_array(ports["locked_at"], context).reshape(n, -1)
        closed = read_array(ports["locks_closed"], context).reshape(n, -1) > 0.5
        locks = closed_locks(self._geometry, limb, values, feet, closed)
        share = read(ports["share"], context)[0]
        found = swung_to(self._geometry, self._job, locks, target, now.pose, share, self._period)
        return _Led(found.lengths, found.pose, found.foot_pose, False)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        lengths, pose, foot, _ = self._led.of(self, context)
        state.set_value(0, np.concatenate((lengths, pose, foot, (1.0,))))

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._led.of(self, context).lengths)

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._now(context).pose)

    def _calc_foot(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._now(context).foot)

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        measured = read_array(self._ports["position_measured"], context)
        output.SetFromVector(measured - self._now(context).lengths)

    def _calc_is_stuck(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._led.of(self, context).is_stuck)
