"""Fit of a vibration that rings down: exact without noise, near enough with it."""

import math

import numpy as np
import pytest

from parapod.systems.arm.ringing import fit_ringing

TIME = np.arange(0.0, 5.0, 0.01)
LOW, HIGH = 2.0 * math.pi * 0.8, 2.0 * math.pi * 10.0


def ringing(frequency, damping, amplitude=1.0, phase=0.3):
    damped = frequency * math.sqrt(1.0 - damping**2)
    return amplitude * np.exp(-damping * frequency * TIME) * np.cos(damped * TIME + phase)


@pytest.mark.parametrize("hertz", [0.9, 2.2, 6.3])
@pytest.mark.parametrize("damping", [0.0, 0.01, 0.04])
def test_it_is_exact_without_noise_below_a_trend(hertz, damping):
    omega = 2.0 * math.pi * hertz
    trend = 3.0 - 2.0 * TIME + 0.5 * TIME**2 - 0.02 * TIME**3
    signals = np.stack([ringing(omega, damping) + trend, ringing(omega, damping, 3.0, 2.0)], 1)
    found = fit_ringing(TIME, signals, LOW, HIGH)
    assert found.frequency == pytest.approx(omega, rel=1e-4)
    assert found.damping_ratio == pytest.approx(damping, abs=2e-4)
    assert found.ratios.min() > 1e3


@pytest.mark.parametrize("seed", range(3))
def test_signals_that_share_a_vibration_tell_more_than_their_noise(seed):
    random = np.random.default_rng(seed)
    omega = 2.0 * math.pi * 2.2
    phases = random.uniform(0.0, 6.0, 4)
    signals = np.stack([ringing(omega, 0.005, 0.8, phase) for phase in phases], 1)
    signals += random.normal(size=signals.shape)
    found = fit_ringing(TIME, signals * (1.0, 10.0, 0.1, 1.0), LOW, HIGH)
    assert found.frequency == pytest.approx(omega, rel=0.01)
    assert found.ratios.min() > 6.0


def test_noise_alone_has_a_small_ratio():
    random = np.random.default_rng(4)
    found = fit_ringing(TIME, random.normal(size=(len(TIME), 4)), LOW, HIGH)
    assert found.ratios.max() < 6.0


def test_a_signal_that_rests_counts_for_nothing():
    omega = 2.0 * math.pi * 2.2
    signals = np.stack([ringing(omega, 0.01), np.full(len(TIME), 2.0)], 1)
    found = fit_ringing(TIME, signals, LOW, HIGH)
    assert found.frequency == pytest.approx(omega, rel=1e-4)
    assert found.ratios[1] < 1.0


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="needs 18 samples or more, not 10"):
        fit_ringing(TIME[:10], np.zeros((10, 1)), LOW, HIGH)
