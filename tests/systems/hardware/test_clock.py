import math
import subprocess
import sys
import threading
import time

import pytest

from parapod.systems.hardware import clock
from parapod.systems.hardware.clock import PATIENCE, EmulatedClock, following, going_by


class Computer:
    """The computer's clock, as the tests move it."""

    now = 1000.0

    def monotonic(self):
        return self.now


@pytest.fixture
def computer(monkeypatch):
    computer = Computer()
    monkeypatch.setattr(clock.time, "monotonic", computer.monotonic)
    monkeypatch.setattr(clock, "_lives", lambda process: True)
    return computer


@pytest.fixture
def path(tmp_path):
    return tmp_path / "clock"


def test_time_runs_at_its_rate_from_that_of_the_computer(path, computer):
    shown = EmulatedClock(path, 0.25)
    assert shown.now() == 1000.0
    computer.now += 8.0
    assert shown.now() == pytest.approx(1002.0)
    assert EmulatedClock(path).rate == 0.25
    assert EmulatedClock(path).now() == pytest.approx(1002.0)


def test_there_is_no_clock_to_follow_without_an_emulator_that_keeps_one(path):
    with pytest.raises(FileNotFoundError):
        EmulatedClock(path)
    with following(path) as shown:
        assert shown is None
        assert abs(clock.monotonic() - time.monotonic()) < 60.0


def test_time_stands_still_at_the_first_hold_and_what_was_waited_is_lost_and_counted(
    path, computer
):
    keeper, follower = EmulatedClock(path, 0.5), EmulatedClock(path)
    physics, tick = keeper.keeper(10.0), follower.hold(10.0)
    physics.until(1000.002)
    tick.until(1000.010)
    computer.now += 1.0
    assert keeper.now() == follower.now() == 1000.002
    physics.until(1000.1)  # half a second was on its way, .002 s of it came
    assert keeper.waited == pytest.approx((0.498, 0.0))
    computer.now += 0.004
    assert follower.now() == pytest.approx(1000.004)
    computer.now += 1.0
    assert keeper.now() == follower.now() == 1000.01
    tick.until(math.inf)
    assert keeper.now() == 1000.1
    physics.until(2000.0)
    assert follower.waited == pytest.approx((0.498 + 0.404, 0.0))


def test_time_that_waits_for_a_controller_is_counted_as_such(path, computer):
    shown = EmulatedClock(path, 1.0)
    physics, tick = shown.keeper(10.0), shown.hold(10.0)
    tick.until(1000.005)
    computer.now += 0.105
    physics.until(1001.0)
    assert shown.waited == pytest.approx((0.0, 0.1))


def test_nobody_is_waited_for_longer_than_their_patience(path, computer):
    shown = EmulatedClock(path, 1.0)
    shown.hold(2.0).until(1000.0)
    computer.now += 1.9
    assert shown.now() == 1000.0
    computer.now += 0.2
    assert shown.now() == pytest.approx(1002.1)


def test_time_does_not_go_back_when_an_earlier_hold_comes(path, computer):
    shown = EmulatedClock(path, 1.0)
    computer.now += 5.0
    assert shown.now() == 1005.0
    shown.hold(10.0).until(1001.0)
    assert shown.now() == 1005.0


def test_released_holds_are_those_of_controllers(path, computer):
    shown = EmulatedClock(path, 1.0)
    physics, tick = shown.keeper(10.0), shown.hold(10.0)
    physics.until(1003.0)
    tick.until(1001.0)
    computer.now += 5.0
    assert shown.now() == 1001.0
    shown.release()
    assert shown.now() == 1003.0


HOLD = """
import sys
from pathlib import Path
from parapod.systems.hardware.clock import EmulatedClock
shown = EmulatedClock(Path(sys.argv[1]))
shown.hold(3600.0).until(shown.now())
print("held", flush=True)
sys.stdin.read()
"""


def test_nobody_waits_for_a_process_that_was_killed(path):
    shown = EmulatedClock(path, 1.0)
    command = [sys.executable, "-c", HOLD, str(path)]
    with subprocess.Popen(command, stdin=-1, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        before = shown.now()
        time.sleep(0.1)
        assert shown.now() == before
        process.kill()
        while shown.now() == before:  # also while it is a zombie
            time.sleep(1e-3)


def test_a_thread_is_not_kept_from_waking_by_its_own_hold(path):
    shown = EmulatedClock(path, 1.0)
    with going_by(shown):
        own = clock.hold(3600.0)
        for _ in range(20):
            own.until(shown.now())
            before = clock.monotonic()
            clock.sleep(1e-3)
            assert clock.monotonic() - before >= 1e-3
            assert not clock.wait(threading.Event(), 1e-3)


def test_time_stands_still_for_work_but_not_for_its_sleep(path):
    shown = EmulatedClock(path, 1.0)
    with going_by(shown):
        with clock.standing_still():
            before = shown.now()
            time.sleep(0.05)
            assert shown.now() == before
            clock.sleep(0.02)
            assert before + 0.02 <= shown.now() <= before + 0.03
        while shown.now() < before + 0.05:
            time.sleep(1e-3)


def test_a_thread_has_one_hold_and_those_of_threads_that_have_ended_are_free_again(path):
    shown = EmulatedClock(path, 1.0)
    with going_by(shown):
        own = clock.hold()
        assert clock.hold() is own
        own.until(at := shown.now())
        for _ in range(40):
            thread = threading.Thread(target=lambda: clock.hold().until(math.inf))
            thread.start()
            thread.join()
        time.sleep(0.01)
        assert shown.now() == at
        own.until(math.inf)


def test_a_wait_ends_with_its_event_while_time_stands_still(path):
    shown, event = EmulatedClock(path, 1.0), threading.Event()
    shown.hold(3600.0).until(shown.now())
    with going_by(shown):
        threading.Timer(0.05, event.set).start()
        assert clock.wait(event, 100.0)


def test_answers_have_more_time_from_emulated_devices(path, computer):
    assert clock.answer_time(0.1) == 0.1
    with going_by(EmulatedClock(path, 0.5)):
        assert clock.answer_time(0.1) >= 0.2
        assert clock.computer_time(0.1) == pytest.approx(0.2)
    assert clock.computer_time(0.1) == 0.1


def test_devices_that_are_well_may_take_nearly_as_long_as_anything_is_waited_for(path, computer):
    keeper, follower = EmulatedClock(path, 1.0), EmulatedClock(path)
    with going_by(follower):
        assert 0.5 * PATIENCE < clock.answer_time(0.05) < PATIENCE
        assert clock.search_time(0.05) < 0.1 * PATIENCE  # there may be no device at all
        keeper.is_well = False
        assert clock.answer_time(0.05) == clock.search_time(0.05)
        keeper.is_well = True
        assert clock.answer_time(0.05) > 0.5 * PATIENCE
        assert clock.answer_time(20.0) >= 20.0
    keeper.is_well = False
    assert clock.answer_time(0.05) == 0.05


def test_an_answer_that_stays_away_takes_as_long_for_devices_as_theirs_would(path):
    keeper, shown = EmulatedClock(path, 1.0), EmulatedClock(path)
    keeper.is_well = False
    with going_by(shown):
        before = shown.now()
        with clock.awaiting_answer(0.02) as longest:
            time.sleep(longest)
            assert before + 0.01 < shown.now() < before + 0.03  # and no further
        with clock.standing_still():
            before = shown.now()
            with clock.awaiting_answer(0.02) as longest:
                time.sleep(0.5 * longest)  # one that comes takes no time
            assert shown.now() == before
            with clock.awaiting_answer(0.02) as longest:
                time.sleep(longest)
            assert before + 0.02 <= shown.now() < before + 0.03
    with clock.awaiting_answer(0.02) as longest:
        assert longest == 0.02


def test_a_thread_wakes_also_where_its_hold_is_set_while_it_sleeps(path):
    shown = EmulatedClock(path, 1.0)
    with going_by(shown):
        own = clock.hold()
        began, setting = time.monotonic(), threading.Timer(0.02, own.until, (shown.now(),))
        setting.start()
        clock.sleep(0.1)
        setting.join()
        own.until(math.inf)
    assert time.monotonic() - began < 0.5 * PATIENCE


def test_logs_have_the_emulated_time_as_calendars_have_it(path, computer):
    with going_by(EmulatedClock(path, 0.5)):
        before = clock.calendar_time_ns()
        computer.now += 10.0
        assert clock.calendar_time_ns() - before == pytest.approx(5e9, abs=1e3)
