import math

import numpy as np
import pytest

from parapod.sims.lab.discovery import find_entry
from parapod.systems.terrain_simulator.kinematics import (
    BenchGeometry,
    slider_forces,
    slider_rates,
)


def test_the_offset_of_table_2_and_the_boxes_come_out(finished):
    values = finished("bench-workspace").values
    assert values["alpha_deg"] == 33
    assert values["largest_box_mm"] == pytest.approx(366.5, abs=1.0)
    assert values["treadmill_box_mm"] == pytest.approx(457.0, abs=1.0)
    assert values["orientations_with_box"] == 0
    assert values["area_change"] < 1e-3
    assert values["least_width_mm"] == pytest.approx(534.0, abs=1.0)
    assert values["least_height_mm"] == pytest.approx(131.0, abs=1.0)
    assert values["pedal_down_area_m2"] == pytest.approx(0.0704, rel=1e-3)
    assert values["pedal_down_guarded_m2"] == pytest.approx(0.0402, rel=1e-3)


def test_speeds_and_forces_are_those_of_a_place_in_the_box(finished):
    run = finished("bench-workspace")
    for name, most in (("pedal", 45.0), ("treadmill", 14.0)):
        geometry = getattr(BenchGeometry, name)()
        x_min, x_max, z_min, z_max = run.result.details["boxes_m"][name]
        rng = np.random.default_rng(0)
        tilt = math.radians(most)
        pose = rng.uniform((x_min, z_min, -tilt), (x_max, z_max, tilt), (20_000, 3))
        up = np.abs(slider_rates(geometry, pose, (0.0, 2.5, 0.0))).max()
        turn = np.abs(slider_rates(geometry, pose, (0.0, 0.0, math.radians(900.0)))).max()
        loads = [slider_forces(geometry, pose, (x, -1000.0, 0.0)) for x in (-500.0, 500.0)]
        for key, found in (
            ("vertical_m_s", up),
            ("turning_m_s", turn),
            ("force_N", np.abs(loads).max()),
        ):
            # Random places come near to the worst and do not pass it.
            assert 0.85 * run.values[f"{name}_{key}"] < found <= run.values[f"{name}_{key}"]


def test_boxes_shrink_with_their_height_and_with_the_distance_from_the_line(execute):
    def box(*overrides):
        result = execute("bench-workspace", "cells=1000", *overrides)
        return {metric.key: metric.value for metric in result.metrics}["largest_box_mm"]

    usual = box()
    assert box("box_height_mm=50") > usual + 20.0
    # With 0.25 the height ends before the width does.
    assert box("least_sin_mu=0.3") < usual
    assert box("box_height_mm=200") == 0.0


def test_a_box_that_is_possible_nowhere_leaves_its_numbers_out(execute):
    result = execute("bench-workspace", "box_height_mm=300", "cells=500")
    keys = {metric.key for metric in result.metrics}
    assert "largest_box_mm" in keys
    assert "pedal_force_N" not in keys
    assert len(result.notes) == 1


def test_its_boxes_are_told_in_details(finished):
    details = finished("bench-workspace").result.details
    assert set(details["extents_m"]) == {
        f"{name} {way}" for name in ("pedal", "treadmill") for way in ("up", "level", "down")
    }
    assert find_entry("bench-workspace").group == "The terrain simulator"
