"""Unknowns and equations of the calibration: 36 numbers, one equation a standing foot.

Of a leg's nine dimensions and its encoder's offset, ten numbers, eight act on its foot. The vector
from the foot to F is a constant c minus the long side l_4 turned by psi, and l_6 and l_7 occur in
c only (`LegGeometry.p_MF`):

    c = (l_x + l_6 cos alpha cos beta, l_y + l_6 cos alpha sin beta, l_z + l_7 + l_6 sin alpha).

A wrong l_7 is therefore the same as a wrong l_z, and a wrong l_6 the same as wrong l_x, l_y and
l_z, exactly and in every pose. Here l_6 and l_7 keep their nominal values, and l_x, l_y and l_z
answer for them: the foot's place is identified, not the part that is off.

Parameters are arrays (36): for each leg `LEG_PARAMETERS`, then bias and ground, roll and pitch.
A recorded pose gives, for each foot that stands, Eqs. (9)-(12):

    g(attitude - bias, ground) . P_i(extension_i + offset_i; dimensions of leg i) + r = height.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.elementwise import Elementwise, nan_without_warning, sin_cos
from parapod.systems.core.triples import Vector3, dot, plus, scaled
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.geometry import (
    ANGLES,
    LEG_COUNT,
    LegDeviation,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.kinematics import estimate_ground
from parapod.systems.levelling_platform.leg import long_side
from parapod.systems.levelling_platform.plane import attitude_derivatives, normal_of, to_platform

type Floats = NDArray[np.float64]

# A leg's dimensions that act differently on its foot; l_6 and l_7 do not (see above).
IDENTIFIABLE = ("l_x", "l_y", "l_z", "beta", "l_3", "l_4", "alpha")
LEG_PARAMETERS = (*IDENTIFIABLE, "offset")
LEG_WIDTH = len(LEG_PARAMETERS)
_LEGS_END = LEG_COUNT * LEG_WIDTH
# Places of the bias of roll and pitch, and of the ground's roll and pitch, among the parameters.
BIAS = slice(_LEGS_END, _LEGS_END + 2)
GROUND = slice(_LEGS_END + 2, _LEGS_END + 4)
PARAMETER_COUNT = GROUND.stop


@dataclass(frozen=True)
class Tolerances:
    """Tolerance of each parameter, either way; uniform within.

    Attributes:
        length: tolerance of the legs' lengths [m].
        angle: tolerance of the legs' angles [rad].
        offset: tolerance of the encoders' offsets [m].
        bias: tolerance of the inertial sensor's roll and pitch [rad]; 1 mg of bias is 1 mrad.
        ground: tolerance of unknown ground from what the nominal legs make of it [rad].
    """

    length: float = 0.5e-3
    angle: float = np.radians(0.2)
    offset: float = 0.3e-3
    bias: float = 5e-3
    ground: float = np.radians(10.0)

    def of_parameters(self, nominal: PlatformGeometry) -> Floats:
        """The tolerance of each parameter (36), in the order of `parameter_names`.

        Those of l_x, l_y and l_z are larger than a single length's, because these answer for
        l_6 and l_7 too; the variances add.
        """
        rows = []
        for leg in nominal.legs:
            (ca, sa), (cb, sb) = leg.e_a, leg.e_b
            shares = {"l_x": (ca * cb,), "l_y": (ca * sb,), "l_z": (sa, 1.0)}
            for name in IDENTIFIABLE:
                single = self.angle if name in ANGLES else self.length
                rows.append(single * float(np.hypot.reduce((1.0, *shares.get(name, ())))))
            rows.append(self.offset)
        return np.array([*rows, self.bias, self.bias, self.ground, self.ground])


def parameter_names() -> tuple[str, ...]:
    """Names of the parameters (36) in words."""
    legs = [f"leg {i + 1}: {name}" for i in range(LEG_COUNT) for name in LEG_PARAMETERS]
    axes = ("roll", "pitch")
    bias = [f"accelerometer bias in {axis}" for axis in axes]
    return (*legs, *bias, *(f"the ground's {axis}" for axis in axes))


def deviated(nominal: PlatformGeometry, parameters: Floats) -> PlatformGeometry:
    """The geometry whose legs differ from nominal by the parameters (36)."""
    before = nominal.deviations or (LegDeviation(),) * LEG_COUNT
    rows = parameters[:_LEGS_END].reshape(LEG_COUNT, LEG_WIDTH)[:, : len(IDENTIFIABLE)].tolist()
    deviations = []
    for deviation, row in zip(before, rows, strict=True):
        deviated_legs = {
            name: getattr(deviation, name) + change
            for name, change in zip(IDENTIFIABLE, row, strict=True)
        }
        deviations.append(replace(deviation, **deviated_legs))
    return replace(nominal, deviations=tuple(deviations))


def offsets_of(parameters: Floats) -> Floats:
    """The encoders' offsets (4) among the parameters (36) [m]."""
    return parameters[:_LEGS_END].reshape(LEG_COUNT, LEG_WIDTH)[:, -1]


def equivalent_parameters(
    geometry: PlatformGeometry, nominal: PlatformGeometry, offsets: Floats, bias: Floats
) -> Floats:
    """The parameters (36) that act as a geometry whose every dimension differs from nominal.

    Args:
        geometry: the machine as built.
        nominal: geometry from which the parameters count.
        offsets: (4) what is added to the encoders' extensions [m].
        bias: (2) error of roll and pitch [rad].

    Returns:
        The parameters; those of the ground are zero.
    """
    rows = []
    for actual, reference, offset in zip(geometry.legs, nominal.legs, offsets, strict=True):
        # l_x, l_y, l_z that bring about the same c with the nominal l_6 and l_7.
        same = replace(actual, l_6=reference.l_6, l_7=reference.l_7)
        offset_of_foot = np.subtract(actual.p_MF, same.p_MF)
        lengths = np.add([actual.l_x, actual.l_y, actual.l_z], offset_of_foot)
        values = dict(zip(("l_x", "l_y", "l_z"), lengths.tolist(), strict=True))
        rows += [values.get(k, getattr(actual, k)) - getattr(reference, k) for k in IDENTIFIABLE]
        rows.append(float(offset))
    return np.array([*rows, *bias, 0.0, 0.0])


# Standard deviation of a height that was not measured: next to no weight, and yet a matrix that
# can be factorised [m].
_UNMEASURED = 1.0


def foot_derivatives(leg: LegGeometry, extension: Elementwise) -> tuple[Vector3, list[Vector3]]:
    """`leg.foot_to_centre`, and its derivatives by each of `LEG_PARAMETERS`.

    With P = c - (cb x, sb x, z) and (x, z) = l_4 (cos psi, sin psi), psi = alpha + delta, where
    d^2 = l_3^2 + l_4^2 + 2 l_3 l_4 cos delta gives delta's derivatives by d, l_3 and l_4.
    """
    x, z = long_side(leg, extension)
    (ca, sa), (cb, sb), (c_x, c_y, c_z) = leg.e_a, leg.e_b, leg.p_MF
    one, none = np.ones_like(x), np.zeros_like(x)
    # l_4 cos delta and l_4 sin delta.
    along, across = x * ca + z * sa, z * ca - x * sa
    by_psi: Vector3 = (cb * z, sb * z, -x)
    # c turns with alpha and beta through the coupler.
    by_alpha = (-cb * sa * leg.l_6, -sb * sa * leg.l_6, ca * leg.l_6)
    reach = ca * leg.l_6 - x
    delta_l_3 = (leg.l_3 + along) / (leg.l_3 * across)
    delta_l_4 = (leg.l_4 + leg.l_3 * along / leg.l_4) / (leg.l_3 * across)
    delta_d = -extension / (leg.l_3 * across)
    rates_of_shank = [scaled(by_psi, rate) for rate in (delta_l_3, delta_l_4, delta_d)]
    longer = (-cb * x / leg.l_4, -sb * x / leg.l_4, -z / leg.l_4)
    derivatives = [
        (one, none, none),
        (none, one, none),
        (none, none, one),
        (-sb * reach, cb * reach, none),
        rates_of_shank[0],
        plus(rates_of_shank[1], longer),
        plus(by_psi, by_alpha),
        rates_of_shank[2],
    ]
    return (c_x - cb * x, c_y - sb * x, c_z - z), derivatives


@dataclass(frozen=True, eq=False)
class StandingEquations:
    """The equations of all feet that stand, as functions of the parameters (36).

    Attributes:
        recording: the poses.
        nominal: the geometry from which the parameters count.
    """

    recording: PoseRecording
    nominal: PlatformGeometry

    def residual(self, parameters: Floats) -> Floats:
        """Heights of the feet above the ground (n, 4) [m]; zero in the air."""
        return self._evaluate(parameters)[0]

    def jacobian(self, parameters: Floats) -> Floats:
        """Derivative of `residual` by the parameters (n, 4, 36)."""
        return self._evaluate(parameters)[1]

    @property
    def count(self) -> int:
        """Number of equations: of standing feet, and of the sensor's bias."""
        recording = self.recording
        return int(recording.contact.sum()) + 2 * int(recording.referenced.sum())

    def whitened(self, parameters: Floats) -> tuple[Floats, Floats]:
        """All equations made independent and of unit variance.

        Beside the feet's there are those of the reference: attitude - bias = reference.

        Returns:
            Their residuals (m) and the derivatives of these by the parameters (m, 36).
        """
        recording, noise = self.recording, self.recording.noise
        residual, jacobian = self._evaluate(parameters)
        feet = (self._whitener @ residual[:, :, None]).reshape(-1)
        by_feet = (self._whitener @ jacobian).reshape(-1, PARAMETER_COUNT)
        if recording.reference is None:
            return feet, by_feet
        is_referenced = recording.referenced
        scale = 1.0 / np.hypot(noise.attitude, noise.reference)
        apart = (
            scale * (recording.attitude - parameters[BIAS] - recording.reference)[is_referenced]
        )
        by_apart = np.zeros((*apart.shape, PARAMETER_COUNT))
        by_apart[:, :, BIAS] = -scale * np.eye(2)
        return (
            np.concatenate([feet, apart.reshape(-1)]),
            np.vstack([by_feet, by_apart.reshape(-1, PARAMETER_COUNT)]),
        )

    @cached_property
    def _sensor_share(self) -> Floats:
        """Weight (n, 1) of the inertial sensor in the attitude; the rest is the reference's.

        The mean by inverse variances has an error that is independent of the difference's.
        """
        noise = self.recording.noise
        share = noise.reference**2 / (noise.reference**2 + noise.attitude**2)
        return np.where(self.recording.referenced, share, 1.0)[:, None]

    def _attitude(self, parameters: Floats) -> Floats:
        """Roll and pitch (n, 2) by all instruments [rad]."""
        recording, share = self.recording, self._sensor_share
        attitude = recording.attitude - parameters[BIAS]
        if recording.reference is None:
            return attitude
        reference = np.where(recording.referenced[:, None], recording.reference, 0.0)
        return share * attitude + (1.0 - share) * reference

    @cached_property
    def _whitener(self) -> Floats:
        """Matrices (n, 4, 4) that make a pose's equations independent, of unit variance.

        The four equations of a pose share the errors of attitude and height; those of the
        encoders act through the leg's transmission. Taken where nothing deviates.
        """
        recording, noise = self.recording, self.recording.noise
        jacobian = self.jacobian(self.start)
        by_extension = np.stack(
            [jacobian[:, i, LEG_WIDTH * (i + 1) - 1] for i in range(LEG_COUNT)], axis=-1
        )
        share = self._sensor_share[:, :, None]
        # The derivative by the bias is that by the attitude times the sensor's share.
        tilt = jacobian[:, :, BIAS] * (noise.attitude / np.sqrt(share))
        height = noise.height if recording.height is not None else _UNMEASURED
        covariance = tilt @ tilt.transpose(0, 2, 1) + height**2
        covariance += np.eye(LEG_COUNT) * (by_extension * noise.extension)[:, None, :] ** 2
        both = recording.contact[:, :, None] & recording.contact[:, None, :]
        factor = np.linalg.cholesky(np.where(both, covariance, np.eye(LEG_COUNT)))
        return np.where(both, np.linalg.inv(factor), 0.0)

    @cached_property
    def start(self) -> Floats:
        """Parameters (36) from which to begin: nothing deviates, the ground as it then seems."""
        parameters = np.zeros(PARAMETER_COUNT)
        recording = self.recording
        if recording.ground is None:
            parameters[GROUND] = seeming_ground(recording, self.nominal)
        return parameters

    @cached_property
    def _height(self) -> Floats:
        """The measured height (n); any will do for its weight of nothing, if near the feet [m]."""
        recording = self.recording
        if recording.height is not None:
            return recording.height
        standing = np.maximum(1, recording.contact.sum(axis=1))
        return self._heights(self.start)[0].sum(axis=1) / standing

    def _evaluate(self, parameters: Floats) -> tuple[Floats, Floats]:
        heights, jacobian = self._heights(parameters)
        return heights - self._height[:, None] * self.recording.contact, jacobian

    # NaN in the air does not matter, and `calibrate` refuses the rest.
    @nan_without_warning
    def _heights(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Height of F above each foot that stands (n, 4) [m], and derivatives (n, 4, 36)."""
        recording = self.recording
        geometry = deviated(self.nominal, parameters)
        roll, pitch = self._attitude(parameters).T
        normal, by_ground = self._normals(parameters)
        g = to_platform(normal, roll, pitch)
        g_rates = attitude_derivatives(normal, g, roll, pitch)
        g_ground = [to_platform(n, roll, pitch) for n in by_ground]
        extension = recording.extension + offsets_of(parameters)
        height = np.empty(extension.shape)
        jacobian = np.zeros((*extension.shape, PARAMETER_COUNT))
        for i, leg in enumerate(geometry.legs):
            foot, derivatives = foot_derivatives(leg, extension[:, i])
            height[:, i] = dot(g, foot) + leg.foot_radius
            columns = [dot(g, derivative) for derivative in derivatives]
            jacobian[:, i, LEG_WIDTH * i : LEG_WIDTH * (i + 1)] = np.stack(columns, axis=-1)
            by_attitude = np.stack([dot(rate, foot) for rate in g_rates], axis=-1)
            jacobian[:, i, BIAS] = -self._sensor_share * by_attitude
            for k, rate in enumerate(g_ground):
                jacobian[:, i, GROUND.start + k] = dot(rate, foot)
        standing = recording.contact
        return (
            np.where(standing, height, 0.0),
            np.where(standing[:, :, None], jacobian, 0.0),
        )

    def _normals(self, parameters: Floats) -> tuple[Vector3, list[Vector3]]:
        """The ground's normal in the platform's heading, and its derivatives by `GROUND`."""
        recording = self.recording
        if recording.ground is not None:
            zero = np.zeros(len(recording))
            return normal_of(*recording.ground.T), [(zero, zero, zero)] * 2
        roll, pitch = parameters[GROUND]
        n_1, n_2, n_3 = normal_of(roll, pitch)
        by_roll = (n_2 * np.sin(pitch), -np.cos(roll), n_2 * np.cos(pitch))
        turn = -recording.turned
        return turned((n_1, n_2, n_3), turn), [
            turned(by_roll, turn),
            turned((n_3, 0.0 * n_2, -n_1), turn),
        ]


def turned(vector: Vector3, angle: Elementwise) -> Vector3:
    """A vector turned about the vertical by an angle [rad]."""
    sine, cosine = sin_cos(angle)
    x, y, z = vector
    return cosine * x - sine * y, sine * x + cosine * y, z + 0.0 * sine


def ground_in_heading(ground: Floats, heading: Floats) -> Floats:
    """Roll and pitch of the ground as a platform sees it that was turned about the vertical.

    Args:
        ground: (2) roll and pitch before it turned [rad].
        heading: (n) by how much it turned [rad].

    Returns:
        (n, 2) roll and pitch [rad].
    """
    return _inclination(turned(normal_of(*ground), -heading))


def seeming_ground(recording: PoseRecording, nominal: PlatformGeometry) -> Floats:
    """Roll and pitch (2) of the ground by legs as drawn and a sensor without bias, on average."""
    estimate = estimate_ground(nominal, recording.extension, recording.attitude)
    n_1, n_2, n_3 = turned(normal_of(*estimate.T), recording.turned)
    return _inclination((n_1.mean(), n_2.mean(), n_3.mean()))


def _inclination(normal: Vector3) -> Floats:
    """Roll and pitch (..., 2) of a plane by its normal, of any length [rad]."""
    n_1, n_2, n_3 = normal
    return np.stack([-np.arctan2(n_2, np.hypot(n_1, n_3)), np.arctan2(n_1, n_3)], axis=-1)
