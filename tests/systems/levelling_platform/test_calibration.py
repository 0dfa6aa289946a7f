"""Calibration: findings from poses, their certainty, and limits of what poses can tell."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.core.errors import UndeterminedCalibration
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    GROUND,
    PARAMETER_COUNT,
    StandingEquations,
    Tolerances,
    deviated,
    equivalent_parameters,
    ground_in_heading,
)
from parapod.systems.levelling_platform.calibration.poses import MeasurementNoise, PoseRecording
from parapod.systems.levelling_platform.calibration.solve import calibrate
from parapod.systems.levelling_platform.geometry import drawn_deviations
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    passive_extension,
)

TOLERANCES = Tolerances()
# Of encoders that count .01 mm, and of the instruments of Appendix B.
NOISE = MeasurementNoise(0.01e-3 / np.sqrt(12.0), np.radians(0.01), 0.05e-3)
SLOPE = np.radians([2.0, 3.0])


class Machine:
    """A machine as built, or as drawn, and its poses with all feet on the ground."""

    def __init__(self, seed=None):
        if seed is None:
            self.geometry = DRAWN
            return
        random = np.random.default_rng(seed)
        deviations = drawn_deviations(random, TOLERANCES.length, TOLERANCES.angle)
        self.geometry = replace(DRAWN, deviations=deviations)
        self.offsets = TOLERANCES.offset * random.uniform(-1.0, 1.0, 4)
        self.bias = TOLERANCES.bias * random.uniform(-1.0, 1.0, 2)

    @property
    def parameters(self):
        return equivalent_parameters(self.geometry, DRAWN, self.offsets, self.bias)

    def stand(self, active, ground):
        """Extensions of all legs and the posture, with legs 1 to 3 at these lengths."""
        standing = np.column_stack([active, active[:, 0]])
        posture = forward_kinematics(self.geometry, standing, ground, (0, 1, 2))
        passive = passive_extension(self.geometry, active, ground, posture[:, :2])
        return np.column_stack([active, passive]), posture

    def record(self, active, seed=None, ground=(0.0, 0.0), scale=1.0, tracked=False, noise=NOISE):
        """Poses as measured, without errors if there is no seed; and the true postures."""
        ground = np.broadcast_to(ground, (len(active), 2))
        extension, posture = self.stand(active, ground)
        random = np.random.default_rng(seed)
        scale = 0.0 if seed is None else scale

        def error(deviation, *shape):
            return scale * deviation * random.standard_normal((len(active), *shape))

        recording = PoseRecording(
            extension=extension - self.offsets + error(noise.extension, 4),
            attitude=posture[:, :2] + self.bias + error(noise.attitude, 2),
            height=posture[:, 2] + error(noise.height),
            contact=np.ones((len(active), 4), dtype=bool),
            noise=noise,
            ground=ground,
            reference=posture[:, :2] + error(noise.reference, 2) if tracked else None,
        )
        return recording, posture

    def prediction_error(self, calibration, active, ground=(0.0, 0.0)):
        """Largest error [m, rad] of postures that are predicted from what the encoders say."""
        ground = np.broadcast_to(ground, (len(active), 2))
        extension, posture = self.stand(active, ground)
        read = extension - self.offsets + calibration.offsets
        return np.abs(forward_kinematics(calibration.geometry, read, ground) - posture).max()


def varied(count, seed=0):
    """Lengths of legs 1 to 3 in poses all over the workspace, a third of each at its ends."""
    random = np.random.default_rng(seed)
    active = 0.405 + 0.015 * np.clip(random.uniform(-1.5, 1.5, (20 * count, 3)), -1.0, 1.0)
    extension, _ = Machine().stand(active, np.zeros((len(active), 2)))
    return active[(extension[:, 3] >= 0.39) & (extension[:, 3] <= 0.42)][:count]


POSES = varied(30)
OTHERS = varied(50, seed=1)
# So exact that tolerances decide nothing.
EXACT = MeasurementNoise(1e-13, 1e-13, 1e-13, 1e-13)


@pytest.mark.parametrize("ground", [(0.0, 0.0), SLOPE])
def test_a_machine_off_in_every_dimension_fulfils_the_equations_with_fewer_parameters(ground):
    machine = Machine(3)
    recording, _ = machine.record(POSES, ground=ground)
    equations = StandingEquations(recording, DRAWN)
    assert np.abs(equations.residual(machine.parameters)).max() < 1e-15
    assert np.abs(equations.residual(equations.start)).max() > 1e-3


def test_parameters_count_from_the_geometry_they_are_given():
    machine = Machine(3)
    whole = deviated(DRAWN, machine.parameters)
    halves = deviated(deviated(DRAWN, 0.5 * machine.parameters), 0.5 * machine.parameters)
    for a, b in zip(whole.legs, halves.legs, strict=True):
        np.testing.assert_allclose(a.p_MF, b.p_MF, atol=1e-15)
        assert (a.l_6, a.l_7) == (DRAWN.l_6, DRAWN.l_7)


def recordings():
    machine = Machine(5)
    known, _ = machine.record(POSES[:6], 0, SLOPE, tracked=True)
    known.reference[2] = np.nan
    yield pytest.param(known, id="known ground, reference")
    yield pytest.param(replace(known, height=None, reference=None), id="no height, no reference")
    heading = np.radians([0.0, 180.0, 90.0, -30.0, 10.0, 5.0])
    yield pytest.param(replace(known, ground=None, heading=heading), id="unknown ground, turned")


@pytest.mark.parametrize("recording", list(recordings()))
def test_derivatives_agree_with_differences(recording):
    equations = StandingEquations(recording, DRAWN)
    parameters = Machine(6).parameters + equations.start
    residual, jacobian = equations.whitened(parameters)
    assert residual.shape == jacobian.shape[:1]
    for k in range(PARAMETER_COUNT):
        step = np.zeros(PARAMETER_COUNT)
        step[k] = 1e-6
        ahead, behind = (equations.whitened(parameters + s)[0] for s in (step, -step))
        column = (ahead - behind) / 2e-6
        scale = max(1.0, np.abs(jacobian[:, k]).max())
        np.testing.assert_allclose(jacobian[:, k], column, atol=2e-7 * scale, rtol=0.0)


@pytest.mark.parametrize("ground", [(0.0, 0.0), SLOPE])
def test_without_noise_the_machine_s_postures_are_predicted_exactly(ground):
    machine = Machine(1)
    recording, _ = machine.record(POSES, ground=ground, tracked=True, noise=EXACT)
    calibration = calibrate(recording, DRAWN)
    assert machine.prediction_error(calibration, OTHERS) < 1e-9
    assert machine.prediction_error(calibration, OTHERS, -SLOPE) < 1e-9
    np.testing.assert_allclose(calibration.bias, machine.bias, atol=1e-9)


def test_turning_on_unknown_ground_finds_ground_and_bias():
    machine = Machine(2)
    heading = np.pi * (np.arange(len(POSES)) % 2)
    ground = ground_in_heading(SLOPE, heading)
    recording, _ = machine.record(POSES, ground=ground, tracked=True, noise=EXACT)
    recording = replace(recording, ground=None, heading=heading)
    calibration = calibrate(recording, DRAWN)
    np.testing.assert_allclose(calibration.ground, SLOPE, atol=1e-9)
    np.testing.assert_allclose(calibration.bias, machine.bias, atol=1e-9)
    assert machine.prediction_error(calibration, OTHERS, -SLOPE) < 1e-9


def test_standard_deviations_and_chi_square_agree_with_monte_carlo():
    errors, chi2 = [], []
    for seed in range(60):
        machine = Machine(seed)
        recording, _ = machine.record(POSES, 1000 + seed, tracked=True)
        calibration = calibrate(recording, DRAWN)
        error = (calibration.parameters - machine.parameters) / calibration.standard_deviations
        errors.append(error[: GROUND.start])
        chi2.append(calibration.chi2_per_dof)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.mean(spread) == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(spread, 1.0, atol=0.35)
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.05)
    assert np.std(chi2) == pytest.approx(np.sqrt(2.0 / calibration.degrees_of_freedom), rel=0.3)


def test_a_foot_in_the_air_says_nothing():
    machine = Machine(8)
    recording, _ = machine.record(POSES, 0, tracked=True)
    contact = recording.contact.copy()
    contact[::3, 1] = False
    lifted = recording.extension.copy()
    lifted[::3, 1] += 0.03
    calibrations = [
        calibrate(replace(recording, contact=contact, extension=extension), DRAWN)
        for extension in (recording.extension, lifted)
    ]
    np.testing.assert_allclose(calibrations[0].parameters, calibrations[1].parameters, atol=1e-12)
    assert (calibrations[0].residuals[::3, 1] == 0.0).all()


def test_calibrating_the_calibrated_machine_hardly_moves_it():
    machine = Machine(9)
    recording, _ = machine.record(POSES, 0, tracked=True)
    first = calibrate(recording, DRAWN)
    corrected = replace(
        recording,
        extension=recording.extension + first.offsets,
        attitude=recording.attitude - first.bias,
    )
    again = calibrate(corrected, first.geometry)
    assert np.abs(again.bias).max() < 0.1 * first.standard_deviations[BIAS].min()
    extension, _ = machine.stand(OTHERS, np.zeros((len(OTHERS), 2)))
    before, after = (
        forward_kinematics(found.geometry, extension + offsets, (0.0, 0.0))
        for found, offsets in ((first, 0.0), (again, again.offsets))
    )
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-4)


def test_a_leaning_sensor_and_leaning_legs_look_alike_without_a_reference():
    machine = Machine(10)
    recording, _ = machine.record(POSES, 0, tracked=True)
    alone = calibrate(replace(recording, reference=None), DRAWN)
    referenced = calibrate(recording, DRAWN)
    assert (alone.standard_deviations[BIAS] > 0.5e-3).all()
    assert (referenced.standard_deviations[BIAS] < 0.05e-3).all()
    # The posture against the sensor is as sure as ever.
    error = machine.bias - alone.bias
    posture = forward_kinematics(
        alone.geometry, recording.extension + alone.offsets, recording.ground
    )
    _, truth = machine.stand(POSES, recording.ground)
    assert np.abs(posture[:, :2] - truth[:, :2] - error).max() < np.radians(0.02)
    assert np.abs(posture[:, 2] - truth[:, 2]).max() < 0.2e-3


def level_poses():
    return np.tile(np.linspace(0.392, 0.418, 30)[:, None], (1, 3))


def without_leg_3(recording):
    contact = recording.contact.copy()
    contact[:, 2] = False
    return replace(recording, contact=contact)


@pytest.mark.parametrize(
    ("active", "change", "named", "advice"),
    [
        (np.tile(POSES[:1], (30, 1)), None, r"leg \d: .*l_3", "differ in roll and pitch"),
        (np.tile(POSES[:1], (30, 1)), None, r"leg \d: .*l_3", "more of the stroke of leg 1"),
        (POSES[:3], None, "beta", "15 poses or more"),
        (level_poses(), None, "l_4.* accelerometer bias in roll", "differ in roll and pitch"),
        (POSES, lambda r: replace(r, height=None), "l_z and alpha", "measured heights"),
        (POSES, without_leg_3, "leg 3: l_3", "poses with leg 3 on the ground"),
        (
            POSES,
            lambda r: replace(r, ground=None),
            "accelerometer bias in roll and the ground's roll",
            "ground of known inclination, or poses with the platform turned",
        ),
        (
            POSES,
            lambda r: replace(r, ground=None, heading=np.full(30, 1.0)),
            "accelerometer bias in pitch, the ground's roll and the ground's pitch together",
            "ground of known inclination",
        ),
        (
            POSES,
            lambda r: replace(r, noise=MeasurementNoise(1e-4, 2e-2, 5e-3)),
            "leg",
            "more poses, or measurements with less noise",
        ),
    ],
)
def test_what_the_poses_do_not_determine_is_named(active, change, named, advice):
    recording, _ = Machine(0).record(active, 0)
    recording = change(recording) if change else recording
    with pytest.raises(UndeterminedCalibration, match=named) as refused:
        calibrate(recording, DRAWN)
    assert advice in str(refused.value)
    assert any(advice in sentence for sentence in refused.value.advice)
    assert "\n" not in str(refused.value)
    words = " ".join(refused.value.directions)
    assert "l_6" not in words
    assert "l_7" not in words


def test_a_reference_frees_the_bias_but_not_the_ground():
    recording, _ = Machine(0).record(POSES, 0, tracked=True)
    with pytest.raises(UndeterminedCalibration, match="the ground's roll") as refused:
        calibrate(replace(recording, ground=None), DRAWN)
    assert "bias" not in str(refused.value)


def test_one_height_is_enough_if_inclinations_vary():
    random = np.random.default_rng(0)
    attitude = random.uniform(-0.06, 0.06, (40, 2))
    posture = np.column_stack([attitude, np.full(40, 0.477)])
    active = inverse_kinematics(DRAWN, posture, (0.0, 0.0))[:, :3]
    recording, _ = Machine(0).record(active, 0, tracked=True)
    assert calibrate(recording, DRAWN).determined > 15


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extension": np.zeros((30, 3))}, r"extension must be \(30, 4\)"),
        ({"attitude": np.zeros((29, 2))}, r"attitude must be \(30, 2\)"),
        ({"height": np.full(30, np.nan)}, "height of pose 1 is not finite"),
        ({"reference": np.array([[0.0, np.nan]] * 30)}, "reference of pose 1 is not finite"),
    ],
)
def test_recordings_of_wrong_shape_are_refused(change, message):
    recording, _ = Machine(0).record(POSES)
    with pytest.raises(ValueError, match=message):
        replace(recording, **change)


def test_what_no_leg_can_be_is_refused():
    recording, _ = Machine(0).record(POSES)
    with pytest.raises(ValueError, match="extension"):
        calibrate(replace(recording, extension=2.0 * recording.extension), DRAWN)


def test_noise_must_be_positive():
    with pytest.raises(ValueError, match="positive"):
        MeasurementNoise(1e-5, 0.0, 1e-4)
