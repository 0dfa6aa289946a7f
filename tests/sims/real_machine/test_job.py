"""What is said and watched in a run on the real machine."""

import io

import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.sims.real_machine.job import DeviceWatch, show_timing
from parapod.sims.real_machine.privileges import Outcome
from parapod.sims.real_machine.real_time import Timing
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.io import DeviceThread, Sample


def said(timing):
    stream = io.StringIO()
    station = Station(PLATFORM, LevellingScenario(backend="hardware"))
    show_timing(timing, station, Console(file=stream))
    return stream.getvalue()


def timed(ticks, kept):
    timing = Timing(0.01, kept)
    for k in range(1, ticks + 1):
        timing.add(1e-3 * k, 2e-3 * k)
    return timing


def test_how_punctual_a_loop_was_is_said_of_all_its_ticks():
    assert said(timed(3, kept=3)) == (
        "3 ticks of 10 ms, 0 missed; "
        "late 2.00, 2.98, 3.00, cost 4.00, 5.96, 6.00 ms (median, 99 %, largest)\n"
    )


def test_of_a_long_run_it_is_said_of_how_many_ticks_that_is():
    assert said(timed(5, kept=3)) == (
        "5 ticks of 10 ms, 0 missed; "
        "late 4.00, 4.98, 5.00, cost 8.00, 9.96, 10.00 ms (median, 99 %, largest of the last 3)\n"
    )


def test_privileges_that_were_refused_are_said():
    timing = timed(3, kept=3)
    reason = "EPERM; the limit rtprio is 0, 40 or more is needed"
    timing.refused = (Outcome("SCHED_FIFO", False, reason),)
    text = said(timing).replace("\n", " ")
    assert text.endswith(f"(median, 99 %, largest); SCHED_FIFO refused: {reason} ")


def test_pages_that_came_from_the_disk_are_said():
    timing = timed(3, kept=3)
    timing.disk_faults = 2
    assert said(timing).splitlines()[-1].startswith("2 pages of the program were read from the")


class BrokenThread(DeviceThread):
    """Shows that its device has a blown fuse."""

    @property
    def sample(self):
        return Sample({}, 0.0, DeviceFault.FAILED, "the fuse is blown")


def test_a_device_that_is_wrong_for_too_long_ends_the_run_and_is_named_once():
    station = Station(PLATFORM, LevellingScenario(backend="hardware"))
    device = station.behind.handle.all_threads[0].device
    watch = DeviceWatch([BrokenThread(device)], patience=0.2)
    watch.check(10.0)
    watch.check(10.2)
    with pytest.raises(DeviceError) as caught:
        watch.check(10.21)
    assert str(caught.value) == f"{device.name}: the fuse is blown"
    assert caught.value.fault is DeviceFault.FAILED
