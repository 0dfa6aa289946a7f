"""Phases of the platform's operation and the transitions between them (section 2.2).

One table says everything: `Supervisor` walks through it, and `as_mermaid` draws it.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum


class Phase(IntEnum):
    """What the platform is doing; the numbers are those of the supervisor's port `phase`."""

    TRANSPORT = 0
    BRAKE = 1
    LOWER = 2
    TOUCHDOWN = 3
    ESTIMATE = 4
    POSTURE = 5
    HOLD = 6
    RETRACT = 7
    FAULT = 8


class Event(StrEnum):
    """What makes the platform go from one phase to another."""

    FAULT = "a fault of severity hold or more"
    GO = "the operator says go"
    STOP = "the operator says stop"
    RESET = "the operator says reset, and the fault's cause is gone"
    STANDS_STILL = "the wheels stand still"
    ALL_TOUCH = "each leg has found the ground, and is back where its switch closed"
    SETTLED = "nothing moved for a while"
    GROUND_FITS = "the ground is known, and its levelling fits the stroke"
    ARRIVED = "the posture is taken"
    NEW_POSTURE = "another posture is asked for"
    LEGS_UP = "all four legs are up"


@dataclass(frozen=True)
class Transition:
    """One line of the table.

    Attributes:
        source: phase in which the event counts.
        event: what happens.
        target: phase that follows.
    """

    source: Phase
    event: Event
    target: Phase


# In the order in which events are looked at: what stops comes before what goes on.
TRANSITIONS: tuple[Transition, ...] = (
    *(Transition(p, Event.FAULT, Phase.FAULT) for p in Phase if p is not Phase.FAULT),
    Transition(Phase.TRANSPORT, Event.GO, Phase.BRAKE),
    Transition(Phase.BRAKE, Event.STOP, Phase.TRANSPORT),
    Transition(Phase.BRAKE, Event.STANDS_STILL, Phase.LOWER),
    Transition(Phase.LOWER, Event.STOP, Phase.RETRACT),
    Transition(Phase.LOWER, Event.ALL_TOUCH, Phase.TOUCHDOWN),
    Transition(Phase.TOUCHDOWN, Event.STOP, Phase.RETRACT),
    Transition(Phase.TOUCHDOWN, Event.SETTLED, Phase.ESTIMATE),
    Transition(Phase.ESTIMATE, Event.STOP, Phase.RETRACT),
    Transition(Phase.ESTIMATE, Event.GROUND_FITS, Phase.POSTURE),
    Transition(Phase.POSTURE, Event.STOP, Phase.RETRACT),
    Transition(Phase.POSTURE, Event.ARRIVED, Phase.HOLD),
    Transition(Phase.HOLD, Event.STOP, Phase.RETRACT),
    Transition(Phase.HOLD, Event.NEW_POSTURE, Phase.POSTURE),
    Transition(Phase.RETRACT, Event.LEGS_UP, Phase.TRANSPORT),
    Transition(Phase.FAULT, Event.RESET, Phase.RETRACT),
)


def next_phase(phase: Phase, events: frozenset[Event] | set[Event]) -> Phase:
    """The phase that follows: the first line of the table whose event happened decides."""
    for transition in TRANSITIONS:
        if transition.source is phase and transition.event in events:
            return transition.target
    return phase


def as_mermaid() -> str:
    """The table as a state diagram in Mermaid's language; faults are one line."""
    lines = ["stateDiagram-v2", f"    [*] --> {Phase.TRANSPORT.name}"]
    lines += [
        f"    {t.source.name} --> {t.target.name}: {t.event.value}"
        for t in TRANSITIONS
        if t.event is not Event.FAULT
    ]
    lines.append(f"    note right of FAULT: from every phase, {Event.FAULT.value}")
    return "\n".join(lines)
