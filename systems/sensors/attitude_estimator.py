"""Roll and pitch from gyro and accelerometer: a complementary filter on gravity's direction."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.elementwise import (
    Elementwise,
    atan2,
    both,
    greatest,
    least,
    length_of,
    quotient,
    sin,
    sqrt,
    where,
)
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, read

_DEGREE = math.radians(1.0)
# Value of the state's sample count once the averaging is over.
_RUNNING = -1.0
# Layout of the discrete state.
_BIAS, _COUNT, _CALM, _MEAN, _OFF = slice(6, 9), 9, 10, slice(11, 14), 14


@dataclass(frozen=True)
class AttitudeEstimatorParams:
    """Design of the filter.

    Attributes:
        time_constant: tau [s]; both poles of the linearised filter lie at -1/tau (k_P = 2/tau,
            k_I = 1/tau^2 of Mahony's filter). About 2 s is the optimum for the densities of the
            ADIS16448's white noise, where its two sensors disturb the tilt equally.
        start_time: the first samples, over this time, are averaged [s] (design choice).
        rest_rate: a rate this far from the average ends the averaging: the body moves [rad/s]
            (design choice, 10 sigma of the ADIS16448's noise at 100 Hz).
        bias_limit: largest gyro bias believed [rad/s]; 4 times the turn-on bias of 0.5 deg/s
            (1 sigma) that the RotorS simulator gives the ADIS16448.
        rate_limit: a gyro sample beyond it is ignored [rad/s]; above the ADIS16448's range of
            1000 deg/s (data sheet).
        gravity: norm of the specific force at rest [m/s2].
        gate: departure of the accelerometer's norm from gravity at which its weight in the
            correction has fallen, linearly, to zero [m/s2] (design choice: 0.05 g, 30 sigma of
            the ADIS16448's noise).
        disturbance: departure of the accelerometer's norm from gravity with which a sample is no
            longer one of a body at rest or in a slow motion [m/s2] (design choice: 9 sigma of the
            noise).
        misfit: angle between accelerometer and estimated vertical that does the same [rad] (design
            choice: .5 m/s2 across it).
        fast: rate about any axis, bias taken off, that does the same [rad/s] (design choice:
            three times what postures are taken with).
        calm_time: time for which samples have to be calm until the attitude is trusted again [s]
            (design choice: twice the time constant, in which the filter forgets).
        mean_time: time constant over which the angle between accelerometer and estimated vertical
            is averaged to tell how far off the attitude is [s] (design choice: the ADIS16448's
            noise then leaves .01 deg).
    """

    time_constant: float = 2.0
    start_time: float = 1.0
    rest_rate: float = 1.0 * _DEGREE
    bias_limit: float = 2.0 * _DEGREE
    rate_limit: float = 20.0
    gravity: float = GRAVITY
    gate: float = 0.5
    disturbance: float = 0.15
    misfit: float = 0.05
    fast: float = 5.0 * _DEGREE
    calm_time: float = 4.0
    mean_time: float = 0.5


class AttitudeEstimator(LeafSystem):
    """Roll and pitch against gravity with estimation of the gyro's bias (Mahony's filter).

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `gyro` | 3 | rad/s | measured angular velocity in the body's axes |
    | in `accel` | 3 | m/s2 | measured specific force in the body's axes |
    | out `attitude` | 2 | rad | roll, pitch of R = R_y(pitch) R_x(roll) |
    | out `gyro_bias` | 3 | rad/s | estimated bias; its part about the vertical by averaging only |
    | out `trusted` | 1 | - | 1, or 0 where vibration or fast motion may mislead the attitude |
    | out `error` | 1 | rad | how far off the attitude may be, beside the accelerometer's bias |

    The filter carries v, the world's vertical in the body's axes, (-sin pitch, cos pitch sin
    roll, cos pitch cos roll): dv/dt = v x (gyro - bias + k_P e), dbias/dt = -k_I e, with e =
    accel x v / |accel|. The correction e weighs less the further |accel| is from gravity.

    Start: until `start_time` the body is taken to be at rest, accelerometer and gyro are
    averaged (gain 1/k); motion ends that early. Until the first update the attitude is that
    of the present accelerometer reading, so the output never jumps from zero.

    Error: a filter that has settled differs from the accelerometer by noise alone. The mean of e,
    which is that difference, tells how far it still has to go; the largest such angle is
    remembered for as long as the filter takes to forget it, as a filter that swings back passes
    through zero.

    State: discrete, v (3), last good gyro sample (3), gyro bias (3), number of samples averaged
    (1), -1 once the averaging is over, for how long samples have been calm (1), mean of e (3),
    error (1).

    Parameters (Context): time constant (1) [s], at least two periods.

    Bad input: a gyro sample that is not finite or beyond `rate_limit` is replaced by the last
    good one; an accelerometer sample outside the gate, not finite or zero is ignored (the first
    one must lie within half to twice gravity). Outputs are always finite.
    """

    def __init__(
        self,
        params: AttitudeEstimatorParams = AttitudeEstimatorParams(),
        period: float = 0.01,
    ) -> None:
        super().__init__()
        self.set_name("attitude_estimator")
        self.params, self.period = params, period
        self._gyro: Any = self.DeclareVectorInputPort("gyro", 3)
        self._accel: Any = self.DeclareVectorInputPort("accel", 3)
        self._time_constant = self.DeclareNumericParameter(
            BasicVector(np.array([params.time_constant]))
        )
        state = self.DeclareDiscreteState(
            np.array([0.0, 0.0, 1.0, *[0.0] * 6, 0.0, params.calm_time, *[0.0] * 4])
        )
        ticket = self.discrete_state_ticket(state)
        self.DeclareVectorOutputPort(
            "attitude",
            2,
            self._calc_attitude,
            prerequisites_of_calc={ticket, self._accel.ticket()},
        )
        self.DeclareVectorOutputPort(
            "gyro_bias", 3, self._calc_gyro_bias, prerequisites_of_calc={ticket}
        )
        self.DeclareVectorOutputPort(
            "trusted",
            1,
            self._calc_trusted,
            prerequisites_of_calc={ticket},
        )
        self.DeclareVectorOutputPort("error", 1, self._calc_error, prerequisites_of_calc={ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_filter)
        self._start_samples = max(1, round(params.start_time / period))

    def _calc_attitude(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        (x, y, z), count = state[:3], state[_COUNT]
        if count == 0.0:
            accel = read(self._accel, context)
            if self._may_start(length_of(*accel)):
                x, y, z = accel
        roll, pitch = atan2(y, z), atan2(-x, sqrt(y * y + z * z))
        output.SetFromVector(np.array([roll, pitch]))

    def _calc_gyro_bias(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(elements(context.get_discrete_state_vector())[_BIAS]))

    def _calc_trusted(self, context: Context, output: BasicVector) -> None:
        calm = context.get_discrete_state_vector()[_CALM]
        output.SetFromVector(np.array([where(calm >= self.params.calm_time - 1e-9, 1.0, 0.0)]))

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([context.get_discrete_state_vector()[_OFF]]))

    def _update_filter(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = elements(context.get_discrete_state_vector())
        up, last, bias, mean = state[:3], state[3:6], state[_BIAS], state[_MEAN]
        count, calm, off = state[_COUNT], state[_CALM], state[_OFF]
        gyro = read(self._gyro, context)
        accel = read(self._accel, context)
        if not _is_within(gyro, self.params.rate_limit):
            gyro = last
        norm = length_of(*accel)
        if count > 0.0 and not _is_close(gyro, bias, self.params.rest_rate):
            count = _RUNNING
        tau = context.get_numeric_parameter(self._time_constant)[0]
        if count and self._weight(norm) > 0.0:
            off = self._moved_error(mean, off, _cross(accel, up), norm, tau)
        if count == _RUNNING:
            is_calm = self._is_calm(up, bias, gyro, accel, norm)
            calm = where(is_calm, least(calm + self.period, self.params.calm_time), 0.0)
            self._correct(up, bias, last, gyro, accel, norm, tau)
        elif count > 0.0 or self._may_start(norm):
            count = self._average(up, bias, gyro, accel, norm, count)
        discrete_state.set_value(np.array([*up, *gyro, *bias, count, calm, *mean, off]))

    def _moved_error(
        self,
        mean: list[Elementwise],
        off: Elementwise,
        across: list[Elementwise],
        norm: Elementwise,
        tau: Elementwise,
    ) -> Elementwise:
        """Moves the mean of e, in place, toward a sample; returns the next error."""
        gain = self.period / (self.params.mean_time + self.period)
        for i in range(3):
            mean[i] = mean[i] + gain * (across[i] / norm - mean[i])
        forgotten = off * tau / (tau + self.period)
        return greatest(forgotten, length_of(*mean))

    def _average(
        self,
        up: list[Elementwise],
        bias: list[Elementwise],
        gyro: list[Elementwise],
        accel: list[Elementwise],
        norm: Elementwise,
        count: Elementwise,
    ) -> Elementwise:
        """Moves the running means `up` and `bias` toward a sample; returns the new count."""
        weight = self._weight(norm) if count > 0.0 else 1.0
        count += 1.0
        if weight > 0.0:
            gain = weight / count
            for i in range(3):
                up[i] += gain * (accel[i] / norm - up[i])
        if count == 1.0 and not _is_within(gyro, self.params.bias_limit):
            return _RUNNING
        for i in range(3):
            bias[i] += (gyro[i] - bias[i]) / count
        self._limit(bias)
        return count if count < self._start_samples else _RUNNING

    def _correct(
        self,
        up: list[Elementwise],
        bias: list[Elementwise],
        last: list[Elementwise],
        gyro: list[Elementwise],
        accel: list[Elementwise],
        norm: Elementwise,
        time_constant: float,
    ) -> None:
        """One step of Mahony's filter: turns `up` and integrates `bias`, both in place."""
        dt = self.period
        # Prediction: v turns by -angle about the rate, the mean of the last two samples; exact
        # for a constant rate (Rodrigues).
        v_x, v_y, v_z = up
        b_x, b_y, b_z = bias
        x = (0.5 * (last[0] + gyro[0]) - b_x) * dt
        y = (0.5 * (last[1] + gyro[1]) - b_y) * dt
        z = (0.5 * (last[2] + gyro[2]) - b_z) * dt
        angle = sqrt(x * x + y * y + z * z)
        turns = angle > 0.0
        sine = where(turns, quotient(sin(angle), angle), 1.0)
        half = quotient(sin(0.5 * angle), angle)
        versine = where(turns, 2.0 * (half * half), 0.5)
        w_x, w_y, w_z = v_y * z - v_z * y, v_z * x - v_x * z, v_x * y - v_y * x
        v_x += sine * w_x + versine * (w_y * z - w_z * y)
        v_y += sine * w_y + versine * (w_z * x - w_x * z)
        v_z += sine * w_z + versine * (w_x * y - w_y * x)
        weight = self._weight(norm)
        if weight > 0.0:
            # Correction, after the prediction: the sample belongs to the step's end.
            tau = time_constant if time_constant > 2.0 * dt else 2.0 * dt
            a_x, a_y, a_z = accel
            scale = weight / norm
            e_x = scale * (a_y * v_z - a_z * v_y)
            e_y = scale * (a_z * v_x - a_x * v_z)
            e_z = scale * (a_x * v_y - a_y * v_x)
            k_p, k_i = 2.0 * dt / tau, dt / (tau * tau)
            v_x, v_y, v_z = (
                v_x + k_p * (v_y * e_z - v_z * e_y),
                v_y + k_p * (v_z * e_x - v_x * e_z),
                v_z + k_p * (v_x * e_y - v_y * e_x),
            )
            bias[:] = b_x - k_i * e_x, b_y - k_i * e_y, b_z - k_i * e_z
            self._limit(bias)
        length = sqrt(v_x * v_x + v_y * v_y + v_z * v_z)
        if length > 0.0:
            up[0], up[1], up[2] = v_x / length, v_y / length, v_z / length

    def _weight(self, norm: Elementwise) -> Elementwise:
        """Trust in an accelerometer sample: 1 at gravity, 0 outside the gate and for NaN."""
        weight = 1.0 - abs(norm - self.params.gravity) / self.params.gate
        return where(weight > 0.0, weight, 0.0)

    def _is_calm(
        self,
        up: list[Elementwise],
        bias: list[Elementwise],
        gyro: list[Elementwise],
        accel: list[Elementwise],
        norm: Elementwise,
    ) -> Any:
        """Whether a sample is one of a body at rest or in a slow motion; False for NaN."""
        is_at_rest = abs(norm - self.params.gravity) <= self.params.disturbance
        is_upright = length_of(*_cross(accel, up)) <= self.params.misfit * norm
        is_slow = _is_close(gyro, bias, self.params.fast)
        return both(both(is_at_rest, is_upright), is_slow)

    def _may_start(self, norm: Elementwise) -> Any:
        return both(0.5 * self.params.gravity <= norm, norm <= 2.0 * self.params.gravity)

    def _limit(self, bias: list[Elementwise]) -> None:
        limit = self.params.bias_limit
        if _is_within(bias, limit):
            return
        for i in range(3):
            bias[i] = where(bias[i] > limit, limit, where(bias[i] < -limit, -limit, bias[i]))


def _cross(a: list[Elementwise], b: list[Elementwise]) -> list[Elementwise]:
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a, b
    return [a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x]


def _is_within(vector: list[Elementwise], limit: float) -> Any:
    """Whether no component exceeds the limit either way; False for NaN."""
    x, y, z = vector
    return both(both(abs(x) <= limit, abs(y) <= limit), abs(z) <= limit)


def _is_close(a: list[Elementwise], b: list[Elementwise], limit: float) -> Any:
    return _is_within([a[0] - b[0], a[1] - b[1], a[2] - b[2]], limit)
