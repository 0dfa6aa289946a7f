"""Homing of one part of a real machine: its axes find their reference, which is then checked."""

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
from parapod.sims.lab.results import Metric
from parapod.sims.real_machine.job import DeviceWatch
from parapod.sims.real_machine.real_time import ended_by_signals, undisturbed
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.io import DeviceThread
from parapod.systems.hardware.position_memory import IncrementalDevice

# Axes stand while measurements are older [s], and the homing ends when they stay so for [s].
_OLDEST, _PATIENCE = 0.1, 1.0


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
        say: told what is going on, a line each time.

    Returns:
        What was measured, with bounds.

    Raises:
        ScenarioError: a part that there is not, or that has no homing, or whose devices are those
            of an emulator that does not run.
        HomingError: an axis does not find its end, or the emergency stop is pressed.
        DeviceError: a device is not there, is another one, or fails.
    """
    machine = machine.of(scenario)
    if part not in machine.homings:
        able = ", ".join(machine.homings) or "none"
        raise ScenarioError(f"part {quoted(part)} cannot be homed; those that can: {able}")
    homing = machine.homings[part]
    drivers: list[Driver] = scenario.hardware.drivers
    period = scenario.control.period
    parts = make_parts(drivers, machine.inputs, machine.measured, period)
    wanted = (part, *homing.parts)
    driver, thread = _incremental(parts, drivers, part)
    device = thread.device
    assert isinstance(device, IncrementalDevice)
    device.seek_reference()
    ends = np.array(homing.positions(driver))
    here = Parts({name: parts.threads[name] for name in wanted})
    hands = _Hands(homing, part, here, period)

    def say_news() -> None:
        for text in here.news():
            say(text)

    with ExitStack() as stack:
        stack.enter_context(time_of([d for d in drivers if d.part in wanted], machine.experiment))
        stack.enter_context(ended_by_signals())
        stack.enter_context(undisturbed())
        stack.callback(say_news)  # also of devices that are refused
        stack.enter_context(here.active())
        say_news()
        if homing.begin is not None:
            hands.carry_out(homing.begin(homing, driver, period, say))
        found = hands.carry_out(find_ends(homing, driver, part, period, say))
        _refer(thread, device, ends + hands.positions() - found.edge)
        checks: list[Check] = []
        if homing.checks is not None:
            say(f"ends found; {homing.checking}")
            checks = hands.carry_out(homing.checks(homing, driver, period))
        _stop(thread)
        spread = 1e3 * float(found.spread.max())
        if all(check.is_held for check in checks):
            device.remember(f"homed, again within {spread:.2f} mm")
            say(f"{device.name}: the file knows the {homing.measures}s from now on")
        else:
            say(f"{device.name}: the reference is refused, and the file knows nothing")
    return [_spread(found, homing), *(_metric(check) for check in checks)]


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
    """Sets the reference of axes that stand; nobody else speaks to the device meanwhile."""
    _stop(thread)
    device.set_reference(positions.tolist())
    thread.start()


def _stop(thread: DeviceThread) -> None:
    if (error := thread.stop()) is not None:
        raise error


class _Hands:
    """Leads the axes of a part once a period."""

    def __init__(self, homing: Homing, part: str, parts: Parts, period: float):
        """Takes the devices.

        Args:
            homing: names of the commands.
            part: part that is led.
            parts: it, and others that are measured.
            period: time between two measurements [s].
        """
        self._homing, self._part, self._parts, self._period = homing, part, parts, period
        self._watch = DeviceWatch(parts.all_threads)

    def carry_out[T](self, procedure: Procedure[T]) -> T:
        """Does what a procedure says until it is over; axes are commanded nothing then.

        Raises:
            HomingError: see the procedure; or measurements are old, or the emergency stop is
                pressed.
            DeviceError: a device fails.
        """
        try:
            commands, due = next(procedure), monotonic()
            while True:
                self._post(commands)
                due = max(due + self._period, monotonic())
                sleep(max(0.0, due - monotonic()))
                self._watch.check(monotonic())
                if self._age() > _OLDEST:
                    self._await_news()
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
            for thread in threads:
                measured = thread.sample.values.items()
                values |= {f"{part}.{name}": value for name, value in measured}
        if values.get(f"{self._part}.emergency_stop", (0.0,))[0] > 0.5:
            raise HomingError("the emergency stop is pressed")
        return values

    def _age(self) -> float:
        """Age of the oldest measurements [s]."""
        stamps = [t.sample.stamp for t in self._parts.all_threads if t.device.measures]
        return monotonic() - min(stamps)

    def _await_news(self) -> None:
        """Has the axes stand until there are new measurements."""
        deadline = monotonic() + _PATIENCE
        while self._age() > _OLDEST:
            if monotonic() > deadline:
                raise HomingError(f"{self._part}: no measurements for {_PATIENCE:g} s")
            self._watch.check(monotonic())
            self._post([0.0] * self._homing.size)
            sleep(self._period)

    def _post(self, commands: Sequence[float]) -> None:
        homing, now = self._homing, monotonic()
        for thread in self._parts.threads[self._part]:
            asked = {
                name: commands if name == homing.command else [homing.rest.get(name, 0.0)] * size
                for name, size in thread.device.commands.items()
            }
            if asked:
                thread.post(asked, now)


def _spread(found: Found, homing: Homing) -> Metric:
    return Metric(
        "largest_spread_mm",
        1e3 * float(found.spread.max()),
        "mm",
        1e3 * homing.spread,
        meaning=f"of {APPROACHES} approaches to an end",
    )


def _metric(check: Check) -> Metric:
    return Metric(check.key, check.value, check.unit, check.bound, meaning=check.meaning)
