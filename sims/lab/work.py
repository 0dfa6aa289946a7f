"""Many independent pieces of work, carried out by any `concurrent.futures.Executor`.

    with LocalCrew(2) as crew:
        for number, result in carry_out(crew, work, pieces):
            ...

A crew is an executor, with what has to be known of it: how much it does at once, with which
exceptions pieces fail whose worker died, and how a broken executor is replaced. Pieces whose
worker died are carried out again, one at a time, so that one that kills workers is found.
"""

import itertools
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Self

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.rows import LIBRARY_FUNCTIONS

# Duration of what a worker is sent at once, and its largest number of pieces: those of some
# milliseconds would otherwise wait for messages [s].
_PARCEL = 0.5
_MOST_IN_PARCEL = 64
# Parcels on their way for each worker: the one that it carries out, and one that it finds then.
_AHEAD = 2
# A piece of work that has lost this number of workers, the last one alone, is given up.
_MOST_LOST = 2


class WorkerDied(ParapodError):
    """The process that carried out a piece ended in the midst of it."""


class NoWorkers(ParapodError):
    """An executor that carries out nothing, or nothing any more."""


class Crew:
    """An executor, and what has to be known of it.

    Attributes:
        executor: carries out the work.
        size: number of pieces that it carries out at the same time.
        losses: exceptions with which pieces fail whose worker died.
    """

    losses: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, executor: Executor, size: int):
        """Takes an executor that the caller opens and closes."""
        self.executor, self.size = executor, size

    def begin(self) -> None:
        """Makes sure that there are workers.

        Raises:
            NoWorkers: there are none.
        """

    def renew(self) -> None:
        """Replaces an executor that is broken.

        Raises:
            NoWorkers: it cannot be replaced.
        """
        raise NoWorkers("the executor is broken: its workers have died")

    def close(self) -> None:
        """Ends what was opened for it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class LocalCrew(Crew):
    """Processes on this computer.

    They are spawned, not forked: Drake's threads would be copied half. They end with this one,
    however it ends.
    """

    def __init__(self, size: int | None = None):
        """Prepares `size` processes, or one a core; they begin with the work."""
        # Drake asks for many small blocks of memory: with room for more of them in each thread's
        # cache its multibody plants take a sixth less time. The C library of Linux reads this.
        os.environ.setdefault("GLIBC_TUNABLES", "glibc.malloc.tcache_count=200")
        # Many runs at once call the C library's functions by NumPy, if it lets them.
        for name, value in LIBRARY_FUNCTIONS.items():
            os.environ.setdefault(name, value)
        # They end when our end is closed, which the kernel does for a program that is killed.
        self._theirs, self._ours = multiprocessing.Pipe(duplex=False)
        size = size or os.cpu_count() or 1
        super().__init__(self._pool(size), size)

    def _pool(self, size: int) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        threads = max(1, (os.cpu_count() or 1) // size)
        return ProcessPoolExecutor(size, context, _begin_worker, (self._theirs, threads))

    def begin(self) -> None:
        """Begins a process, and sees whether it lives."""
        try:
            self.executor.submit(os.getpid).result()
        except BrokenExecutor as error:
            raise NoWorkers(
                "the workers end as soon as they begin; in a script everything that begins them "
                'must stand below `if __name__ == "__main__":`'
            ) from error

    def renew(self) -> None:
        """Begins anew with as many processes."""
        self.executor.shutdown(wait=True)
        self.executor = self._pool(self.size)

    def close(self) -> None:
        """Ends the processes, whatever they are doing."""
        self._ours.close()
        self.executor.shutdown(wait=True, cancel_futures=True)
        self._theirs.close()


def _begin_worker(theirs: Connection, threads: int) -> None:
    """Lets a process end with the one that has begun it, and only with that one.

    Args:
        theirs: connection whose other end the one that has begun it holds.
        threads: number of threads that its libraries may use, so that all workers have a core.
    """
    os.environ.setdefault("OMP_NUM_THREADS", str(threads))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the first one decides

    def watch() -> None:
        try:
            theirs.recv_bytes()
        finally:
            os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def carry_out[T, R](
    crew: Crew, work: Callable[[T], R], pieces: Iterable[T]
) -> Iterator[tuple[int, R | WorkerDied]]:
    """Carries out pieces of work, each alone: see `carry_out_parcels`.

    Args:
        crew: carries them out.
        work: function of a piece, which can be pickled; what it raises ends the work.
        pieces: the pieces, which are taken as they are needed.
    """
    return carry_out_parcels(crew, partial(on_each, work), pieces)


def on_each[T, R](work: Callable[[T], R], pieces: Sequence[T]) -> list[R]:
    """Results of the work on each piece of a parcel."""
    return [work(piece) for piece in pieces]


def carry_out_parcels[T, R](
    crew: Crew, work: Callable[[Sequence[T]], Sequence[R]], pieces: Iterable[T], size: int = 0
) -> Iterator[tuple[int, R | WorkerDied]]:
    """Carries out pieces of work.

    What is yielded is done; if the generator is closed, what is not done is given up.

    Args:
        crew: carries them out.
        work: function of a parcel of pieces, which can be pickled; what it raises ends the work.
        pieces: the pieces, which are taken as they are needed.
        size: number of pieces in a parcel; 0: as many as its duration asks for.

    Yields:
        Number of the piece and its result, in the order in which they are done; an error as the
        result of a piece that kills its worker.

    Raises:
        NoWorkers: nothing carries out anything any more.
    """
    crew.begin()
    waiting = enumerate(pieces)
    doubtful: deque[tuple[int, T]] = deque()
    restarts: dict[int, int] = {}
    running: dict[Future[Any], list[tuple[int, T]]] = {}
    parcels = _Parcels(size)
    try:
        while True:
            if doubtful and not running:
                parcel = [doubtful.popleft()]
                running[_send(crew, work, parcel)] = parcel
            while not doubtful and len(running) < _AHEAD * crew.size:
                parcel = parcels.next(waiting)
                if not parcel:
                    break
                running[_send(crew, work, parcel)] = parcel
            if not running:
                return
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            is_alone, is_broken = len(running) == 1, False
            for future in finished:
                parcel = running.pop(future)
                try:
                    results, seconds = future.result()
                except ModuleNotFoundError as error:
                    raise NoWorkers(f"a worker cannot import {error.name}") from error
                except CancelledError as error:
                    raise NoWorkers("the executor has given up: its work was cancelled") from error
                except crew.losses as error:
                    is_broken |= isinstance(error, BrokenExecutor)
                    for number, piece in parcel:
                        restarts[number] = restarts.get(number, 0) + 1
                        if is_alone and len(parcel) == 1 and restarts[number] >= _MOST_LOST:
                            yield number, WorkerDied(_DIED)
                        else:
                            doubtful.append((number, piece))
                    continue
                parcels.learn(len(parcel), seconds)
                for (number, _), result in zip(parcel, results, strict=True):
                    yield number, result
            if is_broken:
                for parcel in running.values():  # a broken executor carries out none of them
                    doubtful.extend(parcel)
                running.clear()
                crew.renew()
    finally:
        for future in running:
            future.cancel()


_DIED = "the process that carried it out died (killed, out of memory, or a crash in a library)"


class _Parcels:
    """Parcels of pieces, as large as their duration asks for."""

    def __init__(self, size: int = 0):
        self._size, self._is_set = size or 1, bool(size)

    def learn(self, count: int, seconds: float) -> None:
        """Notes how long a parcel took [s]."""
        if self._is_set:
            return
        fitting = int(_PARCEL * count / max(seconds, 1e-9))
        # At most twice as many at a time: the first may be slower for what they import.
        self._size = max(1, min(fitting, 2 * self._size, _MOST_IN_PARCEL))

    def next[T](self, waiting: Iterator[tuple[int, T]]) -> list[tuple[int, T]]:
        """The next pieces; empty if there are none."""
        return list(itertools.islice(waiting, self._size))


def _send(
    crew: Crew, work: Callable[[Sequence[Any]], Any], parcel: Sequence[tuple[int, Any]]
) -> Future[Any]:
    try:
        return crew.executor.submit(partial(_carry_out, work), [piece for _, piece in parcel])
    except BrokenExecutor as error:  # it broke after the last look
        failed: Future[Any] = Future()
        failed.set_exception(error)
        return failed
    except RuntimeError as error:  # it has been shut down
        raise NoWorkers(f"the executor takes no more work: {error}") from error


def _carry_out(
    work: Callable[[Sequence[Any]], Sequence[Any]], pieces: Sequence[Any]
) -> tuple[Sequence[Any], float]:
    """In a worker: results of a parcel and the time that they took [s]."""
    started = time.perf_counter()
    results = work(pieces)
    return results, time.perf_counter() - started
