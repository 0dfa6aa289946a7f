"""Homing of one part of a real machine: its axes find their reference, which is then checked."""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.devices import Parts, make_parts
from parapod.diagrams.drivers.driver import Driver, time_of
from parapod.diagrams.homing import (
    APPROACHES,
    Check,
    Found,
    Homing,
    HomingError,
    Procedure,
    Values,
    find_ends,
)
from parapod.diagrams.machine import Machine
from parapod.sims.output.results import Metric
from parapod.sims.real_machine.job import DeviceWatch
from parapod.sims.real_machine.real_time import undisturbed
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.io import DeviceThread
from parapod.systems.hardware.position_memory import IncrementalDevice
from parapod.systems.hardware.signals import ended_by_signals

# Axes stand while measurements are older [s], and the homing ends when they stay so for [s].
_OLDEST, _PATIENCE = 0.1, 1.0
# Pause between two looks for a measurement that answers a command [s].
_LOOK = 1e-3


def home_part(
    machine: Machine[Any], scenario: Any, part: str, say: Callable[[str], None]
) -> list[Metric]:
    """Has the axes of a part find their reference, checks it, and has the file remember it.

    The file knows nothing from the beginning until every number is within its bound; then it says
    that the positions were found so. Whatever ends the homing, the outputs are neutral.

    Args:
        machine: the machine.
        scenario: one of its scenarios; its `hardware` and `control.period` are taken.
        part: part of the machine.
        say: called with what goes on, a line each time.

    Returns:
        What was measured, with bounds.

    Raises:
        ScenarioError: the part does not exist, has no homing, or has the devices of an emulator
            that does not run.
        HomingError: an axis does not find its end, or the emergency stop is pressed.
        DeviceError: a device is not there, is another one, or fails.
    """
    machine = machine.for_scenario(scenario)
    if part not in machine.real.homings:
        able = ", ".join(machine.real.homings) or "none"
        raise ScenarioError(f"part {quoted(part)} cannot be homed; those that can: {able}")
    homing = machine.real.homings[part]
    drivers = machine.drivers(scenario)
    period = scenario.control.period
    parts = make_parts(drivers, machine.inputs, machine.measured, period)
    parts_wanted = (part, *homing.parts)
    driver, thread = _incremental(parts, drivers, part)
    device = thread.device
    assert isinstance(device, IncrementalDevice)
    device.seek_reference()
    ends = np.array(homing.positions(driver))
    here = Parts({name: parts.threads[name] for name in parts_wanted})
    hands = _Hands(homing, part, here, period)

    def say_news() -> None:
        for text in here.news():
            say(text)

    with ExitStack() as stack:
        stack.enter_context(
            time_of([d for d in drivers if d.part in parts_wanted], machine.experiment)
        )
        stack.enter_context(ended_by_signals())
        stack.enter_context(undisturbed())
        stack.callback(say_news)  # also of devices that are refused
        stack.enter_context(here.active())
        say_news()
        checks: list[Check] = []
        metrics: list[Metric] = []
        if device.is_referenced:  # by its own homing
            how = "homed by the drives themselves"
        else:
            if homing.begin is not None:
                hands.carry_out(homing.begin(homing, driver, period, say))
            results = hands.carry_out(find_ends(homing, driver, part, period, say))
            _refer(thread, device, ends + hands.positions() - results.edge)
            how = f"homed, again within {1e3 * float(results.spread.max()):.2f} mm"
            metrics = [_spread(results, homing)]
        if homing.checks is not None:
            say(f"ends found; {homing.checking}")
            checks = hands.carry_out(homing.checks(homing, driver, period))
        _stop(thread)
        if all(check.is_held for check in checks):
            device.remember(how)
            say(f"{device.name}: the file knows the {homing.measures}s from now on")
        else:
            say(f"{device.name}: the reference is refused, and the file knows nothing")
    return [*metrics, *(_metric(check) for check in checks)]


def _incremental(
    parts: Parts, drivers: Sequence[Driver], part: str
) -> tuple[Driver, DeviceThread]:
    """Driver and thread of the device that measures what a reference is for."""
    of_part = [driver for driver in drivers if driver.part == part]
    for driver, thread in zip(of_part, parts.threads[part], strict=True):
        if isinstance(thread.device, IncrementalDevice):
            return driver, thread
    raise ScenarioError(f"no driver of part {quoted(part)} has encoders that need a reference")


def _refer(
    thread: DeviceThread, device: IncrementalDevice, positions: NDArray[np.float64]
) -> None:
    """Sets the reference of axes at rest; the device's thread is stopped meanwhile."""
    _stop(thread)
    device.set_reference(positions.tolist())
    thread.start()


def _stop(thread: DeviceThread) -> None:
    if (error := thread.stop()) is not None:
        raise error


class _Hands:
    """Leads the axes of a part once a period."""

    def __init__(
        self,
        homing: Homing,
        part: str,
        parts: Parts,
        period: float,
        clock: Callable[[], float] = monotonic,
        sleep: Callable[[float], None] = sleep,
    ):
        """Takes the devices.

        Args:
            homing: names of the commands.
            part: part that is led.
            parts: it, and others that are measured.
            period: shortest time between two measurements [s].
            clock: clock of the devices [s].
            sleep: waits for a time of that clock [s].
        """
        self._homing, self._part, self._parts, self._period = homing, part, parts, period
        self._clock, self._sleep = clock, sleep
        self._watch = DeviceWatch(parts.all_threads)
        # When axes were made to stand because measurements were old; and how long they have been.
        self._stands_since, self._stood = math.inf, 0.0

    def carry_out[T](self, procedure: Procedure[T]) -> T:
        """Does what a procedure says until it is over; axes are commanded nothing then.

        The procedure is sent measurements that were begun after its command had been written.

        Raises:
            HomingError: see the procedure; or measurements are old, or the emergency stop is
                pressed.
            DeviceError: a device fails.
        """
        try:
            commands, due = next(procedure), self._clock()
            while True:
                self._post(commands)
                due = max(due + self._period, self._clock())
                self._sleep(max(0.0, due - self._clock()))
                self._watch.check(self._clock())
                self._await_answer(commands)
                try:
                    commands = procedure.send(self.measured())
                except StopIteration as over:
                    result: T = over.value
                    return result
        finally:
            self._post([0.0] * self._homing.size)

    def positions(self) -> NDArray[np.float64]:
        """Positions (n) of the axes by now [m]."""
        return np.array(self.measured()[f"{self._part}.{self._homing.measures}"])

    def measured(self) -> Values:
        """The newest measurements, by the names of the ports.

        Raises:
            HomingError: the emergency stop is pressed.
        """
        values: dict[str, Sequence[float]] = {}
        for part, threads in self._parts.threads.items():
            samples = [thread.sample for thread in threads if thread.device.measures]
            for sample in samples:
                values |= {f"{part}.{name}": value for name, value in sample.values.items()}
            stamp = min((sample.stamp for sample in samples), default=math.nan)
            values[f"{part}.stamp"] = (min(stamp, self._stands_since) - self._stood,)
        if values.get(f"{self._part}.emergency_stop", (0.0,))[0] > 0.5:
            raise HomingError("the emergency stop is pressed")
        return values

    def _age(self) -> float:
        """Age of the oldest measurements [s]."""
        stamps = [t.sample.stamp for t in self._parts.all_threads if t.device.measures]
        return self._clock() - min(stamps)

    def _has_answer(self) -> bool:
        """Whether the part was measured after what it is commanded had been written."""
        threads = self._parts.threads[self._part]
        return all(t.sample.stamp >= self._obeys_since for t in threads if t.device.measures)

    @property
    def _obeys_since(self) -> float:
        """Time since which all devices of the part have what they are commanded [s]."""
        return max(thread.obeys_since for thread in self._parts.threads[self._part])

    def _await_answer(self, commands: Sequence[float]) -> None:
        """Waits for measurements that answer commands; the axes stand while any are old."""
        again, deadline, goes = self._clock(), self._clock() + _PATIENCE, True
        while (is_old := self._age() > _OLDEST) or not self._has_answer():
            now = self._clock()
            if now > deadline:
                raise HomingError(f"{self._part}: no measurements for {_PATIENCE:g} s")
            self._watch.check(now)
            if is_old and goes:
                self._note_going()
                self._stands_since = min(self._stands_since, now)
                commands, again, goes = [0.0] * self._homing.size, now, False
            if now >= again:  # a device that hears nothing stops by itself
                self._post(commands)
                again = now + self._period
            self._sleep(_LOOK)
        if goes:
            self._note_going()

    def _note_going(self) -> None:
        """Counts how long the axes were made to stand, if they go again."""
        if self._stands_since < math.inf and self._obeys_since < math.inf:
            self._stood += max(0.0, self._obeys_since - self._stands_since)
            self._stands_since = math.inf

    def _post(self, commands: Sequence[float]) -> None:
        homing, now = self._homing, self._clock()
        for thread in self._parts.threads[self._part]:
            posted = {
                name: commands if name == homing.command else [homing.rest.get(name, 0.0)] * size
                for name, size in thread.device.commands.items()
            }
            if posted:
                thread.post(posted, now)


def _spread(ends: Found, homing: Homing) -> Metric:
    return Metric(
        "largest_spread_mm",
        1e3 * float(ends.spread.max()),
        "mm",
        1e3 * homing.spread,
        meaning=f"largest spread of {APPROACHES} approaches to an end",
    )


def _metric(check: Check) -> Metric:
    return Metric(check.key, check.value, check.unit, check.bound, meaning=check.meaning)
