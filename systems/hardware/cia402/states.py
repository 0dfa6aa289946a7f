"""The state machine of electric drives: CiA 402-2 (IEC 61800-7-201), "PDS finite state automaton".

Both sides of it as pure functions: which state a statusword shows and which controlwords lead to
operation, for who commands a drive; what a controlword does, for who emulates one.
"""

from enum import IntEnum, StrEnum


class DriveState(StrEnum):
    """A state of the drive; the text is what errors call it."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"


class Controlword(IntEnum):
    """Commands of object 0x6040; bits that a command does not care about are zero."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


type Step = tuple[Controlword, DriveState]
"""A command, and the state in which the drive is when it has obeyed."""

STATUSWORDS = {
    DriveState.NOT_READY_TO_SWITCH_ON: 0x0000,
    DriveState.SWITCH_ON_DISABLED: 0x0040,
    DriveState.READY_TO_SWITCH_ON: 0x0021,
    DriveState.SWITCHED_ON: 0x0023,
    DriveState.OPERATION_ENABLED: 0x0027,
    DriveState.QUICK_STOP_ACTIVE: 0x0007,
    DriveState.FAULT_REACTION_ACTIVE: 0x000F,
    DriveState.FAULT: 0x0008,
}
"""The state bits of object 0x6041, all others zero."""

_STATES = {word: state for state, word in STATUSWORDS.items()}
# Bit 5 (quick stop) says nothing in the states of these patterns.
_COARSE = (0x0000, 0x0008, 0x000F, 0x0040)
_WITHOUT_QUICK_STOP_BIT, _WITH_QUICK_STOP_BIT = 0x4F, 0x6F

_ENERGISED = (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE)
# Next step towards operation, from each state from which a command leads there.
_NEXT: dict[DriveState, Step] = {
    DriveState.SWITCH_ON_DISABLED: (Controlword.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),
    DriveState.READY_TO_SWITCH_ON: (Controlword.SWITCH_ON, DriveState.SWITCHED_ON),
    DriveState.SWITCHED_ON: (Controlword.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),
    DriveState.QUICK_STOP_ACTIVE: (Controlword.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),
}

FAULT_RESET = (Controlword.DISABLE_VOLTAGE, Controlword.FAULT_RESET)
"""Resets a fault: the drive obeys a rising edge of bit 7, so the bit must have been zero."""


def state_of(statusword: int) -> DriveState | None:
    """The state that a statusword shows; None if it is none of CiA 402's patterns."""
    coarse = statusword & _WITHOUT_QUICK_STOP_BIT
    return _STATES.get(coarse if coarse in _COARSE else statusword & _WITH_QUICK_STOP_BIT)


def steps_to_operation(state: DriveState) -> list[Step]:
    """The steps that lead from a state to operation enabled.

    Raises:
        ValueError: no command leads there, as in a fault, which has to be reset first.
    """
    steps: list[Step] = []
    while state is not DriveState.OPERATION_ENABLED:
        if state not in _NEXT:
            raise ValueError(f"no command leads from {state} to operation enabled")
        steps.append(_NEXT[state])
        state = _NEXT[state][1]
    return steps


def is_energised(state: DriveState | None) -> bool:
    """Whether the motor has power and follows the drive's controller."""
    return state in _ENERGISED


def obeyed(state: DriveState, previous: int, controlword: int) -> DriveState:
    """The state in which a drive is after a controlword.

    Args:
        state: before.
        previous: controlword before: a fault is reset by an edge.
        controlword: received controlword.
    """
    match state:
        case DriveState.FAULT:
            rises = controlword & ~previous & Controlword.FAULT_RESET
            return DriveState.SWITCH_ON_DISABLED if rises else state
        case DriveState.NOT_READY_TO_SWITCH_ON | DriveState.FAULT_REACTION_ACTIVE:
            return state  # only the drive itself leaves these
    if not controlword & 0x02:
        return DriveState.SWITCH_ON_DISABLED
    if not controlword & 0x04:
        stopped = DriveState.QUICK_STOP_ACTIVE
        return stopped if is_energised(state) else DriveState.SWITCH_ON_DISABLED
    match state, controlword & Controlword.ENABLE_OPERATION:
        case DriveState.QUICK_STOP_ACTIVE, command:
            is_enabled = command == Controlword.ENABLE_OPERATION
            return DriveState.OPERATION_ENABLED if is_enabled else state
        case DriveState.SWITCH_ON_DISABLED, command:
            is_shutdown = command & Controlword.SWITCH_ON == Controlword.SHUTDOWN
            return DriveState.READY_TO_SWITCH_ON if is_shutdown else state
        case _, Controlword.ENABLE_OPERATION:
            # CiA 402 lets a drive pass "switched on" on the way.
            return DriveState.OPERATION_ENABLED
        case _, Controlword.SWITCH_ON:
            return DriveState.SWITCHED_ON
        case _:
            return DriveState.READY_TO_SWITCH_ON
