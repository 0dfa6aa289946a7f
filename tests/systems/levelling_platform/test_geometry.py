import math
from dataclasses import fields, replace

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import (
    ANGLES,
    DIMENSIONS,
    LegDeviation,
    PlatformGeometry,
    drawn_deviations,
)

DRAWN = PlatformGeometry(foot_radius=0.025)
LENGTH, ANGLE = 1e-3, math.radians(0.2)


@pytest.mark.parametrize("name", DIMENSIONS)
def test_a_deviation_is_added_to_the_dimension_of_its_name_and_to_its_leg_alone(name):
    deviations = [LegDeviation()] * 4
    deviations[2] = LegDeviation(**{name: 0.003})
    built = replace(DRAWN, deviations=tuple(deviations)).legs
    expected = replace(DRAWN.legs[2], **{name: getattr(DRAWN.legs[2], name) + 0.003})
    assert built == (*DRAWN.legs[:2], expected, DRAWN.legs[3])


def test_legs_without_deviations_are_as_drawn():
    assert replace(DRAWN, deviations=(LegDeviation(),) * 4).legs == DRAWN.legs


@pytest.mark.parametrize("count", [1, 3, 5])
def test_a_wrong_number_of_deviations_is_refused(count):
    with pytest.raises(ValueError, match=f"deviations must be 0 or 4, not {count}"):
        replace(DRAWN, deviations=(LegDeviation(),) * count)


def test_dimensions_are_those_of_a_leg():
    names = {field.name for field in fields(DRAWN.legs[0])}
    assert set(DIMENSIONS) == names - {"foot_radius", "extension_min", "extension_max"}
    assert set(ANGLES) < set(DIMENSIONS)


def drawn(seed, count=1):
    """Deviations (count, legs, dimensions)."""
    random = np.random.default_rng(seed)
    sets = [drawn_deviations(random, LENGTH, ANGLE) for _ in range(count)]
    return np.array([[[getattr(d, n) for n in DIMENSIONS] for d in legs] for legs in sets])


def test_drawn_deviations_fill_their_tolerance_and_stay_within():
    tolerance = np.array([ANGLE if name in ANGLES else LENGTH for name in DIMENSIONS])
    share = drawn(0, 200) / tolerance
    assert (np.abs(share) <= 1.0).all()
    assert (share.min(axis=0) < -0.9).all()
    assert (share.max(axis=0) > 0.9).all()
    assert abs(share.mean()) < 0.02


def test_the_same_generator_draws_the_same_deviations_and_another_does_not():
    np.testing.assert_array_equal(drawn(1), drawn(1))
    assert (drawn(1) != drawn(2)).all()


def test_no_tolerance_draws_no_deviation():
    legs = drawn_deviations(np.random.default_rng(0), 0.0, 0.0)
    assert legs == (LegDeviation(),) * 4
