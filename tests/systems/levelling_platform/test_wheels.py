import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.wheels import WheelGeometry

WHEELS = WheelGeometry()
OTHER = WheelGeometry(half_base=0.3, half_track=0.25, height=-0.2, radius=0.1)


@pytest.mark.parametrize("wheels", [WHEELS, OTHER])
def test_wheels_stand_at_the_corners_of_a_rectangle_in_the_order_of_the_legs(wheels):
    axles = np.array(wheels.axles)
    np.testing.assert_array_equal(np.abs(axles[:, 0]), wheels.half_base)
    np.testing.assert_array_equal(np.abs(axles[:, 1]), wheels.half_track)
    np.testing.assert_array_equal(axles[:, 2], wheels.height)
    # The vectors to F of the legs' table point from the hips.
    hips = [(-leg.l_x, -leg.l_y) for leg in PlatformGeometry().legs]
    np.testing.assert_array_equal(np.sign(axles[:, :2]), np.sign(hips))


def test_the_platform_stands_on_its_wheels_at_390_mm():
    assert WHEELS.standing_height == pytest.approx(0.390, abs=1e-15)


def test_it_stands_on_its_wheels_as_high_as_on_legs_at_the_end_of_their_stroke():
    lowest = forward_kinematics(PlatformGeometry(foot_radius=0.025), [0.42] * 4, (0.0, 0.0))[2]
    assert WHEELS.standing_height == pytest.approx(lowest, abs=1e-3)


@pytest.mark.parametrize("wheels", [WHEELS, OTHER])
def test_straight_ahead_all_wheels_roll_alike(wheels):
    velocity = wheels.skid_steering() @ (0.3, 0.0)
    np.testing.assert_allclose(velocity, 0.3 / wheels.radius, rtol=1e-15)


def test_turning_left_the_right_side_is_faster():
    velocity = WHEELS.skid_steering() @ (0.3, 0.2)
    left = np.array([y > 0.0 for _, y, _ in WHEELS.axles])
    assert left.sum() == 2
    assert velocity[~left].min() > 0.3 / WHEELS.radius > velocity[left].max()


def test_turning_on_the_spot_the_sides_roll_against_each_other():
    velocity = WHEELS.skid_steering() @ (0.0, 0.5)
    np.testing.assert_allclose(velocity, np.array((-0.8, 0.8, 0.8, -0.8)), rtol=1e-12)


@pytest.mark.parametrize("wheels", [WHEELS, OTHER])
def test_rims_move_as_fast_as_the_rigid_body_over_the_ground(wheels):
    rng = np.random.default_rng(0)
    for speed, yaw_rate in rng.uniform(-1.0, 1.0, (20, 2)):
        rolling = wheels.radius * (wheels.skid_steering() @ (speed, yaw_rate))
        along = [
            (np.array((speed, 0.0, 0.0)) + np.cross((0.0, 0.0, yaw_rate), axle))[0]
            for axle in wheels.axles
        ]
        np.testing.assert_allclose(rolling, along, rtol=0, atol=1e-15)
