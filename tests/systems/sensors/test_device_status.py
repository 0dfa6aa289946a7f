import math

import numpy as np
import pytest

from parapod.systems.sensors.device_status import DeviceStatus

PERIOD = 8.0 / 819.2  # an inertial sensor that averages [s]


def ages(status, time):
    context = status.CreateDefaultContext()
    context.SetTime(time)
    return status.GetOutputPort("age").Eval(context)


def test_age_is_the_time_since_the_last_sample():
    status = DeviceStatus(("a", "b", "c"), (0.0, 0.01, 0.25))
    np.testing.assert_allclose(ages(status, 0.257), (0.0, 0.007, 0.007), atol=1e-12)
    np.testing.assert_allclose(ages(status, 1.0), (0.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(ages(status, 0.249), (0.0, 0.009, 0.249), atol=1e-12)


@pytest.mark.parametrize("period", [0.01, 0.001, 0.1, 1.0 / 3.0, 8.0 / 819.2, 1.0 / 819.2])
def test_age_is_zero_at_every_sample_instant(period):
    status = DeviceStatus(("device",), (period,))
    accumulated = 0.0
    for k in range(3000):
        assert ages(status, k * period)[0] < 1e-12
        assert ages(status, accumulated)[0] < 1e-9
        accumulated += period
    # A day later the product k * period is still the same instant.
    for k in range(10):
        assert ages(status, (round(86400.0 / period) + k) * period)[0] < 1e-9


@pytest.mark.parametrize("period", [0.01, 1.0 / 3.0, 8.0 / 819.2])
def test_age_stays_between_zero_and_the_period(period):
    status = DeviceStatus(("device",), (period,))
    for time in np.random.default_rng(0).uniform(0.0, 1000.0, 2000):
        age = ages(status, time)[0]
        assert 0.0 <= age < period
        assert age == pytest.approx(math.fmod(time, period), abs=1e-8)


def test_devices_without_a_period_are_always_up_to_date():
    np.testing.assert_array_equal(ages(DeviceStatus(("a", "b"), (0.0, 0.0)), 12.3), np.zeros(2))


def test_simulated_devices_do_not_fail():
    status = DeviceStatus(("legs", "imu"), (0.0, PERIOD))
    context = status.CreateDefaultContext()
    np.testing.assert_array_equal(status.GetOutputPort("fault").Eval(context), np.zeros(2))


@pytest.mark.parametrize("time", [math.nan, math.inf, -math.inf])
def test_age_at_a_time_that_is_not_finite_is_zero(time):
    np.testing.assert_array_equal(
        ages(DeviceStatus(("legs", "imu"), (0.0, PERIOD)), time), np.zeros(2)
    )


@pytest.mark.parametrize(
    ("periods", "message"),
    [((0.0, 0.01), "2 periods"), ((-1.0,), "0 or more"), ((math.nan,), "0 or more")],
)
def test_periods_that_do_not_fit_are_refused(periods, message):
    with pytest.raises(ValueError, match=message):
        DeviceStatus(("device",), periods)
