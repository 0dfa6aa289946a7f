import os
import signal
import time

import pytest

from parapod.systems.hardware import signals
from parapod.systems.hardware.signals import UninterruptedExit, ended_by_signals


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_signals_that_end_programs_pass_through_finally(name):
    number = getattr(signal, name)
    before, ended = signal.signal(number, signal.SIG_DFL), []  # also under nohup

    def killed():
        try:
            os.kill(os.getpid(), number)
            time.sleep(1.0)
        finally:
            ended.append(True)

    try:
        with ended_by_signals(), pytest.raises(KeyboardInterrupt, match=name):
            killed()
        assert ended
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)


def test_a_signal_that_is_ignored_under_nohup_ends_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_signals():
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, also where the tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def unwound(kind, number, error=None):
    """Steps done by an end that a signal meets at each of them, and the error that comes of it."""
    done = []

    def step(k):
        os.kill(os.getpid(), number)
        for _ in range(100):
            pass  # where the interpreter looks for signals
        done.append(k)

    def work():
        with kind() as stack:
            for k in range(3):
                stack.callback(step, k)
            if error is not None:
                raise error

    with ended_by_signals(), pytest.raises(BaseException) as caught:  # noqa: PT011
        work()
    return done, caught.value


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_leave_out_no_step_of_an_end(number):
    done, error = unwound(UninterruptedExit, number)
    assert done == [2, 1, 0]
    assert isinstance(error, KeyboardInterrupt)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_has_ended_the_work_is_told_whatever_is_signalled_meanwhile():
    why = ValueError("why")
    assert unwound(UninterruptedExit, signal.SIGTERM, why) == ([2, 1, 0], why)


def test_an_end_that_hangs_can_be_interrupted(monkeypatch):
    monkeypatch.setattr(signals, "_HANGING", -1.0)
    done, error = unwound(UninterruptedExit, signal.SIGTERM)
    assert done == []
    assert isinstance(error, KeyboardInterrupt)
