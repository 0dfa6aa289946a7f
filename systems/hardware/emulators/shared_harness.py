"""A harness, and misbehaviour on command, between processes."""

import mmap
import struct
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from parapod.systems.hardware.emulators.harness import Harness
from parapod.systems.hardware.emulators.misbehaviour import KINDS, Misbehaviour, State

_COUNT_SIZE = 8
_STATE = struct.Struct("<qd")
# A writer that was killed in the middle leaves an odd count for ever; a living one takes
# microseconds, or what the system lets it wait in the middle [s].
_PATIENCE = 1.0


class SharedHarness(Harness):
    """Wires in a file that all processes map, by a layout that all of them know.

    Each signal has one writer. It counts before and after it writes; a reader that sees an odd
    count, or two different ones, has read in between and reads again.
    """

    def __init__(
        self, path: Path, sizes: Mapping[str, int], parts: Sequence[str], is_new: bool = False
    ):
        """Opens the wires.

        Args:
            path: of the file.
            sizes: the number of elements of each signal, by its port's name.
            parts: whose misbehaviours are shared as well.
            is_new: makes the file, with all wires at zero.
        """
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
        count = counts[index]
        counts[index] = count + 1
        begin = at + _COUNT_SIZE
        self._memory[begin : begin + layout.size] = packed
        counts[index] = count + 2

    def misbehaviour(self, part: str, seed: int = 0) -> "SharedMisbehaviour":
        """What the devices of a part do wrong, told by any process and done by another.

        Args:
            part: of the machine.
            seed: of garbage.
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
