"""Smooth, reachable posture reference that follows stepwise commands."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from math import radians
from operator import itemgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import all_finite, greatest, where
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_on, read, read_array, read_or_zeros
from parapod.systems.core.rows import answer_of, batch_of
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    height_range,
    inverse_kinematics,
)

# Layout of the discrete state.
_COEFFICIENTS = slice(0, 18)  # polynomials of degree 5 of roll, pitch, height
_EACH = slice(0, 6), slice(6, 12), slice(12, 18)
_START, _DURATION, _STARTED = 18, 19, 20
_COMMAND, _GROUND = slice(21, 24), slice(24, 26)
_BRAKING = 26
_planned_for = itemgetter(*range(_COMMAND.start, _GROUND.stop))
_SIZE = 27
# Time to come to rest where the direct way to a command would leave the stroke [s].
_BRAKE_TIME = 0.3
# Points of a planned path that are checked.
_CHECKS = np.linspace(0.0, 1.0, 17).tolist()


@dataclass(frozen=True)
class PostureReferenceParams:
    """Limits of the way to a new posture.

    Attributes:
        angle_rate: largest rate of roll and pitch between two postures at rest [rad/s].
        height_rate: largest rate of the height [m/s].
        shortest_move: shortest duration of a move [s].
    """

    angle_rate: float = radians(1.5)
    height_rate: float = 0.02
    shortest_move: float = 0.6

    def duration(self, way: Iterable[float]) -> float:
        """Duration of a move from rest to rest [s].

        Its rate peaks at 15/8 of the mean rate, because its jerk is smallest.

        Args:
            way: changes of roll, pitch and height [rad, rad, m].
        """
        limits = (self.angle_rate, self.angle_rate, self.height_rate)
        moves = (1.875 * abs(d) / limit for d, limit in zip(way, limits, strict=True))
        return reduce(greatest, moves, self.shortest_move)


class PostureReference(LeafSystem):
    """Turns posture commands, which may jump, into a reference that the platform can follow.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `posture_command` | 3 | rad, rad, m | commanded roll, pitch, height; may jump |
    | in `extension_measured` | 4 | m | where the reference starts |
    | in `ground` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets` | 4 | m | how far each foot stands above the ground; unconnected: 0 |
    | in `enable` | 1 | - | above 0.5: follow commands |
    | out `posture_desired_state` | 6 | rad, rad, m and rates | the reference, C2 in the posture |

    When it is enabled the reference starts at rest from the measured posture, so that nothing
    jumps. Each new command is approached by polynomials of degree 5 from the reference's present
    position, rate and acceleration to rest at the command (minimum jerk when it starts at rest).
    Where that path would overshoot the stroke, the reference comes to rest first.

    A command outside the workspace is refused: with `on_unreachable="raise"` the simulation stops
    with `UnreachablePosture`, before anything moves towards it; with `"clamp"` it takes the
    nearest height that the legs reach at the commanded angles, and where there is none it goes as
    far towards the angles as they reach.

    State: discrete, polynomials (18), start time and duration (2), whether started (1), the last
    command (3), the ground it was planned for (2) and whether it comes to rest before obeying
    (1), updated every period.

    Bad input: a command or ground that is not finite is ignored, and so are measurements that
    are not when the reference should start: it starts with the first good ones.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: PostureReferenceParams = PostureReferenceParams(),
        on_unreachable: Literal["raise", "clamp"] = "raise",
        period: float = 0.01,
    ):
        if on_unreachable not in ("raise", "clamp"):
            raise ValueError(f'on_unreachable must be "raise" or "clamp", not {on_unreachable!r}')
        super().__init__()
        self.set_name("posture_reference")
        self._geometry, self._params = geometry, params
        self._on_unreachable = on_unreachable
        self._command = self.DeclareVectorInputPort("posture_command", 3)
        self._measured = self.DeclareVectorInputPort("extension_measured", 4)
        self._ground = self.DeclareVectorInputPort("ground", 2)
        self._offsets = self.DeclareVectorInputPort("foot_offsets", LEG_COUNT)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        state = self.discrete_state_ticket(self.DeclareDiscreteState(_SIZE))
        prerequisites = {
            state,
            self.time_ticket(),
            self._measured.ticket(),
            self._ground.ticket(),
            self._offsets.ticket(),
        }
        self.DeclareVectorOutputPort(
            "posture_desired_state", 6, self._calc_desired_state, prerequisites
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_plan)

    def _calc_desired_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        if state[_STARTED] > 0.5:
            output.SetFromVector(np.array(_motion(state, context.get_time())))
        else:
            output.SetFromVector(np.append(self._measured_posture(context), np.zeros(3)))

    def _measured_posture(self, context: Context) -> NDArray[np.float64]:
        extension, ground = read_array(self._measured, context), read_array(self._ground, context)
        offsets = read_or_zeros(self._offsets, context)
        return forward_kinematics(self._geometry, extension, ground, foot_offsets=offsets)

    def _update_plan(self, context: Context, discrete_state: Any) -> None:
        state: Any = context.get_discrete_state_vector()
        started = state[_STARTED] > 0.5
        if not is_on(self._enable, context):
            if started:
                discrete_state.set_value(np.zeros(_SIZE))
            return
        command, ground = read(self._command, context), read(self._ground, context)
        if started and state[_BRAKING] > 0.5:
            if context.get_time() < state[_START] + state[_DURATION]:
                return
        elif started and _planned_for(state) == (*command, *ground):
            return
        plan = elements(state)
        if not all_finite(command + ground):
            return
        now = context.get_time()
        if started:
            motion = _motion(plan, now)
            start = (motion[:3], motion[3:], _acceleration(plan, now))
        else:
            start = (self._measured_posture(context).tolist(), [0.0] * 3, [0.0] * 3)
        if all_finite(start):
            standing = _Standing(ground, read_or_zeros(self._offsets, context))
            plan = self._plan(now, start, command, standing)
            discrete_state.set_value(np.array(plan))

    def _plan(
        self,
        now: float,
        start: tuple[list[float], list[float], list[float]],
        command: list[float],
        standing: "_Standing",
    ) -> list[float]:
        """State that leads from a position, rate and acceleration to the command."""
        target = self._reachable(start[0], command, standing)
        duration = self._params.duration(
            goal - at for at, goal in zip(start[0], target, strict=True)
        )
        state = _state(now, start, target, duration)
        if any(start[1]) and not self._stays_inside(state, standing):
            # At rest at the end of the way that braking takes.
            way = zip(start[0], start[1], strict=True)
            end = [at + 0.5 * _BRAKE_TIME * rate for at, rate in way]
            state = _state(now, start, end, _BRAKE_TIME)
            state[_BRAKING] = 1.0
        state[_COMMAND], state[_GROUND] = command, standing.ground
        return state

    def _stays_inside(self, plan: list[float], standing: "_Standing") -> bool:
        """Whether the legs reach all of a planned path."""
        times = (plan[_START] + share * plan[_DURATION] for share in _CHECKS)
        path = np.stack([batch_of(_position(plan, time)) for time in times], axis=-2)
        ground, offsets = (batch_of(numbers)[..., np.newaxis, :] for numbers in standing)
        extension = inverse_kinematics(self._geometry, path, ground, offsets, on_unreachable="nan")
        return bool(answer_of(np.isfinite(extension).all(axis=(-2, -1))))

    def _reachable(
        self, start: list[float], command: list[float], standing: "_Standing"
    ) -> list[float]:
        """The command, or what `on_unreachable` asks for where the legs do not reach it."""
        try:
            inverse_kinematics(self._geometry, command, *standing)
            return command
        except UnreachablePosture as error:
            if self._on_unreachable == "raise":
                raise UnreachablePosture(
                    error.leg,
                    error.extension,
                    error.admissible,
                    hint=describe_range(self._geometry, np.array(command), *standing),
                ) from None
        # Height gives way first, and only where no height will do the angles.
        shares = np.linspace(1.0, 0.0, 129)[:, np.newaxis]
        attitudes = start[:2] + shares * (np.array(command[:2]) - start[:2])
        low, high = height_range(self._geometry, attitudes, *standing).T
        fits = np.flatnonzero(low <= high)
        if not fits.size:
            return start
        best = fits[0]
        height = float(np.clip(command[2], low[best], high[best]))
        return [*attitudes[best].tolist(), height]


class _Standing(NamedTuple):
    """Ground under the feet."""

    ground: list[float]
    foot_offsets: list[float]


def describe_range(
    geometry: PlatformGeometry,
    posture: NDArray[np.float64],
    ground: ArrayLike,
    foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
) -> str:
    """Describe the heights that can be reached at an attitude, as the end of an error's line."""
    low, high = height_range(geometry, posture[:2], ground, foot_offsets)
    roll, pitch, ground_roll, ground_pitch = np.degrees([*posture[:2], *np.asarray(ground)])
    at = (
        f"at roll {roll:.2f}, pitch {pitch:.2f} deg on ground estimated at "
        f"roll {ground_roll:.2f}, pitch {ground_pitch:.2f} deg"
    )
    if low <= high:
        return f": {at} the height must be {1e3 * low:.1f}..{1e3 * high:.1f} mm"
    return f": {at} no height fits the stroke"


def _quintics(
    position: list[float],
    rate: list[float],
    acceleration: list[float],
    target: list[float],
    duration: float,
) -> list[float]:
    """Coefficients, lowest first, of three polynomials of degree 5 that end at rest."""
    coefficients = []
    t = duration
    for p, v, a, goal in zip(position, rate, acceleration, target, strict=True):
        d = goal - p
        coefficients += [
            p,
            v,
            0.5 * a,
            (10.0 * d - 6.0 * v * t - 1.5 * a * t * t) / t**3,
            (-15.0 * d + 8.0 * v * t + 1.5 * a * t * t) / t**4,
            (6.0 * d - 3.0 * v * t - 0.5 * a * t * t) / t**5,
        ]
    return coefficients


def _state(
    now: float,
    start: tuple[list[float], list[float], list[float]],
    target: list[float],
    duration: float,
) -> list[float]:
    """State of a plan that begins now and ends at rest at the target."""
    state = [0.0] * _SIZE
    state[_COEFFICIENTS] = _quintics(*start, target, duration)
    state[_START], state[_DURATION], state[_STARTED] = now, duration, 1.0
    return state


def _elapsed(state: list[float], time: float) -> float:
    """Time since the plan began; it stops at the plan's end, where the reference rests."""
    elapsed, duration = time - state[_START], state[_DURATION]
    inside: float = where(elapsed < duration, elapsed, duration)
    return where(elapsed > 0.0, inside, 0.0)


def _position(state: list[float], time: float) -> list[float]:
    return _motion(state, time)[:3]


def _motion(state: list[float], time: float) -> list[float]:
    """Position and rate."""
    t = _elapsed(state, time)
    positions, rates = [], []
    for k in _EACH:
        c0, c1, c2, c3, c4, c5 = state[k]
        positions.append(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
        rates.append(c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))))
    return positions + rates


def _acceleration(state: list[float], time: float) -> list[float]:
    t = _elapsed(state, time)
    return [
        2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
        for _, _, c2, c3, c4, c5 in (state[k] for k in _EACH)
    ]
