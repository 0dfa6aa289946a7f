"""Supervisor of the platform's operation: drive there, stand up, work, leave (section 2.2).

One table, `TRANSITIONS`, says which phase follows which: `Supervisor` walks through it, and
`as_mermaid` draws it. Requests of the operator and the reasons to refuse them come first, then the
decisions, then the system.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from parapod.systems.core.elementwise import clamp
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, has_value, read
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.safety.faults import Severity


class Phase(IntEnum):
    """Phase of the operation; the numbers are those of the supervisor's port `phase`."""

    TRANSPORT = 0
    BRAKE = 1
    LOWER = 2
    TOUCHDOWN = 3
    ESTIMATE = 4
    POSTURE = 5
    HOLD = 6
    RETRACT = 7
    FAULT = 8
    STANDBY = 9


class Event(StrEnum):
    """Event that makes the platform go from one phase to another."""

    FAULT = "a fault of severity hold or more"
    GO = "the operator says go"
    STOP = "the operator says stop"
    RESET = "the operator says reset, and the fault's cause is gone"
    STANDS_STILL = "the wheels stand still"
    ALL_TOUCH = "each leg has found the ground, and is back where its switch closed"
    SETTLED = "nothing moved for a while"
    GROUND_FITS = "the ground is known, and its levelling fits the stroke"
    ARRIVED = "the posture is taken"
    NEW_POSTURE = "another posture is asked for"
    LEGS_UP = "all four legs are up"


@dataclass(frozen=True)
class Transition:
    """One line of the table.

    Attributes:
        source: phase in which the event counts.
        event: event that happens.
        target: phase that follows.
    """

    source: Phase
    event: Event
    target: Phase


# In the order in which events are looked at: what stops comes before what goes on.
TRANSITIONS: tuple[Transition, ...] = (
    *(Transition(p, Event.FAULT, Phase.FAULT) for p in Phase if p is not Phase.FAULT),
    Transition(Phase.TRANSPORT, Event.GO, Phase.BRAKE),
    Transition(Phase.BRAKE, Event.STOP, Phase.TRANSPORT),
    Transition(Phase.BRAKE, Event.STANDS_STILL, Phase.LOWER),
    Transition(Phase.LOWER, Event.STOP, Phase.RETRACT),
    Transition(Phase.LOWER, Event.ALL_TOUCH, Phase.TOUCHDOWN),
    Transition(Phase.TOUCHDOWN, Event.STOP, Phase.RETRACT),
    Transition(Phase.TOUCHDOWN, Event.SETTLED, Phase.ESTIMATE),
    Transition(Phase.ESTIMATE, Event.STOP, Phase.RETRACT),
    Transition(Phase.ESTIMATE, Event.GROUND_FITS, Phase.POSTURE),
    Transition(Phase.POSTURE, Event.STOP, Phase.RETRACT),
    Transition(Phase.POSTURE, Event.ARRIVED, Phase.HOLD),
    Transition(Phase.HOLD, Event.STOP, Phase.RETRACT),
    Transition(Phase.HOLD, Event.NEW_POSTURE, Phase.POSTURE),
    Transition(Phase.RETRACT, Event.LEGS_UP, Phase.TRANSPORT),
    Transition(Phase.FAULT, Event.RESET, Phase.STANDBY),
    Transition(Phase.STANDBY, Event.STOP, Phase.RETRACT),
)


def next_phase(phase: Phase, events: frozenset[Event] | set[Event]) -> Phase:
    """The phase that follows: the first line of the table whose event happened decides."""
    for transition in TRANSITIONS:
        if transition.source is phase and transition.event in events:
            return transition.target
    return phase


def as_mermaid() -> str:
    """The table as a state diagram in Mermaid's language; faults are one line."""
    lines = ["stateDiagram-v2", f"    [*] --> {Phase.TRANSPORT.name}"]
    lines += [
        f"    {t.source.name} --> {t.target.name}: {t.event.value}"
        for t in TRANSITIONS
        if t.event is not Event.FAULT
    ]
    lines.append(f"    note right of FAULT: from every phase, {Event.FAULT.value}")
    return "\n".join(lines)


class Command(IntEnum):
    """Command of an operator; the numbers are those of the port `operator`."""

    NONE = 0
    GO = 1
    STOP = 2
    RESET = 3


class Refusal(IntEnum):
    """Reason why a request is not carried out; the numbers are those of the port `refusal`."""

    NONE = 0
    COMMAND = 1  # not in this phase; detail: the phase
    GROUND = 2  # levelling does not fit the stroke; detail: the leg that misses most, 1..4
    POSTURE = 3  # out of reach; detail: the leg that misses most, 1..4
    NO_GROUND = 4  # a leg found none; detail: the leg, 1..4
    CAUSE = 5  # no reset while a fault's cause is there; detail: the phase
    UNSETTLED = 6  # the attitude does not come to rest, or there is none; detail: the phase


_RESTS = 1e-9  # smaller rates of a reference are rounding: it is at rest [rad/s, m/s]

# Layout of the memory.
_SINCE, _QUIET, _OPERATOR, _DESCENDING = range(4)
_HELD = slice(4, 7)  # the posture last asked for
_TOUCHED = slice(7, 11)  # extensions at which the feet touched; 0 before
_ASKED = 11  # since when a reset has been waiting
MEMORY_SIZE = 12


@dataclass(frozen=True)
class SupervisorParams:
    """Times, speeds and tolerances of the operation (all design choices); sizes are a machine's.

    Attributes:
        raised: extension of a leg that is up [m].
        clear: extension with which a leg leaves the ground alone [m]: nothing drives below.
        lowering_rate: rate of a leg that looks for ground, or is jogged [m/s].
        raising_rate: rate of a leg that goes up [m/s].
        touched: largest distance of a leg from where it touched the ground [m].
        arrived: largest error of an extension at its goal [m].
        clearance: clearance of the wheels at the end of the way down, if the stroke leaves it [m].
        standstill: largest velocity of a wheel that stands [rad/s].
        settle_time: time for which wheels must stand, and switches stay closed [s].
        estimate_time: at rest on wheels and feet before the ground is estimated [s].
        estimate_limit: longest time for which the ground's estimate may be waited for until that
            is refused [s]; five time constants of the attitude's estimator.
        approach: rate over distance with which a leg comes to its goal [1/s].
        arrive_time: time for which a leg must stay at its goal [s].
    """

    raised: float
    clear: float
    lowering_rate: float
    raising_rate: float
    touched: float
    arrived: float
    clearance: float
    standstill: float = 0.02
    settle_time: float = 0.5
    estimate_time: float = 3.0
    estimate_limit: float = 10.0
    approach: float = 4.0
    arrive_time: float = 0.3


@dataclass(frozen=True)
class Operation:
    """Constants of an operation.

    Attributes:
        geometry: the platform.
        params: times, speeds and tolerances.
        lowest: height to which the platform is lowered before its legs are raised [m].
        period: period of the decisions [s].
    """

    geometry: PlatformGeometry
    params: SupervisorParams
    lowest: float
    period: float


class Decision:
    """Events of a period, and their consequences for the outputs and the memory."""

    def __init__(
        self,
        operation: Operation,
        read: Callable[[str], list[float]],
        now: float,
        signals: dict[str, list[float]],
        out: dict[str, list[float]],
        memory: list[float],
    ):
        """Looks at one period.

        Args:
            operation: constants of the operation.
            read: gives an input by its name; not all are needed in every phase.
            now: time [s].
            signals: inputs that every phase needs, by name.
            out: outputs of the last period by name, changed to those of the next.
            memory: memory of the supervisor, changed in place.
        """
        self._operation, self._read, self._now = operation, read, now
        self._signals, self._out, self._memory = signals, out, memory
        self._params = operation.params

    def _refuse(self, why: Refusal, detail: float) -> None:
        self._out["refusal"] = [float(why), float(detail)]

    @property
    def _severity(self) -> float:
        """Severity of the worst fault; one that is NaN is the gravest."""
        severity = self._signals.get("severity", [0.0])[0]
        return math.inf if math.isnan(severity) else severity

    @property
    def _contact(self) -> list[bool]:
        return [switch > 0.5 for switch in self._signals["limits"][2 * LEG_COUNT :]]

    def _elapsed(self, since: int) -> float:
        return self._now - self._memory[since] + 1e-9

    # What has happened

    def events(self, phase: Phase) -> set[Event]:
        """Everything in this phase that its transitions look at."""
        events = self._commanded(phase)
        if self._severity >= Severity.HOLD:
            events.add(Event.FAULT)
        match phase:
            case Phase.BRAKE:
                events |= self._stands_still()
            case Phase.LOWER if self._all_have_touched():
                events.add(Event.ALL_TOUCH)
            case Phase.TOUCHDOWN if self._elapsed(_SINCE) >= self._params.settle_time:
                events.add(Event.SETTLED)
            case Phase.ESTIMATE if self._ground_fits():
                events.add(Event.GROUND_FITS)
            case Phase.POSTURE if not self._adopt_request() and self._has_arrived():
                events.add(Event.ARRIVED)
            case Phase.HOLD if self._adopt_request():
                events.add(Event.NEW_POSTURE)
            case Phase.RETRACT if self._legs_are_up():
                events.add(Event.LEGS_UP)
        return events

    def _commanded(self, phase: Phase) -> set[Event]:
        """The operator's command, if it is new and has its place in this phase."""
        code = self._signals["operator"][0]
        if code == self._memory[_OPERATOR] or not math.isfinite(code):
            self._memory[_ASKED] = 0.0
            return set()
        cleared = self._severity < Severity.HOLD
        if code == Command.RESET and phase is Phase.FAULT and not cleared and self._may_wait():
            return set()
        self._memory[_OPERATOR], self._memory[_ASKED] = code, 0.0
        if not code:
            return set()
        self._refuse(Refusal.NONE, 0.0)  # what was refused before is over
        match code:
            case Command.GO if phase is Phase.TRANSPORT:
                return {Event.GO}
            case Command.STOP if Phase.BRAKE <= phase <= Phase.HOLD or phase is Phase.STANDBY:
                return {Event.STOP}
            case Command.RESET if phase is Phase.FAULT and cleared:
                return {Event.RESET}
            case Command.RESET if phase is Phase.FAULT:
                self._refuse(Refusal.CAUSE, phase)
            case _:
                self._refuse(Refusal.COMMAND, phase)
        return set()

    def _may_wait(self) -> bool:
        """Whether a reset has been asked for just now: findings end a period or two after it."""
        if not self._memory[_ASKED]:
            self._memory[_ASKED] = self._now
        return self._elapsed(_ASKED) < 3.0 * self._operation.period

    def _stands_still(self) -> set[Event]:
        if not all(abs(v) <= self._params.standstill for v in self._read("wheel_velocity")):
            self._memory[_QUIET] = self._now
        still = self._elapsed(_QUIET) >= self._params.settle_time
        return {Event.STANDS_STILL} if still else set()

    def _all_have_touched(self) -> bool:
        """Whether each leg has been where its switch closed, and has not just passed it."""
        touched = self._memory[_TOUCHED]
        if not all(touched) or not all(
            abs(d - at) <= self._params.touched
            for d, at in zip(self._signals["extension"], touched, strict=True)
        ):
            self._memory[_QUIET] = self._now
        return self._elapsed(_QUIET) >= self._params.arrive_time

    def _ground_fits(self) -> bool:
        """Whether the ground has been estimated and the posture that is asked for fits it."""
        if not self._out["estimate_ground"][0] > 0.5:
            self._memory[_QUIET] = self._now
            return False
        # The estimator sees the trigger one period later, and its estimate is seen after that.
        if self._elapsed(_QUIET) < 3.0 * self._operation.period:
            return False
        if not self._read("ground_valid")[0] > 0.5:
            if self._elapsed(_QUIET) >= self._params.estimate_limit:
                self._refuse(Refusal.UNSETTLED, Phase.ESTIMATE)
            return False
        leg = self._missing_leg(self._signals["posture_request"])
        if leg:
            self._refuse(Refusal.GROUND, leg)
        else:
            self._take(self._signals["posture_request"])
        return not leg

    def _has_arrived(self) -> bool:
        """Whether reference and legs have been at their goal for a while."""
        desired = self._read("extension_desired_state")[:LEG_COUNT]
        there = all(
            abs(a - b) <= self._params.arrived
            for a, b in zip(desired, self._signals["extension"], strict=True)
        )
        resting = all(abs(rate) <= _RESTS for rate in self._read("posture_desired_state")[3:])
        if not (there and resting):
            self._memory[_QUIET] = self._now
        return self._elapsed(_QUIET) >= self._params.arrive_time

    def _adopt_request(self) -> bool:
        """Takes another posture that is asked for, or refuses it; whether there is one to take."""
        request = self._signals["posture_request"]
        if request == self._memory[_HELD] or not all(map(math.isfinite, request)):
            return False
        leg = self._missing_leg(request)
        if leg:
            self._memory[_HELD] = request
            self._refuse(Refusal.POSTURE, leg)
        else:
            self._take(request)
        return not leg

    def _take(self, posture: list[float]) -> None:
        self._memory[_HELD] = self._out["posture_command"] = list(posture)
        self._memory[_QUIET] = self._now
        self._refuse(Refusal.NONE, 0.0)

    def _missing_leg(self, posture: list[float]) -> int:
        """Number of the leg that misses a posture most; 0 if all reach it."""
        geometry = self._operation.geometry
        try:
            inverse_kinematics(geometry, posture, self._read("ground"), self._read("foot_offsets"))
        except UnreachablePosture as error:
            return error.leg
        return 0

    def _legs_are_up(self) -> bool:
        lowest = self._params.raised - self._params.arrived
        up = all(d >= lowest for d in self._signals["extension"])
        return up and not self._memory[_DESCENDING] > 0.5

    # What follows

    def leave(self, phase: Phase, target: Phase) -> None:
        """Carry out the actions of a transition between phases."""
        self._memory[_SINCE] = self._memory[_QUIET] = self._now
        out = self._out
        if target is Phase.POSTURE:
            out["posture_control"] = [1.0]
        elif target is Phase.RETRACT and out["posture_control"][0] > 0.5:
            self._memory[_DESCENDING] = float(self._descend())
        elif target is Phase.FAULT:
            out["posture_control"], self._memory[_DESCENDING] = [0.0], 0.0
        elif target is Phase.LOWER:
            self._memory[_TOUCHED] = [0.0] * LEG_COUNT

    def _descend(self) -> bool:
        """Commands the lowest posture parallel to the ground; whether there is one."""
        ground = self._read("ground")
        low, high = height_range(
            self._operation.geometry, ground, ground, self._read("foot_offsets")
        ).tolist()
        if not low <= high:
            return False
        height = min(max(self._operation.lowest, low + 1e-4), high)
        self._out["posture_command"] = [*ground, height]
        return True

    def act(self, phase: Phase) -> None:
        """Outputs of this phase."""
        out = self._out
        off = phase is Phase.FAULT and self._severity >= Severity.BRAKE
        out["legs_enable"], out["legs_stop"] = [0.0 if off else 1.0], [1.0 if off else 0.0]
        jog = self._jog() if phase in (Phase.TRANSPORT, Phase.STANDBY) else []
        driving = phase is Phase.TRANSPORT and not any(jog) and self._legs_are_clear()
        out["wheel_brake"] = [0.0 if driving else 1.0]
        request = self._signals["drive_request"]
        out["wheel_velocity_command"] = (
            list(request) if driving and all(map(math.isfinite, request)) else [0.0] * 4
        )
        out["arm_enable"] = [1.0 if phase is Phase.HOLD else 0.0]
        out["leg_rate"] = jog or [0.0] * LEG_COUNT
        if phase is Phase.LOWER:
            out["leg_rate"] = self._lower()
        elif phase is Phase.ESTIMATE and self._elapsed(_SINCE) >= self._params.estimate_time:
            out["estimate_ground"] = [1.0]
        elif phase is Phase.RETRACT:
            self._retract()

    def _jog(self) -> list[float]:
        """Rates of single legs that the operator asks for, within the stroke; wheels stand."""
        request = self._signals.get("jog_request", [0.0] * LEG_COUNT)
        params, wheels = self._params, self._read("wheel_velocity")
        if not (any(request) and all(abs(v) <= params.standstill for v in wheels)):
            return [0.0] * LEG_COUNT
        low, high = self._operation.geometry.extension_min, params.raised
        rates = []
        for rate, d in zip(request, self._signals["extension"], strict=True):
            slow, fast = (params.approach * (goal - d) for goal in (low, high))
            is_known = math.isfinite(rate) and math.isfinite(d)
            most = params.lowering_rate
            rates.append(clamp(clamp(rate, slow, fast), -most, most) if is_known else 0.0)
        return rates

    def _legs_are_clear(self) -> bool:
        return all(d >= self._params.clear for d in self._signals["extension"])

    def _lower(self) -> list[float]:
        """Each leg goes down until its own foot touches, and back to where it did."""
        touched, extension = self._memory[_TOUCHED], self._signals["extension"]
        rates = []
        for i, (contact, d) in enumerate(zip(self._contact, extension, strict=True)):
            if contact and not touched[i] and math.isfinite(d):
                touched[i] = d
            if touched[i]:
                rates.append(self._towards(touched[i], d, self._params.lowering_rate))
            elif not math.isfinite(d):
                rates.append(0.0)  # until the encoder is found to be wrong
            elif d > self._operation.geometry.extension_min:
                rates.append(-self._params.lowering_rate)
            else:
                self._refuse(Refusal.NO_GROUND, i + 1)
                rates.append(0.0)
        self._memory[_TOUCHED] = touched
        return rates

    def _towards(self, goal: float, at: float, fastest: float) -> float:
        """Rate that brings a leg to its goal without overshooting it; 0 where it is not known."""
        if not math.isfinite(at):
            return 0.0
        return clamp(self._params.approach * (goal - at), -fastest, fastest)

    def _retract(self) -> None:
        """First down parallel to the ground, until the wheels are near it; then legs up."""
        out = self._out
        if self._memory[_DESCENDING] > 0.5:
            if not self._has_arrived():
                return
            self._memory[_DESCENDING] = 0.0
        out["posture_control"] = [0.0]
        out["estimate_ground"] = [0.0]
        goal = self._params.raised
        # Gently until the wheels carry.
        standing = any(self._contact)
        fastest = self._params.lowering_rate if standing else self._params.raising_rate
        out["leg_rate"] = [self._towards(goal, d, fastest) for d in self._signals["extension"]]


_ALWAYS = ("operator", "drive_request", "posture_request", "limits", "extension")
_OPTIONAL = ("severity", "jog_request")


class Supervisor(LeafSystem):
    """Walks through the phases of `parapod.systems.levelling_platform.supervisor`.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `operator` | 1 | - | a `Command`; counts when it changes |
    | in `drive_request` | 4 | rad/s | wheels' velocities; obeyed in transport only |
    | in `posture_request` | 3 | rad, rad, m | posture to take; may change while it is held |
    | in `jog_request` | 4 | m/s | rates of single legs; unconnected: 0 |
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
    | out `refusal` | 2 | - | the `Refusal` of the last request, and its detail |

    To find the ground each leg goes down until its own switch closes, and then back to where it
    did: the wheels carry meanwhile, and uneven ground is met foot by foot. What does not fit is
    refused and the platform stays where it is: a command outside its phase, a ground that cannot
    be levelled or is not known because the platform does not come to rest, a posture out of
    reach. To leave, the platform first lowers itself parallel to
    the ground as far as the stroke goes, and then raises its legs. After a fault it stands by
    until a request to stop, which raises the legs; while it stands by, and in transport at
    rest, single legs can be jogged.

    State: discrete, each output, and a memory (12); updated every period.

    Bad input: a request that is not finite is not obeyed; a switch that is NaN is open, a severity
    that is NaN is the gravest. A leg whose extension is NaN is at no goal, and stands still;
    nothing drives while one is not up.
    """

    def __init__(
        self,
        geometry: PlatformGeometry,
        params: SupervisorParams,
        standing_height: float,
        period: float = 0.01,
    ):
        """Creates the supervisor.

        Args:
            geometry: the platform.
            params: its times, speeds and tolerances.
            standing_height: standing height of the platform on its wheels [m].
            period: period of its decisions [s].
        """
        super().__init__()
        self.set_name("supervisor")
        self._operation = Operation(geometry, params, standing_height + params.clearance, period)
        for name, size in (
            ("operator", 1),
            ("drive_request", 4),
            ("posture_request", 3),
            ("jog_request", LEG_COUNT),
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
            for name in (*_ALWAYS, *_OPTIONAL)
            if name in _ALWAYS or has_value(self.GetInputPort(name), context)
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
