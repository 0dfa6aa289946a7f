from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.checks import SpeedExceeded, StrokeExceeded, check_gait
from parapod.systems.walking_chair.gait import DIRECTIONS, ORDERS, TrotGait, gait_branches
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.trajectories import MOTION_LAWS

CHAIR, GAIT = ChairGeometry(), TrotGait()


@pytest.mark.parametrize("law", MOTION_LAWS)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("direction", DIRECTIONS)
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
