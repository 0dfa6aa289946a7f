import math

import numpy as np
import pytest

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import (
    CORNERS,
    corner_numbers,
    leg_corners,
    lowest_corner,
    reference_corner,
    up_branch,
)

LEG = LegGeometry()


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def test_names_and_numbers_of_corners_mean_the_same():
    assert corner_numbers("E2") == 2
    assert corner_numbers(3) == 3
    np.testing.assert_array_equal(corner_numbers(CORNERS), (1, 2, 3))
    np.testing.assert_array_equal(corner_numbers(np.array([["E3", "E1"]])), [[3, 1]])
    np.testing.assert_array_equal(corner_numbers([1, 2, 3]), (1, 2, 3))
    np.testing.assert_array_equal(corner_numbers(np.array(["E1", "E2"], dtype=object)), (1, 2))


@pytest.mark.parametrize(
    "reference", ["E4", "e1", "", 0, 4, -1, 1.5, math.nan, None, True, ["E1", "E0"], [1, 4]]
)
def test_a_corner_that_does_not_exist_is_refused_with_those_that_do(reference):
    with pytest.raises(ValueError, match=r"one of E1, E2, E3 or its number 1, 2, 3, not"):
        corner_numbers(reference)


def test_the_first_unknown_corner_is_named():
    with pytest.raises(ValueError, match="not 'E9'"):
        corner_numbers(["E1", "E9", "E8"])


def test_corners_are_looked_up_per_element():
    np.testing.assert_array_equal(reference_corner(LEG, ["E3", "E1"]), LEG.corners[[2, 0]])


@pytest.mark.parametrize(("beta", "corner"), [(-0.1, 1), (0.0, 1), (0.1, 2)])
def test_rule_of_the_lowest_corner_without_side_swing(beta, corner):
    assert lowest_corner(LEG, (0.7, 0.0, beta)) == corner


@pytest.mark.parametrize("reference", CORNERS)
def test_the_rule_may_be_asked_with_any_corner(reference):
    for ahead in (-0.1, -0.01, 0.01, 0.1):
        point = LEG.corners[CORNERS.index(reference)] + (0.0, ahead, -0.78)
        found = lowest_corner(LEG, up_branch(LEG, point, reference))
        assert found == (2 if ahead > 0.0 else 1)


def test_no_corner_is_lower_than_the_lowest_in_any_attitude_of_the_leg():
    rng = np.random.default_rng(1)
    up = rng.uniform((0.6, -0.5, -0.5), (0.85, 0.5, 0.5), (200, 3))
    tilt = rng.uniform(-0.3, 0.3, 200)
    c, s, o, i = np.cos(tilt), np.sin(tilt), np.zeros(200), np.ones(200)
    rotation = turned(2.0) @ np.moveaxis(np.array(((i, o, o), (o, c, -s), (o, s, c))), -1, 0)
    heights = np.einsum("nij,nkj->nki", rotation, leg_corners(LEG, up))[..., 2]
    found = lowest_corner(LEG, up, rotation) - 1
    assert set(found) == {0, 1, 2}
    np.testing.assert_allclose(
        np.take_along_axis(heights, found[:, None], axis=1)[:, 0], heights.min(axis=1), atol=1e-15
    )
