"""Inertial measurement unit: the ADIS16448's gyro, accelerometer and magnetometer."""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common import RandomDistribution, RandomGenerator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
)
from pydrake.systems.primitives import RandomSource

from parapod.systems.ports import read
from parapod.systems.sensors.averaging_accelerometer import in_body

_DEGREE = math.radians(1.0)
# What an accelerometer's g and mg are counted in [m/s^2].
STANDARD_GRAVITY = 9.80665
_GAUSS = 1e-4
_SAMPLE_RATE = 819.2
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
        gyro_bias_correlation_time: of the Gauss-Markov process [s] (assumption, the value of
            the RotorS simulator for this sensor).
        accel_bias_correlation_time: likewise [s] (assumption, RotorS).
        gyro_turn_on_bias: constant part of the bias [rad/s]; RotorS draws it with 0.5 deg/s
            (1 sigma), which is left to the user here.
        accel_turn_on_bias: likewise [m/s2]; RotorS' 20 mg (1 sigma) are 1.15 deg of tilt.
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

    State: discrete, the last samples (3 each) and the in-run biases of gyro and accelerometer
    (6), Gauss-Markov processes that start from zero.

    Parameters (Context): turn-on biases of gyro and accelerometer (6), see `set_turn_on_bias`.

    Bad input: a NaN input or attitude reads zero, an infinite one saturates; noise that is not
    finite counts as none. Outputs are finite and within the range.
    """

    NOISE_SIZE = 15  # gyro 3, accel 3, mag 3, gyro bias 3, accel bias 3

    def __init__(self, params: ImuParams = ImuParams(), decimation: int = 3) -> None:
        super().__init__()
        if decimation < 0:
            raise ValueError(f"decimation must be 0 or more, not {decimation}")
        self.set_name("imu")
        self.params, self.decimation = params, decimation
        self.period = 2.0**decimation / _SAMPLE_RATE
        self._angular_velocity: Any = self.DeclareVectorInputPort("angular_velocity", 3)
        self._specific_force: Any = self.DeclareVectorInputPort("specific_force", 3)
        self._attitude: Any = self.DeclareVectorInputPort("attitude", 3)
        self._noise: Any = self.DeclareVectorInputPort("noise", self.NOISE_SIZE)
        self._turn_on_bias = self.DeclareNumericParameter(
            BasicVector(np.array(params.gyro_turn_on_bias + params.accel_turn_on_bias))
        )
        for name in ("gyro", "accel", "mag"):
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(3))
        self.DeclareDiscreteState(6)
        self.DeclareInitializationDiscreteUpdateEvent(self._update_first_sample)
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._update_sample)

        # One element an axis: gyro, accelerometer, magnetometer.
        to_deviation = math.sqrt(0.5 / self.period)
        self._deviation = to_deviation * _per_axis(
            params.gyro_noise_density, params.accel_noise_density, params.mag_noise_density
        )
        resolution = _per_axis(
            params.gyro_resolution, params.accel_resolution, params.mag_resolution
        )
        self._is_counted = resolution > 0.0
        self._resolution = np.where(self._is_counted, resolution, 1.0)
        limit = _per_axis(params.gyro_range, params.accel_range, params.mag_range)
        # Whole counts, so that a rounded reading cannot exceed the range.
        counts = np.floor(limit / self._resolution + 1e-6)
        self._limit = np.where(self._is_counted, counts * self._resolution, limit)

        decay_kick = np.array(
            [
                _gauss_markov(deviation, correlation_time, self.period)
                for deviation, correlation_time in (
                    (params.gyro_bias_instability, params.gyro_bias_correlation_time),
                    (params.accel_bias_instability, params.accel_bias_correlation_time),
                )
            ]
        )
        self._decay, self._kick = np.repeat(decay_kick, 3, axis=0).T

    def set_turn_on_bias(
        self, context: Context, gyro: ArrayLike = 0.0, accel: ArrayLike = 0.0
    ) -> None:
        """Sets the constant biases of gyro [rad/s] and accelerometer [m/s2] (3 or scalar).

        Raises:
            ValueError: a bias is not finite.
        """
        bias = np.concatenate((np.broadcast_to(gyro, 3), np.broadcast_to(accel, 3)))
        if not np.isfinite(bias).all():
            raise ValueError(f"turn-on biases must be finite, not {bias.tolist()}")
        context.get_mutable_numeric_parameter(self._turn_on_bias).SetFromVector(bias)

    def _update_first_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        drift = context.get_discrete_state(3).value()
        self._sample(context, discrete_state, self._read_noise(context), drift)

    def _update_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        noise = self._read_noise(context)
        drift = self._decay * context.get_discrete_state(3).value() + self._kick * noise[9:]
        discrete_state.set_value(3, drift)
        self._sample(context, discrete_state, noise, drift)

    def _read_noise(self, context: Context) -> NDArray[np.float64]:
        if not self._noise.HasValue(context):
            return np.zeros(self.NOISE_SIZE)
        noise = self._noise.EvalBasicVector(context).value()
        return noise if np.isfinite(noise).all() else np.where(np.isfinite(noise), noise, 0.0)

    def _sample(
        self,
        context: Context,
        discrete_state: DiscreteValues,
        noise: NDArray[np.float64],
        drift: NDArray[np.float64],
    ) -> None:
        field = self.params.magnetic_field
        if self._attitude.HasValue(context):
            field = in_body(field, *read(self._attitude, context))
        reading = np.array(
            [*read(self._angular_velocity, context), *read(self._specific_force, context), *field]
        )
        reading += self._deviation * noise[:9]
        reading[:6] += context.get_numeric_parameter(self._turn_on_bias).value() + drift
        if not np.isfinite(reading).all():
            reading = np.nan_to_num(reading, posinf=math.inf, neginf=-math.inf)
        reading = np.minimum(np.maximum(reading, -self._limit), self._limit)
        counted = np.rint(reading / self._resolution) * self._resolution
        reading = np.where(self._is_counted, counted, reading)
        discrete_state.set_value(0, reading[:3])
        discrete_state.set_value(1, reading[3:6])
        discrete_state.set_value(2, reading[6:])


def add_imu(
    builder: DiagramBuilder,
    params: ImuParams = ImuParams(),
    decimation: int = 3,
    name: str = "imu",
) -> tuple[Imu, RandomSource]:
    """Adds an IMU and the source of its noise, connected. Seed the source with `seed_noise`."""
    imu = Imu(params, decimation)
    imu.set_name(name)
    builder.AddSystem(imu)
    noise = RandomSource(RandomDistribution.kGaussian, Imu.NOISE_SIZE, imu.period)
    noise.set_name(f"{name}_noise")
    builder.AddSystem(noise)
    builder.Connect(noise.get_output_port(0), imu.GetInputPort("noise"))
    return imu, noise


def seed_noise(noise: RandomSource, root_context: Context, seed: int) -> None:
    """Makes the source's sequence a function of `seed` alone, in this context of the diagram.

    Without it every source made in a process gets another sequence.
    """
    context = noise.GetMyMutableContextFromRoot(root_context)
    noise.SetRandomContext(context, RandomGenerator(seed))


def _gauss_markov(deviation: float, correlation_time: float, period: float) -> tuple[float, float]:
    """Factors of state and unit noise in a step of a process with this stationary deviation."""
    decay = math.exp(-period / correlation_time)
    return decay, deviation * math.sqrt(1.0 - decay * decay)


def _per_axis(gyro: float, accel: float, mag: float) -> NDArray[np.float64]:
    return np.repeat([gyro, accel, mag], 3)
