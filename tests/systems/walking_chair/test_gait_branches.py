from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.motion_laws import MOTION_LAWS
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import DIRECTIONS, TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR, GAIT = ChairGeometry(), TrotGait()
TIMES = np.linspace(0.0, 25.0, 5001)
ENDS = 5.0 * np.arange(6)
# A leg's UP and UPS lengths in mm, and those of the other legs, section by section.
HOME, LIFTED = (591.400, 574.002), (706.100, 687.769)
BEHIND_HALF, AHEAD_HALF = (707.913, 677.391), (700.545, 694.406)
BEHIND, AHEAD = (713.327, 670.683), (698.626, 704.513)
UP_BEHIND, UP_AHEAD = (608.202, 576.551), (599.649, 596.227)
TABLE = {
    0.0: (HOME, HOME, HOME, HOME),
    5.0: (LIFTED, LIFTED, LIFTED, LIFTED),
    7.5: (UP_BEHIND, LIFTED, UP_AHEAD, LIFTED),
    10.0: (BEHIND, LIFTED, AHEAD, LIFTED),
    12.5: (BEHIND_HALF, AHEAD_HALF, AHEAD_HALF, BEHIND_HALF),
    15.0: (LIFTED, AHEAD, LIFTED, BEHIND),
    17.5: (LIFTED, UP_AHEAD, LIFTED, UP_BEHIND),
    20.0: (LIFTED, LIFTED, LIFTED, LIFTED),
    25.0: (HOME, HOME, HOME, HOME),
}
# The same with E_1 as every foot's reference.
TABLE_OF_E1 = {
    7.5: (UP_BEHIND, LIFTED, (608.202, 604.610), LIFTED),
    10.0: (BEHIND, LIFTED, (713.327, 718.886), LIFTED),
    12.5: (BEHIND_HALF, (707.913, 701.665), (707.913, 701.665), BEHIND_HALF),
    15.0: (LIFTED, (713.327, 718.886), LIFTED, BEHIND),
    17.5: (LIFTED, (608.202, 604.610), LIFTED, UP_BEHIND),
}


def velocity_steps(gait, branches=None):
    """Largest jump of a branch's velocity at each end of a phase [mm/s]."""
    branches = branches or (lambda side: gait_branches(CHAIR, gait, ENDS, side))
    jump = branches("right").velocity - branches("left").velocity
    return 1e3 * np.abs(jump).max(axis=(1, 2))


def peaks(gait, start):
    """Largest speed and acceleration of the branches within the phase that starts then [mm]."""
    found = gait_branches(CHAIR, gait, np.linspace(start + 1e-9, start + 5.0 - 1e-9, 2001))
    return 1e3 * np.abs(found.velocity).max(), 1e3 * np.abs(found.acceleration).max()


# The paper's gait


@pytest.mark.parametrize("time", TABLE)
def test_table_of_lengths(time):
    length = 1e3 * gait_branches(CHAIR, GAIT, time).length
    np.testing.assert_allclose(length[:, :2], TABLE[time], rtol=0, atol=1e-3)
    np.testing.assert_allclose(length[:, 2], length[:, 1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("time", TABLE_OF_E1)
def test_table_of_lengths_with_the_first_corner_as_every_foots_reference(time, planned_for):
    _, branches = planned_for("E1", GAIT, time)
    np.testing.assert_allclose(1e3 * branches.length[:, :2], TABLE_OF_E1[time], rtol=0, atol=1e-3)


def test_ranges_of_lengths_speeds_and_accelerations():
    length, velocity, acceleration = (1e3 * v for v in gait_branches(CHAIR, GAIT, TIMES))
    up, ups = length[..., 0], length[..., 1:]
    assert (up.min(), up.max()) == pytest.approx((591.400, 713.327), abs=1e-3)
    assert (ups.min(), ups.max()) == pytest.approx((574.002, 704.513), abs=1e-3)
    assert np.abs(velocity[..., 0]).max() == pytest.approx(73.44, abs=0.01)
    assert np.abs(velocity[..., 1:]).max() == pytest.approx(75.163, abs=0.01)
    assert TIMES[np.abs(velocity[:, 0, 1]).argmax()] == pytest.approx(6.31, abs=0.01)
    assert np.abs(acceleration).max() == pytest.approx(92.34, abs=0.01)


@pytest.mark.parametrize(
    ("reference", "ranges", "speeds", "acceleration"),
    [
        ("E1", (591.400, 713.327, 574.002, 718.886), (72.57, 75.16), 92.34),
        ("E2", (591.400, 727.739, 574.002, 704.513), (74.37, 73.21), 92.13),
    ],
)
def test_ranges_with_one_corner_as_every_foots_reference(
    reference, ranges, speeds, acceleration, planned_for
):
    _, found = planned_for(reference, GAIT, TIMES)
    length, velocity, rate = (1e3 * values for values in found)
    up, ups = length[..., 0], length[..., 1:]
    extremes = (up.min(), up.max(), ups.min(), ups.max())
    np.testing.assert_allclose(extremes, ranges, rtol=0, atol=1e-3)
    fastest = (np.abs(velocity[..., 0]).max(), np.abs(velocity[..., 1:]).max())
    np.testing.assert_allclose(fastest, speeds, rtol=0, atol=0.01)
    assert np.abs(rate).max() == pytest.approx(acceleration, abs=0.01)


def test_velocity_steps_of_the_papers_law():
    steps = (22.94, 22.94, 4.87, 4.87, 22.94, 22.94)
    np.testing.assert_allclose(velocity_steps(GAIT), steps, rtol=0, atol=5e-3)


def test_velocity_steps_with_the_first_corner_as_every_foots_reference(planned_for):
    steps = (22.94, 22.94, 7.52, 7.52, 22.94, 22.94)
    found = velocity_steps(GAIT, lambda side: planned_for("E1", GAIT, ENDS, side)[1])
    np.testing.assert_allclose(found, steps, rtol=0, atol=5e-3)


def test_legs_1_and_4_and_legs_2_and_3_are_each_others_time_reversal():
    length = gait_branches(CHAIR, GAIT, TIMES).length
    reverse = gait_branches(CHAIR, GAIT, 25.0 - TIMES).length
    np.testing.assert_allclose(length[:, 0], reverse[:, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(length[:, 1], reverse[:, 2], rtol=0, atol=1e-12)
    assert np.abs(length[:, 0] - length[:, 3]).max() > 0.05


@pytest.mark.parametrize("law", MOTION_LAWS)
def test_velocities_and_accelerations_agree_with_differences(law):
    gait, dt = replace(GAIT, body_law=law), 1e-4
    inside = (5.0 * np.arange(5)[:, None] + np.linspace(0.011, 4.989, 199)).ravel()
    now, ahead, behind = (gait_branches(CHAIR, gait, inside + e) for e in (0.0, dt, -dt))
    numeric = (ahead.length - behind.length) / (2.0 * dt)
    np.testing.assert_allclose(now.velocity, numeric, rtol=0, atol=1e-8)
    numeric = (ahead.velocity - behind.velocity) / (2.0 * dt)
    np.testing.assert_allclose(now.acceleration, numeric, rtol=0, atol=2e-5)


# Smooth laws of the body


def test_acceleration_within_the_papers_body_phases_is_next_to_nothing():
    assert peaks(GAIT, 0.0)[1] == pytest.approx(0.02, abs=5e-3)
    assert peaks(GAIT, 10.0)[1] == pytest.approx(0.60, abs=5e-3)


@pytest.mark.parametrize(
    ("law", "lift", "shift"),
    [
        ("linear", (22.94, 0.02), (4.87, 0.60)),
        ("ramped", (28.68, 45.0), (5.65, 9.2)),
        ("cycloid", (45.88, 28.8), (7.29, 5.4)),
        ("quintic", (43.01, 26.5), (6.87, 5.1)),
    ],
)
def test_peaks_of_the_laws(law, lift, shift):
    gait = replace(GAIT, body_law=law)
    for start, (speed, acceleration) in ((0.0, lift), (10.0, shift)):
        found = peaks(gait, start)
        assert found[0] == pytest.approx(speed, abs=0.01)
        assert found[1] == pytest.approx(acceleration, abs=0.06)


@pytest.mark.parametrize("law", sorted(set(MOTION_LAWS) - {"linear"}))
def test_smooth_laws_have_no_velocity_steps(law):
    np.testing.assert_allclose(velocity_steps(replace(GAIT, body_law=law)), 0.0, atol=1e-9)


# Orders, directions, cycles


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_other_order_is_the_mirror_image(direction):
    gait = replace(GAIT, direction=direction, cycles=2)
    times = np.linspace(0.0, gait.duration, 1001)
    one = gait_branches(CHAIR, gait, times)
    other = gait_branches(CHAIR, replace(gait, order="24-13"), times)
    left_for_right, ups_swapped = [1, 0, 3, 2], [0, 2, 1]
    for values, mirrored in zip(one, other, strict=True):
        np.testing.assert_allclose(
            mirrored[:, left_for_right][..., ups_swapped], values, rtol=0, atol=1e-12
        )


def test_going_back_in_the_other_order_is_the_time_reversal():
    forward = TrotGait(cycles=2)
    back = TrotGait(order="24-13", cycles=2, direction="back", start=(0.0, 2 * 0.1027))
    times = np.linspace(0.0, forward.duration, 1001)
    one, other = (
        gait_branches(CHAIR, forward, times),
        gait_branches(CHAIR, back, forward.duration - times, "left"),
    )
    np.testing.assert_allclose(one.length, other.length, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.velocity, -other.velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.acceleration, other.acceleration, rtol=0, atol=1e-12)
    places = gait_motion(CHAIR, forward, times), gait_motion(CHAIR, back, 40.0 - times)
    np.testing.assert_allclose(places[0].feet.position, places[1].feet.position, atol=1e-12)


@pytest.mark.parametrize("law", MOTION_LAWS)
def test_cycles_are_periodic(law):
    gait = TrotGait(cycles=3, body_law=law)
    in_cycle = np.linspace(5.0, 20.0, 1001)[1:-1]
    once = gait_branches(CHAIR, gait, in_cycle)
    for later in (15.0, 30.0):
        again = gait_branches(CHAIR, gait, in_cycle + later)
        for first, other in zip(once, again, strict=True):
            np.testing.assert_allclose(other, first, rtol=0, atol=1e-12)


def test_first_cycle_of_several_is_the_only_one_of_one():
    several = TrotGait(cycles=3)
    for early in (0.0, 4.0, 9.0, 14.0, 19.9):
        one, other = (gait_branches(CHAIR, gait, early).length for gait in (GAIT, several))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)
    late = 55.0 - 25.0
    one = gait_branches(CHAIR, GAIT, 22.0).length
    np.testing.assert_allclose(gait_branches(CHAIR, several, late + 22.0).length, one, atol=1e-13)


def test_step_beyond_the_legs_reach_gives_nan():
    length = gait_branches(CHAIR, replace(GAIT, step=20.0, lift=1e-3), 10.0).length
    assert np.isfinite(length).all()
    low = replace(GAIT, swing_height=0.9)
    assert np.isnan(gait_branches(CHAIR, low, 7.5).length[0]).all()


def test_lengths_are_those_of_the_chair_for_its_bodies_and_feet():
    motion = gait_motion(CHAIR, GAIT, TIMES)
    lengths = chair_inverse(
        CHAIR, motion.body.position, motion.body.rotation, motion.feet.position, motion.references
    )
    np.testing.assert_allclose(
        gait_branches(CHAIR, GAIT, TIMES).length, lengths, rtol=0, atol=1e-15
    )
