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


class Loop:
    """A loop whose inputs are fixed by the test."""

    def __init__(self, fix, **inputs):
        self.system = PostureLoop(PARAMS, PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        given = {
            "posture_desired_state": DESIRED,
            "attitude": IN_STEP - ERROR,
            "enable": (1.0,),
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def update(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            self.context.SetDiscreteState(ahead.value(0).copy())
        return self.correction

    @property
    def output(self):
        return self.system.get_output_port().Eval(self.context).copy()

    @property
    def correction(self):
        """What is added to roll and pitch."""
        return self.context.get_discrete_state_vector().CopyToVector()

    @correction.setter
    def correction(self, value):
        self.context.SetDiscreteState(np.array(value))


def test_it_begins_without_correction(fix):
    np.testing.assert_array_equal(Loop(fix).output, DESIRED)


def test_roll_and_pitch_are_corrected_and_nothing_else(fix):
    loop = Loop(fix)
    loop.correction = (0.005, -0.007)
    np.testing.assert_allclose(
        loop.output[:2], DESIRED[:2] + np.array((0.005, -0.007)), atol=1e-17
    )
    np.testing.assert_array_equal(loop.output[2:], DESIRED[2:])


@pytest.mark.parametrize("periods", [1, 2, 50])
def test_an_error_is_integrated_over_the_time_it_is_held(fix, periods):
    correction = Loop(fix).update(periods)
    expected = periods * PARAMS.gain * PERIOD * ERROR
    np.testing.assert_allclose(correction, expected, rtol=1e-12)


def test_a_platform_that_leans_less_than_desired_is_asked_for_more(fix):
    loop = Loop(fix, attitude=IN_STEP - (0.001, -0.001))
    assert np.sign(loop.update()).tolist() == [1.0, -1.0]


def test_steady_motion_with_an_attitude_that_is_late_by_the_lag_is_no_error(fix):
    loop = Loop(fix)
    for k in range(50):
        desired = DESIRED.copy()
        desired[:3] += k * PERIOD * DESIRED[3:]
        loop.set(posture_desired_state=desired, attitude=desired[:2] - PARAMS.lag * desired[3:5])
        loop.update()
    np.testing.assert_allclose(loop.correction, 0.0, atol=1e-17)


def test_the_correction_stops_at_its_limit_and_leaves_it_as_soon_as_the_error_turns(fix):
    loop = Loop(fix)
    np.testing.assert_array_equal(loop.update(1000), PARAMS.limit * np.sign(ERROR))
    loop.set(attitude=IN_STEP + ERROR)
    expected = PARAMS.limit * np.sign(ERROR) - PARAMS.gain * PERIOD * ERROR
    np.testing.assert_allclose(loop.update(), expected, rtol=1e-12)


@pytest.mark.parametrize("off", [0.0, 0.5, math.nan])
def test_a_disabled_loop_has_no_correction(fix, off):
    loop = Loop(fix)
    loop.update(10)
    loop.set(enable=(off,))
    np.testing.assert_array_equal(loop.update(), np.zeros(2))
    np.testing.assert_array_equal(loop.output, DESIRED)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
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
    fix, bad, name, element, axis
):
    loop = Loop(fix)
    before = loop.update(3)
    value = np.array({"attitude": IN_STEP - ERROR, "posture_desired_state": DESIRED}[name])
    value[element] = bad
    loop.set(**{name: value})
    after = loop.update()
    assert after[axis] == before[axis]
    expected = before + PARAMS.gain * PERIOD * ERROR
    assert after[1 - axis] == pytest.approx(expected[1 - axis], rel=1e-12)


@pytest.mark.parametrize("element", [2, 5])
def test_a_height_that_is_not_finite_does_not_concern_the_loop(fix, element):
    bad = DESIRED.copy()
    bad[element] = math.nan
    correction = Loop(fix, posture_desired_state=bad).update()
    np.testing.assert_allclose(correction, PARAMS.gain * PERIOD * ERROR, rtol=1e-12)


def test_gain_lag_and_limit_are_those_of_the_context(fix):
    loop = Loop(fix)
    parameters = loop.context.get_mutable_numeric_parameter(0)
    np.testing.assert_array_equal(parameters.CopyToVector(), (1.5, 0.04, 0.02))
    parameters.SetFromVector([3.0, 0.0, 1e-4])
    error = DESIRED[:2] - (IN_STEP - ERROR)
    np.testing.assert_allclose(loop.update(), np.clip(0.03 * error, -1e-4, 1e-4), rtol=1e-12)


GEOMETRY = PlatformGeometry(foot_radius=0.025)
GROUND = np.array((0.02, -0.03))
OFFSETS = np.array((0.004, -0.003, 0.002, -0.005))
POSTURE = np.array((0.01, -0.02, 0.475))
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND, OFFSETS)
INPUTS = {"extension": EXTENSION, "ground": GROUND, "foot_offsets": OFFSETS}


def evaluated(fix, geometry=GEOMETRY, **inputs):
    system = ForwardKinematics(geometry)
    context = system.CreateDefaultContext()
    fix(system, context, **(INPUTS | inputs))
    return system.get_output_port().Eval(context).copy()


def test_the_posture_is_the_one_whose_extensions_are_given(fix):
    np.testing.assert_allclose(evaluated(fix), POSTURE, rtol=0, atol=1e-13)


@pytest.mark.parametrize("geometry", [PlatformGeometry(), GEOMETRY], ids=["point", "roller"])
def test_it_is_the_function_for_the_active_legs(fix, geometry):
    rng = np.random.default_rng(0)
    for _ in range(50):
        extension, offsets = rng.uniform(0.39, 0.42, 4), rng.uniform(-0.02, 0.02, 4)
        ground = rng.uniform(-0.08, 0.08, 2)
        found = evaluated(fix, geometry, extension=extension, ground=ground, foot_offsets=offsets)
        expected = forward_kinematics(geometry, extension, ground, (0, 1, 2), offsets)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["extension", "foot_offsets"])
def test_a_leg_that_is_not_finite_gives_nan(fix, name):
    bad = INPUTS[name].copy()
    bad[1] = math.nan
    assert np.isnan(evaluated(fix, **{name: bad})).all()


@pytest.mark.parametrize(("element", "names"), [(0, [True, True]), (1, [False, True])])
def test_ground_that_is_not_finite_gives_nan_angles_and_the_height_of_the_legs(
    fix, element, names
):
    bad = GROUND.copy()
    bad[element] = math.nan
    found = evaluated(fix, ground=bad)
    assert np.isnan(found[:2]).tolist() == names
    assert found[2] == evaluated(fix)[2]


def test_an_extension_that_cannot_be_built_gives_nan(fix):
    assert np.isnan(evaluated(fix, extension=(0.4, 0.35, 0.4, 0.4))).all()


def test_the_passive_leg_does_not_matter(fix):
    extension, offsets = EXTENSION.copy(), OFFSETS.copy()
    extension[3], offsets[3] = math.nan, math.nan
    bare = evaluated(fix, extension=extension, foot_offsets=offsets)
    np.testing.assert_array_equal(bare, evaluated(fix))
