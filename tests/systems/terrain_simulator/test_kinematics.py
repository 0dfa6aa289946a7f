import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    BenchGeometry,
    UnreachablePlate,
    forward_kinematics,
    inverse_jacobian,
    inverse_kinematics,
    jacobian,
    margins,
    singularity,
    slider_forces,
    slider_places,
    slider_rates,
)

PEDAL, TREADMILL = BenchGeometry.pedal(), BenchGeometry.treadmill()
LEVEL = (0.5, 0.28, 0.0)


def pivots(geometry, pose):
    """P and T in the base frame, by a rotation matrix."""
    x, z, phi = np.moveaxis(np.asarray(pose), -1, 0)
    c, s = np.cos(phi), np.sin(phi)
    return [
        np.stack((x + c * p[0] + s * p[1], z - s * p[0] + c * p[1]), axis=-1)
        for p in (geometry.p_OP, geometry.p_OT)
    ]


def on_rail(places):
    return np.stack((places, np.zeros_like(places)), axis=-1)


# --- sliders and poses


def test_links_are_as_long_as_they_are(geometry, poses):
    batch = poses(500)
    a = slider_places(geometry, batch)
    P, T = pivots(geometry, batch)
    for k, pivot, length in ((0, P, geometry.link), (1, P, geometry.link), (2, T, geometry.strut)):
        found = np.linalg.norm(pivot - on_rail(a[:, k]), axis=-1)
        assert np.abs(found - length).max() < 1e-14
    assert (a[:, 0] < a[:, 1]).all()
    assert (np.sign(a[:, 2] - T[:, 0]) == geometry.branch).all()


def test_places_at_golden_poses():
    pedal = inverse_kinematics(PEDAL, LEVEL)
    # To 40 decimals by another program.
    assert pedal == pytest.approx((0.2930853500531, 0.6759539477167, 0.8730495168500), abs=1e-12)
    treadmill = inverse_kinematics(TREADMILL, (0.88, 0.20, 0.0))
    assert treadmill == pytest.approx((0.356393, 0.803607, 0.776887), abs=5e-7)
    # A_3 has passed A_2.
    assert treadmill[2] < treadmill[1]


def test_the_pose_comes_back_from_the_sliders(geometry, poses):
    batch = poses(2000).reshape(50, 40, 3)
    found = forward_kinematics(geometry, slider_places(geometry, batch))
    assert found.shape == batch.shape
    assert np.abs(found - batch).max() < 1e-12


def test_the_other_assembly_has_the_same_links_and_is_the_mirror_image(geometry, poses):
    batch = poses(500)
    a = slider_places(geometry, batch)
    lower = forward_kinematics(geometry, a, "lower")
    (P, T), (other_P, other_T) = pivots(geometry, batch), pivots(geometry, lower)
    assert np.abs(other_P - P).max() < 1e-13
    found = np.linalg.norm(other_T - on_rail(a[:, 2]), axis=-1)
    assert np.abs(found - geometry.strut).max() < 1e-13
    # Mirrored in the line from P to A_3.
    along = on_rail(a[:, 2]) - P
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    assert np.abs(np.sum((T - P + other_T - P) * along[:, ::-1] * (1, -1), axis=-1)).max() < 1e-13
    assert forward_kinematics(PEDAL, inverse_kinematics(PEDAL, LEVEL), "lower") == pytest.approx(
        (0.514011, 0.188880, 2.224654), abs=5e-7
    )


def test_the_printed_argument_of_the_arc_cosine_turns_the_plate_round(geometry, poses):
    batch = poses(200)
    a = slider_places(geometry, batch)
    P, _ = pivots(geometry, batch)
    d = a[:, 2] - P[:, 0]
    D = np.hypot(d, P[:, 1])
    printed = (geometry.strut**2 - geometry.lever**2 - D**2) / (2.0 * geometry.lever * D)
    theta = 0.5 * math.pi - np.arctan(d / P[:, 1]) + np.arccos(printed)
    off = theta + geometry.offset - batch[:, 2]
    assert np.abs(np.abs(np.remainder(off, 2.0 * math.pi)) - math.pi).max() < 1e-6


def test_a_motion_along_the_rail_moves_all_sliders_alike(geometry, poses):
    batch = poses(100)
    moved = slider_places(geometry, batch + np.array((0.3, 0.0, 0.0))) - slider_places(
        geometry, batch
    )
    assert np.abs(moved - 0.3).max() < 1e-15


# --- rates and forces


def test_the_jacobian_is_the_derivative_of_the_pose(geometry, poses):
    batch = poses(200)
    a = slider_places(geometry, batch)
    for k in range(3):
        by = 1e-7 * np.eye(3)[k]
        ahead, behind = (forward_kinematics(geometry, a + sign * by) for sign in (1, -1))
        slope = (ahead - behind) / 2e-7
        exact = jacobian(geometry, batch)[..., k]
        assert np.abs(slope - exact).max() < 1e-5 * (1.0 + np.abs(exact).max())


def test_rates_of_sliders_and_of_the_plate_are_inverse(geometry, poses):
    batch = poses(500)
    K = np.stack([slider_rates(geometry, batch, one) for one in np.eye(3)], axis=-1)
    assert np.abs(jacobian(geometry, batch) @ K - np.eye(3)).max() < 1e-10
    assert np.array_equal(K[..., 0], np.ones_like(K[..., 0]))
    np.testing.assert_allclose(inverse_jacobian(geometry, batch), K, rtol=1e-12, atol=1e-12)


def test_drake_differentiates_the_places(geometry, poses):
    for pose in poses(5):
        exact = ExtractGradient(slider_places(geometry, InitializeAutoDiff(pose).ravel()))
        K = np.stack([slider_rates(geometry, pose, one) for one in np.eye(3)], axis=-1)
        np.testing.assert_allclose(exact, K, atol=1e-12 * np.abs(K).max())


def test_drake_differentiates_the_pose(geometry, poses):
    for pose in poses(5):
        sliders = InitializeAutoDiff(slider_places(geometry, pose)).ravel()
        exact, J = ExtractGradient(forward_kinematics(geometry, sliders)), jacobian(geometry, pose)
        np.testing.assert_allclose(exact, J, atol=1e-11 * np.abs(J).max())


def test_a_vertical_motion_is_fastest_where_the_sliders_are_at_their_stop():
    height = math.sqrt(PEDAL.link**2 - (0.5 * PEDAL.gap) ** 2)
    pose = (0.5, height - PEDAL.p_OP[1], 0.0)
    rates = slider_rates(PEDAL, pose, (0.0, 1.0, 0.0))
    assert rates[:2] == pytest.approx((5.916, -5.916), abs=5e-4)


def test_forces_do_the_work_of_the_load(geometry, poses):
    rng = np.random.default_rng(1)
    batch, load, twist = poses(300), rng.normal(size=(300, 3)), rng.normal(size=(300, 3))
    forces = slider_forces(geometry, batch, load)
    power = np.sum(forces * slider_rates(geometry, batch, twist), axis=-1)
    np.testing.assert_allclose(power, -np.sum(load * twist, axis=-1), atol=1e-10)
    np.testing.assert_allclose(forces.sum(axis=-1), -load[:, 0], atol=1e-11)


def test_a_load_on_p_alone_is_carried_by_the_two_links_as_a_truss_carries_it():
    # A weight at P, told about O'.
    P, _ = pivots(PEDAL, LEVEL)
    moment = -(P[0] - LEVEL[0]) * -300.0
    forces = slider_forces(PEDAL, LEVEL, (0.0, -300.0, moment))
    slope = math.sqrt(PEDAL.link**2 - P[1] ** 2) / P[1]
    # Sliders hold the feet of the links together.
    assert forces == pytest.approx((150.0 * slope, -150.0 * slope, 0.0), abs=1e-10)


# --- singularities


def test_the_determinant_is_told_by_an_identity(geometry, poses):
    batch = poses(500)
    at = singularity(geometry, batch)
    exact = np.linalg.det(jacobian(geometry, batch))
    np.testing.assert_allclose(at.determinant, exact, rtol=1e-9)
    s_1, s_3 = at.spread * geometry.link, at.lean * geometry.strut
    below = 2.0 * at.height * geometry.link * geometry.strut * geometry.lever * at.sin_mu
    np.testing.assert_allclose(-geometry.branch * at.determinant, s_1 * s_3 / below, rtol=1e-9)


def test_singularities_at_golden_poses():
    at = singularity(PEDAL, LEVEL)
    assert at.sin_mu == pytest.approx(0.965063680, abs=5e-10)
    assert at.determinant == pytest.approx(-3.556116416, abs=5e-10)
    at = singularity(TREADMILL, (0.88, 0.20, 0.0))
    assert at.sin_mu == pytest.approx(0.444444, abs=5e-7)
    assert at.determinant == pytest.approx(1.877891, abs=5e-7)


def test_sin_mu_is_the_sine_of_the_angle_at_t(geometry, poses):
    batch = poses(200)
    a = slider_places(geometry, batch)
    P, T = pivots(geometry, batch)
    to_p, to_a = P - T, on_rail(a[:, 2]) - T
    sine = (to_p[:, 0] * to_a[:, 1] - to_p[:, 1] * to_a[:, 0]) / geometry.strut / geometry.lever
    np.testing.assert_allclose(singularity(geometry, batch).sin_mu, sine, atol=1e-14)


@pytest.mark.parametrize(("z", "degrees"), [(0.28, 65.46), (0.20, 54.13), (0.15, 47.58)])
def test_the_plate_passes_the_line_where_it_is_turned_too_far(z, degrees):
    near = [singularity(PEDAL, (0.5, z, math.radians(degrees + by))) for by in (-0.01, 0.01)]
    assert near[0].sin_mu > 0.0 > near[1].sin_mu
    with pytest.raises(UnreachablePlate, match=r"P, T and A_3 would pass .*sin mu = -0\.000"):
        inverse_kinematics(replace(PEDAL, strut_gap=None), (0.5, z, math.radians(degrees + 0.01)))


def test_each_singularity_is_told_by_a_measure_of_its_own():
    upright = replace(PEDAL, gap=1e-9)
    together = (0.5, PEDAL.link - PEDAL.p_OP[1], 0.0)
    at = singularity(upright, together)
    assert at.spread == pytest.approx(0.0, abs=1e-7)
    assert at.sin_mu > 0.5
    assert np.isfinite(jacobian(upright, together)).all()
    flat = (0.5, -PEDAL.p_OP[1], 0.0)
    assert singularity(PEDAL, flat).height == pytest.approx(0.0, abs=1e-15)
    assert not np.isfinite(jacobian(PEDAL, flat)).all()
    strut = (0.5, PEDAL.strut, 0.0)
    assert singularity(replace(PEDAL, link=0.5), strut).lean == pytest.approx(0.0, abs=1e-7)


# --- limits


@pytest.mark.parametrize(
    ("pose", "limit", "missing", "said"),
    [
        ((0.5, 0.06, 0.0), "height of P", 0.009017513,
         r"pivot P would be 9\.02 mm below its least height of 20\.0 mm"),
        ((0.5, 0.06, 1.05), "height of T", None, "pivot T would be .* mm below its least height"),
        ((0.5, 0.36, 0.0), "reach of P", 0.010982487,
         r"pivot P would be 10\.98 mm higher than its links are long"),
        ((0.5, 0.346, 0.0), "gap of A_1 and A_2", None,
         r"A_1 and A_2 would be [\d.]+ mm closer than 100\.0 mm"),
        ((0.2, 0.28, 0.0), "rear end of slider 1", 0.086914650,
         r"slider 1 would be at -6\.91 mm, 86\.91 mm beyond its rail 80\.0\.\.1120\.0 mm"),
        ((0.8, 0.28, 0.0), "front end of slider 3", 0.053049517,
         r"slider 3 would be at 1173\.05 mm, 53\.05 mm beyond its rail"),
        ((0.5, 0.28, 1.2), "line P T A_3", None, r"P, T and A_3 would pass the line"),
        ((0.5, math.nan, 0.0), "height of P", None, "the pose has numbers that are not finite"),
    ],
)  # fmt: skip
def test_a_pose_beyond_a_limit_is_refused_with_what_is_missing(pose, limit, missing, said):
    with pytest.raises(UnreachablePlate, match=said) as caught:
        inverse_kinematics(PEDAL, pose)
    assert caught.value.limit == limit
    assert caught.value.index is None
    if missing is not None:
        assert caught.value.missing == pytest.approx(missing, abs=5e-10)


def test_a_strut_that_shares_its_rail_keeps_away_from_the_link():
    one_rail = replace(TREADMILL, strut_gap=0.1)
    with pytest.raises(UnreachablePlate, match=r"A_2 and A_3 would be 126\.72 mm closer than 100"):
        inverse_kinematics(one_rail, (0.88, 0.20, 0.0))


def test_the_first_pose_of_a_batch_that_is_out_of_reach_is_named():
    batch = np.tile(LEVEL, (2, 3, 1))
    batch[1, 0, 1] = 0.36
    batch[1, 2, 0] = 0.1
    with pytest.raises(UnreachablePlate, match=r"^pose \[1, 0\]: pivot P would be") as caught:
        inverse_kinematics(PEDAL, batch)
    assert caught.value.index == (1, 0)


def test_margins_tell_what_is_left_to_every_limit(geometry, poses):
    batch = poses(300)
    left = dict(zip(LIMITS, np.moveaxis(margins(geometry, batch), -1, 0), strict=True))
    a, (P, T) = slider_places(geometry, batch), pivots(geometry, batch)
    expected = {
        "height of P": P[:, 1] - 0.02,
        "height of T": T[:, 1] - 0.02,
        "reach of P": 0.3 - P[:, 1],
        "reach of T": geometry.strut - T[:, 1],
        "line P T A_3": singularity(geometry, batch).sin_mu,
        "gap of A_1 and A_2": a[:, 1] - a[:, 0] - 0.1,
        "gap of A_2 and A_3": a[:, 2] - a[:, 1] - 0.1 if geometry.strut_gap else np.inf,
    }
    for k in range(3):
        expected[f"rear end of slider {k + 1}"] = a[:, k] - 0.08
        expected[f"front end of slider {k + 1}"] = 1.12 - a[:, k]
    assert set(expected) == set(LIMITS)
    for name, value in expected.items():
        np.testing.assert_allclose(left[name], value, atol=1e-14, err_msg=name)


def test_two_sliders_in_one_place_have_a_pose():
    pose = forward_kinematics(PEDAL, (0.45, 0.45, 0.8))
    P, _ = pivots(PEDAL, pose)
    np.testing.assert_allclose(P, (0.45, PEDAL.link), atol=1e-15)


@pytest.mark.parametrize("sliders", [(0.5, 0.4, 0.8), (0.3, 0.4, 1.8), (0.1, 0.9, 1.0)])
def test_sliders_between_which_the_links_cannot_be_joined_are_refused(sliders):
    with pytest.raises(UnreachablePlate, match=r"with the sliders at .* mm the links cannot be"):
        forward_kinematics(PEDAL, sliders)


def test_wrong_shapes_and_assemblies_are_refused():
    with pytest.raises(ValueError, match=r"pose must have shape \(\.\.\., 3\), not \(2,\)"):
        inverse_kinematics(PEDAL, (0.5, 0.3))
    with pytest.raises(ValueError, match="assembly must be 'upper' or 'lower', not 'middle'"):
        forward_kinematics(PEDAL, (0.3, 0.6, 0.9), "middle")
