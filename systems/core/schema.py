"""Fields of schemas with admissible values, and the words of errors about them."""

import dataclasses
import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

RULE = "parapod.rule"

# Longest value that an error message repeats.
_LONGEST_SHOWN = 60


def did_you_mean(name: str, allowed: Sequence[str]) -> str:
    """The allowed name that was probably meant, as an aside; empty if none is near."""
    close = difflib.get_close_matches(name, allowed, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def show(value: Any) -> str:
    """A value as the user would write it, in one line, not too long."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return repr(float(value)).removesuffix(".0")
    text = one_line(repr(value))
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 3]}..."


def one_line(text: object) -> str:
    """Text without line breaks."""
    return " ".join(str(text).split())


@dataclass(frozen=True)
class Range:
    """Admissible range of a number, or of every number of a list with `length` elements."""

    low: float
    high: float
    length: int | None = None

    def __str__(self) -> str:
        return f"{show(self.low)}..{show(self.high)}"


@dataclass(frozen=True)
class Options:
    """Admissible values of a choice."""

    options: tuple[Any, ...]


type Rule = Range | Options | None


def quantity(default: Any, low: float, high: float, *, length: int | None = None) -> Any:
    """Field of a schema: a number, or a list of numbers, with an admissible range.

    Args:
        default: the default; a list is copied; None for an optional number or list.
        low: smallest admissible value, of every element if it is a list.
        high: largest admissible value.
        length: how many elements a list must have; None for any number of them.
    """
    metadata = {RULE: Range(low, high, length)}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def choice(default: Any, options: Sequence[Any]) -> Any:
    """Field of a schema: one of a few admissible values."""
    return dataclasses.field(default=default, metadata={RULE: Options(tuple(options))})
