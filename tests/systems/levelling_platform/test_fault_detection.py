"""What shows a fault, what does not, and for how long it is remembered."""

import itertools
import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.fault_detection import (
    RULES,
    FaultDetector,
    Finding,
    Rule,
    as_markdown,
)
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.plane import to_platform
from parapod.systems.levelling_platform.supervisor import Command, Phase
from parapod.systems.safety.faults import Severity
from parapod.systems.sensors.imu import ImuParams

PERIOD = 0.01
COUNT = 1e-5  # of the encoders [m]
K = 0.01  # Eq. (18) [(m/s)/V]
GRAVITY = 9.81
GROUND = np.radians((2.0, 3.0))
POSTURE = np.array((0.0, 0.0, 0.485))
OFFSETS = 1e-3 * np.array((2.0, -2.0, 2.0, -2.0))
STANDING = inverse_kinematics(MODEL_GEOMETRY, POSTURE, GROUND, OFFSETS)
RAISED, TOUCHING = np.full(4, 0.450), np.array((0.4302, 0.4221, 0.4275, 0.4252))
ON_WHEELS = (Phase.TRANSPORT, Phase.BRAKE, Phase.LOWER, Phase.RETRACT)
ON_FEET = (Phase.POSTURE, Phase.HOLD)
TOUCHED = np.repeat((0.0, 1.0), (8, 4))
OPEN = np.zeros(12)
SIZES = {
    "extension": 4,
    "limits": 12,
    "voltage": 4,
    "gyro": 3,
    "accel": 3,
    "age": 4,
    "attitude": 2,
    "ground": 2,
    "foot_offsets": 4,
    "posture_request": 3,
    "operator": 1,
    "phase": 1,
}


def gravity(roll, pitch, size=GRAVITY):
    """What an accelerometer at rest shows."""
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
    }


class Watch:
    """A detector whose inputs are fixed by the test, period by period."""

    def __init__(self, fix, phase=Phase.HOLD, **inputs):
        self.system = FaultDetector(MODEL_GEOMETRY, period=PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        given = healthy(phase) | inputs
        # A detector that begins while feet stand has no attitude from before they touched.
        self.set(**(given | {"limits": OPEN}))
        self.tick()
        self.set(limits=given["limits"])
        self.tick()

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def tick(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            values = [ahead.value(i).copy() for i in range(ahead.num_groups())]
            self.context.SetTime(self.context.get_time() + PERIOD)
            for i, value in enumerate(values):
                self.context.SetDiscreteState(i, value)
        return self.findings

    def wait(self, seconds):
        return self.tick(round(seconds / PERIOD))

    def reset(self):
        """The operator asks for a reset for one period."""
        self.set(operator=(float(Command.RESET),))
        self.tick()
        self.set(operator=(0.0,))
        return self.findings

    @property
    def flags(self):
        return self.system.GetOutputPort("findings").Eval(self.context)

    @property
    def findings(self):
        return {Finding(int(i)) for i in np.flatnonzero(self.flags)}

    @property
    def severity(self):
        return float(self.system.GetOutputPort("severity").Eval(self.context)[0])


# A healthy machine


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_and_flicker_of_a_machine_at_rest_are_no_fault(fix, phase, seed):
    random, imu, inputs = np.random.default_rng(seed), ImuParams(), healthy(phase)
    watch = Watch(fix, phase)
    bandwidth = math.sqrt(0.5 / PERIOD)
    for _ in range(400):
        watch.set(
            extension=inputs["extension"] + COUNT * random.integers(0, 2, 4),
            gyro=math.radians(0.5) + random.normal(0.0, imu.gyro_noise_density * bandwidth, 3),
            accel=inputs["accel"]
            + 0.01
            + random.normal(0.0, imu.accel_noise_density * bandwidth, 3),
            attitude=inputs["attitude"] + random.normal(0.0, math.radians(0.02), 2),
            age=random.uniform(0.0, 0.03, 4),
        )
        assert watch.tick() == set()
    assert watch.severity == Severity.NONE


def test_a_whole_operation_at_rest_goes_through_its_phases_without_a_finding(fix):
    """Extensions between phases are those of legs that have moved as their voltages said."""
    watch = Watch(fix, Phase.TRANSPORT)
    here = healthy(Phase.TRANSPORT)["extension"]
    for phase in (*Phase, Phase.TRANSPORT):
        inputs = healthy(phase)
        way = inputs["extension"] - here
        watch.set(phase=(float(Phase.RETRACT),))
        for part in np.linspace(0.0, 1.0, 300):
            watch.set(extension=here + part * way, voltage=way / 3.0 / K, limits=OPEN)
            assert watch.tick() == set()
        here = inputs["extension"]
        watch.set(**inputs)
        assert watch.wait(1.0) == set()


@pytest.mark.parametrize("turn", [-50.0, 0.5, 50.0])
def test_a_platform_may_turn_about_its_vertical_as_fast_as_its_wheels_can(fix, turn):
    watch = Watch(fix, Phase.TRANSPORT, gyro=(0.0, 0.0, turn))
    assert watch.wait(1.0) == set()


def test_switches_may_differ_from_the_extensions_by_their_tolerance(fix):
    for at, switch in itertools.product((0.4578, 0.4610), (0.0, 1.0)):
        watch = Watch(
            fix, Phase.TRANSPORT, extension=np.full(4, at), limits=np.repeat((switch, 0.0), (4, 8))
        )
        assert watch.wait(1.0) == set()


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
    "nan command": (Finding.COMMAND_INVALID, Phase.HOLD, {"posture_request": (0, math.nan, 0.48)}),
}
EACH_SIGN = pytest.mark.parametrize("sign", SIGNS)
# Their signs end by themselves, or are judged from motion.
MOVING = {Finding.LEG_RESPONSE, Finding.SUPPLY}
LASTING = pytest.mark.parametrize("sign", [sign for sign in SIGNS if sign != "jump"])


def show(fix, sign):
    """A watch that has seen a healthy machine and is shown the sign from now on."""
    finding, phase, inputs = SIGNS[sign]
    watch = Watch(fix, phase)
    assert watch.wait(0.1) == set()
    watch.set(**inputs)
    return watch, RULES[finding], healthy(phase)


def test_there_is_a_sign_for_each_finding():
    assert {finding for finding, _, _ in SIGNS.values()} | MOVING == set(Finding)


@EACH_SIGN
def test_a_sign_is_believed_when_it_has_lasted_and_not_before(fix, sign):
    watch, rule, _ = show(fix, sign)
    assert watch.wait(rule.persists) == set()
    assert watch.severity == Severity.NONE
    assert watch.tick() == {rule.finding}
    assert watch.severity == rule.severity


@LASTING
def test_a_lasting_sign_is_the_sign_of_one_finding_only(fix, sign):
    watch, rule, _ = show(fix, sign)
    assert watch.wait(4.0) == {rule.finding}


@pytest.mark.parametrize(
    "sign", [sign for sign, (finding, _, _) in SIGNS.items() if RULES[finding].persists]
)
def test_a_sign_that_goes_before_it_is_believed_is_forgotten(fix, sign):
    watch, rule, well = show(fix, sign)
    for _ in range(3):
        watch.set(**SIGNS[sign][2])
        assert watch.wait(rule.persists) == set()
        watch.set(**well)
        assert watch.tick() == set()


@EACH_SIGN
def test_a_finding_stays_when_its_sign_has_gone_until_it_is_reset(fix, sign):
    watch, rule, well = show(fix, sign)
    watch.wait(rule.persists + PERIOD)
    watch.set(**{name: value for name, value in well.items() if name != "extension"})
    if sign != "jump":
        watch.set(extension=well["extension"])
    stays = watch.wait(1.0)
    assert rule.finding in stays
    assert watch.severity == max(RULES[finding].severity for finding in stays)
    assert watch.reset() == set()
    assert watch.severity == Severity.NONE
    assert watch.wait(1.0) == set()


@LASTING
def test_a_reset_does_not_clear_what_is_still_there(fix, sign):
    watch, rule, well = show(fix, sign)
    watch.wait(rule.persists + 2 * PERIOD)
    assert watch.reset() == {rule.finding}
    assert watch.severity == rule.severity
    # A reset that is kept down does not clear it later either.
    watch.set(operator=(float(Command.RESET),))
    watch.tick(2)
    watch.set(**(well | {"operator": (float(Command.RESET),)}))
    assert rule.finding in watch.wait(0.5)


@pytest.mark.parametrize("command", [0.0, Command.GO, Command.STOP, 2.9, math.nan, math.inf])
def test_nothing_but_a_reset_clears(fix, command):
    watch, rule, well = show(fix, "old samples")
    watch.wait(0.1)
    watch.set(**(well | {"operator": (float(command),)}))
    assert watch.wait(0.1) == {rule.finding}


def test_the_worst_severity_counts(fix):
    watch = Watch(fix)
    watch.set(posture_request=[math.nan] * 3)
    watch.tick()
    assert watch.severity == Severity.WARN
    watch.set(age=(0.0, 1.0, 0.0, 0.0))
    watch.tick()
    assert watch.severity == Severity.HOLD
    watch.set(age=(1.0, 1.0, 0.0, 0.0))
    watch.tick()
    assert watch.severity == Severity.BRAKE
    watch.set(age=(0.0, 0.0, 0.0, 0.0))
    assert watch.wait(0.1) == {Finding.COMMAND_INVALID, Finding.IMU_STALE, Finding.LEGS_STALE}
    assert watch.severity == Severity.BRAKE
    assert watch.reset() == {Finding.COMMAND_INVALID}
    assert watch.severity == Severity.WARN


# What counts in some phases only


@pytest.mark.parametrize("phase", Phase)
def test_a_foot_may_be_open_unless_the_platform_stands_on_it(fix, phase):
    watch = Watch(fix, phase, limits=OPEN)
    assert watch.wait(2.0) == ({Finding.FOOT_LOST} if phase in ON_FEET else set())


@pytest.mark.parametrize("phase", Phase)
def test_feet_and_posture_are_compared_only_on_feet(fix, phase):
    watch = Watch(fix, phase)
    watch.set(foot_offsets=UNEVEN, ground=GROUND + 0.03)
    wrong = {Finding.FEET_MISMATCH, Finding.POSTURE_MISMATCH}
    assert watch.wait(2.0) == (wrong if phase in ON_FEET else set())


@pytest.mark.parametrize("phase", Phase)
def test_a_tilt_is_a_push_only_while_legs_look_for_the_ground(fix, phase):
    """The feet have touched; outside those phases the platform may tilt as it is told."""
    watch = Watch(fix, phase, limits=OPEN, extension=TOUCHING)
    watch.set(limits=TOUCHED)
    watch.tick()
    watch.set(attitude=healthy(phase)["attitude"] + (math.radians(0.4), 0.0))
    looking = phase in (Phase.LOWER, Phase.TOUCHDOWN, Phase.ESTIMATE)
    assert (Finding.PUSHED_UP in watch.wait(1.0)) == looking


def test_a_push_is_judged_from_the_attitude_before_the_first_foot_touched(fix):
    watch = Watch(fix, Phase.LOWER, extension=TOUCHING)
    # The estimate still settles while the legs go down.
    for part in np.linspace(0.0, 1.0, 100):
        watch.set(attitude=GROUND + part * math.radians(1.2))
        assert watch.tick() == set()
    settled = GROUND + math.radians(1.2)
    watch.set(limits=changed(OPEN, 9, 1.0))
    watch.tick()
    # Slow or fast makes no difference, and each further foot neither.
    for contact, tilt in (((1, 0, 0), 0.15), ((1, 1, 0), 0.25), ((1, 1, 1), 0.34)):
        watch.set(limits=[*[0] * 8, contact[0], 1, *contact[1:]])
        watch.set(attitude=settled - (0.0, math.radians(tilt)))
        assert watch.wait(1.0) == set()
    watch.set(phase=(float(Phase.TOUCHDOWN),), attitude=settled - (0.0, math.radians(0.36)))
    assert watch.wait(0.11) == {Finding.PUSHED_UP}


# Legs and voltages


class Legs:
    """Legs that are driven open loop, seen in whole counts that flicker."""

    def __init__(self, watch, seed=0):
        self.watch, self._random = watch, np.random.default_rng(seed)
        self.extension = np.full(4, 0.42)

    def drive(self, seconds, voltage, rate_of, until=None):
        """Drives to and fro by turns of half a second; time of `until`, or None."""
        for k in range(round(seconds / PERIOD)):
            v = np.broadcast_to(voltage, 4) * (1.0 if k % 100 < 50 else -1.0)
            seen = COUNT * (np.floor(self.extension / COUNT) + self._random.integers(0, 2, 4))
            self.watch.set(extension=seen, voltage=v)
            found = self.watch.tick()
            if until in found:
                return PERIOD * k
            self.extension = self.extension + PERIOD * np.array(
                [rate_of(leg, v[leg]) for leg in range(4)]
            )
        return None


def moves(voltage, gain=1.0, friction=0.12):
    """Rate of an actuator [m/s]."""
    return math.copysign(gain * K * max(0.0, abs(voltage) - friction), voltage)


def legs_of(fix):
    return Legs(Watch(fix, Phase.LOWER, extension=np.full(4, 0.42)))


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.12])
@pytest.mark.parametrize("voltage", [0.0, 0.1, 0.3, 1.0, 2.5])
def test_legs_within_their_tolerances_are_healthy(fix, gain, friction, voltage):
    legs = legs_of(fix)
    legs.drive(4.0, voltage, lambda leg, v: moves(v, gain, friction))
    assert legs.watch.findings == set()


WRONG = {
    "reversed": lambda v: moves(-v),
    "dead": lambda v: 0.0,
    "weak": lambda v: moves(v, 0.4),
    "stuck to the supply": lambda v: 0.02,
}


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize(
    ("wrong", "voltage"),
    [
        *itertools.product(("reversed", "dead", "stuck to the supply"), (0.4, -0.4, 1.0, 3.0)),
        # Half of little is within what friction may take.
        ("weak", 1.0),
        ("weak", 3.0),
    ],
)
def test_a_leg_that_does_not_do_as_told_is_found_in_time(fix, leg, voltage, wrong):
    legs = legs_of(fix)
    legs.drive(0.5, voltage, lambda _, v: moves(v))
    after = legs.drive(
        2.6,
        voltage,
        lambda i, v: WRONG[wrong](v) if i == leg else moves(v),
        until=Finding.LEG_RESPONSE,
    )
    rule = RULES[Finding.LEG_RESPONSE]
    assert after is not None
    assert after <= rule.deadline
    assert legs.watch.findings == {Finding.LEG_RESPONSE}
    assert legs.watch.severity == rule.severity


def test_an_encoder_that_creeps_without_voltage_is_found(fix):
    legs = legs_of(fix)
    after = legs.drive(2.5, 0.0, lambda i, _: 1e-3 * (i == 1), until=Finding.LEG_RESPONSE)
    assert after is not None
    assert after <= RULES[Finding.LEG_RESPONSE].deadline


@pytest.mark.parametrize("dead", [(0,), (0, 2), (0, 1, 3), (0, 1, 2, 3)])
def test_three_legs_that_stand_still_are_the_supply(fix, dead):
    legs = legs_of(fix)
    legs.drive(2.0, 1.0, lambda i, v: 0.0 if i in dead else moves(v))
    supply = {Finding.SUPPLY} if len(dead) >= 3 else set()
    assert legs.watch.findings == {Finding.LEG_RESPONSE} | supply
    assert legs.watch.severity == Severity.BRAKE


def test_a_response_that_was_wrong_can_be_reset_after_a_rest_and_not_at_once(fix):
    legs = legs_of(fix)
    watch = legs.watch
    assert legs.drive(2.0, 1.0, lambda i, v: 0.0, until=Finding.SUPPLY) is not None
    watch.set(voltage=np.zeros(4))
    assert Finding.LEG_RESPONSE in watch.reset()
    watch.wait(2.0)
    assert watch.reset() == set()


def test_a_leg_that_jumps_has_not_moved_against_its_voltage(fix):
    """The jump is the encoder's, and says nothing about the drive."""
    watch = Watch(fix, Phase.TRANSPORT)
    watch.set(extension=changed(RAISED, 0, 5e-3))
    assert watch.wait(2.0) == {Finding.ENCODER_JUMP}


# Bad input

BAD = {"nan": math.nan, "infinite": math.inf, "minus infinite": -math.inf, "absurd": 1e6}


@pytest.mark.parametrize("phase", [Phase.TRANSPORT, Phase.LOWER, Phase.ESTIMATE, Phase.HOLD])
@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", SIZES)
def test_whatever_comes_in_the_outputs_are_findings(fix, name, bad, phase):
    watch = Watch(fix, phase)
    good = np.array(healthy(phase)[name], dtype=float)
    for index in (*range(SIZES[name]), slice(None)):
        value = good.copy()
        value[index] = BAD[bad]
        watch.set(**{name: value})
        watch.tick(5)
        assert np.isin(watch.flags, (0.0, 1.0)).all()
        assert watch.severity in list(Severity)
    watch.set(**{name: good})
    if (name, bad) != ("voltage", "absurd"):  # A leg would have moved by kilometres.
        watch.wait(2.0)
        watch.reset()
        assert watch.wait(0.5) == set()


def test_everything_at_once_may_be_nan(fix):
    watch = Watch(fix)
    watch.set(**{name: np.full(size, math.nan) for name, size in SIZES.items()})
    watch.wait(3.0)
    assert {Finding.ENCODER_INVALID, Finding.LEGS_STALE, Finding.IMU_STALE} <= watch.findings
    assert watch.severity == Severity.BRAKE


@pytest.mark.parametrize("phase", [-1.0, 9.0, 1e6])
def test_a_phase_that_is_none_is_no_reason_to_stop_looking(fix, phase):
    watch = Watch(fix)
    watch.set(phase=(phase,))
    assert watch.wait(1.0) == set()
    watch.set(age=(1.0, 0.0, 0.0, 0.0))
    assert watch.tick() == {Finding.LEGS_STALE}


def test_the_first_sample_is_no_jump(fix):
    """Extensions before it are not known."""
    assert Watch(fix, Phase.TRANSPORT).findings == set()


EACH_RULE = pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.finding.name.lower())


def test_there_is_one_line_for_each_finding_in_the_order_of_the_numbers():
    assert [rule.finding for rule in RULES] == list(Finding)
    assert [int(rule.finding) for rule in RULES] == list(range(len(RULES)))


@EACH_RULE
def test_a_sign_is_believed_before_its_deadline(rule: Rule):
    assert 0.0 <= rule.persists < rule.deadline


@EACH_RULE
def test_what_is_found_is_told_at_least_and_never_waits_for_a_person(rule: Rule):
    assert Severity.WARN <= rule.severity <= Severity.BRAKE


@EACH_RULE
def test_each_line_says_what_may_have_failed_and_what_shows_it(rule: Rule):
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


def test_the_table_for_people_names_all_of_them_with_severity_and_deadline():
    head, rule_off, *lines = as_markdown().splitlines()
    assert head.count("|") == rule_off.count("|") == 6
    assert len(lines) == len(RULES)
    for line, rule in zip(lines, RULES, strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert cells[:2] == [rule.finding.name.lower(), rule.severity.name.lower()]
        assert float(cells[2]) == rule.deadline
        assert cells[3:] == [rule.device, rule.sign]
