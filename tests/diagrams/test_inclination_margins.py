"""Margins of the outer inclination loop, and the linear system that they are read from."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, LogVectorOutput, MatrixGain

from parapod.diagrams.levelling_platform.inclination_margins import (
    OpenLoop,
    alone,
    inclination_loop,
    margins,
    open_loop,
)
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add, connect

AXES = pytest.mark.parametrize("axis", [0, 1], ids=["roll", "pitch"])
PERIOD = LevellingScenario().control.period


def scenario_with(gain=1.0):
    scenario = LevellingScenario()
    scenario.control.outer_loop_gain = gain
    return scenario


@pytest.fixture(scope="module")
def loop():
    """loop(gain, gain_scale): the open loop."""
    loops = {}

    def get(gain=1.0, gain_scale=1.0):
        if (gain, gain_scale) not in loops:
            loops[gain, gain_scale] = open_loop(scenario_with(gain), gain_scale)
        return loops[gain, gain_scale]

    return get


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.0])
def test_the_loop_crosses_over_at_its_gain(loop, gain):
    for axis in margins(loop(gain)):
        assert axis.crossover == pytest.approx(gain, rel=0.05)


@pytest.mark.parametrize("gain_scale", [0.85, 1.0, 1.15])
@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_margins_are_wide_whatever_the_actuators_gain(loop, gain_scale, delay):
    for axis in margins(loop(1.0, gain_scale), delay):
        assert math.degrees(axis.phase) > 60.0
        assert axis.gain_db > 10.0


def test_a_delay_takes_its_angle_at_the_crossover_from_the_phase(loop):
    for without, late in zip(margins(loop()), margins(loop(), 0.1), strict=True):
        assert late.crossover == pytest.approx(without.crossover, rel=1e-3)
        assert without.phase - late.phase == pytest.approx(0.1 * without.crossover, rel=1e-2)
        assert late.gain < without.gain


@AXES
def test_the_delay_that_the_loop_bears_leaves_no_margin(loop, axis):
    bearable = margins(loop())[axis].delay
    assert margins(loop(), bearable)[axis].phase == pytest.approx(0.0, abs=2e-2)


def test_doubled_gain_halves_the_gain_margin(loop):
    for once, twice in zip(margins(loop(1.0)), margins(loop(2.0)), strict=True):
        assert once.gain / twice.gain == pytest.approx(2.0, rel=0.05)


def test_margins_know_their_other_units(loop):
    axis = margins(loop())[0]
    assert axis.gain_db == pytest.approx(20.0 * math.log10(axis.gain))
    assert replace(axis, gain=10.0).gain_db == pytest.approx(20.0)
    assert replace(axis, phase=1.5, crossover=3.0).delay == pytest.approx(0.5)


# Response


def test_at_low_frequency_the_loop_is_its_integrator(loop):
    frequency = np.geomspace(1e-3, 1e-2, 5)
    response = loop(1.5).response(frequency)
    integrator = 1.5 / (1j * frequency)
    for axis in range(2):
        np.testing.assert_allclose(response[:, axis, axis] / integrator, 1.0, atol=0.01)


def test_the_response_is_that_of_a_simulated_sine(loop):
    system, frequency = loop(), 3.0
    state = np.zeros(len(system.a))
    turns, samples = np.exp(1j * frequency * system.period), []
    # The integrator keeps what the sine begins with; a constant is orthogonal to whole turns.
    steps = round(2.0 * math.pi / (frequency * system.period)) * 20
    for k in range(steps):
        samples.append(system.c @ state)
        state = system.a @ state + system.b @ (np.imag(turns**k), 0.0)
    n = np.arange(steps)
    basis = np.column_stack(
        [np.cos(frequency * system.period * n), np.sin(frequency * system.period * n), n**0]
    )
    half = steps // 2
    (cosine, sine, _), *_ = np.linalg.lstsq(basis[half:], np.array(samples)[half:, 0], rcond=None)
    expected = -system.response([frequency])[0, 0, 0]
    assert sine + 1j * cosine == pytest.approx(expected, rel=1e-3)


def test_a_delay_turns_the_response_and_keeps_its_magnitude(loop):
    frequency = np.geomspace(0.1, 30.0, 7)
    without, late = loop().response(frequency), loop().response(frequency, 0.05)
    turned = without * np.exp(-0.05j * frequency)[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose(late, turned, rtol=1e-12)


def test_roll_and_pitch_alone_are_the_diagonal_where_they_are_not_coupled():
    rng = np.random.default_rng(0)
    response = rng.normal(size=(5, 2, 2)) + 1j * rng.normal(size=(5, 2, 2))
    response[:, 0, 1] = 0.0  # one way is enough
    for axis in range(2):
        np.testing.assert_array_equal(alone(response, axis), response[:, axis, axis])


@AXES
def test_an_axis_alone_is_the_loop_that_the_other_one_leaves(axis):
    rng = np.random.default_rng(1)
    response = rng.normal(size=(5, 2, 2)) + 1j * rng.normal(size=(5, 2, 2))
    # det(1 + L) is the return difference of one axis times the other's with the first closed.
    whole = np.linalg.det(np.eye(2) + response)
    product = (1.0 + alone(response, axis)) * (1.0 + response[:, 1 - axis, 1 - axis])
    np.testing.assert_allclose(product, whole, rtol=1e-12)


# Known loops


def integrator(gain):
    """Two loops gain / s, sampled, which read their state and thus the sample before."""
    return OpenLoop(np.eye(2), -gain * PERIOD * np.eye(2), np.eye(2), PERIOD)


@pytest.mark.parametrize("gain", [0.5, 5.0])
def test_margins_of_a_sampled_integrator_are_the_textbooks(gain):
    for axis in margins(integrator(gain)):
        # |k T / (z - 1)| = 1 at 2 sin(w T / 2) = k T; its phase is -90 deg - w T / 2.
        crossover = 2.0 / PERIOD * math.asin(0.5 * gain * PERIOD)
        assert axis.crossover == pytest.approx(crossover, rel=1e-4)
        assert axis.phase == pytest.approx(0.5 * math.pi - 0.5 * crossover * PERIOD, abs=1e-4)


def test_gain_margin_of_a_late_integrator_is_the_textbooks():
    # k e^-sL / s turns by 180 deg at w = pi / (2 L), where its gain is k / w.
    delay, gain = 0.2, 1.0
    late = delay + 0.5 * PERIOD  # sampling delays by half a period
    for axis in margins(integrator(gain), delay):
        assert axis.gain == pytest.approx(0.5 * math.pi / (late * gain), rel=2e-3)


def test_the_loop_closed_moves_as_its_linear_system_does(loop):
    """Half a degree that the sensor is wrong by turns the platform, with the loop's gain."""
    wrong, until = np.radians([0.5, -0.3]), 2.0
    builder = DiagramBuilder()
    opened = add(builder, inclination_loop(scenario_with(1.0), 0.85))
    seen, bias = add(builder, Adder(2, 2)), add(builder, ConstantVectorSource(wrong))
    angles = add(builder, MatrixGain(np.eye(2, 3)))
    connect(builder, opened.get_output_port(), angles.get_input_port())
    connect(builder, angles.get_output_port(), seen.get_input_port(0))
    connect(builder, bias.get_output_port(), seen.get_input_port(1))
    connect(builder, seen.get_output_port(), opened.get_input_port())
    log = LogVectorOutput(opened.get_output_port(), builder, PERIOD)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(until)
    simulated = log.FindLog(simulator.get_context()).data()[:2].T

    linear = loop(1.0, 0.85)
    state, expected = np.zeros(len(linear.a)), []
    for _ in simulated:
        expected.append(linear.c @ state)
        state = linear.a @ state + linear.b @ (expected[-1] + wrong)
    assert np.abs(simulated[-1] + wrong).max() < 0.2 * np.abs(wrong).max()
    np.testing.assert_allclose(simulated, expected, rtol=0.0, atol=1e-3 * np.abs(wrong).max())


def test_the_loop_oscillates_where_its_gain_margin_ends(loop):
    linear = loop()
    for factor, is_stable in ((0.99, True), (1.01, False)):
        gain = factor * min(axis.gain for axis in margins(linear))
        poles = np.abs(np.linalg.eigvals(linear.a + gain * linear.b @ linear.c))
        moving = poles[~np.isclose(poles, 1.0, atol=1e-9)]  # integrals that nothing reaches rest
        assert (moving.max() < 1.0) == is_stable
