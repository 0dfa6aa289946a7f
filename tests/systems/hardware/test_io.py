import math
import threading
import time

import pytest

from parapod.systems.hardware.clock import EmulatedClock, going_by, hold, monotonic, sleep
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.io import DeviceThread

COMMAND = {"velocity": (1.0, 2.0), "brake": (0.0,)}


@pytest.fixture
def running(fake):
    started = []

    def start(device=None, **options):
        thread = DeviceThread(device or fake(), **options)
        started.append(thread)
        thread.start()
        return thread

    yield start
    for thread in started:
        thread.stop()


def test_there_is_a_sample_once_the_thread_has_started(running):
    thread = running()
    assert thread.sample.fault is DeviceFault.NONE
    assert thread.sample.values["position"][0] >= 1.0


def test_the_device_is_activated_before_it_is_read_and_deactivated_at_the_end(running, fake):
    device = fake()
    thread = running(device)
    assert device.events == ["activate"]
    thread.stop()
    assert device.events == ["activate", "neutral"]
    readings = device.readings
    time.sleep(0.02)
    assert device.readings == readings


def test_readings_keep_to_the_period(running, judge):
    thread = running(period=0.005)
    began, before = time.monotonic(), thread.device.readings
    with judge() as judged:
        time.sleep(0.3)
    readings = thread.device.readings - before
    # Those that begin in that time, and one that had begun before.
    assert readings <= (time.monotonic() - began) / 0.005 + 2
    judged.check_at_least(readings, 0.5 * judged.took / 0.005)


def test_a_loop_that_takes_samples_gets_fresh_ones(running, fake, judge):
    device = fake()
    device.stall = 0.004  # what a reading takes
    thread = running(device, period=0.02)
    ages = []
    before, began = device.readings, time.monotonic()
    due = began
    with judge() as judged:
        for _ in range(80):
            due += 0.02
            time.sleep(max(0.0, due - time.monotonic()))
            ages.append(time.monotonic() - thread.sample.stamp)
            thread.taken()
    # Begun a little more than a reading's time before; one reading a period is enough.
    readings = device.readings - before
    judged.check_at_least((time.monotonic() - began) / 0.02 + 4, readings)
    median = sorted(ages[40:])[20]
    assert median >= 0.004
    judged.check_at_least(0.012, median)


def test_a_reading_that_is_late_is_not_put_off_by_the_next(running, fake, until, judge):
    device = fake()
    writes, written = device.write, threading.Event()

    def slow(signals):
        written.wait(20.0)
        writes(signals)

    device.write = slow
    thread = running(device, period=0.5)
    thread.taken()
    thread.post(COMMAND, time.monotonic())  # keeps the thread until its reading is late
    before = device.readings
    assert until(lambda: thread._due < time.monotonic())
    thread.taken()
    with judge() as judged:
        written.set()
        assert until(lambda: device.readings > before)
    judged.check(0.3)


def test_readings_begin_earlier_where_they_begin_late(fake):
    """By the time from when one was due to its end."""
    now = 0.0
    thread = DeviceThread(fake(), 0.01, clock=lambda: now)
    for k in range(200):
        now = 0.01 * k
        thread._read(due=now - 0.002)
    thread._due = now + 0.001
    thread.taken()
    assert thread._due == pytest.approx(now + 0.01 - 0.002 - 5e-4, abs=3e-4)


def test_values_are_newer_than_their_stamp_by_a_fifth_of_a_period_at_most(fake):
    """In an emulated time, which waits then: else legs would seem to jump."""
    thread = DeviceThread(fake(), 0.01, clock=lambda: 0.0)
    for took, allowed in ((1e-3, 1e-3), (6e-3, 2e-3), (1.0, 2e-3)):
        thread._due, thread._reading_time = 5e-3, took
        thread.taken()
        assert thread._allowed == pytest.approx(allowed)


def test_the_stamp_is_from_before_the_reading(running, fake, until):
    device = fake()
    device.stall = 0.03
    thread = running(device)
    shown = thread.sample
    assert until(lambda: thread.sample is not shown)
    assert time.monotonic() - thread.sample.stamp >= device.stall


def test_a_device_may_say_when_its_values_were_measured(running, fake):
    device = fake()
    device.stamp = monotonic() - 0.25
    thread = running(device)
    assert thread.sample.stamp == device.stamp


def test_a_command_is_written_at_once_and_once(running, until, judge):
    thread = running(period=10.0)  # nothing else wakes it up
    with judge() as judged:
        thread.post(COMMAND, time.monotonic())
        assert until(lambda: thread.device.written)
    judged.check(0.1)
    time.sleep(0.02)
    assert thread.device.written == [COMMAND]


def test_the_age_at_the_write_is_that_of_the_measurement(running, until):
    thread = running()
    for count, age in enumerate((0.05, 0.0), start=1):
        measured = time.monotonic() - age
        thread.post(COMMAND, measured)
        assert until(lambda count=count: len(thread.write_ages) == count)
        assert age <= thread.write_ages[-1] <= time.monotonic() - measured


def test_a_device_obeys_since_what_it_is_commanded_was_written_first(fake, failure):
    now, device = 1.0, fake()
    thread = DeviceThread(device, clock=lambda: now)

    def post(velocity):
        thread.post({"velocity": (velocity, 0.0), "brake": (0.0,)}, now)

    def written(at):
        nonlocal now
        now = at
        thread._write(thread._command)
        return thread.obeys_since

    assert thread.obeys_since == -math.inf
    post(1.0)
    assert thread.obeys_since == math.inf
    assert written(2.0) == 2.0
    post(1.0)  # the same again
    assert thread.obeys_since == written(3.0) == 2.0
    post(-1.0)
    assert thread.obeys_since == math.inf
    assert written(4.0) == 4.0
    thread._fall_silent()
    assert thread.obeys_since == math.inf
    post(-1.0)
    assert written(5.0) == 5.0
    post(2.0)
    device.error = failure
    assert written(6.0) == math.inf
    device.error = None
    assert written(7.0) == 7.0


def test_outputs_become_neutral_when_commands_cease(running, until, judge):
    thread = running(command_timeout=0.05)
    assert "neutral" not in thread.device.events  # nothing has been commanded yet
    with judge() as judged:
        thread.post(COMMAND, time.monotonic())
        assert until(lambda: "neutral" in thread.device.events)
    assert judged.took > 0.04
    assert until(lambda: thread.sample.fault is DeviceFault.NO_COMMAND)
    assert "neutral" in thread.sample.words
    time.sleep(0.1)
    assert thread.device.events.count("neutral") == 1

    def commanded():
        thread.post(COMMAND, time.monotonic())
        return thread.sample.fault is DeviceFault.NONE

    assert until(commanded)
    judged.check(0.15)


def test_a_failing_device_keeps_its_last_values_and_shows_its_words(running, failure, until):
    thread = running()
    thread.device.error = failure
    assert until(lambda: thread.sample.fault is DeviceFault.FAILED)
    assert "the fuse is blown" in thread.sample.words
    values, stamp = thread.sample.values, thread.sample.stamp
    time.sleep(0.02)
    assert thread.sample.values == values
    assert thread.sample.stamp == stamp
    thread.device.error = None
    assert until(lambda: thread.sample.fault is DeviceFault.NONE)
    assert thread.sample.stamp > stamp


def test_an_error_of_the_program_is_a_fault_and_does_not_end_the_thread(running, until):
    thread = running()
    thread.device.error = ZeroDivisionError("a mistake")
    assert until(lambda: thread.sample.fault is DeviceFault.FAILED)
    assert "ZeroDivisionError a mistake" in thread.sample.words
    thread.device.error = None
    assert until(lambda: thread.sample.fault is DeviceFault.NONE)


def test_commands_that_do_not_arrive_are_a_fault(running, failure, until):
    thread = running(period=10.0, command_timeout=60.0)
    thread.device.error = failure
    thread.post(COMMAND, time.monotonic())
    assert until(lambda: thread.sample.fault is DeviceFault.FAILED)
    assert thread.write_ages == []


@pytest.fixture
def burning(fake, failure):
    """A device that obeys once, and nothing any more."""

    class Burning(fake):
        def write(self, commands):
            super().write(commands)
            self.error = failure

    return Burning()


def test_a_device_that_cannot_be_neutral_says_so(running, burning, until):
    thread = running(burning, period=10.0, command_timeout=0.05)
    thread.post(COMMAND, time.monotonic())
    assert until(lambda: thread.sample.fault is DeviceFault.NO_COMMAND)
    assert "the fuse is blown" in thread.sample.words


def test_a_device_that_shows_nothing_is_refused_and_deactivated(fake):
    device = fake()
    device.stall = 1.0
    thread = DeviceThread(device)
    with pytest.raises(DeviceError, match=r"fake: no sample yet"):
        thread.start(timeout=0.05)
    assert device.events[-1] == "neutral"


def test_a_refusal_to_be_activated_is_raised(fake, failure):
    device = fake()
    device.error = failure
    with pytest.raises(DeviceError, match="the fuse is blown"):
        DeviceThread(device).start()


def test_a_stalled_bus_does_not_stall_who_posts_and_looks(running, fake, judge):
    device = fake()
    thread = running(device)
    device.stall = 0.3
    time.sleep(0.02)
    with judge() as judged:
        thread.post(COMMAND, time.monotonic())
        assert time.monotonic() - thread.sample.stamp > 0.0
    judged.check(0.05)


def test_a_thread_can_be_started_again(running, fake, until):
    thread = running(fake())
    thread.post(COMMAND, time.monotonic())
    assert until(lambda: thread.device.written)
    thread.stop()
    readings = thread.device.readings
    thread.start()
    assert until(lambda: thread.device.readings > readings)
    assert len(thread.device.written) == 1


def test_a_write_that_fails_half_way_is_made_neutral_all_the_same(running, fake, failure, until):
    class HalfWay(fake):
        def write(self, commands):
            self.written.append(commands)  # the first actuator moves
            raise failure

    thread = running(HalfWay(), period=10.0, command_timeout=0.05)
    thread.post(COMMAND, time.monotonic())
    assert until(lambda: thread.device.written)
    assert until(lambda: "neutral" in thread.device.events)
    assert until(lambda: thread.sample.fault is DeviceFault.NO_COMMAND)
    time.sleep(0.1)
    assert thread.device.events.count("neutral") == 1


# What is wrong


def test_a_device_that_is_well_has_no_error(running):
    thread = running()
    assert thread.error is None
    assert thread.sample.words == ""


def test_an_error_names_the_device_once(running, failure, until):
    thread = running()
    thread.device.error = failure
    assert until(lambda: thread.error is not None)
    error = thread.error
    assert (error.device, error.words, error.fault) == ("fake", "the fuse is blown", failure.fault)
    assert str(error) == "fake: the fuse is blown"
    assert thread.sample.words == "the fuse is blown"


def test_an_error_of_something_behind_the_device_names_both(running, until):
    thread = running()
    thread.device.error = DeviceError("fuse box", "door is open", DeviceFault.CORRUPT)
    assert until(lambda: thread.error is not None)
    assert str(thread.error) == "fake: fuse box: door is open"
    assert thread.error.fault is DeviceFault.CORRUPT


def test_a_device_that_is_neither_commanded_nor_neutral_is_named_once(running, burning, until):
    thread = running(burning, period=10.0, command_timeout=0.05)
    thread.post(COMMAND, time.monotonic())
    assert until(lambda: thread.error is not None)
    assert str(thread.error) == "fake: no command for 0.05 s, and the fuse is blown"


def test_a_thread_that_is_started_again_waits_for_a_new_sample(running, fake):
    thread = running(fake())
    thread.stop()
    thread.device.stall = 1.0
    with pytest.raises(DeviceError, match="no sample yet"):
        thread.start(timeout=0.05)


def test_commands_that_arrive_during_a_slow_write_are_no_silence(running, fake, judge):
    device = fake()
    write, faults = device.write, set()

    def slow(signals):
        time.sleep(0.15)
        write(signals)

    device.write = slow
    thread = running(device, command_timeout=0.1)
    end = time.monotonic() + 0.6
    with judge() as judged:
        while time.monotonic() < end:
            thread.post(COMMAND, time.monotonic())
            time.sleep(0.005)
            faults.add(thread.sample.fault)
    if DeviceFault.NO_COMMAND in faults and judged.late > 0.05:
        pytest.skip(f"the machine was late by {judged.late:.3f} s")
    assert faults == {DeviceFault.NONE}
    assert "neutral" not in device.events


def test_time_waits_for_the_writes_of_a_device_without_readings(fake, tmp_path, until):
    device, writing, may_end = fake(), threading.Event(), threading.Event()
    device.measures, device.read = {}, dict

    def write(commands):
        writing.set()
        assert may_end.wait(60.0)

    device.write = write
    with going_by(EmulatedClock(tmp_path / "clock", 1.0)):
        thread = DeviceThread(device, 0.01)
        thread.start()
        try:
            thread.post(COMMAND, monotonic())
            posted = monotonic()
            assert writing.wait(60.0)
            time.sleep(0.05)
            assert monotonic() <= posted + 0.005
            may_end.set()
            assert until(lambda: monotonic() > posted + 0.01, 60.0)
        finally:
            may_end.set()
            thread.stop()


@pytest.mark.parametrize("offset", [-2e-4, 0.0, 2e-4, 5e-3])
@pytest.mark.parametrize("is_late", [False, True])
def test_samples_are_fresh_for_a_loop_although_readings_take_longer_than_a_period(
    fake, tmp_path, offset, is_late
):
    device, period, ages, took = fake(), 0.01, [], []
    device.stall = 3.0 * period  # of the computer's clock
    stalled = device.read

    def read():
        begun, values = monotonic(), stalled()
        took.append(monotonic() - begun)
        return values

    device.read = read
    with going_by(EmulatedClock(tmp_path / "clock", 1.0)):
        thread = DeviceThread(device, period)
        thread.start()
        try:
            held = hold()
            held.until(monotonic())
            # Before, at or after the readings that no loop has asked for.
            due = thread.sample.stamp + offset
            due += period * math.ceil((monotonic() - due) / period)
            for k in range(25):
                due += period
                held.until(due + 0.1 * period)
                sleep(max(0.0, due - monotonic()))
                held.until(monotonic() + 0.1 * period)
                time.sleep(0.5 * period * (is_late and k % 2))  # such ticks keep to the schedule
                ages.append(monotonic() - thread.sample.stamp)
                thread.taken()
        finally:
            hold().until(math.inf)
            thread.stop()
    assert max(ages[15:]) < period
    # Values may be newer than their stamps by as much.
    assert max(took) < 0.25 * period


def test_what_a_device_sends_is_read_when_it_comes(running, fake, until):
    device = fake()
    device.is_asked = False
    thread = running(device, period=1e3)
    for readings in range(2, 5):
        thread.taken()
        thread._read_at = -math.inf  # long ago
        device.on_measured()
        until(lambda: device.readings == readings)  # noqa: B023 (before the next)
    until(lambda: thread.sample.values["position"] == (4.0, 4.0))


def test_what_a_device_sends_too_often_is_not_read_each_time(running, fake):
    device = fake()
    device.is_asked = False
    thread = running(device, period=1e3)
    for _ in range(100):
        device.on_measured()
    # The last of them is not lost.
    assert thread._due == pytest.approx(thread._read_at + 200.0)
    assert device.readings == 1


def test_a_device_that_has_ceased_to_send_is_found_out(running, fake, failure, until):
    device = fake()
    device.is_asked = False
    thread = running(device, period=0.01)
    device.error = failure
    until(lambda: thread.sample.fault)
