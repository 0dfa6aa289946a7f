"""Guard of the arm's command: no move starts that would bring the platform near to tipping.

Moves of the arm go from rest to rest.
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_on, read
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.statics import KinematicPlatformParams
from parapod.systems.levelling_platform.zero_moment_point import (
    ArmMove,
    Footing,
    Profile,
    move_margin,
    tipping_margin,
)

# Layout of the discrete state, behind start, goal and request of n joints each.
_BEGUN, _DURATION, _MARGIN, _ADMITTED, _ENABLED = -5, -4, -3, -2, -1


@dataclass(frozen=True)
class StabilityMonitorParams:
    """Limits of the arm's moves.

    Attributes:
        margin: smallest distance of the zero-moment point from the edge of the support polygon,
            at rest and moving [m]; None: `usual_margin`.
        rate: largest rates (n) of the arm's joints [rad/s or m/s]; 67.5 deg/s, with which the
            paper's arm swings by 45 deg in a second (section 7; the turntable's is an assumption).
        acceleration: largest accelerations (n) [rad/s^2 or m/s^2]; 270 deg/s^2, those of the same
            swing along a cubic (design choice).
        reach: smallest and largest positions (n) [rad or m]; a turn of the turntable and a quarter
            of one of the arm, either way (assumption).
        profile: shape of moves: "cubic" has a continuous rate, "quintic" a continuous acceleration
            too.
        platform: masses of platform and arm.
    """

    margin: float | None = None
    rate: tuple[float, ...] = (math.radians(67.5), math.radians(67.5))
    acceleration: tuple[float, ...] = (math.radians(270.0), math.radians(270.0))
    reach: tuple[tuple[float, float], ...] = (
        (-2.0 * math.pi, 2.0 * math.pi),
        (-0.5 * math.pi, 0.5 * math.pi),
    )
    profile: Profile = "cubic"
    platform: KinematicPlatformParams = field(default_factory=KinematicPlatformParams)

    def __post_init__(self) -> None:
        counts = {len(limits) for limits in (self.rate, self.acceleration, self.reach)}
        if counts != {self.platform.arm.count}:
            raise ValueError(f"the limits must be those of {self.platform.arm.count} joints")


# Margin by the half distance of the hips across the platform (assumption) [-].
_SHARE = 5.0 / 17.0


def usual_margin(geometry: PlatformGeometry) -> float:
    """Margin that a platform is to have [m]: 50 mm of the paper's.

    Args:
        geometry: the platform.
    """
    narrowest = min(abs(leg.l_y) for leg in geometry.legs)
    return _SHARE * narrowest


class StabilityMonitor(LeafSystem):
    """Tells the arm to go where it is asked to, unless the platform would come near to tipping.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | measured extensions |
    | in `attitude` | 2 | rad | estimated roll and pitch of the platform |
    | in `ground` | 2 | rad | estimated roll and pitch of the ground |
    | in `standing` | 4 | 0/1 | contact switches of the feet |
    | in `arm_request` | n | rad or m | positions of the joints asked for; may jump |
    | in `enable` | 1 | - | above 0.5: moves may begin |
    | out `margin` | 1 | m | `tipping_margin` at present, with the command's motion |
    | out `arm_command` | n | rad or m | command of the arm's joints; C1 in time |
    | out `margin_requested` | 1 | m | smallest margin along the move last asked for |
    | out `refused` | 1 | 0/1 | above 0.5 while the present request is not admitted |

    A platform without an arm has sensors and `margin` alone.

    The command begins at zero. A request is admitted if the zero-moment point stays inside the
    support polygon by the margin along the whole move, both with its accelerations and without
    them; and hence with any between, as the point then lies between the two and the polygon is
    convex. The command then goes there from rest to rest, all joints on one polynomial of time,
    as fast as the largest rates and accelerations allow. A request that is not admitted moves
    nothing, and the command stays where it is; also one that would lead back into the margin
    from outside it, as its acceleration first pushes further out. The platform is taken to
    stand still during the move as it does when the request is judged.

    **When it is judged.** A request is judged when it changes, when `enable` rises, and once more
    before it begins if it had to wait. In between it is not: what was refused stays refused even
    when the feet stand better meanwhile, so that nothing moves without being asked to.

    **During a move** a new request is judged as a move from the present one's goal, and waits
    until that has been reached. The latest one counts.

    **Without `enable`** no move begins; one that is under way goes on to its end (eight seconds
    at most for a whole turn). All of it has been judged, including its end at rest; to stop
    half-way would be a motion with accelerations of its own that has not been judged. A move
    goes on, too, when a foot lifts: `margin` tells.

    State: discrete, start and goal of the move and the request last judged (3n) [rad or m], when
    the move began and its duration (2) [s], the request's margin (1) [m], whether it was admitted
    (1) and whether enabled (1); updated every period.

    Parameters (Context): margin (1), largest rates (n) and accelerations (n), smallest (n) and
    largest (n) positions.

    Bad input: a request that is not finite, or beyond these positions, is refused. A sensor
    that is not finite makes the margin minus infinity, as fewer than three standing feet do, and
    that refuses every request.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: StabilityMonitorParams = StabilityMonitorParams(),
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("stability_monitor")
        self._geometry, self._params = geometry, params
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._attitude = self.DeclareVectorInputPort("attitude", 2)
        self._ground = self.DeclareVectorInputPort("ground", 2)
        self._standing = self.DeclareVectorInputPort("standing", LEG_COUNT)
        self._count = count = params.platform.arm.count
        margin = usual_margin(geometry) if params.margin is None else params.margin
        limits = [margin, *params.rate, *params.acceleration]
        limits += [low for low, _ in params.reach] + [high for _, high in params.reach]
        self._limits = self.DeclareNumericParameter(BasicVector(np.array(limits)))
        self._start, self._goal, self._asked = (
            slice(i * count, (i + 1) * count) for i in range(3)
        )
        initial = np.zeros(3 * count - _BEGUN)
        initial[self._asked], initial[_MARGIN] = math.nan, -math.inf
        state = self.discrete_state_ticket(self.DeclareDiscreteState(initial))
        motion = {state, self.time_ticket()}
        sensors = {
            port.ticket()
            for port in (self._extension, self._attitude, self._ground, self._standing)
        }
        self.DeclareVectorOutputPort("margin", 1, self._calc_margin, motion | sensors)
        if not count:
            return
        self._request = self.DeclareVectorInputPort("arm_request", count)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self.DeclareVectorOutputPort("arm_command", count, self._calc_arm_command, motion)
        self.DeclareVectorOutputPort("margin_requested", 1, self._calc_margin_requested, {state})
        self.DeclareVectorOutputPort("refused", 1, self._calc_refused, {state})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_plan)

    def _calc_arm_command(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        motion = self._move_of(state).at(context.get_time() - state[_BEGUN])
        output.SetFromVector(np.array(motion.position))

    def _calc_margin(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        motion = self._move_of(state).at(context.get_time() - state[_BEGUN])
        output[0] = float(
            tipping_margin(self._geometry, self._params.platform, self._footing(context), motion)
        )

    def _calc_margin_requested(self, context: Context, output: BasicVector) -> None:
        output[0] = elements(context.get_discrete_state_vector())[_MARGIN]

    def _calc_refused(self, context: Context, output: BasicVector) -> None:
        output[0] = 1.0 - elements(context.get_discrete_state_vector())[_ADMITTED]

    def _update_plan(self, context: Context, discrete_state: Any) -> None:
        state = elements(context.get_discrete_state_vector())
        request = read(self._request, context)
        was_enabled, enabled = state[_ENABLED] > 0.5, is_on(self._enable, context)
        state[_ENABLED] = float(enabled)
        # A request that is NaN differs from every other, and is refused again.
        is_judged = state[self._asked] == request and (was_enabled or not enabled)
        if not is_judged:
            state[self._asked] = request
            self._judge(context, state)
        now = context.get_time()
        if (
            enabled
            and state[_ADMITTED] > 0.5
            and state[self._goal] != request
            and now >= state[_BEGUN] + state[_DURATION]
        ):
            if is_judged:
                self._judge(context, state)
            if state[_ADMITTED] > 0.5:
                move = self._requested_move(context, state)
                state[self._start], state[self._goal] = move.start, move.goal
                state[_BEGUN], state[_DURATION] = now, move.duration
        discrete_state.set_value(np.array(state))

    def _judge(self, context: Context, state: list[float]) -> None:
        """Sets the margin of the request in this state, and whether it is admitted."""
        limits = self._limits_in(context)
        margin = -math.inf
        # False for NaN.
        if all(
            low <= request <= high
            for request, low, high in zip(
                state[self._asked], limits.lower, limits.upper, strict=True
            )
        ):
            move, footing = self._requested_move(context, state), self._footing(context)
            margin = min(
                move_margin(self._geometry, self._params.platform, footing, move, accelerated)
                for accelerated in (True, False)
            )
        state[_MARGIN], state[_ADMITTED] = margin, float(margin >= limits.margin)

    def _limits_in(self, context: Context) -> "_Limits":
        margin, *rest = elements(context.get_numeric_parameter(self._limits))
        n = self._count
        return _Limits(margin, *(tuple(rest[i * n : (i + 1) * n]) for i in range(4)))

    def _requested_move(self, context: Context, state: list[float]) -> ArmMove:
        """The move from where the present one ends to the request of this state."""
        limits = self._limits_in(context)
        return ArmMove.within(
            tuple(state[self._goal]),
            tuple(state[self._asked]),
            limits.rate,
            limits.acceleration,
            self._params.profile,
        )

    def _move_of(self, state: list[float]) -> ArmMove:
        """The move that is under way or was the last one."""
        start, goal = tuple(state[self._start]), tuple(state[self._goal])
        return ArmMove(start, goal, state[_DURATION], self._params.profile)

    def _footing(self, context: Context) -> Footing:
        return Footing(
            read(self._extension, context),
            read(self._attitude, context),
            read(self._ground, context),
            read(self._standing, context),
        )


class _Limits(NamedTuple):
    """The parameters of a Context."""

    margin: float
    rate: tuple[float, ...]
    acceleration: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
