"""Runs that are carried out together: their closed loops are simulated side by side.

Each run is a function in a thread of its own, and only one of them is at work at any time. One
that comes to a simulation waits there until all others do or are done; loops that are wired
alike are then simulated as rows. So an experiment need not know of the others.
"""

import gc
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import Any

from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.recording import Recording
from parapod.diagrams.side_by_side import LoopRows, bytes_of_row
from parapod.systems.core.errors import ParapodError

# Memory of a loop, those of rigid bodies with the engine's model [B].
_LOOP = 6 * 2**20
# Memory of the loops and recordings of all rows that are simulated at once [B].
_MEMORY = 640 * 2**20
# Fewer rows than this are faster one after the other, in C++ in part.
_FEWEST = 8
# Times at which rows are looked at, whether they pay.
_LOOKS = 20
_MOMENT = 1e-6  # shorter than any work [s]
# Stack of a thread, that of a program on Linux; only what is used takes memory [B].
_STACK = 8 * 2**20


def collect_garbage() -> None:
    """Collects garbage, unless in a thread beside: a scene of Meshcat must end in its own."""
    if threading.current_thread() is threading.main_thread():
        gc.collect()


@dataclass(frozen=True)
class Wish:
    """Simulation that a run wants.

    Attributes:
        loop: its loop, which may be that of others too; those wired alike go together.
        begin: the machine's scenario that it begins with.
        duration: end of the run [s].
        monitor: may end it, as a simulator's; None: it goes to its end.
    """

    loop: ClosedLoop[Any]
    begin: Any
    duration: float
    monitor: Callable[[Any], EventStatus] | None = None


@dataclass(frozen=True)
class Granted:
    """A simulation that has been carried out.

    Attributes:
        recording: its signals.
        elapsed: its share of the wall-clock time [s].
        context: makes the root context at its end.
    """

    recording: Recording
    elapsed: float
    context: Callable[[], Context]


class Together:
    """A gathering of runs.

    Args:
        rows: largest number of runs at once; None: as many as are fast, within the memory that
            they may take.
    """

    def __init__(self, rows: int | None = None):
        self._rows = rows
        self._alone: set[Hashable] = set()  # what loops share that are simulated one by one
        self._here = threading.local()

    def simulate(self, wish: Wish) -> Granted | None:
        """Called by a run: the simulation that it wants; None if it is to do it alone.

        Raises:
            Exception: the reason why the row failed.
        """
        guest: _Guest | None = getattr(self._here, "guest", None)
        if guest is None:
            return None
        answer = guest.ask(wish)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def carry_out[R](self, works: Iterable[Callable[[], R]]) -> Iterator[R]:
        """Carries out runs.

        Args:
            works: functions, which may call `simulate`, and must not raise.

        Yields:
            Their results, in their order.
        """
        waiting = iter(works)
        if self._rows == 1:
            yield from (work() for work in waiting)
            return
        while guests := self._gather(waiting):
            while wishes := [guest for guest in guests if guest.wish is not None]:
                for guests_alike in _alike(wishes):
                    collect_garbage()  # rows of before, which know each other in circles
                    self._answer(guests_alike)
            for guest in guests:
                yield guest.result()

    def _answer(self, guests: "Sequence[_Guest[Any]]") -> None:
        """Simulates runs that are alike, unless others of the kind were better off alone."""
        form = guests[0].form
        answers: Iterable[Granted | Exception | None] = (
            repeat(None) if form in self._alone else _simulated([guest.wish for guest in guests])
        )
        for guest, answer in zip(guests, answers, strict=False):
            if answer is None and len(guests) >= _FEWEST:
                self._alone.add(form)
            guest.answer(answer)

    def _gather[R](self, works: Iterator[Callable[[], R]]) -> "list[_Guest[R]]":
        """Lets runs begin until there are enough of them."""
        guests: list[_Guest[R]] = []
        loops: set[int] = set()
        memory, most = 0, self._rows or sys.maxsize
        for work in works:
            guest = _Guest(work, self._here)
            guest.begin()
            guests.append(guest)
            if guest.wish is not None:
                memory += bytes_of_row(guest.wish.loop, guest.wish.duration)
                memory += 0 if id(guest.wish.loop) in loops else _LOOP
                loops.add(id(guest.wish.loop))
            if len(guests) >= most or (self._rows is None and memory >= _MEMORY):
                break
        return guests


class _Guest[R]:
    """A run in a thread, which is at work only while it is asked to be."""

    def __init__(self, work: Callable[[], R], here: threading.local):
        self.wish: Wish | None = None
        self._work, self._here = work, here
        self._answer: Granted | Exception | None = None
        self._results: list[R] = []
        self._errors: list[BaseException] = []
        self._ours, self._theirs = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def begin(self) -> None:
        """Runs until the first wish, or the end."""
        before = threading.stack_size(_STACK)
        try:
            self._thread.start()
        finally:
            threading.stack_size(before)
        self._ours.acquire()

    def ask(self, wish: Wish) -> Granted | Exception | None:
        """Called in its thread: waits for a simulation."""
        self.wish = wish
        self._ours.release()
        self._theirs.acquire()
        answer, self._answer = self._answer, None  # a recording is large
        return answer

    def answer(self, answer: Granted | Exception | None) -> None:
        """Runs on until the next wish, or the end."""
        self.wish, self._answer = None, answer
        self._theirs.release()
        self._ours.acquire()

    @property
    def form(self) -> Hashable:
        """All that those share with which its wish may be granted."""
        assert self.wish is not None
        return self.wish.loop.form, self.wish.duration

    def result(self) -> R:
        """The result, once it has come to the end."""
        self._thread.join()
        if self._errors:
            raise self._errors[0]
        return self._results.pop()

    def _run(self) -> None:
        self._here.guest = self
        try:
            self._results.append(self._work())
        except BaseException as error:
            self._errors.append(error)
        self._ours.release()


def _alike(guests: Sequence["_Guest[Any]"]) -> "list[list[_Guest[Any]]]":
    """Runs whose loops are simulated together."""
    groups: dict[Hashable, list[_Guest[Any]]] = {}
    for guest in guests:
        groups.setdefault(guest.form, []).append(guest)
    return list(groups.values())


def _simulated(wishes: Sequence[Any]) -> Iterator[Granted | Exception | None]:
    """Answers to wishes for loops that are wired alike; None where a run is better off alone."""
    started = time.perf_counter()
    rows = _rows_of(wishes) if len(wishes) >= _FEWEST else None
    elapsed = (time.perf_counter() - started) / len(wishes)
    for row in range(len(wishes)):
        yield (
            None
            if rows is None
            else rows.errors.get(row)
            or Granted(rows.recording(row), elapsed, partial(rows.context, row))
        )


def _rows_of(wishes: Sequence[Any]) -> LoopRows[Any] | None:
    """Rows that have been simulated; None if there are no laws for them, or it does not pay."""
    monitors = [wish.monitor for wish in wishes]
    try:
        rows = LoopRows([wish.loop for wish in wishes], [wish.begin for wish in wishes])
        return rows if _carried_on(rows, wishes[0], monitors) else None
    except ParapodError:
        return None


def _carried_on(rows: LoopRows[Any], wish: Wish, monitors: Sequence[Any]) -> bool:
    """Simulates rows as long as it pays; false if to begin anew, one by one, takes less time.

    Laws may ask what rows answer differently, or take them one at a time: then many rows can be
    slower than Drake, one after the other. Their results are the same.
    """
    period, duration = rows.loop.sampling_period, wish.duration
    samples = max(1, round(duration / _LOOKS / period))
    by_drake = 0.0
    for look in range(1, _LOOKS):
        if (until := look * samples * period) >= duration:
            break
        time_of_all = _cpu_time(partial(rows.advance_to, until, monitors))
        by_drake = by_drake or max(_cpu_time(partial(_simulate, wish, until)), _MOMENT)
        slowness = time_of_all / len(rows.scenarios) / by_drake
        if slowness * (duration - until) > duration:
            return False
    rows.advance_to(duration, monitors)
    return True


def _simulate(wish: Wish, until: float) -> None:
    simulator = wish.loop.simulator()
    wish.loop.reset(simulator.get_mutable_context(), wish.begin)
    with suppress(Exception):  # which is told when this run is carried out
        simulator.AdvanceTo(until)


def _cpu_time(work: Callable[[], object]) -> float:
    """Time that the processor spends on a piece of work [s]."""
    started = time.process_time()
    work()
    return time.process_time() - started
