"""Frequency and damping of a vibration that rings down, from signals in which it is hidden.

Each signal is a polynomial, one decaying vibration that all have in common, and noise:

    s_i(t) = p_i(t) + exp(-d omega t) (a_i cos(omega_d t) + b_i sin(omega_d t)) + noise.

Polynomials and both amplitudes are linear, and solved for by least squares wherever frequency and
damping are tried (variable projection: Golub and Pereyra, "The differentiation of pseudo-inverses
and nonlinear least squares problems whose variables separate", 1973).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize  # type: ignore[import-untyped]

from parapod.systems.core.vectors import Array

# Degree of the polynomials by the number of vibrations in the time, and least and largest degree.
_PER_VIBRATION, _DEGREES = 1.0, (4, 14)
# Frequencies that are tried, by those that the time tells apart [-]; damping ratio while they are.
_FINENESS, _USUAL_DAMPING = 4.0, 0.005
_LARGEST_DAMPING = 0.06


@dataclass(frozen=True)
class Ringing:
    """A vibration in signals.

    Attributes:
        frequency: angular frequency, undamped [rad/s].
        damping_ratio: damping ratio [-].
        ratios: amplitude in each signal (k) by the standard deviation that its estimate has from
            noise [-]; below about 4 it may be noise alone.
    """

    frequency: float
    damping_ratio: float
    ratios: Array


def fit_ringing(time: Array, signals: Array, lowest: float, highest: float) -> Ringing:
    """Finds the vibration that signals have in common.

    Args:
        time: times (n), ascending [s].
        signals: signals (n, k) of any units; each counts by its own noise.
        lowest: lowest angular frequency [rad/s].
        highest: highest angular frequency [rad/s].

    Raises:
        ValueError: too few samples for a polynomial and a vibration.
    """
    duration = float(time[-1] - time[0])
    vibrations = lowest * duration / (2.0 * math.pi)
    degree = int(min(max(_PER_VIBRATION * vibrations, _DEGREES[0]), _DEGREES[1]))
    if len(time) < 2 * (degree + 5):
        raise ValueError(f"a vibration needs {2 * (degree + 5)} samples or more, not {len(time)}")
    t = time - time[0]
    basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(2.0 * t / duration - 1.0, degree))
    rest = signals - basis @ (basis.T @ signals)
    scale = np.linalg.norm(rest, axis=0)
    rest = rest / np.where(scale > 0.0, scale, 1.0)

    def shares(frequency: float, damping: float) -> Array:
        """Shares (k) of the signals' squares that a vibration explains."""
        damped = frequency * math.sqrt(1.0 - damping**2)
        wave = np.stack([np.cos(damped * t), np.sin(damped * t)], axis=1)
        wave *= np.exp(-damping * frequency * t)[:, np.newaxis]
        wave, _ = np.linalg.qr(wave - basis @ (basis.T @ wave))
        explained: Array = ((wave.T @ rest) ** 2).sum(0)
        return explained

    def loss(values: Array) -> float:
        """Negative logarithm of the likelihood, each signal's noise being unknown."""
        frequency, damping = values
        if not (lowest <= frequency <= highest and 0.0 <= damping <= _LARGEST_DAMPING):
            return math.inf
        return float(np.log(np.maximum(1.0 - shares(frequency, damping), 1e-15)).sum())

    step = 2.0 * math.pi / (_FINENESS * duration)
    grid = np.arange(lowest, highest, step)
    best = min(grid, key=lambda frequency: loss(np.array((frequency, _USUAL_DAMPING))))
    simplex = [(best, _USUAL_DAMPING), (best + 0.5 * step, 0.01), (best - 0.3 * step, 0.02)]
    start = np.clip(simplex, (lowest, 0.0), (highest, _LARGEST_DAMPING))
    options = {"initial_simplex": start, "xatol": 1e-6, "fatol": 1e-9}
    frequency, damping = minimize(loss, start[0], method="Nelder-Mead", options=options).x
    explained = shares(frequency, damping)
    left = np.maximum(1.0 - explained, 1e-15) / (len(time) - degree - 5)
    return Ringing(float(frequency), float(damping), np.sqrt(explained / left))
