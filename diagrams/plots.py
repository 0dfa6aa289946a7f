"""Plots of signals: which elements of which share one, in the units that people read."""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from parapod.diagrams.style import COLOURS
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import did_you_mean, quoted
from parapod.systems.core.units import READ, units_of

_ASKED = re.compile(r"(?P<name>[^\[\]+]+)(?:\[(?P<first>\d+)(?::(?P<end>\d+))?\])?")
_NAMED = 20  # signals in a sentence
# Plots of a log for which nothing is declared.
_USUAL = 4

# Ends of the names of signals that are asked for, and words for the others by how they are known.
_ASKED_FOR = ("_desired", "_desired_state", "_command", "_asked", "_request", "_node")
ASKED, MEASURED, TRUE = "asked for", "measured", "true"
# The same colour for the same role in every plot.
ROLE_COLOURS = {ASKED: COLOURS[0], MEASURED: COLOURS[1], TRUE: COLOURS[2]}


def role_of(signal: str) -> str:
    """Role of a signal by its name: asked for, measured (or estimated), or true."""
    if signal.startswith("truth."):
        return TRUE
    return ASKED if signal.endswith(_ASKED_FOR) else MEASURED


def words_of(signal: str) -> str:
    """Name of a signal for people: "legs extension" of `legs.extension`, "true pose"."""
    words = signal.replace("truth.", "true ").replace(".", " ")
    return words.replace("_", " ")


# Smallest and largest admissible value by signal, for all elements or for each; None: none.
type Limits = Mapping[str, tuple[ArrayLike | None, ArrayLike | None]]


class NoSignal(ParapodError):
    """A signal, or an element of one, that is not there."""


@dataclass(frozen=True)
class Signals:
    """The signals that can be plotted.

    Attributes:
        owner: name of what has them, as sentences tell it.
        sizes: number of elements of each, by port name.
        units: units, by port name.
        name_of: name of an element for people, by the name of its port and its index; "" where
            there is none.
    """

    owner: str
    sizes: Mapping[str, int]
    units: Mapping[str, str]
    name_of: Callable[[str, int], str] = lambda signal, element: ""

    def unit(self, curve: "Curve") -> str:
        """Unit of a curve; that of the whole signal where its elements' are unknown."""
        unit = self.units[curve.signal]
        try:
            return units_of(unit, self.sizes[curve.signal])[curve.element]
        except ValueError:
            return unit


@dataclass(frozen=True)
class Curve:
    """One element of a signal.

    Attributes:
        signal: name of its port.
        element: its index.
        label: the name, with the index where there are several.
        name: name of the element for people; "" where there is none.
    """

    signal: str
    element: int
    label: str
    name: str = ""


@dataclass(frozen=True)
class Plot:
    """Curves of one unit.

    Attributes:
        curves: the curves.
        unit: unit in which they are drawn.
        factor: number in `unit` of one in the log's unit.
        limits: smallest and largest admissible values, in `unit`.
        limited: places among `curves` of those that each of the limits is of.
    """

    curves: tuple[Curve, ...]
    unit: str
    factor: float = 1.0
    limits: tuple[float, ...] = field(default=())
    limited: tuple[tuple[int, ...], ...] = field(default=())

    def place_of_limit(self, limit: float) -> int | None:
        """Place of the first curve that a limit is of; None: it is of all that have any."""
        places = self.limited[self.limits.index(limit)]
        return (
            None if len(places) == len({p for each in self.limited for p in each}) else places[0]
        )

    @property
    def quantity(self) -> str:
        """Label of the axis: what all curves are of, where it is the same, and the unit."""
        names = {curve.name for curve in self.curves}
        signals = {words_of(curve.signal) for curve in self.curves}
        of_all = names if len(names) == 1 and "" not in names else signals
        return f"{of_all.pop()} [{self.unit}]" if len(of_all) == 1 else f"[{self.unit}]"

    @property
    def legend(self) -> tuple[str, ...]:
        """Labels of the curves: their roles, or the names of the elements, or the ports'."""
        names = [curve.name for curve in self.curves]
        if "" not in names and len(names) > 1:
            if len(set(names)) == 1 and self._is_one_a_role:
                return self._roles
            if len({curve.signal for curve in self.curves}) == 1:
                return tuple(names)
            both = tuple(f"{name} {role}" for name, role in zip(names, self._roles, strict=True))
            if len(set(both)) == len(both):
                return both
        before = ("", *(curve.signal for curve in self.curves))
        return tuple(
            curve.label.removeprefix(last).replace(curve.signal, words_of(curve.signal))
            for curve, last in zip(self.curves, before, strict=False)
        )

    @property
    def colours(self) -> tuple[str, ...]:
        """Colours of the curves: of their roles where each has another one, else in turn."""
        if self._is_one_a_role:
            return tuple(ROLE_COLOURS[role] for role in self._roles)
        return tuple(COLOURS[place % len(COLOURS)] for place in range(len(self.curves)))

    @property
    def _roles(self) -> tuple[str, ...]:
        return tuple(role_of(curve.signal) for curve in self.curves)

    @property
    def _is_one_a_role(self) -> bool:
        """True if no two curves have the same role."""
        return len(set(self._roles)) == len(self.curves)

    def is_first(self, curve: Curve) -> bool:
        """Whether a curve is of the first of several signals."""
        first = self.curves[0].signal
        return curve.signal == first != self.curves[-1].signal


def choose(
    signals: Signals,
    names: Sequence[str],
    limits: Limits,
) -> list[Plot]:
    """The plots that were asked for.

    Args:
        signals: those that there are.
        names: `signal`, `signal[0]` or `signal[0:3]`, several joined by +; elements of different
            units become plots of their own.
        limits: smallest and largest admissible value of signals, in their unit, for all elements
            or for each.

    Raises:
        NoSignal: names those that there are, and one that is near.
    """
    plots = []
    for text in names:
        by_unit: dict[str, list[Curve]] = {}
        for each in text.split("+"):
            for curve in _curves(signals, each.strip()):
                unit = signals.unit(curve)
                by_unit.setdefault(unit, []).append(curve)
        plots += [_plot(tuple(curves), unit, limits) for unit, curves in by_unit.items()]
    return plots


def parse(name: str) -> tuple[str, range | None] | None:
    """Name and elements of `signal`, `signal[0]` or `signal[0:3]`; None elements: all of them.

    Args:
        name: the text.

    Returns:
        None where the text is nothing of the kind.
    """
    match = _ASKED.fullmatch(name.strip())
    if match is None:
        return None
    if match["first"] is None:
        return match["name"], None
    first = int(match["first"])
    return match["name"], range(first, int(match["end"]) if match["end"] else first + 1)


def usual(there: Collection[str], plots: Sequence[str], measured: Sequence[str] = ()) -> list[str]:
    """Plots by default: the usual ones, as far as they are there.

    Args:
        there: names of the signals that there are.
        plots: the usual ones, of a machine or of an experiment.
        measured: those that the experiment measures, for when none of the usual ones is there.
    """
    names = []
    for text in plots:
        parts = [each for each in text.split("+") if _name(each) in there]
        if parts:
            names.append("+".join(parts))
    if names:
        return names
    return ([name for name in measured if name in there] or [*there])[:_USUAL]


def limit_of(limit: ArrayLike, element: int) -> float:
    """Limit of one element, of a number for all of them or of one for each."""
    numbers = np.ravel(np.asarray(limit, dtype=float))
    return float(numbers[element] if numbers.size > 1 else numbers[0])


def _name(name: str) -> str:
    return name.partition("[")[0]


def _curves(signals: Signals, text: str) -> Iterator[Curve]:
    name, elements = parse(text) or (text, None)
    if name not in signals.sizes:
        hint, close_names = did_you_mean(name, signals.sizes), _named(name, signals.sizes)
        raise NoSignal(
            f"no signal {quoted(name)} in {signals.owner}{hint}; there are: {close_names}"
        )
    size = signals.sizes[name]
    elements = range(size) if elements is None else elements
    if not elements or elements[-1] >= size:
        last = f"elements 0 to {size - 1}" if size > 1 else "element 0 only"
        raise NoSignal(f"{quoted(name)} has {last}, not {quoted(text.removeprefix(name))}")
    for element in elements:
        label = f"{name}[{element}]" if size > 1 else name
        yield Curve(name, element, label, signals.name_of(name, element))


def _named(text: str, names: Collection[str]) -> str:
    """Names that there are, those of the same part first; of many the first."""
    part = text.partition(".")[0]
    by_part = sorted(names, key=lambda name: name.partition(".")[0] != part)
    more = len(by_part) - _NAMED
    return ", ".join(by_part[:_NAMED]) + (f" and {more} more" if more > 0 else "") or "none"


def _plot(
    curves: tuple[Curve, ...],
    unit: str,
    limits: Limits,
) -> Plot:
    unit_shown, factor = READ.get(unit, (unit or "-", 1.0))
    ends: dict[float, list[int]] = {}
    for place, curve in enumerate(curves):
        for each in limits.get(curve.signal, ()):
            if each is not None and math.isfinite(end := limit_of(each, curve.element)):
                ends.setdefault(factor * end, []).append(place)
    order = sorted(ends)
    return Plot(curves, unit_shown, factor, tuple(order), tuple(tuple(ends[end]) for end in order))
