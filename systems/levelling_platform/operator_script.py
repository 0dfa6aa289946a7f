"""An operator who does one thing after the other, each when the platform is ready for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from parapod.systems.levelling_platform.phases import Phase
from parapod.systems.levelling_platform.requests import Command
from parapod.systems.ports import elements, read


@dataclass(frozen=True)
class Step:
    """One thing that the operator does; what is None stays as it was.

    Attributes:
        phase: in which it is done.
        delay: after the step before it, and after the phase has been reached [s].
        command: for the supervisor; taken back with the next step.
        drive: forward speed and yaw rate [m/s, rad/s].
        posture: roll, pitch, height to ask for [rad, rad, m].
        arm: angles of turntable and arm to ask for [rad].
    """

    phase: Phase
    delay: float
    command: Command = Command.NONE
    drive: tuple[float, float] | None = None
    posture: tuple[float, float, float] | None = None
    arm: tuple[float, float] | None = None


class OperatorScript(LeafSystem):
    """Goes through a list of steps.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `phase` | 1 | - | the supervisor's |
    | out `operator` | 1 | - | a `Command` |
    | out `drive_request` | 2 | m/s, rad/s | forward speed and yaw rate |
    | out `posture_request` | 3 | rad, rad, m | posture to take |
    | out `arm_request` | 2 | rad | angles of turntable and arm |
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
    ):
        """Creates the operator.

        Args:
            steps: in their order.
            posture: asked for until a step asks for another [rad, rad, m].
            period: of the operator's attention [s].
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
            ("arm_request", [0.0, 0.0]),
            ("steps_done", [0.0]),
        ):
            self._outputs[name] = self.DeclareDiscreteState(np.array(start))
            self.DeclareStateOutputPort(name, self._outputs[name])
        self._memory: Any = self.DeclareDiscreteState(np.array([-1.0, 0.0, 0.0]))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: Any) -> None:
        now, phase = context.get_time(), read(self._phase, context)[0]
        last, since, done_at = elements(context.get_discrete_state(self._memory))
        if phase != last:
            since = now
        done = int(context.get_discrete_state(self._outputs["steps_done"])[0])
        if done < len(self._steps):
            step = self._steps[done]
            waited = now - max(since, done_at) + 1e-9
            if phase == step.phase and waited >= step.delay:
                self._do(step, done + 1, discrete_state)
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
            if value is not None:
                discrete_state.set_value(self._outputs[name], np.array(value))
