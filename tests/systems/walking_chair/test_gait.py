import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.gait import TrotGait

GAIT = TrotGait()


def test_one_cycle_takes_25_seconds_of_five_phases():
    assert GAIT.phases == ("lift", "first swing", "shift", "second swing", "lower")
    assert GAIT.duration == 25.0


def test_further_cycles_repeat_the_three_steps_between_one_lift_and_one_lowering():
    gait = TrotGait(cycles=3)
    assert gait.phases == (
        "lift", *("first swing", "shift", "second swing") * 3, "lower"
    )  # fmt: skip
    assert gait.duration == 55.0


@pytest.mark.parametrize(
    ("order", "pairs"), [("13-24", ((0, 2), (1, 3))), ("24-13", ((1, 3), (0, 2)))]
)
def test_order_names_the_pairs(order, pairs):
    assert TrotGait(order=order).pairs == pairs


def test_direction_is_the_sign_of_the_step():
    assert GAIT.signed_step == 0.1027
    assert TrotGait(direction="back").signed_step == -0.1027


def test_times_belong_to_the_phase_that_they_are_in():
    index, share = GAIT.locate([-1.0, 2.5, 6.0, 24.0, 30.0])
    assert index.tolist() == [-1, 0, 1, 4, 5]
    np.testing.assert_allclose(share[1:4], (0.5, 0.2, 0.8), rtol=1e-14)


def test_a_time_between_two_phases_belongs_to_the_one_on_the_side_asked_for():
    ends = 5.0 * np.arange(6)
    right, share = GAIT.locate(ends)
    assert right.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(share, 0.0)
    left, share = GAIT.locate(ends, "left")
    assert left.tolist() == [-1, 0, 1, 2, 3, 4]
    np.testing.assert_array_equal(share[1:], 1.0)


@pytest.mark.parametrize("time", [math.nan, math.inf, [0.0, math.nan]])
def test_a_time_that_is_not_finite_is_refused(time):
    with pytest.raises(ValueError, match="times must be finite"):
        GAIT.locate(time)


def test_an_unknown_side_is_refused_with_those_that_are():
    with pytest.raises(ValueError, match="one of right, left, not 'middle'"):
        GAIT.locate(0.0, "middle")


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("order", "12-34", "13-24, 24-13"),
        ("direction", "sideways", "forward, back"),
        ("body_law", "cubic", "linear, ramped, cycloid, quintic"),
    ],
)
def test_unknown_names_are_refused_with_the_admissible_ones(name, value, allowed):
    with pytest.raises(ValueError, match=f"{name} must be one of {allowed}, not '{value}'"):
        replace(GAIT, **{name: value})


@pytest.mark.parametrize("cycles", [0, -1, 1.5, "2"])
def test_cycles_are_counted(cycles):
    with pytest.raises(ValueError, match="cycles must be a whole number"):
        TrotGait(cycles=cycles)


@pytest.mark.parametrize("name", ["lift", "step", "swing_height", "phase_duration"])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_sizes_that_are_not_positive_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} must be positive"):
        replace(GAIT, **{name: value})


@pytest.mark.parametrize("start", [(0.0,), (0.0, math.nan), (0.0, 0.0, 0.0)])
def test_a_start_that_is_no_place_is_refused(start):
    with pytest.raises(ValueError, match="start must be two finite numbers"):
        replace(GAIT, start=start)


def test_feet_that_stand_are_those_that_do_not_swing():
    gait = TrotGait(order="24-13", cycles=2)
    assert len(gait.standing) == len(gait.phases) == 8
    swinging = [tuple(leg + 1 for leg in range(4) if not row[leg]) for row in gait.standing]
    assert swinging == [(), (2, 4), (), (1, 3), (2, 4), (), (1, 3), ()]


@pytest.mark.parametrize(
    ("time", "side", "phase"),
    [(-1.0, "right", 0), (0.0, "left", 0), (5.0, "right", 1), (5.0, "left", 0), (7.0, "left", 1),
     (24.9, "right", 4), (25.0, "right", 4), (99.0, "right", 4)],
)  # fmt: skip
def test_a_time_has_a_phase_even_before_and_after_the_gait(time, side, phase):
    assert TrotGait().phase_at(time, side) == phase


def test_the_reversed_gait_leads_back_to_the_start():
    gait = TrotGait(cycles=3, start=(0.1, -0.2))
    back = gait.reversed()
    assert back.direction == "back"
    assert back.start == gait.end == pytest.approx((0.1, -0.2 + 3 * gait.step))
    assert back.end == pytest.approx(gait.start)
    assert back.reversed().direction == "forward"
