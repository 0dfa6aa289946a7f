"""Supervisor of the platform's operation: drive there, stand up, work, leave (section 2.2)."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from parapod.systems.levelling_platform.decision import (
    MEMORY_SIZE,
    Decision,
    Operation,
    SupervisorParams,
)
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.phases import Phase, next_phase
from parapod.systems.ports import elements, read

_ALWAYS = ("operator", "drive_request", "posture_request", "severity", "limits", "extension")


class Supervisor(LeafSystem):
    """Walks through the phases of `parapod.systems.levelling_platform.phases`.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `operator` | 1 | - | a `Command`; counts when it changes |
    | in `drive_request` | 4 | rad/s | wheels' velocities; obeyed in transport only |
    | in `posture_request` | 3 | rad, rad, m | posture to take; may change while it is held |
    | in `severity` | 1 | - | `Severity` of the worst fault; unconnected: none |
    | in `limits` | 12 | 0/1 | switches: extended, retracted, ground contact of each leg |
    | in `extension` | 4 | m | measured extensions |
    | in `wheel_velocity` | 4 | rad/s | measured |
    | in `ground` | 2 | rad | estimated ground |
    | in `ground_valid` | 1 | - | above 0.5: there is an estimate |
    | in `foot_offsets` | 4 | m | estimated heights of the feet above it |
    | in `posture_desired_state` | 6 | rad, rad, m and rates | the reference |
    | in `extension_desired_state` | 8 | m, m/s | what the legs are asked for |
    | out `phase` | 1 | - | a `Phase` |
    | out `leg_rate` | 4 | m/s | of legs that are lowered or raised |
    | out `posture_control` | 1 | - | above 0.5: legs follow the posture and not `leg_rate` |
    | out `legs_enable` | 1 | - | above 0.5: legs are controlled, otherwise 0 V |
    | out `legs_stop` | 1 | - | above 0.5: the drives' supply is cut |
    | out `estimate_ground` | 1 | - | rises when the ground is to be estimated |
    | out `posture_command` | 3 | rad, rad, m | posture to take |
    | out `wheel_velocity_command` | 4 | rad/s | of the wheels |
    | out `wheel_brake` | 1 | - | above 0.5: brake |
    | out `arm_enable` | 1 | - | above 0.5: the arm may work |
    | out `refusal` | 2 | - | the last `Refusal` and its detail |

    To find the ground each leg goes down until its own switch closes, and then back to where it
    did: the wheels carry meanwhile, and uneven ground is met foot by foot. What does not fit is
    refused and the platform stays where it is: a command outside its phase, a ground that cannot
    be levelled, a posture out of reach. To leave, the platform first lowers itself parallel to
    the ground as far as the stroke goes, and then raises its legs.

    State: discrete, each output, and a memory (12); updated every period.

    Bad input: a request that is not finite is not obeyed; a switch that is NaN is open, a severity
    that is NaN is the gravest. A leg whose extension is NaN is at no goal, and stands still.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: SupervisorParams = SupervisorParams(),
        standing_height: float = 0.390,
        period: float = 0.01,
    ):
        """Creates the supervisor.

        Args:
            geometry: the platform.
            params: its times, speeds and tolerances.
            standing_height: of the platform on its wheels [m].
            period: of its decisions [s].
        """
        super().__init__()
        self.set_name("supervisor")
        self._operation = Operation(geometry, params, standing_height + params.clearance, period)
        for name, size in (
            ("operator", 1),
            ("drive_request", 4),
            ("posture_request", 3),
            ("severity", 1),
            ("limits", 12),
            ("extension", 4),
            ("wheel_velocity", 4),
            ("ground", 2),
            ("ground_valid", 1),
            ("foot_offsets", 4),
            ("posture_desired_state", 6),
            ("extension_desired_state", 8),
        ):
            self.DeclareVectorInputPort(name, size)
        self._outputs: dict[str, Any] = {}
        for name, size in (
            ("phase", 1),
            ("leg_rate", 4),
            ("posture_control", 1),
            ("legs_enable", 1),
            ("legs_stop", 1),
            ("estimate_ground", 1),
            ("posture_command", 3),
            ("wheel_velocity_command", 4),
            ("wheel_brake", 1),
            ("arm_enable", 1),
            ("refusal", 2),
        ):
            start = np.ones(1) if name == "legs_enable" else np.zeros(size)
            index: Any = self.DeclareDiscreteState(start)
            self._outputs[name] = index
            self.DeclareStateOutputPort(name, index)
        self._memory: Any = self.DeclareDiscreteState(MEMORY_SIZE)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: Any) -> None:
        signals = {
            name: read(self.GetInputPort(name), context)
            for name in _ALWAYS
            if self.GetInputPort(name).HasValue(context)
        }
        out = {name: elements(context.get_discrete_state(i)) for name, i in self._outputs.items()}
        memory = elements(context.get_discrete_state(self._memory))
        phase = Phase(int(out["phase"][0]))
        decision = Decision(
            self._operation,
            lambda name: read(self.GetInputPort(name), context),
            context.get_time(),
            signals,
            out,
            memory,
        )
        target = next_phase(phase, decision.events(phase))
        if target is not phase:
            decision.leave(phase, target)
        decision.act(target)
        out["phase"] = [float(target)]
        for name, i in self._outputs.items():
            discrete_state.set_value(i, np.array(out[name]))
        discrete_state.set_value(self._memory, np.array(memory))
