"""Scripts of commands: postures one after the other, and an operator's steps."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_on, read, read_or_zeros
from parapod.systems.core.rows import batch_of, number_of
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.supervisor import Command, Phase


@dataclass(frozen=True)
class Waypoint:
    """A posture relative to the level one, and when it is commanded.

    Attributes:
        time: since the script began [s].
        roll: [rad].
        pitch: [rad].
        height: relative to the height of the level posture [m].
    """

    time: float
    roll: float = 0.0
    pitch: float = 0.0
    height: float = 0.0


class PostureScript(LeafSystem):
    """Commands a level posture, then waypoints about it, each at its time.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground_estimated` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets_estimated` | 4 | m | heights under the feet; unconnected: 0 |
    | in `ground_valid` | 1 | - | the script begins when this rises above 0.5 |
    | out `posture_command` | 3 | rad, rad, m | commanded roll, pitch, height |
    | out `posture_scale` | 1 | - | share of the waypoints' size that fits the stroke |

    A script is written once and run on grounds that leave little stroke. When it begins, all
    waypoints are shrunk towards the level posture by the largest factor up to 1 with which every
    one of them can be reached. Whether the level posture itself can be reached is not decided
    here but by `PostureReference`, which refuses it by name.

    State: discrete, commanded posture (3); scale (1); whether begun, start time and number of
    waypoints commanded so far (3); updated every period, so a waypoint is commanded up to a
    period after its time.

    Bad input: a ground that is not finite does not start the script.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        height: float = 0.477,
        waypoints: Sequence[Waypoint] = (),
        margin: float = 0.3e-3,
        period: float = 0.01,
    ):
        """Creates the script.

        Args:
            geometry: the platform.
            height: height of the level posture [m].
            waypoints: in the order of their times.
            margin: stroke that is left unused at each end by the waypoints [m].
            period: period of the check whether to begin [s].
        """
        super().__init__()
        self.set_name("posture_script")
        self._geometry, self._height, self._margin = geometry, height, margin
        self._waypoints = tuple(waypoints)
        self._times = [waypoint.time for waypoint in waypoints]
        if self._times != sorted(self._times):
            raise ValueError(f"the waypoints' times must not decrease, but are {self._times}")
        self._ground = self.DeclareVectorInputPort("ground_estimated", 2)
        self._offsets = self.DeclareVectorInputPort("foot_offsets_estimated", LEG_COUNT)
        self._enable = self.DeclareVectorInputPort("ground_valid", 1)
        self._level = np.array([0.0, 0.0, height])
        self.DeclareStateOutputPort("posture_command", self.DeclareDiscreteState(self._level))
        self.DeclareStateOutputPort("posture_scale", self.DeclareDiscreteState(1))
        self.DeclareDiscreteState(3)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_command)

    def _update_command(self, context: Context, discrete_state: Any) -> None:
        has_begun, start, count = elements(context.get_discrete_state(2))
        enabled = is_on(self._enable, context)
        if has_begun != float(enabled):
            self._begin_or_end(context, discrete_state, enabled)
            return
        if not has_begun or count == len(self._times):
            return
        steps_done = self._count_until(context.get_time() - start)
        if steps_done > count:
            scale = context.get_discrete_state(1)[0]
            discrete_state.set_value(0, self._commanded(steps_done, scale))
            discrete_state.set_value(2, np.array([1.0, start, float(steps_done)]))

    def _begin_or_end(self, context: Context, discrete_state: Any, enabled: bool) -> None:
        """Begins the script once the ground is known; ends it at the level posture."""
        ground = read(self._ground, context)
        if enabled and not all_finite(ground):
            return
        offsets = read_or_zeros(self._offsets, context)
        scale = self._fit(ground, offsets) if enabled else 0.0
        steps_done = self._count_until(0.0) if enabled else 0
        discrete_state.set_value(0, self._commanded(steps_done, scale))
        discrete_state.set_value(1, np.array([scale]))
        progress = [float(enabled), context.get_time() if enabled else 0.0, float(steps_done)]
        discrete_state.set_value(2, np.array(progress))

    def _count_until(self, elapsed: float) -> int:
        """Number of waypoints whose time has come."""
        return bisect.bisect_right(self._times, elapsed + 1e-9)

    def _commanded(self, steps_done: int, scale: float) -> NDArray[np.float64]:
        """Posture commanded once that many waypoints have been."""
        return (
            np.array(self._posture(self._waypoints[steps_done - 1], scale))
            if steps_done
            else self._level
        )

    def _posture(self, waypoint: Waypoint, scale: float) -> list[float]:
        return [
            scale * waypoint.roll,
            scale * waypoint.pitch,
            self._height + scale * waypoint.height,
        ]

    def _fit(self, ground: Sequence[float], offsets: Sequence[float]) -> float:
        """Largest factor of 0, 0.01, ... 1 with which the legs reach every waypoint."""
        if not self._waypoints:
            return 1.0
        scales = np.linspace(1.0, 0.0, 101)
        relative = np.array([[w.roll, w.pitch, w.height] for w in self._waypoints])
        postures = self._level + scales[:, np.newaxis, np.newaxis] * relative
        at, above = (batch_of(n)[..., np.newaxis, np.newaxis, :] for n in (ground, offsets))
        extension = inverse_kinematics(self._geometry, postures, at, above, "nan")
        low = self._geometry.extension_min + self._margin
        high = self._geometry.extension_max - self._margin
        fits = ((extension >= low) & (extension <= high)).all(axis=(-2, -1))
        largest = scales[np.argmax(fits, axis=-1)]
        scale: float = number_of(np.where(fits.any(axis=-1), largest, 0.0))
        return scale


@dataclass(frozen=True)
class Step:
    """One thing that the operator does; what is None stays as it was.

    Attributes:
        phase: in which it is done.
        delay: after the step before it, and after the phase has been reached [s].
        command: for the supervisor; taken back with the next step.
        drive: forward speed and yaw rate [m/s, rad/s].
        posture: roll, pitch, height to ask for [rad, rad, m].
        arm: positions (n) of the arm's joints to ask for [rad or m].
    """

    phase: Phase
    delay: float
    command: Command = Command.NONE
    drive: tuple[float, float] | None = None
    posture: tuple[float, float, float] | None = None
    arm: tuple[float, ...] | None = None


class OperatorScript(LeafSystem):
    """Goes through a list of steps.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `phase` | 1 | - | the supervisor's |
    | out `operator` | 1 | - | a `Command` |
    | out `drive_request` | 2 | m/s, rad/s | forward speed and yaw rate |
    | out `posture_request` | 3 | rad, rad, m | posture to take |
    | out `arm_request` | n | rad or m | positions of the arm's joints |
    | out `steps_done` | 1 | - | how many steps have been done |

    State: discrete, each output; the phase seen last and since when, and when the last step was
    done (3); updated every period.

    Bad input: a phase that is not finite is none of those that steps wait for.
    """

    def __init__(
        self,
        steps: Sequence[Step] = (),
        posture: tuple[float, float, float] = (0.0, 0.0, 0.477),
        period: float = 0.01,
        joints: int = 2,
    ):
        """Creates the operator.

        Args:
            steps: in their order.
            posture: asked for until a step asks for another [rad, rad, m].
            period: period of the operator's attention [s].
            joints: number n of the arm's joints; 0: no port for them.
        """
        super().__init__()
        self.set_name("operator_script")
        self._steps = tuple(steps)
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._outputs: dict[str, Any] = {}
        for name, start in (
            ("operator", [0.0]),
            ("drive_request", [0.0, 0.0]),
            ("posture_request", list(posture)),
            ("arm_request", [0.0] * joints),
            ("steps_done", [0.0]),
        ):
            if not start:
                continue
            self._outputs[name] = self.DeclareDiscreteState(np.array(start))
            self.DeclareStateOutputPort(name, self._outputs[name])
        self._memory: Any = self.DeclareDiscreteState(np.array([-1.0, 0.0, 0.0]))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: Any) -> None:
        now, phase = context.get_time(), read(self._phase, context)[0]
        last, since, done_at = elements(context.get_discrete_state(self._memory))
        if phase != last:
            since = now
        steps_done = int(context.get_discrete_state(self._outputs["steps_done"])[0])
        if steps_done < len(self._steps):
            step = self._steps[steps_done]
            waited = now - max(since, done_at) + 1e-9
            if phase == step.phase and waited >= step.delay:
                self._do(step, steps_done + 1, discrete_state)
                done_at = now
        discrete_state.set_value(self._memory, np.array([phase, since, done_at]))

    def _do(self, step: Step, count: int, discrete_state: Any) -> None:
        values = {
            "operator": (float(step.command),),
            "drive_request": step.drive,
            "posture_request": step.posture,
            "arm_request": step.arm,
            "steps_done": (float(count),),
        }
        for name, value in values.items():
            if value is not None and name in self._outputs:
                discrete_state.set_value(self._outputs[name], np.array(value))
