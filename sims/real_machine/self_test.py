"""Self-test of the devices of one part of a machine: what they show, and one move of each."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.devices import make_parts
from parapod.diagrams.drivers.driver import time_of
from parapod.diagrams.machine import Machine
from parapod.diagrams.real import SelfTest
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.device import NotFitted
from parapod.systems.hardware.io import DeviceThread
from parapod.systems.hardware.signals import UninterruptedExit, ended_by_signals

_STEP = 0.01  # [s]
# A command grows and fades for so long [s].
_RAMP = 0.2
# The turning point itself comes so much later than that of the command.
_LAG = 0.1
# After it, so long is looked whether everything stands still [s].
_REST = 0.3
# Others must not move by more than this share of what the tested one moves [-].
_CROSSTALK = 0.05
_SCALE_ERROR = 30.0  # [%]
_GRAVITY_ERROR = 2.0  # [%]
_RATE_AT_REST = 1.0  # [deg/s]
_SWITCH = "0/1"  # unit of what is open or closed


@dataclass(frozen=True)
class Move:
    """A small motion of one actuator, there and back.

    Attributes:
        index: index of the actuator, counted from 0.
        command: while it moves, in the unit of the part's command; None: the usual one.
        duration: in each direction [s].
    """

    index: int
    command: float | None
    duration: float


def check_part(
    machine: Machine[Any],
    scenario: Any,
    part: str,
    move: Move | None,
    seconds: float,
    say: Callable[[str], None],
    may_move: Callable[[], bool] = lambda: True,
) -> list[Metric]:
    """Tests the devices of one part; those of others are left alone.

    Without `move` nothing gets power: the devices are configured, which refuses wrong ones, and
    read. With it one actuator moves there and back, and sign, scale and the others' rest are
    checked.

    Args:
        machine: the machine.
        scenario: one of its scenarios; its `hardware` is taken.
        part: part of the machine.
        move: part to move, or None.
        seconds: duration of the reading [s].
        say: called with what goes on, a line each time.
        may_move: asked before devices are opened, once it is clear that `move` can be made.

    Returns:
        What was measured, with bounds; nothing if it may not move, or measures nothing.

    Raises:
        ScenarioError: a part does not exist, is not fitted, cannot be moved so, or has the
            devices of an emulator that does not run.
        DeviceError: a device is not there, is another one, or fails.
    """
    machine = machine.for_scenario(scenario)
    drivers = machine.drivers(scenario)
    parts = make_parts(drivers, machine.inputs, machine.measured, scenario.control.period)
    if part not in parts.threads:
        raise ScenarioError(f"part {quoted(part)} is not one of {', '.join(parts.threads)}")
    fitted = [
        name
        for name, each in parts.threads.items()
        if not all(isinstance(thread.device, NotFitted) for thread in each)
    ]
    if part not in fitted:
        raise ScenarioError(
            f"part {quoted(part)} is not fitted, so that there is nothing to check; fitted: "
            f"{', '.join(fitted) or 'none'}"
        )
    threads = parts.threads[part]
    checked = None if move is None else _checked(machine, part, move, threads)
    metrics: list[Metric] = []
    # A device calls the signals of other parts by their whole names.
    units = {name.removeprefix(f"{part}."): spec.unit for name, spec in machine.table.items()}

    def say_news() -> None:
        for text in parts.news():
            say(text)

    with ended_by_signals(), UninterruptedExit() as stack:
        stack.enter_context(time_of([d for d in drivers if d.part == part], machine.experiment))
        if checked is not None and not may_move():
            return []
        stack.callback(say_news)  # also of devices that are refused
        for thread in threads:
            stack.enter_context(thread.device)
            power = "; its outputs have no power" if thread.device.commands else ""
            say(f"{thread.device.name}: configured{power}")
        say_news()
        for thread in threads:
            if thread.device.measures:
                metrics += _read(thread, units, seconds, say)
        if checked is not None:
            metrics += _move(part, threads, checked, stack, say)
    say("outputs are neutral and without power")
    return metrics


@dataclass(frozen=True)
class _CheckedMove:
    """A move that may be made, and of what."""

    motion: SelfTest
    index: int
    command: float
    duration: float
    unit: str
    measured_unit: str


def _checked(
    machine: Machine[Any], part: str, move: Move, threads: Sequence[DeviceThread]
) -> _CheckedMove:
    if part not in machine.real.self_tests:
        able = ", ".join(machine.real.self_tests)
        raise ScenarioError(f"part {quoted(part)} cannot be moved; {able} can")
    motion = machine.real.self_tests[part]
    command = motion.usual if move.command is None else move.command
    sizes = [
        t.device.commands[motion.command] for t in threads if motion.command in t.device.commands
    ]
    size = max(sizes, default=0)
    if not 0 <= move.index < size:
        raise ScenarioError(f"{part} have numbers 1..{size}, not {move.index + 1}")
    unit = machine.unit(f"{part}.{motion.command}") + ("/s" if motion.is_position else "")
    if not 0.0 < abs(command) <= motion.largest:
        raise ScenarioError(
            f"a self-test moves {part} with up to {motion.largest:g} {unit}, "
            f"not {command:g} {unit}"
        )
    if not 2.0 * _RAMP <= move.duration <= 5.0:
        raise ScenarioError(f"a motion takes {2.0 * _RAMP:g}..5 s, not {move.duration:g} s")
    measured_unit = machine.unit(f"{part}.{motion.measures}")
    return _CheckedMove(motion, move.index, command, move.duration, unit, measured_unit)


def _read(
    thread: DeviceThread, units: Mapping[str, str], seconds: float, say: Callable[[str], None]
) -> list[Metric]:
    """Reads a device at the loop's rate; says what it shows, and at once when a switch changes."""
    rows: dict[str, list[Sequence[float]]] = {name: [] for name in thread.device.measures}
    readings: dict[str, list[float]] = {}
    costs = []
    end = monotonic() + seconds
    while monotonic() < end:
        began = monotonic()
        for name, values in thread.device.read().items():
            rows[name].append(values)
            if units.get(name) == _SWITCH and readings.get(name) != [*values]:
                readings[name] = [*values]
                say(f"{name}: {' '.join(f'{value:g}' for value in values)}")
        costs.append(monotonic() - began)
        sleep(max(0.0, began + _STEP - monotonic()))
    for name, samples in rows.items():
        if name in readings:
            continue
        unit = f" [{units[name]}]" if name in units else ""
        mean, spread = np.mean(samples, axis=0), np.ptp(samples, axis=0)
        each = ", ".join(f"{m:.6g}" for m in mean)
        say(f"{name}{unit}: {each} (spread {np.max(spread):.3g})")
    metrics = [
        Metric(
            "read_median_ms",
            1e3 * float(np.median(costs)),
            "ms",
            1e3 * _STEP,
            meaning=f"median time of one reading of {thread.device.name}",
        )
    ]
    if "accel" in rows:
        metrics += _at_rest(np.array(rows["accel"]), np.array(rows["gyro"]))
    return metrics


def _at_rest(accel: NDArray[np.float64], gyro: NDArray[np.float64]) -> list[Metric]:
    """Check the values of an inertial sensor that does not move."""
    size = float(np.linalg.norm(accel.mean(axis=0)))
    error = 100.0 * abs(size / STANDARD_GRAVITY - 1.0)
    rate = float(np.degrees(np.abs(gyro.mean(axis=0)).max()))
    up = float(accel[:, 2].mean())
    return [
        Metric(
            "gravity_error_percent",
            error,
            "%",
            _GRAVITY_ERROR,
            meaning="error of the specific force",
        ),
        Metric(
            "gyro_at_rest_deg_s",
            rate,
            "deg/s",
            _RATE_AT_REST,
            meaning="largest mean turn rate at rest",
        ),
        Metric(
            "upside_down", float(up <= 0.0), bound=0.0, meaning="1 if the z axis does not point up"
        ),
    ]


def _profile(move: _CheckedMove) -> Iterator[float]:
    """Commands of a motion, there and back and at rest, each for one step."""
    for sign in (1.0, -1.0):
        for k in range(round(move.duration / _STEP)):
            t = k * _STEP
            share = min(1.0, t / _RAMP, (move.duration - t) / _RAMP)
            yield sign * share * move.command
    for _ in range(round(_REST / _STEP)):
        yield 0.0


def _move(
    part: str,
    threads: Sequence[DeviceThread],
    move: _CheckedMove,
    stack: ExitStack,
    say: Callable[[str], None],
) -> list[Metric]:
    motion = move.motion
    for thread in threads:
        stack.callback(thread.stop)
        thread.start()
    say(f"{part} {move.index + 1}: {move.command:g} {move.unit} for {move.duration:g} s and back")
    reader = next(t for t in threads if motion.measures in t.device.measures)
    commanded, measured = [0.0], [np.array(reader.sample.values[motion.measures])]
    due = monotonic()
    for command in _profile(move):
        ahead = commanded[-1] + command * _STEP
        _post(threads, motion, move.index, ahead if motion.is_position else command, measured[0])
        due += _STEP
        sleep(max(0.0, due - monotonic()))
        if (error := reader.error) is not None:
            raise error
        commanded.append(commanded[-1] + command * _STEP)
        measured.append(np.array(reader.sample.values[motion.measures]))
    way = np.array(measured) - measured[0]
    turn = int(np.argmax(np.abs(commanded)))
    displacement, expected = way[:, move.index], motion.gain * commanded[turn]
    # The way back does not count: an axis at its end makes only that.
    there = displacement[: turn + round(_LAG / _STEP)]
    reached = float(there[np.argmax(np.abs(there))])
    others = np.delete(np.abs(way).max(axis=0), move.index)
    unit = move.measured_unit
    return [
        Metric("reached", reached, unit, meaning=f"measured way, {expected:.3g} {unit} expected"),
        Metric(
            "wrong_sign",
            float(reached * expected <= 0.0),
            bound=0.0,
            meaning="1 if the axis moves against the command, or rests (at its end?)",
        ),
        Metric(
            "scale_error_percent",
            100.0 * abs(abs(reached / expected) - 1.0),
            "%",
            _SCALE_ERROR,
            meaning="error of the measured way",
        ),
        Metric(
            "others_moved_percent",
            100.0 * float(others.max(initial=0.0)) / max(abs(reached), 1e-9),
            "%",
            100.0 * _CROSSTALK,
            meaning="largest way of another axis",
        ),
    ]


def _post(
    threads: Sequence[DeviceThread],
    motion: SelfTest,
    index: int,
    command: float,
    start: NDArray[np.float64],
) -> None:
    """Commands one axis, and the others to rest: by a rate, or by the way from where it was."""
    now = monotonic()
    for thread in threads:
        commands = {}
        for name, size in thread.device.commands.items():
            values = [motion.rest.get(name, 0.0)] * size
            if name == motion.command and motion.is_position:
                values = start.tolist()
            if name == motion.command:
                values[index] += command
            commands[name] = values
        if commands:
            thread.post(commands, now)
