"""What is said and watched in a run on the real machine."""

import io
import math
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.devices import Parts
from parapod.diagrams.guard import Trip, Tripped
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.ports import Behind, In
from parapod.diagrams.station import Station
from parapod.sims.real_machine.job import DeviceWatch, end_by_guard, show_timing
from parapod.sims.real_machine.privileges import Outcome
from parapod.sims.real_machine.real_time import Timing
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.io import DeviceThread, Sample
from parapod.systems.hardware.position_memory import IncrementalDevice


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


class Encoders(IncrementalDevice):
    """Encoders whose device remembers that they are distrusted."""

    name, measures, commands, position_signal = "encoders", {"position": 1}, {}, "position"
    _open = _energise = _release = is_referenced = _set_reference = close = None

    def __init__(self):
        self.is_distrusted = False

    def distrust(self):
        self.is_distrusted = True


@pytest.fixture
def guarded():
    """guarded(rate, brake, stop): encoders after a tick whose guard trips, at these commands."""
    inputs = (
        In("legs.rate", 2, "m/s", "rates"),
        In("legs.brake", 1, "-", "1: it brakes", idle=1.0),
        In("legs.stop", 1, "-", "1: the supply is cut"),
    )

    def tick(rate, brake, stop=0.0):
        values = {
            "legs.rate": np.array([0.0, rate]),
            "legs.brake": np.array([brake]),
            "legs.stop": np.array([stop]),
        }
        device, trip = Encoders(), Trip("legs_stale", "old", ("legs",))
        guard = SimpleNamespace(signals=frozenset(), check=lambda now, values: trip)
        parts = Parts({"legs": [DeviceThread(device)]})
        parts.threads["legs"][0]._sample = Sample({}, 0.0, DeviceFault.NONE, "")
        real = SimpleNamespace(guard=lambda scenario: guard)
        loop = SimpleNamespace(
            machine=SimpleNamespace(real=real, inputs=inputs, axes={}),
            station=SimpleNamespace(scenario=None, behind=Behind({}, {}, handle=parts)),
            readings=lambda root, names: {
                name: (lambda name=name: values[name]) for name in names
            },
        )
        # What is rehearsed is not judged.
        check = end_by_guard(loop, SimpleNamespace(Clone=lambda: None), guard)
        with pytest.raises(Tripped, match="legs_stale"):
            check(0.0)
        return device

    return tick


def test_a_job_that_ends_before_its_first_command_keeps_its_positions(guarded):
    for stop in (0.0, 1.0):  # as where nothing drives it, and as of a neutral part
        assert not guarded(0.0, 1.0, stop).is_distrusted


@pytest.mark.parametrize(("rate", "brake"), [(0.1, 1.0), (0.0, 0.0), (math.nan, 1.0)])
def test_a_job_that_has_commanded_something_trusts_no_positions_of_a_distrusted_part(
    guarded, rate, brake
):
    assert guarded(rate, brake).is_distrusted


class SlowThread(DeviceThread):
    """Measures anew when it has been looked at some times."""

    looks, first, fault = 0, 5, DeviceFault.NONE

    @property
    def sample(self):
        self.looks += 1
        stamp = -math.inf if self.looks < self.first else math.inf
        return Sample({}, stamp, self.fault, "the fuse is blown")


def test_a_loop_begins_with_measurements_that_were_begun_after_it_was_prepared():
    thread = SlowThread(Encoders())
    Parts({"legs": [thread]}).await_measurements(3600.0)
    assert thread.looks >= thread.first


def test_devices_with_a_fault_and_those_that_never_measure_keep_no_loop_waiting():
    broken, silent = SlowThread(Encoders()), SlowThread(Encoders())
    broken.fault, broken.first, silent.first = DeviceFault.SILENT, math.inf, math.inf
    Parts({"legs": [broken]}).await_measurements(3600.0)
    Parts({"legs": [silent]}).await_measurements(0.01)
    assert silent.looks < silent.first
