import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.machining_centre.panel import Panel

CYLINDER, PLANE = Panel(0.8), Panel(math.inf)
BOTH = pytest.mark.parametrize("panel", [CYLINDER, PLANE], ids=["cylinder", "plane"])


def places(count=200):
    """Ways along and across, yaws, heights above the hollow side's axis."""
    return np.random.default_rng(0).uniform(
        (-0.6, -0.6, -3.1, -0.2), (0.6, 0.6, 3.1, 0.4), (count, 4)
    )


def axes(frame):
    return Rotation.from_euler("xyz", frame[3:]).as_matrix().T


@BOTH
def test_a_frame_is_found_again_where_it_was_put(panel):
    for along, across, yaw, height in places():
        frame = panel.frame(along, across, yaw, height)
        assert panel.place(frame[:3]) == pytest.approx((along, across, height), abs=1e-14)
        assert panel.heading(frame) == pytest.approx(yaw, abs=1e-12)
        assert panel.tilt(frame) == pytest.approx(0.0, abs=1e-12)


@BOTH
def test_the_third_axis_is_the_normal_and_the_first_looks_to_the_yaw(panel):
    step = 1e-6
    for along, across, yaw, height in places(50):
        first, second, third = axes(panel.frame(along, across, yaw))
        ways = [
            panel.frame(along + sign * step * np.cos(yaw), across + sign * step * np.sin(yaw))[:3]
            for sign in (1, -1)
        ]
        assert np.allclose((ways[0] - ways[1]) / (2 * step), first, atol=1e-9)
        assert np.cross(first, second) @ third == pytest.approx(1.0, abs=1e-14)
        raised = panel.frame(along, across, yaw, height)[:3] - panel.frame(along, across)[:3]
        assert np.allclose(raised, height * third, atol=1e-15)


def test_the_cylinder_falls_away_on_both_sides_of_its_highest_line():
    # A sixth of half the circumference on, what leads out leans by 30 deg to the first axis.
    sixth = math.pi * CYLINDER.radius / 6.0
    frame = CYLINDER.frame(sixth, 0.3)
    low = 0.8 * (math.cos(math.pi / 6.0) - 1.0)
    assert frame[:3] == pytest.approx((0.4, 0.3, low))
    assert np.allclose(axes(frame)[2], (0.5, 0.0, math.cos(math.pi / 6.0)), atol=1e-15)
    assert CYLINDER.frame(-sixth, 0.0)[:3] == pytest.approx((-0.4, 0.0, low))
    assert CYLINDER.frame(0.0, 0.7) == pytest.approx((0.0, 0.7, 0.0, 0.0, 0.0, 0.0))


def test_a_large_radius_comes_near_the_plane_as_its_inverse():
    place = (0.3, 0.2, 0.4, 0.1)
    off = [
        np.abs(Panel(radius).frame(*place) - PLANE.frame(*place)).max() for radius in (1e3, 1e4)
    ]
    assert off[0] / off[1] == pytest.approx(10.0, rel=1e-3)
    assert 0.0 < off[1] < 1e-4


@pytest.mark.parametrize("radius", [3.0, 1e4, 1e8])
def test_heights_are_exact_near_the_surface(radius):
    rng = np.random.default_rng(1)
    for x, z in rng.uniform(-1e-5, 1e-5, (50, 2)):
        with localcontext() as context:
            context.prec = 60
            out = Decimal(radius) + Decimal(z)
            height = (Decimal(x) ** 2 + out**2).sqrt() - Decimal(radius)
        found = Panel(radius).place(np.array((x, 0.0, z)))[2]
        assert found == pytest.approx(float(height), rel=1e-12)


def test_points_are_placed_many_at_once():
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (4, 5, 3))
    found = CYLINDER.place(points)
    assert found.shape == (4, 5, 3)
    assert np.array_equal(found[2, 3], CYLINDER.place(points[2, 3]))


@BOTH
def test_a_leaning_frame_is_tilted_by_its_lean_whatever_its_yaw(panel):
    for along, across, yaw, height in places(50):
        frame = panel.frame(along, across, yaw, height)
        for lean in (1e-6, 0.1, 2.0):
            for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0)):
                leaning = Rotation.from_euler("xyz", frame[3:]) * Rotation.from_rotvec(
                    lean * np.array(axis)
                )
                pose = np.concatenate((frame[:3], leaning.as_euler("xyz")))
                assert panel.tilt(pose) == pytest.approx(lean, abs=1e-9)


def test_upside_down_is_tilted_by_half_a_turn():
    assert PLANE.tilt(np.array((0.0, 0.0, 0.0, np.pi, 0.0, 0.0))) == pytest.approx(np.pi)


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan])
def test_a_radius_that_is_not_positive_is_refused(radius):
    with pytest.raises(ValueError, match="radius must be positive or infinite"):
        Panel(radius)
