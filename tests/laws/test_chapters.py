"""Laws of every chapter of the report, and of its quick report as a whole."""

import re

import pytest

from parapod.sims.lab import pages
from parapod.sims.output.figures import render
from parapod.sims.report import page as report_page
from parapod.sims.report.chapter import Numbers, Relation, Tone
from parapod.sims.report.run import list_chapters

CHAPTERS = list_chapters()
each_chapter = pytest.mark.parametrize("chapter", CHAPTERS, ids=lambda chapter: chapter.title)
each_paper = pytest.mark.parametrize(
    "chapter",
    [chapter for chapter in CHAPTERS if chapter.paper],
    ids=lambda chapter: chapter.title,
)
# The papers' figures; the platform's Fig. 2 is a table, which the page heads itself.
FIGURES = {
    "The levelling platform": {*range(1, 24)} - {2},
    "The machining centres": {*range(1, 13)},
    "The terrain simulator": {*range(1, 7)},
    "The walking chair": {*range(1, 20)},
}


# Where the papers print what they measured on their machines.
MEASURED = {
    "The levelling platform": ("section 6.4, Figs. 20, 21", "Fig. 15"),
    "The machining centres": (),
    "The terrain simulator": (),
    "The walking chair": ("Fig. 14", "Fig. 17"),
}


@pytest.fixture
def quick(chapter, finished_chapter):
    """Everything in the chapter run once, in a hurry."""
    return finished_chapter(chapter)


@each_chapter
def test_a_quick_report_holds_all_bounds(quick):
    for run in quick.parts:
        assert run.problem == ""
        assert run.result.broken == (), run.part.name
    assert quick.passed


@each_chapter
def test_every_erratum_is_borne_out_by_numbers(quick):
    for erratum, check in zip(quick.chapter.errata, quick.checks, strict=True):
        assert check.passed, erratum.name
        assert re.search(r"\d", check.shows), erratum.name


@each_paper
def test_the_paper_s_number_is_what_is_put_in(chapter):
    claims = [claim for claim in chapter.claims if claim.relation is Relation.USED]
    assert len(claims) >= 18
    for claim in claims:
        assert claim.verdict(Numbers({})).word == "used", claim.what


@each_paper
def test_what_is_better_than_a_measurement_is_said_to_be_simulated(quick):
    better = [
        (claim.where, claim.verdict(quick.numbers))
        for claim in quick.chapter.claims
        if claim.relation is Relation.AT_MOST
    ]
    places = MEASURED[quick.chapter.title]
    assert {where for where, verdict in better if verdict.remark == "simulated here"} == {*places}
    for where, verdict in better:
        assert bool(verdict.remark) == (where in places), where


@each_paper
def test_a_claim_about_an_experiment_that_has_not_been_run_says_so(chapter):
    verdicts = [claim.verdict(Numbers({})) for claim in chapter.claims]
    bad = {verdict.word for verdict in verdicts if verdict.tone is Tone.BAD}
    assert "not run" in bad
    assert bad <= {"not run", "not reproduced"}


@each_chapter
def test_every_number_that_is_there_is_shown(quick):
    for claim in quick.chapter.claims:
        assert claim.here is None or claim.shown(quick.numbers), claim.what


@pytest.mark.parametrize(
    "drawing",
    [drawing for chapter in CHAPTERS for drawing in chapter.drawings],
    ids=lambda drawing: drawing.name,
)
def test_drawings_can_be_drawn(drawing):
    assert render(drawing).startswith(b"<?xml")


@each_paper
def test_every_figure_of_the_paper_is_drawn_or_said_to_be_missing(quick):
    chapter = quick.chapter
    drawn = [*chapter.drawings, *quick.pictures]
    drawn += [figure for run in quick.parts for figure in run.result.figures]
    text = [*(item.caption for item in drawn), *chapter.missing]
    text += [words for part in chapter.parts for words in (part.title, part.text)]
    named = set()
    for listed in re.findall(r"Figs?\.((?:[ ,]|and|to|\d+[a-e]?)+)", " ".join(text)):
        numbers = [int(number) for number in re.findall(r"\d+", listed)]
        named.update(range(numbers[0], numbers[-1] + 1) if "to" in listed else numbers)
    if quick.problem:
        pytest.skip(quick.problem)
    assert named >= FIGURES[chapter.title]


@each_chapter
def test_future_work_names_parts_that_show_it(chapter):
    names = {part.name for part in chapter.parts}
    for work in chapter.future:
        assert work.parts, work.wish
        assert set(work.parts) <= names, work.wish


@each_chapter
def test_the_page_holds_every_figure_once_and_numbers_of_every_part(quick, monkeypatch):
    # Each has been drawn where its experiment is tested.
    monkeypatch.setattr(pages, "render", lambda figure: b"<svg/>")
    page = report_page.make_page([quick], quick=True, date="2020-02-02")
    shown = len(quick.chapter.drawings)
    for run in quick.parts:
        earlier = quick.numbers.results.get(run.part.adds_to)
        names = {figure.name for figure in earlier.figures} if earlier else set()
        shown += sum(figure.name not in names for figure in run.result.figures)
    assert page.count("data:image/svg") == shown
    assert page.count("data:image/png") == len(quick.pictures)
    tables = re.findall(r"<th>metric</th>.*?</table>", page, re.DOTALL)
    assert len(tables) == len(quick.parts)
    assert [table for table in tables if 'class="wide key"' not in table] == []
