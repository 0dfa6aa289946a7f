"""Damping of a flexible rod by its base: an observer of its first modes, and what brakes them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem
from scipy.linalg import expm  # type: ignore[import-untyped]

from parapod.systems.arm.serial_arm import SerialArm, rotated
from parapod.systems.arm.vibration_feedforward import LumpedRod, Response, at_once
from parapod.systems.core.ports import elements, is_on, read, read_or_zeros
from parapod.systems.core.triples import Vector3, cross, dot, plus
from parapod.systems.core.vectors import Array, rotation_columns

# Samples by which what is observed is late when it is shown: the second differences are, by one,
# and encoders of the joints show the sample before.
_LATE = 2
# Groups of the discrete state; samples, newest first, of places (6) and displacements (2).
_SHOWN, _MODES, _SAMPLES = range(3)
_SAMPLE, _COUNT = 8, 3
_ABSURD = 1e6  # sum of numbers that no measured motion has
# Share of the damping that sets in, or ceases, with each sample [-].
_SETTING_IN = 0.1


class VibrationDamper(LeafSystem):
    """Displacement of a rod by its base that damps the rod's first modes.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `arm_position` | n | rad or m | positions of the arm's joints |
    | in `posture_desired_state` | 6 | rad, rad, m and rates | base without damping |
    | in `posture` | 3 | rad, rad, m | base as measured; its height over what it turns about |
    | in `fed_forward` | 4 | m, m/s | displacement by a feedforward; unconnected: 0 |
    | in `enable` | 1 | - | above 0.5: observe and damp; otherwise the modes are at rest |
    | out `displacement` | 4 | m, m/s | of the modes' places across, in x and y, and rates |

    The observer has the equation of `vibration_feedforward` in both planes. With y = x + u, where
    u is how far the base has moved the place off the desired posture,

        y'' + 2 d omega y' + omega^2 (y - u) = -e . P''

    with the place's acceleration by the joints and the desired posture alone. So the measured
    motion of the base is not differentiated. The base follows u = -2 `damping` y' / omega, ahead
    by its own lag, which adds `damping` to the mode's damping ratio.

    While a feedforward moves the base the damper observes only: what is planned is not to be
    damped. It ceases and sets in over a few samples.

    The rod has no sensor: only what the clamp does to it is observed, a push at its tip is not.

    State: discrete, displacement and rates (4); y and y' in both planes (4) [m, m/s]; places (6)
    and u (2) at the last three samples [m], whether they are known (1), and the share of the
    damping that has set in (1); updated every period.

    Bad input: while a measurement is not finite, or absurd, the modes are taken to be at rest.
    """

    def __init__(
        self,
        rod: LumpedRod,
        arm: SerialArm,
        period: float = 0.01,
        damping: float = 0.2,
        response: Response = at_once,
    ):
        """Creates the system.

        Args:
            rod: the modes.
            arm: the arm that carries the rod as its last link.
            period: time between two samples [s].
            damping: damping ratio that is added [-].
            response: factor by which the base follows samples z^k of what it is asked for.
        """
        super().__init__()
        self.set_name("vibration_damper")
        self._rod, self._arm, self._period = rod, arm, period
        self._steps = [_step(omega, rod.damping_ratio, period) for omega in rod.frequencies]
        self._gains = [_gains(omega, damping, period, response) for omega in rod.frequencies]
        self._position = self.DeclareVectorInputPort("arm_position", arm.count)
        self._desired = self.DeclareVectorInputPort("posture_desired_state", 6)
        self._posture = self.DeclareVectorInputPort("posture", 3)
        self._fed_forward = self.DeclareVectorInputPort("fed_forward", 4)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        displacement: Any = self.DeclareDiscreteState(4)
        self.DeclareDiscreteState(4)
        self.DeclareDiscreteState(_COUNT * _SAMPLE + 2)
        self.DeclareStateOutputPort("displacement", displacement)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_modes)

    def _update_modes(self, context: Context, discrete_state: DiscreteValues) -> None:
        position, posture = read(self._position, context), read(self._posture, context)
        desired = read(self._desired, context)[:3]
        size = sum(map(abs, position + posture + desired))
        if not (is_on(self._enable, context) and size < _ABSURD):
            for group, size in ((_SHOWN, 4), (_MODES, 4), (_SAMPLES, _COUNT * _SAMPLE + 2)):
                discrete_state.set_value(group, np.zeros(size))
            return
        off = posture[0] - desired[0], posture[1] - desired[1], 0.0
        sample, axes = self._sample(position, desired, off)
        *past, is_known, share = elements(context.get_discrete_state(_SAMPLES))
        if not is_known:
            past = sample * _COUNT
            discrete_state.set_value(_MODES, np.array([sample[6], 0.0, sample[7], 0.0]))
        samples = [sample, past[:_SAMPLE], past[_SAMPLE : 2 * _SAMPLE]]
        waits = any(read_or_zeros(self._fed_forward, context))
        share = max(0.0, share - _SETTING_IN) if waits else min(1.0, share + _SETTING_IN)
        kept = past[: 2 * _SAMPLE]
        discrete_state.set_value(_SAMPLES, np.array([*sample, *kept, 1.0, share]))
        if is_known:
            modes = elements(context.get_discrete_state(_MODES))
            braking, ahead = self._observe(modes, samples, axes)
            moved = [share * way for way in braking]
            before, h = elements(context.get_discrete_state(_SHOWN)), self._period
            rates = [(now - last) / h for now, last in zip(moved, before[:2], strict=True)]
            discrete_state.set_value(_SHOWN, np.array(moved + rates))
            discrete_state.set_value(_MODES, np.array(ahead))

    def _observe(
        self, modes: Sequence[float], samples: Sequence[Sequence[float]], axes: Sequence[Vector3]
    ) -> tuple[list[float], list[float]]:
        """Displacements (2) that brake the modes, and the modes (4) a period later."""
        braking: list[float] = []
        ahead: list[float] = []
        for plane, (axis, omega) in enumerate(zip(axes, self._rod.frequencies, strict=True)):
            now, last, before = (sample[3 * plane : 3 * plane + 3] for sample in samples)
            change = [a - 2.0 * b + c for a, b, c in zip(now, last, before, strict=True)]
            # Of about the instant of the acceleration: drives of legs and joints lag as well.
            load = omega**2 * samples[1][6 + plane] - dot(axis, change) / self._period**2
            mode = modes[2 * plane : 2 * plane + 2]
            place, rate = (self._steps[plane] @ (*mode, load)).tolist()
            by_rate, by_change = self._gains[plane].tolist()
            braking.append(by_rate * rate + by_change * (rate - mode[1]) / self._period)
            ahead += place, rate
        return braking, ahead

    def _sample(
        self, position: Sequence[float], desired: Sequence[float], off: Vector3
    ) -> tuple[list[float], list[Vector3]]:
        """Places (6) on a base as desired, displacements (2) by what it is off; axes across."""
        roll, pitch, height = desired
        rows: Any = tuple(zip(*rotation_columns(roll, pitch, 0.0), strict=True))
        places: list[float] = []
        axes, moved = [], []
        for place, axis in self._rod.places(self._arm, position):
            over = plus(place, (0.0, 0.0, height))
            places += rotated(rows, over)
            axes.append(rotated(rows, axis))
            moved.append(dot(axis, cross(off, over)))
        return places + moved, axes


def _step(omega: float, damping_ratio: float, period: float) -> Array:
    """Matrix (2, 3) from a mode's place, its rate and a constant load to both a period later."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1] = 1.0, (-(omega**2), -2.0 * damping_ratio * omega, 1.0)
    step: Array = expm(period * whole)[:2]
    return step


def _gains(omega: float, damping: float, period: float, response: Response) -> Array:
    """Factors of y' [s], and of its difference by the period [s^2]."""
    z = complex(np.exp(1j * omega * period))
    target = -2.0 * damping / (omega * response(z) * z**-_LATE)
    ahead = (1.0 - 1.0 / z) / period
    parts = [[1.0, ahead.real], [0.0, ahead.imag]]
    gains: Array = np.linalg.solve(parts, [target.real, target.imag])
    return gains
