"""The process that writes a live log: it reads the numbers from a pipe, and draws the machine."""

import json
import os
import select
import sys
import time
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from parapod.sims.output.companion import PIECE, read_beginning
from parapod.sims.output.logs.live import HEAD, READY
from parapod.sims.output.logs.mcap import FLUSH_PERIOD, McapWriter, Message, Picture
from parapod.systems.core.errors import ParapodError


def _write_all() -> None:
    """Writes what comes through a pipe to the file that is named at its beginning."""
    source, beginning, rest = read_beginning()
    described = json.loads(beginning)
    sizes = described["sizes"]
    length = 8 * (HEAD + sum(sizes))

    def draw(
        shapes: Mapping[str, tuple[int, ...]], pictures: Sequence[Picture]
    ) -> Iterable[Message]:
        # Drake is loaded when the machine moves no more.
        from parapod.sims.lab.subject import draw_log

        return draw_log(described["metadata"], shapes, pictures)

    with open(described["path"], "wb") as stream:
        writer = McapWriter(stream, described["units"], sizes, described["metadata"])
        writer.flush()
        os.write(sys.stdout.fileno(), READY)
        flushed = time.monotonic()
        is_over = False
        while not is_over:
            if select.select([source], [], [], FLUSH_PERIOD)[0]:
                piece = os.read(source, PIECE)
                rest, is_over = rest + piece, not piece
            whole = len(rest) - len(rest) % length
            for begin in range(0, whole, length):
                row = np.frombuffer(rest, count=length // 8, offset=begin)
                writer.write(int(row.view(np.int64)[0]), float(row[1]), row[HEAD:])
            rest = rest[whole:]
            if time.monotonic() - flushed >= FLUSH_PERIOD:
                writer.flush()
                flushed = time.monotonic()
        writer.draw(draw)
        writer.finish()


def main() -> int:
    """Writes a log in a process of its own; its exit code."""
    try:
        _write_all()
    except (OSError, ParapodError) as error:
        reason = getattr(error, "strerror", None) or error
        os.write(sys.stdout.fileno(), f"{reason}\n".encode())
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
