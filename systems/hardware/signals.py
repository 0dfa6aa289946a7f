"""Signals that end this program: when they are heard, and what they may not cut short."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType, TracebackType
from typing import Any

from parapod.systems.hardware.clock import monotonic

# A program that has not asked for signals for so long does not ask any more [s].
_HOPELESS = 0.1
# An end that takes so long does not come [s].
_HANGING = 10.0
_PARENT_PERIOD = 0.2  # between two looks at the program that began this one [s]

_Handler = Callable[[int, FrameType | None], Any]


@contextmanager
def signals_between_ticks() -> Iterator[Callable[[], None]]:
    """Keeps signals that interrupt this program for the moments when it asks for them.

    A handler raises wherever the program happens to be. In the middle of a conversion from Python
    to C++ its exception is taken for an argument of the wrong type, or is lost. A second signal,
    and one that is not asked for within 0.1 s, interrupt at once.

    Yields the question: it raises if a signal has come.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    numbers: list[int] = []
    asked_at = monotonic()

    def note(number: int, frame: FrameType | None) -> None:
        if numbers or monotonic() - asked_at > _HOPELESS:
            handlers[number](number, frame)
        numbers.append(number)

    def ask() -> None:
        nonlocal asked_at
        asked_at = monotonic()
        if numbers:
            handlers[numbers[0]](numbers[0], None)

    handlers = _replaced(note)
    try:
        yield ask
    finally:
        _restore(handlers)
    ask()


class UninterruptedExit(ExitStack[bool | None]):
    """A stack that no signal cuts short while it unwinds, as what makes a machine neutral.

    Somebody who presses Ctrl-C twice would otherwise leave devices out. A signal that comes
    meanwhile interrupts once all has been done, unless something else has ended the work: that is
    what the user reads. One that comes more than 10 s after the beginning interrupts at once.
    """

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool | None:
        """Unwinds."""
        if threading.current_thread() is not threading.main_thread():
            return super().__exit__(kind, error, traceback)
        numbers: list[int] = []
        began = time.monotonic()

        def note(number: int, frame: FrameType | None) -> None:
            numbers.append(number)
            if time.monotonic() - began > _HANGING:
                handlers[number](number, frame)

        handlers = _replaced(note)
        try:
            is_swallowed = super().__exit__(kind, error, traceback)
        finally:
            _restore(handlers)
        if numbers and error is None:
            handlers[numbers[0]](numbers[0], None)
        return is_swallowed


@contextmanager
def ended_with_parent(parent: int) -> Iterator[None]:
    """Ends this program, as SIGTERM does, once the program that began it has ended.

    A shell or a test that is killed sends no signal to its children, and a loop in real time would
    run for ever.

    Args:
        parent: process that began this one, by `os.getppid` at the beginning.
    """
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_PARENT_PERIOD):
            if os.getppid() != parent:
                os.kill(os.getpid(), signal.SIGTERM)
                return

    thread = threading.Thread(target=watch, name="parent", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Makes the signals that end programs end this one as Ctrl-C does: through every `finally`.

    One that is ignored stays so: under `nohup` a program outlives its terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    handled = [number for number in _endings() if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, interrupt) for number in handled}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _replaced(by: _Handler) -> dict[int, _Handler]:
    """Handlers of the signals that end programs and are not ignored; `by` takes their place."""
    handlers: dict[int, _Handler] = {}
    for number in (signal.SIGINT, *_endings()):
        handler = signal.getsignal(number)
        if callable(handler):
            handlers[number] = handler
            signal.signal(number, by)
    return handlers


def _restore(handlers: dict[int, _Handler]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _endings() -> list[int]:
    """Signals, beside Ctrl-C's, that end programs."""
    return [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
