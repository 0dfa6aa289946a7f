import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from parapod.systems.sensors.attitude_estimator import AttitudeEstimator, AttitudeEstimatorParams
from parapod.systems.sensors.imu import ImuParams, add_imu

PARAMS = AttitudeEstimatorParams()
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


@pytest.fixture
def start(stand):
    """start(params): an estimator that is fed sample by sample."""

    class Estimator(stand):
        def step(self, gyro=STILL, accel=LEVEL, count=1):
            """Attitude after that many samples."""
            self.tick(count, gyro=gyro, accel=accel)
            return self.attitude

        @property
        def attitude(self):
            return self["attitude"]

        @property
        def gyro_bias(self):
            return self["gyro_bias"]

    return lambda params=PARAMS: Estimator(AttitudeEstimator(params))


@pytest.fixture
def settled(start):
    """An estimator that has started on a level body at rest."""
    estimator = start()
    estimator.step(count=101)
    return estimator


def turn(estimator, count, begun=0, bias=0.0, bad=None):
    """Rolls a body at 5 deg/s up to a sample, every third rate bad, and returns its roll."""
    for k in range(begun + 1, count + 1):
        rate = bad if bad is not None and k % 3 == 0 else bias + 5.0 * DEGREE
        estimator.step((rate, 0.0, 0.0), vertical(0.05 * DEGREE * k, 0.0))
    return 0.05 * DEGREE * count


@pytest.fixture
def errors_at_rest(start):
    """errors_at_rest(steps, seed, gyro_bias): [deg], of a level body with white noise."""

    def errors(steps, seed, gyro_bias=0.0):
        rng = np.random.default_rng(seed)
        gyro = gyro_bias + GYRO_NOISE * rng.normal(size=(steps, 3))
        accel = np.array(LEVEL) + ACCEL_NOISE * rng.normal(size=(steps, 3))
        estimator = start()
        samples = zip(gyro, accel, strict=True)
        return np.array([estimator.step(w, f) for w, f in samples]) / DEGREE

    return errors


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, -0.1), (-0.3, 0.4), (2.5, 1.2)])
def test_attitude_is_roll_and_pitch_of_the_platforms_convention(start, roll, pitch):
    attitude = start().step(STILL, vertical(roll, pitch))
    np.testing.assert_allclose(attitude, (roll, pitch), atol=1e-14)


def test_hand_computed_tilt(start):
    # tan(roll) = 3/4; sin(pitch) = -3/5.
    attitude = start().step(STILL, np.array((0.6, 0.8 * 0.6, 0.8 * 0.8)) * GRAVITY)
    np.testing.assert_allclose(attitude, (math.atan(0.75), -math.asin(0.6)), rtol=1e-14)


def test_after_the_start_inputs_move_the_output_through_updates_only(settled):
    for gyro, accel in (((0.1, 0.2, 0.3), LEVEL), (STILL, vertical(0.02, 0.02))):
        before = settled.attitude
        np.testing.assert_array_equal(settled.set(gyro=gyro, accel=accel).attitude, before)
        assert (settled.tick().attitude != before).all()


def test_start_averages_accelerometer_and_gyro(start):
    estimator, bias = start(), 0.5 * DEGREE
    for sign in (1.0, -1.0) * 50:
        estimator.step((bias, sign * 0.001, -bias), (0.0, sign * 0.05, GRAVITY))
    # The alternating parts of 100 samples cancel, but for the gate's lesser trust in them.
    np.testing.assert_allclose(estimator.attitude, (0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(estimator.gyro_bias, (bias, 0.0, -bias), atol=1e-15)


def test_error_at_rest_halves_with_four_times_the_time_of_averaging(errors_at_rest):
    errors = np.array([errors_at_rest(80, seed, 0.5 * DEGREE) for seed in range(50)])
    early, late = (np.sqrt(np.mean(errors[:, k - 1] ** 2)) for k in (20, 80))
    # 100 values each: the sampling error of the ratio is 10 %.
    assert early / late == pytest.approx(2.0, rel=0.2)
    # .23 mg/sqrt(Hz) averaged over .8 s: .0132 deg * sqrt(1 / (2 * .8)).
    assert late == pytest.approx(0.0132 * math.sqrt(1.0 / 1.6), rel=0.2)


def test_white_noise_passes_as_the_filters_noise_bandwidth_says(errors_at_rest):
    errors = errors_at_rest(12000, 11, 0.5 * DEGREE)
    # (2 s + 1) / (s + 1)^2 passes 5/8 Hz and s / (s + 1)^2 1/8 Hz per 1 / (2 tau) of density.
    tau = PARAMS.time_constant
    expected = math.hypot(0.0132 * math.sqrt(0.625 / tau), 0.0135 * math.sqrt(tau / 8.0))
    assert errors[2000:].std() == pytest.approx(expected, rel=0.15)
    assert np.abs(errors[200:]).max() < 0.06


def test_accelerometer_bias_of_one_milli_g_tilts_by_its_angle(start):
    attitude = start().step(STILL, (1e-3 * GRAVITY, 1e-3 * GRAVITY, GRAVITY), count=1000)
    np.testing.assert_allclose(attitude / DEGREE, (0.0573, -0.0573), atol=5e-5)


def test_tracks_a_smooth_motion_of_five_degrees_per_second_to_a_thousandth_of_a_degree(settled):
    dt = 0.01
    worst = 0.0
    for k in range(1, 2500):
        phase_1, phase_2 = 0.5 * k * dt, 0.3 * k * dt
        roll, roll_rate = 10.0 * DEGREE * (1.0 - math.cos(phase_1)), 5.0 * math.sin(phase_1)
        pitch, pitch_rate = 16.0 * DEGREE * (1.0 - math.cos(phase_2)), 4.8 * math.sin(phase_2)
        rate = body_rate(roll, roll_rate * DEGREE, pitch_rate * DEGREE)
        attitude = settled.step(rate, vertical(roll, pitch))
        worst = max(worst, np.abs(attitude - (roll, pitch)).max())
    assert worst < 1e-3 * DEGREE


def test_a_jump_of_the_rate_costs_half_a_step_of_it_which_decays(settled):
    turn(settled, 1)
    # The mean of the old and the new rate, 2.5 deg/s over 10 ms, and a first correction of 1 %.
    expected = 0.025 + 0.01 * 0.025
    assert settled.attitude[0] / DEGREE == pytest.approx(expected, rel=1e-3)
    roll = turn(settled, 500, begun=1)
    np.testing.assert_allclose(settled.attitude, (roll, 0.0), atol=0.005 * DEGREE)


@pytest.mark.parametrize("time_constant", [1.0, 2.0, 4.0])
def test_error_after_a_bias_step_follows_the_double_pole(start, time_constant):
    estimator = start(AttitudeEstimatorParams(time_constant=time_constant))
    estimator.step(count=101)
    step = 0.1 * DEGREE
    steps = round(10.0 * time_constant / 0.01)
    errors = np.array([estimator.step((step, 0.0, 0.0))[0] for _ in range(steps)])
    # step * t * exp(-t / tau): largest, step * tau / e, at t = tau.
    assert errors.max() == pytest.approx(step * time_constant / math.e, rel=0.02)
    assert np.argmax(errors) * 0.01 == pytest.approx(time_constant, rel=0.02)
    assert abs(errors[-1]) < 1e-3 * errors.max() * 10.0
    np.testing.assert_allclose(estimator.gyro_bias, (step, 0.0, 0.0), atol=0.01 * step)


def test_time_constant_of_the_context_is_honoured(start):
    tilts = {}
    for time_constant in (0.5, 2.0, math.nan, 0.0, -1.0, math.inf):
        estimator = start()
        estimator.context.get_mutable_numeric_parameter(0).SetAtIndex(0, time_constant)
        estimator.step(count=101)
        tilts[time_constant] = estimator.step(STILL, vertical(0.02, 0.0), count=20)[0]
        # A senseless one leaves the filter stable.
        estimator.step((0.01, 0.0, 0.0), vertical(0.1, 0.1), count=500)
        assert np.abs(estimator.attitude).max() < 0.2
    assert tilts[0.5] > 2.0 * tilts[2.0] > 0.0


def test_motion_at_the_start_is_not_taken_for_bias_and_ends_the_averaging(start):
    moving, resting = start(), start()
    np.testing.assert_allclose((turn(moving, 200), 0.0), moving.attitude, atol=1e-9)
    np.testing.assert_allclose(moving.gyro_bias, np.zeros(3), atol=1e-9)
    resting.step((0.5 * DEGREE, 0.0, 0.0), count=30)
    roll = turn(resting, 100, bias=0.5 * DEGREE)
    np.testing.assert_allclose(resting.attitude, (roll, 0.0), atol=0.03 * DEGREE)
    np.testing.assert_allclose(resting.gyro_bias, (0.5 * DEGREE, 0.0, 0.0), atol=0.03 * DEGREE)


def test_averaged_and_estimated_bias_stay_within_their_limit(start):
    estimator = start()
    for rate in (1.9, 2.8):
        estimator.step((rate * DEGREE, 0.0, -rate * DEGREE))
    np.testing.assert_allclose(estimator.gyro_bias / DEGREE, (2.0, 0.0, -2.0), rtol=1e-12)
    estimator = start()
    estimator.step(count=101)
    estimator.step((10.0 * DEGREE, 0.0, 0.0), count=1000)
    assert estimator.gyro_bias[0] / DEGREE == pytest.approx(2.0, rel=1e-12)


def test_accelerations_outside_the_gate_do_not_tilt(start):
    estimator = start()
    estimator.step(STILL, vertical(0.1, 0.0), count=200)
    before = estimator.attitude
    estimator.step(STILL, vertical(0.1, 0.0) + np.full(3, 5.0), count=100)
    np.testing.assert_allclose(estimator.attitude, before, atol=1e-12)


def test_weight_falls_linearly_to_the_gate(start):
    tilts = []
    for stretch in (0.0, 0.25, 0.5):
        estimator = start()
        estimator.step(count=101)
        accel = vertical(0.01, 0.0) * (1.0 + stretch / GRAVITY)
        tilts.append(estimator.step(STILL, accel)[0])
    assert tilts[1] == pytest.approx(0.5 * tilts[0], rel=1e-9)
    assert tilts[2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("bad", [math.nan, 1e308])
def test_bad_gyro_sample_is_replaced_by_the_last_good_one(settled, bad):
    roll = turn(settled, 200, bad=bad)
    np.testing.assert_allclose(settled.attitude, (roll, 0.0), atol=0.03 * DEGREE)


@pytest.mark.parametrize("bad", [math.nan, 1e308, 0.0])
def test_bad_accelerometer_sample_is_ignored(start, bad):
    estimator = start()
    before = estimator.step(STILL, vertical(0.1, -0.2), count=200)
    for accel in ((bad, bad, bad), (0.0, bad, GRAVITY) if bad else STILL):
        estimator.step(STILL, accel, count=50)
        np.testing.assert_allclose(estimator.attitude, before, atol=1e-12)


def test_start_waits_for_a_usable_accelerometer_sample(start):
    estimator = start()
    for accel in (STILL, NAN, (0.0, 0.0, math.inf)):
        np.testing.assert_array_equal(estimator.step(STILL, accel, count=10), np.zeros(2))
    np.testing.assert_allclose(estimator.step(STILL, vertical(0.1, 0.2)), (0.1, 0.2), atol=1e-14)


def test_pitch_stays_within_a_quarter_turn_whatever_the_inputs(start):
    rng, estimator = np.random.default_rng(1), start()
    values = np.array([math.nan, math.inf, 0.0, 1e308, -9.81, 9.81, 17.0, -17.0, 1e-320])
    for _ in range(500):
        _, pitch = estimator.step(rng.choice(values, 3), rng.choice(values, 3))
        assert abs(pitch) <= 0.5 * math.pi


@pytest.mark.parametrize(
    ("gyro", "accel"),
    [
        ((0.0, 0.0, 2.0 * PARAMS.fast), LEVEL),
        (STILL, (0.0, 0.0, GRAVITY + 1.1 * PARAMS.disturbance)),
        (STILL, vertical(0.0, 1.1 * PARAMS.misfit)),
        (STILL, NAN),
    ],
)
def test_the_attitude_is_trusted_again_when_samples_have_been_calm_for_a_while(
    settled, gyro, accel
):
    assert settled["trusted"] == 1.0
    settled.step(gyro, accel)
    assert settled["trusted"] == 0.0
    settled.step(count=round(PARAMS.calm_time / settled.period) - 1)
    assert settled["trusted"] == 0.0
    settled.step()
    assert settled["trusted"] == 1.0
    # A slow motion is calm.
    settled.step((0.0, 0.0, 0.9 * PARAMS.fast), vertical(0.0, 0.9 * PARAMS.misfit))
    assert settled["trusted"] == 1.0


def test_recovers_after_a_burst_of_nonsense(start):
    estimator = start()
    estimator.step(count=200)
    estimator.step((15.0, -15.0, 3.0), NAN, count=30)
    estimator.step(count=3000)
    np.testing.assert_allclose(estimator.attitude, np.zeros(2), atol=1e-3 * DEGREE)


def test_with_the_sensor_model_the_output_starts_at_the_tilt_and_settles():
    roll, pitch, gyro_bias = 0.1, -0.05, 0.5 * DEGREE * np.array((1.0, -1.0, 1.0))
    builder = DiagramBuilder()
    imu, _ = add_imu(builder, replace(ImuParams(), gyro_turn_on_bias=tuple(gyro_bias)), seed=1)
    for name, value in (("angular_velocity", STILL), ("specific_force", vertical(roll, pitch))):
        source = builder.AddSystem(ConstantVectorSource(np.array(value)))
        builder.Connect(source.get_output_port(), imu.GetInputPort(name))
    estimator = builder.AddSystem(AttitudeEstimator())
    for name in ("gyro", "accel"):
        builder.Connect(imu.GetOutputPort(name), estimator.GetInputPort(name))
    log = LogVectorOutput(estimator.GetOutputPort("attitude"), builder, estimator.period)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(30.0)
    errors = (log.FindLog(context).data().T - (roll, pitch)) / DEGREE
    # The first output is one accelerometer sample, .094 deg of noise an axis.
    assert np.abs(errors).max() < 0.4
    assert np.sqrt(np.mean(errors[200:] ** 2)) < 0.02
    own = estimator.GetMyContextFromRoot(context)
    found = estimator.GetOutputPort("gyro_bias").Eval(own)
    np.testing.assert_allclose(found, gyro_bias, rtol=0, atol=0.05 * DEGREE)


@pytest.mark.parametrize(("tilt", "bias"), [(2.0, 0.0), (0.0, 0.4), (2.0, 0.4), (1.0, -0.4)])
def test_an_attitude_that_counts_as_settled_stays_so(settled, tilt, bias):
    """A jump of the tilt that the gyro has not seen [deg], and of the gyro's bias [deg/s]."""
    gyro, accel = (bias * DEGREE, 0.0, 0.0), vertical(tilt * DEGREE, 0.0)
    told, true = [], []
    for _ in range(3000):
        attitude = settled.step(gyro, accel)
        told.append(settled["error"][0])
        true.append(abs(attitude[0] - tilt * DEGREE))
    told, true = np.array(told), np.array(true)
    # The mean has seen the jump after three of its time constants. The filter then swings back
    # through zero, and must not be taken for settled there.
    seen = round(3.0 * PARAMS.mean_time / 0.01)
    first = seen + int(np.argmax(told[seen:] < 1e-3))
    assert true[seen:first].max() > 1e-3
    assert told[first:].max() < 1e-3
    assert true[first:].max() < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_tells_an_error_that_counts_as_settled(start, seed):
    rng, estimator, told = np.random.default_rng(seed), start(), []
    for _ in range(2000):
        noise = rng.normal(size=(2, 3))
        estimator.step(GYRO_NOISE * noise[0], LEVEL + ACCEL_NOISE * noise[1])
        told.append(estimator["error"][0])
    assert 1e-5 < max(told[100:]) < 1e-3


def test_samples_that_correct_nothing_leave_the_error_that_is_told(settled):
    settled.step(accel=vertical(2.0 * DEGREE, 0.0), count=20)
    told = settled["error"][0]
    assert told > 1e-3
    for bad in (NAN, (0.0, 0.0, 0.5 * GRAVITY)):
        settled.step(accel=bad, count=10)
        assert settled["error"][0] == told
