import itertools

import pytest

from parapod.systems.levelling_platform.supervisor import (
    TRANSITIONS,
    Event,
    Phase,
    Transition,
    as_mermaid,
    next_phase,
)

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
