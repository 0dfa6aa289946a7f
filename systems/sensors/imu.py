"""Inertial measurement unit: the ADIS16448's gyro, accelerometer and magnetometer.

Each axis has noise, whole counts, saturation and a drifting bias.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
)

from parapod.systems.core.elementwise import Elementwise, all_finite, copysign, is_finite, where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.core.ports import elements, has_value, read, read_or_zeros
from parapod.systems.core.vectors import Axes
from parapod.systems.sensors.noise import NoiseSource


class SensorAxis(NamedTuple):
    """Model of one axis: from a value to a reading.

    Attributes:
        deviation: standard deviation of a sample's noise.
        resolution: one count; 0 for none.
        limit: largest reading.
    """

    deviation: float
    resolution: float
    limit: float

    @classmethod
    def sampled(cls, period: float, noise_density: float, resolution: float, limit: float) -> Self:
        """An axis with one-sided white noise that is sampled with that period [s].

        The limit becomes one in whole counts, so that a rounded reading cannot exceed it.
        """
        if resolution:
            limit = math.floor(limit / resolution + 1e-6) * resolution
        return cls(math.sqrt(0.5 / period) * noise_density, resolution, limit)

    def read(self, value: Elementwise, noise: Elementwise) -> Elementwise:
        """The reading, in whole counts and within the limit; zero for NaN.

        Args:
            value: measured value, with its biases.
            noise: unit Gaussian.
        """
        deviation, resolution, limit = self
        value = value + deviation * noise
        if not -limit < value < limit:
            return 0.0 if value != value else copysign(limit, value)
        return round(value / resolution) * resolution if resolution else value


class Drift(NamedTuple):
    """First-order Gauss-Markov process, from one sample to the next.

    Attributes:
        decay: factor of the state.
        kick: factor of unit Gaussian noise.
    """

    decay: float
    kick: float

    @classmethod
    def sampled(cls, period: float, deviation: float, correlation_time: float) -> Self:
        """A process with this stationary deviation, times in [s]."""
        decay = math.exp(-period / correlation_time)
        return cls(decay, deviation * math.sqrt(1.0 - decay * decay))


_DEGREE = math.radians(1.0)
_GAUSS = 1e-4
_SAMPLE_RATE = 819.2
# Eight samples are averaged: the rate nearest to a controller's 100 Hz.
_DECIMATION = 3
_NO_BIAS = (0.0, 0.0, 0.0)

type Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class ImuParams:
    """Imperfections of the sensor; zero switches one off.

    Sources: "data sheet" is that of the ADIS16448. Noise densities are one-sided, so a sample's
    standard deviation is density * sqrt(rate / 2). Bias instabilities are the data sheet's
    "in-run bias stability", used as the standard deviation of a first-order Gauss-Markov
    process. Misalignment, scale errors and temperature are not modelled.

    Attributes:
        gyro_noise_density: 0.0135 deg/s/sqrt(Hz) [rad/s/sqrt(Hz)] (data sheet).
        accel_noise_density: 0.23 mg/sqrt(Hz) [m/s2/sqrt(Hz)] (data sheet).
        mag_noise_density: 0.06 mgauss/sqrt(Hz) [T/sqrt(Hz)] (assumption).
        gyro_bias_instability: 14.5 deg/h [rad/s] (data sheet).
        accel_bias_instability: 0.25 mg [m/s2] (data sheet).
        gyro_bias_correlation_time: correlation time of the Gauss-Markov process [s] (assumption,
            the value of the RotorS simulator for this sensor).
        accel_bias_correlation_time: correlation time of the accelerometer's process [s]
            (assumption, RotorS).
        gyro_turn_on_bias: constant part of the bias [rad/s]; RotorS draws it with 0.5 deg/s
            (1 sigma), which is left to the user here.
        accel_turn_on_bias: accelerometer's [m/s2]; RotorS' 20 mg (1 sigma) are 1.15 deg.
        gyro_resolution: one count, 0.04 deg/s [rad/s] (data sheet).
        accel_resolution: one count, 1/1200 g [m/s2] (data sheet).
        mag_resolution: one count, 1/7 mgauss [T] (data sheet).
        gyro_range: saturation, 1000 deg/s [rad/s] (data sheet).
        accel_range: saturation, 18 g [m/s2] (data sheet).
        mag_range: saturation, 1.9 gauss [T] (data sheet).
        magnetic_field: earth's field in the world's axes (x to magnetic north, z up) [T]; 22 uT
            horizontal and 42 uT down are typical of central Europe (assumption).
    """

    gyro_noise_density: float = 0.0135 * _DEGREE
    accel_noise_density: float = 0.23e-3 * STANDARD_GRAVITY
    mag_noise_density: float = 0.06e-3 * _GAUSS
    gyro_bias_instability: float = 14.5 / 3600.0 * _DEGREE
    accel_bias_instability: float = 0.25e-3 * STANDARD_GRAVITY
    gyro_bias_correlation_time: float = 1000.0
    accel_bias_correlation_time: float = 300.0
    gyro_turn_on_bias: Vector3 = (0.0, 0.0, 0.0)
    accel_turn_on_bias: Vector3 = (0.0, 0.0, 0.0)
    gyro_resolution: float = 0.04 * _DEGREE
    accel_resolution: float = STANDARD_GRAVITY / 1200.0
    mag_resolution: float = 1e-3 / 7.0 * _GAUSS
    gyro_range: float = 1000.0 * _DEGREE
    accel_range: float = 18.0 * STANDARD_GRAVITY
    mag_range: float = 1.9 * _GAUSS
    magnetic_field: Vector3 = (22e-6, 0.0, -42e-6)

    @classmethod
    def ideal(cls) -> Self:
        """A sensor without noise, bias or quantisation; it still samples and saturates."""
        return cls().without_noise().without_bias().without_quantisation()

    def without_noise(self) -> Self:
        """The same sensor without white noise."""
        return replace(
            self, gyro_noise_density=0.0, accel_noise_density=0.0, mag_noise_density=0.0
        )

    def without_bias(self) -> Self:
        """The same sensor without turn-on bias and bias instability."""
        return replace(
            self,
            gyro_bias_instability=0.0,
            accel_bias_instability=0.0,
            gyro_turn_on_bias=_NO_BIAS,
            accel_turn_on_bias=_NO_BIAS,
        )

    def without_quantisation(self) -> Self:
        """The same sensor with unlimited resolution."""
        return replace(self, gyro_resolution=0.0, accel_resolution=0.0, mag_resolution=0.0)

    def axes(self, period: float) -> list[SensorAxis]:
        """An axis of gyro, accelerometer and magnetometer each, sampled with that period [s]."""
        return [
            SensorAxis.sampled(period, density, resolution, limit)
            for density, resolution, limit in (
                (self.gyro_noise_density, self.gyro_resolution, self.gyro_range),
                (self.accel_noise_density, self.accel_resolution, self.accel_range),
                (self.mag_noise_density, self.mag_resolution, self.mag_range),
            )
        ]

    def drifts(self, period: float) -> list[Drift]:
        """In-run biases of gyro and accelerometer."""
        return [
            Drift.sampled(period, deviation, correlation_time)
            for deviation, correlation_time in (
                (self.gyro_bias_instability, self.gyro_bias_correlation_time),
                (self.accel_bias_instability, self.accel_bias_correlation_time),
            )
        ]


class Imu(LeafSystem):
    """Sampled gyro, accelerometer and magnetometer with noise, biases, counts and saturation.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `angular_velocity` | 3 | rad/s | true angular velocity in the body's axes |
    | in `specific_force` | 3 | m/s2 | true specific force in the body's axes; level: (0, 0, g) |
    | in `attitude` | 3 | rad | roll, pitch, yaw, R = R_z R_y R_x; unconnected: level |
    | in `noise` | 15 | - | unit Gaussian white noise, see `add_imu`; unconnected: noise-free |
    | out `gyro` | 3 | rad/s | last sample |
    | out `accel` | 3 | m/s2 | last sample |
    | out `mag` | 3 | T | last sample |

    The period is 2^decimation / 819.2 s, as the device's decimation filter sets it; the filter's
    delay and pass band are not modelled. Initialization takes a sample as well, so outputs are
    measurements from the start.

    State: discrete, the last samples of gyro and accelerometer (3 each); and (12) the in-run
    biases of both (6), Gauss-Markov processes that start from zero, with attitude and noise of
    the magnetometer's last sample (6), whose reading is worked out where it is read.

    Parameters (Context): turn-on biases of gyro and accelerometer (6), see `set_turn_on_bias`.

    Bad input: a NaN input or attitude reads zero, an infinite one saturates; noise that is not
    finite counts as none. Outputs are finite and within the range.
    """

    NOISE_SIZE = 15  # gyro 3, accel 3, mag 3, gyro bias 3, accel bias 3

    def __init__(self, params: ImuParams = ImuParams(), decimation: int = _DECIMATION) -> None:
        super().__init__()
        self.set_name("imu")
        self.params, self.decimation = params, decimation
        self.period = sample_period(decimation)
        self._angular_velocity: Any = self.DeclareVectorInputPort("angular_velocity", 3)
        self._specific_force: Any = self.DeclareVectorInputPort("specific_force", 3)
        self._attitude: Any = self.DeclareVectorInputPort("attitude", 3)
        self._noise: Any = self.DeclareVectorInputPort("noise", self.NOISE_SIZE)
        self._turn_on_bias = self.DeclareNumericParameter(
            BasicVector(np.array(params.gyro_turn_on_bias + params.accel_turn_on_bias))
        )
        for name in ("gyro", "accel"):
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(3))
        hidden = self.discrete_state_ticket(self.DeclareDiscreteState(12))
        self.DeclareVectorOutputPort("mag", 3, self._calc_mag, {hidden})
        self.DeclareInitializationDiscreteUpdateEvent(self._update_first_sample)
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._update_sample)

        gyro, accel, self._mag_axis = params.axes(self.period)
        self._axes = (gyro,) * 3 + (accel,) * 3
        self._drifts = [drift for drift in params.drifts(self.period) for _ in range(3)]

    def set_turn_on_bias(
        self, context: Context, gyro: ArrayLike = 0.0, accel: ArrayLike = 0.0
    ) -> None:
        """Sets the constant biases of gyro [rad/s] and accelerometer [m/s2] (3 or scalar).

        Raises:
            ValueError: a bias is not finite.
        """
        bias = np.concatenate((np.broadcast_to(gyro, 3), np.broadcast_to(accel, 3)))
        if not all_finite(bias):
            raise ValueError(f"turn-on biases must be finite, not {bias.tolist()}")
        context.get_mutable_numeric_parameter(self._turn_on_bias).SetFromVector(bias)

    def _update_first_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        drift = elements(context.get_discrete_state(2))[:6]
        self._sample(context, discrete_state, self._read_noise(context), drift)

    def _update_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        noise = self._read_noise(context)
        drift = elements(context.get_discrete_state(2))[:6]
        for i, (decay, kick) in enumerate(self._drifts):
            drift[i] = decay * drift[i] + kick * noise[9 + i]
        self._sample(context, discrete_state, noise, drift)

    def _read_noise(self, context: Context) -> list[float]:
        if not has_value(self._noise, context):
            return [0.0] * self.NOISE_SIZE
        noise = read(self._noise, context)
        if is_finite(sum(noise)):
            return noise
        return [where(is_finite(sample), sample, 0.0) for sample in noise]

    def _sample(
        self,
        context: Context,
        discrete_state: DiscreteValues,
        noise: list[float],
        drift: list[float],
    ) -> None:
        truth = read(self._angular_velocity, context) + read(self._specific_force, context)
        constant = elements(context.get_numeric_parameter(self._turn_on_bias))
        each = zip(self._axes, truth, constant, drift, noise, strict=False)
        reading = np.array([axis.read(a + b + c, sample) for axis, a, b, c, sample in each])
        discrete_state.set_value(0, reading[:3])
        discrete_state.set_value(1, reading[3:])
        attitude = read_or_zeros(self._attitude, context)
        discrete_state.set_value(2, np.array(drift + attitude + noise[6:9]))

    def _calc_mag(self, context: Context, output: BasicVector) -> None:
        roll, pitch, yaw, *noise = elements(context.get_discrete_state(2))[6:]
        field = Axes.from_roll_pitch_yaw(roll, pitch, yaw).components(self.params.magnetic_field)
        axis = self._mag_axis
        output.SetFromVector(
            np.array([axis.read(b, e) for b, e in zip(field, noise, strict=True)])
        )


def sample_period(decimation: int = _DECIMATION) -> float:
    """Time between two samples of the ADIS16448, 2^decimation / 819.2 s (data sheet) [s].

    Raises:
        ValueError: negative decimation.
    """
    if decimation < 0:
        raise ValueError(f"decimation must be 0 or more, not {decimation}")
    return 2.0**decimation / _SAMPLE_RATE


def add_imu(
    builder: DiagramBuilder,
    params: ImuParams = ImuParams(),
    decimation: int = _DECIMATION,
    name: str = "imu",
    seed: int = 0,
) -> tuple[Imu, NoiseSource]:
    """Adds an IMU and the source of its noise, connected and seeded."""
    imu = Imu(params, decimation)
    imu.set_name(name)
    builder.AddSystem(imu)
    noise = NoiseSource(Imu.NOISE_SIZE, imu.period, seed)
    noise.set_name(f"{name}_noise")
    builder.AddSystem(noise)
    builder.Connect(noise.get_output_port(), imu.GetInputPort("noise"))
    return imu, noise
