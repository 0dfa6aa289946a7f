import math

import numpy as np
import pytest

from parapod.systems.sensors.imu import Drift, SensorAxis


def test_readings_are_whole_counts_and_never_beyond_the_range():
    axis = SensorAxis.sampled(0.01, 0.0, 0.3, 1.0)
    assert axis.limit == pytest.approx(0.9)
    assert axis.read(0.4, 0.0) == pytest.approx(0.3)
    assert axis.read(0.99, 0.0) == axis.limit
    assert axis.read(-math.inf, 0.0) == -axis.limit
    assert axis.read(math.nan, 0.0) == 0.0


def test_without_counts_a_reading_is_the_value_with_its_noise():
    # One-sided density 0.2 at 50 Hz: deviation 0.2 sqrt(25) = 1.
    axis = SensorAxis.sampled(0.02, 0.2, 0.0, 10.0)
    assert axis.read(0.25, 2.0) == pytest.approx(2.25, abs=1e-15)
    assert axis.limit == 10.0


def test_a_drift_keeps_its_deviation_and_forgets_in_its_correlation_time():
    drift = Drift.sampled(0.5, 3.0, 10.0)
    assert drift.decay**20 == pytest.approx(math.exp(-1.0))
    # Variance of the next sample when that of this one is 9.
    assert np.hypot(drift.decay * 3.0, drift.kick) == pytest.approx(3.0)
