import pytest

from parapod.systems.core.errors import UnreachablePosture


def test_a_quick_run_holds_its_bounds_and_lists_every_pair(finished):
    run = finished("center-locks")
    assert run.result.broken == ()
    pairs = {row["locked"]: row for row in run.result.details["pairs"]}
    assert len(pairs) == 28
    assert pairs["q6 of 2, q6 of 3"]["sunk_mm"] == pytest.approx(477.0, abs=3.0)
    assert pairs["q1 of 2, q1 of 3"]["sunk_mm"] < 1.0
    assert pairs["q1 of 2, q1 of 3"]["holding"] == pytest.approx(0.0546, abs=1e-3)


def test_the_paper_s_pair_does_not_determine_the_platform_and_another_does(finished):
    values = finished("center-locks").values
    assert values["paper_sigma"] < 1e-9
    assert values["best_sigma"] > 0.05
    assert values["best_sigma_around"] > 10.0 * values["paper_sigma_around"]
    assert values["pairs_fallen"] == 1


def test_pairs_are_listed_from_the_best_to_the_worst(finished):
    sigmas = [row["sigma_around"] for row in finished("center-locks").result.details["pairs"]]
    assert sigmas == sorted(sigmas, reverse=True)


def test_a_height_out_of_the_stroke_is_refused_with_the_leg(execute):
    with pytest.raises(UnreachablePosture, match=r"leg 1 would need an extension of 327\.\d\d mm"):
        execute("center-locks", "height_mm=300", "poses=10")
