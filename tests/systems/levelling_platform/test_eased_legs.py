"""Legs that are led to what is asked for."""

import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.eased_legs import EasedLegs, easing_time

PERIOD, RATE = 0.01, 4e-3
MEASURED = np.array((0.410, 0.400, 0.402, 0.399))
REQUEST = np.array((0.400, 0.402, 0.400, 0.400, 0.001, 0.0, -0.002, 0.0))
# The farthest leg has 10 mm to go; a quintic's largest rate is 15/8 of its mean.
DURATION = 1.875 * 10e-3 / RATE


@pytest.fixture
def legs(stand):
    """Legs that are not led yet."""
    inputs = {"extension_request": REQUEST, "extension": MEASURED, "enable": 0.0}
    return stand(EasedLegs(RATE, PERIOD), **inputs)


def test_the_duration_is_that_of_a_quintic_with_the_largest_rate():
    assert easing_time(10e-3, RATE) == pytest.approx(DURATION)


def test_disabled_legs_are_asked_for_what_they_are(legs):
    legs.tick(3)
    np.testing.assert_array_equal(legs["extension_desired_state"], [*MEASURED, 0, 0, 0, 0])
    assert legs["legs_arrived"] == 0.0


def test_a_way_begins_where_the_legs_are_and_ends_with_the_request(legs):
    legs.tick(enable=1.0)
    first = legs["extension_desired_state"]
    np.testing.assert_allclose(first[:4], MEASURED, atol=1e-6)
    legs.wait(DURATION - 0.05)
    assert legs["legs_arrived"] == 0.0
    legs.wait(0.1)
    assert legs["legs_arrived"] == 1.0
    np.testing.assert_allclose(legs["extension_desired_state"], REQUEST, atol=1e-12)


def test_no_leg_is_faster_for_its_way_than_the_rate_and_rates_are_derivatives(legs):
    legs.set(extension_request=[*REQUEST[:4], 0, 0, 0, 0]).tick(enable=1.0)
    rows = []
    for _ in range(round(DURATION / PERIOD)):
        legs.tick()
        rows.append(legs["extension_desired_state"])
    rows = np.array(rows)
    position, rate = rows[:, :4], rows[:, 4:]
    assert np.abs(rate).max() == pytest.approx(RATE, rel=1e-3)
    slope = (position[2:] - position[:-2]) / (2.0 * PERIOD)
    np.testing.assert_allclose(slope, rate[1:-1], atol=2e-6)


def test_a_request_that_moves_is_followed_on_the_way_too(legs):
    legs.tick(enable=1.0).wait(1.0)
    before = legs["extension_desired_state"]
    legs.set(extension_request=REQUEST + 1e-3)
    np.testing.assert_allclose(legs["extension_desired_state"], before + 1e-3)


def test_another_way_begins_from_where_the_legs_are_by_then(legs):
    legs.tick(enable=1.0).wait(DURATION + 0.1)
    legs.tick(enable=0.0)
    legs.tick(enable=1.0, extension=MEASURED + 1e-3)
    np.testing.assert_allclose(legs["extension_desired_state"][:4], MEASURED + 1e-3, atol=1e-6)


def test_a_way_waits_for_measurements(legs):
    legs.tick(5, enable=1.0, extension=[math.nan, *MEASURED[1:]])
    assert legs["legs_arrived"] == 0.0
    legs.tick(extension=MEASURED)
    np.testing.assert_allclose(legs["extension_desired_state"][:4], MEASURED, atol=1e-6)
