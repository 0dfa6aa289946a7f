import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry, leg_name


def test_pivots_are_on_the_circle_and_at_the_angles_of_figure_5(geometry):
    radii = np.linalg.norm(geometry.pivots, axis=1)
    assert np.allclose(radii, 0.1, atol=1e-15)
    left, right = geometry.pivots[0], geometry.pivots[1]
    assert math.atan2(left[1], left[0]) == pytest.approx(-math.pi / 4)
    assert math.atan2(right[1], right[0]) == pytest.approx(math.pi / 4)
    assert np.allclose(geometry.middles[0], (0.1 * math.cos(math.pi / 4), 0.0, 0.0))


def test_limbs_are_turned_copies_of_the_first(geometry):
    turn = 2.0 * math.pi / geometry.limbs
    R = np.array(
        ((math.cos(turn), -math.sin(turn), 0), (math.sin(turn), math.cos(turn), 0), (0, 0, 1))
    )
    assert np.allclose(geometry.pivots[2:4], geometry.pivots[:2] @ R.T)
    assert np.allclose(geometry.footholds[1, :3], R @ geometry.footholds[0, :3])
    assert geometry.footholds[1, 5] - geometry.footholds[0, 5] == pytest.approx(turn)


def test_pivots_of_neighbours_meet_on_the_quadruped():
    pivots = CentreGeometry(4).pivots
    assert np.allclose(pivots[1::2], np.roll(pivots[0::2], -1, axis=0), atol=1e-15)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("limbs", 7, "one of 3, 4, 5, 6 .3 the tripod, 4 the quadruped"),
        ("platform_radius", -0.1, "platform_radius must be positive"),
        ("pattern_radius", math.nan, "pattern_radius must be positive"),
        ("half_angle", 1.2, "at most pi / limbs"),
        ("stroke_min", 0.7, "less than stroke_max"),
    ],
)
def test_dimensions_that_make_no_centre_are_refused(key, value, says):
    with pytest.raises(ValueError, match=says):
        replace(CentreGeometry(), **{key: value})


def test_legs_are_counted_left_and_right_of_each_limb():
    assert [leg_name(i) for i in (0, 3)] == ["left leg of limb 1", "right leg of limb 2"]
