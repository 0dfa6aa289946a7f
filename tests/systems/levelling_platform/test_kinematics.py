import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.levelling_platform.kinematics import (
    PlatformGeometry,
    estimate_ground,
    forward_kinematics,
    height_range,
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import swing_angle
from parapod.systems.levelling_platform.printed import (
    c_123,
    derivative_of_z,
    g_123,
    gradient_u,
    gradient_y,
    omega,
    p_xz,
    printed_dz,
    u_f,
    u_mn,
    z_angle,
)

POINT = PlatformGeometry()
ROLLER = PlatformGeometry(foot_radius=0.025)
GEOMETRIES = pytest.mark.parametrize("geometry", [POINT, ROLLER], ids=["point", "roller"])
TRIPLES = [(0, 1, 2), (3, 1, 0), (2, 0, 3), (1, 3, 2)]
LEVEL = (0.0, 0.0)
FIVE_DEGREES = math.radians(5.0)


def reachable(geometry, count=500, seed=0):
    """Random grounds up to 5 deg, and postures that all four legs can take on them."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-FIVE_DEGREES, FIVE_DEGREES, (count, 2))
    attitude = ground + rng.uniform(-0.06, 0.06, (count, 2))
    low, high = height_range(geometry, attitude, ground).T
    fits = high - low > 1e-3
    share = rng.uniform(0.0, 1.0, count)
    posture = np.column_stack([attitude, low + share * (high - low)])
    assert fits.sum() > count // 3
    return posture[fits], ground[fits]


def rotation(attitude):
    return RollPitchYaw(attitude[0], attitude[1], 0.0).ToRotationMatrix().matrix()


def paper_jacobian(triple, posture, ground, extension, **changes):
    """Eq. (26): extensions of the active legs by roll, pitch, height."""
    legs = [POINT.legs[i] for i in triple]
    d = [extension[i] for i in triple]
    phi, theta, _ = posture
    by_u = gradient_u(legs, d, ground, theta, phi, **changes)
    jacobian = -np.linalg.inv(by_u) @ gradient_y(legs, d, ground, theta, phi)
    return jacobian[:, [1, 0, 2]]


# Round trips


@GEOMETRIES
@pytest.mark.parametrize("legs", [None, *TRIPLES])
def test_extensions_of_a_posture_give_back_posture_ground_and_the_passive_leg(geometry, legs):
    posture, ground = reachable(geometry)
    extension = inverse_kinematics(geometry, posture, ground)
    returned = forward_kinematics(geometry, extension, ground, legs=legs)
    np.testing.assert_allclose(returned, posture, rtol=0.0, atol=1e-12)
    estimate = estimate_ground(geometry, extension, posture[:, :2])
    np.testing.assert_allclose(estimate, ground, rtol=0.0, atol=1e-12)
    if legs:
        (passive,) = set(range(4)) - set(legs)
        found = passive_extension(geometry, extension[:, legs], ground, posture[:, :2], legs=legs)
        assert found.shape == (len(posture),)
        np.testing.assert_allclose(found, extension[:, passive], rtol=0.0, atol=1e-12)


@GEOMETRIES
@pytest.mark.parametrize("legs", TRIPLES)
def test_inverse_kinematics_undoes_forward_kinematics_of_three_legs(geometry, legs):
    rng = np.random.default_rng(1)
    extension = rng.uniform(0.390, 0.420, (300, 4))
    ground = rng.uniform(-FIVE_DEGREES, FIVE_DEGREES, (300, 2))
    posture = forward_kinematics(geometry, extension, ground, legs=legs)
    returned = inverse_kinematics(geometry, posture, ground, on_unreachable="nan")
    fits = np.isfinite(returned[:, 0])
    assert fits.sum() > 100
    np.testing.assert_allclose(
        returned[fits][:, legs], extension[fits][:, legs], rtol=0.0, atol=1e-12
    )


@GEOMETRIES
def test_feet_stand_on_the_ground_or_on_their_offsets(geometry):
    posture, ground = reachable(geometry, seed=2)
    offsets = np.random.default_rng(3).uniform(-0.002, 0.002, (len(posture), 4))
    wide = replace(geometry, extension_min=0.37, extension_max=0.44)
    for delta in (None, offsets):
        extension = inverse_kinematics(wide, posture, ground, foot_offsets=delta)
        for k in range(0, len(posture), 10):
            n = rotation(ground[k])[:, 2]
            R = rotation(posture[k])
            feet = np.array([u_f(leg, d) for leg, d in zip(POINT.legs, extension[k], strict=True)])
            feet[:, 2] -= geometry.foot_radius
            above = posture[k, 2] - (feet @ R.T) @ n - geometry.foot_radius
            expected = np.zeros(4) if delta is None else delta[k]
            np.testing.assert_allclose(above, expected, rtol=0.0, atol=1e-12)


def test_offset_of_one_foot_moves_that_leg_alone():
    flat = inverse_kinematics(POINT, (0.0, 0.0, 0.47), LEVEL)
    offset = inverse_kinematics(POINT, (0.0, 0.0, 0.47), LEVEL, foot_offsets=(0, 0, 0.01, 0))
    assert (offset != flat).tolist() == [False, False, True, False]
    assert offset[2] > flat[2]  # standing higher, the leg is drawn up: a longer actuator


def test_passive_extension_satisfies_equation_31_as_printed():
    posture, ground = reachable(POINT, count=50, seed=6)
    extension = inverse_kinematics(POINT, posture, ground)
    fourth = passive_extension(POINT, extension[:, :3], ground, posture[:, :2])
    for k in range(len(posture)):
        g = g_123(c_123(ground[k]), posture[k, 1], posture[k, 0])
        u_14 = u_mn(POINT.legs[0], POINT.legs[3], extension[k, 0], fourth[k])
        assert u_14 @ g == pytest.approx(0.0, abs=1e-14)


# Printed numbers


@pytest.mark.parametrize(
    ("d", "gamma", "p_x", "p_z"),
    [
        (0.390, 124.229, 0.507155, 0.454824),
        (0.400, 115.151, 0.517876, 0.392429),
        (0.410, 106.927, 0.519710, 0.333529),
        (0.420, 99.248, 0.514068, 0.277345),
        (0.450, 77.731, 0.457008, 0.122465),
    ],
)
def test_table_of_one_leg(d, gamma, p_x, p_z):
    leg = POINT.legs[0]
    assert math.degrees(z_angle(leg, d) - leg.alpha) == pytest.approx(gamma, abs=6e-4)
    np.testing.assert_allclose(p_xz(leg, d), (p_x, p_z), atol=6e-7)
    posture = forward_kinematics(POINT, [d] * 4, LEVEL)
    np.testing.assert_allclose(posture, (0.0, 0.0, p_z + 0.113), atol=6e-7)


@pytest.mark.parametrize(
    ("roll", "pitch", "margin_mm"),
    [
        (0.0, 5.0, 4.0), (0.0, 6.0, 1.9), (5.0, 0.0, 6.7), (6.0, 0.0, 5.0), (2.0, 3.0, 5.1),
        (3.0, 3.0, 3.4), (2.0, 4.0, 2.9), (3.0, 4.0, 1.3), (3.0, 5.0, -0.85), (5.0, 5.0, -4.0),
    ],
)  # fmt: skip
def test_table_of_levelled_grounds(roll, pitch, margin_mm):
    ground = np.radians((roll, pitch))
    wide = replace(POINT, extension_min=0.37, extension_max=0.44)
    heights = np.linspace(0.44, 0.51, 1401)
    postures = np.column_stack([np.zeros((heights.size, 2)), heights])
    extension = inverse_kinematics(wide, postures, ground)
    margins = np.minimum(extension - 0.390, 0.420 - extension).min(axis=1)
    assert 1e3 * margins.max() == pytest.approx(margin_mm, abs=0.1)
    assert heights[margins.argmax()] == pytest.approx(0.477, abs=0.006)
    low, high = height_range(POINT, LEVEL, ground)
    assert (low <= high) == (margin_mm > 0.0)
    if margin_mm > 0.0:
        # 1 mm of margin is about 6 mm of height to either side.
        assert 0.5 * (high - low) == pytest.approx(5.9e-3 * margin_mm, abs=2e-3)


def test_workspace_on_flat_ground():
    d = np.linspace(0.390, 0.420, 25)
    three = np.array(list(itertools.product(d, d, d)))
    posture = forward_kinematics(
        POINT, np.column_stack([three, three[:, 0]]), LEVEL, legs=(0, 1, 2)
    )
    fourth = passive_extension(POINT, three, LEVEL, posture[:, :2])
    fits = (fourth >= 0.390 - 1e-12) & (fourth <= 0.420 + 1e-12)
    roll, pitch, height = posture[fits].T
    assert math.degrees(pitch.max()) == pytest.approx(6.88, abs=0.005)
    assert math.degrees(pitch.min()) == pytest.approx(-6.88, abs=0.005)
    assert -9.1 < math.degrees(roll.min()) < -8.6
    assert 8.6 < math.degrees(roll.max()) < 9.15
    assert height.min() == pytest.approx(0.3903, abs=5e-5)
    assert height.max() == pytest.approx(0.5678, abs=5e-5)


# The paper's equations


@pytest.mark.parametrize("legs", [(0, 1, 2), (1, 3, 0), (2, 3, 1)])
def test_forward_kinematics_satisfies_equations_10_to_12_as_printed(legs):
    posture, ground = reachable(POINT, count=60, seed=7)
    extension = inverse_kinematics(POINT, posture, ground)
    extension += np.random.default_rng(8).uniform(-0.002, 0.002, extension.shape)
    for d, inclination in zip(extension, ground, strict=True):
        phi, theta, h = forward_kinematics(POINT, d, inclination, legs=legs)
        residual = omega(
            [POINT.legs[i] for i in legs], [d[i] for i in legs], inclination, theta, phi, h
        )
        np.testing.assert_allclose(residual, 0.0, atol=1e-14)


@GEOMETRIES
def test_jacobian_agrees_with_central_differences(geometry):
    posture, ground = reachable(geometry, count=200, seed=11)
    wide = replace(geometry, extension_min=0.37, extension_max=0.44)
    jacobian = posture_jacobian(wide, posture, ground)
    step = 1e-6
    for i in range(3):
        ahead, behind = posture.copy(), posture.copy()
        ahead[:, i] += step
        behind[:, i] -= step
        column = inverse_kinematics(wide, ahead, ground) - inverse_kinematics(wide, behind, ground)
        np.testing.assert_allclose(jacobian[..., i], column / (2.0 * step), atol=1e-7)


@pytest.mark.parametrize("legs", [(0, 1, 2), (3, 1, 0), (2, 0, 3)])
def test_jacobian_is_equation_26_with_the_appendix_where_dz_is_minus_the_derivative(legs):
    posture, ground = reachable(POINT, count=100, seed=12)
    extension = inverse_kinematics(POINT, posture, ground)
    jacobian = posture_jacobian(POINT, posture, ground)
    for k in range(len(posture)):
        standing = posture[k], ground[k], extension[k]
        found, printed = jacobian[k][list(legs)], paper_jacobian(legs, *standing)
        np.testing.assert_allclose(found, printed, atol=1e-12)
        misread = paper_jacobian(legs, *standing, dz=derivative_of_z)
        assert np.abs(found - misread).max() > 0.1


def test_jacobian_at_given_extensions_is_equation_26_at_these():
    posture, ground = reachable(POINT, count=20, seed=13)
    extension = inverse_kinematics(POINT, posture, ground)
    drifted = extension + np.random.default_rng(14).uniform(-0.003, 0.003, extension.shape)
    jacobian = posture_jacobian(POINT, posture, ground, extension=drifted)
    # The law of one leg alone takes its own height, so Eq. (25) is compared row by row.
    for k, i in itertools.product(range(len(posture)), range(4)):
        leg, (phi, theta, _) = POINT.legs[i], posture[k]
        legs, d = [leg] * 3, [drifted[k, i]] * 3
        by_y = gradient_y(legs, d, ground[k], theta, phi)[2, [1, 0, 2]]
        by_d = gradient_u(legs, d, ground[k], theta, phi)[2, 0]
        np.testing.assert_allclose(jacobian[k, i], -by_y / by_d, atol=1e-12)
    without = posture_jacobian(POINT, posture, ground)
    at_solution = posture_jacobian(POINT, posture, ground, extension=extension)
    np.testing.assert_allclose(at_solution, without, atol=1e-12)
    assert np.abs(jacobian - without).max() > 1e-3


def test_derivative_of_z_has_the_sign_opposite_to_the_printed_dz():
    leg, step = POINT.legs[0], 1e-6
    for d in (0.390, 0.405, 0.420):
        derivative = (z_angle(leg, d + step) - z_angle(leg, d - step)) / (2.0 * step)
        assert derivative == pytest.approx(-printed_dz(leg, d), rel=1e-8)


# Unreachable postures


def test_unreachable_posture_names_leg_extension_and_range():
    posture = (0.0, 0.0, 0.6)
    wide = replace(POINT, extension_min=0.37)
    needed = inverse_kinematics(wide, posture, LEVEL)
    with pytest.raises(UnreachablePosture) as caught:
        inverse_kinematics(POINT, posture, LEVEL)
    error = caught.value
    assert error.leg == 1
    assert error.extension == pytest.approx(needed[0], abs=1e-15)
    assert error.admissible == (0.390, 0.420)
    assert error.missing == pytest.approx(0.390 - needed[0], abs=1e-15)
    assert error.index is None
    for text in ("leg 1", f"{1e3 * needed[0]:.2f} mm", "390.0..420.0 mm"):
        assert text in str(error)


@pytest.mark.parametrize(
    ("ground", "legs"),
    [((0.06, 0.10), (1, 3)), ((-0.06, 0.10), (2, 4)), ((0.0, 0.13), (1, 2, 3, 4))],
)
def test_unreachable_posture_names_the_leg_that_misses_most(ground, legs):
    posture = (0.0, 0.0, 0.477)
    wide = replace(POINT, extension_min=0.361, extension_max=0.519)
    extension = inverse_kinematics(wide, posture, ground)
    missing = np.maximum(0.390 - extension, extension - 0.420)
    with pytest.raises(UnreachablePosture) as caught:
        inverse_kinematics(POINT, posture, ground)
    assert caught.value.leg == missing.argmax() + 1
    assert caught.value.leg in legs
    assert caught.value.missing == pytest.approx(missing.max(), abs=1e-15)


def test_posture_that_no_extension_reaches_has_no_extension_to_name():
    with pytest.raises(UnreachablePosture, match="cannot reach the ground with any") as caught:
        inverse_kinematics(POINT, (0.0, 0.0, 2.0), LEVEL)
    assert math.isnan(caught.value.extension)
    assert caught.value.leg == 1
    assert np.isnan(posture_jacobian(POINT, (0.0, 0.0, 2.0), LEVEL)).all()


def test_unreachable_posture_of_a_batch_is_named_by_its_index():
    postures = np.tile((0.0, 0.0, 0.47), (3, 4, 1))
    postures[1, 2, 2] = postures[2, 0, 2] = 0.9
    with pytest.raises(UnreachablePosture, match=r"posture \[1, 2\]") as caught:
        inverse_kinematics(POINT, postures, LEVEL)
    assert caught.value.index == (1, 2)


def test_unreachable_postures_of_a_batch_can_be_marked_and_spare_the_others():
    postures = np.tile((0.0, 0.0, 0.47), (3, 4, 1))
    bad = np.zeros((3, 4), dtype=bool)
    # Tilted by more than the stroke, unknown, and out of reach with any extension.
    for index, posture in (((1, 2), (0.25, 0.0, 0.47)), ((2, 0), np.nan), ((0, 3), (0, 0, 5.0))):
        postures[index], bad[index] = posture, True
    extension = inverse_kinematics(POINT, postures, LEVEL, on_unreachable="nan")
    assert np.isnan(extension[bad]).all()
    expected = inverse_kinematics(POINT, (0.0, 0.0, 0.47), LEVEL)
    np.testing.assert_array_equal(extension[~bad], np.tile(expected, (9, 1)))


def test_ends_of_the_stroke_are_reachable_after_a_round_trip():
    for d in (0.390, 0.420):
        posture = forward_kinematics(POINT, [d] * 4, LEVEL)
        np.testing.assert_allclose(inverse_kinematics(POINT, posture, LEVEL), d, atol=1e-13)


def test_height_range_is_inverted_where_the_attitude_cannot_be_held():
    low, high = height_range(POINT, LEVEL, np.radians((5.0, 5.0)))
    assert low > high


# Least squares


def test_four_legs_off_one_plane_give_a_posture_between_those_of_the_triples():
    rng = np.random.default_rng(18)
    extension = 0.405 + rng.uniform(-0.002, 0.002, (200, 4))
    fitted = forward_kinematics(ROLLER, extension, LEVEL)
    triples = [
        forward_kinematics(ROLLER, extension, LEVEL, legs=legs)
        for legs in itertools.combinations(range(4), 3)
    ]

    def plane(posture):
        """Affine coefficients of the ground seen from the platform."""
        g = np.array([g_123((0.0, 0.0, 1.0), pitch, roll) for roll, pitch, _ in posture])
        affine = [g[:, 0] / g[:, 2], g[:, 1] / g[:, 2], (posture[:, 2] - 0.025) / g[:, 2]]
        return np.stack(affine, axis=-1)

    planes = np.array([plane(posture) for posture in triples])
    between = plane(fitted)
    assert (between >= planes.min(axis=0) - 1e-14).all()
    assert (between <= planes.max(axis=0) + 1e-14).all()
    assert np.ptp(planes, axis=0).max() > 1e-3


def test_batches_may_be_large_or_empty():
    posture, ground = reachable(POINT, count=15_000, seed=20)
    assert len(posture) > 4096
    extension = inverse_kinematics(POINT, posture, ground)
    for part in (slice(0, 3), slice(4094, 4099), slice(-3, None)):
        alone = inverse_kinematics(POINT, posture[part], ground[part])
        np.testing.assert_allclose(extension[part], alone, rtol=0.0, atol=1e-15)
    assert inverse_kinematics(POINT, np.empty((0, 3)), LEVEL).shape == (0, 4)
    assert forward_kinematics(POINT, np.empty((0, 4)), LEVEL).shape == (0, 3)
    assert estimate_ground(POINT, np.empty((2, 0, 4)), LEVEL).shape == (2, 0, 2)
    assert posture_jacobian(POINT, np.empty((0, 3)), LEVEL).shape == (0, 4, 3)


def test_arguments_are_left_unchanged():
    posture, ground = reachable(POINT, count=20, seed=21)
    posture[0, 2] = 9.0
    before = posture.copy(), ground.copy()
    inverse_kinematics(POINT, posture, ground, on_unreachable="nan")
    np.testing.assert_array_equal(posture, before[0])
    np.testing.assert_array_equal(ground, before[1])


def test_senseless_arguments_are_refused():
    with pytest.raises(ValueError, match="broadcast"):
        forward_kinematics(POINT, np.full((3, 4), 0.4), np.zeros((2, 2)))
    for legs in ((0, 1), (0, 1, 1), (0, 1, 4), (-1, 0, 1), (0, 1, 2, 3)):
        with pytest.raises(ValueError, match="three different indices"):
            forward_kinematics(POINT, [0.4] * 4, LEVEL, legs=legs)
        with pytest.raises(ValueError, match="three different indices"):
            passive_extension(POINT, [0.4] * 3, LEVEL, LEVEL, legs=legs)
    with pytest.raises(ValueError, match="on_unreachable"):
        inverse_kinematics(POINT, (0.0, 0.0, 0.47), LEVEL, on_unreachable="clip")


# Numbers that are not finite


@pytest.mark.parametrize("bad", [np.nan, 0.3599, 0.5201])
def test_extensions_that_cannot_be_built_give_nan_in_their_row_only(bad):
    extension = np.full((3, 4), 0.405)
    extension[1, 2] = bad
    posture = forward_kinematics(POINT, extension, LEVEL)
    ground = estimate_ground(POINT, extension, LEVEL)
    for result in (posture, ground):
        assert np.isnan(result[1]).all()
        assert np.isfinite(result[[0, 2]]).all()
    assert np.isnan(forward_kinematics(POINT, extension[1], LEVEL)).all()
    assert np.isnan(estimate_ground(POINT, extension[1], LEVEL)).all()
    assert np.isfinite(forward_kinematics(POINT, extension[1], LEVEL, legs=(0, 1, 3))).all()


@pytest.mark.parametrize("element", range(5))
def test_postures_and_grounds_that_are_not_finite_are_unreachable(element):
    for bad in (np.nan, np.inf):
        given = np.tile((0.0, 0.0, 0.47, 0.0, 0.0), (2, 1))
        given[1, element] = bad
        posture, ground = given[:, :3], given[:, 3:]
        with pytest.raises(UnreachablePosture):
            inverse_kinematics(POINT, posture[1], ground[1])
        extension = inverse_kinematics(POINT, posture, ground, on_unreachable="nan")
        assert np.isfinite(extension[0]).all()
        assert np.isnan(extension[1]).all()


# Symmetry


@pytest.mark.parametrize(
    ("permutation", "signs"),
    [((1, 0, 3, 2), (-1.0, 1.0)), ((3, 2, 1, 0), (1.0, -1.0)), ((2, 3, 0, 1), (-1.0, -1.0))],
    ids=["left-right", "front-back", "half turn"],
)
def test_mirrored_postures_exchange_the_legs(permutation, signs):
    posture, ground = reachable(ROLLER, count=60, seed=22)
    extension = inverse_kinematics(ROLLER, posture, ground)
    mirrored = inverse_kinematics(ROLLER, posture * (*signs, 1.0), ground * signs)
    np.testing.assert_allclose(mirrored, extension[:, permutation], rtol=0.0, atol=1e-14)
    uneven = extension + np.random.default_rng(23).uniform(-0.002, 0.002, extension.shape)
    np.testing.assert_allclose(
        forward_kinematics(ROLLER, uneven[:, permutation], ground * signs),
        forward_kinematics(ROLLER, uneven, ground) * (*signs, 1.0),
        rtol=0.0,
        atol=1e-14,
    )


def test_inclining_ground_and_platform_together_about_one_axis_changes_no_extension():
    for turn in ((0.05, 0.0), (0.0, 0.08)):
        tilted = inverse_kinematics(POINT, (*turn, 0.47), turn)
        level = inverse_kinematics(POINT, (0.0, 0.0, 0.47), LEVEL)
        np.testing.assert_allclose(tilted, level, rtol=0.0, atol=1e-14)


def test_working_branch_has_the_long_side_outboard():
    posture, ground = reachable(POINT, count=100, seed=27)
    extension = inverse_kinematics(POINT, posture, ground)
    psi = swing_angle(POINT.legs[0], extension)
    assert (np.cos(psi) < 0.0).all()
