"""Text in messages: whatever people type, a message stays one readable line."""

import random

import pytest

from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError
from parapod.systems.core.quoting import (
    did_you_mean,
    escaped,
    printable,
    quoted,
    quoted_path,
    show,
)
from parapod.systems.hardware.device import DeviceError


@pytest.mark.parametrize(
    ("text", "escaped_text"),
    [
        ("pitch_deg", "pitch_deg"),
        ("é ñ", "é ñ"),
        ("a\nb\t\x1b[31m", "a\\nb\\t\\x1b[31m"),
        ("\u2028\udcff\U000e0001", "\\u2028\\udcff\\U000e0001"),
        ("", ""),
        ("x" * 60, "x" * 60),
        ("a" * 100 + "b" * 100, "a" * 38 + "..." + "b" * 19),
    ],
)
def test_a_name_is_repeated_without_control_characters_and_not_too_long(text, escaped_text):
    assert escaped(text) == escaped_text
    assert quoted(text) == f"'{escaped_text}'"


def test_a_path_may_be_longer_than_a_name():
    path = "/folder" * 30
    assert quoted_path(path) == f"'{path}'"
    assert len(quoted_path(path * 100)) == 242


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (3.0, "3"),
        (1e-3, "0.001"),
        (True, "True"),
        ("a\nb", "'a\\nb'"),
        ([1, "x"], "[1, 'x']"),
        (["x" * 100], "['" + "x" * 55 + "..."),
    ],
)
def test_a_value_is_shown_as_it_would_be_typed(value, text):
    assert show(value) == text


def test_a_value_that_has_no_decimal_form_is_shown_too():
    assert show(16**5000) == "a very long int"


def test_words_of_a_library_lose_their_line_breaks():
    assert printable("expected <end>,\n   but  found\x00") == "expected <end>, but found\\x00"
    assert printable("two  blanks stay") == "two  blanks stay"


def test_the_nearest_name_is_guessed_unless_the_text_is_too_long():
    assert did_you_mean("pich", ["pitch", "roll"]) == " (did you mean pitch?)"
    assert did_you_mean("height", ["pitch", "roll"]) == ""
    assert did_you_mean("x" * 10_000, ["x" * 10_001]) == ""


@pytest.mark.parametrize(
    "made", [ParapodError, ScenarioError, OutputError, lambda text: DeviceError(text, text)]
)
def test_every_error_is_one_line_of_reasonable_length(made):
    rng = random.Random(0)
    for _ in range(200):
        codes = [rng.randrange(rng.choice((256, 0x11000))) for _ in range(9)]
        text = "".join(map(chr, codes))
        message = str(made(text * rng.choice((1, 10, 1000))))
        assert message.isprintable()
        assert len(message) <= 1200
