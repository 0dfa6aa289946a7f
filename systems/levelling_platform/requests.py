"""What an operator can ask of the supervisor, and why it may not be done."""

from enum import IntEnum


class Command(IntEnum):
    """What an operator can ask for; the numbers are those of the port `operator`."""

    NONE = 0
    GO = 1
    STOP = 2
    RESET = 3


class Refusal(IntEnum):
    """Why something asked for is not done; the numbers are those of the port `refusal`."""

    NONE = 0
    COMMAND = 1  # not in this phase; detail: the phase
    GROUND = 2  # levelling does not fit the stroke; detail: the leg that misses most, 1..4
    POSTURE = 3  # out of reach; detail likewise
    NO_GROUND = 4  # a leg found none; detail: the leg, 1..4
