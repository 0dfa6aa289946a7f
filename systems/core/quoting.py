"""Quotation of text in messages: one line, no control characters, a reasonable length.

Whatever people type can be anything, and an error that repeats it must stay one readable line:
`quoted` and `escaped` for names, `quoted_path` for files, `show` for values, `printable` for text
from elsewhere, such as the words of a library.
"""

import difflib
from collections.abc import Iterable
from typing import Any

# Longest name, value and path that a message repeats, and longest message [characters].
_LONGEST = 60
_LONGEST_PATH = 240
_LONGEST_MESSAGE = 1200


def quoted(text: object, longest: int = _LONGEST) -> str:
    """Text in quotes, as in 'pitch_deg'; see `escaped`."""
    return f"'{escaped(text, longest)}'"


def quoted_path(path: object) -> str:
    """A path in quotes, which may be longer than a name."""
    return quoted(path, _LONGEST_PATH)


def escaped(text: object, longest: int = _LONGEST) -> str:
    r"""Text without control characters: a line break is shown as \n.

    Args:
        text: a name, or a path.
        longest: number of characters from which on the middle is left out.
    """
    return _clipped(_escaped(str(text), longest), longest)


def show(value: Any) -> str:
    """A value as the user would write it, in one line, not too long."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return repr(float(value)).removesuffix(".0")
    try:
        text = printable(repr(value), 100 * _LONGEST)
    except (ValueError, RecursionError):  # a number of thousands of digits, a list of thousands
        return f"a very long {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def printable(text: object, longest: int = _LONGEST_MESSAGE) -> str:
    """Text in one line: line breaks are blanks, other control characters are escaped.

    Args:
        text: text of any origin.
        longest: number of characters from which on the middle is left out.
    """
    line = str(text)
    if not line.isprintable():
        line = _escaped(" ".join(line.split()), longest)
    return _clipped(line, longest)


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """The allowed name that was probably meant, as an aside; empty if none is near."""
    if len(name) > _LONGEST:  # comparing takes the square of the length
        return ""
    close = difflib.get_close_matches(name, list(allowed), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _escaped(text: str, longest: int) -> str:
    if len(text) > 2 * longest:
        text = text[:longest] + text[-longest:]  # what is left out need not be escaped
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def _clipped(text: str, longest: int) -> str:
    """Text with its middle left out if it is too long."""
    if len(text) <= longest:
        return text
    head = 2 * (longest - 3) // 3
    return f"{text[:head]}...{text[len(text) - (longest - 3 - head) :]}"
