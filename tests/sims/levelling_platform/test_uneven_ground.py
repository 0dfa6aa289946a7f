"""Levelling where the feet stand at different heights."""

import numpy as np
import pytest

from parapod.systems.levelling_platform import ground_estimator

BRIEF = ("job.waypoints=[]", "job.end=8", "job.arm.start=0", "backend=kinematic")


@pytest.mark.parametrize("heights", ["[20, -20, 20, -20]", "[0, 0, 0, 40]"])
def test_uneven_ground_is_levelled_to_the_bounds_of_a_plane(execute, heights):
    found = execute("uneven-ground", f"ground.foot_heights_mm={heights}", *BRIEF)
    assert found.passed
    assert found["unevenness_mm"] == pytest.approx(40.0)
    bounds = {metric.key: metric.bound for metric in found.metrics}
    assert (bounds["roll_error_deg"], bounds["pitch_error_deg"]) == (0.2, 0.2)
    assert bounds["height_error_mm"] == 2.0


def test_on_bodies_all_feet_stay_down(finished):
    assert finished("uneven-ground").values["foot_lift_mm"] < 0.1


def test_a_platform_that_takes_the_ground_for_a_plane_breaks_its_bounds(execute, monkeypatch):
    monkeypatch.setattr(ground_estimator, "unevenness", lambda *arguments: np.zeros(4))
    found = execute("uneven-ground", "ground.foot_heights_mm=[20, -20, 20, -20]", *BRIEF)
    assert {"height_error_mm", "foot_lift_mm"} & {metric.key for metric in found.broken}
