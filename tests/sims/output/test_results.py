"""Metrics, their verdicts, and how a result is shown to people and to machines."""

import io
import json
import math
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric, Result, print_table


def result(*metrics, notes=()):
    return Result("level", "kinematic", 3, tuple(metrics), notes)


def printed(a_result, **options):
    stream = io.StringIO()
    print_table(a_result, Console(file=stream, **options))
    return stream.getvalue()


TILT = Metric("final_tilt", -0.1234567, "deg", 0.5, 0.3, "largest inclination while it holds")


@pytest.mark.parametrize(
    ("value", "bound", "passed"),
    [
        (0.5, 0.5, True),
        (-0.5, 0.5, True),
        (0.6, 0.5, False),
        (-0.6, 0.5, False),
        (9e9, None, True),
        (math.nan, 0.5, False),
        (math.nan, None, False),
        (math.nan, math.inf, False),
        (math.inf, math.inf, False),
        (0.0, math.nan, False),
    ],
)
def test_a_metric_passes_if_it_is_finite_and_its_magnitude_within_the_bound(value, bound, passed):
    assert Metric("x", value, "m", bound).passed is passed


def test_a_result_names_the_metrics_that_are_broken():
    wrong = Metric("settling_time", 70.0, "s", 60.0)
    assert result(TILT).passed
    assert result(TILT, wrong).broken == (wrong,)
    assert not result(TILT, wrong).passed
    assert str(wrong) == "settling_time = 70 s (bound 60 s)"


def test_json_is_plain_with_null_for_what_is_not_finite_and_limits_beside_the_values():
    data = result(
        Metric("a", np.float64(1.5), "m", np.float64(2.0), meaning="a length"),
        Metric("b", math.nan),
        Metric("c", -math.inf, at_least=1.0),
        Metric("d", np.int64(7)),
        Metric("e", np.float32(0.5)),
    ).as_json()
    data = json.loads(json.dumps(data, allow_nan=False))
    bounds = data.pop("bounds")
    assert data.pop("parapod") == version("parapod")
    assert data == {
        "experiment": "level",
        "backend": "kinematic",
        "seed": 3,
        "passed": False,
        "a": 1.5,
        "b": None,
        "c": None,
        "d": 7,
        "e": 0.5,
    }
    assert bounds["a"] == {
        "unit": "m",
        "bound": 2.0,
        "at_least": None,
        "verdict": "held",
        "meaning": "a length",
    }
    verdicts = {key: told["verdict"] for key, told in bounds.items()}
    assert verdicts == {"a": "held", "b": "BROKEN", "c": "BROKEN", "d": "-", "e": "-"}
    assert bounds["c"]["at_least"] == 1.0


@pytest.mark.parametrize("key", ["seed", "bounds", "scenario", "a"])
def test_keys_that_would_hide_another_are_refused(key):
    with pytest.raises(ValueError, match=key):
        result(Metric("a", 1.0), Metric(key, 2.0))


def test_the_table_shows_value_unit_bound_paper_and_verdict():
    text = printed(result(TILT, Metric("duration", 31.4, "s", paper="about 30 s")), width=80)
    row = next(line for line in text.splitlines() if "final_tilt" in line)
    assert row.split() == ["final_tilt", "[deg]", "-0.12346", "<=", "0.5", "0.3", "held"]
    assert "about 30 s" in text
    assert "level (kinematic, seed 3)" in text
    assert text.rstrip().endswith("all bounds held: 1 of 1")


def test_the_table_names_what_is_broken():
    text = printed(result(TILT, Metric("torque", math.nan, "Nm", 2.0)), width=80)
    assert "BROKEN" in text
    assert "broken: torque = nan Nm (bound 2 Nm)" in text
    assert "all bounds held" not in text


@pytest.mark.parametrize("width", [80, 200])
def test_a_piped_table_has_no_escape_codes_and_loses_nothing(width):
    long = Metric("k" * 60, 1e-12, "mm/s", 1e9, "p" * 30, "m" * 90)
    text = printed(result(TILT, long, notes=("note [bold]" + "n" * 100,)), width=width)
    assert "\x1b" not in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    for letter, count in {"k": 60, "p": 30, "m": 90, "n": 100}.items():
        assert text.count(letter) >= count
    assert "[bold]" in text
    assert "[mm/s]" in text


def test_the_table_can_be_printed_where_there_is_only_ascii():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    print_table(result(TILT), Console(file=stream, width=80))
    stream.flush()
    assert b"final_tilt [deg]" in stream.buffer.getvalue()


@pytest.mark.parametrize(
    ("bound", "at_least", "limits", "words"),
    [
        (None, None, "", "no bound"),
        (2.0, None, "<= 2", "bound 2 dB"),
        (None, 5.0, ">= 5", "bound >= 5 dB"),
        (3.0, 1.0, "1..3", "bound 1..3 dB"),
    ],
)
def test_limits_are_written_as_people_write_them(bound, at_least, limits, words):
    metric = Metric("margin", 2.0, "dB", bound, at_least=at_least)
    assert metric.limits == limits
    assert str(metric) == f"margin = 2 dB ({words})"
    assert metric.is_bounded == bool(limits)


@pytest.mark.parametrize(
    ("value", "bound", "passed"),
    [
        (5.0, None, True),
        (4.9, None, False),
        (-9.0, None, False),
        (7.0, 8.0, True),
        (9.0, 8.0, False),
        (math.nan, None, False),
        (math.inf, None, False),
    ],
)
def test_a_metric_passes_if_it_is_at_least_what_it_must_be(value, bound, passed):
    metric = Metric("margin", value, "dB", bound, at_least=5.0)
    assert metric.passed is passed
    assert metric.verdict == ("held" if passed else "BROKEN")


def test_the_table_shows_lower_bounds():
    text = printed(result(Metric("margin", 12.0, "dB", at_least=10.0)), width=100)
    assert ">= 10" in text
    assert "all bounds held: 1 of 1" in text


def test_a_result_gives_its_numbers_by_key_and_names_them_all_for_a_wrong_one():
    found = result(TILT, Metric("duration", 31.4, "s"))
    assert found["duration"] == 31.4
    with pytest.raises(KeyError, match="no metric 'tilt'; there are: final_tilt, duration"):
        found["tilt"]
    assert repr(found) == "<level (kinematic, seed 3): all bounds held>"
    assert "broken: torque = 3 Nm (bound 2 Nm)" in repr(result(Metric("torque", 3.0, "Nm", 2.0)))


def test_a_result_shows_itself_in_a_notebook():
    line = Figure("a", "A", "A <line>.", lambda canvas: canvas.text(0.5, 0.5, "drawn"))
    page = replace(result(TILT, notes=("a < b",)), figures=(line,))._repr_html_()
    for part in ("final_tilt", "held", "a &lt; b", "A &lt;line&gt;.", "<svg", "drawn"):
        assert part in page
    assert "<?xml" not in page


def test_identified_values_are_in_the_json_of_a_result_that_has_some():
    assert "identified" not in result(TILT).as_json()
    found = replace(result(TILT), identified={"control.pole": 9.0}).as_json()
    assert found["identified"] == {"control.pole": 9.0}
    assert json.loads(json.dumps(found)) == found


def test_no_metric_takes_the_place_of_identified_values():
    with pytest.raises(ValueError, match="identified"):
        result(Metric("identified", 1.0))
