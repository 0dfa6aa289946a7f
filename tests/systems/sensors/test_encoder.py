import math

import numpy as np
import pytest

from parapod.systems.sensors.encoder import Encoder


@pytest.fixture
def measure(stand):
    """measure(encoder, position, velocity): measurements of both, or of one for both."""

    def read(encoder, position, velocity=None):
        velocity = position if velocity is None else velocity
        shown = stand(encoder, position=position, velocity=velocity)
        return shown["position_measured"], shown["velocity_measured"]

    return read


def test_values_are_whole_counts(measure):
    position, velocity = measure(
        Encoder(), (0.380004, 0.380006, -0.420014, 0.0), (0.0004, 0.0006, -0.0116, 0.0)
    )
    # Counts of 10 um, and of 10 um in 10 ms: 1 mm/s.
    np.testing.assert_allclose(position, (0.38, 0.38001, -0.42001, 0.0), rtol=1e-12)
    np.testing.assert_allclose(velocity, (0.0, 0.001, -0.012, 0.0), rtol=1e-12)


@pytest.mark.parametrize("resolution", [1e-5, 1e-3])
def test_error_is_at_most_half_a_count_and_uniform(measure, resolution):
    true = np.random.default_rng(0).uniform(-1.0, 1.0, 10_000)
    measured, _ = measure(Encoder(true.size, resolution), true)
    error = measured - true
    assert np.abs(error).max() <= 0.5 * resolution * (1.0 + 1e-9)
    assert error.std() == pytest.approx(resolution / math.sqrt(12.0), rel=0.03)


def test_longer_gate_gives_finer_velocity(measure):
    true = np.linspace(0.0, 0.1, 1000)
    for gate_time in (0.01, 0.1):
        _, velocity = measure(Encoder(true.size, 1e-5, gate_time), true)
        assert np.abs(velocity - true).max() == pytest.approx(0.5e-5 / gate_time, rel=0.1)


def test_resolution_of_zero_is_ideal(measure):
    true = np.random.default_rng(1).normal(size=(2, 4))
    measured = measure(Encoder(resolution=0.0), *true)
    np.testing.assert_array_equal(measured, true)


@pytest.mark.parametrize("resolution", [0.0, 1e-5])
def test_values_that_are_not_finite_read_zero_and_large_ones_pass(measure, resolution):
    bad = (math.nan, math.inf, -math.inf, 1e308)
    for measured in measure(Encoder(resolution=resolution), bad, bad):
        np.testing.assert_array_equal(measured, (0.0, 0.0, 0.0, 1e308))


@pytest.mark.parametrize(
    ("resolution", "gate_time"), [(-1e-5, 0.01), (math.nan, 0.01), (1e-5, 0.0)]
)
def test_senseless_settings_are_refused(resolution, gate_time):
    with pytest.raises(ValueError, match="resolution"):
        Encoder(4, resolution, gate_time)
