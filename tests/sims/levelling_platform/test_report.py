"""The levelling platform's chapter: claims, errata, drawings, and a quick report as a whole."""

import re
from dataclasses import replace

import pytest

from parapod.sims.lab.figures import render
from parapod.sims.lab.results import Metric, Result
from parapod.sims.levelling_platform.report import errata as errata_module
from parapod.sims.levelling_platform.report.chapter import CHAPTER
from parapod.sims.levelling_platform.report.errata import ERRATA
from parapod.sims.report import page as report_page
from parapod.sims.report.chapter import Numbers, Relation, Tone
from parapod.sims.report.page import make_page
from parapod.systems.levelling_platform.geometry import PlatformGeometry

# What the errata about the workspace go by.
WORKSPACE = {
    "inside_fraction": 0.975,
    "inside_fraction_best": 0.976,
    "unreachable_fraction": 0.054,
    "inclined_difference_mm": 7.0,
}


def numbers(**changes):
    metrics = tuple(Metric(key, value) for key, value in (WORKSPACE | changes).items())
    return Numbers({"workspace": Result("workspace", "exact", 0, metrics)})


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda erratum: erratum.name)
def test_every_erratum_is_borne_out(erratum):
    check = erratum.check(numbers())
    assert check.passed
    assert re.search(r"\d", check.shows)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("E7", {"inside_fraction": 0.96}),
        ("E9", {"unreachable_fraction": 0.0}),
        ("E10", {"inclined_difference_mm": 0.1}),
    ],
)
def test_an_erratum_is_not_borne_out_by_other_measurements(name, change):
    (erratum,) = (erratum for erratum in ERRATA if erratum.name == name)
    assert not erratum.check(numbers(**change)).passed


def test_errata_of_the_equations_need_the_right_equations(monkeypatch):
    # Legs that are not those of the misprint: the corrected equation no longer holds either.
    shifted = replace(PlatformGeometry(), l_c1=0.41).legs[:3]
    monkeypatch.setattr(errata_module, "_LEGS", shifted)
    failed = {erratum.name for erratum in ERRATA if not erratum.check(numbers()).passed}
    assert failed == {"E2"}


def test_what_is_put_in_is_what_is_printed():
    claims = [claim for claim in CHAPTER.claims if claim.relation is Relation.USED]
    assert len(claims) > 20
    for claim in claims:
        assert claim.verdict(Numbers({})).word == "used", claim.what


def test_claims_name_experiments_of_the_chapter_only():
    # A claim about an experiment that has not been run says so; none raises.
    verdicts = [claim.verdict(Numbers({})) for claim in CHAPTER.claims]
    assert {v.word for v in verdicts if v.tone is Tone.BAD} == {"not run", "not reproduced"}


@pytest.mark.parametrize("drawing", CHAPTER.drawings, ids=lambda drawing: drawing.name)
def test_drawings_can_be_drawn(drawing):
    assert render(drawing).startswith(b"<?xml")


@pytest.fixture(scope="module")
def quick(finished_chapter):
    return finished_chapter(CHAPTER)


def test_a_quick_report_holds_all_bounds(quick):
    for run in quick.parts:
        assert run.problem == ""
        assert run.result.broken == (), run.part.name
    assert quick.passed


def test_every_printed_number_has_a_verdict_and_the_bad_ones_are_known(quick):
    bad = [
        (claim.where, claim.verdict(quick.numbers).word)
        for claim in CHAPTER.claims
        if claim.verdict(quick.numbers).tone is Tone.BAD
    ]
    assert bad == [
        ("section 4", "differs"),
        ("Eq. (14)", "differs"),
        ("section 2.1", "not reproduced"),
        ("section 4", "not reproduced"),
    ]
    assert all(claim.shown(quick.numbers) for claim in CHAPTER.claims if claim.here is not None)


def test_every_figure_of_the_paper_is_drawn_or_said_to_be_missing(quick):
    drawn = [*CHAPTER.drawings, *quick.pictures]
    drawn += [figure for run in quick.parts for figure in run.result.figures]
    text = [*(item.caption for item in drawn), *CHAPTER.missing]
    text += [part.text for part in CHAPTER.parts]
    named = set()
    for listed in re.findall(r"Figs?\.((?:[ ,]|and|to|\d+[a-c]?)+)", " ".join(text)):
        numbers = re.findall(r"\d+", listed)
        named.update(int(number) for number in numbers)
    # Fig. 2 is the table of components, which the page heads itself.
    assert named >= set(range(1, 24)) - {2}


def test_the_page_of_the_whole_report_holds_every_figure(quick, monkeypatch):
    # Each has been drawn where its experiment is tested.
    monkeypatch.setattr(report_page, "render", lambda figure, suffix: b"<svg/>")
    page = make_page([quick], quick=True, date="2020-02-02")
    figures = sum(len(run.result.figures) for run in quick.parts) + len(CHAPTER.drawings)
    # The turntable's part leaves out what the workspace's shows.
    shared = len(quick.numbers.results["workspace"].figures)
    assert page.count("data:image/svg") == figures - shared
    assert page.count("data:image/png") == len(quick.pictures)
