"""Figures of postures: which errors their axes are made for."""

import numpy as np
import pytest

from parapod.diagrams.plots import ROLE_COLOURS
from parapod.sims.levelling_platform.levelling import posture_figure
from parapod.sims.output.figures import draw

TIME = np.linspace(0.0, 10.0, 101)
ASKED = np.zeros((101, 3))


def axes_of(true, counts_from):
    lines = {"asked for": ASKED, "true": true}
    figure = posture_figure("tilt", "Tilt", "A tilt.", TIME, lines, "asked for", counts_from)
    return draw(figure).axes


def test_the_axes_of_the_errors_are_those_of_the_errors_that_count():
    true = np.where(TIME < 4.0, 5.0, 0.1)[:, np.newaxis] * [1.0, -1.0, 20.0]
    for axes, error in zip(axes_of(true, 4.0)[3:], (0.1, -0.1, 2.0), strict=True):
        low, high = axes.get_ylim()
        assert low < min(0.0, error) < max(0.0, error) < high
        assert high - low < 1.2 * abs(error)
        # Nothing is left out of the data: the line only leaves the axes.
        assert np.abs(axes.lines[0].get_ydata()).max() == pytest.approx(50.0 * abs(error))


@pytest.mark.parametrize("missing", [slice(None), slice(50, None)])
def test_errors_that_are_not_known_leave_the_axes_to_the_others(missing):
    true = np.full((101, 3), 0.1)
    true[missing] = np.nan
    for axes in axes_of(true, 4.0)[3:]:
        low, high = axes.get_ylim()
        assert np.isfinite([low, high]).all()
        assert low < high


@pytest.mark.parametrize("part", ["level", "uneven-ground", "track-posture"])
def test_the_time_before_errors_count_is_marked(part, finished):
    run = finished(part)
    job = run.scenario.job
    canvas = draw(run.result.figures[0])
    for axes in canvas.axes:
        (span,) = axes.patches
        assert span.get_x() + span.get_width() == pytest.approx(
            job.estimate_at + job.settled_after
        )
    (legend,) = canvas.legends
    assert "errors do not count yet" in [text.get_text() for text in legend.get_texts()]


def test_rows_of_errors_have_their_bounds_and_roles_their_colours():
    time = np.linspace(0.0, 1.0, 11)
    asked = np.zeros((11, 3))
    true = asked + [0.1, -0.1, 0.5] * np.sin(time)[:, None]
    figure = posture_figure(
        "f", "F", "C.", time, {"asked for": asked, "true": true}, "asked for", bounds=(0.2, 1.0)
    )
    axes = draw(figure).axes
    for axes_of_error, bound in zip(axes[3:], (0.2, 0.2, 1.0), strict=True):
        curve, *bounds = axes_of_error.lines
        assert curve.get_color() == ROLE_COLOURS["true"]
        assert [line.get_ydata()[0] for line in bounds] in ([-bound, bound], [bound])
