import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.paths import (
    Speeds,
    duration_of,
    foot_at,
    platform_at,
    swing_duration,
)
from parapod.systems.machining_centre.platform_mode import displacement

SHARES = np.linspace(0.0, 1.0, 201)
# Limits of which now this one counts, now that one.
LIMITS = {
    "speed": Speeds(acceleration=100.0),
    "acceleration": Speeds(rapid=1.0, swing=1.0, acceleration=0.25),
    "both": Speeds(rapid=0.06, turn=0.26, swing=0.08, acceleration=0.3),
}


def third_axis(pose):
    return Rotation.from_euler("xyz", pose[3:]).as_matrix()[:, 2]


def platform_ways(count=24):
    rng = np.random.default_rng(0)
    for _ in range(count):
        far, turned = 10.0 ** rng.uniform(-3.5, -0.5), 10.0 ** rng.uniform(-3.5, -0.5)
        start, by = rng.uniform(-0.3, 0.3, (2, 6))
        yield start, start + by * np.repeat((far, turned), 3)


def foot_ways(radius, count=24):
    """Footholds on a panel, from one to the other, and lifts."""
    rng, panel = np.random.default_rng(1), Panel(radius)
    for k in range(count):
        along, across, yaw = rng.uniform(-0.3, 0.3, 3)
        far = 10.0 ** rng.uniform(-3.0, -0.7)
        to = (along + far * rng.normal(), across + far * rng.normal())
        goal = panel.frame(*to, yaw + (k % 2) * rng.uniform(-0.5, 0.5))
        yield panel.frame(along, across, yaw), goal, 10.0 ** rng.uniform(-2.5, -1.0)


def derivatives(poses, duration):
    """Largest speed, acceleration, and speed of rotation on a way of equal steps."""
    step = duration / (len(poses) - 1)
    places, turned = poses[:, :3], Rotation.from_euler("xyz", poses[:, 3:])
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / step
    acceleration = np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / step**2
    turn = (turned[1:] * turned[:-1].inv()).magnitude().max() / step
    return np.array((speed, acceleration, turn))


def sampled_foot(start, end, lift, shares=SHARES):
    by = displacement(start, end)
    return np.array([foot_at(start, end, by, lift, share) for share in shares])


def sampled_platform(start, end):
    by = displacement(start, end)
    return np.array([platform_at(start, by, share) for share in SHARES])


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
def test_the_platform_keeps_its_limits_and_reaches_one(limits):
    of = np.array((limits.rapid, limits.acceleration, limits.turn))
    for start, end in platform_ways():
        duration = duration_of(start, end, limits, limits.rapid)
        shares = derivatives(sampled_platform(start, end), duration) / of
        assert shares.max() <= 1.0 + 1e-9
        assert shares.max() > 0.999 or duration == pytest.approx(0.05)


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
def test_a_foot_keeps_its_limits_and_some_foot_reaches_one(limits):
    of, largest = np.array((limits.swing, limits.acceleration, limits.turn)), 0.0
    for start, end, lift in foot_ways(math.inf):
        duration = swing_duration(start, end, lift, limits)
        shares = derivatives(sampled_foot(start, end, lift), duration) / of
        assert shares.max() <= 1.0 + 1e-9
        largest = max(largest, shares.max())
    assert largest > 0.95


def test_a_foot_above_a_curve_is_faster_by_no_more_than_its_lift_by_the_radius():
    limits, radius = LIMITS["speed"], 3.0
    for start, end, lift in foot_ways(radius):
        duration = swing_duration(start, end, lift, limits)
        speed, *_ = derivatives(sampled_foot(start, end, lift), duration)
        assert speed <= (1.0 + lift / radius) * limits.swing * (1.0 + 1e-9)


@pytest.mark.parametrize("limit", ["rapid", "turn", "acceleration"])
def test_each_limit_of_the_platform_counts_by_itself(limit):
    start, end = np.zeros(6), np.array((0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    if limit == "turn":
        end = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.5))
    limits = replace(Speeds(rapid=9.0, turn=9.0, acceleration=99.0), **{limit: 0.01})
    half = replace(limits, **{limit: 0.005})
    slower = duration_of(start, end, half, half.rapid) / duration_of(
        start, end, limits, limits.rapid
    )
    assert slower == pytest.approx(math.sqrt(2.0) if limit == "acceleration" else 2.0)


def test_platform_and_foot_rest_at_both_ends():
    # A quintic leaves its ends by the third power of the time.
    eps = 1e-3
    for start, end in platform_ways(10):
        by = displacement(start, end)
        for ends, near in ((start, eps), (end, 1.0 - eps)):
            off = np.abs(displacement(ends, platform_at(start, by, near)))
            assert (off <= 10.1 * eps**3 * np.linalg.norm(by)).all()
    for start, end, lift in foot_ways(3.0, 10):
        by = displacement(start, end)
        for ends, near in ((start, eps), (end, 1.0 - eps)):
            off = np.abs(displacement(ends, foot_at(start, end, by, lift, near)))
            assert (off[3:] <= 10.1 * (eps / 0.35) ** 3 * lift).all()
            assert (off[:3] <= 1e-12).all()


def test_ends_are_exact_and_nothing_goes_beyond_them():
    for start, end in platform_ways(20):
        by = displacement(start, end)
        for share, expected in ((0.0, start), (-1.0, start), (1.0, end), (2.0, end)):
            assert np.allclose(platform_at(start, by, share), expected, atol=1e-14)
    for start, end, lift in foot_ways(3.0, 20):
        by = displacement(start, end)
        for share, expected in ((0.0, start), (-1.0, start), (1.0, end), (2.0, end)):
            assert np.allclose(foot_at(start, end, by, lift, share), expected, atol=1e-14)


def test_the_platform_goes_straight_and_turns_about_one_axis():
    for start, end in platform_ways(10):
        by, way = displacement(start, end), sampled_platform(start, end)
        gone = np.array([displacement(start, pose) for pose in way])
        done = gone @ by / (by @ by)
        assert np.allclose(gone, done[:, None] * by, atol=1e-12)
        assert (np.diff(done) >= -1e-12).all()
        assert done[100] == pytest.approx(0.5, abs=1e-12)


def test_a_foot_leaves_and_lands_along_the_normals_and_is_highest_between():
    for start, end, lift in foot_ways(0.8, 20):
        poses = sampled_foot(start, end, lift)
        for ends, near in ((start, SHARES <= 0.2), (end, SHARES >= 0.8)):
            off = poses[near, :3] - ends[:3]
            out = third_axis(ends)
            height = off @ out
            assert np.allclose(off, height[:, None] * out, atol=1e-14)
            assert (height >= 0.0).all()
            assert height.max() > 0.2 * lift
        flat = sampled_foot(start, end, 0.0)
        raised = np.linalg.norm(poses[:, :3] - flat[:, :3], axis=1)
        assert raised.max() <= lift * (1.0 + 1e-12)
        assert raised[70] == pytest.approx(lift, rel=2e-2)
        high = (SHARES >= 0.35) & (SHARES <= 0.65)
        assert raised[high].min() > 0.9 * lift
        assert np.allclose(raised, raised[::-1], rtol=1e-9, atol=1e-15)


def test_a_foot_on_a_plane_reaches_its_lift_exactly():
    for start, end, lift in foot_ways(math.inf, 20):
        heights = sampled_foot(start, end, lift)[:, 2]
        assert heights.max() == pytest.approx(lift, abs=1e-15)
        assert heights.min() >= 0.0


def test_a_foot_that_stays_takes_as_long_as_its_lift():
    foot = Panel(3.0).frame(0.1, 0.1)
    limits = LIMITS["speed"]
    assert swing_duration(foot, foot, 0.0, limits) == pytest.approx(0.05)
    double = swing_duration(foot, foot, 0.06, limits) / swing_duration(foot, foot, 0.03, limits)
    assert double == pytest.approx(2.0)
