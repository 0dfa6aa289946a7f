import math

import numpy as np
import pytest

from parapod.systems.sensors.device_status import DeviceStatus


def ages(status, time):
    context = status.CreateDefaultContext()
    context.SetTime(time)
    return status.GetOutputPort("age").Eval(context)


def test_age_is_the_time_since_the_last_sample():
    status = DeviceStatus(("a", "b", "c"), (0.0, 0.01, 0.25))
    np.testing.assert_allclose(ages(status, 0.257), (0.0, 0.007, 0.007), atol=1e-12)
    np.testing.assert_allclose(ages(status, 1.0), (0.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(ages(status, 0.249), (0.0, 0.009, 0.249), atol=1e-12)


@pytest.mark.parametrize("period", [0.01, 1.0 / 3.0, 8.0 / 819.2])
def test_age_is_zero_at_every_sample_instant_and_below_the_period_between(period):
    status = DeviceStatus(("device",), (period,))
    accumulated = 0.0
    for k in range(1000):
        assert ages(status, k * period)[0] < 1e-12
        assert ages(status, accumulated)[0] < 1e-9
        accumulated += period
    # A day later the product k * period is still the same instant.
    for k in range(10):
        assert ages(status, (round(86400.0 / period) + k) * period)[0] < 1e-9
    for time in np.random.default_rng(0).uniform(0.0, 1000.0, 500):
        age = ages(status, time)[0]
        assert 0.0 <= age < period
        assert age == pytest.approx(math.fmod(time, period), abs=1e-8)


def test_devices_without_a_period_and_times_that_are_not_finite_have_age_zero():
    np.testing.assert_array_equal(ages(DeviceStatus(("a", "b"), (0.0, 0.0)), 12.3), np.zeros(2))
    for time in (math.nan, math.inf, -math.inf):
        np.testing.assert_array_equal(ages(DeviceStatus(("a", "b"), (0.0, 0.01)), time), [0, 0])


@pytest.mark.parametrize(
    ("periods", "message"),
    [((0.0, 0.01), "2 periods"), ((-1.0,), "0 or more"), ((math.nan,), "0 or more")],
)
def test_periods_that_do_not_fit_are_refused(periods, message):
    with pytest.raises(ValueError, match=message):
        DeviceStatus(("device",), periods)
