"""Phases of the platform's operation, and what leads from one to another."""

import itertools
import math

import numpy as np
import pytest

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.supervisor import (
    TRANSITIONS,
    Command,
    Event,
    Phase,
    Refusal,
    SupervisorParams,
    Transition,
    as_mermaid,
    next_phase,
)

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


def worst_leg(posture, ground, offsets=(0.0, 0.0, 0.0, 0.0)):
    """Number of the leg that misses a posture most, 1..4."""
    try:
        inverse_kinematics(MODEL_GEOMETRY, posture, ground, offsets)
    except UnreachablePosture as error:
        return error.leg
    raise AssertionError("the posture can be reached")


# Outputs of each phase


# Phases in which a signal is on.
ON = {
    "wheel_brake": set(Phase) - {Phase.TRANSPORT},
    "arm_enable": {Phase.HOLD},
    "posture_control": set(ON_LEGS),
    "legs_enable": set(Phase),
    "legs_stop": set(),
}


@pytest.mark.parametrize("phase", PHASES)
def test_each_phase_has_its_outputs(operate, phase):
    operation = operate().to(phase)
    operation.tick()
    assert {name for name in ON if operation[name] > 0.5} == {
        name for name, phases in ON.items() if operation.phase in phases
    }
    driving = phase is Phase.TRANSPORT
    assert operation["wheel_velocity_command"].tolist() == (list(DRIVE) if driving else [0] * 4)
    assert operation.refusal == (Refusal.NONE, 0.0)


@pytest.mark.parametrize("phase", PHASES)
def test_legs_move_by_themselves_only_when_lowered_or_raised(operate, phase):
    operation = operate().to(phase)
    operation.at(np.full(4, 0.43))
    operation.touch(0, 0, 0, 0)
    operation.tick()
    assert operation["leg_rate"].any() == (operation.phase in (Phase.LOWER, Phase.RETRACT))


def test_it_begins_in_transport_with_legs_controlled(operate):
    operation = operate()
    assert operation.phase is Phase.TRANSPORT
    assert operation["legs_enable"].tolist() == [1.0]


# Commands


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("command", [Command.GO, Command.STOP, Command.RESET])
def test_a_command_outside_its_phase_is_refused_with_the_phase_as_detail(operate, phase, command):
    operation = operate().to(phase)
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
def test_stop_leads_to_transport_from_braking_and_else_to_retracting(operate, phase):
    target = Phase.TRANSPORT if phase is Phase.BRAKE else Phase.RETRACT
    assert operate().to(phase).command(Command.STOP) is target


@pytest.mark.parametrize("code", [1.5, 4.0, -1.0, math.nan, math.inf])
def test_an_unknown_command_is_refused_and_one_that_is_not_finite_is_none(operate, code):
    operation = operate()
    assert operation.command(code) is Phase.TRANSPORT
    why = Refusal.COMMAND if math.isfinite(code) else Refusal.NONE
    assert operation.refusal == (why, float(Phase.TRANSPORT))


def test_a_command_counts_once_however_long_it_is_shown(operate):
    operation = operate()
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


def test_legs_are_lowered_when_the_wheels_have_stood_for_a_while(operate):
    operation = operate().to(Phase.BRAKE)
    assert operation.wait(PARAMS.settle_time - PERIOD) is Phase.BRAKE
    assert operation.tick() is Phase.LOWER


@pytest.mark.parametrize("moving", [0.03, -0.03, math.nan])
def test_one_wheel_that_moves_begins_the_wait_anew(operate, moving):
    operation = operate(wheel_velocity=(0.0, 0.0, moving, 0.0)).to(Phase.BRAKE)
    assert operation.wait(2.0) is Phase.BRAKE
    operation.set(wheel_velocity=(0.0, 0.0, 0.9 * PARAMS.standstill, 0.0))
    assert operation.wait(0.3) is Phase.BRAKE
    operation.set(wheel_velocity=(moving, 0.0, 0.0, 0.0))
    operation.tick()
    operation.set(wheel_velocity=np.zeros(4))
    assert operation.wait(PARAMS.settle_time - 2 * PERIOD) is Phase.BRAKE
    assert operation.tick(2) is Phase.LOWER


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_drive_request_that_is_not_finite_is_not_obeyed(operate, bad):
    operation = operate(drive_request=(1.0, bad, 1.0, 1.0))
    operation.tick()
    assert operation["wheel_velocity_command"].tolist() == [0.0] * 4


# Touchdown


def test_each_leg_goes_down_until_its_own_switch_closes_and_back_to_where_it_did(operate):
    operation = operate().to(Phase.LOWER)
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


def test_a_leg_that_touched_stays_there_when_its_switch_opens_again(operate):
    operation = operate().to(Phase.LOWER)
    operation.at((0.43, 0.43, 0.43, 0.43))
    operation.touch(1, 0, 0, 0)
    operation.tick()
    operation.touch(0, 0, 0, 0)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], [0.0] + [-PARAMS.lowering_rate] * 3)


@pytest.mark.parametrize("leg", range(4))
def test_a_leg_that_finds_no_ground_is_refused_by_its_number_and_stops(operate, leg):
    operation = operate().to(Phase.LOWER)
    extension = LOW.copy()
    extension[leg] = MODEL_GEOMETRY.extension_min
    operation.at(extension)
    operation.touch(*(np.arange(4) != leg))
    operation.wait(2.0)
    assert operation.phase is Phase.LOWER
    assert operation.refusal == (Refusal.NO_GROUND, leg + 1.0)
    assert operation["leg_rate"].tolist() == [0.0] * 4
    assert operation.command(Command.STOP) is Phase.RETRACT


def test_a_switch_that_is_nan_is_open(operate):
    operation = operate().to(Phase.LOWER)
    operation.at(LOW)
    operation.touch(1, 1, math.nan, 1)
    assert operation.wait(1.0) is Phase.LOWER
    np.testing.assert_array_equal(operation["leg_rate"], (0, 0, -PARAMS.lowering_rate, 0))


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize("contact", [0.0, 1.0])
def test_a_leg_that_is_not_measured_is_not_lowered(operate, leg, contact):
    operation = operate().to(Phase.LOWER)
    extension = LOW.copy()
    extension[leg] = math.nan
    operation.at(extension)
    operation.touch(*[contact] * 4)
    assert operation.wait(1.0) is Phase.LOWER
    assert operation["leg_rate"][leg] == 0.0


def test_switches_are_forgotten_when_legs_are_lowered_again(operate):
    operation = operate().to(Phase.TOUCHDOWN)
    operation.command(Command.STOP)
    operation.at(RAISED)
    operation.touch(0, 0, 0, 0)
    assert operation.tick(2) is Phase.TRANSPORT
    operation.forward_to(Phase.LOWER)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], -PARAMS.lowering_rate)


# Estimate


def test_the_ground_is_estimated_after_a_time_at_rest(operate):
    operation = operate().to(Phase.TOUCHDOWN)
    assert operation.wait(PARAMS.settle_time - PERIOD) is Phase.TOUCHDOWN
    assert operation.tick() is Phase.ESTIMATE
    operation.wait(PARAMS.estimate_time - PERIOD)
    assert operation["estimate_ground"].tolist() == [0.0]
    operation.tick()
    assert operation["estimate_ground"].tolist() == [1.0]


def test_a_posture_is_taken_when_the_estimate_has_come_and_it_fits(operate):
    operation = operate(ground_valid=(0.0,)).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    operation.set(ground_valid=(1.0,))
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)
    assert operation.refusal == (Refusal.NONE, 0.0)


def test_an_estimate_of_before_is_not_taken_for_the_new_one(operate):
    """The estimator needs a period to see the trigger, and its estimate one to be seen."""
    operation = operate().to(Phase.ESTIMATE)
    while not operation["estimate_ground"][0]:
        operation.tick()
    assert operation.tick(2) is Phase.ESTIMATE
    assert operation.tick(2) is Phase.POSTURE


@pytest.mark.parametrize("ground", [STEEP, (-0.2, 0.1), (0.2, -0.1), (-0.2, -0.1)])
def test_a_ground_that_does_not_fit_is_refused_by_leg_and_the_phase_stays(operate, ground):
    operation = operate(ground=ground).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    assert operation.refusal == (Refusal.GROUND, worst_leg(POSTURE, ground))
    assert operation["posture_control"].tolist() == [0.0]
    assert operation["leg_rate"].tolist() == [0.0] * 4
    assert operation.command(Command.STOP) is Phase.RETRACT


def test_a_refused_ground_is_left_with_a_posture_that_fits(operate):
    operation = operate(posture_request=FAR).to(Phase.ESTIMATE)
    assert operation.wait(5.0) is Phase.ESTIMATE
    operation.set(posture_request=OTHER)
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)


def test_heights_of_the_feet_count_for_what_fits(operate):
    offsets = (0.05, -0.05, 0.05, -0.05)
    operation = operate(foot_offsets=offsets).to(Phase.ESTIMATE)
    operation.wait(5.0)
    assert operation.refusal == (Refusal.GROUND, worst_leg(POSTURE, GROUND, offsets))


# Posture


def test_a_posture_is_held_when_reference_and_legs_have_arrived_for_a_while(operate):
    operation = operate().to(Phase.POSTURE)
    assert operation.wait(PARAMS.arrive_time - 2 * PERIOD) is Phase.POSTURE
    assert operation.tick(2) is Phase.HOLD


@pytest.mark.parametrize("late", [2.1e-4, math.nan])
@pytest.mark.parametrize("leg", range(4))
def test_a_leg_that_is_late_or_not_measured_has_not_arrived(operate, leg, late):
    operation = operate().to(Phase.POSTURE)
    extension = LOW.copy()
    extension[leg] += late
    operation.at(extension, desired=LOW)
    assert operation.wait(2.0) is Phase.POSTURE
    operation.at(LOW)
    assert operation.wait(PARAMS.arrive_time + PERIOD) is Phase.HOLD


@pytest.mark.parametrize("rate", [1e-6, -1e-6, math.nan])
@pytest.mark.parametrize("element", [3, 4, 5])
def test_a_reference_that_moves_has_not_arrived(operate, element, rate):
    operation = operate().to(Phase.POSTURE)
    state = AT_REST.copy()
    state[element] = rate
    operation.set(posture_desired_state=state)
    assert operation.wait(2.0) is Phase.POSTURE


@pytest.mark.parametrize("phase", ON_LEGS)
def test_another_posture_is_taken(operate, phase):
    operation = operate().to(phase)
    operation.set(posture_request=OTHER)
    assert operation.tick() is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)
    assert operation["posture_control"].tolist() == [1.0]
    assert operation.wait(PARAMS.arrive_time + PERIOD) is Phase.HOLD


@pytest.mark.parametrize("phase", ON_LEGS)
@pytest.mark.parametrize("far", [FAR, (0.2, 0.0, 0.47), (0.0, -0.2, 0.47)])
def test_a_posture_out_of_reach_is_refused_by_leg_and_the_old_one_kept(operate, phase, far):
    operation = operate().to(phase)
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
@pytest.mark.parametrize("phase", [Phase.ESTIMATE, Phase.HOLD])
def test_a_posture_request_that_is_not_finite_is_not_obeyed(operate, phase, element, bad):
    request = np.array(OTHER)
    request[element] = bad
    operation = operate().to(phase)
    before = operation["posture_command"]
    operation.set(posture_request=request)
    assert operation.wait(4.0) is phase
    np.testing.assert_array_equal(operation["posture_command"], before)


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.ESTIMATE, *ON_LEGS}))
def test_a_posture_asked_for_in_another_phase_moves_nothing(operate, phase):
    operation = operate().to(phase)
    before = operation["posture_command"]
    operation.set(posture_request=OTHER)
    operation.tick()
    np.testing.assert_array_equal(operation["posture_command"], before)
    assert operation.refusal == (Refusal.NONE, 0.0)


# Retracting


@pytest.mark.parametrize("phase", ON_LEGS)
def test_a_platform_on_its_legs_first_goes_down_parallel_to_the_ground(operate, phase):
    operation = operate().to(phase)
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


def test_on_uneven_ground_it_goes_down_as_far_as_the_stroke_allows(operate):
    offsets = (0.01, -0.01, 0.01, -0.01)
    operation = operate(foot_offsets=offsets).to(Phase.HOLD)
    operation.command(Command.STOP)
    lowest, _ = height_range(MODEL_GEOMETRY, GROUND, GROUND, offsets)
    assert lowest > STANDING_HEIGHT + PARAMS.clearance
    assert operation["posture_command"][2] == pytest.approx(lowest + 1e-4)


@pytest.mark.parametrize("phase", [p for p in STOPPABLE if Phase.LOWER <= p < Phase.POSTURE])
def test_a_platform_on_its_wheels_raises_its_legs_at_once(operate, phase):
    operation = operate().to(phase)
    operation.at(LOW)
    assert operation.command(Command.STOP) is Phase.RETRACT
    assert operation["posture_control"].tolist() == [0.0]
    assert (operation["leg_rate"] > 0.0).all()


def test_legs_go_up_without_overshooting_and_then_the_platform_may_drive(operate):
    operation = operate().to(Phase.LOWER)
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


def test_legs_go_up_gently_while_one_of_them_stands(operate):
    operation = operate().to(Phase.TOUCHDOWN)
    operation.touch(0, 0, 1, 0)
    operation.command(Command.STOP)
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.lowering_rate)
    operation.touch(0, 0, 0, 0)
    operation.tick()
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.raising_rate)


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize("low", [0.4497, math.nan])
def test_it_does_not_drive_before_every_leg_is_known_to_be_up(operate, leg, low):
    operation = operate().to(Phase.RETRACT)
    extension = RAISED.copy()
    extension[leg] = low
    operation.at(extension)
    assert operation.wait(1.0) is Phase.RETRACT
    rate = operation["leg_rate"][leg]
    assert rate == 0.0 if math.isnan(low) else rate > 0.0
    operation.at(RAISED)
    assert operation.tick() is Phase.TRANSPORT


def test_the_ground_can_be_estimated_anew_after_retracting(operate):
    operation = operate().to(Phase.ESTIMATE)
    operation.set(ground=STEEP)
    operation.wait(4.0)
    assert operation["estimate_ground"].tolist() == [1.0]
    operation.command(Command.STOP)
    assert operation["estimate_ground"].tolist() == [0.0]


ORDINARY = [t for t in TRANSITIONS if t.event is not Event.FAULT]


def reachable(start, transitions):
    """Phases that can follow a phase, in any number of steps."""
    found, last = {start}, set()
    while found != last:
        last = set(found)
        found |= {t.target for t in transitions if t.source in found}
    return found


def test_numbers_of_the_phases_are_those_of_the_port():
    assert [phase.value for phase in Phase] == list(range(9))
    assert (Phase.TRANSPORT, Phase.HOLD, Phase.FAULT) == (0, 6, 8)


# Soundness of the table


def test_every_phase_can_be_reached_from_transport():
    assert reachable(Phase.TRANSPORT, TRANSITIONS) == set(Phase)


def test_every_phase_but_fault_is_reached_without_a_fault():
    assert reachable(Phase.TRANSPORT, ORDINARY) == set(Phase) - {Phase.FAULT}


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_leads_back_to_transport_without_a_fault(phase):
    assert Phase.TRANSPORT in reachable(phase, ORDINARY)


def test_a_source_has_no_two_lines_for_one_event():
    pairs = [(t.source, t.event) for t in TRANSITIONS]
    assert len(set(pairs)) == len(pairs)


def test_every_line_leads_to_another_phase():
    assert all(t.source is not t.target for t in TRANSITIONS)


def test_every_event_has_a_line():
    assert {t.event for t in TRANSITIONS} == set(Event)


@pytest.mark.parametrize("phase", set(Phase) - {Phase.FAULT})
def test_a_fault_is_looked_at_before_anything_else(phase):
    first = next(t for t in TRANSITIONS if t.source is phase)
    assert first == Transition(phase, Event.FAULT, Phase.FAULT)
    assert next_phase(phase, set(Event)) is Phase.FAULT


def test_only_a_reset_leads_out_of_fault():
    out = [t for t in TRANSITIONS if t.source is Phase.FAULT]
    assert out == [Transition(Phase.FAULT, Event.RESET, Phase.RETRACT)]


@pytest.mark.parametrize("phase", [p for p in Phase if Phase.BRAKE <= p <= Phase.HOLD])
def test_the_operator_can_stop_whatever_stands_or_goes_down(phase):
    target = next_phase(phase, {Event.STOP})
    assert target is (Phase.TRANSPORT if phase is Phase.BRAKE else Phase.RETRACT)


@pytest.mark.parametrize("phase", [p for p in Phase if Phase.BRAKE <= p <= Phase.HOLD])
def test_a_stop_comes_before_what_goes_on(phase):
    everything = set(Event) - {Event.FAULT}
    assert next_phase(phase, everything) is next_phase(phase, {Event.STOP})


# Steps


@pytest.mark.parametrize("transition", TRANSITIONS)
def test_a_line_is_followed_when_its_event_happens_alone(transition):
    assert next_phase(transition.source, {transition.event}) is transition.target


@pytest.mark.parametrize("phase", Phase)
def test_the_first_of_two_lines_decides(phase):
    lines = [t for t in TRANSITIONS if t.source is phase]
    for earlier, later in itertools.combinations(lines, 2):
        assert next_phase(phase, {earlier.event, later.event}) is earlier.target
        assert next_phase(phase, frozenset((later.event, earlier.event))) is earlier.target


@pytest.mark.parametrize("phase", Phase)
def test_events_without_a_line_change_nothing(phase):
    foreign = set(Event) - {t.event for t in TRANSITIONS if t.source is phase}
    assert foreign
    assert next_phase(phase, foreign) is phase
    assert next_phase(phase, set()) is phase


# Drawing


def test_the_diagram_names_every_phase_and_every_line_but_those_of_faults():
    lines = as_mermaid().splitlines()
    assert lines[0] == "stateDiagram-v2"
    assert lines[1].split() == ["[*]", "-->", "TRANSPORT"]
    drawn = [line.strip() for line in lines[2:-1]]
    assert drawn == [f"{t.source.name} --> {t.target.name}: {t.event.value}" for t in ORDINARY]
    assert all(any(phase.name in line for line in lines) for phase in Phase)


def test_the_diagram_tells_faults_in_one_note():
    lines = [line for line in as_mermaid().splitlines() if Event.FAULT.value in line]
    assert len(lines) == 1
    assert lines[0].split()[:4] == ["note", "right", "of", "FAULT:"]


def test_no_event_has_a_character_that_ends_a_label():
    assert not any(set(event.value) & set(":;#") for event in Event)
