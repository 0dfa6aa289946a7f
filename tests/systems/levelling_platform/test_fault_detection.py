"""Signs of faults, how long they last before they are believed, and what ends a finding."""

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.levelling_platform.fault_detection import (
    RULES,
    FaultDetector,
    Finding,
    as_markdown,
)
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.plane import to_platform
from parapod.systems.levelling_platform.supervisor import Command, Phase
from parapod.systems.safety.faults import Severity
from parapod.systems.sensors.imu import ImuParams

PERIOD, PARAMS = 0.01, PlatformDesign().fault_detector
COUNT = 1e-5  # of the encoders [m]
K = 0.01  # Eq. (18) [(m/s)/V]
GRAVITY = 9.81
GROUND = np.radians((2.0, 3.0))
POSTURE = np.array((0.0, 0.0, 0.485))
OFFSETS = 1e-3 * np.array((2.0, -2.0, 2.0, -2.0))
STANDING = inverse_kinematics(DRAWN, POSTURE, GROUND, OFFSETS)
RAISED, TOUCHING = np.full(4, 0.450), np.array((0.4302, 0.4221, 0.4275, 0.4252))
ON_WHEELS = (Phase.TRANSPORT, Phase.BRAKE, Phase.LOWER, Phase.RETRACT)
ON_FEET = (Phase.POSTURE, Phase.HOLD)
TOUCHED = np.repeat((0.0, 1.0), (8, 4))
OPEN = np.zeros(12)


def gravity(roll, pitch, size=GRAVITY):
    """Readings of an accelerometer at rest."""
    return np.array(to_platform((0.0, 0.0, size), roll, pitch))


def changed(value, index, by):
    value = np.array(value, dtype=float)
    value[index] += by
    return value


def healthy(phase):
    """Inputs of a machine at rest in a phase."""
    on_feet = phase in ON_FEET
    attitude = POSTURE[:2] if on_feet else GROUND
    return {
        "extension": STANDING if on_feet else RAISED if phase in ON_WHEELS else TOUCHING,
        "limits": OPEN if phase in ON_WHEELS else TOUCHED,
        "voltage": np.zeros(4),
        "gyro": np.zeros(3),
        "accel": gravity(*attitude),
        "age": np.zeros(4),
        "attitude": attitude,
        "ground": GROUND,
        "foot_offsets": OFFSETS,
        "posture_request": POSTURE,
        "operator": (0.0,),
        "phase": (float(phase),),
        "emergency_stop": (0.0,),
        "operator_age": (0.0,),
    }


@pytest.fixture
def watch(stand):
    """watch(phase, **inputs): a detector that has seen a healthy machine, but for the inputs."""

    class Watch(stand):
        def reset(self):
            """The operator asks for a reset for one period."""
            return self.tick(operator=Command.RESET).set(operator=0.0)

        @property
        def findings(self):
            return {Finding(int(i)) for i in np.flatnonzero(self["findings"])}

        @property
        def severity(self):
            return self["severity"].item()

    def begin(phase=Phase.HOLD, params=PARAMS, **inputs):
        given = healthy(phase) | inputs
        watch = Watch(FaultDetector(DRAWN, params, PERIOD), **given)
        # A detector that begins while feet stand has no attitude from before they touched.
        return watch.tick(limits=OPEN).tick(limits=given["limits"])

    return begin


# A healthy machine


@pytest.mark.parametrize("changes", [{}, {"extended": 0.44}, {"retracted": 0.46}])
def test_end_switches_close_where_a_machine_has_them(watch, changes):
    found = watch(Phase.TRANSPORT, replace(PARAMS, **changes)).wait(0.3).findings
    assert found == ({Finding.SWITCH_END} if changes else set())


@pytest.mark.parametrize("phase", Phase)
def test_noise_and_flicker_of_a_machine_at_rest_are_no_fault(watch, phase):
    random, imu, inputs = np.random.default_rng(0), ImuParams(), healthy(phase)
    detector = watch(phase)
    bandwidth = math.sqrt(0.5 / PERIOD)
    for _ in range(200):
        detector.tick(
            extension=inputs["extension"] + COUNT * random.integers(0, 2, 4),
            gyro=math.radians(0.5) + random.normal(0.0, imu.gyro_noise_density * bandwidth, 3),
            accel=inputs["accel"]
            + 0.01
            + random.normal(0.0, imu.accel_noise_density * bandwidth, 3),
            attitude=inputs["attitude"] + random.normal(0.0, math.radians(0.02), 2),
            age=random.uniform(0.0, 0.03, 4),
        )
        assert detector.findings == set()
    assert detector.severity == Severity.NONE


@pytest.mark.parametrize(("allowed", "limit"), [(0.02, 0.05), (0.08, 0.08)])
def test_data_may_be_as_old_as_usual_or_as_is_allowed(watch, allowed, limit):
    def found(age):
        detector = watch()
        assert detector.system.allow_age(detector.context, allowed) == 0.05
        return detector.wait(0.3, age=age).findings

    assert found(np.full(4, 0.99 * limit)) == set()
    assert found(np.full(4, 1.01 * limit)) == {Finding.LEGS_STALE, Finding.IMU_STALE}


@pytest.mark.parametrize("allowed", [0.05, 0.08])
def test_legs_that_are_shown_late_are_compared_with_where_they_may_be(watch, allowed):
    detector = watch(Phase.RETRACT)
    detector.system.allow_age(detector.context, allowed)
    begun, volts = healthy(Phase.RETRACT)["extension"], np.full(4, 3.0)
    late = np.r_[np.zeros(20), 1.0, 2.0, 3.0, np.zeros(5)]  # ticks
    for k, ticks in enumerate(late):
        way = 0.01 * K * volts * max(0.0, k - ticks)
        detector.tick(extension=begun + way, voltage=volts)
    is_accused = {Finding.LEG_RESPONSE, Finding.SUPPLY} <= detector.findings
    assert is_accused == (allowed == 0.05)
    for _ in range(200):  # encoders that are stuck now
        detector.tick()
    assert Finding.LEG_RESPONSE in detector.findings


def test_a_whole_operation_at_rest_goes_through_its_phases_without_a_finding(watch):
    """Extensions between phases are those of legs that have moved as their voltages said."""
    detector = watch(Phase.TRANSPORT)
    here = healthy(Phase.TRANSPORT)["extension"]
    for phase in (*Phase, Phase.TRANSPORT):
        inputs = healthy(phase)
        way = inputs["extension"] - here
        detector.set(phase=Phase.RETRACT, voltage=way / 3.0 / K, limits=OPEN)
        for part in np.linspace(0.0, 1.0, 300):
            detector.tick(extension=here + part * way)
        here = inputs["extension"]
        assert detector.wait(1.0, **inputs).findings == set()


def test_a_platform_may_turn_about_its_vertical_as_fast_as_its_wheels_can(watch):
    for turn in (-50.0, 50.0):
        assert watch(Phase.TRANSPORT, gyro=(0.0, 0.0, turn)).wait(0.2).findings == set()


def test_switches_may_differ_from_the_extensions_by_their_tolerance(watch):
    for at, switch in itertools.product((0.4578, 0.4610), (0.0, 1.0)):
        limits = np.repeat((switch, 0.0), (4, 8))
        detector = watch(Phase.TRANSPORT, extension=np.full(4, at), limits=limits)
        assert detector.wait(0.2).findings == set()


# Each finding

UNEVEN = OFFSETS + 5e-3 * np.array((1.0, -1.0, 1.0, -1.0))
TILTED = POSTURE[:2] + np.radians((0.0, 0.7))
# What shows each finding, at rest, in a phase in which it counts.
SIGNS = {
    "nan extension": (
        Finding.ENCODER_INVALID,
        Phase.HOLD,
        {"extension": changed(STANDING, 2, math.nan)},
    ),
    "too long": (
        Finding.ENCODER_INVALID,
        Phase.LOWER,
        {"extension": changed(RAISED, 0, 0.0155), "limits": changed(OPEN, 0, 1.0)},
    ),
    "too short": (
        Finding.ENCODER_INVALID,
        Phase.BRAKE,
        {"extension": changed(RAISED, 3, -0.08), "limits": changed(OPEN, 7, 1.0)},
    ),
    "jump": (Finding.ENCODER_JUMP, Phase.TRANSPORT, {"extension": changed(RAISED, 1, 1.6e-3)}),
    "old legs": (Finding.LEGS_STALE, Phase.POSTURE, {"age": (0.06, 0.0, 0.0, 0.0)}),
    "legs of unknown age": (Finding.LEGS_STALE, Phase.RETRACT, {"age": (math.nan, 0, 0, 0)}),
    "uneven feet": (Finding.FEET_MISMATCH, Phase.HOLD, {"foot_offsets": UNEVEN}),
    "tilt": (
        Finding.POSTURE_MISMATCH,
        Phase.POSTURE,
        {"attitude": TILTED, "accel": gravity(*TILTED)},
    ),
    "other ground": (
        Finding.POSTURE_MISMATCH,
        Phase.HOLD,
        {"ground": GROUND + np.radians((0.7, 0.0))},
    ),
    "fast roll": (Finding.GYRO_INVALID, Phase.TRANSPORT, {"gyro": (0.07, 0.0, 0.0)}),
    "fast pitch": (Finding.GYRO_INVALID, Phase.HOLD, {"gyro": (0.0, -0.07, 0.0)}),
    "nan gyro": (Finding.GYRO_INVALID, Phase.HOLD, {"gyro": (0.0, 0.0, math.nan)}),
    "strong force": (Finding.ACCEL_INVALID, Phase.HOLD, {"accel": gravity(0.0, 0.0, 10.5)}),
    "weak force": (Finding.ACCEL_INVALID, Phase.HOLD, {"accel": gravity(0.0, 0.0, 9.1)}),
    "nan force": (Finding.ACCEL_INVALID, Phase.BRAKE, {"accel": (math.nan, 0.0, GRAVITY)}),
    "other vertical": (
        Finding.ACCEL_MISMATCH,
        Phase.HOLD,
        {"accel": gravity(math.radians(2.1), 0.0)},
    ),
    "old samples": (Finding.IMU_STALE, Phase.HOLD, {"age": (0.0, 0.06, 0.0, 0.0)}),
    "closed end switch": (Finding.SWITCH_END, Phase.TRANSPORT, {"limits": changed(OPEN, 2, 1.0)}),
    "closed near switch": (Finding.SWITCH_END, Phase.HOLD, {"limits": changed(TOUCHED, 6, 1.0)}),
    "foot in the air": (Finding.SWITCH_CONTACT, Phase.BRAKE, {"limits": changed(OPEN, 10, 1.0)}),
    "open contact": (Finding.FOOT_LOST, Phase.HOLD, {"limits": changed(TOUCHED, 11, -1.0)}),
    "nan contact": (Finding.FOOT_LOST, Phase.POSTURE, {"limits": changed(TOUCHED, 8, math.nan)}),
    "pushed": (
        Finding.PUSHED_UP,
        Phase.ESTIMATE,
        {"attitude": GROUND + np.radians((0.0, 0.4))},
    ),
    "pressed stop": (Finding.EMERGENCY_STOP, Phase.TRANSPORT, {"emergency_stop": (1.0,)}),
    "unknown stop": (Finding.EMERGENCY_STOP, Phase.HOLD, {"emergency_stop": (math.nan,)}),
    "silent operator": (Finding.OPERATOR_LOST, Phase.LOWER, {"operator_age": (0.31,)}),
    "no operator": (Finding.OPERATOR_LOST, Phase.HOLD, {"operator_age": (math.inf,)}),
    "nan command": (Finding.COMMAND_INVALID, Phase.HOLD, {"posture_request": (0, math.nan, 0.48)}),
}
# Periods during which a sign lasts before it is believed; other findings follow at once.
PERSISTS = {
    Finding.GYRO_INVALID: 5,
    Finding.SWITCH_CONTACT: 5,
    Finding.SWITCH_END: 10,
    Finding.PUSHED_UP: 10,
    Finding.ACCEL_INVALID: 15,
    Finding.FEET_MISMATCH: 20,
    Finding.POSTURE_MISMATCH: 30,
    Finding.ACCEL_MISMATCH: 40,
    Finding.FOOT_LOST: 80,
}


def test_there_is_a_sign_for_each_finding_that_is_not_judged_from_motion():
    shown = {finding for finding, _, _ in SIGNS.values()}
    assert shown | {Finding.LEG_RESPONSE, Finding.SUPPLY} == set(Finding)


@pytest.mark.parametrize("sign", SIGNS)
def test_a_sign_is_believed_when_it_has_lasted_and_stays_until_it_is_reset(watch, sign):
    finding, phase, inputs = SIGNS[sign]
    rule, well, lasts = RULES[finding], healthy(phase), sign != "jump"
    detector = watch(phase)
    assert detector.tick(10).findings == set()
    detector.tick(PERSISTS.get(finding, 0), **inputs)
    assert (detector.findings, detector.severity) == (set(), Severity.NONE)
    detector.tick()
    assert (detector.findings, detector.severity) == ({finding}, rule.severity)
    if lasts:
        # It is the sign of nothing else, and no reset clears what is still there.
        assert detector.wait(3.0).findings == {finding}
        assert detector.reset().findings == {finding}
        assert detector.severity == rule.severity
    else:
        del well["extension"]  # to jump back is a jump as well
    stays = detector.wait(1.0, **well).findings
    assert finding in stays
    assert detector.severity == max(RULES[found].severity for found in stays)
    assert detector.reset().findings == set()
    assert detector.severity == Severity.NONE
    assert detector.wait(1.0).findings == set()


def test_a_sign_that_goes_before_it_is_believed_is_forgotten(watch):
    finding, phase, inputs = SIGNS["other vertical"]
    detector = watch(phase)
    for _ in range(3):
        assert detector.tick(PERSISTS[finding], **inputs).findings == set()
        assert detector.tick(**healthy(phase)).findings == set()


def test_only_a_reset_clears_and_one_that_is_kept_down_does_so_once(watch):
    detector = watch(age=(0.0, 0.06, 0.0, 0.0)).tick()
    detector.tick(2, operator=Command.RESET)
    detector.tick(2, age=np.zeros(4))
    for command in (0.0, Command.GO, Command.STOP, 2.9, math.nan):
        assert detector.tick(2, operator=command).findings == {Finding.IMU_STALE}
    assert detector.reset().findings == set()


def test_the_worst_severity_counts(watch):
    detector = watch().tick(posture_request=[math.nan] * 3)
    assert detector.severity == Severity.WARN
    assert detector.tick(age=(0.0, 1.0, 0.0, 0.0)).severity == Severity.HOLD
    assert detector.tick(age=(1.0, 1.0, 0.0, 0.0)).severity == Severity.BRAKE
    detector.tick(10, age=np.zeros(4))
    assert detector.findings == {
        Finding.COMMAND_INVALID,
        Finding.IMU_STALE,
        Finding.LEGS_STALE,
    }
    assert detector.severity == Severity.BRAKE
    assert detector.reset().findings == {Finding.COMMAND_INVALID}
    assert detector.severity == Severity.WARN


# What counts in some phases only


@pytest.mark.parametrize("phase", Phase)
def test_signs_of_feet_count_while_the_platform_stands_on_them(watch, phase):
    lost = {Finding.FOOT_LOST} if phase in ON_FEET else set()
    assert watch(phase, limits=OPEN).wait(1.0).findings == lost
    wrong = {Finding.FEET_MISMATCH, Finding.POSTURE_MISMATCH} if phase in ON_FEET else set()
    detector = watch(phase).wait(1.0, foot_offsets=UNEVEN, ground=GROUND + 0.03)
    assert detector.findings == wrong


@pytest.mark.parametrize("phase", Phase)
def test_a_tilt_is_a_push_only_while_legs_look_for_the_ground(watch, phase):
    """The feet have touched; outside those phases the platform may tilt as it is told."""
    detector = watch(phase, limits=OPEN, extension=TOUCHING).tick(limits=TOUCHED)
    detector.wait(0.5, attitude=healthy(phase)["attitude"] + (math.radians(0.4), 0.0))
    looking = phase in (Phase.LOWER, Phase.TOUCHDOWN, Phase.ESTIMATE)
    assert (Finding.PUSHED_UP in detector.findings) == looking


def test_a_push_is_judged_from_the_attitude_before_the_first_foot_touched(watch):
    detector = watch(Phase.LOWER, extension=TOUCHING)
    # The estimate still settles while the legs go down.
    for part in np.linspace(0.0, 1.0, 100):
        detector.tick(attitude=GROUND + part * math.radians(1.2))
        assert detector.findings == set()
    settled = GROUND + math.radians(1.2)
    detector.tick(limits=changed(OPEN, 9, 1.0))
    # Slow or fast makes no difference, and each further foot neither.
    for contact, tilt in (((1, 0, 0), 0.15), ((1, 1, 0), 0.25), ((1, 1, 1), 0.34)):
        detector.set(attitude=settled - (0.0, math.radians(tilt)))
        detector.wait(0.5, limits=[*[0] * 8, contact[0], 1, *contact[1:]])
        assert detector.findings == set()
    detector.set(phase=Phase.TOUCHDOWN, attitude=settled - (0.0, math.radians(0.36)))
    assert detector.wait(0.11).findings == {Finding.PUSHED_UP}


# Legs and voltages


def drive(detector, seconds, voltage, rate_of, until=None):
    """Drives legs open loop, to and fro by turns of half a second, seen in counts that flicker.

    Begins where they were left, and returns the time of the finding `until`, or None.
    """
    random = np.random.default_rng(0)
    extension = detector.system.GetInputPort("extension").Eval(detector.context).copy()
    for k in range(round(seconds / PERIOD)):
        v = voltage * (1.0 if k % 100 < 50 else -1.0)
        seen = COUNT * (np.floor(extension / COUNT) + random.integers(0, 2, 4))
        detector.tick(extension=seen, voltage=np.full(4, v))
        if until in detector.findings:
            return PERIOD * k
        extension = extension + PERIOD * np.array([rate_of(leg, v) for leg in range(4)])
    return None


def moves(voltage, gain=1.0, friction=0.12):
    """Rate of an actuator [m/s]."""
    return math.copysign(gain * K * max(0.0, abs(voltage) - friction), voltage)


@pytest.fixture
def legs(watch):
    """A detector of legs that are about to be driven."""
    return watch(Phase.LOWER, extension=np.full(4, 0.42))


@pytest.mark.parametrize("voltage", [0.0, 0.1, 0.3, 1.0, 2.5])
def test_legs_within_their_tolerances_are_healthy(legs, voltage):
    tolerances = list(itertools.product((0.8, 1.2), (0.0, 0.12)))
    drive(legs, 4.0, voltage, lambda leg, v: moves(v, *tolerances[leg]))
    assert legs.findings == set()


WRONG = {
    "reversed": lambda v: moves(-v),
    "dead": lambda v: 0.0,
    "weak": lambda v: moves(v, 0.4),
    "stuck to the supply": lambda v: 0.02,
}


@pytest.mark.parametrize(
    ("wrong", "voltage", "leg"),
    [
        *(
            (wrong, voltage, leg)
            for wrong in ("reversed", "dead", "stuck to the supply")
            for leg, voltage in enumerate((0.4, -0.4, 1.0, 3.0))
        ),
        # Half of little is within what friction may take.
        ("weak", 1.0, 0),
        ("weak", 3.0, 1),
    ],
)
def test_a_leg_that_does_not_do_as_told_is_found_in_time(legs, wrong, voltage, leg):
    drive(legs, 0.5, voltage, lambda _, v: moves(v))
    rule = RULES[Finding.LEG_RESPONSE]
    after = drive(
        legs,
        2.6,
        voltage,
        lambda i, v: WRONG[wrong](v) if i == leg else moves(v),
        until=rule.finding,
    )
    assert after is not None
    assert after <= rule.deadline
    assert (legs.findings, legs.severity) == ({rule.finding}, rule.severity)


def test_an_encoder_that_creeps_without_voltage_is_found(legs):
    after = drive(legs, 2.5, 0.0, lambda i, _: 1e-3 * (i == 1), until=Finding.LEG_RESPONSE)
    assert after is not None
    assert after <= RULES[Finding.LEG_RESPONSE].deadline


@pytest.mark.parametrize("says_its_age", [True, False])
def test_a_measurement_that_is_seen_twice_is_no_leg_that_stands_still(legs, says_its_age):
    """Every second one is late: legs are shown where they were, then two periods further."""
    volts, way = np.full(4, 0.9), np.full(4, 0.42)
    legs.set(voltage=volts)
    for k in range(300):
        if not k % 2:
            legs.set(extension=way)
        legs.tick(age=np.full(4, 0.002 + PERIOD * (k % 2 and says_its_age)))
        way = way + PERIOD * moves(volts[0], 0.85)
    assert (Finding.LEG_RESPONSE in legs.findings) != says_its_age


@pytest.mark.parametrize("dead", [(0, 2), (0, 1, 3)])
def test_three_legs_that_stand_still_are_the_supply(legs, dead):
    drive(legs, 2.0, 1.0, lambda i, v: 0.0 if i in dead else moves(v))
    supply = {Finding.SUPPLY} if len(dead) >= 3 else set()
    assert legs.findings == {Finding.LEG_RESPONSE} | supply
    assert legs.severity == Severity.BRAKE


def test_a_response_that_was_wrong_can_be_reset_after_a_rest_and_not_at_once(legs):
    assert drive(legs, 2.0, 1.0, lambda i, v: 0.0, until=Finding.SUPPLY) is not None
    legs.set(voltage=np.zeros(4))
    assert Finding.LEG_RESPONSE in legs.reset().findings
    assert legs.wait(2.0).reset().findings == set()


def test_a_leg_that_jumps_has_not_moved_against_its_voltage(watch):
    """The jump is the encoder's, and says nothing about the drive."""
    detector = watch(Phase.TRANSPORT).wait(2.0, extension=changed(RAISED, 0, 5e-3))
    assert detector.findings == {Finding.ENCODER_JUMP}


# Bad input


@pytest.mark.parametrize("name", healthy(Phase.HOLD))
def test_bad_input_leaves_nothing_behind(watch, name):
    good = healthy(Phase.HOLD)[name]
    for bad in (math.nan, math.inf):
        detector = watch().tick(5, **{name: np.full(np.shape(good), bad)})
        assert detector.wait(2.0, **{name: good}).reset().findings == set()
        assert detector.wait(0.5).findings == set()


def test_everything_at_once_may_be_nan(watch):
    well = healthy(Phase.HOLD)
    detector = watch().wait(
        1.0, **{name: np.full(np.shape(v), math.nan) for name, v in well.items()}
    )
    assert {Finding.ENCODER_INVALID, Finding.LEGS_STALE, Finding.IMU_STALE} <= detector.findings
    assert detector.severity == Severity.LATCHED_OFF


@pytest.mark.parametrize("phase", [-1.0, 10.0])
def test_a_phase_that_is_none_is_no_reason_to_stop_looking(watch, phase):
    detector = watch()
    assert detector.wait(1.0, phase=phase).findings == set()
    assert detector.tick(age=(1.0, 0.0, 0.0, 0.0)).findings == {Finding.LEGS_STALE}


# The rules


def test_there_is_one_rule_for_each_finding_that_can_be_found_in_time_and_be_told():
    assert [rule.finding for rule in RULES] == list(Finding)
    assert list(map(int, Finding)) == list(range(len(RULES)))
    for rule in RULES:
        assert 0.0 <= rule.persists < rule.deadline
        # It is told at least; only who has pressed the stop has to look before it goes on.
        pressed = rule.finding is Finding.EMERGENCY_STOP
        assert rule.severity >= Severity.WARN
        assert pressed == (rule.severity > Severity.BRAKE)
        assert rule.device
        assert rule.sign
        assert "|" not in rule.device + rule.sign


def test_what_moves_the_legs_wrongly_takes_their_drives_out_of_control():
    """A position controller cannot be trusted with an extension that is wrong."""
    trusted = {rule.finding for rule in RULES if rule.severity < Severity.BRAKE}
    assert not trusted & {
        Finding.ENCODER_INVALID,
        Finding.ENCODER_JUMP,
        Finding.LEGS_STALE,
        Finding.LEG_RESPONSE,
        Finding.SUPPLY,
    }


def test_the_list_for_people_names_all_of_them_with_severity_and_deadline():
    lines = as_markdown().splitlines()
    for line, rule in zip(lines, RULES, strict=True):
        name, sign, severity, deadline, device = re.fullmatch(
            r"\* `(\w+)`: (.+); (\w+), within ([\d.]+) s, (.+)", line
        ).groups()
        assert (name, severity) == (rule.finding.name.lower(), rule.severity.name.lower())
        assert (sign, device, float(deadline)) == (rule.sign, rule.device, rule.deadline)
