"""A walk from standing to standing: smooth, in step with its terrain, refused as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.physics import GRAVITY
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.jump import SquatJump
from parapod.systems.terrain_simulator.path import Gait, PathLimits, PathRefused, PlatePath
from parapod.systems.terrain_simulator.terrain import Heave, Level, Slope, Stairs
from parapod.systems.terrain_simulator.walk import BenchWalk, check_walk

PEDAL = BenchGeometry.pedal()
TROT = PlatePath(Level(), Gait(1.5, ramp=0.28), 0.513, 0.30)
WALKS = {
    "trot": BenchWalk(TROT, 30.0, 0.58),
    "stairs": BenchWalk(
        PlatePath(Stairs(0.17, 0.29, 0.19), Gait(0.435, 1.5), 0.561, 0.25), 30.0, 0.56, run_up=2
    ),
    "slope": BenchWalk(
        PlatePath(Slope(np.radians(20.0)), Gait(0.8), 0.562, 0.26), 30.0, 0.58, run_up=0
    ),
    "heave": BenchWalk(PlatePath(Heave(0.02, 1.3), Gait(0.5), 0.513, 0.3), 30.0, 0.58),
    "treadmill": BenchWalk(
        PlatePath(Level(), Gait(2.75, 2.0, 0.4, 0.3), 0.88, 0.19, treadmill=True), 30.0, 0.58
    ),
}
every = pytest.mark.parametrize("walk", WALKS.values(), ids=WALKS)
H = 1e-4


@every
@pytest.mark.parametrize("name", ["pose", "foot", "distance", "rise", "bounce"])
def test_a_motion_is_the_integral_of_its_rates_without_a_jump(walk, name):
    time = np.arange(0.2, walk.duration + 0.1, H)
    if name == "bounce":  # its force has corners, and standing none of it
        time = time[(time > walk.lift_off + walk.swing) & (time < walk.landing - walk.swing)]
    value, rate, change = np.moveaxis(getattr(walk.at(time), name), 0, 0)
    np.testing.assert_allclose(np.gradient(value, H, axis=0)[1:-1], rate[1:-1], atol=2e-4)
    lifts = isinstance(walk.path.terrain, Heave)  # the ground goes on while the leg stands
    within = (
        (time > walk.lift_off + 2 * H) & (time < walk.landing - 2 * H) if lifts else slice(1, -1)
    )
    np.testing.assert_allclose(np.gradient(rate, H, axis=0)[within], change[within], atol=0.3)


@every
def test_the_foot_follows_the_plate_in_stance_a_radius_off_it(walk):
    time = np.linspace(walk.lift_off, walk.landing, 2000)
    motion = walk.at(time)
    foot = motion.foot[0] + np.array(walk.hip) + np.stack((0.0 * time, motion.bounce[0]), axis=-1)
    phi = motion.pose[0, :, 2]
    off = foot - motion.pose[0, :, :2]
    height = np.sin(phi) * off[:, 0] + np.cos(phi) * off[:, 1]
    inside = motion.stance
    np.testing.assert_allclose(height[inside], walk.foot_radius, atol=1e-12)
    assert (height[~inside] > walk.foot_radius - 1e-12).all()
    if not walk.path.treadmill:
        along = np.cos(phi) * off[:, 0] - np.sin(phi) * off[:, 1]
        np.testing.assert_allclose(along[inside], 0.0, atol=1e-12)


def test_a_foothold_stays_where_it_is_in_the_world():
    """Way of the body and place of the foot add up, and so do rise and height."""
    walk = WALKS["stairs"]
    for stride in range(walk.strides + 2 * walk.run_up):
        touchdown = walk.lift_off + walk.swing + stride * walk.period
        time = touchdown + np.linspace(0.0, 1.0, 30) * walk.path.gait.duty * walk.period
        motion = walk.at(time)
        along = motion.distance[0] + motion.pose[0, :, 0] - walk.path.x_c
        up = motion.rise[0] + motion.pose[0, :, 1] - walk.path.z_c
        assert np.ptp(along) < 1e-9
        np.testing.assert_allclose(up, walk.path.terrain.height(along[0]), atol=1e-9)


def test_the_slide_carries_what_the_leg_does_not_and_the_body_that_does_not_rise():
    walk = WALKS["stairs"]
    time = np.linspace(0.0, walk.duration, 500)
    motion, free = walk.at(time), replace(walk, is_inertial=False).at(time)
    carried = motion.force + free.hip_force
    np.testing.assert_allclose(carried, 30.0 * (GRAVITY + motion.bounce[2]), atol=1e-9)
    np.testing.assert_allclose(free.hip_force - motion.hip_force, 30.0 * motion.rise[2], atol=1e-9)


def test_it_stands_with_its_weight_before_and_after():
    walk = WALKS["trot"]
    for time in (0.0, walk.begin, walk.duration, walk.duration + 5.0):
        motion = walk.at(time)
        assert motion.force == pytest.approx(walk.support.weight)
        assert not motion.pose[1:].any()
        assert motion.stance


def test_it_stands_where_the_ground_has_been_lifted_to_when_the_walk_begins_and_ends():
    walk = WALKS["heave"]
    for time in (walk.lift_off, walk.landing):
        lifted = walk.at(time).pose[0, 1] - walk.path.z_c
        assert lifted == pytest.approx(walk.path.terrain.lift(time - walk.lift_off).height)
    assert abs(lifted) > 1e-3


def test_the_belt_speeds_up_and_down_with_the_body():
    walk = WALKS["treadmill"]
    first, last = walk.steady
    assert walk.at(0.5 * (first + last)).belt == pytest.approx(2.75)
    assert walk.at(0.0).belt == walk.at(walk.duration).belt == 0.0
    assert walk.at(first - walk.period + 0.05).belt == pytest.approx(0.5 * 2.75)


def test_a_walk_is_refused_with_a_speed_that_passes():
    fast = replace(WALKS["trot"], path=TROT.at_speed(1.7))
    with pytest.raises(PathRefused, match="largest admissible speed") as caught:
        check_walk(PEDAL, fast)
    check_walk(PEDAL, replace(fast, path=TROT.at_speed(0.99 * caught.value.admissible)))


def test_a_run_up_that_breaks_a_limit_is_refused_too():
    """Its swings from standing ask more of the sliders than the strides between them."""
    alone = replace(WALKS["slope"], path=WALKS["slope"].path.at_speed(0.6))
    time = np.linspace(alone.lift_off, alone.landing, 4000)
    steady = (time > alone.lift_off + alone.swing) & (time < alone.landing - alone.swing)
    fastest = np.abs(alone.at(time).pose[2, :, 2])
    assert fastest[~steady].max() >= fastest[steady].max()
    check_walk(PEDAL, alone)
    tight = PathLimits(slider_acceleration=20.0)
    with pytest.raises(PathRefused, match="acceleration of slider"):
        check_walk(PEDAL, alone, tight)


def test_walks_that_are_none_are_refused():
    for given, words in (
        ({"mass": 0.0}, "mass must be positive"),
        ({"strides": 0}, "strides must be at least 1"),
        ({"clearance": -0.1}, "clearance must not be negative"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(WALKS["trot"], **given)


def test_a_jump_is_ballistic_in_flight_and_pushes_as_newton_has_it():
    jump = SquatJump((0.5, 0.3), 30.0)
    assert jump.takeoff_speed == pytest.approx(2.426, abs=1e-3)
    time = np.arange(0.0, jump.duration, H)
    motion = jump.at(time)
    height, rate, change = motion.bounce
    assert height.max() == pytest.approx(jump.height + jump.stretched - jump.standing, abs=1e-6)
    inner = np.abs(time[:, np.newaxis] - np.array(jump.instants)).min(axis=1) > 3 * H
    np.testing.assert_allclose(np.gradient(height, H)[inner], rate[inner], atol=1e-3)
    np.testing.assert_allclose(np.gradient(rate, H)[inner], change[inner], atol=0.2)
    np.testing.assert_allclose(
        motion.force[motion.stance], 30.0 * (GRAVITY + change[motion.stance]), atol=1e-9
    )
    assert (motion.force[~motion.stance] == 0.0).all()
    # The foot is drawn up as fast as the hip falls when it lands.
    lands = jump.at(jump.instants[3] - 1e-9)
    assert lands.foot[1, 1] == pytest.approx(-lands.bounce[1], abs=1e-3)
    assert lands.foot[1, 1] == pytest.approx(jump.landing_speed, abs=1e-3)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"squatting": 0.6}, "squatting = 0.6 m must be below standing"),
        ({"landing": 0.7}, "landing = 0.7 m must be below stretched"),
        ({"height": 0.0}, "height must be positive"),
    ],
)
def test_jumps_that_are_none_are_refused(given, words):
    with pytest.raises(ValueError, match=words):
        SquatJump((0.5, 0.3), 30.0, **given)
