"""The walking chair's chapter: claims, errata, drawings, and a quick report as a whole."""

import re
from dataclasses import replace

import numpy as np
import pytest

from parapod.sims.lab.figures import render
from parapod.sims.report import page as report_page
from parapod.sims.report.chapter import Numbers, Relation, Tone
from parapod.sims.report.page import make_page
from parapod.sims.walking_chair.report import errata as errata_module
from parapod.sims.walking_chair.report.chapter import CHAPTER, pictures
from parapod.sims.walking_chair.report.errata import ERRATA
from parapod.systems.walking_chair.leg import leg_corners
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY
from parapod.systems.walking_chair.printed import (
    printed_jacobian,
    printed_point_acceleration,
    printed_point_velocity,
)
from parapod.systems.walking_chair.rates import leg_jacobian

NOTHING = Numbers({})


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda erratum: erratum.name)
def test_every_erratum_is_borne_out(erratum):
    check = erratum.check(NOTHING)
    assert check.passed
    assert re.search(r"\d", check.shows)


def test_errata_of_the_leg_need_a_leg_that_is_tilted(monkeypatch):
    # A straight leg shows none of them.
    monkeypatch.setattr(errata_module, "_UP", np.array((0.70, 0.0, 0.0)))
    failed = {erratum.name for erratum in ERRATA if not erratum.check(NOTHING).passed}
    assert failed == {"Half angles", "The foot's spin"}


def test_the_printed_jacobian_is_right_for_motions_in_the_plane_of_the_leg():
    # In the gait alpha is zero, which is why Fig. 8 is not affected.
    leg = CHAIR_GEOMETRY.leg
    up = np.array((0.70, 0.0, 0.2))
    exact = leg_jacobian(leg, leg_corners(leg, up)[1], "E2")
    printed = printed_jacobian(leg, up)
    np.testing.assert_allclose(printed[:, 1:], exact[:, 1:], rtol=0, atol=1e-12)
    assert np.abs(printed[:, 0] - exact[:, 0]).max() > 1e-3


def test_corrected_equations_agree_with_differences_and_printed_ones_do_not():
    printed, corrected, differences = printed_point_velocity()
    np.testing.assert_allclose(corrected, differences, rtol=0, atol=1e-8)
    assert np.abs(printed - differences).max() > 0.1
    corrected, differences = printed_point_acceleration()
    np.testing.assert_allclose(corrected, differences, rtol=0, atol=1e-6)


def test_what_is_put_in_is_what_is_printed():
    claims = [claim for claim in CHAPTER.claims if claim.relation is Relation.USED]
    assert len(claims) >= 18
    for claim in claims:
        assert claim.verdict(NOTHING).word == "used", claim.what


def test_claims_name_experiments_of_the_chapter_only():
    verdicts = [claim.verdict(NOTHING) for claim in CHAPTER.claims]
    assert {v.word for v in verdicts if v.tone is Tone.BAD} == {"not run"}


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


def test_every_printed_number_has_a_good_verdict(quick):
    bad = [
        (claim.where, claim.what)
        for claim in CHAPTER.claims
        if claim.verdict(quick.numbers).tone is Tone.BAD
    ]
    assert bad == []
    assert all(claim.shown(quick.numbers) for claim in CHAPTER.claims if claim.here is not None)


def test_a_claim_fails_with_other_numbers(quick):
    results = dict(quick.numbers.results)
    gait = results["chair-gait"]
    slower = tuple(
        replace(metric, value=90.0) if metric.key == "max_branch_speed_mm_s" else metric
        for metric in gait.metrics
    )
    results["chair-gait"] = replace(gait, metrics=slower)
    bad = [c.what for c in CHAPTER.claims if c.verdict(Numbers(results)).tone is Tone.BAD]
    assert bad == ["velocities of all branches"]


def test_every_figure_of_the_paper_is_drawn_or_said_to_be_missing(quick):
    drawn = [*CHAPTER.drawings, *quick.pictures]
    drawn += [figure for run in quick.parts for figure in run.result.figures]
    text = [*(item.caption for item in drawn), *CHAPTER.missing]
    text += [part.title for part in CHAPTER.parts]
    named = set()
    for listed in re.findall(r"Figs?\.((?:[ ,]|and|to|\d+[a-e]?)+)", " ".join(text)):
        numbers = [int(number) for number in re.findall(r"\d+", listed)]
        named.update(range(numbers[0], numbers[-1] + 1) if "to" in listed else numbers)
    if not quick.pictures:  # nothing can render here
        named |= {2, 16, 18}
    assert named >= set(range(1, 20))


def test_the_page_holds_every_figure(quick, monkeypatch):
    # Each has been drawn where its experiment is tested.
    monkeypatch.setattr(report_page, "render", lambda figure, suffix: b"<svg/>")
    page = make_page([quick], quick=True, date="2020-02-02")
    figures = sum(len(run.result.figures) for run in quick.parts) + len(CHAPTER.drawings)
    assert page.count("data:image/svg") == figures
    assert page.count("data:image/png") == len(quick.pictures)


def test_the_chair_is_in_the_middle_of_every_picture():
    try:
        taken = pictures()
    except RuntimeError as error:
        pytest.skip(str(error))
    for picture in taken:
        height, width, _ = picture.pixels.shape
        # The chair's orange is nowhere else.
        red, green, blue = (picture.pixels[..., i].astype(int) for i in range(3))
        rows, columns = np.nonzero((red - blue > 90) & (red - green > 50))
        assert rows.size > 1000, picture.title
        assert abs(columns.mean() / width - 0.5) < 0.15, picture.title
        assert 0.2 < rows.mean() / height < 0.8, picture.title
