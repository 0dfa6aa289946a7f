import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.inclination_loop import ForwardKinematics
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
)

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


@pytest.mark.parametrize(
    ("name", "value"),
    [("extension", EXTENSION + 1e-3), ("ground", GROUND + 1e-3), ("foot_offsets", -OFFSETS)],
)
def test_each_input_moves_the_posture(fix, moved, name, value):
    system = ForwardKinematics(GEOMETRY)
    context = system.CreateDefaultContext()
    fix(system, context, **INPUTS)
    assert moved(system, context, lambda: fix(system, context, **{name: value})) == {"posture"}


def test_derivatives_agree_with_differences(assert_gradient_agrees, fix):
    def evaluate(system, x):
        context = system.CreateDefaultContext()
        fix(system, context, extension=x[:4], ground=x[4:6], foot_offsets=x[6:])
        return system.get_output_port().Eval(context)

    x = np.concatenate([EXTENSION, GROUND, OFFSETS])
    assert_gradient_agrees(ForwardKinematics(GEOMETRY), evaluate, x)


def test_converted_system_keeps_its_settings():
    assert ForwardKinematics(GEOMETRY).ToAutoDiffXd().geometry == GEOMETRY
