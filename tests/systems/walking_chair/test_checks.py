"""Refusals of lengths, speeds and forces that a branch cannot have."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.errors import ParapodError
from parapod.systems.walking_chair.checks import (
    ForceExceeded,
    SpeedExceeded,
    StrokeExceeded,
    check_forces,
    check_gait,
    check_speeds,
    check_strokes,
    refuse_forces,
    stroke_excess,
)
from parapod.systems.walking_chair.gait import (
    TrotGait,
    Walk,
    gait_branches,
    there_and_back,
)
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.masses import Passenger

LEG = LegGeometry()


def lengths(count=3):
    return np.full((count, 4, 3), 0.7)


def test_excess_is_the_distance_to_the_nearer_end():
    excess = stroke_excess(LEG, (0.5904, 0.584, 0.875))
    np.testing.assert_allclose(excess, (1e-3, -0.010, 1e-3), rtol=0, atol=1e-15)
    assert np.isnan(stroke_excess(LEG, (math.nan, 0.6, 0.6))).tolist() == [True, False, False]


def test_lengths_at_both_ends_of_the_strokes_are_admissible():
    low, high = LEG.strokes.T
    check_strokes(LEG, np.broadcast_to(low, (4, 3)))
    check_strokes(LEG, np.broadcast_to(high, (4, 3)))


def test_the_branch_furthest_outside_is_named_with_its_time_and_length():
    bad = lengths()
    bad[1, 0, 2], bad[2, 2, 1] = 0.5735, 0.5711
    with pytest.raises(StrokeExceeded) as caught:
        check_strokes(LEG, bad, (0.0, 2.0, 7.5))
    error = caught.value
    assert (error.branch, error.time, error.length) == ("branch 32", 7.5, 0.5711)
    assert error.admissible == pytest.approx((0.574, 0.874), abs=1e-15)
    assert error.missing == pytest.approx(2.9e-3, abs=1e-15)
    assert str(error) == (
        "branch 32 would need a length of 571.100 mm at 7.500 s, 2.900 mm outside its stroke "
        "574.0..874.0 mm"
    )


@pytest.mark.parametrize("value", [0.5913, 0.8915])
def test_both_ends_of_the_up_stroke_are_checked(value):
    bad = lengths()[0]
    bad[3, 0] = value
    with pytest.raises(StrokeExceeded, match=r"branch 41 .* stroke 591.4..891.4 mm") as caught:
        check_strokes(LEG, bad)
    assert caught.value.time is None
    assert " s," not in str(caught.value)


def test_a_branch_without_a_length_is_worse_than_any_other():
    bad = lengths()
    bad[0, 0, 0], bad[1, 1, 1] = 0.1, math.nan
    with pytest.raises(StrokeExceeded, match=r"branch 22 has no length .* at 1.000 s") as caught:
        check_strokes(LEG, bad, (0.0, 1.0, 2.0))
    assert math.isnan(caught.value.length)


def test_chosen_legs_are_named_by_their_numbers():
    with pytest.raises(StrokeExceeded, match="branch 33"):
        check_strokes(LEG, [[0.7, 0.7, 0.9]], legs=(3,))
    with pytest.raises(SpeedExceeded, match="branch 33"):
        check_speeds([[0.0, 0.0, 0.1]], 0.08, legs=(3,))


def test_speeds_up_to_the_limit_are_admissible_either_way():
    check_speeds(np.full((4, 3), 0.08), 0.08)
    check_speeds(np.full((4, 3), -0.08), 0.08)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_fastest_branch_is_named_with_its_time_and_speed(sign):
    bad = np.zeros((2, 4, 3))
    bad[0, 1, 0], bad[1, 0, 1] = 0.081, sign * 0.0852
    with pytest.raises(SpeedExceeded) as caught:
        check_speeds(bad, 0.08, (1.0, 6.308))
    error = caught.value
    assert (error.branch, error.time, error.speed, error.limit) == (
        "branch 12", 6.308, 0.0852, 0.08
    )  # fmt: skip
    assert str(error) == (
        "branch 12 would move at 85.200 mm/s at 6.308 s, 5.200 mm/s faster than its limit "
        "80.0 mm/s"
    )


def test_of_equally_fast_branches_the_first_is_named():
    bad = np.zeros((2, 4, 3))
    bad[0, 2, 1], bad[1, 0, 0] = 0.09, 0.09 + 1e-15
    with pytest.raises(SpeedExceeded, match=r"branch 32 .* at 1\.000 s"):
        check_speeds(bad, 0.08, (1.0, 2.0))


def test_a_speed_that_is_not_a_number_is_refused():
    bad = np.zeros((4, 3))
    bad[2, 0] = math.nan
    with pytest.raises(SpeedExceeded, match="branch 31"):
        check_speeds(bad, 0.08)


def test_no_postures_exceed_nothing():
    check_strokes(LEG, np.zeros((0, 4, 3)), np.zeros(0))
    check_speeds(np.zeros((0, 4, 3)), 0.08)


@pytest.mark.parametrize("value", [np.zeros(3), np.zeros((3, 3)), np.zeros((4, 2))])
def test_other_shapes_are_refused(value):
    with pytest.raises(ValueError, match="length must have shape"):
        check_strokes(LEG, value)


def test_errors_are_parapods_and_survive_the_way_from_another_process():
    for error in (
        StrokeExceeded("branch 12", 1.0, 0.5, (0.574, 0.874)),
        SpeedExceeded("branch 12", 1.0, 0.1, 0.08),
    ):
        assert isinstance(error, ParapodError)
        again = pickle.loads(pickle.dumps(error))
        assert str(again) == str(error)
        assert again.branch == "branch 12"


CHAIR, GAIT = ChairGeometry(), TrotGait()


@pytest.mark.parametrize(
    ("law", "order", "direction"),
    [
        ("linear", "13-24", "forward"),
        ("ramped", "24-13", "back"),
        ("cycloid", "13-24", "back"),
        ("quintic", "24-13", "forward"),
    ],
)
def test_actuators_can_do_the_papers_gait_with_any_law(law, order, direction):
    check_gait(CHAIR, TrotGait(order=order, direction=direction, body_law=law, cycles=2))


def test_least_lift():
    check_gait(CHAIR, replace(GAIT, lift=0.112513))
    with pytest.raises(StrokeExceeded, match=r"branch 12 .* at 7\.58") as caught:
        check_gait(CHAIR, replace(GAIT, lift=0.112512))
    assert caught.value.length < 0.574
    assert caught.value.missing < 1e-6


def test_missing_length_for_a_lift_that_is_too_small_is_named():
    with pytest.raises(StrokeExceeded) as caught:
        check_gait(CHAIR, replace(GAIT, lift=0.100))
    shortest = gait_branches(CHAIR, replace(GAIT, lift=0.100), np.linspace(5.0, 10.0, 20001))
    assert caught.value.length == pytest.approx(shortest.length[..., 1].min(), abs=3e-7)
    assert 5.0 < caught.value.time < 10.0


def test_shortest_duration_of_a_phase():
    check_gait(CHAIR, replace(GAIT, phase_duration=4.698))
    with pytest.raises(SpeedExceeded, match="branch 12") as caught:
        check_gait(CHAIR, replace(GAIT, phase_duration=4.697))
    assert caught.value.limit == 0.080
    assert 0.080 < caught.value.speed < 0.08002


def test_fastest_branch_of_the_papers_gait_is_named_with_its_time():
    with pytest.raises(SpeedExceeded, match="branch 12") as caught:
        check_gait(CHAIR, GAIT, speed_limit=0.075)
    assert 1e3 * caught.value.speed == pytest.approx(75.163, abs=1e-3)
    assert caught.value.time == pytest.approx(6.308, abs=5e-3)
    check_gait(CHAIR, GAIT, speed_limit=0.0752)


def test_a_body_law_may_be_too_fast_although_the_swing_is_not():
    slow = replace(GAIT, swing_height=0.010, step=0.010)
    check_gait(CHAIR, slow, speed_limit=0.030)
    with pytest.raises(SpeedExceeded) as caught:
        check_gait(CHAIR, replace(slow, body_law="cycloid"), speed_limit=0.030)
    assert 1e3 * caught.value.speed == pytest.approx(45.88, abs=0.01)


@pytest.mark.parametrize("step", [0.3, 0.9])
def test_a_step_that_is_too_long_is_refused(step):
    with pytest.raises(StrokeExceeded):
        check_gait(CHAIR, replace(GAIT, step=step))


def test_a_swing_out_of_reach_is_refused():
    with pytest.raises(StrokeExceeded, match="has no length"):
        check_gait(CHAIR, replace(GAIT, swing_height=0.9))


def test_many_cycles_are_checked_as_fast_as_one():
    check_gait(CHAIR, replace(GAIT, cycles=10**6))


def test_the_papers_passenger_is_carried():
    check_forces(CHAIR, there_and_back(TrotGait()), Passenger(57.0))


def test_equally_stiff_branches_carry_what_the_best_distribution_does():
    # Linear programming gives 168.588 kg without friction; springs that share alike are near it.
    check_forces(CHAIR, Walk(), Passenger(140.0))
    with pytest.raises(ForceExceeded):
        check_forces(CHAIR, Walk(), Passenger(175.0))


def test_the_error_names_branch_time_and_limit():
    with pytest.raises(ForceExceeded) as caught:
        check_forces(CHAIR, Walk(), Passenger(57.0, 0.05, 0.0), limit=150.0)
    error = caught.value
    assert error.branch.startswith("branch ")
    assert 0.0 <= error.time <= 25.0
    assert abs(error.force) > error.limit == 150.0
    text = str(error)
    assert "\n" not in text
    assert error.branch in text
    assert f"{error.time:.3f} s" in text
    assert "150.0 N" in text


@pytest.mark.parametrize("noise", [1e-12, -1e-12])
def test_of_forces_that_differ_by_rounding_the_first_is_named(noise):
    # Mirrored legs bear alike: which is a bit larger differs between processors.
    forces = np.array([[1.0, 2.0, 2.0], [2.0 + noise, -2.0 - noise, 1.0]])
    with pytest.raises(ForceExceeded) as caught:
        refuse_forces(forces, 1.5, np.array([3.0, 7.0]), ("branch 11", "branch 12", "branch 13"))
    assert (caught.value.branch, caught.value.time, caught.value.force) == ("branch 12", 3.0, 2.0)


def test_the_largest_force_is_that_of_two_legs():
    with pytest.raises(ForceExceeded) as caught:
        check_forces(CHAIR, Walk(), Passenger(57.0), limit=1.0)
    standing = np.array(Walk().standing)[Walk().phase_at(caught.value.time)]
    assert standing.sum() == 2


@pytest.mark.parametrize("passenger", [Passenger(57.0, 0.0, 0.05), Passenger(57.0, 0.1, 0.1)])
def test_a_gait_that_takes_longer_exceeds_the_same_force_at_the_same_share_of_its_time(passenger):
    """At rest forces depend on where feet and body are; five instants a phase are looked at."""
    found = []
    for duration in (5.0, 3.0, 0.7):
        walk = Walk((TrotGait(phase_duration=duration),))
        with pytest.raises(ForceExceeded) as caught:
            check_forces(CHAIR, walk, passenger, limit=1.0)
        instant = 5.0 * caught.value.time / duration
        assert instant == pytest.approx(round(instant), abs=1e-9)
        found.append((round(instant), caught.value.branch, caught.value.force))
    for instant, branch, force in found[1:]:
        assert (instant, branch) == found[0][:2]
        assert force == pytest.approx(found[0][2], rel=1e-9)
