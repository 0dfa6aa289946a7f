"""Faults of emulated devices, in the words of PX4's failure injection."""

import random
import threading
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from parapod.systems.core.quoting import show
from parapod.systems.safety.faults import FaultKind

UNPLUGGED = "unplugged"
KINDS = (*(kind.value for kind in FaultKind), UNPLUGGED)

# How long a slow device shows the same, a delayed one is late, and an intermittent one is off and
# on [s].
_SLOW_PERIOD, _DELAY, _TURN = 0.2, 0.1, 0.1


class State(NamedTuple):
    """What is done wrong, and since when [s]."""

    kind: str
    since: float


class Misbehaviour:
    """What an emulated device does wrong, told by one thread and done by another.

    A device asks `answers` before it says anything, passes what it measures through `shown`, and
    puts itself out of reach while `is_unplugged`. What garbage is on the wire (a wrong checksum,
    say) is the device's matter: see `is_garbled`.
    """

    def __init__(self, seed: int = 0):
        self.__state: State | None = None
        self._random = random.Random(seed)
        self._past: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=1000)
        self._held: tuple[float, tuple[float, ...]] | None = None
        self._lock = threading.Lock()

    def begin(self, kind: str, now: float) -> None:
        """Begins to misbehave.

        Args:
            kind: one of `KINDS`.
            now: the time [s].

        Raises:
            ValueError: an unknown kind.
        """
        if kind not in KINDS:
            raise ValueError(f"{show(kind)} is not one of {', '.join(KINDS)}")
        with self._lock:
            self._held = None
            self._store(State(kind, now))

    def end(self) -> None:
        """Behaves again."""
        with self._lock:
            self._store(None)

    def _load(self) -> State | None:
        return self.__state

    def _store(self, state: State | None) -> None:
        self.__state = state

    @property
    def kind(self) -> str | None:
        """What it does wrong now; None: nothing."""
        state = self._load()
        return None if state is None else state.kind

    @property
    def is_unplugged(self) -> bool:
        """Whether the connection is gone."""
        return self.kind == UNPLUGGED

    @property
    def is_garbled(self) -> bool:
        """Whether what it sends is damaged."""
        return self.kind == FaultKind.GARBAGE

    def answers(self, now: float) -> bool:
        """Whether the device says anything at that time."""
        state = self._load()
        if state is None:
            return True
        if state.kind == FaultKind.INTERMITTENT:
            return (now - state.since) % (2.0 * _TURN) >= _TURN
        return state.kind not in (FaultKind.OFF, UNPLUGGED)

    def shown(self, values: Sequence[float], now: float) -> tuple[float, ...]:
        """What the device shows in place of what it measures."""
        true = tuple(values)
        with self._lock:
            self._past.append((now, true))
            state = self._load()
            if state is None:
                return true
            match state.kind:
                case FaultKind.STUCK:
                    return self._hold(true, now, forever=True)
                case FaultKind.SLOW:
                    return self._hold(true, now, forever=False)
                case FaultKind.DELAYED:
                    old = [past for at, past in self._past if at <= now - _DELAY]
                    return old[-1] if old else self._past[0][1]
                case FaultKind.WRONG:
                    return tuple(-value for value in true)
                case FaultKind.GARBAGE:
                    return tuple(value * self._random.uniform(-10.0, 10.0) for value in true)
                case _:
                    return true

    def _hold(self, true: tuple[float, ...], now: float, forever: bool) -> tuple[float, ...]:
        if self._held is None or (not forever and now - self._held[0] >= _SLOW_PERIOD):
            self._held = now, true
        return self._held[1]
