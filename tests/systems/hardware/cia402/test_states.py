import pytest

from parapod.systems.hardware.cia402.states import (
    FAULT_RESET,
    STATUSWORDS,
    Controlword,
    DriveState,
    is_energised,
    obeyed,
    state_of,
    steps_to_operation,
)

DISABLED, READY = DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON
ON, OPERATION = DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED
QUICK_STOP, FAULT = DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0000, DriveState.NOT_READY_TO_SWITCH_ON),
        (0x0040, DISABLED),
        (0x0021, READY),
        (0x0023, ON),
        (0x0027, OPERATION),
        (0x0007, QUICK_STOP),
        (0x000F, DriveState.FAULT_REACTION_ACTIVE),
        (0x0008, FAULT),
    ],
)
def test_statusword_tells_the_state_whatever_the_other_bits_are(word, state):
    assert STATUSWORDS[state] == word
    for others in (0x0000, 0x0010, 0x0080, 0x0100, 0x0237, 0x0600, 0xFF90 & ~0x6F):
        assert state_of(word | (others & ~0x6F)) is state


@pytest.mark.parametrize(
    ("word", "state"),
    [
        # States of an EPOS2 by its firmware specification.
        (0x0140, DISABLED),
        (0x0121, READY),
        (0x0123, ON),
        (0x4133, ON),  # measures current offsets
        (0x0137, OPERATION),
        (0x0117, QUICK_STOP),
        (0x010F, DriveState.FAULT_REACTION_ACTIVE),
        (0x011F, DriveState.FAULT_REACTION_ACTIVE),
        (0x0108, FAULT),
    ],
)
def test_statuswords_of_an_epos2(word, state):
    assert state_of(word) is state


def test_quick_stop_bit_is_ignored_where_it_says_nothing():
    assert state_of(0x0060) is DISABLED
    assert state_of(0x0028) is FAULT


@pytest.mark.parametrize("word", [0x0001, 0x0003, 0x0048, 0x0043])
def test_other_patterns_are_no_state(word):
    assert state_of(word) is None


def test_sequence_from_rest_to_operation():
    steps = steps_to_operation(DISABLED)
    assert [int(word) for word, _ in steps] == [0x06, 0x07, 0x0F]
    assert [STATUSWORDS[state] for _, state in steps] == [0x0021, 0x0023, 0x0027]


@pytest.mark.parametrize(
    ("state", "words"),
    [(READY, [0x07, 0x0F]), (ON, [0x0F]), (QUICK_STOP, [0x0F]), (OPERATION, [])],
)
def test_sequence_begins_where_the_drive_is(state, words):
    assert [int(word) for word, _ in steps_to_operation(state)] == words


@pytest.mark.parametrize("state", [FAULT, DriveState.FAULT_REACTION_ACTIVE])
def test_no_sequence_leads_out_of_a_fault(state):
    with pytest.raises(ValueError, match="fault"):
        steps_to_operation(state)


@pytest.mark.parametrize("start", [DISABLED, READY, ON, QUICK_STOP])
def test_drive_that_obeys_follows_the_sequence(start):
    state, previous = start, 0
    for word, expected in steps_to_operation(start):
        state, previous = obeyed(state, previous, word), word
        assert state is expected
    assert state is OPERATION


def test_fault_is_reset_by_an_edge_only():
    assert [int(word) for word in FAULT_RESET] == [0x00, 0x80]
    assert obeyed(FAULT, 0x00, 0x80) is DISABLED
    assert obeyed(FAULT, 0x80, 0x80) is FAULT
    for word in (0x00, 0x06, 0x07, 0x0F):
        assert obeyed(FAULT, 0x00, word) is FAULT


@pytest.mark.parametrize("state", [READY, ON, OPERATION, QUICK_STOP, DISABLED])
def test_disable_voltage_takes_the_power_from_every_state(state):
    assert obeyed(state, 0x0F, Controlword.DISABLE_VOLTAGE) is DISABLED


def test_quick_stop_holds_and_is_released():
    assert obeyed(OPERATION, 0x0F, 0x02) is QUICK_STOP
    assert obeyed(QUICK_STOP, 0x02, 0x07) is QUICK_STOP
    assert obeyed(QUICK_STOP, 0x02, 0x0F) is OPERATION
    assert obeyed(ON, 0x07, 0x02) is DISABLED


def test_operation_is_not_reached_from_rest_at_once():
    assert obeyed(DISABLED, 0x00, 0x0F) is DISABLED
    assert obeyed(DISABLED, 0x00, 0x07) is DISABLED


@pytest.mark.parametrize("state", [DriveState.NOT_READY_TO_SWITCH_ON, "fault reaction active"])
def test_only_the_drive_leaves_its_own_states(state):
    for word in Controlword:
        assert obeyed(DriveState(state), 0x00, word) == state


def test_motor_has_power_in_operation_and_quick_stop():
    assert {state for state in DriveState if is_energised(state)} == {OPERATION, QUICK_STOP}
    assert not is_energised(None)
