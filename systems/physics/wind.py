"""Gusts of wind near the ground, by their spectrum."""

import numpy as np
from numpy.typing import NDArray

# Density of air at 15 degrees Celsius, at the sea [kg/m^3].
AIR_DENSITY = 1.225


def kaimal_density(
    frequency: NDArray[np.float64], speed: float, deviation: float, length: float
) -> NDArray[np.float64]:
    """One-sided spectral density of the wind's speed along its direction [(m/s)^2/Hz].

    Source: Kaimal's spectrum in IEC 61400-1:2019, f S / sigma^2 = 4 x / (1 + 6 x)^(5/3) with
    x = f L / V; its L is 8.1 times .7 z, which 1.5 m above the ground is 8.5 m.

    Args:
        frequency: (n) above zero [Hz].
        speed: mean speed V [m/s].
        deviation: standard deviation sigma of the speed [m/s].
        length: length L of the gusts [m].
    """
    time = length / speed
    return 4.0 * deviation**2 * time / (1.0 + 6.0 * time * frequency) ** (5.0 / 3.0)


def gusts(
    count: int, period: float, speed: float, deviation: float, length: float, seed: int
) -> NDArray[np.float64]:
    """Samples (count) of the speed less its mean, whose spectrum is Kaimal's [m/s].

    Waves of all frequencies that the samples carry have phases drawn from the seed, and the
    density's amplitudes. So what is slower than all samples, or faster than two of them, is
    missing from the deviation.

    Args:
        count: number of samples, 2 or more.
        period: time between them [s].
        speed: mean speed [m/s].
        deviation: standard deviation of the speed [m/s].
        length: length of the gusts [m].
        seed: seed of the phases.
    """
    frequency = np.fft.rfftfreq(count, period)
    step = 1.0 / (count * period)
    amplitude = np.zeros(frequency.size)
    waves = kaimal_density(frequency[1:], speed, deviation, length)
    amplitude[1:] = np.sqrt(2.0 * waves * step)
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, frequency.size)
    return np.fft.irfft(0.5 * count * amplitude * np.exp(1j * phase), count)
