import math

import numpy as np
import pytest

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.supervisor import (
    Command,
    Phase,
    Refusal,
    Supervisor,
    SupervisorParams,
)
from parapod.systems.safety.faults import Severity

PERIOD = 0.01
PARAMS = SupervisorParams()
POSTURE = (0.0, 0.0, 0.47)
OTHER = (0.0, 0.0, 0.46)
FAR = (0.0, 0.0, 0.7)
GROUND = (0.02, 0.03)
STEEP = (0.2, 0.1)
STANDING_HEIGHT = 0.390
DRIVE = (2.0, 2.5, 2.5, 2.0)
RAISED = np.full(4, PARAMS.raised)
LOW = np.full(4, 0.42)
AT_REST = np.zeros(6)
PHASES = list(Phase)
ON_LEGS = [Phase.POSTURE, Phase.HOLD]
STOPPABLE = [p for p in Phase if Phase.BRAKE <= p <= Phase.HOLD]


def switches(contact):
    return np.concatenate([np.zeros(8), contact])


class Operation:
    """A supervisor whose inputs are fixed by the test, period by period."""

    def __init__(self, fix, params=PARAMS, **inputs):
        self.system = Supervisor(MODEL_GEOMETRY, params, STANDING_HEIGHT, PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        self.extension = RAISED.copy()
        given = {
            "operator": (0.0,),
            "drive_request": DRIVE,
            "posture_request": POSTURE,
            "severity": (0.0,),
            "limits": switches([0.0] * 4),
            "extension": RAISED,
            "wheel_velocity": np.zeros(4),
            "ground": GROUND,
            "ground_valid": (1.0,),
            "foot_offsets": np.zeros(4),
            "posture_desired_state": AT_REST,
            "extension_desired_state": [*RAISED, 0, 0, 0, 0],
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def at(self, extension, desired=None):
        """Shows extensions, and desired ones (the same if not given)."""
        self.extension = np.array(extension, dtype=float)
        desired = self.extension if desired is None else desired
        self.set(extension=self.extension, extension_desired_state=[*desired, 0, 0, 0, 0])

    def touch(self, *contact):
        self.set(limits=switches(contact))

    def tick(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            values = [ahead.value(i).copy() for i in range(ahead.num_groups())]
            self.context.SetTime(self.context.get_time() + PERIOD)
            for i, value in enumerate(values):
                self.context.SetDiscreteState(i, value)
        return self.phase

    def wait(self, seconds):
        return self.tick(round(seconds / PERIOD))

    def command(self, code):
        """The operator says something for one period."""
        self.set(operator=(float(code),))
        self.tick()
        self.set(operator=(0.0,))
        return self.phase

    def move(self, times=1):
        """Legs that go at the rates that they are told."""
        for _ in range(times):
            self.tick()
            self.at(self.extension + PERIOD * self["leg_rate"])
        return self.phase

    def to(self, phase):
        """Goes to a phase by the usual way."""
        if phase is Phase.FAULT:
            self.set(severity=(float(Severity.HOLD),))
            self.tick()
            self.set(severity=(0.0,))
        elif phase is Phase.RETRACT:
            self.to(Phase.LOWER)
            self.at(LOW)
            self.command(Command.STOP)
        elif phase is not Phase.TRANSPORT:
            self.forward_to(phase)
        assert self.phase is phase
        return self

    def forward_to(self, phase):
        """Goes from transport to a phase as soon as it can be reached."""
        self.command(Command.GO)
        for step in range(Phase.LOWER, phase + 1):
            if step == Phase.TOUCHDOWN:
                self.at(LOW)
                self.touch(1, 1, 1, 1)
            for _ in range(1000):
                if self.phase >= step:
                    break
                self.tick()

    def __getitem__(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).copy()

    @property
    def phase(self):
        return Phase(int(self["phase"][0]))

    @property
    def refusal(self):
        why, detail = self["refusal"]
        return Refusal(int(why)), detail


def worst_leg(posture, ground, offsets=(0.0, 0.0, 0.0, 0.0)):
    """Number of the leg that misses a posture most, 1..4."""
    try:
        inverse_kinematics(MODEL_GEOMETRY, posture, ground, offsets)
    except UnreachablePosture as error:
        return error.leg
    raise AssertionError("the posture can be reached")


# Outputs of each phase


@pytest.mark.parametrize("phase", PHASES)
def test_brakes_are_off_and_wheels_obey_in_transport_only(fix, phase):
    operation = Operation(fix).to(phase)
    operation.tick()
    driving = phase is Phase.TRANSPORT
    assert operation["wheel_brake"].tolist() == [0.0 if driving else 1.0]
    assert operation["wheel_velocity_command"].tolist() == (list(DRIVE) if driving else [0.0] * 4)


@pytest.mark.parametrize("phase", PHASES)
def test_the_arm_may_work_while_a_posture_is_held_only(fix, phase):
    assert Operation(fix).to(phase)["arm_enable"].tolist() == [float(phase is Phase.HOLD)]


@pytest.mark.parametrize("phase", PHASES)
def test_legs_follow_a_posture_in_two_phases_only(fix, phase):
    assert Operation(fix).to(phase)["posture_control"].tolist() == [float(phase in ON_LEGS)]


@pytest.mark.parametrize("phase", PHASES)
def test_legs_move_by_themselves_only_when_lowered_or_raised(fix, phase):
    operation = Operation(fix).to(phase)
    operation.at(np.full(4, 0.43))
    operation.touch(0, 0, 0, 0)
    operation.tick()
    assert operation["leg_rate"].any() == (operation.phase in (Phase.LOWER, Phase.RETRACT))


@pytest.mark.parametrize("phase", PHASES)
def test_legs_are_controlled_in_every_phase_without_a_grave_fault(fix, phase):
    assert Operation(fix).to(phase)["legs_enable"].tolist() == [1.0]


def test_it_begins_in_transport_with_legs_controlled(fix):
    operation = Operation(fix)
    assert operation.phase is Phase.TRANSPORT
    assert operation["legs_enable"].tolist() == [1.0]
    assert operation.refusal == (Refusal.NONE, 0.0)


# Commands


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("command", [Command.GO, Command.STOP, Command.RESET])
def test_a_command_outside_its_phase_is_refused_with_the_phase_as_detail(fix, phase, command):
    operation = Operation(fix).to(phase)
    places = {
        Command.GO: [Phase.TRANSPORT],
        Command.STOP: STOPPABLE,
        Command.RESET: [Phase.FAULT],
    }
    operation.tick()
    after = operation.command(command)
    if phase in places[command]:
        assert after is not phase
        assert operation.refusal == (Refusal.NONE, 0.0)
    else:
        assert operation.refusal == (Refusal.COMMAND, float(phase))


@pytest.mark.parametrize("phase", STOPPABLE)
def test_stop_leads_to_transport_from_braking_and_to_retracting_from_all_that_follows(fix, phase):
    target = Phase.TRANSPORT if phase is Phase.BRAKE else Phase.RETRACT
    assert Operation(fix).to(phase).command(Command.STOP) is target


@pytest.mark.parametrize("code", [1.5, 4.0, -1.0])
def test_an_unknown_command_is_refused(fix, code):
    operation = Operation(fix)
    assert operation.command(code) is Phase.TRANSPORT
    assert operation.refusal == (Refusal.COMMAND, float(Phase.TRANSPORT))


@pytest.mark.parametrize("code", [math.nan, math.inf])
def test_a_command_that_is_not_finite_is_none(fix, code):
    operation = Operation(fix)
    assert operation.command(code) is Phase.TRANSPORT
    assert operation.refusal == (Refusal.NONE, 0.0)


def test_a_command_counts_once_however_long_it_is_shown(fix):
    operation = Operation(fix)
    operation.command(Command.GO)
    operation.set(operator=(float(Command.STOP),))
    assert operation.tick() is Phase.TRANSPORT
    assert operation.wait(1.0) is Phase.TRANSPORT
    assert operation.refusal == (Refusal.NONE, 0.0)
    operation.set(operator=(0.0,))
    operation.tick()
    operation.command(Command.STOP)
    assert operation.refusal == (Refusal.COMMAND, float(Phase.TRANSPORT))


# Wheels


def test_legs_are_lowered_when_the_wheels_have_stood_for_a_while(fix):
    operation = Operation(fix).to(Phase.BRAKE)
    assert operation.wait(PARAMS.settle_time - PERIOD) is Phase.BRAKE
    assert operation.tick() is Phase.LOWER


@pytest.mark.parametrize("moving", [0.03, -0.03, math.nan])
def test_one_wheel_that_moves_begins_the_wait_anew(fix, moving):
    operation = Operation(fix, wheel_velocity=(0.0, 0.0, moving, 0.0)).to(Phase.BRAKE)
    assert operation.wait(2.0) is Phase.BRAKE
    operation.set(wheel_velocity=(0.0, 0.0, 0.9 * PARAMS.standstill, 0.0))
    assert operation.wait(0.3) is Phase.BRAKE
    operation.set(wheel_velocity=(moving, 0.0, 0.0, 0.0))
    operation.tick()
    operation.set(wheel_velocity=np.zeros(4))
    assert operation.wait(PARAMS.settle_time - 2 * PERIOD) is Phase.BRAKE
    assert operation.tick(2) is Phase.LOWER


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_drive_request_that_is_not_finite_is_not_obeyed(fix, bad):
    operation = Operation(fix, drive_request=(1.0, bad, 1.0, 1.0))
    operation.tick()
    assert operation["wheel_velocity_command"].tolist() == [0.0] * 4


# Touchdown


def test_each_leg_goes_down_until_its_own_switch_closes_and_back_to_where_it_did(fix):
    operation = Operation(fix).to(Phase.LOWER)
    grounds = np.array((0.4402, 0.4311, 0.4357, 0.4289))
    touched, rates = [None] * 4, []
    for _ in range(3000):
        contact = operation.extension <= grounds
        for leg in np.flatnonzero(contact):
            if touched[leg] is None:
                touched[leg] = operation.extension[leg]
        # A leg does not stop at once.
        operation.touch(*contact)
        operation.tick()
        rates.append(operation["leg_rate"])
        if operation.phase is not Phase.LOWER:
            break
        slow = operation["leg_rate"] if len(rates) < 6 else rates[-6]
        operation.at(operation.extension + PERIOD * slow)
    assert operation.phase is Phase.TOUCHDOWN
    np.testing.assert_allclose(operation.extension, touched, rtol=0, atol=PARAMS.touched)
    rates = np.array(rates)
    assert np.abs(rates).max() <= PARAMS.lowering_rate
    first = [int(np.flatnonzero(rates[:, leg] > -PARAMS.lowering_rate)[0]) for leg in range(4)]
    assert np.argsort(first).tolist() == np.argsort(-grounds).tolist()
    # Each went a little further than it should, and came back.
    assert (rates.max(axis=0) > 0.0).all()


def test_a_leg_that_touched_stays_there_when_its_switch_opens_again(fix):
    operation = Operation(fix).to(Phase.LOWER)
    operation.at((0.43, 0.43, 0.43, 0.43))
    operation.touch(1, 0, 0, 0)
    operation.tick()
    operation.touch(0, 0, 0, 0)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], [0.0] + [-PARAMS.lowering_rate] * 3)


@pytest.mark.parametrize("leg", range(4))
def test_a_leg_that_finds_no_ground_is_refused_by_its_number_and_stops(fix, leg):
    operation = Operation(fix).to(Phase.LOWER)
    extension = LOW.copy()
    extension[leg] = MODEL_GEOMETRY.extension_min
    operation.at(extension)
    operation.touch(*(np.arange(4) != leg))
    operation.wait(2.0)
    assert operation.phase is Phase.LOWER
    assert operation.refusal == (Refusal.NO_GROUND, leg + 1.0)
    assert operation["leg_rate"].tolist() == [0.0] * 4
    assert operation.command(Command.STOP) is Phase.RETRACT


def test_a_switch_that_is_nan_is_open(fix):
    operation = Operation(fix).to(Phase.LOWER)
    operation.at(LOW)
    operation.touch(1, 1, math.nan, 1)
    assert operation.wait(1.0) is Phase.LOWER
    np.testing.assert_array_equal(operation["leg_rate"], (0, 0, -PARAMS.lowering_rate, 0))


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize("contact", [0.0, 1.0])
def test_a_leg_that_is_not_measured_is_not_lowered(fix, leg, contact):
    operation = Operation(fix).to(Phase.LOWER)
    extension = LOW.copy()
    extension[leg] = math.nan
    operation.at(extension)
    operation.touch(*[contact] * 4)
    assert operation.wait(1.0) is Phase.LOWER
    assert operation["leg_rate"][leg] == 0.0


def test_switches_are_forgotten_when_legs_are_lowered_again(fix):
    operation = Operation(fix).to(Phase.TOUCHDOWN)
    operation.command(Command.STOP)
    operation.at(RAISED)
    operation.touch(0, 0, 0, 0)
    assert operation.tick(2) is Phase.TRANSPORT
    operation.forward_to(Phase.LOWER)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], -PARAMS.lowering_rate)


# Estimate


def test_the_ground_is_estimated_after_a_time_at_rest(fix):
    operation = Operation(fix).to(Phase.TOUCHDOWN)
    assert operation.wait(PARAMS.settle_time - PERIOD) is Phase.TOUCHDOWN
    assert operation.tick() is Phase.ESTIMATE
    operation.wait(PARAMS.estimate_time - PERIOD)
    assert operation["estimate_ground"].tolist() == [0.0]
    operation.tick()
    assert operation["estimate_ground"].tolist() == [1.0]


def test_a_posture_is_taken_when_the_estimate_has_come_and_it_fits(fix):
    operation = Operation(fix, ground_valid=(0.0,)).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    operation.set(ground_valid=(1.0,))
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)
    assert operation.refusal == (Refusal.NONE, 0.0)


def test_an_estimate_of_before_is_not_taken_for_the_new_one(fix):
    """The estimator needs a period to see the trigger, and its estimate one to be seen."""
    operation = Operation(fix).to(Phase.ESTIMATE)
    while not operation["estimate_ground"][0]:
        operation.tick()
    assert operation.tick(2) is Phase.ESTIMATE
    assert operation.tick(2) is Phase.POSTURE


@pytest.mark.parametrize("ground", [STEEP, (-0.2, 0.1), (0.2, -0.1), (-0.2, -0.1)])
def test_a_ground_that_does_not_fit_is_refused_by_leg_and_the_phase_stays(fix, ground):
    operation = Operation(fix, ground=ground).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    assert operation.refusal == (Refusal.GROUND, worst_leg(POSTURE, ground))
    assert operation["posture_control"].tolist() == [0.0]
    assert operation["leg_rate"].tolist() == [0.0] * 4
    assert operation.command(Command.STOP) is Phase.RETRACT


def test_a_refused_ground_is_left_with_a_posture_that_fits(fix):
    operation = Operation(fix, posture_request=FAR).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    operation.set(posture_request=OTHER)
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)


@pytest.mark.parametrize("element", range(3))
def test_no_posture_is_taken_while_the_request_is_not_finite(fix, element):
    request = np.array(POSTURE)
    request[element] = math.nan
    operation = Operation(fix, posture_request=request).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    assert np.isfinite(operation["posture_command"]).all()


def test_heights_of_the_feet_count_for_what_fits(fix):
    offsets = (0.05, -0.05, 0.05, -0.05)
    operation = Operation(fix, foot_offsets=offsets).to(Phase.ESTIMATE)
    operation.wait(5.0)
    assert operation.refusal == (Refusal.GROUND, worst_leg(POSTURE, GROUND, offsets))


# Posture


def test_a_posture_is_held_when_reference_and_legs_have_arrived_for_a_while(fix):
    operation = Operation(fix).to(Phase.POSTURE)
    assert operation.wait(PARAMS.arrive_time - 2 * PERIOD) is Phase.POSTURE
    assert operation.tick(2) is Phase.HOLD


@pytest.mark.parametrize("late", [2.1e-4, math.nan])
@pytest.mark.parametrize("leg", range(4))
def test_a_leg_that_is_late_or_not_measured_has_not_arrived(fix, leg, late):
    operation = Operation(fix).to(Phase.POSTURE)
    extension = LOW.copy()
    extension[leg] += late
    operation.at(extension, desired=LOW)
    assert operation.wait(2.0) is Phase.POSTURE
    operation.at(LOW)
    assert operation.wait(PARAMS.arrive_time + PERIOD) is Phase.HOLD


@pytest.mark.parametrize("rate", [1e-6, -1e-6, math.nan])
@pytest.mark.parametrize("element", [3, 4, 5])
def test_a_reference_that_moves_has_not_arrived(fix, element, rate):
    operation = Operation(fix).to(Phase.POSTURE)
    state = AT_REST.copy()
    state[element] = rate
    operation.set(posture_desired_state=state)
    assert operation.wait(2.0) is Phase.POSTURE


@pytest.mark.parametrize("phase", ON_LEGS)
def test_another_posture_is_taken(fix, phase):
    operation = Operation(fix).to(phase)
    operation.set(posture_request=OTHER)
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)
    assert operation["posture_control"].tolist() == [1.0]
    assert operation.wait(PARAMS.arrive_time + PERIOD) is Phase.HOLD


@pytest.mark.parametrize("phase", ON_LEGS)
@pytest.mark.parametrize("far", [FAR, (0.2, 0.0, 0.47), (0.0, -0.2, 0.47)])
def test_a_posture_out_of_reach_is_refused_by_leg_and_the_old_one_kept(fix, phase, far):
    operation = Operation(fix).to(phase)
    operation.set(posture_request=far)
    operation.tick()
    assert operation.phase is phase
    assert operation.refusal == (Refusal.POSTURE, worst_leg(far, GROUND))
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)
    assert operation.wait(1.0) is Phase.HOLD
    operation.set(posture_request=POSTURE)
    operation.tick()
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("element", range(3))
def test_a_posture_request_that_is_not_finite_is_not_obeyed(fix, element, bad):
    operation = Operation(fix).to(Phase.HOLD)
    request = np.array(OTHER)
    request[element] = bad
    operation.set(posture_request=request)
    assert operation.wait(0.1) is Phase.HOLD
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.ESTIMATE, *ON_LEGS}))
def test_a_posture_asked_for_in_another_phase_moves_nothing(fix, phase):
    operation = Operation(fix).to(phase)
    before = operation["posture_command"]
    operation.set(posture_request=OTHER)
    operation.tick()
    np.testing.assert_array_equal(operation["posture_command"], before)
    assert operation.refusal == (Refusal.NONE, 0.0)


# Retracting


@pytest.mark.parametrize("phase", ON_LEGS)
def test_a_platform_on_its_legs_first_goes_down_parallel_to_the_ground(fix, phase):
    operation = Operation(fix).to(phase)
    operation.command(Command.STOP)
    assert operation["posture_control"].tolist() == [1.0]
    assert operation["leg_rate"].tolist() == [0.0] * 4
    lowest, highest = height_range(MODEL_GEOMETRY, GROUND, GROUND)
    height = max(lowest + 1e-4, STANDING_HEIGHT + PARAMS.clearance)
    assert height < highest
    np.testing.assert_allclose(operation["posture_command"], (*GROUND, height), rtol=1e-12)
    # On the way.
    operation.set(posture_desired_state=(0, 0, 0.4, 0, 0, -0.01))
    assert operation.wait(3.0) is Phase.RETRACT
    assert operation["posture_control"].tolist() == [1.0]
    # There.
    operation.set(posture_desired_state=AT_REST)
    operation.wait(PARAMS.arrive_time + PERIOD)
    assert operation["posture_control"].tolist() == [0.0]
    assert (operation["leg_rate"] > 0.0).all()


def test_on_uneven_ground_it_goes_down_as_far_as_the_stroke_allows(fix):
    offsets = (0.01, -0.01, 0.01, -0.01)
    operation = Operation(fix, foot_offsets=offsets).to(Phase.HOLD)
    operation.command(Command.STOP)
    lowest, _ = height_range(MODEL_GEOMETRY, GROUND, GROUND, offsets)
    assert lowest > STANDING_HEIGHT + PARAMS.clearance
    assert operation["posture_command"][2] == pytest.approx(lowest + 1e-4)


@pytest.mark.parametrize("phase", [p for p in STOPPABLE if Phase.LOWER <= p < Phase.POSTURE])
def test_a_platform_on_its_wheels_raises_its_legs_at_once(fix, phase):
    operation = Operation(fix).to(phase)
    operation.at(LOW)
    assert operation.command(Command.STOP) is Phase.RETRACT
    assert operation["posture_control"].tolist() == [0.0]
    assert (operation["leg_rate"] > 0.0).all()


def test_legs_go_up_without_overshooting_and_then_the_platform_may_drive(fix):
    operation = Operation(fix).to(Phase.LOWER)
    operation.at((0.42, 0.43, 0.44, 0.41))
    operation.command(Command.STOP)
    highest = 0.0
    while operation.phase is Phase.RETRACT and operation.context.get_time() < 30.0:
        operation.move()
        highest = max(highest, operation.extension.max())
        assert np.abs(operation["leg_rate"]).max() <= PARAMS.raising_rate
    assert operation.phase is Phase.TRANSPORT
    assert highest <= PARAMS.raised
    assert operation.extension.min() >= PARAMS.raised - PARAMS.arrived


def test_legs_go_up_gently_while_one_of_them_stands(fix):
    operation = Operation(fix).to(Phase.TOUCHDOWN)
    operation.touch(0, 0, 1, 0)
    operation.command(Command.STOP)
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.lowering_rate)
    operation.touch(0, 0, 0, 0)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.raising_rate)


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize("low", [0.4497, math.nan])
def test_it_does_not_drive_before_every_leg_is_known_to_be_up(fix, leg, low):
    operation = Operation(fix).to(Phase.RETRACT)
    extension = RAISED.copy()
    extension[leg] = low
    operation.at(extension)
    assert operation.wait(1.0) is Phase.RETRACT
    rate = operation["leg_rate"][leg]
    assert rate == 0.0 if math.isnan(low) else rate > 0.0
    operation.at(RAISED)
    assert operation.tick() is Phase.TRANSPORT


def test_the_ground_can_be_estimated_anew_after_retracting(fix):
    operation = Operation(fix).to(Phase.ESTIMATE)
    operation.set(ground=STEEP)
    operation.wait(4.0)
    assert operation["estimate_ground"].tolist() == [1.0]
    operation.command(Command.STOP)
    assert operation["estimate_ground"].tolist() == [0.0]


# Faults


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.FAULT}))
@pytest.mark.parametrize("severity", Severity)
def test_a_fault_of_severity_hold_or_more_stops_every_phase(fix, phase, severity):
    operation = Operation(fix).to(phase)
    operation.set(severity=(float(severity),))
    operation.tick()
    assert (operation.phase is Phase.FAULT) == (severity >= Severity.HOLD)
    if severity >= Severity.HOLD:
        assert operation["wheel_velocity_command"].tolist() == [0.0] * 4
        assert operation["wheel_brake"].tolist() == [1.0]
        assert operation["leg_rate"].tolist() == [0.0] * 4
        assert operation["posture_control"].tolist() == [0.0]
        assert operation["arm_enable"].tolist() == [0.0]


@pytest.mark.parametrize("severity", Severity)
def test_legs_are_without_voltage_from_severity_brake_on(fix, severity):
    operation = Operation(fix).to(Phase.FAULT)
    operation.set(severity=(float(severity),))
    operation.tick()
    assert operation["legs_enable"].tolist() == [float(severity < Severity.BRAKE)]
    assert operation["legs_stop"].tolist() == [float(severity >= Severity.BRAKE)]


GRAVE = [Severity.HOLD, Severity.BRAKE, Severity.LATCHED_OFF]


@pytest.mark.parametrize("severity", GRAVE)
def test_a_reset_is_refused_until_the_fault_is_gone(fix, severity):
    operation = Operation(fix).to(Phase.FAULT)
    operation.set(severity=(float(severity),), operator=(float(Command.RESET),))
    operation.tick(4)
    assert operation.phase is Phase.FAULT
    assert operation.refusal == (Refusal.COMMAND, float(Phase.FAULT))
    operation.set(severity=(float(Severity.WARN),))
    assert operation.wait(1.0) is Phase.FAULT
    operation.set(operator=(0.0,))
    operation.tick()
    assert operation.command(Command.RESET) is Phase.RETRACT
    assert operation["legs_enable"].tolist() == [1.0]


@pytest.mark.parametrize("severity", GRAVE)
@pytest.mark.parametrize("periods", [1, 2, 3])
def test_a_reset_waits_for_the_findings_that_end_with_it(fix, severity, periods):
    operation = Operation(fix).to(Phase.FAULT)
    operation.set(severity=(float(severity),), operator=(float(Command.RESET),))
    assert operation.tick(periods) is Phase.FAULT
    assert operation.refusal == (Refusal.NONE, 0.0)
    operation.set(severity=(float(Severity.WARN),))
    assert operation.tick() is Phase.RETRACT
    assert operation.refusal == (Refusal.NONE, 0.0)
    assert operation["legs_stop"].tolist() == [0.0]


def test_a_reset_that_was_refused_does_not_shorten_the_next_one_s_wait(fix):
    operation = Operation(fix).to(Phase.FAULT)
    for _ in range(2):
        operation.set(severity=(float(Severity.HOLD),), operator=(float(Command.RESET),))
        operation.tick(4)
        assert operation.refusal == (Refusal.COMMAND, float(Phase.FAULT))
        operation.set(operator=(0.0,))
        operation.wait(1.0)
    operation.set(operator=(float(Command.RESET),))
    operation.tick(3)
    operation.set(severity=(float(Severity.NONE),))
    assert operation.tick() is Phase.RETRACT


def test_a_reset_that_is_taken_back_while_it_waits_is_forgotten(fix):
    operation = Operation(fix).to(Phase.FAULT)
    operation.set(severity=(float(Severity.HOLD),))
    operation.command(Command.RESET)
    operation.tick()
    operation.set(severity=(float(Severity.NONE),))
    assert operation.wait(1.0) is Phase.FAULT
    assert operation.refusal == (Refusal.NONE, 0.0)
    # The next one waits as long as the first.
    operation.set(severity=(float(Severity.HOLD),), operator=(float(Command.RESET),))
    operation.tick(3)
    assert operation.refusal == (Refusal.NONE, 0.0)
    operation.set(severity=(float(Severity.NONE),))
    assert operation.tick() is Phase.RETRACT


def test_after_a_fault_legs_go_up_at_once(fix):
    operation = Operation(fix).to(Phase.HOLD)
    operation.to(Phase.FAULT)
    operation.command(Command.RESET)
    operation.tick()
    assert operation["posture_control"].tolist() == [0.0]
    assert (operation["leg_rate"] > 0.0).all()


def test_a_fault_on_the_way_down_ends_it(fix):
    operation = Operation(fix).to(Phase.HOLD)
    operation.set(posture_desired_state=(0, 0, 0.4, 0, 0, -0.01))
    operation.command(Command.STOP)
    assert operation["posture_control"].tolist() == [1.0]
    operation.to(Phase.FAULT)
    operation.command(Command.RESET)
    operation.tick()
    assert operation["posture_control"].tolist() == [0.0]


def test_a_severity_that_is_nan_is_a_fault(fix):
    operation = Operation(fix, severity=(math.nan,))
    assert operation.tick() is Phase.FAULT
    assert operation["legs_enable"].tolist() == [0.0]
    assert operation.command(Command.RESET) is Phase.FAULT


def test_without_a_connected_severity_there_is_no_fault(fix):
    system = Supervisor()
    context = system.CreateDefaultContext()
    names = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
    for name in names - {"severity"}:
        port = system.GetInputPort(name)
        port.FixValue(context, np.zeros(port.size()))
    ahead = system.EvalUniquePeriodicDiscreteUpdate(context)
    assert ahead.value(0).flatten().tolist() == [float(Phase.TRANSPORT)]


# The whole


@pytest.mark.parametrize(
    ("name", "value", "phase", "moves"),
    [
        ("operator", (1.0,), Phase.TRANSPORT, "phase"),
        ("drive_request", np.ones(4), Phase.TRANSPORT, "wheel_velocity_command"),
        ("posture_request", OTHER, Phase.HOLD, "posture_command"),
        ("severity", (2.0,), Phase.TRANSPORT, "phase"),
        ("limits", switches((1, 0, 1, 1)), Phase.LOWER, "leg_rate"),
        ("extension", RAISED - 0.001, Phase.RETRACT, "leg_rate"),
        ("wheel_velocity", np.ones(4), Phase.BRAKE, "phase"),
        ("ground", STEEP, Phase.ESTIMATE, "phase"),
        ("ground_valid", (0.0,), Phase.ESTIMATE, "phase"),
        ("foot_offsets", (0.05, -0.05, 0.05, -0.05), Phase.ESTIMATE, "phase"),
        ("posture_desired_state", np.ones(6), Phase.POSTURE, "phase"),
        ("extension_desired_state", np.ones(8), Phase.POSTURE, "phase"),
    ],
)
def test_each_input_has_its_effect(fix, name, value, phase, moves):
    results = []
    for changed in (False, True):
        operation = Operation(fix).to(phase)
        if changed:
            operation.set(**{name: value})
        operation.wait(0.6 if phase is not Phase.ESTIMATE else 4.0) if moves == "phase" else None
        operation.tick()
        results.append(operation[moves].tolist())
    assert results[0] != results[1]


def test_no_output_depends_on_an_input_directly():
    assert not Supervisor().HasAnyDirectFeedthrough()
