"""The walking chair's chapter: what its claims and errata hang on."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.sims.report.chapter import Numbers, Tone
from parapod.sims.walking_chair.report import errata as errata_module
from parapod.sims.walking_chair.report.chapter import CHAPTER
from parapod.sims.walking_chair.report.errata import ERRATA
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import leg_corners
from parapod.systems.walking_chair.printed import (
    printed_jacobian,
    printed_point_acceleration,
    printed_point_velocity,
)
from parapod.systems.walking_chair.rates import leg_jacobian

CHAIR_GEOMETRY = ChairGeometry()

NOTHING = Numbers({})


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


@pytest.fixture(scope="module")
def quick(finished_chapter):
    return finished_chapter(CHAPTER)


def test_every_printed_number_has_a_good_verdict(quick):
    bad = [
        (claim.where, claim.what)
        for claim in CHAPTER.claims
        if claim.verdict(quick.numbers).tone is Tone.BAD
    ]
    assert bad == []


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


def test_the_chair_is_in_the_middle_of_every_picture(quick):
    if not quick.pictures:
        pytest.skip(quick.problem)
    for picture in quick.pictures:
        height, width, _ = picture.pixels.shape
        # The chair's orange is nowhere else.
        red, green, blue = (picture.pixels[..., i].astype(int) for i in range(3))
        rows, columns = np.nonzero((red - blue > 90) & (red - green > 50))
        assert rows.size > 1000, picture.title
        assert abs(columns.mean() / width - 0.5) < 0.15, picture.title
        assert 0.2 < rows.mean() / height < 0.8, picture.title
