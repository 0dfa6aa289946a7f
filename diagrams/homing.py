"""Search of axes with incremental encoders for their reference, step by step.

A search is a generator: it yields what the axes are commanded, and is sent what is measured, once
a period or later. It knows no clock and no device, so whatever has axes can be led by it: with the
measurements of each part comes `<part>.stamp`, the time at which they were begun, and those of the
part that is led were begun after what was yielded before had been written to its devices. That
time stands still while the leader of the axes pauses them.
"""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.errors import ParapodError

type Values = Mapping[str, Sequence[float]]
"""Signals of the machine by the names of their ports, and a `stamp` for each part."""
type Motion[T] = Generator[float, Values, T]
"""Search of one axis: yields its command."""
type Procedure[T] = Generator[Sequence[float], Values, T]
"""Search of all axes of a part: yields their commands."""
type Watch = Callable[[Values], None]
"""Called with what is measured, once a period."""
type Tell = Callable[[str], None]
"""Called with what is about to move, a line each time."""

# Number of slow approaches to an end.
APPROACHES = 3
# Way to get away from an end, from where its sign has gone [m].
_AWAY = 2e-3
# An axis must have gone this share of its way by then [s].
_SHARE, _GRACE = 0.3, 0.6
# An axis stands when it moves by less from one measurement to the next [m].
_STANDING = 1e-6
# Axes that are not commanded, and one that turns round, move by less than this [m].
_STILL = 0.5e-3
# A command has had its effect after so long [s].
_SETTLING = 0.3
# An end whose sign does not go away within this way is none [m].
_LONGEST_AWAY = 0.02

# Rate over distance [1/s], and the distance at which an axis has arrived [m].
_APPROACH, _ARRIVED = 4.0, 2e-4
# By how much an axis must come nearer [m] within a time [s].
_PROGRESS, _PATIENCE = 5e-5, 1.0


class HomingError(ParapodError):
    """An axis has not found its reference, or found an impossible one."""


def stamp_of(signal: str, values: Values) -> float:
    """Time at which a signal's part was measured [s]."""
    return float(values[f"{signal.partition('.')[0]}.stamp"][0])


class Stopwatch:
    """Time from one measurement of a part to the next: none where there is no new one."""

    def __init__(self, signal: str):
        """Begins with the first measurement that comes.

        Args:
            signal: any of the part.
        """
        self._signal, self._stamp = signal, math.nan

    def lap(self, values: Values) -> float:
        """Time since the measurement before [s]."""
        before, self._stamp = self._stamp, stamp_of(self._signal, values)
        lap_time = self._stamp - before
        return lap_time if lap_time > 0.0 else 0.0


class Sign(Protocol):
    """Tells from measurements that an axis is at its end; made anew for each motion."""

    def __call__(self, values: Values, command: float) -> bool:
        """Whether it is there, now that it has been commanded so."""


class BySwitch:
    """A switch is closed at the end."""

    def __init__(self, signal: str, index: int):
        """Names the switch.

        Args:
            signal: signal of the switches.
            index: index of the axis's own.
        """
        self._signal, self._index = signal, index

    def __call__(self, values: Values, command: float) -> bool:
        """See `Sign`."""
        return values[self._signal][self._index] > 0.5


class ByStandstill:
    """The axis stands although it is commanded, and its motor pushes with all that it may."""

    def __init__(
        self,
        index: int,
        velocity: str,
        current: str,
        pushing: float,
        lasting: float = 0.15,
        share: float = 0.1,
    ):
        """Says what standing means.

        Args:
            index: index of the axis.
            velocity: signal of the velocities [m/s].
            current: signal of the motors' currents [A].
            pushing: current above which a motor pushes [A].
            lasting: time for which it must stand [s].
            share: share of the commanded velocity below which it stands [-].
        """
        self._index, self._lasting = index, lasting
        self._velocity, self._current, self._pushing = velocity, current, pushing
        self._share, self._standing, self._watch = share, 0.0, Stopwatch(velocity)

    def __call__(self, values: Values, command: float) -> bool:
        """See `Sign`."""
        velocity, current = (values[name][self._index] for name in (self._velocity, self._current))
        stands = command != 0.0 and abs(velocity) < self._share * abs(command)
        pushes = abs(current) >= self._pushing and current * command > 0.0
        lap_time = self._watch.lap(values)
        self._standing = self._standing + lap_time if stands and pushes else 0.0
        return self._standing >= self._lasting


@dataclass(frozen=True)
class Check:
    """One number by which a reference is believed or not.

    Attributes:
        key: its name.
        value: the number, in `unit`.
        unit: its unit.
        bound: largest admissible |value|; None: printed only.
        meaning: meaning of the value, for people.
    """

    key: str
    value: float
    unit: str
    bound: float | None
    meaning: str

    @property
    def is_held(self) -> bool:
        """Whether it is finite and within its bound."""
        return bool(np.isfinite(self.value)) and (
            self.bound is None or abs(self.value) <= self.bound
        )


@dataclass(frozen=True)
class Found:
    """Places at which axes have found their ends.

    Attributes:
        edge: (n) positions at which the ends' signs come, as measured without reference [m].
        spread: (n) between the largest and the smallest of the approaches [m].
    """

    edge: NDArray[np.float64]
    spread: NDArray[np.float64]


@dataclass(frozen=True)
class Homing:
    """Search for references, as the axes of one part make it.

    Attributes:
        command: signal of the part that is commanded.
        measures: signal of the part that a reference is for.
        gain: rate of the measured signal by command; its sign says which commands extend.
        fast: command towards the end [unit of the command].
        slow: the same where the end is measured.
        longest: longest way to the end [m].
        sign: (driver, axis, period) -> what tells that the axis is at its end.
        positions: driver -> positions (n) of the ends [m].
        size: number of axes.
        others: signals that must not change while one axis moves, by which swapped wires show:
            names, and which of their elements.
        in_turn: true if one axis moves after the other, and not all at once.
        spread: largest difference between the approaches of an axis [m].
        begin: (homing, driver, period, tell) -> what is done before the search, without a
            reference; None: nothing.
        watch: period -> what takes all measurements of the search, and raises HomingError where
            the machine does what it must not meanwhile; None: nothing.
        checks: (homing, driver, period) -> what is done with axes that have a reference, to see
            whether it can be; returns numbers with bounds. None: nothing.
        parts: parts whose devices the checks need beside this one.
        rest: further commands of the part, for which it moves.
        prepare: condition before anything moves, in words.
        checking: motion during the checks, in words.
    """

    command: str
    measures: str
    gain: float
    fast: float
    slow: float
    longest: float
    sign: Callable[[Any, int, float], Sign]
    positions: Callable[[Any], Sequence[float]]
    size: int
    others: tuple[str, slice] | None = None
    in_turn: bool = True
    spread: float = 0.3e-3
    begin: Callable[["Homing", Any, float, Tell], Procedure[None]] | None = None
    watch: Callable[[float], Watch] | None = None
    checks: Callable[["Homing", Any, float], Procedure[list[Check]]] | None = None
    parts: tuple[str, ...] = ()
    rest: Mapping[str, float] = field(default_factory=dict)
    prepare: str = ""
    checking: str = ""


class _Way:
    """Way of an axis under one command, from the first measurement that answers it.

    What an axis that turns round does before that is the command's before.

    Attributes:
        here: newest position [m].
        before: the one before it [m].
        length: way since the first answer [m].
        elapsed: time since then [s].
        standing: time for which it has not moved by now [s].
    """

    def __init__(self, axis: "_Axis", values: Values):
        """Begins with what was measured before the command."""
        self._axis, self._watch = axis, Stopwatch(axis.signal)
        self.here = self.before = axis.at(values)
        self._begun: float | None = None
        self.length = self.elapsed = self.standing = 0.0

    def go(self, values: Values) -> None:
        """Takes a measurement that answers the command."""
        self.before, self.here = self.here, self._axis.at(values)
        lap_time = self._watch.lap(values)
        if self._begun is None:
            self._begun = self.here
        self.length, self.elapsed = self.here - self._begun, self.elapsed + lap_time
        moves = abs(self.here - self.before) >= _STANDING
        self.standing = 0.0 if moves else self.standing + lap_time


@dataclass
class _Axis:
    """One axis on its way, and its commands."""

    homing: Homing
    driver: Any
    index: int
    period: float
    signal: str

    @property
    def name(self) -> str:
        return f"{self.signal.partition('.')[0]} {self.index + 1}"

    def at(self, values: Values) -> float:
        return float(values[self.signal][self.index])

    def find(self) -> Motion[tuple[float, float]]:
        """Mean position of the end's sign, and the spread of the approaches."""
        homing, edges = self.homing, []
        values = yield 0.0
        if self._sign()(values, homing.fast):
            yield from self._leave()
        yield from self.approach(homing.fast, homing.longest)
        for _ in range(APPROACHES):
            yield from self._leave()
            edges.append((yield from self.approach(homing.slow, 4.0 * _LONGEST_AWAY)))
        yield from self._wait(_SETTLING)
        return float(np.mean(edges)), float(np.ptp(edges))

    def _sign(self) -> Sign:
        return self.homing.sign(self.driver, self.index, self.period)

    def approach(self, command: float, longest: float) -> Motion[float]:
        """Goes towards the end until its sign comes; the position, between two measurements."""
        sign, way = self._sign(), _Way(self, (yield 0.0))
        while True:
            values = yield command
            way.go(values)
            if sign(values, command):
                return 0.5 * (way.before + way.here)
            if abs(way.length) > longest:
                raise HomingError(
                    f"{self.name}: no end within {1e3 * longest:.0f} mm; is its switch connected?"
                )
            if way.standing > _GRACE:
                raise HomingError(
                    f"{self.name} stands, but its end has not shown: switch, encoder, drive or "
                    "supply"
                )
            self._check_way(way, command, sign)

    def _leave(self) -> Motion[None]:
        """Goes away from the end until its sign has gone, and a little further."""
        command = -self.homing.fast
        way, distance = _Way(self, (yield 0.0)), None
        while distance is None or abs(way.here - distance) < _AWAY:
            values = yield command
            way.go(values)
            self._check_way(way, command, None)
            if distance is None and not self._sign()(values, self.homing.fast):
                distance = way.here
            if distance is None and abs(way.length) > _LONGEST_AWAY:
                raise HomingError(
                    f"{self.name}: the sign of its end stays for {1e3 * abs(way.length):.0f} mm; "
                    "is its switch stuck?"
                )
        yield from self._wait(_SETTLING)

    def _check_way(self, way: _Way, command: float, sign: Sign | None) -> None:
        """Refuses an axis that does not go where it is commanded."""
        expected_way = self.homing.gain * command * way.elapsed
        if way.length * expected_way < 0.0 and abs(way.length) > _STILL:
            raise HomingError(
                f"{self.name} moves against its command: motor or encoder is swapped"
            )
        # One that waits for a standstill may stand.
        if isinstance(sign, ByStandstill) and way.elapsed > _GRACE:
            return
        if way.elapsed > _GRACE and abs(way.length) < _SHARE * abs(expected_way):
            raise HomingError(
                f"{self.name} has moved {1e3 * abs(way.length):.1f} mm and should have moved "
                f"{1e3 * abs(expected_way):.1f} mm: encoder, drive or supply"
            )

    def _wait(self, duration: float) -> Motion[None]:
        for _ in range(round(duration / self.period)):
            yield 0.0


def find_ends(
    homing: Homing, driver: Any, part: str, period: float, tell: Tell
) -> Procedure[Found]:
    """Search of all axes of a part.

    Args:
        homing: rule of the homing.
        driver: driver of the device that measures them; `sign` is made of it.
        part: part of the machine.
        period: time between two measurements [s].
        tell: called with the axes that are about to move.

    Raises:
        HomingError: an axis does not find its end, or measures the impossible.
    """
    axes = _axes(homing, driver, part, period)
    watch = _unwatched if homing.watch is None else homing.watch(period)
    positions = yield from _moved(homing, part, [axis.find for axis in axes], tell, watch)
    edge, spread = np.array(positions).T
    for axis, value in zip(axes, spread, strict=True):
        if value > homing.spread:
            raise HomingError(
                f"{axis.name}: its end was found at places {1e3 * value:.2f} mm apart, "
                f"{1e3 * homing.spread:g} mm are admissible"
            )
    return Found(edge, spread)


def find_far_ends(
    homing: Homing, driver: Any, part: str, period: float
) -> Procedure[NDArray[np.float64]]:
    """Positions (n) of the other ends of all strokes [m]; see `find_ends`.

    Raises:
        HomingError: an axis does not find its end, or measures the impossible.
    """
    axes = _axes(homing, driver, part, period)
    searches = [partial(axis.approach, -homing.fast, homing.longest) for axis in axes]
    return np.array((yield from _moved(homing, part, searches)))


def _axes(homing: Homing, driver: Any, part: str, period: float) -> list[_Axis]:
    signal = f"{part}.{homing.measures}"
    return [_Axis(homing, driver, i, period, signal) for i in range(homing.size)]


def _unwatched(values: Values) -> None:
    """Default watcher: none."""


def _unheard(line: str) -> None:
    """Default listener: discards what happens."""


def _moved[T](
    homing: Homing,
    part: str,
    motions: Sequence[Callable[[], Motion[T]]],
    tell: Tell = _unheard,
    watch: Watch = _unwatched,
) -> Procedure[list[T]]:
    """Motions of all axes, one after the other or at once, while those not moved must stand."""
    results: dict[int, T] = {}
    every = list(range(homing.size))
    for group in [[i] for i in every] if homing.in_turn else [every]:
        tell(f"{part} {_listed(group)}: to the end")
        going = {i: motions[i]() for i in group}
        requests = {i: next(motion) for i, motion in going.items()}
        first: Values | None = None
        while going:
            values = yield [requests.get(i, 0.0) for i in every]
            first = first or values
            watch(values)
            _check_others(homing, part, group, first, values)
            for i, motion in list(going.items()):
                try:
                    requests[i] = motion.send(values)
                except StopIteration as over:
                    results[i] = over.value
                    del going[i], requests[i]
    return [results[i] for i in every]


def _check_others(
    homing: Homing, part: str, moving: Sequence[int], first: Values, now: Values
) -> None:
    """Refuses axes that move, and switches that answer, although another one was commanded."""
    signal = f"{part}.{homing.measures}"
    still = [i for i in range(homing.size) if i not in moving]
    for i in still:
        way = now[signal][i] - first[signal][i]
        if not abs(way) < _STILL:
            raise HomingError(
                f"{part} {i + 1} has moved by {1e3 * way:.1f} mm while {part} "
                f"{_listed(moving)} was commanded: are they swapped?"
            )
    if homing.others is None:
        return
    name, which = homing.others
    for i in still:
        if now[name][which][i] != first[name][which][i]:
            raise HomingError(
                f"the switch of {part} {i + 1} has answered while {part} {_listed(moving)} was "
                "commanded: are they swapped?"
            )


def _listed(indices: Sequence[int]) -> str:
    return ", ".join(str(i + 1) for i in indices)


def lead(homing: Homing, signal: str, goal: Sequence[float]) -> Procedure[Values]:
    """Leads axes with a reference to positions, each for itself; returns the last measurements.

    Args:
        homing: gain is taken; commands are between its `slow` and its `fast`.
        signal: name of the measured port.
        goal: (n) positions [m].

    Raises:
        HomingError: an axis comes no nearer for a second.
    """
    values, watch = (yield [0.0] * homing.size), Stopwatch(signal)
    largest, nearest = abs(homing.fast), np.full(homing.size, np.inf)
    waited = np.zeros(homing.size)
    while True:
        way_left = np.asarray(goal, dtype=float) - np.asarray(values[signal])
        far = np.abs(way_left) >= _ARRIVED
        if not far.any():
            return (yield [0.0] * homing.size)
        nearer = ~far | (np.abs(way_left) < nearest - _PROGRESS)
        nearest = np.where(nearer, np.abs(way_left), nearest)
        waited = np.where(nearer, 0.0, waited + watch.lap(values))
        i = int(np.argmax(waited))
        if waited[i] > _PATIENCE:
            raise HomingError(
                f"{signal.partition('.')[0]} {i + 1} does not come nearer to where it is led, "
                f"{1e3 * abs(way_left[i]):.1f} mm away"
            )
        # Below its slow command friction may hold an axis.
        size = np.clip(_APPROACH * np.abs(way_left / homing.gain), abs(homing.slow), largest)
        values = yield np.where(far, np.copysign(size, way_left / homing.gain), 0.0).tolist()
