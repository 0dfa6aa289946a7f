"""Phases of the platform's operation, and what leads from one to another."""

import itertools
import math

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.levelling_platform.supervisor import (
    TRANSITIONS,
    Command,
    Event,
    Phase,
    Refusal,
    Transition,
    as_mermaid,
    next_phase,
)

PERIOD = 0.01
PARAMS = PlatformDesign().supervisor
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
FLAT = (0.0, 0.0, 0.0, 0.0)
ON_LEGS = [Phase.POSTURE, Phase.HOLD]
STOPPABLE = [p for p in Phase if Phase.BRAKE <= p <= Phase.HOLD]
EACH_PHASE = pytest.mark.parametrize("phase", Phase)
EACH_LEG = pytest.mark.parametrize("leg", range(4))
NOTHING_REFUSED = (Refusal.NONE, 0.0)


def worst_leg(posture, ground, offsets=FLAT):
    """Number of the leg that misses a posture most, 1..4."""
    with pytest.raises(UnreachablePosture) as missed:
        inverse_kinematics(DRAWN, posture, ground, offsets)
    return missed.value.leg


def but(values, leg, value):
    """Values of four legs, that of one replaced."""
    return [value if i == leg else other for i, other in enumerate(values)]


# Outputs of each phase


# Phases in which a signal is on.
ON = {
    "wheel_brake": set(Phase) - {Phase.TRANSPORT},
    "arm_enable": {Phase.HOLD},
    "posture_control": set(ON_LEGS),
    "legs_enable": set(Phase),
    "legs_stop": set(),
}


@EACH_PHASE
def test_each_phase_has_its_outputs(operate, phase):
    operation = operate().to(phase)
    assert operation["legs_enable"] == 1.0  # from the beginning
    operation.tick()
    assert {name for name in ON if operation[name] > 0.5} == {
        name for name, phases in ON.items() if operation.phase in phases
    }
    driving = phase is Phase.TRANSPORT
    assert operation["wheel_velocity_command"].tolist() == (list(DRIVE) if driving else [0] * 4)
    assert operation.refusal == NOTHING_REFUSED
    # Legs move by themselves only when they are lowered or raised.
    operation.at(np.full(4, 0.43)).touch(0, 0, 0, 0).tick()
    assert operation["leg_rate"].any() == (operation.phase in (Phase.LOWER, Phase.RETRACT))


# Commands


@EACH_PHASE
@pytest.mark.parametrize("command", [Command.GO, Command.STOP, Command.RESET])
def test_a_command_has_its_place_and_is_refused_elsewhere(operate, phase, command):
    places = {
        Command.GO: {Phase.TRANSPORT: Phase.BRAKE},
        Command.STOP: dict.fromkeys((*STOPPABLE, Phase.STANDBY), Phase.RETRACT)
        | {Phase.BRAKE: Phase.TRANSPORT},
        Command.RESET: {Phase.FAULT: Phase.STANDBY},
    }[command]
    operation = operate().to(phase).tick().command(command)
    assert operation.phase is places.get(phase, phase)
    refused = NOTHING_REFUSED if phase in places else (Refusal.COMMAND, float(phase))
    assert operation.refusal == refused


def test_what_was_refused_is_over_once_a_command_is_obeyed(operate):
    operation = operate().command(Command.STOP)
    assert operation.refusal == (Refusal.COMMAND, float(Phase.TRANSPORT))
    operation.tick(operator=0.0).command(Command.GO)
    assert operation.refusal == NOTHING_REFUSED


def test_an_unknown_command_is_refused_and_one_that_is_not_finite_is_none(operate):
    for code in (math.nan, math.inf, 1.5, 4.0, -1.0):
        operation = operate().command(code)
        assert operation.phase is Phase.TRANSPORT
        why = Refusal.COMMAND if math.isfinite(code) else Refusal.NONE
        assert operation.refusal == (why, 0.0)


def test_a_command_counts_once_however_long_it_is_shown(operate):
    operation = operate().command(Command.GO)
    assert operation.tick(operator=Command.STOP).phase is Phase.TRANSPORT
    assert operation.wait(0.1).refusal == NOTHING_REFUSED
    operation.tick(operator=0.0).command(Command.STOP)
    assert operation.refusal == (Refusal.COMMAND, float(Phase.TRANSPORT))


# Wheels


def test_legs_are_lowered_when_the_wheels_have_stood_for_a_while(operate):
    operation = operate().to(Phase.BRAKE)
    assert operation.wait(PARAMS.settle_time - PERIOD).phase is Phase.BRAKE
    assert operation.tick().phase is Phase.LOWER


@pytest.mark.parametrize("moving", [0.03, -0.03, math.nan])
def test_one_wheel_that_moves_begins_the_wait_anew(operate, moving):
    operation = operate(wheel_velocity=(0.0, 0.0, moving, 0.0)).to(Phase.BRAKE)
    assert operation.wait(1.0).phase is Phase.BRAKE
    operation.wait(0.3, wheel_velocity=(0.0, 0.0, 0.9 * PARAMS.standstill, 0.0))
    assert operation.phase is Phase.BRAKE
    operation.tick(wheel_velocity=(moving, 0.0, 0.0, 0.0)).set(wheel_velocity=np.zeros(4))
    assert operation.wait(PARAMS.settle_time - 2 * PERIOD).phase is Phase.BRAKE
    assert operation.tick(2).phase is Phase.LOWER


def test_a_drive_request_that_is_not_finite_is_not_obeyed(operate):
    operation = operate().tick(drive_request=(1.0, math.nan, 1.0, 1.0))
    assert operation["wheel_velocity_command"].tolist() == [0.0] * 4


# Touchdown


def test_each_leg_goes_down_until_its_own_switch_closes_and_back_to_where_it_did(operate):
    operation = operate().to(Phase.LOWER)
    grounds = np.array((0.4402, 0.4311, 0.4357, 0.4289))
    touched, rates = np.full(4, math.nan), []
    while operation.phase is Phase.LOWER and len(rates) < 3000:
        contact = operation.extension <= grounds
        touched = np.where(contact & np.isnan(touched), operation.extension, touched)
        rates.append(operation.touch(*contact).tick()["leg_rate"])
        # A leg does not stop at once.
        operation.at(operation.extension + PERIOD * rates[-6:][0])
    assert operation.phase is Phase.TOUCHDOWN
    np.testing.assert_allclose(operation.extension, touched, rtol=0, atol=PARAMS.touched)
    rates = np.array(rates)
    assert np.abs(rates).max() <= PARAMS.lowering_rate
    first = [int(np.flatnonzero(rates[:, leg] > -PARAMS.lowering_rate)[0]) for leg in range(4)]
    assert np.argsort(first).tolist() == np.argsort(-grounds).tolist()
    # Each went a little further than it should, and came back.
    assert (rates.max(axis=0) > 0.0).all()


def test_a_leg_that_touched_stays_when_its_switch_opens_again_or_is_not_known(operate):
    operation = operate().to(Phase.LOWER).at(np.full(4, 0.43)).touch(1, math.nan, 0, 0).tick()
    operation.touch(0, 0, 0, 0).tick()
    np.testing.assert_array_equal(operation["leg_rate"], [0.0] + [-PARAMS.lowering_rate] * 3)


@EACH_LEG
def test_a_leg_that_finds_no_ground_is_refused_by_its_number_and_stops(operate, leg):
    operation = operate().to(Phase.LOWER).at(but(LOW, leg, DRAWN.extension_min))
    operation.touch(*(np.arange(4) != leg)).wait(1.0)
    assert operation.phase is Phase.LOWER
    assert operation.refusal == (Refusal.NO_GROUND, leg + 1.0)
    assert operation["leg_rate"].tolist() == [0.0] * 4


@EACH_LEG
def test_a_leg_that_is_not_measured_is_not_lowered(operate, leg):
    for contact in (0.0, 1.0):
        operation = operate().to(Phase.LOWER).at(but(LOW, leg, math.nan)).touch(*[contact] * 4)
        assert operation.wait(1.0).phase is Phase.LOWER
        assert operation.refusal[0] == Refusal.NONE  # it is no ground that is missing
        assert operation["leg_rate"][leg] == 0.0


def test_switches_are_forgotten_when_legs_are_lowered_again(operate):
    operation = operate().to(Phase.TOUCHDOWN).command(Command.STOP)
    assert operation.at(RAISED).touch(0, 0, 0, 0).tick(2).phase is Phase.TRANSPORT
    operation.forward_to(Phase.LOWER).tick()
    np.testing.assert_array_equal(operation["leg_rate"], -PARAMS.lowering_rate)


# Estimate


def test_the_ground_is_estimated_after_a_time_at_rest(operate):
    operation = operate().to(Phase.TOUCHDOWN)
    assert operation.wait(PARAMS.settle_time - PERIOD).phase is Phase.TOUCHDOWN
    assert operation.tick().phase is Phase.ESTIMATE
    assert operation.wait(PARAMS.estimate_time - PERIOD)["estimate_ground"] == 0.0
    assert operation.tick()["estimate_ground"] == 1.0
    # The estimator needs a period to see the trigger, and its estimate one to be seen.
    assert operation.tick(2).phase is Phase.ESTIMATE
    assert operation.tick(2).phase is Phase.POSTURE


def test_a_posture_is_taken_when_the_estimate_has_come_and_it_fits(operate):
    operation = operate(ground_valid=0.0).to(Phase.ESTIMATE)
    assert operation.wait(4.0).phase is Phase.ESTIMATE
    assert operation.tick(ground_valid=1.0).phase is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)
    assert operation.refusal == NOTHING_REFUSED


def test_an_estimate_that_does_not_come_is_refused_and_taken_when_it_comes_after_all(operate):
    operation = operate(ground_valid=0.0).to(Phase.ESTIMATE).wait(PARAMS.estimate_time)
    assert operation.wait(PARAMS.estimate_limit - 2.0 * PERIOD).refusal == NOTHING_REFUSED
    assert operation.wait(3.0 * PERIOD).refusal == (Refusal.UNSETTLED, float(Phase.ESTIMATE))
    assert operation.phase is Phase.ESTIMATE
    assert operation["posture_control"] == 0.0
    assert operation.tick(ground_valid=1.0).phase is Phase.POSTURE
    assert operation.refusal == NOTHING_REFUSED


@pytest.mark.parametrize(
    ("ground", "offsets"),
    [
        (STEEP, FLAT),
        ((-0.2, 0.1), FLAT),
        ((0.2, -0.1), FLAT),
        ((-0.2, -0.1), FLAT),
        (GROUND, (0.05, -0.05, 0.05, -0.05)),
    ],
)
def test_a_ground_that_does_not_fit_is_refused_by_leg_and_the_phase_stays(
    operate, ground, offsets
):
    operation = operate(ground=ground, foot_offsets=offsets).to(Phase.ESTIMATE).wait(4.0)
    assert operation.phase is Phase.ESTIMATE
    assert operation.refusal == (Refusal.GROUND, worst_leg(POSTURE, ground, offsets))
    assert operation["posture_control"] == 0.0
    assert operation["leg_rate"].tolist() == [0.0] * 4


def test_a_refused_ground_is_left_with_a_posture_that_fits(operate):
    operation = operate(posture_request=FAR).to(Phase.ESTIMATE)
    assert operation.wait(4.0).phase is Phase.ESTIMATE
    assert operation.tick(posture_request=OTHER).phase is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)


# Posture


def test_a_posture_is_held_when_reference_and_legs_have_arrived_for_a_while(operate):
    operation = operate().to(Phase.POSTURE)
    assert operation.wait(PARAMS.arrive_time - 2 * PERIOD).phase is Phase.POSTURE
    assert operation.tick(2).phase is Phase.HOLD


@EACH_LEG
def test_a_leg_that_is_late_or_not_measured_has_not_arrived(operate, leg):
    for late in (2.1e-4, math.nan):
        operation = operate().to(Phase.POSTURE).at(but(LOW, leg, LOW[leg] + late), desired=LOW)
        assert operation.wait(1.0).phase is Phase.POSTURE
        assert operation.at(LOW).wait(PARAMS.arrive_time + PERIOD).phase is Phase.HOLD


@pytest.mark.parametrize("element", [3, 4, 5])
def test_a_reference_that_moves_has_not_arrived(operate, element):
    operation = operate().to(Phase.POSTURE)
    for rate in (1e-6, -1e-6, math.nan):
        state = AT_REST.copy()
        state[element] = rate
        assert operation.wait(0.5, posture_desired_state=state).phase is Phase.POSTURE


@pytest.mark.parametrize("phase", ON_LEGS)
def test_another_posture_is_taken(operate, phase):
    operation = operate().to(phase)
    assert operation.tick(posture_request=OTHER).phase is Phase.POSTURE
    np.testing.assert_array_equal(operation["posture_command"], OTHER)
    assert operation["posture_control"] == 1.0
    assert operation.wait(PARAMS.arrive_time + PERIOD).phase is Phase.HOLD


@pytest.mark.parametrize("phase", ON_LEGS)
@pytest.mark.parametrize("far", [FAR, (0.2, 0.0, 0.47), (0.0, -0.2, 0.47)])
def test_a_posture_out_of_reach_is_refused_by_leg_and_the_old_one_kept(operate, phase, far):
    operation = operate().to(phase)
    assert operation.tick(posture_request=far).phase is phase
    assert operation.refusal == (Refusal.POSTURE, worst_leg(far, GROUND))
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)
    assert operation.wait(1.0).phase is Phase.HOLD
    operation.tick(posture_request=POSTURE)
    np.testing.assert_array_equal(operation["posture_command"], POSTURE)


@pytest.mark.parametrize("phase", [Phase.ESTIMATE, Phase.HOLD])
@pytest.mark.parametrize("element", range(3))
def test_a_posture_request_that_is_not_finite_is_not_obeyed(operate, phase, element):
    for bad in (math.nan, math.inf):
        request = np.array(OTHER)
        request[element] = bad
        operation = operate().to(phase)
        before = operation["posture_command"]
        assert operation.wait(3.5, posture_request=request).phase is phase
        np.testing.assert_array_equal(operation["posture_command"], before)


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.ESTIMATE, *ON_LEGS}))
def test_a_posture_asked_for_in_another_phase_moves_nothing(operate, phase):
    operation = operate().to(phase)
    before = operation["posture_command"]
    operation.tick(posture_request=OTHER)
    np.testing.assert_array_equal(operation["posture_command"], before)
    assert operation.refusal == NOTHING_REFUSED


# Retracting


@pytest.mark.parametrize(
    ("phase", "offsets"),
    # On uneven ground it goes down as far as the stroke allows.
    [(Phase.POSTURE, FLAT), (Phase.HOLD, FLAT), (Phase.HOLD, (0.01, -0.01, 0.01, -0.01))],
)
def test_a_platform_on_its_legs_first_goes_down_parallel_to_the_ground(operate, phase, offsets):
    operation = operate(foot_offsets=offsets).to(phase).command(Command.STOP)
    assert operation["posture_control"] == 1.0
    assert operation["leg_rate"].tolist() == [0.0] * 4
    lowest, highest = height_range(DRAWN, GROUND, GROUND, offsets)
    on_wheels = STANDING_HEIGHT + PARAMS.clearance
    assert (lowest > on_wheels) == (offsets != FLAT)
    height = max(lowest + 1e-4, on_wheels)
    assert height < highest
    np.testing.assert_allclose(operation["posture_command"], (*GROUND, height), rtol=1e-12)
    # On the way.
    operation.wait(1.0, posture_desired_state=(0, 0, 0.4, 0, 0, -0.01))
    assert operation.phase is Phase.RETRACT
    assert operation["posture_control"] == 1.0
    # There.
    operation.wait(PARAMS.arrive_time + PERIOD, posture_desired_state=AT_REST)
    assert operation["posture_control"] == 0.0
    assert (operation["leg_rate"] > 0.0).all()


@pytest.mark.parametrize("phase", [p for p in STOPPABLE if Phase.LOWER <= p < Phase.POSTURE])
def test_a_platform_on_its_wheels_raises_its_legs_at_once(operate, phase):
    operation = operate().to(phase).at(LOW).command(Command.STOP)
    assert operation["posture_control"] == 0.0
    assert (operation["leg_rate"] > 0.0).all()


def test_legs_go_up_without_overshooting_and_then_the_platform_may_drive(operate):
    operation = operate().to(Phase.LOWER).at((0.42, 0.43, 0.44, 0.41)).command(Command.STOP)
    highest = 0.0
    while operation.phase is Phase.RETRACT and operation.context.get_time() < 30.0:
        rate = operation.tick()["leg_rate"]
        operation.at(operation.extension + PERIOD * rate)
        highest = max(highest, operation.extension.max())
        assert np.abs(rate).max() <= PARAMS.raising_rate
    assert operation.phase is Phase.TRANSPORT
    assert highest <= PARAMS.raised
    assert operation.extension.min() >= PARAMS.raised - PARAMS.arrived


def test_legs_go_up_gently_while_one_of_them_stands(operate):
    operation = operate().to(Phase.TOUCHDOWN).touch(0, 0, 1, 0).command(Command.STOP)
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.lowering_rate)
    operation.touch(0, 0, 0, 0).tick()
    np.testing.assert_array_equal(operation["leg_rate"], PARAMS.raising_rate)


@EACH_LEG
def test_it_does_not_drive_before_every_leg_is_known_to_be_up(operate, leg):
    for low in (0.4497, math.nan):
        operation = operate().to(Phase.RETRACT).at(but(RAISED, leg, low))
        assert operation.wait(1.0).phase is Phase.RETRACT
        rate = operation["leg_rate"][leg]
        assert rate == 0.0 if math.isnan(low) else rate > 0.0
        assert operation.at(RAISED).tick().phase is Phase.TRANSPORT


def test_the_ground_can_be_estimated_anew_after_retracting(operate):
    operation = operate().to(Phase.ESTIMATE).wait(4.0, ground=STEEP)
    assert operation["estimate_ground"] == 1.0
    assert operation.command(Command.STOP)["estimate_ground"] == 0.0


# The table


ORDINARY = [t for t in TRANSITIONS if t.event is not Event.FAULT]


def reachable(start, transitions):
    """Phases that can follow a phase, in any number of steps."""
    found, last = {start}, set()
    while found != last:
        last = set(found)
        found |= {t.target for t in transitions if t.source in found}
    return found


def test_numbers_of_the_phases_are_those_of_the_port():
    assert [phase.value for phase in Phase] == list(range(10))
    assert (Phase.TRANSPORT, Phase.HOLD, Phase.FAULT, Phase.STANDBY) == (0, 6, 8, 9)


def test_every_phase_can_be_reached_from_transport_and_leads_back_to_it():
    assert reachable(Phase.TRANSPORT, TRANSITIONS) == set(Phase)
    assert reachable(Phase.TRANSPORT, ORDINARY) == set(Phase) - {Phase.FAULT, Phase.STANDBY}
    assert all(Phase.TRANSPORT in reachable(phase, ORDINARY) for phase in Phase)


def test_a_phase_has_one_line_for_an_event_and_each_leads_to_another_phase():
    pairs = [(t.source, t.event) for t in TRANSITIONS]
    assert len(set(pairs)) == len(pairs)
    assert all(t.source is not t.target for t in TRANSITIONS)
    assert {t.event for t in TRANSITIONS} == set(Event)


def test_a_fault_comes_before_a_stop_and_a_stop_before_what_goes_on():
    for phase in set(Phase) - {Phase.FAULT}:
        first = next(t for t in TRANSITIONS if t.source is phase)
        assert first == Transition(phase, Event.FAULT, Phase.FAULT)
        assert next_phase(phase, set(Event)) is Phase.FAULT
    for phase in STOPPABLE:
        target = Phase.TRANSPORT if phase is Phase.BRAKE else Phase.RETRACT
        assert next_phase(phase, {Event.STOP}) is target
        assert next_phase(phase, set(Event) - {Event.FAULT}) is target


def test_only_a_reset_leads_out_of_fault():
    out = [t for t in TRANSITIONS if t.source is Phase.FAULT]
    assert out == [Transition(Phase.FAULT, Event.RESET, Phase.STANDBY)]


@EACH_PHASE
def test_the_first_line_whose_event_happens_is_followed_and_other_events_change_nothing(phase):
    lines = [t for t in TRANSITIONS if t.source is phase]
    for line in lines:
        assert next_phase(phase, {line.event}) is line.target
    for earlier, later in itertools.combinations(lines, 2):
        assert next_phase(phase, {earlier.event, later.event}) is earlier.target
        assert next_phase(phase, frozenset((later.event, earlier.event))) is earlier.target
    foreign = set(Event) - {line.event for line in lines}
    assert foreign
    assert next_phase(phase, foreign) is phase
    assert next_phase(phase, set()) is phase


def test_the_diagram_has_every_line_and_tells_faults_in_one_note():
    first, begin, *lines = as_mermaid().splitlines()
    assert first == "stateDiagram-v2"
    assert begin.split() == ["[*]", "-->", "TRANSPORT"]
    assert [line.strip() for line in lines[:-1]] == [
        f"{t.source.name} --> {t.target.name}: {t.event.value}" for t in ORDINARY
    ]
    assert lines[-1].split()[:4] == ["note", "right", "of", "FAULT:"]
    assert Event.FAULT.value in lines[-1]
    # No event has a character that ends a label.
    assert not any(set(event.value) & set(":;#") for event in Event)


@pytest.mark.parametrize("kind", [Phase, Command, Refusal])
def test_numbers_on_the_ports_follow_each_other_from_zero(kind):
    assert [int(member) for member in kind] == list(range(len(kind)))


# Single legs


@pytest.mark.parametrize("phase", Phase)
def test_legs_are_jogged_while_it_stands_by_and_in_transport_at_rest(operate, phase):
    operation = operate().to(phase).tick()
    before = operation["leg_rate"]
    operation.tick(jog_request=(0.0, -0.002, 0.0, 0.0))
    jogged = operation.phase in (Phase.TRANSPORT, Phase.STANDBY)
    expected = (0.0, -0.002, 0.0, 0.0) if jogged else before
    np.testing.assert_array_equal(operation["leg_rate"], expected)
    if jogged:  # and nothing drives meanwhile
        assert operation["wheel_brake"] == 1.0
        assert not operation["wheel_velocity_command"].any()
        assert not operation.tick(jog_request=np.zeros(4))["leg_rate"].any()


def test_a_leg_is_jogged_slowly_and_not_beyond_its_stroke(operate):
    operation = operate(jog_request=(1.0, -1.0, math.nan, math.inf)).to(Phase.STANDBY)
    low, most = DRAWN.extension_min, PARAMS.lowering_rate
    operation.at(np.full(4, 0.42)).tick()
    assert operation["leg_rate"].tolist() == [most, -most, 0.0, 0.0]
    operation.at((PARAMS.raised, low, 0.42, 0.42)).tick()
    assert operation["leg_rate"].tolist() == [0.0] * 4
    operation.at((math.nan, low + 1e-4, 0.42, 0.42)).tick()
    np.testing.assert_allclose(operation["leg_rate"], (0.0, -1e-4 * PARAMS.approach, 0.0, 0.0))


def test_nothing_is_jogged_while_wheels_turn_and_nothing_drives_below_a_leg(operate):
    operation = operate(wheel_velocity=(0.0, 0.0, 0.1, 0.0), jog_request=(0.001, 0, 0, 0)).tick()
    assert not operation["leg_rate"].any()
    operation.set(jog_request=np.zeros(4)).tick()
    assert operation["wheel_velocity_command"].tolist() == list(DRIVE)
    for extension in (PARAMS.clear - 1e-4, math.nan):
        operation.at((extension, *RAISED[1:])).tick()
        assert operation["wheel_brake"] == 1.0
        assert not operation["wheel_velocity_command"].any()
