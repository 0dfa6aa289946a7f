"""Detection of the devices' faults from the redundancy that the platform has anyway.

One table, `RULES`, lists the findings, their severity and their deadline:
`FaultDetector` fills it, the supervisor obeys its severities, and the documents and the campaign
of faults are made of it.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import total
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, read, read_or_zeros
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, unevenness
from parapod.systems.levelling_platform.supervisor import Command, Phase
from parapod.systems.safety.faults import EMERGENCY_STOP_SIGN, Severity


class Finding(IntEnum):
    """Names of the findings; the numbers are the elements of the detector's ports."""

    ENCODER_INVALID = 0
    ENCODER_JUMP = 1
    LEGS_STALE = 2
    LEG_RESPONSE = 3
    SUPPLY = 4
    FEET_MISMATCH = 5
    POSTURE_MISMATCH = 6
    GYRO_INVALID = 7
    ACCEL_INVALID = 8
    ACCEL_MISMATCH = 9
    IMU_STALE = 10
    SWITCH_END = 11
    SWITCH_CONTACT = 12
    FOOT_LOST = 13
    PUSHED_UP = 14
    COMMAND_INVALID = 15
    EMERGENCY_STOP = 16
    OPERATOR_LOST = 17


@dataclass(frozen=True)
class Rule:
    """One line of the table.

    Attributes:
        finding: its name.
        severity: reaction of the machine.
        persists: time for which the sign must last before it is believed [s].
        deadline: time in which it is found [s], from the moment at which the signal is wrong, if
            that makes the platform move; a fault without effect may wait until it has one.
        device: part that may have failed; more than one where they cannot be distinguished.
        sign: observation that shows it.
    """

    finding: Finding
    severity: Severity
    persists: float
    deadline: float
    device: str
    sign: str


RULES: tuple[Rule, ...] = (
    Rule(
        Finding.ENCODER_INVALID,
        Severity.BRAKE,
        0.0,
        0.05,
        "encoder",
        "an extension that is not finite or beyond the end stops",
    ),
    Rule(
        Finding.ENCODER_JUMP,
        Severity.BRAKE,
        0.0,
        0.05,
        "encoder",
        "an extension that changes faster than any actuator moves",
    ),
    Rule(Finding.LEGS_STALE, Severity.BRAKE, 0.0, 0.15, "encoder", "extensions that are old"),
    Rule(
        Finding.LEG_RESPONSE,
        Severity.BRAKE,
        0.0,
        2.5,
        "encoder, drive or supply",
        "a leg that does not move as its voltage says",
    ),
    Rule(
        Finding.SUPPLY,
        Severity.BRAKE,
        0.0,
        2.5,
        "supply, drives or encoders",
        "three legs or more that do not move as their voltages say",
    ),
    Rule(
        Finding.FEET_MISMATCH,
        Severity.HOLD,
        0.2,
        1.0,
        "encoder",
        "four feet that stand, but by their extensions not on the ground that was measured",
    ),
    Rule(
        Finding.POSTURE_MISMATCH,
        Severity.HOLD,
        0.3,
        3.0,
        "encoder, gyroscope or accelerometer",
        "an attitude that the extensions do not agree with",
    ),
    Rule(
        Finding.GYRO_INVALID,
        Severity.HOLD,
        0.05,
        0.2,
        "gyroscope",
        "a rate that is not finite or faster than the platform ever turns",
    ),
    Rule(
        Finding.ACCEL_INVALID,
        Severity.HOLD,
        0.15,
        0.4,
        "accelerometer",
        "a specific force that is not finite or far from gravity",
    ),
    Rule(
        Finding.ACCEL_MISMATCH,
        Severity.HOLD,
        0.4,
        1.0,
        "accelerometer or gyroscope",
        "a vertical that turns away from the estimated one",
    ),
    Rule(Finding.IMU_STALE, Severity.HOLD, 0.0, 0.15, "inertial sensor", "samples that are old"),
    Rule(
        Finding.SWITCH_END,
        Severity.WARN,
        0.1,
        0.3,
        "limit switch or encoder",
        "an end switch that the extension does not agree with",
    ),
    Rule(
        Finding.SWITCH_CONTACT,
        Severity.HOLD,
        0.05,
        0.2,
        "contact switch",
        "a foot that touches although its leg is up",
    ),
    Rule(
        Finding.FOOT_LOST,
        Severity.HOLD,
        0.8,
        2.5,
        "contact switch, encoder or ground",
        "a foot that no longer stands, and is not brought back",
    ),
    Rule(
        Finding.PUSHED_UP,
        Severity.HOLD,
        0.1,
        2.0,
        "contact switch, encoder or accelerometer",
        "a platform that seems to tilt while its legs look for the ground",
    ),
    Rule(
        Finding.COMMAND_INVALID,
        Severity.WARN,
        0.0,
        0.05,
        "command",
        "a posture asked for that is not finite",
    ),
    Rule(
        Finding.EMERGENCY_STOP,
        Severity.LATCHED_OFF,
        0.0,
        0.05,
        "emergency stop",
        EMERGENCY_STOP_SIGN,
    ),
    Rule(
        Finding.OPERATOR_LOST,
        Severity.HOLD,
        0.0,
        0.4,
        "operator's page",
        "an operator who has been silent",
    ),
)


def as_markdown() -> str:
    """The table as a list, for people."""
    return "\n".join(
        f"* `{rule.finding.name.lower()}`: {rule.sign}; {rule.severity.name.lower()}, within "
        f"{rule.deadline:g} s, {rule.device}"
        for rule in RULES
    )


_COUNT = len(RULES)
_ON_FEET = (Phase.POSTURE, Phase.HOLD)
_SEARCHING = (Phase.LOWER, Phase.TOUCHDOWN, Phase.ESTIMATE)
# Layout of the memory.
_EXTENSION, _VOLTAGE, _RESIDUAL = slice(0, 4), slice(4, 8), slice(8, 12)
_ATTITUDE = slice(12, 14)  # before the first foot touched
_OPERATOR, _SEEN, _AGE = 14, 15, 16
_MEMORY = 17


@dataclass(frozen=True)
class FaultDetectorParams:
    """Limits of normal signals (design choices, each above noise and motion).

    Attributes:
        shortest: least extension that can be [m]; the end stop less a tolerance.
        longest: largest extension that can be [m].
        fastest: speed of an actuator [m/s].
        gain: K of the actuators [(m/s)/V].
        friction: largest voltage that friction and load take [V].
        response: largest way by which a leg may differ from what its voltage says [m].
        feet: largest difference of a foot's height from the measured ground [m].
        extended: extension at which a leg's far end switch closes [m].
        retracted: extension at which its near end switch closes [m].
        end: tolerance of the end switches [m].
        up: a leg of this extension cannot touch the ground [m].
        oldest: largest age of legs and inertial sensor in a default context [s].
        gain_error: share by which it may be off [-].
        memory: over which that is counted [s].
        tilt: largest difference of two attitudes [rad].
        turn_rate: faster than the platform ever turns about x and y [rad/s].
        force: largest difference of the specific force from gravity [m/s^2].
        vertical: largest angle between the accelerometer's vertical and the estimated one [rad].
        pushed: largest tilt while the legs look for the ground [rad].
        silence: longest silence of an operator [s]; pages speak ten times a second.
    """

    shortest: float
    longest: float
    fastest: float
    gain: float
    friction: float
    response: float
    feet: float
    extended: float
    retracted: float
    end: float
    up: float
    oldest: float = 0.05
    gain_error: float = 0.2
    memory: float = 1.0
    tilt: float = math.radians(0.6)
    turn_rate: float = 0.06
    force: float = 0.6
    vertical: float = math.radians(2.0)
    pushed: float = math.radians(0.35)
    silence: float = 0.3


class FaultDetector(LeafSystem):
    """Compares what must agree: legs with legs, legs with voltages, legs with the inertial sensor.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | measured |
    | in `limits` | 12 | 0/1 | switches: extended, retracted, ground contact of each leg |
    | in `voltage` | 4 | V | commanded |
    | in `gyro` | 3 | rad/s | measured |
    | in `accel` | 3 | m/s^2 | measured |
    | in `age` | 4 | s | of the data of legs, inertial sensor, wheels, arm |
    | in `attitude` | 2 | rad | estimated roll and pitch |
    | in `ground` | 2 | rad | estimated ground |
    | in `foot_offsets` | 4 | m | estimated heights of the feet above it |
    | in `posture_request` | 3 | rad, rad, m | what the operator asks for |
    | in `operator` | 1 | - | a `Command`; RESET clears what has ended |
    | in `phase` | 1 | - | the supervisor's |
    | in `emergency_stop` | 1 | 0/1 | whether it is pressed; unconnected: it is not |
    | in `operator_age` | 1 | s | since the operator was heard; unconnected: there is none |
    | out `findings` | 18 | 0/1 | by `Finding`; each stays until it is reset |
    | out `severity` | 1 | - | the worst `Severity` of them |

    A sign that lasts as long as its rule in `findings` says becomes a finding, and a finding
    stays until the operator resets it after its cause has gone.

    State: discrete, findings (18), severity (1), how long each sign has lasted (18) [s], and a
    memory (17); updated every period.

    Parameters (Context): largest age of legs and inertial sensor (1) [s], see `allow_age`.

    Bad input: becomes a finding.
    """

    def __init__(
        self,
        geometry: PlatformGeometry,
        params: FaultDetectorParams,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("fault_detector")
        self.geometry, self.params, self.period = geometry, params, period
        for name, size in (
            ("extension", 4),
            ("limits", 12),
            ("voltage", 4),
            ("gyro", 3),
            ("accel", 3),
            ("age", 4),
            ("attitude", 2),
            ("ground", 2),
            ("foot_offsets", 4),
            ("posture_request", 3),
            ("operator", 1),
            ("phase", 1),
            ("emergency_stop", 1),
            ("operator_age", 1),
        ):
            self.DeclareVectorInputPort(name, size)
        self._findings: Any = self.DeclareDiscreteState(_COUNT)
        self._severity: Any = self.DeclareDiscreteState(1)
        self._lasted: Any = self.DeclareDiscreteState(_COUNT)
        self._memory: Any = self.DeclareDiscreteState(_MEMORY)
        self._oldest: Any = self.DeclareNumericParameter(BasicVector(np.array([params.oldest])))
        self.DeclareStateOutputPort("findings", self._findings)
        self.DeclareStateOutputPort("severity", self._severity)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def allow_age(self, context: Context, seconds: float) -> float:
        """Lets measurements be older than usual, if that is more; returns the usual limit [s].

        Legs may then jump, and be off what their voltages say, by the way that they go meanwhile.
        """
        limit = max(seconds, self.params.oldest)
        context.get_mutable_numeric_parameter(self._oldest).SetFromVector(np.array([limit]))
        return self.params.oldest

    def oldest(self, context: Context) -> float:
        """Largest age of legs and inertial sensor [s]."""
        vector: Any = context.get_numeric_parameter(self._oldest)
        limit: float = vector[0]
        return limit

    def forget(self, context: Context) -> None:
        """Compares the next measurements with none before: for a loop that has left ticks out."""
        context.get_mutable_discrete_state(self._memory)[_SEEN] = 0.0

    def _update(self, context: Context, discrete_state: Any) -> None:
        memory = elements(context.get_discrete_state(self._memory))
        look = _Look(self, context, memory)
        signs = look.signs()
        lasted = elements(context.get_discrete_state(self._lasted))
        findings = elements(context.get_discrete_state(self._findings))
        reset = look.is_reset()
        severity = Severity.NONE
        for rule in RULES:
            i = int(rule.finding)
            lasted[i] = lasted[i] + self.period if rule.finding in signs else 0.0
            if lasted[i] > rule.persists + 1e-9:
                findings[i] = 1.0
            elif reset and not lasted[i]:
                findings[i] = 0.0
            if findings[i]:
                severity = max(severity, rule.severity)
        discrete_state.set_value(self._findings, np.array(findings))
        discrete_state.set_value(self._severity, np.array([float(severity)]))
        discrete_state.set_value(self._lasted, np.array(lasted))
        discrete_state.set_value(self._memory, np.array(look.remembered()))


class _Look:
    """One look at everything."""

    def __init__(self, detector: FaultDetector, context: Context, memory: list[float]):
        self._detector, self._context = detector, context
        self._params, self._memory = detector.params, memory
        self._oldest = detector.oldest(context)
        # For so much longer than usual legs may be shown where they were [s].
        self._late = self._oldest - detector.params.oldest
        self._extension, self._age = self._read("extension"), self._read("age")[0]
        self._limits = self._read("limits")
        self._attitude = self._read("attitude")
        number = self._read("phase")[0]
        # In an unknown phase, as in a fault, nothing is compared that only some phases have.
        self._phase = Phase(int(number)) if number in Phase else Phase.FAULT
        if self._phase not in _SEARCHING or not any(self._contact):
            # The estimate settles after the way here; from the first touch on it must not move.
            memory[_ATTITUDE] = self._attitude

    def _read(self, name: str) -> list[float]:
        return read(self._detector.GetInputPort(name), self._context)

    @property
    def _contact(self) -> list[bool]:
        return [switch > 0.5 for switch in self._limits[2 * LEG_COUNT :]]

    def is_reset(self) -> bool:
        """Whether the operator has just asked for a reset."""
        command, last = self._read("operator")[0], self._memory[_OPERATOR]
        self._memory[_OPERATOR] = command
        return command == Command.RESET != last

    def remembered(self) -> list[float]:
        """The memory after this look."""
        memory = self._memory
        memory[_EXTENSION] = [d if math.isfinite(d) else 0.4 for d in self._extension]
        voltage = self._read("voltage")
        memory[_AGE] = self._age if math.isfinite(self._age) else 0.0
        memory[_VOLTAGE] = [v if math.isfinite(v) else 0.0 for v in voltage]
        memory[_SEEN] = 1.0
        return memory

    def signs(self) -> set[Finding]:
        """Signs of faults at this instant."""
        signs = self._of_encoders() | self._of_inertial_sensor() | self._of_switches()
        if not signs & {Finding.ENCODER_INVALID, Finding.ENCODER_JUMP}:
            signs |= self._of_response()
            if self._phase in _ON_FEET:
                signs |= self._of_posture()
        if self._phase in _SEARCHING and self._tilted() > self._params.pushed:
            signs.add(Finding.PUSHED_UP)
        if not all(map(math.isfinite, self._read("posture_request"))):
            signs.add(Finding.COMMAND_INVALID)
        return signs | self._of_people()

    def _tilted(self) -> float:
        return max(
            abs(a - b) for a, b in zip(self._attitude, self._memory[_ATTITUDE], strict=True)
        )

    def _of_encoders(self) -> set[Finding]:
        params, signs = self._params, set()
        if not all(params.shortest <= d <= params.longest for d in self._extension):
            signs.add(Finding.ENCODER_INVALID)
        elif self._memory[_SEEN]:
            most = params.fastest * (self._detector.period + self._late)
            pairs = zip(self._extension, self._memory[_EXTENSION], strict=True)
            if not all(abs(now - before) <= most for now, before in pairs):
                signs.add(Finding.ENCODER_JUMP)
        if not self._age <= self._oldest:
            signs.add(Finding.LEGS_STALE)
        return signs

    def _of_response(self) -> set[Finding]:
        """Ways that legs have gone beyond what their voltages allow, both ways."""
        params, period, memory = self._params, self._detector.period, self._memory
        if not memory[_SEEN]:
            return set()
        # Periods between the two measurements: one that is late is seen twice, and moves no leg.
        newer = memory[_AGE] - self._age
        periods = max(0.0, 1.0 + newer / period) if math.isfinite(newer) else 1.0
        residual, wrong = memory[_RESIDUAL], 0
        for i in range(LEG_COUNT):
            slow, fast = (periods * rate for rate in self._possible(memory[_VOLTAGE][i]))
            rate = (self._extension[i] - memory[_EXTENSION][i]) / period
            beyond = rate - fast if rate > fast else min(0.0, rate - slow)
            residual[i] += period * (beyond - residual[i] / params.memory)
            behind = self._late * max(map(abs, self._possible(memory[_VOLTAGE][i])))
            wrong += abs(residual[i]) > params.response + behind
        memory[_RESIDUAL] = residual
        if wrong >= 3:
            return {Finding.SUPPLY, Finding.LEG_RESPONSE}
        return {Finding.LEG_RESPONSE} if wrong else set()

    def _possible(self, voltage: float) -> tuple[float, float]:
        """Smallest and largest rate of an actuator at a voltage [m/s]."""
        params = self._params
        most = params.gain * (1.0 + params.gain_error) * abs(voltage)
        least = params.gain * (1.0 - params.gain_error) * max(0.0, abs(voltage) - params.friction)
        return (least, most) if voltage >= 0.0 else (-most, -least)

    def _of_posture(self) -> set[Finding]:
        """Four legs have three degrees of freedom, and the inertial sensor sees two of them."""
        signs, geometry = set(), self._detector.geometry
        ground, offsets = self._read("ground"), self._read("foot_offsets")
        feet = unevenness(geometry, self._extension)
        if not np.abs(feet - offsets).max() <= self._params.feet:
            signs.add(Finding.FEET_MISMATCH)
        posture = forward_kinematics(geometry, self._extension, ground, foot_offsets=offsets)
        pairs = zip(posture[:2].tolist(), self._attitude, strict=True)
        if not all(abs(a - b) <= self._params.tilt for a, b in pairs):
            signs.add(Finding.POSTURE_MISMATCH)
        return signs

    def _of_inertial_sensor(self) -> set[Finding]:
        params, signs = self._params, set()
        gyro, accel = self._read("gyro"), self._read("accel")
        turns = all(abs(rate) <= params.turn_rate for rate in gyro[:2])
        if not (turns and math.isfinite(gyro[2])):
            signs.add(Finding.GYRO_INVALID)
        force = math.hypot(*accel)
        if not abs(force - GRAVITY) <= params.force:
            signs.add(Finding.ACCEL_INVALID)
        else:
            roll, pitch = (a if math.isfinite(a) else math.nan for a in self._attitude)
            vertical = (
                -math.sin(pitch),
                math.cos(pitch) * math.sin(roll),
                math.cos(pitch) * math.cos(roll),
            )
            along = total(a * v for a, v in zip(accel, vertical, strict=True)) / force
            if not along >= math.cos(params.vertical):
                signs.add(Finding.ACCEL_MISMATCH)
        if not self._read("age")[1] <= self._oldest:
            signs.add(Finding.IMU_STALE)
        return signs

    def _of_people(self) -> set[Finding]:
        """Somebody has pressed the stop, or is gone."""
        signs = set()
        if not self._optional("emergency_stop") <= 0.5:
            signs.add(Finding.EMERGENCY_STOP)
        if not self._optional("operator_age") <= self._params.silence:
            signs.add(Finding.OPERATOR_LOST)
        return signs

    def _optional(self, name: str) -> float:
        """An input that need not be connected; 0 then."""
        port = self._detector.GetInputPort(name)
        number: float = read_or_zeros(port, self._context)[0]
        return number

    def _of_switches(self) -> set[Finding]:
        params, signs = self._params, set()
        extended, retracted = self._limits[:LEG_COUNT], self._limits[LEG_COUNT : 2 * LEG_COUNT]
        for d, longest, shortest, touches in zip(
            self._extension, extended, retracted, self._contact, strict=True
        ):
            far, near = d - params.extended, d - params.retracted
            if (longest > 0.5) != (far >= 0.0) and abs(far) > params.end:
                signs.add(Finding.SWITCH_END)
            if (shortest > 0.5) != (near <= 0.0) and abs(near) > params.end:
                signs.add(Finding.SWITCH_END)
            if touches and d > params.up:
                signs.add(Finding.SWITCH_CONTACT)
        if self._phase in _ON_FEET and not all(self._contact):
            signs.add(Finding.FOOT_LOST)
        return signs
