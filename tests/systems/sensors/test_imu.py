import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from parapod.systems.sensors.imu import Drift, Imu, ImuParams, SensorAxis, add_imu

OUTPUTS = ("gyro", "accel", "mag")
LEVEL = {"angular_velocity": (0.0, 0.0, 0.0), "specific_force": (0.0, 0.0, 9.81)}
DEGREE = math.pi / 180.0
MG = 9.80665e-3


@pytest.fixture
def sensor(stand):
    """sensor(params, decimation, **inputs): a sensor at rest that has taken its first sample."""

    def begin(params=ImuParams(), decimation=3, **inputs):
        imu = stand(Imu(params, decimation), **(LEVEL | inputs))
        imu.system.ExecuteInitializationEvents(imu.context)
        return imu

    return begin


def record(params, duration, seed=1, decimation=3):
    builder = DiagramBuilder()
    imu, _ = add_imu(builder, params, decimation, seed=seed)
    for name, value in LEVEL.items():
        source = builder.AddSystem(ConstantVectorSource(np.array(value)))
        builder.Connect(source.get_output_port(), imu.GetInputPort(name))
    logs = {
        name: LogVectorOutput(imu.GetOutputPort(name), builder, imu.period) for name in OUTPUTS
    }
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(duration)
    return {name: log.FindLog(context).data().T for name, log in logs.items()}


def white(**changes):
    """The default sensor with white noise alone."""
    return replace(ImuParams().without_bias().without_quantisation(), **changes)


def drifting(correlation_time):
    """The default sensor with in-run bias alone."""
    return replace(
        ImuParams().without_noise().without_quantisation(),
        gyro_bias_correlation_time=correlation_time,
        accel_bias_correlation_time=correlation_time,
    )


def test_ideal_sensor_returns_the_truth(sensor):
    rng = np.random.default_rng(0)
    rate, force, attitude = rng.normal(size=3), 9.0 * rng.normal(size=3), rng.normal(size=3)
    imu = sensor(
        ImuParams.ideal(),
        angular_velocity=rate,
        specific_force=force,
        attitude=attitude,
        noise=rng.normal(size=Imu.NOISE_SIZE),
    )
    np.testing.assert_array_equal(imu["gyro"], rate)
    np.testing.assert_array_equal(imu["accel"], force)
    R_WB = RollPitchYaw(attitude).ToRotationMatrix().matrix()
    np.testing.assert_allclose(imu["mag"], R_WB.T @ ImuParams().magnetic_field, atol=1e-18)


def test_field_of_a_body_turned_left_by_90_degrees(sensor):
    # Its x axis points west, its y axis south: 22 uT to the north are -22 uT along y.
    imu = sensor(ImuParams.ideal(), attitude=(0.0, 0.0, 0.5 * math.pi))
    np.testing.assert_allclose(imu["mag"], (0.0, -22e-6, -42e-6), atol=1e-18)


def test_readings_are_whole_counts_of_the_data_sheet(sensor):
    params = replace(ImuParams(), magnetic_field=(21.03e-6, 0.0, -42e-6))
    imu = sensor(params, angular_velocity=(0.05, -0.05, 0.0003))
    # .05 rad/s = 2.8648 deg/s = 71.6 counts of .04 deg/s; .0003 rad/s = .43 counts.
    np.testing.assert_allclose(imu["gyro"], np.array((2.88, -2.88, 0.0)) * DEGREE)
    # 9.81 m/s2 = 1.000342 g = 1200.4 counts of 1/1200 g.
    np.testing.assert_allclose(imu["accel"], (0.0, 0.0, 9.80665))
    # 210.3 mgauss = 1472.1 counts of 1/7 mgauss; 420 mgauss are 2940 counts.
    np.testing.assert_allclose(imu["mag"], (1472 / 7 * 1e-7, 0.0, -42e-6), rtol=1e-12)


@pytest.mark.parametrize("params", [ImuParams(), ImuParams.ideal()])
def test_readings_saturate_at_the_data_sheets_ranges_and_nan_reads_zero(sensor, params):
    imu = sensor(
        replace(params, magnetic_field=(1.0, -1.0, 0.0)),
        angular_velocity=(20.0, -math.inf, math.nan),
        specific_force=(math.inf, -200.0, math.nan),
    )
    np.testing.assert_allclose(imu["gyro"] / DEGREE, (1000.0, -1000.0, 0.0))
    np.testing.assert_allclose(imu["accel"] / 9.80665, (18.0, -18.0, 0.0))
    np.testing.assert_allclose(imu["mag"], (1.9e-4, -1.9e-4, 0.0))
    imu.tick(attitude=(math.nan, 0.0, 0.0))
    np.testing.assert_array_equal(imu["mag"], np.zeros(3))


def test_noise_that_is_not_finite_counts_as_none(sensor):
    imu, clean = sensor(), sensor()
    for bad in (math.nan, math.inf, 0.0):
        imu.tick(5, noise=[bad] * Imu.NOISE_SIZE)
        for name in OUTPUTS:
            np.testing.assert_array_equal(imu[name], clean[name])


@pytest.mark.parametrize(("decimation", "rate"), [(0, 819.2), (3, 102.4), (5, 25.6)])
def test_samples_are_held_for_the_period_of_the_decimation(sensor, decimation, rate):
    imu = sensor(ImuParams.ideal(), decimation)
    assert imu.system.period == imu.period == pytest.approx(1.0 / rate, rel=1e-15)
    imu.run(0.5 * imu.period).set(angular_velocity=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(imu.run(0.99 * imu.period)["gyro"], np.zeros(3))
    np.testing.assert_array_equal(imu.run(1.01 * imu.period)["gyro"], (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("name", "value", "moved"),
    [
        ("angular_velocity", (0.1, 0.2, 0.3), "gyro"),
        ("specific_force", (1.0, 2.0, 3.0), "accel"),
        ("attitude", (0.1, 0.2, 0.3), "mag"),
        ("noise", 3.0 * np.eye(Imu.NOISE_SIZE)[0], "gyro"),
        ("noise", 3.0 * np.eye(Imu.NOISE_SIZE)[4], "accel"),
        ("noise", 3.0 * np.eye(Imu.NOISE_SIZE)[8], "mag"),
    ],
)
def test_each_input_moves_its_output_and_no_other(sensor, name, value, moved):
    imu = sensor(attitude=np.zeros(3), noise=np.zeros(Imu.NOISE_SIZE))
    before = {output: imu[output] for output in OUTPUTS}
    imu.tick(**{name: value})
    assert [output for output in OUTPUTS if (before[output] != imu[output]).any()] == [moved]


def test_turn_on_bias_comes_from_the_params_and_can_be_set_in_the_context(sensor):
    biases = {"gyro_turn_on_bias": (0.1, 0.2, 0.3), "accel_turn_on_bias": (0.4, 0.5, 0.6)}
    imu = sensor(replace(ImuParams.ideal(), **biases))
    np.testing.assert_allclose(imu["gyro"], (0.1, 0.2, 0.3))
    np.testing.assert_allclose(imu["accel"], (0.4, 0.5, 10.41))
    imu.system.set_turn_on_bias(imu.context, gyro=(1.0, 2.0, 3.0), accel=0.5)
    imu.tick()
    np.testing.assert_allclose(imu["gyro"], (1.0, 2.0, 3.0))
    np.testing.assert_allclose(imu["accel"], (0.5, 0.5, 10.31))
    with pytest.raises(ValueError, match="finite"):
        imu.system.set_turn_on_bias(imu.context, accel=(0.0, math.nan, 0.0))


def test_negative_decimation_is_refused():
    with pytest.raises(ValueError, match="decimation"):
        Imu(decimation=-1)


def test_one_unit_of_noise_is_the_density_times_the_root_of_half_the_rate(sensor):
    # .0135 deg/s/sqrt(Hz) * sqrt(51.2 Hz) = .0966 deg/s; .23 mg/sqrt(Hz) -> 1.646 mg.
    imu = sensor(white(), noise=np.ones(Imu.NOISE_SIZE))
    assert imu["gyro"][0] / DEGREE == pytest.approx(0.0966, abs=5e-5)
    assert imu["accel"][0] / MG == pytest.approx(1.646, abs=5e-4)


@pytest.mark.parametrize("decimation", [1, 3])
def test_measured_noise_is_white_of_the_params_density_and_its_channels_independent(decimation):
    params, rate, count = white(), 819.2 / 2**decimation, 8192
    samples = record(params, duration=count / rate, seed=2, decimation=decimation)
    for name in OUTPUTS:
        deviation = getattr(params, f"{name}_noise_density") * math.sqrt(0.5 * rate)
        # 3 * 8192 samples: the sampling error of a standard deviation is .5 %.
        assert np.std(samples[name], axis=0).mean() == pytest.approx(deviation, rel=0.02)
    channels = np.hstack([samples[name][1:] for name in OUTPUTS])
    channels = (channels - channels.mean(axis=0)) / channels.std(axis=0)
    bound = 4.5 / math.sqrt(len(channels))
    assert np.abs((channels[1:] * channels[:-1]).mean(axis=0)).max() < bound
    assert np.abs(np.corrcoef(channels.T) - np.eye(9)).max() < bound


def test_rounding_adds_a_twelfth_of_a_count_squared():
    params = replace(ImuParams().without_bias())
    deviation = np.std(record(params, duration=100.0)["accel"], axis=0).mean()
    white_part = params.accel_noise_density * math.sqrt(51.2)
    expected = math.sqrt(white_part**2 + params.accel_resolution**2 / 12.0)
    assert deviation == pytest.approx(expected, rel=0.015)


def test_in_run_bias_is_gauss_markov_with_the_stated_deviation_and_correlation_time():
    params = drifting(correlation_time=1.0)
    samples = record(params, duration=250.0, seed=4)
    for name, truth, deviation in (
        ("gyro", 0.0, 14.5 / 3600.0 * DEGREE),
        ("accel", np.array((0.0, 0.0, 9.81)), 0.25 * MG),
    ):
        bias = samples[name][512:] - truth
        # 3 axes * 250 s / 2 s of independent values: the sampling error is some 4 %.
        assert np.sqrt(np.mean(bias**2)) == pytest.approx(deviation, rel=0.12)
        lag = 102  # samples a second
        correlation = np.mean(bias[lag:] * bias[:-lag]) / np.mean(bias**2)
        assert correlation == pytest.approx(math.exp(-1.0), abs=0.12)


def test_in_run_bias_of_an_axis_comes_from_its_own_noise(sensor):
    for axis in range(6):
        imu = sensor(drifting(300.0), noise=np.eye(Imu.NOISE_SIZE)[9 + axis]).tick(3)
        drift = imu.context.get_discrete_state(2).value()[:6]
        assert np.flatnonzero(drift).tolist() == [axis]


def test_in_run_bias_starts_from_zero_and_magnetometers_have_none():
    samples = record(drifting(correlation_time=1.0), duration=1.0)
    np.testing.assert_array_equal(samples["gyro"][0], np.zeros(3))
    assert (samples["gyro"][-1] != 0.0).all()
    assert np.ptp(samples["mag"], axis=0).max() == 0.0


def test_same_seed_gives_same_samples_and_another_seed_others():
    first, again, other = (record(ImuParams(), 1.0, seed=seed) for seed in (7, 7, 8))
    for name in OUTPUTS:
        np.testing.assert_array_equal(first[name], again[name])
        assert (first[name] != other[name]).any()


def test_helper_adds_a_gaussian_source_of_the_sensors_size_and_period():
    builder = DiagramBuilder()
    imu, noise = add_imu(builder, decimation=4, name="imu_1")
    assert (imu.get_name(), noise.get_name()) == ("imu_1", "imu_1_noise")
    assert noise.get_output_port().size() == Imu.NOISE_SIZE
    assert noise.GetUniquePeriodicDiscreteUpdateAttribute().period_sec() == imu.period
    assert imu.period == pytest.approx(1.0 / 51.2)


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
