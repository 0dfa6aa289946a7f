import math
from dataclasses import fields, replace

import numpy as np
import pytest

from parapod.systems.walking_chair.geometry import (
    BRANCHES,
    ChairGeometry,
    LegGeometry,
    LegPlacement,
    branch_names,
)

LEG, CHAIR = LegGeometry(), ChairGeometry()


def test_distances_between_joints_follow_from_table_1():
    assert (LEG.x1, LEG.x2, LEG.x3) == pytest.approx((0.054, 0.020, 0.043), abs=1e-15)
    assert LEG.ups_extra == pytest.approx(0.133, abs=1e-15)


def test_strokes_are_the_printed_ranges():
    np.testing.assert_allclose(LEG.up_stroke, (0.5914, 0.8914), rtol=0, atol=1e-15)
    np.testing.assert_allclose(LEG.ups_stroke, (0.574, 0.874), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(LEG.strokes, (LEG.up_stroke, LEG.ups_stroke, LEG.ups_stroke))


def test_retracted_height_is_the_printed_one():
    assert LEG.retracted_height == pytest.approx(0.6654, abs=1e-15)


def test_triangles_are_equilateral_and_go_round_counter_clockwise():
    for corners, side in ((LEG.upper_joints, LEG.a), (LEG.corners, LEG.b)):
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        np.testing.assert_allclose(sides, side, rtol=1e-14)
        assert np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] > 0.0


def test_lower_joints_are_above_the_corners():
    np.testing.assert_array_equal(LEG.lower_joints[:, :2], LEG.corners[:, :2])
    np.testing.assert_array_equal(LEG.lower_joints[:, 2], (LEG.x2, LEG.x3, LEG.x3))


@pytest.mark.parametrize("name", [field.name for field in fields(LegGeometry)])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_a_size_that_is_not_a_positive_length_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} must be a positive length"):
        replace(LEG, **{name: value})


def test_an_actuator_that_is_longest_when_retracted_is_refused():
    with pytest.raises(ValueError, match=r"actuator_min = 0.8 m .* actuator_max = 0.741 m"):
        replace(LEG, actuator_min=0.8)


def test_shared_arrays_cannot_be_changed():
    for array in (LEG.strokes, LEG.corners, CHAIR.R_SA, CHAIR.p_SA):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_up_branches_hang_outwards_and_the_centroids_where_they_are_placed():
    y = 0.1423 + 0.2 / math.sqrt(3.0)
    expected = [(-0.155, -y, 0), (0.155, -y, 0), (0.155, y, 0), (-0.155, y, 0)]
    np.testing.assert_allclose(CHAIR.p_SA, expected, rtol=0, atol=1e-15)
    assert y == pytest.approx(0.25777, abs=1e-5)
    hinges = LEG.upper_joints * (1.0, 1.0, 0.0)
    centroids = CHAIR.p_SA + np.einsum("lij,j->li", CHAIR.R_SA, hinges.mean(axis=0))
    places = [(place.x, place.y, 0.0) for place in CHAIR.placements]
    np.testing.assert_allclose(centroids, places, rtol=0, atol=1e-15)


def test_legs_1_and_4_are_on_one_side_turned_against_each_other_and_so_are_2_and_3():
    for one, other in ((0, 3), (1, 2)):
        first, second = CHAIR.placements[one], CHAIR.placements[other]
        assert first.x == second.x
        assert first.turned != second.turned


def test_turned_legs_are_turned_by_half_a_turn_about_z():
    for placement, rotation in zip(CHAIR.placements, CHAIR.R_SA, strict=True):
        np.testing.assert_array_equal(
            np.diag(rotation), (-1, -1, 1) if placement.turned else (1, 1, 1)
        )
        assert np.linalg.det(rotation) == 1.0


@pytest.mark.parametrize("count", [0, 3, 5])
def test_a_wrong_number_of_legs_is_refused(count):
    with pytest.raises(ValueError, match=f"placements must be 4, not {count}"):
        ChairGeometry(placements=(LegPlacement(0.0, 0.0, False),) * count)


@pytest.mark.parametrize("place", [(math.nan, 0.0), (0.0, math.inf)])
def test_a_leg_without_a_place_is_refused(place):
    with pytest.raises(ValueError, match="a leg cannot be placed at"):
        LegPlacement(*place, turned=False)


def test_branches_are_named_by_leg_and_number():
    assert len(BRANCHES) == 12
    assert BRANCHES[:4] == ("branch 11", "branch 12", "branch 13", "branch 21")
    assert BRANCHES[-1] == "branch 43"


def test_names_of_chosen_legs_alone():
    assert branch_names((3,)) == ("branch 31", "branch 32", "branch 33")
