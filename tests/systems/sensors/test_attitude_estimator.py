import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.symbolic import Expression, Variable, cos, sin
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, SymbolicVectorSystem

from parapod.systems.sensors.attitude_estimator import AttitudeEstimator, AttitudeEstimatorParams
from parapod.systems.sensors.imu import ImuParams, add_imu

DEGREE = math.pi / 180.0
GRAVITY = 9.81
STILL = (0.0, 0.0, 0.0)
LEVEL = (0.0, 0.0, GRAVITY)
NAN = (math.nan,) * 3
# Standard deviations of ADIS16448 samples at 100 Hz.
GYRO_NOISE = ImuParams().gyro_noise_density * math.sqrt(50.0)
ACCEL_NOISE = ImuParams().accel_noise_density * math.sqrt(50.0)


def vertical(roll, pitch):
    """Specific force of a body at rest: R^T (0, 0, g)."""
    R_WB = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()
    return R_WB.T @ LEVEL


def body_rate(roll, roll_rate, pitch_rate):
    """Angular velocity in the body's axes of R = R_y(pitch) R_x(roll)."""
    return np.array((roll_rate, pitch_rate * math.cos(roll), -pitch_rate * math.sin(roll)))


class Bench:
    """The estimator fed sample by sample."""

    def __init__(self, params=AttitudeEstimatorParams(), period=0.01):
        self.system = AttitudeEstimator(params, period)
        self.context = self.system.CreateDefaultContext()

    def feed(self, gyro, accel):
        self.system.GetInputPort("gyro").FixValue(self.context, gyro)
        self.system.GetInputPort("accel").FixValue(self.context, accel)

    def step(self, gyro=STILL, accel=LEVEL, count=1):
        self.feed(gyro, accel)
        for _ in range(count):
            self.update()
        return self.attitude

    def update(self):
        values = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
        self.context.SetDiscreteState(values)

    @property
    def attitude(self):
        return self.system.GetOutputPort("attitude").Eval(self.context)

    @property
    def gyro_bias(self):
        return self.system.GetOutputPort("gyro_bias").Eval(self.context)


def errors_at_rest(steps, seed, gyro_bias=0.0):
    """Attitude errors [deg] of a level body at rest with the ADIS16448's white noise."""
    rng = np.random.default_rng(seed)
    gyro = gyro_bias + GYRO_NOISE * rng.normal(size=(steps, 3))
    accel = np.array(LEVEL) + ACCEL_NOISE * rng.normal(size=(steps, 3))
    bench = Bench()
    return np.array([bench.step(w, f) for w, f in zip(gyro, accel, strict=True)]) / DEGREE


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, -0.1), (-0.3, 0.4), (2.5, 1.2), (0.0, 0.0)])
def test_attitude_is_roll_and_pitch_of_the_platforms_convention(roll, pitch):
    attitude = Bench().step(STILL, vertical(roll, pitch))
    np.testing.assert_allclose(attitude, (roll, pitch), atol=1e-14)


def test_hand_computed_tilt():
    # tan(roll) = 3/4; sin(pitch) = -3/5.
    attitude = Bench().step(STILL, np.array((0.6, 0.8 * 0.6, 0.8 * 0.8)) * GRAVITY)
    np.testing.assert_allclose(attitude, (math.atan(0.75), -math.asin(0.6)), rtol=1e-14)


def test_after_the_start_inputs_move_the_output_through_updates_only():
    bench = Bench()
    bench.step(count=200)
    for gyro, accel in (((0.1, 0.2, 0.3), LEVEL), (STILL, vertical(0.02, 0.02))):
        before = bench.attitude
        bench.feed(gyro, accel)
        np.testing.assert_array_equal(bench.attitude, before)
        after = bench.step(gyro, accel)
        assert (after != before).all()


def test_start_averages_accelerometer_and_gyro():
    bench = Bench()
    bias = 0.5 * DEGREE
    for sign in (1.0, -1.0) * 50:
        bench.step((bias, sign * 0.001, -bias), (0.0, sign * 0.05, GRAVITY))
    # The alternating parts of 100 samples cancel, but for the gate's lesser trust in them.
    np.testing.assert_allclose(bench.attitude, (0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(bench.gyro_bias, (bias, 0.0, -bias), atol=1e-15)


def test_error_at_rest_halves_with_four_times_the_time_of_averaging():
    errors = np.array([errors_at_rest(80, seed, 0.5 * DEGREE) for seed in range(100)])
    early, late = (np.sqrt(np.mean(errors[:, k - 1] ** 2)) for k in (20, 80))
    # 200 values each: the sampling error of the ratio is 7 %.
    assert early / late == pytest.approx(2.0, rel=0.2)
    # .23 mg/sqrt(Hz) averaged over .8 s: .0132 deg * sqrt(1 / (2 * .8)).
    assert late == pytest.approx(0.0132 * math.sqrt(1.0 / 1.6), rel=0.2)


def test_error_at_rest_stays_below_two_hundredths_of_a_degree_rms():
    errors = np.array([errors_at_rest(3000, seed, 0.5 * DEGREE)[200:] for seed in range(3)])
    assert np.sqrt(np.mean(errors**2, axis=1)).max() < 0.02
    assert np.abs(errors).max() < 0.06


def test_white_noise_passes_as_the_filters_noise_bandwidth_says():
    errors = errors_at_rest(20000, seed=11)[2000:]
    # (2 s + 1) / (s + 1)^2 passes 5/8 Hz and s / (s + 1)^2 1/8 Hz per 1 / (2 tau) of density.
    tau = AttitudeEstimatorParams().time_constant
    expected = math.hypot(0.0132 * math.sqrt(0.625 / tau), 0.0135 * math.sqrt(tau / 8.0))
    assert errors.std() == pytest.approx(expected, rel=0.15)


def test_accelerometer_bias_of_one_milli_g_tilts_by_its_angle():
    bench = Bench()
    bench.step(STILL, (1e-3 * GRAVITY, 1e-3 * GRAVITY, GRAVITY), count=1000)
    np.testing.assert_allclose(bench.attitude / DEGREE, (0.0573, -0.0573), atol=5e-5)


def test_tracks_a_smooth_motion_of_five_degrees_per_second_to_a_thousandth_of_a_degree():
    bench, dt = Bench(), 0.01
    bench.step(count=101)
    worst = 0.0
    for k in range(1, 4000):
        phase_1, phase_2 = 0.5 * k * dt, 0.3 * k * dt
        roll, roll_rate = 10.0 * DEGREE * (1.0 - math.cos(phase_1)), 5.0 * math.sin(phase_1)
        pitch, pitch_rate = 16.0 * DEGREE * (1.0 - math.cos(phase_2)), 4.8 * math.sin(phase_2)
        rate = body_rate(roll, roll_rate * DEGREE, pitch_rate * DEGREE)
        attitude = bench.step(rate, vertical(roll, pitch))
        worst = max(worst, np.abs(attitude - (roll, pitch)).max())
    assert worst < 1e-3 * DEGREE


def test_jump_of_the_rate_costs_half_a_step_of_it():
    bench = Bench()
    bench.step(count=101)
    roll = bench.step((5.0 * DEGREE, 0.0, 0.0), vertical(0.05 * DEGREE, 0.0))[0]
    # The mean of the old and the new rate, 2.5 deg/s over 10 ms, and a first correction of 1 %.
    assert roll / DEGREE == pytest.approx(0.025 + 0.01 * 0.025, rel=1e-3)


def test_constant_motion_is_tracked_without_error():
    bench = Bench()
    bench.step(count=100)
    for k in range(1, 500):
        roll = 0.05 * DEGREE * k
        bench.step((5.0 * DEGREE, 0.0, 0.0), vertical(roll, 0.0))
    # What the first step costs has decayed.
    np.testing.assert_allclose(bench.attitude, (roll, 0.0), atol=0.005 * DEGREE)


@pytest.mark.parametrize("time_constant", [1.0, 2.0, 4.0])
def test_error_after_a_bias_step_follows_the_double_pole(time_constant):
    bench = Bench(AttitudeEstimatorParams(time_constant=time_constant))
    bench.step(count=101)
    step = 0.1 * DEGREE
    steps = round(10.0 * time_constant / 0.01)
    errors = np.array([bench.step((step, 0.0, 0.0))[0] for _ in range(steps)])
    # step * t * exp(-t / tau): largest, step * tau / e, at t = tau.
    assert errors.max() == pytest.approx(step * time_constant / math.e, rel=0.02)
    assert np.argmax(errors) * 0.01 == pytest.approx(time_constant, rel=0.02)
    assert abs(errors[-1]) < 1e-3 * errors.max() * 10.0
    np.testing.assert_allclose(bench.gyro_bias, (step, 0.0, 0.0), atol=0.01 * step)


def test_time_constant_of_the_context_is_honoured():
    fast, slow = Bench(), Bench()
    fast.context.get_mutable_numeric_parameter(0).SetAtIndex(0, 0.5)
    for bench in (fast, slow):
        bench.step(count=101)
        bench.step(STILL, vertical(0.02, 0.0), count=20)
    assert fast.attitude[0] > 2.0 * slow.attitude[0]


@pytest.mark.parametrize("time_constant", [math.nan, 0.0, -1.0, math.inf])
def test_senseless_time_constant_leaves_the_filter_stable(time_constant):
    bench = Bench()
    bench.context.get_mutable_numeric_parameter(0).SetAtIndex(0, time_constant)
    bench.step(count=101)
    bench.step((0.01, 0.0, 0.0), vertical(0.1, 0.1), count=500)
    assert np.abs(bench.attitude).max() < 0.2


def test_motion_at_the_start_is_not_taken_for_bias():
    bench = Bench()
    for k in range(200):
        roll = 0.05 * DEGREE * k
        bench.step((5.0 * DEGREE, 0.0, 0.0), vertical(roll, 0.0))
    np.testing.assert_allclose(bench.attitude, (roll, 0.0), atol=1e-9)
    np.testing.assert_allclose(bench.gyro_bias, np.zeros(3), atol=1e-9)


def test_averaged_bias_stays_within_its_limit():
    bench = Bench()
    bench.step((1.9 * DEGREE, 0.0, -1.9 * DEGREE))
    bench.step((2.8 * DEGREE, 0.0, -2.8 * DEGREE))
    np.testing.assert_allclose(bench.gyro_bias / DEGREE, (2.0, 0.0, -2.0), rtol=1e-12)


def test_estimated_bias_stays_within_its_limit():
    bench = Bench()
    bench.step(count=101)
    bench.step((10.0 * DEGREE, 0.0, 0.0), count=1000)
    assert bench.gyro_bias[0] / DEGREE == pytest.approx(2.0, rel=1e-12)


def test_motion_ends_the_averaging():
    bench = Bench()
    bench.step((0.5 * DEGREE, 0.0, 0.0), count=30)
    for k in range(1, 100):
        roll = 0.05 * DEGREE * k
        bench.step((5.5 * DEGREE, 0.0, 0.0), vertical(roll, 0.0))
    np.testing.assert_allclose(bench.attitude, (roll, 0.0), atol=0.03 * DEGREE)
    np.testing.assert_allclose(bench.gyro_bias, (0.5 * DEGREE, 0.0, 0.0), atol=0.03 * DEGREE)


def test_accelerations_outside_the_gate_do_not_tilt():
    bench = Bench()
    bench.step(STILL, vertical(0.1, 0.0), count=200)
    before = bench.attitude
    bench.step(STILL, vertical(0.1, 0.0) + np.full(3, 5.0), count=100)
    np.testing.assert_allclose(bench.attitude, before, atol=1e-12)


def test_weight_falls_linearly_to_the_gate():
    tilts = []
    for stretch in (0.0, 0.25, 0.5):
        bench = Bench()
        bench.step(count=101)
        accel = vertical(0.01, 0.0) * (1.0 + stretch / GRAVITY)
        tilts.append(bench.step(STILL, accel)[0])
    assert tilts[1] == pytest.approx(0.5 * tilts[0], rel=1e-9)
    assert tilts[2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
def test_bad_gyro_sample_is_replaced_by_the_last_good_one(bad):
    bench = Bench()
    bench.step(count=101)
    for k in range(1, 200):
        roll = 0.05 * DEGREE * k
        gyro = (bad, 0.0, 0.0) if k % 3 == 0 else (5.0 * DEGREE, 0.0, 0.0)
        bench.step(gyro, vertical(roll, 0.0))
    np.testing.assert_allclose(bench.attitude, (roll, 0.0), atol=0.03 * DEGREE)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308, 0.0])
def test_bad_accelerometer_sample_is_ignored(bad):
    bench = Bench()
    bench.step(STILL, vertical(0.1, -0.2), count=200)
    before = bench.attitude
    for accel in ((bad, bad, bad), (0.0, bad, GRAVITY) if bad else STILL):
        bench.step(STILL, accel, count=50)
        np.testing.assert_allclose(bench.attitude, before, atol=1e-12)


def test_start_waits_for_a_usable_accelerometer_sample():
    bench = Bench()
    for accel in (STILL, NAN, (0.0, 0.0, math.inf)):
        np.testing.assert_array_equal(bench.step(STILL, accel, count=10), np.zeros(2))
    np.testing.assert_allclose(bench.step(STILL, vertical(0.1, 0.2)), (0.1, 0.2), atol=1e-14)


def test_outputs_are_finite_and_bounded_whatever_the_inputs():
    rng = np.random.default_rng(1)
    values = np.array(
        [math.nan, math.inf, -math.inf, 0.0, 1e308, -9.81, 9.81, 17.0, -17.0, 1e-320]
    )
    for _ in range(20):
        bench = Bench()
        for _ in range(150):
            roll, pitch = bench.step(rng.choice(values, 3), rng.choice(values, 3))
            assert abs(roll) <= math.pi
            assert abs(pitch) <= 0.5 * math.pi
            assert np.abs(bench.gyro_bias).max() <= AttitudeEstimatorParams().bias_limit


def test_recovers_after_a_burst_of_nonsense():
    bench = Bench()
    bench.step(count=200)
    bench.step((15.0, -15.0, 3.0), NAN, count=30)
    bench.step(count=3000)
    np.testing.assert_allclose(bench.attitude, np.zeros(2), atol=1e-3 * DEGREE)


def wire(builder, imu, **inputs):
    """Feeds the sensor's inputs from sources, the estimator from the sensor; logs it."""
    for name, source in inputs.items():
        if not isinstance(source, SymbolicVectorSystem):
            source = ConstantVectorSource(np.array(source))
        builder.AddSystem(source)
        builder.Connect(source.get_output_port(), imu.GetInputPort(name))
    estimator = builder.AddSystem(AttitudeEstimator())
    for name in ("gyro", "accel"):
        builder.Connect(imu.GetOutputPort(name), estimator.GetInputPort(name))
    outputs = (estimator.GetOutputPort("attitude"), estimator.GetOutputPort("gyro_bias"))
    return [LogVectorOutput(output, builder, estimator.period) for output in outputs]


@pytest.mark.parametrize("gyro_bias", [0.5 * DEGREE, -0.5 * DEGREE])
def test_with_the_sensor_model_the_output_starts_at_the_tilt_and_settles(gyro_bias):
    roll, pitch = 0.1, -0.05
    builder = DiagramBuilder()
    imu, _ = add_imu(builder, replace(ImuParams(), gyro_turn_on_bias=(gyro_bias,) * 3), seed=1)
    logs = wire(builder, imu, angular_velocity=STILL, specific_force=vertical(roll, pitch))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(40.0)
    attitude, bias = (log.FindLog(context).data() for log in logs)
    errors = (attitude.T - (roll, pitch)) / DEGREE
    # The first output is one accelerometer sample, .094 deg of noise an axis.
    assert np.abs(errors).max() < 0.4
    assert np.sqrt(np.mean(errors[200:] ** 2)) < 0.02
    assert np.abs(bias[:, -1] - gyro_bias).max() < 0.05 * DEGREE


def test_with_an_ideal_sampled_sensor_the_lag_is_at_most_two_sampling_periods():
    builder = DiagramBuilder()
    imu, _ = add_imu(builder, ImuParams.ideal())
    time = Variable("t")
    roll = 10.0 * DEGREE * (1.0 - cos(0.5 * time))
    rate = SymbolicVectorSystem(
        time=time, output=[5.0 * DEGREE * sin(0.5 * time), Expression(0.0), Expression(0.0)]
    )
    force = SymbolicVectorSystem(
        time=time, output=[Expression(0.0), GRAVITY * sin(roll), GRAVITY * cos(roll)]
    )
    log, _ = wire(builder, imu, angular_velocity=rate, specific_force=force)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(20.0)
    record = log.FindLog(simulator.get_context())
    times = record.sample_times()
    errors = record.data()[0] / DEGREE - 10.0 * (1.0 - np.cos(0.5 * times))
    # 5 deg/s for the sensor's period and the estimator's, as seen just before an update. The
    # first second is slow enough to be taken for rest: its rate, a bias that is unlearned.
    settled = np.abs(errors[times > 10.0])
    assert settled.max() < 5.0 * (imu.period + 0.01) + 0.01
    assert settled.max() > 5.0 * 0.01
