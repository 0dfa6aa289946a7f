"""Figures and page of a study."""

import io
import re

import numpy as np
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.text import Text
from rich.console import Console

from parapod.sims.output.figures import draw, render
from parapod.sims.study.page import make_page
from parapod.sims.study.records import Column
from parapod.sims.study.sensitivity import contributions
from parapod.sims.study.summary import print_summary
from tests.sims.study.conftest import carry_out

ALL = {"x": "-10:10:9", "y": "-5:5:9", "kind": "good,crash"}


def figure(result, name):
    (found,) = [one for one in result.figures if one.name == name]
    return found


@pytest.fixture
def result(study):
    return carry_out(study(ALL))


def test_a_grid_shows_distributions_contributions_and_its_border(result):
    names = [one.name for one in result.figures]
    assert names == ["border_y_x", "contributions", "over_variables", "distributions"]
    for one in result.figures:
        assert b"<svg" in render(one)


def test_the_border_is_where_half_of_the_runs_hold_their_bounds(study):
    # Held where |x + 2 y| <= 5, y >= -1, and x <= 1 + |y| where x > 0.
    result = carry_out(study({"x": "-9:1:21", "y": "-0.5:5:23"}))
    (ax, _) = draw(figure(result, "border_y_x")).axes
    (border,) = [item for item in ax.collections if isinstance(item, QuadContourSet)]
    y, x = np.concatenate([path.vertices for path in border.get_paths()]).T
    assert len(x) > 20
    # Half a cell, of .5 and .25, from the true border.
    off = np.minimum(np.abs(np.abs(x + 2.0 * y) - 5.0), np.abs(x - 1.0 - y))
    assert off.max() <= 0.5 + 1e-9


def test_cells_tell_the_share_of_runs_that_hold_their_bounds(result):
    (ax, _) = draw(figure(result, "border_y_x")).axes
    share = np.asarray(ax.collections[0].get_array()).reshape(9, 9)  # x upwards, y to the right
    held = result.records.passed.reshape(9, 9, 2).mean(axis=2)
    assert share == pytest.approx(100.0 * held)
    assert 0.0 < held.max() == 0.5


def test_histograms_tell_what_is_held_from_what_is_broken(result):
    total = result.records.columns[0]
    ax = draw(figure(result, "distributions")).axes[0]
    green, orange = (sum(bar.get_height() for bar in bars) for bars in ax.containers)
    assert green == (total.held & total.is_there).sum()
    assert orange == (np.isfinite(total.values) & ~total.held).sum()
    assert {line.get_xdata()[0] for line in ax.lines} == {5.0, -5.0}


def test_contributions_are_those_of_the_grid(study):
    result = carry_out(study({"x": "-1:1:3", "y": "-1:1:3"}))
    ax = draw(figure(result, "contributions")).axes[0]
    widths = [[bar.get_width() for bar in bars] for bars in ax.containers if len(bars) == 2]
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == ["total_mm", "floor_mm"]  # all bounds are held everywhere
    assert widths[1] == pytest.approx([0.2, 0.0], abs=1e-12)  # x alone: 1 of 1 + 4
    assert widths[3] == pytest.approx([0.8, 1.0])


def test_a_study_of_which_nothing_is_done_has_no_figures(study):
    made = study(ALL)
    from parapod.sims.study.records import Records
    from parapod.sims.study.result import StudyResult

    result = StudyResult(made, Records(made.sampling))
    assert result.figures == ()
    assert "0 of 0" in make_page(result.study, result.summary, result.figures)


def test_the_page_needs_nothing_else_and_says_everything(result):
    page = make_page(result.study, result.summary, result.figures)
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=\"(?!data:)", page)
    for text in ("trial: 162 runs", "total_mm [mm]", "&lt;= 5", "RuntimeError: it does not conv"):
        assert text in page
    assert page.count("data:image/svg+xml") == len(result.figures)
    for command in result.summary.commands.values():
        assert command.replace("'", "&#39;") in page
    assert "<!doctype" not in result._repr_html_()


def test_the_page_answers_first_then_shows_where_the_bounds_hold(result):
    page = make_page(result.study, result.summary, result.figures)
    passed = result.records.passed.sum()
    answer = (
        f"All bounds held in {passed} of 162 runs. 81 were refused or failed. Broken most often: "
    )
    titles = [one.title for one in result.figures]
    parts = [answer, "<table", *titles, "<h3>Metrics</h3>", "<h3>Runs to look at</h3>"]
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    assert titles[0].startswith("Where the bounds hold")


def test_the_answer_names_the_variable_that_decides(study):
    result = carry_out(study({"x": "-9:1:5", "y": "0:5:11"}))
    share = contributions(result.study.sampling, [result.records.verdict])[0].total
    key = "xy"[int(np.argmax(share))]
    assert result.summary.decisive == (key, pytest.approx(max(share)))
    assert result.summary.answer.endswith(
        f"{key} decides most: it has a part in {100.0 * max(share):.0f} % of the variance."
    )


def test_values_that_are_not_finite_have_their_reason(study):
    result = carry_out(study({"x": "0:1:2", "kind": "good,endless"}))
    remark = "not finite in 2 runs: the sum is endless"
    assert remark in make_page(result.study, result.summary, result.figures)
    console = Console(file=io.StringIO(), width=200)
    print_summary(result.summary, console)
    assert remark in console.file.getvalue()


def test_letters_of_figures_are_10_pixels_of_the_page_or_more(result):
    (scale,) = re.findall(
        r"img \{ min-width: calc\(var\(--inches\) \* ([\d.]+)rem\)",
        make_page(result.study, result.summary, result.figures),
    )
    pixels_of_a_point = 16.0 * float(scale) / 72.0
    for one in result.figures:
        for text in draw(one).findobj(Text):
            if text.get_text():
                assert text.get_fontsize() * pixels_of_a_point >= 10.0, text


def test_values_of_a_range_are_written_as_people_write_them(study):
    assert study({"x": "-7:7:11"}).variables[0].values[4:6] == [-1.4, 0.0]


# bound, at_least, value: share of the bound that is used
USES = [
    (2.0, None, -1.0, 0.5),
    (2.0, None, 3.0, 1.5),
    (0.0, None, 0.0, 0.0),
    (0.0, None, 0.1, np.inf),
    (None, 4.0, 8.0, 0.5),
    (None, 4.0, 2.0, 2.0),
    (None, 4.0, -1.0, np.inf),
    (None, -1.0, -0.5, 0.0),
    (None, -1.0, -2.0, np.inf),
    (4.0, 1.0, 2.0, 0.5),
    (2.0, None, np.nan, np.inf),
    (None, None, 3.0, np.nan),
]


@pytest.mark.parametrize(("bound", "at_least", "value", "use"), USES)
def test_use_of_a_bound_is_one_at_the_bound(bound, at_least, value, use):
    def one(number):
        return np.array([np.nan if number is None else number])

    column = Column("a", "", "", one(value), one(bound), one(at_least), np.array([True]), (0, 0))
    assert column.use == pytest.approx([use], nan_ok=True)
    if not np.isnan(use):
        assert bool(column.held[0]) == (use <= 1.0)
