"""Figures of speed beside a yardstick: their verdicts, and what is taken when."""

import sys
from itertools import count
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def benchmarks(monkeypatch):
    """The modules of the yardsticks and of the report."""
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks import report, yardstick

    yield yardstick, report
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


QUIET = 0.01


@pytest.mark.parametrize(
    ("value", "at_most", "samples", "verdict"),
    [
        (60.0, False, (0.010, 0.010), "ok"),
        (59.0, False, (0.010, 0.010), "missed"),
        # Half as fast on a machine of half the speed is as fast, and no faster.
        (30.0, False, (0.020, 0.0201), "ok"),
        (29.0, False, (0.020, 0.0201), "missed"),
        # On a faster machine more is asked for.
        (60.0, False, (0.005, 0.005), "missed"),
        (120.0, True, (0.020, 0.020), "ok"),
        (121.0, True, (0.020, 0.020), "missed"),
        (59.0, True, (0.005, 0.005), "missed"),
        # A yardstick that scatters tells nothing, but what holds all the same does.
        (29.0, False, (0.020, 0.020, 0.030), "too busy to judge"),
        (31.0, False, (0.020, 0.030, 0.020), "ok"),
        (200.0, True, (0.030, 0.020), "too busy to judge"),
    ],
)
def test_speed_is_judged_beside_its_yardstick(benchmarks, value, at_most, samples, verdict):
    yardstick, report = benchmarks
    pace = yardstick.Pace("fake", samples, QUIET)
    found = report.Measurement("speed", value, "x", 60.0, at_most=at_most, pace=pace)
    assert found.verdict == verdict
    assert found.is_missed == (verdict == "missed")


def test_without_a_yardstick_or_a_bound_the_figure_counts(benchmarks):
    _, report = benchmarks
    assert report.Measurement("error", 1.0, "mm", 2.0, at_most=True).verdict == "ok"
    assert report.Measurement("error", 3.0, "mm", 2.0, at_most=True).verdict == "missed"
    assert report.Measurement("error", 3.0, "mm").verdict == "ok"


def test_yardstick_is_taken_before_between_and_after(benchmarks, monkeypatch):
    yardstick, _ = benchmarks
    now = count()  # a clock that is read twice for each pass: each takes 1 s
    monkeypatch.setattr(yardstick, "clock", lambda: float(next(now)))
    taken = []
    fake = yardstick.Yardstick("fake", 0.5, lambda: lambda: taken.append("yardstick"))
    durations = iter((3.0, 2.0, 4.0))

    def measured():
        taken.append("figure")
        return next(durations)

    best, pace = fake.best_beside(measured, 3)
    assert best == 2.0
    assert pace.samples == (1.0,) * 4
    assert pace.slowness == 2.0
    assert pace.is_steady
    figures = [k for k, what in enumerate(taken) if what == "figure"]
    assert "yardstick" in taken[: figures[0]]
    assert all(b - a > 1 for a, b in zip(figures, [*figures[1:], len(taken)], strict=True))


@pytest.mark.parametrize("name", ["PYTHON", "NUMPY", "DRAKE"])
def test_work_of_a_yardstick_can_be_repeated(benchmarks, name):
    yardstick, _ = benchmarks
    work = getattr(yardstick, name).work()
    work()
    work()
