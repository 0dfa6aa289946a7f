"""Progress of long work: a bar in a terminal, a line from time to time elsewhere.

`PARAPOD_PROGRESS=off` leaves out lines and spinners, which depend on how long work takes, for who
compares what programs print.
"""

import io
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

# Wall-clock time between two redraws of a bar and between two lines in a file [s].
_REDRAW_PERIOD = 0.1
_LINE_PERIOD = 5.0
# Work of unknown length that is over sooner is not shown [s].
_PATIENCE = 0.5


@contextmanager
def progress(
    console: Console, what: str, total_seconds: float, line_period: float = _LINE_PERIOD
) -> Iterator[Callable[[float], None]]:
    """Show the progress of a simulation; yields the function that takes the simulated time.

    A terminal gets a bar. A file or pipe gets a line from time to time, and nothing at all from
    a run that is over before the first.

    Args:
        console: console to show it on.
        what: name of the work, in a word or two.
        total_seconds: simulated time at the end [s].
        line_period: wall-clock time between two lines in a file or pipe [s].
    """
    if console.is_terminal:
        with _bar(console, what, total_seconds) as update:
            yield update
    else:
        started, line = time.monotonic(), _lines(console, what, line_period)
        yield lambda simulated: line(lambda now: _pace(simulated, total_seconds, now - started))


@contextmanager
def _bar(console: Console, what: str, total: float) -> Iterator[Callable[[float], None]]:
    from rich.progress import BarColumn, Progress, TextColumn

    started = time.monotonic()
    reached = 0.0
    # Markup is off because `what` is any text.
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[pace]}", markup=False),
    )
    with Progress(*columns, console=console, auto_refresh=False) as bar:
        task = bar.add_task(what, total=total, pace="")
        ended = threading.Event()

        def draw() -> None:
            pace = _pace(reached, total, time.monotonic() - started)
            bar.update(task, completed=reached, pace=pace, refresh=True)

        def redraw() -> None:
            while not ended.wait(_REDRAW_PERIOD):
                draw()

        def update(simulated: float) -> None:
            nonlocal reached
            reached = simulated

        # A drawing takes milliseconds, which a loop in real time does not have.
        thread = threading.Thread(target=redraw, name="progress", daemon=True)
        thread.start()
        try:
            yield update
        finally:
            ended.set()
            thread.join()
            draw()


def _lines(console: Console, what: str, period: float) -> Callable[[Callable[[float], str]], None]:
    """Prints what is going on, and its state as a function of the time, when a line is due."""
    # The library's first line takes as long as a hundred others.
    Console(file=io.StringIO()).print("", markup=False, highlight=False, soft_wrap=True)
    printed = time.monotonic()

    def line(state: Callable[[float], str]) -> None:
        nonlocal printed
        now = time.monotonic()
        if now - printed >= period and not _is_off():
            printed = now
            text = f"{what}: {state(now)}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)

    return line


def _is_off() -> bool:
    return os.environ.get("PARAPOD_PROGRESS") == "off"


def _pace(simulated: float, total: float, elapsed: float) -> str:
    factor = simulated / elapsed if elapsed > 0.0 else 0.0
    return f"{simulated:.1f} of {total:.1f} s, {factor:.3g} x real time"


def _duration(seconds: float) -> str:
    """A duration as people say it."""
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{seconds / 3600.0:.3g} h"


@contextmanager
def counted(
    console: Console,
    what: str,
    total: int,
    begin: int = 0,
    line_period: float = _LINE_PERIOD,
) -> Iterator[Callable[[int], None]]:
    """Shows how much of a number of runs is done, how fast, and how long the rest will take.

    Args:
        console: console to show it on.
        what: name of the work, in a word or two.
        total: number of runs.
        begin: number of runs that had been done before.
        line_period: wall-clock time between two lines in a file or pipe [s].

    Yields:
        Function to call with the number of runs that are done.
    """
    started = time.monotonic()

    def state(count: int, now: float) -> str:
        if count <= begin:
            return f"{count} of {total}"
        rate = (count - begin) / max(now - started, 1e-9)
        return f"{count} of {total}, {rate:.3g}/s, {_duration((total - count) / rate)} left"

    if not console.is_terminal:
        line = _lines(console, what, line_period)
        yield lambda count: line(lambda now: state(count, now))
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[state]}", markup=False),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=total, completed=begin, state=state(begin, started))

        def update(count: int) -> None:
            bar.update(task, completed=count, state=state(count, time.monotonic()))

        yield update


@contextmanager
def waiting(
    console: Console, what: str, patience: float = _PATIENCE, line_period: float = _LINE_PERIOD
) -> Iterator[None]:
    """Show that work of unknown length goes on.

    A thread shows it, so that the work need not report anything. A terminal gets a spinner that
    is gone afterwards, a file or pipe a line from time to time.

    Args:
        console: console to show it on.
        what: name of the work, in a word or two.
        patience: wall-clock time before anything is shown on a terminal [s].
        line_period: wall-clock time between two lines in a file or pipe [s].
    """
    if console.quiet or _is_off():
        yield
        return
    ended = threading.Event()

    def spin() -> None:
        if ended.wait(patience):
            return
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}", markup=False)
        with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as spinner:
            spinner.add_task(what, total=None)
            ended.wait()

    def tell() -> None:
        started, line = time.monotonic(), _lines(console, what, line_period)
        while not ended.wait(line_period):
            line(lambda now: _duration(now - started))

    thread = threading.Thread(target=spin if console.is_terminal else tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
