"""The arm's tip led to points: coarse by arm, turntable and posture, fine by the legs."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.background import Background
from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import (
    elements,
    has_value,
    is_on,
    read,
    read_array,
    read_or_zeros,
)
from parapod.systems.core.remembered import Remembered
from parapod.systems.levelling_platform.carried_arm import (
    BarredTip,
    CarriedArm,
    Reach,
    UnreachableTip,
)
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import normal_of, to_platform

# Numbers of a point, and of a point with a direction of view.
_POINT, _POINT_AND_VIEW = 3, 6
# Singular values of the Jacobian, by the largest, that count [-].
_SMALLEST = 1e-3
# Payload that no tip bears [kg].
_HEAVIEST = 1e4
# Reference that has come to its command [rad or m]; rate at rest [rad/s or m/s].
_THERE, _AT_REST = 1e-6, 1e-9
_NOWHERE = np.full(7, math.nan)  # pose that is not known


class _Answer(NamedTuple):
    """Consequences of a command.

    Attributes:
        goal: point (3) that is aimed at [m].
        reach: posture and joints for it; None: they stay.
        refusal: why that is not the point of the command; None: it is.
    """

    goal: NDArray[np.float64]
    reach: Reach | None
    refusal: UnreachableTip | BarredTip | None


def _answer(
    standing: Callable[..., CarriedArm], question: list[float], joints: list[float]
) -> _Answer:
    """Posture and joints for a command, or for the nearest point of one out of reach.

    Args:
        standing: platform and arm by the ground (2) and its offsets (4).
        question: command, ground and offsets (w + 6).
        joints: positions (n) at which the arm is [rad or m].
    """
    end = len(question) - LEG_COUNT
    carried = standing(question[end - 2 : end], question[end:])
    goal, view = np.array(question[:_POINT]), question[_POINT : end - 2] or None
    try:
        return _Answer(goal, carried.reach(goal, joints, view), None)
    except UnreachableTip as error:
        with suppress(UnreachableTip, BarredTip):
            return _Answer(error.nearest, carried.reach(error.nearest, joints), error)
        return _Answer(goal, None, error)
    except BarredTip as error:
        return _Answer(goal, None, error)


class TipFeedforward(LeafSystem):
    """Posture, turntable and arm for a point at which the tip is wanted.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `tip_command` | w | m | point in the world; with a view, its direction behind it |
    | in `ground` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
    | in `enable` | 1 | - | above 0.5: follow commands |
    | out `tip_goal` | 3 | m | point that is aimed at; NaN before the first |
    | out `posture_command` | 3 | rad, rad, m | posture of the platform |
    | out `arm_request` | n | rad or m | positions of the arm's joints |
    | out `tip_refused` | 1 | 0/1 | 1 while the command is not what is aimed at |
    | out `tip_answered` | 1 | 0/1 | 1 while all this is the answer to the command |

    w is 3, or 6 with a direction of view. Each new command, and each new estimate of the ground,
    is answered once, by `CarriedArm.reach` from where the arm was last told to be: the answer may
    jump, and what follows it, `PostureReference` and `StabilityMonitor`, does not.

    The answer comes `answer_delay` after the question. What is asked for meanwhile waits for it,
    and the newest of that is the next question; all before it is dropped. With `in_background`
    another process works out the answer, and no update waits for it: while it is not there in
    time, the outputs stay. Then the time of an answer depends on the computer, and nothing else.

    A point out of reach ends the simulation with `UnreachableTip`, before anything moves towards
    it, or with `on_unreachable="clamp"` the nearest point is aimed at. One that stability or the
    machine's parts forbid ends it with `BarredTip`, or changes nothing.

    State: discrete, each output but the last; command, ground and offsets answered last (w + 6),
    those of the question (w + 6), and when its answer is due (1) [s], infinite without a question;
    updated every period. Without `enable` there is none.

    Bad input: a command or ground that is not finite changes nothing.
    """

    def __init__(
        self,
        carried: CarriedArm,
        height: float,
        has_view: bool = False,
        on_unreachable: Literal["raise", "clamp"] = "raise",
        period: float = 0.01,
        answer_delay: float = 0.0,
        in_background: bool = False,
    ):
        """Creates the system.

        Args:
            carried: platform and arm; their ground is what the inputs say.
            height: height of the level platform until there is a command [m].
            has_view: true if commands have a direction of view.
            on_unreachable: reaction to a command that cannot be.
            period: period of the updates [s].
            answer_delay: time from a question to its answer [s].
            in_background: true for a machine in real time.
        """
        if on_unreachable not in ("raise", "clamp"):
            raise ValueError(f'on_unreachable must be "raise" or "clamp", not {on_unreachable!r}')
        super().__init__()
        self.set_name("tip_feedforward")
        self._on_unreachable, self._delay = on_unreachable, answer_delay
        self._in_background = in_background
        answer = partial(_answer, Remembered(partial(_on, carried)))
        self._answer: Callable[..., _Answer | None] = (
            Background(answer) if in_background else answer
        )
        width = _POINT_AND_VIEW if has_view else _POINT
        self._command = self.DeclareVectorInputPort("tip_command", width)
        self._ground = self.DeclareVectorInputPort("ground", 2)
        self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        outputs: tuple[tuple[str, Sequence[float]], ...] = (
            ("tip_goal", [math.nan] * 3),
            ("posture_command", [0.0, 0.0, height]),
            ("arm_request", [0.0] * carried.arm.count),
            ("tip_refused", [0.0]),
        )
        states: dict[str, Any] = {
            name: self.DeclareDiscreteState(np.array(start)) for name, start in outputs
        }
        for name, state in states.items():
            self.DeclareStateOutputPort(name, state)
        self._goal, self._posture, self._joints, self._refused = (
            states[name] for name, _ in outputs
        )
        never = np.full(width + 2 + LEG_COUNT, math.nan)
        self._answered: Any = self.DeclareDiscreteState(never)
        self._question: Any = self.DeclareDiscreteState(never)
        self._due: Any = self.DeclareDiscreteState(np.array([math.inf]))
        self.DeclareVectorOutputPort(
            "tip_answered",
            1,
            self._calc_answered,
            {self._command.ticket(), self.discrete_state_ticket(self._answered)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_answer)

    def _calc_answered(self, context: Context, output: BasicVector) -> None:
        command = read(self._command, context)
        answered = elements(context.get_discrete_state(self._answered))
        output[0] = float(command == answered[: len(command)])

    def _update_answer(self, context: Context, state: Any) -> None:
        now, due = context.get_time(), context.get_discrete_state(self._due)[0]
        if not is_on(self._enable, context):
            state.set_value(self._due, np.array([math.inf]))
            return
        question = elements(context.get_discrete_state(self._question))
        if due == math.inf:
            question = read(self._command, context) + read(self._ground, context)
            question += read_or_zeros(self._offsets, context)
            answered = elements(context.get_discrete_state(self._answered))
            if not all_finite(question) or question == answered:
                return
            due = now + self._delay
            state.set_value(self._question, np.array(question))
            state.set_value(self._due, np.array([due]))
        is_due = now >= due - 1e-9
        if is_due or self._in_background:  # which begins with a question as soon as it can
            answer = self._answer(question, elements(context.get_discrete_state(self._joints)))
            if is_due and answer is not None:
                self._take(question, answer, state)

    def _take(self, question: list[float], answer: _Answer, state: Any) -> None:
        """Aims at what a question is answered by."""
        if answer.refusal is not None and self._on_unreachable == "raise":
            raise answer.refusal
        state.set_value(self._due, np.array([math.inf]))
        state.set_value(self._answered, np.array(question))
        state.set_value(self._refused, np.array([float(answer.refusal is not None)]))
        if answer.reach is not None:
            state.set_value(self._goal, answer.goal)
            state.set_value(self._posture, answer.reach.solution.posture)
            state.set_value(self._joints, answer.reach.solution.joints)


@dataclass(frozen=True)
class TipLoopParams:
    """Design of the fine correction by the legs.

    Attributes:
        gain: k of the correction's rate [1/s]; the loop's crossover in rad/s.
        angle_limit: largest correction of roll and pitch, either way [rad].
        height_limit: largest correction of the height, either way [m].
        tolerance: distance from the point at which the tip has arrived, as estimated [m].
        patience: time at the end of which it has arrived wherever it is [s].
        arm_tolerance: difference of a joint from its request with which the arm has come to rest
            [rad or m].
    """

    gain: float = 2.0
    angle_limit: float = math.radians(2.0)
    height_limit: float = 0.02
    tolerance: float = 5e-4
    patience: float = 3.0
    arm_tolerance: float = 2e-3


class TipLoop(LeafSystem):
    """Correction of the posture by which the legs bring the tip to its point, as it is measured.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `posture_desired_state` | 6 | rad, rad, m and rates | reference of the posture |
    | in `posture_command` | 3 | rad, rad, m | posture to which the reference leads |
    | in `tip_goal` | 3 | m | point at which the tip is wanted |
    | in `arm_request` | n | rad or m | positions of the joints asked for |
    | in `arm_position` | n | rad or m | measured positions |
    | in `attitude` | 2 | rad | estimated roll and pitch of the platform |
    | in `extension_measured` | 4 | m | measured extensions |
    | in `ground` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
    | in `payload` | 1 | kg | mass that the tip is known to bear besides; unconnected: 0 |
    | in `tip_answered` | 1 | - | above 0.5: the goal is that of the command; unconnected: always |
    | in `enable` | 1 | - | above 0.5: correct; otherwise the correction is zero |
    | out `posture_corrected_state` | 6 | rad, rad, m and rates | what the legs are asked for |
    | out `posture_measured` | 3 | rad, rad, m | roll, pitch and height, as all of these see them |
    | out `platform_pose_measured` | 7 | -, m | quaternion and place; NaN unless enabled |
    | out `tip_estimated` | 3 | m | the tip, as all of these see it |
    | out `tip_arrived` | 1 | 0/1 | 1 once the tip is at its point, or comes no nearer |

    The tip follows from the measured joints, the estimated attitude, the sag at rest and what the
    drives give way, under a payload too. The platform's height is the median of what its four legs
    tell on their own: one of them may stand on ground that has given way. While reference and arm
    are at rest, the correction of roll, pitch and height moves at k J^-1 times what the tip
    misses, with the Jacobian J of the tip by the posture. During moves it stays: most of what it
    makes good, legs that are not built as drawn, is there again.

    A direction of view is not corrected: the legs have three freedoms, and the point takes them.

    State: discrete, the correction (3) [rad, rad, m], whether arrived (1) and since when reference
    and arm are at rest (1) [s]; updated every period.

    Bad input: with a goal or a measurement that is not finite the correction stays, and so it does
    where the legs would leave their stroke; a desired state that is not finite is passed on.
    """

    def __init__(
        self,
        carried: CarriedArm,
        params: TipLoopParams = TipLoopParams(),
        period: float = 0.01,
    ):
        """Creates the system.

        Args:
            carried: platform and arm; their ground is what the inputs say.
            params: design of the loop.
            period: period of the updates [s].
        """
        super().__init__()
        self.set_name("tip_loop")
        self._params, self._period, self._legs = params, period, carried.geometry.legs
        self._on = Remembered(partial(_on, carried))
        # Of its own, lest one with a payload and one without take turns.
        self._unloaded = Remembered(partial(_on, carried))
        self._pull = Remembered(partial(_pull, self._on))
        count = carried.arm.count
        sizes = (
            ("posture_desired_state", 6),
            ("posture_command", 3),
            ("tip_goal", 3),
            ("arm_request", count),
            ("arm_position", count),
            ("attitude", 2),
            ("extension_measured", LEG_COUNT),
            ("ground", 2),
            ("foot_offsets", LEG_COUNT),
            ("payload", 1),
            ("tip_answered", 1),
            ("enable", 1),
        )
        ports = {name: self.DeclareVectorInputPort(name, size) for name, size in sizes}
        self._ports = ports
        self._enable = ports["enable"]
        self._correction: Any = self.DeclareDiscreteState(3)
        self._arrived: Any = self.DeclareDiscreteState(1)
        self._since: Any = self.DeclareDiscreteState(np.array([math.inf]))
        standing = {
            ports[name].ticket()
            for name in ("attitude", "extension_measured", "ground", "foot_offsets")
        }
        self.DeclareVectorOutputPort(
            "posture_corrected_state",
            6,
            self._calc_corrected_state,
            {
                ports["posture_desired_state"].ticket(),
                self.discrete_state_ticket(self._correction),
            },
        )
        self._posture: Any = self.DeclareVectorOutputPort(
            "posture_measured", 3, self._calc_posture, standing
        )
        enabled = standing | {self._enable.ticket()}
        self.DeclareVectorOutputPort("platform_pose_measured", 7, self._calc_pose, enabled)
        sensors = standing | {ports[name].ticket() for name in ("arm_position", "payload")}
        self._estimated: Any = self.DeclareVectorOutputPort(
            "tip_estimated", 3, self._calc_tip, sensors
        )
        self.DeclareStateOutputPort("tip_arrived", self._arrived)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_correction)

    def _calc_corrected_state(self, context: Context, output: BasicVector) -> None:
        posture = read(self._ports["posture_desired_state"], context)
        correction = elements(context.get_discrete_state(self._correction))
        for i, by in enumerate(correction):
            posture[i] += by
        output.SetFromVector(np.array(posture))

    def _calc_tip(self, context: Context, output: BasicVector) -> None:
        posture = read_array(self._posture, context)
        joints = read_array(self._ports["arm_position"], context)
        (payload,) = read_or_zeros(self._ports["payload"], context)
        if not (all_finite([*posture, *joints]) and abs(payload) < _HEAVIEST):
            output.SetFromVector(np.full(3, math.nan))
            return
        output.SetFromVector(self._standing(context).tip_position(posture, joints))

    def _standing(self, context: Context) -> CarriedArm:
        """Platform and arm on the ground as it is estimated, with what the tip bears."""
        payload = read_or_zeros(self._ports["payload"], context)
        return self._on(*self._ground(context), payload)

    def _ground(self, context: Context) -> tuple[list[float], list[float]]:
        """Roll and pitch (2) of the ground, and offsets (4) of the feet above it."""
        offsets = read_or_zeros(self._ports["foot_offsets"], context)
        return read(self._ports["ground"], context), offsets

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        posture = read_array(self._posture, context).tolist()
        is_known = is_on(self._enable, context) and all_finite(posture)
        if not is_known:
            output.SetFromVector(_NOWHERE)
            return
        output.SetFromVector(self._unloaded(*self._ground(context)).platform_pose(posture))

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        attitude = read(self._ports["attitude"], context)
        extension = read(self._ports["extension_measured"], context)
        ground, offsets = self._ground(context)
        x, y, z = to_platform(normal_of(*ground), *attitude)
        heights = []
        for leg, d, offset in zip(self._legs, extension, offsets, strict=True):
            p_x, p_y, p_z = foot_to_centre(leg, d)
            heights.append(x * p_x + y * p_y + z * p_z + leg.foot_radius + offset)
        _, low, high, _ = sorted(heights)
        output.SetFromVector(np.array([*attitude, 0.5 * (low + high)]))

    def _update_correction(self, context: Context, state: Any) -> None:
        now = context.get_time()
        if not is_on(self._enable, context):
            state.set_value(self._correction, np.zeros(3))
            state.set_value(self._arrived, np.zeros(1))
            state.set_value(self._since, np.array([math.inf]))
            return
        goal = read_array(self._ports["tip_goal"], context)
        missed: NDArray[np.float64] = goal - read_array(self._estimated, context)
        if not self._is_at_rest(context) or not all_finite(missed):
            state.set_value(self._arrived, np.zeros(1))
            state.set_value(self._since, np.array([math.inf]))
            return
        since = min(now, context.get_discrete_state(self._since)[0])
        state.set_value(self._since, np.array([since]))
        has_waited = now - since >= self._params.patience
        is_near = float(np.linalg.norm(missed)) <= self._params.tolerance
        was_there = context.get_discrete_state(self._arrived)[0] > 0.5
        answered = self._ports["tip_answered"]
        is_asked_for = not has_value(answered, context) or is_on(answered, context)
        has_arrived = is_asked_for and (is_near or has_waited or was_there)
        state.set_value(self._arrived, np.array([float(has_arrived)]))
        correction = context.get_discrete_state(self._correction).CopyToVector()
        correction = self._moved(context, correction, missed)
        state.set_value(self._correction, correction)

    def _is_at_rest(self, context: Context) -> bool:
        """Tell whether the reference has come to its command, and the arm to its request."""
        desired = read(self._ports["posture_desired_state"], context)
        command = read(self._ports["posture_command"], context)
        request = read(self._ports["arm_request"], context)
        position = read(self._ports["arm_position"], context)
        moves = [abs(rate) for rate in desired[3:]]
        ways = [abs(a - b) for a, b in zip(desired[:3], command, strict=True)]
        turns = [abs(a - b) for a, b in zip(request, position, strict=True)]
        return (
            max(moves) < _AT_REST
            and max(ways) < _THERE
            and max(turns, default=0.0) < self._params.arm_tolerance
        )

    def _moved(
        self, context: Context, correction: NDArray[np.float64], missed: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The correction a period later."""
        params, carried = self._params, self._standing(context)
        pull = self._pull(
            read(self._ports["posture_command"], context),
            read(self._ports["arm_request"], context),
            list(carried.ground),
            list(carried.foot_offsets),
            read_or_zeros(self._ports["payload"], context),
        )
        step = params.gain * self._period * (pull @ missed)
        limit = np.array([params.angle_limit, params.angle_limit, params.height_limit])
        moved = np.clip(correction + step, -limit, limit)
        desired = read_array(self._ports["posture_desired_state"], context)[:3]
        reached = inverse_kinematics(
            carried.geometry,
            desired + moved,
            carried.ground,
            carried.foot_offsets,
            on_unreachable="nan",
        )
        return moved if all_finite(reached) else correction


def _on(
    carried: CarriedArm,
    ground: list[float],
    foot_offsets: list[float],
    payload: Sequence[float] = (0.0,),
) -> CarriedArm:
    """Platform and arm on other ground, with a payload (1) at the tip."""
    (roll, pitch), (mass,), offsets = ground, payload, tuple(foot_offsets)
    return replace(carried, ground=(roll, pitch), foot_offsets=offsets, payload=max(mass, 0.0))


def _pull(
    standing: Callable[..., CarriedArm],
    posture: list[float],
    joints: list[float],
    ground: list[float],
    foot_offsets: list[float],
    payload: list[float],
) -> NDArray[np.float64]:
    """Change of the posture (3, 3) by which the tip moves, where it can."""
    jacobian = standing(ground, foot_offsets, payload).posture_jacobian(posture, joints)
    pull: NDArray[np.float64] = np.linalg.pinv(jacobian, rcond=_SMALLEST)
    return pull


class TipScript(LeafSystem):
    """Goes through a list of points, and stays a while at each.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground_valid` | 1 | - | above 0.5: begin |
    | in `tip_arrived` | 1 | 0/1 | 1 once the tip is at its point |
    | out `tip_command` | w | m | the present point; NaN before the first |
    | out `points_done` | 1 | - | number of points at which the tip has stayed |

    State: discrete, each output; when the present point was asked for and since when the tip has
    been there (2) [s]; updated every period.

    Bad input: an arrival that is not finite is none.
    """

    def __init__(
        self,
        points: Sequence[Sequence[float]],
        hold: float = 0.5,
        delay: float = 0.0,
        period: float = 0.01,
    ):
        """Creates the script.

        Args:
            points: points (3), or points with directions of view (6) [m].
            hold: time at each [s].
            delay: time between the ground's estimate and the first [s].
            period: period of the updates [s].
        """
        super().__init__()
        self.set_name("tip_script")
        self._points = [np.array(point, dtype=float) for point in points]
        self._hold, self._delay, self._period = hold, delay, period
        self._enable = self.DeclareVectorInputPort("ground_valid", 1)
        self._arrival = self.DeclareVectorInputPort("tip_arrived", 1)
        width = len(points[0]) if points else _POINT
        self._command: Any = self.DeclareDiscreteState(np.full(width, math.nan))
        self._done: Any = self.DeclareDiscreteState(1)
        self._times: Any = self.DeclareDiscreteState(np.array([math.nan, math.inf]))
        self.DeclareStateOutputPort("tip_command", self._command)
        self.DeclareStateOutputPort("points_done", self._done)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: Any) -> None:
        now = context.get_time()
        if not is_on(self._enable, context):
            return
        start, since = elements(context.get_discrete_state(self._times))
        count = int(context.get_discrete_state(self._done)[0])
        if math.isnan(start):
            start = now + self._delay
        has_command = bool(np.isfinite(context.get_discrete_state(self._command)[0]))
        if not has_command:
            if now >= start - 1e-9 and self._points:
                state.set_value(self._command, self._points[0])
                start = now
        elif count < len(self._points):
            # What is told a period after a command has been worked out before it.
            is_there = is_on(self._arrival, context) and now > start + 1.5 * self._period
            since = min(since, now) if is_there else math.inf
            if now - since >= self._hold - 1e-9:
                count += 1
                start, since = now, math.inf
                state.set_value(self._done, np.array([float(count)]))
                if count < len(self._points):
                    state.set_value(self._command, self._points[count])
        state.set_value(self._times, np.array([start, since]))
