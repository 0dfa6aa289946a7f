"""The levelling platform's chapter: what its claims and errata hang on."""

import re
from dataclasses import replace

import pytest

from parapod.sims.levelling_platform.report import errata as errata_module
from parapod.sims.levelling_platform.report.chapter import CHAPTER
from parapod.sims.levelling_platform.report.errata import ERRATA
from parapod.sims.output.results import Metric, Result
from parapod.sims.report.chapter import Numbers, Tone
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


def test_every_printed_number_has_a_verdict_and_the_bad_ones_are_known(finished_chapter):
    quick = finished_chapter(CHAPTER)
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


def test_the_quick_report_claims_no_more_of_the_campaign_than_was_run():
    (part,) = (part for part in CHAPTER.parts if part.name == "fault-campaign")
    assert {"device=encoder", "phase=posture"} <= {*part.quick}
    assert "every device in every phase" in part.text
    done, left = part.quick_text.split(" The whole campaign ")
    assert (
        "Every kind of fault is injected into an encoder while the platform takes a posture"
        in done
    )
    assert not re.search("every (device|phase)", done)
    assert re.search("every device and phase", left)
