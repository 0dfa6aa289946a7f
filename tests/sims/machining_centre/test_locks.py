import numpy as np
import pytest

from parapod.diagrams.machining_centre.held_centre import make_held_centre
from parapod.sims.machining_centre.locks import fall
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.swing import LockSet

HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))


def test_a_quick_run_holds_its_bounds_and_lists_every_pair(finished):
    run = finished("centre-locks")
    assert run.result.broken == ()
    pairs = {row["locked"]: row for row in run.result.details["pairs"]}
    assert len(pairs) == 28
    assert pairs["q6 of 2, q6 of 3"]["sunk_mm"] == pytest.approx(477.0, abs=3.0)
    assert pairs["q1 of 2, q1 of 3"]["sunk_mm"] < 1.0
    assert pairs["q1 of 2, q1 of 3"]["holding"] == pytest.approx(0.0546, abs=1e-3)


def test_the_paper_s_pair_does_not_determine_the_platform_and_another_does(finished):
    values = finished("centre-locks").values
    assert values["paper_sigma"] < 1e-9
    assert values["best_sigma"] > 0.05
    assert values["best_sigma_around"] > 10.0 * values["paper_sigma_around"]
    assert values["pairs_fallen"] == 1


def test_pairs_are_listed_from_the_best_to_the_worst(finished):
    sigmas = [row["sigma_around"] for row in finished("centre-locks").result.details["pairs"]]
    assert sigmas == sorted(sigmas, reverse=True)


def test_a_height_out_of_the_stroke_is_refused_with_the_leg(execute):
    with pytest.raises(UnreachablePosture, match=r"leg 1 would need an extension of 327\.\d\d mm"):
        execute("centre-locks", "height_mm=300", "poses=10")


def test_locks_hold_a_tripod_that_falls_without_them():
    bench = make_held_centre(CentreGeometry(3), 1e-3)
    printed = LockSet.printed(CentreGeometry(3), 1)
    sunk, drift = fall(bench, HOME, 1, printed.joints, 0.3)
    assert sunk < 1e-3
    assert drift == 0.0
    assert fall(bench, HOME, 1, (), 0.3)[0] == pytest.approx(0.145, abs=0.005)


def test_three_limbs_hold_a_quadruped():
    bench = make_held_centre(CentreGeometry(4), 1e-3)
    assert fall(bench, HOME, 1, LockSet(1).joints, 0.3)[0] < 1e-3
