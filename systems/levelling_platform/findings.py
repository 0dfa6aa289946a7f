"""What the platform can find out about its own faults, how grave it is, and by when it knows.

One table: `FaultDetector` fills it, the supervisor obeys its severities, and the documents and
the campaign of faults are made of it.
"""

from dataclasses import dataclass
from enum import IntEnum

from parapod.systems.safety.faults import Severity


class Finding(IntEnum):
    """Names of what can be found; the numbers are the elements of the detector's ports."""

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


@dataclass(frozen=True)
class Rule:
    """One line of the table.

    Attributes:
        finding: its name.
        severity: what the machine does about it.
        persists: how long the sign must last before it is believed [s].
        deadline: by when it is found [s], from the moment at which the signal is wrong, if that
            makes the platform move; what makes no difference may wait until it does.
        device: which part may have failed; more than one where they cannot be told apart.
        sign: what shows it.
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
)


def as_markdown() -> str:
    """The table for people."""
    lines = ["| finding | severity | within [s] | device | sign |", "|---|---|---|---|---|"]
    lines += [
        f"| {rule.finding.name.lower()} | {rule.severity.name.lower()} | {rule.deadline:g} | "
        f"{rule.device} | {rule.sign} |"
        for rule in RULES
    ]
    return "\n".join(lines)
