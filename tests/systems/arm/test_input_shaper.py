"""Shapers leave modes at rest; the system that applies them is their convolution."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.optimize import minimize_scalar

from parapod.systems.arm.input_shaper import InputShaper, Shaper

FREQUENCY = 2.0 * math.pi * 1.3
MAKERS = (Shaper.zv, Shaper.zvd, Shaper.ei)
DAMPING = pytest.mark.parametrize("damping_ratio", [0.0, 0.01, 0.1, 0.3])
EACH = pytest.mark.parametrize("make", MAKERS, ids=["zv", "zvd", "ei"])


def vibration(command, shaper, frequency, damping_ratio):
    """Amplitude of an oscillator after a shaped command, at the end of its last impulse.

    Closed form: the response to a step and to a ramp is what the command ends at, and one mode.

    Args:
        command: times and heights of steps, and times and slopes of ramps that begin there.
        shaper: shaper of the command.
        frequency: natural frequency [rad/s].
        damping_ratio: damping ratio.
    """
    pole = frequency * complex(-damping_ratio, math.sqrt(1.0 - damping_ratio**2))
    residue = frequency**2 / (1j * pole * pole.imag)
    impulses = np.array((shaper.times, shaper.amplitudes)).T
    steps, ramps = command
    end = max(time for time, _ in (*steps, *ramps)) + shaper.delay
    mode = sum(
        share * size * factor * np.exp(pole * (end - time - later))
        for parts, factor in ((steps, residue), (ramps, residue / pole))
        for time, size in parts
        for later, share in impulses
    )
    return abs(mode)


def a_step():
    return [(0.3, 1.0)], []


def a_ramp():
    """A ramp of 0.37 s."""
    return [], [(0.0, 2.0), (0.37, -2.0)]


def at_random():
    """Steps and straight parts that end."""
    random = np.random.default_rng(3)
    times = np.sort(random.uniform(0.0, 3.0, 30))
    slopes = random.normal(size=30)
    slopes[-1] -= slopes.sum()
    steps = zip(times, random.normal(size=30), strict=True)
    return [*steps], [*zip(times, slopes, strict=True)]


@DAMPING
@EACH
def test_amplitudes_are_positive_with_sum_1_and_times_ascend_from_0(make, damping_ratio):
    shaper = make(FREQUENCY, damping_ratio)
    assert sum(shaper.amplitudes) == pytest.approx(1.0, abs=1e-14)
    assert min(shaper.amplitudes) > 0.0
    assert shaper.times[0] == 0.0
    assert np.diff(shaper.times).min() > 0.0
    assert shaper.delay == shaper.times[-1]
    assert 0.0 < shaper.lag < shaper.delay


@pytest.mark.parametrize("command", [a_step, a_ramp, at_random])
@DAMPING
@pytest.mark.parametrize("make", MAKERS[:2], ids=["zv", "zvd"])
def test_a_mode_is_at_rest_after_the_last_impulse(make, damping_ratio, command):
    shaper = make(FREQUENCY, damping_ratio)
    assert vibration(command(), shaper, FREQUENCY, damping_ratio) < 1e-9
    assert vibration(command(), Shaper(), FREQUENCY, damping_ratio) > 1e-2


@DAMPING
@EACH
def test_the_residual_is_what_a_step_leaves_by_what_an_unshaped_one_does(make, damping_ratio):
    shaper = make(FREQUENCY, damping_ratio)
    frequency = FREQUENCY * np.array((0.5, 0.83, 1.0, 1.21, 2.2))
    shares = [
        vibration(a_step(), shaper, each, damping_ratio)
        / vibration(a_step(), Shaper(), each, damping_ratio)
        for each in frequency
    ]
    residual = shaper.residual(frequency, damping_ratio)
    np.testing.assert_allclose(residual, shares, atol=1e-12)
    assert residual.max() > 0.02


def test_residuals_come_in_batches():
    shaper, frequency = Shaper.zv(FREQUENCY, 0.05), FREQUENCY * np.array((0.7, 1.4))
    damping_ratio = np.array([[0.0], [0.02], [0.1]])
    residual = shaper.residual(frequency, damping_ratio)
    for (i, j), value in np.ndenumerate(residual):
        assert value == pytest.approx(shaper.residual(frequency[j], damping_ratio[i, 0]))
    assert residual.shape == (3, 2)


@DAMPING
def test_the_zvd_residual_is_flat_where_the_zv_one_is_steep(damping_ratio):
    beside = FREQUENCY * np.array((1.0 - 1e-4, 1.0 + 1e-4))
    flat = Shaper.zvd(FREQUENCY, damping_ratio).residual(beside, damping_ratio)
    steep = Shaper.zv(FREQUENCY, damping_ratio).residual(beside, damping_ratio)
    assert steep.min() > 1e-5
    np.testing.assert_array_less(flat, 1e-3 * steep)


@pytest.mark.parametrize("tolerance", [1e-3, 0.01, 0.05, 0.2])
@DAMPING
def test_the_ei_residual_is_its_tolerance_between_two_frequencies_of_rest(
    damping_ratio, tolerance
):
    shaper = Shaper.ei(FREQUENCY, damping_ratio, tolerance)
    residual = shaper.residual(FREQUENCY, damping_ratio)
    assert residual == pytest.approx(tolerance, rel=1e-9)
    zeros = []
    for bounds in ((0.55, 1.0), (1.0, 1.7)):
        clear = minimize_scalar(
            lambda share: float(shaper.residual(share * FREQUENCY, damping_ratio)),
            bounds=bounds,
            options={"xatol": 1e-12},
        )
        assert clear.fun < 1e-6
        zeros.append(clear.x * FREQUENCY)
    between = shaper.residual(np.linspace(*zeros, 201), damping_ratio)
    assert between.max() < 1.02 * tolerance


@pytest.mark.parametrize(
    ("make", "residual", "bound"),
    [
        (Shaper.zv, lambda r: abs(math.cos(0.5 * math.pi * r)), 0.3091),
        (Shaper.zvd, lambda r: math.cos(0.5 * math.pi * r) ** 2, 0.0955),
        (Shaper.ei, lambda r: abs(0.525 * math.cos(math.pi * r) + 0.475), 0.0503),
    ],
    ids=["zv", "zvd", "ei"],
)
def test_robustness_without_damping_is_that_of_the_closed_form(make, residual, bound):
    share = np.linspace(0.8, 1.2, 81)
    shown = make(FREQUENCY).residual(share * FREQUENCY)
    np.testing.assert_allclose(shown, [residual(r) for r in share], atol=1e-12)
    assert shown.max() == pytest.approx(bound, abs=1e-4)


def test_a_zvd_shaper_is_a_zv_shaper_twice():
    twice = Shaper.by_name("zv", [FREQUENCY] * 2, [0.1] * 2)
    shaper = Shaper.zvd(FREQUENCY, 0.1)
    for command in (a_step(), at_random()):
        for frequency in (0.8 * FREQUENCY, 1.7 * FREQUENCY):
            expected = vibration(command, shaper, frequency, 0.02)
            assert vibration(command, twice, frequency, 0.02) == pytest.approx(expected)


def test_two_modes_are_at_rest_together():
    modes = (FREQUENCY, 6.27 * FREQUENCY), (0.01, 0.05)
    first, second = (Shaper.zv(*mode) for mode in zip(*modes, strict=True))
    both = Shaper.by_name("zv", *modes)
    assert both.delay == pytest.approx(first.delay + second.delay)
    assert both.lag == pytest.approx(first.lag + second.lag)
    for mode in zip(*modes, strict=True):
        assert vibration(at_random(), both, *mode) < 1e-9
    assert vibration(at_random(), first, *(column[1] for column in modes)) > 1e-3


def test_without_modes_a_shaper_changes_nothing():
    assert Shaper.by_name("ei", [], []) == Shaper((0.0,), (1.0,))
    assert Shaper().delay == Shaper().lag == 0.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Shaper.zv(0.0), "frequency above 0 rad/s"),
        (lambda: Shaper.zvd(math.inf), "frequency above 0 rad/s"),
        (lambda: Shaper.zv(1.0, 1.0), "damping ratio from 0 to below 1, not 1 and 1"),
        (lambda: Shaper.ei(1.0, -0.1), "damping ratio from 0"),
        (lambda: Shaper.ei(1.0, 0.31), "damping ratio of 0.3 at most"),
        (lambda: Shaper.ei(1.0, 0.1, 0.3), "tolerance of 0.001 to 0.2"),
        (lambda: Shaper.ei(1.0, 0.1, 0.0), "tolerance of 0.001 to 0.2"),
        (lambda: Shaper.by_name("zw", [1.0], [0.0]), "one of zv, zvd, ei, not 'zw'"),
        (lambda: Shaper.by_name("zv", [1.0, 2.0], [0.0]), "shorter"),
        (lambda: Shaper((0.0, 1.0), (1.0,)), "times must ascend"),
        (lambda: Shaper((), ()), "times must ascend"),
        (lambda: Shaper((0.1,), (1.0,)), "times must ascend"),
        (lambda: Shaper((0.0, 2.0, 1.0), (0.5, 0.25, 0.25)), "times must ascend"),
        (lambda: Shaper((0.0, math.nan), (0.5, 0.5)), "times must ascend"),
        (lambda: Shaper((0.0, math.inf), (0.5, 0.5)), "times must ascend"),
        (lambda: Shaper((0.0, 1.0), (0.6, 0.6)), "amplitudes must be positive with sum 1"),
        (lambda: Shaper((0.0, 1.0), (1.5, -0.5)), "amplitudes must be positive with sum 1"),
        (lambda: Shaper((0.0, 1.0), (math.nan, 0.5)), "amplitudes must be positive with sum 1"),
        (lambda: InputShaper(Shaper.zv(2.0 * math.pi * 60.0)), "below 50 Hz, not 60 Hz"),
        (
            lambda: InputShaper(Shaper.by_name("zvd", [2.0, 400.0], [0.0] * 2), 1, 0.02),
            "period of 0.02 s needs modes below 25 Hz, not 63.66 Hz",
        ),
    ],
)
def test_senseless_settings_are_refused_in_one_line(make, words):
    with pytest.raises(ValueError, match=words) as refused:
        make()
    assert "\n" not in str(refused.value)


# --- The system


# Half a period of the vibration is 0.3846 s: no multiple of these periods.
PERIODS = pytest.mark.parametrize("period", [0.01, 0.07, 0.25, 0.34])


def convolved(shaper, times, samples, at):
    """Straight lines (n) between samples, convolved with the impulses of a shaper."""
    parts = zip(shaper.times, shaper.amplitudes, strict=True)
    return sum(
        share * np.array([np.interp(at - later, times, column) for column in samples.T])
        for later, share in parts
    )


@PERIODS
@pytest.mark.parametrize("kind", ["zv", "zvd", "ei"])
def test_the_output_is_the_convolution_of_the_samples_at_all_times(stand, kind, period):
    shaper = Shaper.by_name(kind, [FREQUENCY, 1.1 * FREQUENCY], [0.02, 0.0])
    system = InputShaper(shaper, 2, period)
    random = np.random.default_rng(0)
    samples = random.normal(size=(60, 2)).cumsum(0)
    times = period * np.arange(1, 61)  # of the straight motion, one period after the samples
    shown = stand(system)
    for k, sample in enumerate(samples):
        shown.tick(command=sample)
        for share in (0.0, random.uniform(), 1.0):
            now = period * (k + share)
            shown.context.SetTime(now)
            expected = convolved(shaper, times, samples, now)
            np.testing.assert_allclose(shown["shaped_command"], expected, atol=1e-9)
    assert system.delay == shaper.delay + period
    assert system.lag == shaper.lag + period


@PERIODS
def test_a_ramp_lags_and_a_step_ends_after_the_delay(stand, period):
    system = InputShaper(Shaper.zvd(FREQUENCY, 0.05), 1, period)
    count = math.ceil(system.delay / period) + 1
    ramp, step = stand(system), stand(system, command=0.0).tick()
    for k in range(2 * count):
        ramp.tick(command=3.0 * k * period)
        step.tick(command=1.0)
        if k >= count:
            now = ramp.context.get_time()
            assert ramp["shaped_command"] == pytest.approx(3.0 * (now - system.lag))
            assert step["shaped_command"] == pytest.approx(1.0)
    step = stand(system, command=0.0).tick().tick(command=1.0)
    step.run(math.floor(system.delay / period) * period)
    assert step["shaped_command"] < 1.0 - 1e-3


def test_it_begins_at_rest_at_the_first_finite_command(stand):
    shown = stand(InputShaper(Shaper.zvd(FREQUENCY), 2), command=[0.7, -0.2])
    np.testing.assert_array_equal(shown["shaped_command"], (0.7, -0.2))
    shown.set(command=[math.nan, 5.0]).tick(3)
    np.testing.assert_array_equal(shown["shaped_command"], (math.nan, 5.0))
    for _ in range(100):
        shown.tick(command=[0.3, 0.4])
        np.testing.assert_allclose(shown["shaped_command"], (0.3, 0.4), rtol=1e-14)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_leaves_the_last_one(stand, bad):
    shaper = Shaper.zv(FREQUENCY)
    ignoring, holding = (stand(InputShaper(shaper, 2), command=[0.0, 0.0]).tick() for _ in "ab")
    ignoring.tick(3, command=[1.0, 2.0])
    holding.tick(3, command=[1.0, 2.0])
    for _ in range(60):
        ignoring.tick(command=[4.0, bad])
        holding.tick(command=[1.0, 2.0])
        np.testing.assert_array_equal(ignoring["shaped_command"], holding["shaped_command"])


def test_whatever_is_commanded_the_output_stays_in_its_range(stand):
    random = np.random.default_rng(5)
    shown = stand(InputShaper(Shaper.by_name("ei", [20.0, 90.0], [0.1, 0.2]), 1))
    commands = random.choice((-1e308, -3.0, 0.0, 1e308), 300)
    for k, command in enumerate(commands):
        value = shown.tick(command=command)["shaped_command"][0] / 1e308
        past = commands[: k + 1] / 1e308
        assert past.min() - 1e-12 <= value <= past.max() + 1e-12


def simulated(system, period):
    """Position and velocity by frequency [-] of a mode after a command, and the shown commands.

    The command is 0.5 until it jumps to 1.5 and goes on as a ramp.
    """
    knots = [[0.5, 0.5, 1.5, 2.5, 2.5]]
    command: PiecewisePolynomial = PiecewisePolynomial.FirstOrderHold(
        [-1.0, 2.0 * period - 1e-6, 2.0 * period, 2.0 * period + 0.5, 9.0], knots
    )
    matrix = [[0.0, 1.0], [-(FREQUENCY**2), -0.02 * FREQUENCY]]
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(command))
    mode = builder.AddSystem(LinearSystem(matrix, [[0.0], [FREQUENCY**2]], np.eye(2), [[0], [0]]))
    shaped = source
    if system is not None:
        shaped = builder.AddSystem(system)
        builder.Connect(source.get_output_port(), system.GetInputPort("command"))
    builder.Connect(shaped.get_output_port(), mode.get_input_port())
    log = LogVectorOutput(shaped.get_output_port(), builder, period)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    mode.GetMyMutableContextFromRoot(context).SetContinuousState([0.5, 0.0])
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.get_mutable_integrator().set_maximum_step_size(0.01)
    simulator.AdvanceTo(0.5 + 3.0 * period + (system.delay if system else 0.0))
    state = mode.GetMyContextFromRoot(context).get_continuous_state_vector()
    position, velocity = state.CopyToVector()
    samples = log.FindLog(context).data()[0]
    return np.array((position - 2.5, velocity / FREQUENCY)), samples


@pytest.mark.parametrize("period", [0.01, 0.07])
def test_in_a_diagram_a_mode_comes_to_rest_though_the_command_jumps(period):
    error, samples = simulated(InputShaper(Shaper.zvd(FREQUENCY, 0.01), 1, period), period)
    # The step of the integrator hits no corner of the command exactly.
    assert np.abs(error).max() < 2e-5
    assert samples[0] == 0.5
    assert (np.diff(samples) >= -1e-12).all()
    assert samples[-1] == pytest.approx(2.5)
    error, _ = simulated(None, period)
    assert np.abs(error).max() > 0.3
