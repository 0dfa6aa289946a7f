"""How errors about scenarios say what was given and what is allowed."""

import difflib
from collections.abc import Sequence
from typing import Any

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
