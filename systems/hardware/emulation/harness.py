"""Wires between emulated devices and the simulated machine behind them, and the devices' faults.

Both exist within one process and, in a file that is mapped, between processes.
"""

import mmap
import random
import struct
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from parapod.systems.core.quoting import show
from parapod.systems.safety.faults import FaultKind


class Harness:
    """The newest value of every signal, by its port's name, shared between threads.

    Values are tuples that are swapped whole, so a reader never sees half of one.
    """

    def __init__(self, sizes: Mapping[str, int], idle: Mapping[str, float] | None = None):
        """Creates wires at zero.

        Args:
            sizes: the number of elements of each signal, by its port's name.
            idle: value of each command to the machine while its part is neutral; None: which of
                the signals are commands is not known.
        """
        self._sizes, self._idle = dict(sizes), dict(idle or {})
        self._values: dict[str, tuple[float, ...]] = {
            name: (0.0,) * size for name, size in sizes.items()
        }

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def signals_of(self, part: str) -> dict[str, tuple[int, float | None]]:
        """Signals of a part: size, and idle value of a command; None for a measurement."""
        start = f"{part}."
        return {
            name.removeprefix(start): (size, self._idle.get(name))
            for name, size in self._sizes.items()
            if name.startswith(start)
        }

    def get(self, name: str) -> tuple[float, ...]:
        """The newest value of a signal."""
        return self._values[name]

    def set(self, name: str, values: Sequence[float]) -> None:
        """Puts a value on the wires.

        Raises:
            ValueError: another number of elements than the signal has.
        """
        size = len(self._values[name])
        if len(values) != size:
            raise ValueError(f"{name} has {size} elements, not {len(values)}")
        self._values[name] = tuple(float(value) for value in values)


SUPPLY = "supply"
"""Wire of the drives' supply where a machine's emulator has it: 1 [-] while it is there."""


def is_supplied(harness: Harness) -> bool:
    """Whether the drives have their supply."""
    return SUPPLY not in harness or harness.get(SUPPLY)[0] > 0.5


class MutedHarness(Harness):
    """Wires, some of them cut: values that the device sets on those are lost."""

    def __init__(self, harness: Harness, muted: Sequence[str]):
        """Cuts wires.

        Args:
            harness: the wires.
            muted: the signals that are not to be set.
        """
        self._harness, self._muted = harness, frozenset(muted)
        self._sizes, self._idle = harness._sizes, harness._idle

    def __contains__(self, name: str) -> bool:
        return name in self._harness

    def get(self, name: str) -> tuple[float, ...]:
        """See `Harness`."""
        return self._harness.get(name)

    def set(self, name: str, values: Sequence[float]) -> None:
        """See `Harness`."""
        if name not in self._muted:
            self._harness.set(name, values)


UNPLUGGED = "unplugged"
KINDS = (*(kind.value for kind in FaultKind), UNPLUGGED)

# How long a slow device shows the same, a delayed one is late, and an intermittent one is off and
# on [s].
_SLOW_PERIOD, _DELAY, _TURN = 0.2, 0.1, 0.1


class State(NamedTuple):
    """A misbehaviour, and the time of its beginning [s]."""

    kind: str
    since: float


class Misbehaviour:
    """Misbehaviour of an emulated device, requested by one thread and done by another.

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
        """Its misbehaviour now; None if it behaves."""
        state = self._load()
        return None if state is None else state.kind

    @property
    def is_unplugged(self) -> bool:
        """Whether the connection is gone."""
        return self.kind == UNPLUGGED

    @property
    def is_garbled(self) -> bool:
        """Whether its messages are damaged."""
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
        """Values that the device shows in place of those that it measures."""
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


_COUNT_SIZE = 8
_STATE = struct.Struct("<qd")
# A writer that was killed in the middle leaves an odd count until the next one; a living one takes
# microseconds, or what the system lets it wait in the middle [s].
_PATIENCE = 1.0


class SharedHarness(Harness):
    """Wires in a file that all processes map, by a layout that all of them know.

    Each signal is written by one process, whose threads wait for each other. It counts before and
    after it writes; a reader that sees an odd count, or two different ones, has read in between
    and reads again.
    """

    def __init__(
        self,
        path: Path,
        sizes: Mapping[str, int],
        parts: Sequence[str],
        is_new: bool = False,
        idle: Mapping[str, float] | None = None,
    ):
        """Opens the wires.

        Args:
            path: path of the file.
            sizes: the number of elements of each signal, by its port's name.
            parts: parts that share its misbehaviours.
            is_new: makes the file, with all wires at zero.
            idle: see `Harness`.
        """
        self._sizes, self._idle = dict(sizes), dict(idle or {})
        self._layout: dict[str, tuple[int, struct.Struct]] = {}
        end = 0
        for signal, size in sizes.items():
            self._layout[signal] = end, struct.Struct(f"<{size}d")
            end += _COUNT_SIZE + 8 * size
        self._states = {part: end + k * _STATE.size for k, part in enumerate(parts)}
        end += len(parts) * _STATE.size
        if is_new:
            # A new file, so that processes that are left over keep the old one.
            path.unlink(missing_ok=True)
            path.write_bytes(bytes(end))
        with open(path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), end)
        # Not with `pack_into`, which makes zeros first: others would see an even count meanwhile.
        self._counts = memoryview(self._memory).cast("q")
        self._writing = threading.Lock()

    def __contains__(self, name: str) -> bool:
        return name in self._layout

    def get(self, name: str) -> tuple[float, ...]:
        """See `Harness`."""
        at, values = self._layout[name]
        counts, index = self._counts, at // _COUNT_SIZE
        until = None
        while until is None or time.monotonic() < until:
            before = counts[index]
            read = values.unpack_from(self._memory, at + _COUNT_SIZE)
            after = counts[index]
            if before == after and before % 2 == 0:
                break
            until = until or time.monotonic() + _PATIENCE
        return read

    def set(self, name: str, values: Sequence[float]) -> None:
        """See `Harness`."""
        at, layout = self._layout[name]
        if 8 * len(values) != layout.size:
            raise ValueError(f"{name} has {layout.size // 8} elements, not {len(values)}")
        packed = layout.pack(*values)  # may fail; between the counts nothing must
        counts, index = self._counts, at // _COUNT_SIZE
        begin = at + _COUNT_SIZE
        with self._writing:
            odd = counts[index] | 1  # already, where a writer was killed in the middle
            counts[index] = odd
            self._memory[begin : begin + layout.size] = packed
            counts[index] = odd + 1

    def misbehaviour(self, part: str, seed: int = 0) -> "SharedMisbehaviour":
        """Misbehaviour of the devices of a part, requested by any process and done by another.

        Args:
            part: part of the machine.
            seed: seed of garbage.
        """
        return SharedMisbehaviour(self._memory, self._states[part], seed)


class SharedMisbehaviour(Misbehaviour):
    """A `Misbehaviour` whose state lies in shared memory."""

    def __init__(self, memory: mmap.mmap, at: int, seed: int):
        """Creates it; see `SharedHarness.misbehaviour`."""
        self._memory, self._at = memory, at
        self._seen: State | None = None
        super().__init__(seed)

    def _load(self) -> State | None:
        number, since = _STATE.unpack_from(self._memory, self._at)
        state = State(KINDS[number - 1], since) if number else None
        if state != self._seen:
            self._seen, self._held = state, None
        return state

    def _store(self, state: State | None) -> None:
        number = 0 if state is None else 1 + KINDS.index(state.kind)
        since = 0.0 if state is None else state.since
        self._memory[self._at : self._at + _STATE.size] = _STATE.pack(number, since)
