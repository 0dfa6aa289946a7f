"""`python -m benchmarks.wake_ups CORE`: a real-time program that only wakes up, on one core.

It waits behind no program of ordinary or lesser priority, so that what delays it is the computer
itself: its kernel, its firmware, or the host of a virtual machine. It also looks at the time for
which the host took its core away, as the kernel counts it ("steal" in proc(5)): a program that
waits meanwhile does not notice. It ends with its standard input.
"""

import gc
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO

import numpy as np
from numpy.typing import NDArray

from parapod.sims.real_machine.privileges import KERNEL, PRIORITY
from parapod.sims.real_machine.wake_up import wake_ups as wakings

_PERIOD = 0.002  # [s]
# Later wake-ups than this are reported: they are not the scheduler's usual ones [s].
_LATE = 0.001
# Wake-ups from one look at what the host took to the next; its column in /proc/stat, and the
# kernel's unit of it [s].
_LOOK, _STEAL, _TICK = 5, 8, 1.0 / os.sysconf("SC_CLK_TCK")


class WakeUps:
    """Programs that wake up, one a core, while something else is measured.

    Attributes:
        late: begin and end of each time in which a core woke no program, by the monotonic clock
            [s], (n, 2).
        steal: instant of a look, and time for which the host had taken a core since the look
            before [s], (n, 2); the kernel counts it in hundredths of a second.
        is_judge: true if all of them had the priority that makes them a yardstick.
    """

    def __init__(self) -> None:
        self.late: NDArray[np.float64] = np.empty((0, 2))
        self.steal: NDArray[np.float64] = np.empty((0, 2))
        self.is_judge = False

    @property
    def latest(self) -> float:
        """Longest time in which a core woke no program [s]."""
        return float(np.max(np.diff(self.late), initial=0.0))

    def before(self, instants: NDArray[np.float64], span: float) -> NDArray[np.float64]:
        """Sum of the times in which cores woke no program shortly before each instant [s], (m,).

        Args:
            instants: instants by the monotonic clock [s], (m,).
            span: time before an instant that counts [s].
        """
        begin, end = self.late.T[:, :, None]
        overlap = np.minimum(end, instants) - np.maximum(begin, instants - span)
        return np.sum(np.maximum(overlap, 0.0), axis=0)

    def steal_before(self, instants: NDArray[np.float64], span: float) -> NDArray[np.float64]:
        """Sum of the times for which the host took cores shortly before each instant [s], (m,).

        Args:
            instants: instants by the monotonic clock [s], (m,).
            span: time before an instant that counts [s].
        """
        looks, steal = self.steal.T[:, :, None]
        # What was taken up to an instant is seen at the look after it.
        counts = (looks > instants - span) & (looks <= instants + _LOOK * _PERIOD)
        return np.sum(steal * counts, axis=0)


@contextmanager
def wake_ups() -> Iterator[WakeUps]:
    """Wakes up on every core meanwhile; what came of it is known afterwards."""
    command = [sys.executable, "-m", "benchmarks.wake_ups"]
    pipe = subprocess.PIPE
    programs = [
        subprocess.Popen([*command, str(core)], stdin=pipe, stdout=pipe, text=True)
        for core in sorted(os.sched_getaffinity(0))
    ]
    counts = WakeUps()
    try:
        yield counts
    finally:
        outputs = [program.communicate()[0].splitlines() for program in programs]
        counts.is_judge = all(lines[:1] == ["fifo"] for lines in outputs)
        rows = [line.split() for lines in outputs for line in lines[1:]]
        counts.late, counts.steal = (
            np.array(
                [[float(word) for word in words] for kind, *words in rows if kind == this]
            ).reshape(-1, 2)
            for this in ("late", "steal")
        )


def _wake_up(core: int) -> None:
    """Prints from when until when nothing woke this program, until its standard input ends."""
    KERNEL.set_cores({core})
    try:
        KERNEL.set_fifo(PRIORITY + 1)
        print("fifo", flush=True)
    except OSError as error:
        print(error.strerror, flush=True)
    gc.disable()
    late: list[tuple[float, float]] = []
    steal: list[tuple[float, float]] = []
    with open("/proc/stat", "rb", buffering=0) as file:
        before = _steal(file, core)
        for count, (due, now) in enumerate(wakings(_PERIOD)):
            if now - due > _LATE:
                late.append((due, now))
            if count % _LOOK == 0 and (total := _steal(file, core)) > before:
                steal.append((now, total - before))
                before = total
            if select.select([sys.stdin], [], [], 0.0)[0]:
                break
    for kind, rows in (("late", late), ("steal", steal)):
        for one, other in rows:
            print(f"{kind} {one:.6f} {other:.6f}")


def _steal(file: FileIO, core: int) -> float:
    """Time for which the host has taken a core away since the computer began [s]."""
    file.seek(0)
    name = b"cpu%d " % core
    line = next(line for line in file.read().splitlines() if line.startswith(name))
    return _TICK * int(line.split()[_STEAL])


if __name__ == "__main__":
    _wake_up(int(sys.argv[1]))
