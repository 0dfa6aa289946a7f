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

# Bit 5 (quick stop) says nothing in the states that these four patterns tell.
_WITHOUT_QUICK_STOP_BIT, _WITH_QUICK_STOP_BIT = 0x4F, 0x6F
_COARSE = {
    STATUSWORDS[state]: state
    for state in (
        DriveState.NOT_READY_TO_SWITCH_ON,
        DriveState.SWITCH_ON_DISABLED,
        DriveState.FAULT_REACTION_ACTIVE,
        DriveState.FAULT,
    )
}
_FINE = {word: state for state, word in STATUSWORDS.items() if word not in _COARSE}

_ENERGISED = (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE)
_TO_OPERATION: tuple[Step, ...] = (
    (Controlword.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),
    (Controlword.SWITCH_ON, DriveState.SWITCHED_ON),
    (Controlword.ENABLE_OPERATION, DriveState.OPERATION_ENABLED),
)
_STEPS_DONE = {
    DriveState.SWITCH_ON_DISABLED: 0,
    DriveState.READY_TO_SWITCH_ON: 1,
    DriveState.SWITCHED_ON: 2,
    DriveState.QUICK_STOP_ACTIVE: 2,
    DriveState.OPERATION_ENABLED: 3,
}

FAULT_RESET: tuple[Controlword, Controlword] = (
    Controlword.DISABLE_VOLTAGE,
    Controlword.FAULT_RESET,
)
"""Resets a fault: the drive obeys a rising edge of bit 7, so the bit must have been zero."""


def state_of(statusword: int) -> DriveState | None:
    """The state that a statusword shows; None if it is none of CiA 402's patterns."""
    coarse = _COARSE.get(statusword & _WITHOUT_QUICK_STOP_BIT)
    return coarse or _FINE.get(statusword & _WITH_QUICK_STOP_BIT)


def steps_to_operation(state: DriveState) -> tuple[Step, ...]:
    """The commands that lead from a state to operation enabled, each with the state it leads to.

    Raises:
        ValueError: no command leads there, as in a fault, which has to be reset first.
    """
    if state not in _STEPS_DONE:
        raise ValueError(f"no command leads from {state} to operation enabled")
    return _TO_OPERATION[_STEPS_DONE[state] :]


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
    return _obeyed_enabling(state, controlword)


def _obeyed_enabling(state: DriveState, controlword: int) -> DriveState:
    """The state after a controlword that neither disables the voltage nor stops quickly."""
    match state, controlword & Controlword.ENABLE_OPERATION:
        case DriveState.QUICK_STOP_ACTIVE, Controlword.ENABLE_OPERATION:
            return DriveState.OPERATION_ENABLED
        case DriveState.QUICK_STOP_ACTIVE, _:
            return state
        case DriveState.SWITCH_ON_DISABLED, word:
            is_shutdown = word & Controlword.SWITCH_ON == Controlword.SHUTDOWN
            return DriveState.READY_TO_SWITCH_ON if is_shutdown else state
        case _, Controlword.ENABLE_OPERATION:
            # CiA 402 lets a drive pass "switched on" on the way.
            return DriveState.OPERATION_ENABLED
        case _, Controlword.SWITCH_ON:
            return DriveState.SWITCHED_ON
        case _:
            return DriveState.READY_TO_SWITCH_ON
