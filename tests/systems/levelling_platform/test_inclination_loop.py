"""The outer inclination loop, and the kinematics that close it where it is linearised."""

import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.inclination_loop import (
    ForwardKinematics,
    PostureLoop,
    PostureLoopParams,
)
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics

PARAMS = PostureLoopParams(gain=1.5, lag=0.04, limit=0.02)
PERIOD = 0.01
DESIRED = np.array((0.01, -0.02, 0.47, 0.003, -0.004, 0.005))
IN_STEP = DESIRED[:2] - PARAMS.lag * DESIRED[3:5]  # the attitude of a platform without error
ERROR = np.array((0.004, -0.003))


@pytest.fixture
def loop(stand):
    """A loop that sees the platform lean by `ERROR` less than desired."""
    inputs = {"posture_desired_state": DESIRED, "attitude": IN_STEP - ERROR, "enable": 1.0}
    return stand(PostureLoop(PARAMS, PERIOD), **inputs)


def correction(loop):
    """Corrections of roll and pitch; nothing else is changed."""
    change = loop["posture_corrected_state"] - DESIRED
    np.testing.assert_array_equal(change[2:], np.zeros(4))
    return change[:2]


@pytest.mark.parametrize("periods", [0, 1, 2, 50])
def test_an_error_is_integrated_over_the_time_it_is_held(loop, periods):
    expected = periods * PARAMS.gain * PERIOD * ERROR
    np.testing.assert_allclose(correction(loop.tick(periods)), expected, rtol=1e-12, atol=1e-17)


def test_steady_motion_with_an_attitude_that_is_late_by_the_lag_is_no_error(loop):
    for k in range(50):
        desired = DESIRED.copy()
        desired[:3] += k * PERIOD * DESIRED[3:]
        attitude = desired[:2] - PARAMS.lag * desired[3:5]
        loop.tick(posture_desired_state=desired, attitude=attitude)
    loop.set(posture_desired_state=DESIRED)
    np.testing.assert_allclose(correction(loop), 0.0, atol=1e-17)


def test_the_correction_stops_at_its_limit_and_leaves_it_as_soon_as_the_error_turns(loop):
    limit = PARAMS.limit * np.sign(ERROR)
    np.testing.assert_allclose(correction(loop.tick(1000)), limit, atol=1e-17)
    expected = limit - PARAMS.gain * PERIOD * ERROR
    found = correction(loop.tick(attitude=IN_STEP + ERROR))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("off", [0.5, math.nan])
def test_a_disabled_loop_has_no_correction(loop, off):
    loop.tick(10).tick(enable=off)
    np.testing.assert_array_equal(loop["posture_corrected_state"], DESIRED)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize(
    ("name", "element", "axis"),
    [
        ("attitude", 0, 0),
        ("attitude", 1, 1),
        ("posture_desired_state", 0, 0),
        ("posture_desired_state", 4, 1),
    ],
)
def test_an_axis_that_is_not_finite_keeps_its_correction_and_the_other_goes_on(
    loop, bad, name, element, axis
):
    before = correction(loop.tick(3))
    good = loop.system.GetInputPort(name).Eval(loop.context).copy()
    value = good.copy()
    value[element] = bad
    after = correction(loop.tick(**{name: value}).set(**{name: good}))
    expected = before + PARAMS.gain * PERIOD * ERROR * (np.arange(2) != axis)
    np.testing.assert_allclose(after, expected, rtol=1e-12)


def test_a_height_that_is_not_finite_does_not_concern_the_loop(loop):
    bad = np.where(np.arange(6) % 3 == 2, math.nan, DESIRED)
    loop.tick(posture_desired_state=bad).set(posture_desired_state=DESIRED)
    np.testing.assert_allclose(correction(loop), PARAMS.gain * PERIOD * ERROR, rtol=1e-12)


def test_gain_lag_and_limit_are_those_of_the_context(loop):
    parameters = loop.context.get_mutable_numeric_parameter(0)
    np.testing.assert_array_equal(parameters.CopyToVector(), (1.5, 0.04, 0.02))
    parameters.SetFromVector([3.0, 0.0, 1e-4])
    error = DESIRED[:2] - (IN_STEP - ERROR)
    expected = np.clip(0.03 * error, -1e-4, 1e-4)
    np.testing.assert_allclose(correction(loop.tick()), expected, rtol=1e-10)


# Kinematics that close the loop where it is linearised


GEOMETRY = PlatformGeometry(foot_radius=0.025)
GROUND = np.array((0.02, -0.03))
OFFSETS = np.array((0.004, -0.003, 0.002, -0.005))
POSTURE = np.array((0.01, -0.02, 0.475))
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND, OFFSETS)
INPUTS = {"extension": EXTENSION, "ground": GROUND, "foot_offsets": OFFSETS}


@pytest.fixture
def posture(stand):
    """posture(geometry, **inputs): the output."""
    return lambda geometry=GEOMETRY, **inputs: stand(
        ForwardKinematics(geometry), **(INPUTS | inputs)
    )["posture"]


@pytest.mark.parametrize("geometry", [PlatformGeometry(), GEOMETRY], ids=["point", "roller"])
def test_it_is_forward_kinematics_of_the_active_legs(posture, geometry):
    np.testing.assert_allclose(posture(), POSTURE, rtol=0, atol=1e-13)
    rng = np.random.default_rng(0)
    for _ in range(20):
        extension, offsets = rng.uniform(0.39, 0.42, 4), rng.uniform(-0.02, 0.02, 4)
        ground = rng.uniform(-0.08, 0.08, 2)
        found = posture(geometry, extension=extension, ground=ground, foot_offsets=offsets)
        expected = forward_kinematics(geometry, extension, ground, (0, 1, 2), offsets)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_a_leg_that_is_not_finite_or_cannot_be_built_gives_nan_but_the_passive_one(posture):
    bad = np.where(np.arange(4) == 1, math.nan, 0.4)
    assert np.isnan(posture(extension=bad)).all()
    assert np.isnan(posture(foot_offsets=bad)).all()
    assert np.isnan(posture(extension=(0.4, 0.35, 0.4, 0.4))).all()
    passive = np.where(np.arange(4) == 3, math.nan, (EXTENSION, OFFSETS))
    bare = posture(extension=passive[0], foot_offsets=passive[1])
    np.testing.assert_array_equal(bare, posture())


def test_ground_that_is_not_finite_gives_nan_angles_and_the_height_of_the_legs(posture):
    for ground, names in (((math.nan, -0.03), [True, True]), ((0.02, math.nan), [False, True])):
        found = posture(ground=ground)
        assert np.isnan(found[:2]).tolist() == names
        assert found[2] == posture()[2]
