"""Parts of a chapter of the report: a machine, its paper, and what is said of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Result, amount

# An error that is at most this share of the printed one is called better.
_BETTER = 0.5
# Relative difference up to which numbers are called the same.
_ROUNDED = 1e-6


@dataclass(frozen=True)
class Numbers:
    """Metrics of the experiments of a chapter.

    Attributes:
        results: results by the name of the chapter's part.
        seeds: results of further seeds by the name of the part; may lack a part.
    """

    results: Mapping[str, Result]
    seeds: Mapping[str, Sequence[Result]] = field(default_factory=dict)

    def __call__(self, part: str, key: str) -> float:
        """A metric's value; NaN if its part has not been run."""
        return _value(self.results[part], key) if part in self.results else math.nan

    def spread(self, part: str, key: str) -> tuple[float, float] | None:
        """A metric's smallest and largest value over the seeds; None if there are none."""
        values = [_value(result, key) for result in self.seeds.get(part, ())]
        return (min(values), max(values)) if values else None


def _value(result: Result, key: str) -> float:
    values = [metric.value for metric in result.metrics if metric.key == key]
    if not values:
        raise KeyError(f"'{result.experiment}' measures no '{key}'")
    return values[0]


class Relation(Enum):
    """Relation between a number here and the printed one."""

    AT_MOST = "an error: less is better"
    AT_LEAST = "more is better"
    EQUAL = "must be the same"
    ALIKE = "must be of the same order"
    USED = "put in, not found out"
    MISSING = "not reproduced"


class Tone(Enum):
    """Tone of a verdict."""

    GOOD = "good"
    NEUTRAL = "neutral"
    BAD = "bad"


@dataclass(frozen=True)
class Verdict:
    """The comparison in a word or two.

    Attributes:
        word: relation of the two numbers.
        tone: judgement of that relation.
        remark: remark beside it; empty for none.
    """

    word: str
    tone: Tone
    remark: str = ""


_DIFFERS = Verdict("differs", Tone.BAD)


@dataclass(frozen=True)
class Claim:
    """A number that a paper prints, and where the same number comes from here.

    Attributes:
        where: section, figure, table or equation.
        what: name of the number.
        printed: the number; text if it is more than one.
        unit: unit of both.
        here: gives the number here; None if there is none.
        relation: way in which they are compared.
        tolerance: relative difference that still counts as equal, or, for `ALIKE`, the factor.
        remark: remark beside it.
        show: text for the number here instead of its value, if it is more than one.
        spread: part and key of the metric whose values over the seeds hold the printed number.
        is_measured: true if the paper measured it on its machine, where it is simulated here.
    """

    where: str
    what: str
    printed: float | str
    unit: str = ""
    here: Callable[[Numbers], float] | None = None
    relation: Relation = Relation.EQUAL
    tolerance: float = 1e-9
    remark: str = ""
    show: Callable[[Numbers], str] | None = None
    spread: tuple[str, str] | None = None
    is_measured: bool = False

    def shown(self, numbers: Numbers) -> str:
        """The number here, as it is printed beside the paper's."""
        if self.show is not None:
            return self.show(numbers)
        if self.here is None:
            return ""
        text = amount(float(f"{self.here(numbers):.3g}"), self.unit)
        if self.spread is not None and (ends := numbers.spread(*self.spread)) is not None:
            text += f" ({ends[0]:.2g} to {ends[1]:.2g} over the seeds)"
        return text

    def as_printed(self) -> str:
        """The paper's number with its unit."""
        text = self.printed if isinstance(self.printed, str) else amount(self.printed)
        return f"{text} {self.unit}".rstrip()

    def verdict(self, numbers: Numbers) -> Verdict:
        """Compare the two.

        For numbers printed as text, `here` tells by how much they differ, and `tolerance` is
        absolute.
        """
        if self.relation is Relation.MISSING or self.here is None:
            return Verdict("not reproduced", Tone.BAD)
        value = self.here(numbers)
        if not math.isfinite(value):
            return Verdict("not run", Tone.BAD)
        printed = 0.0 if isinstance(self.printed, str) else self.printed
        if self.spread is not None and (ends := numbers.spread(*self.spread)) is not None:
            is_within = ends[0] <= printed <= ends[1]
            return Verdict("within the seeds", Tone.GOOD) if is_within else _DIFFERS
        verdict = self._compare(value, printed)
        return replace(verdict, remark="simulated here") if self.is_measured else verdict

    def _compare(self, value: float, printed: float) -> Verdict:
        scale = abs(printed) or 1.0
        is_equal = abs(value - printed) <= self.tolerance * scale
        match self.relation:
            case Relation.USED:
                return Verdict("used", Tone.NEUTRAL) if is_equal else _DIFFERS
            case Relation.EQUAL:
                word = "agrees" if self.tolerance > _ROUNDED else "the same"
                return Verdict(word, Tone.GOOD) if is_equal else _DIFFERS
            case Relation.ALIKE:
                is_alike = printed / self.tolerance <= value <= printed * self.tolerance
                return Verdict("the same order", Tone.GOOD) if is_alike else _DIFFERS
            case Relation.AT_LEAST:
                is_reached = value >= printed
                return Verdict("reached", Tone.GOOD) if is_reached else _DIFFERS
        if abs(value) > printed:
            return Verdict("worse", Tone.BAD)
        if abs(value) > _BETTER * printed:
            return Verdict("reached", Tone.GOOD)
        return Verdict(f"{_factor(printed, value)} times better", Tone.GOOD)


def _factor(printed: float, value: float) -> str:
    factor = printed / max(abs(value), 1e-3 * printed)
    return f"{factor:.0f}" if factor >= 10.0 else f"{factor:.2g}"


@dataclass(frozen=True)
class Check:
    """Result of the check of an erratum.

    Attributes:
        shows: the numbers, in a sentence or two.
        passed: true if the numbers confirm the erratum.
    """

    shows: str
    passed: bool


@dataclass(frozen=True)
class Erratum:
    """Something printed that cannot be meant.

    Attributes:
        name: a short one.
        where: section or equation.
        printed: printed form.
        meant: correct form.
        check: computes what decides it.
    """

    name: str
    where: str
    printed: str
    meant: str
    check: Callable[[Numbers], Check]


@dataclass(frozen=True)
class Part:
    """An experiment in a chapter.

    Attributes:
        name: the chapter's own name of it.
        title: title of its section.
        text: work of the paper, and the work here.
        experiment: its name.
        overrides: `key=value` of the scenario.
        quick: more of them, for a report in a hurry.
        quick_text: work of a quick report, where `text` says more than that.
        is_random: true if seeds make a difference.
        adds_to: name of an earlier part; what that one shows too is not shown again.
        source: section, figures or equations of the paper; empty where the part goes beyond it.
    """

    name: str
    title: str
    text: str
    experiment: str
    overrides: tuple[str, ...] = ()
    quick: tuple[str, ...] = ()
    quick_text: str = ""
    is_random: bool = True
    adds_to: str = ""
    source: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture of the machine.

    Attributes:
        title: a few words.
        caption: content of the picture, and its figure in the paper.
        pixels: (height, width, 3).
    """

    title: str
    caption: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Component:
    """A component of the machine in the paper, and what stands for it here.

    Attributes:
        part: part of the machine, by the paper's name.
        system: name of the system that simulates it; empty for none.
        remark: remark.
    """

    part: str
    system: str
    remark: str = ""


@dataclass(frozen=True)
class FutureWork:
    """Something that the paper leaves to future work, and what is shown of it here.

    Attributes:
        where: section of the paper.
        wish: work that it leaves, in a few words.
        here: result here, a sentence or two.
        parts: names of the parts that show it; empty for none.
    """

    where: str
    wish: str
    here: str
    parts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chapter:
    """A machine in the report.

    Attributes:
        title: title of the chapter.
        paper: the citation; empty for a machine that no paper is about.
        summary: one paragraph.
        parts: the experiments, in order.
        claims: every number that the paper prints.
        errata: misprints.
        components: components of the machine.
        components_in: figure of the paper that lists them.
        drawings: figures that need no experiment.
        pictures: takes the pictures; raises RuntimeError where nothing can render.
        missing: results that could not be reproduced, a sentence each.
        future: work that the paper leaves to future work.
    """

    title: str
    paper: str
    summary: str
    parts: tuple[Part, ...]
    claims: tuple[Claim, ...]
    errata: tuple[Erratum, ...] = ()
    components: tuple[Component, ...] = ()
    components_in: str = ""
    drawings: tuple[Figure, ...] = ()
    pictures: Callable[[], Sequence[Picture]] = field(default=tuple)
    missing: tuple[str, ...] = ()
    future: tuple[FutureWork, ...] = ()
