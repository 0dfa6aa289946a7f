"""What is said and watched in a run on the real machine."""

import io

import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.sims.real_machine import real_time
from parapod.sims.real_machine.job import DeviceWatch, show_timing
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


def test_a_loop_that_others_may_delay_is_said_to_be_one(monkeypatch):
    timing = timed(3, kept=3)
    timing.has_priority = False
    assert (
        said(timing)
        .replace("\n", " ")
        .endswith(
            "(median, 99 %, largest); without real-time priority, which is not permitted "
            "(rtprio in limits.conf) "
        )
    )
    monkeypatch.setattr(real_time, "take_priority", lambda: False)
    monkeypatch.setattr(real_time, "has_priority", lambda: False)
    with real_time.undisturbed() as has_priority:
        assert not has_priority


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
