"""One leg: its branches from the place of its foot, and back."""

import math

import numpy as np
import pytest

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import (
    CORNERS,
    branch_lengths,
    corner_numbers,
    leg_corners,
    leg_forward,
    leg_inverse,
    lowest_corner,
    reference_corner,
    up_branch,
    up_of_lengths,
)

LEG = LegGeometry()
HEIGHTS = {"E1": 0, "E2": 1, "E3": 2}
B_S, B_C = 0.5 * LEG.b, 0.5 * math.sqrt(3.0) * LEG.b


def postures(count=2000, seed=0, angle=0.7):
    """Random coordinates of the UP branch over its stroke."""
    rng = np.random.default_rng(seed)
    low, high = LEG.up_stroke
    return rng.uniform((low, -angle, -angle), (high, angle, angle), (count, 3))


def printed_roots(point, sign_v, sign_u):
    """Half tangents v and u of beta and alpha with the roots of Eqs. (16) and (18), for E2."""
    x, y, z = point
    t_m = math.sqrt(x**2 + y**2 + (z + LEG.x1) ** 2 - LEG.b**2)
    v = (-t_m + sign_v * math.sqrt(t_m**2 + (B_C - y) * (y + B_C))) / (B_C - y)
    beta = 2.0 * math.atan(v)
    k = B_C * math.sin(beta) + t_m * math.cos(beta)
    u = (k + sign_u * math.sqrt(k**2 + B_S**2 - x**2)) / (B_S - x)
    return v, u


def posture_of_e2(alpha_deg, beta_deg, length=0.72):
    up = np.array((length, math.radians(alpha_deg), math.radians(beta_deg)))
    return up, leg_corners(LEG, up)[1]


# Round trips


@pytest.mark.parametrize("reference", CORNERS)
def test_up_branch_is_recovered_from_any_corner(reference):
    up = postures()
    points = leg_corners(LEG, up)[:, CORNERS.index(reference)]
    np.testing.assert_allclose(up_branch(LEG, points, reference), up, rtol=0, atol=1e-12)


@pytest.mark.parametrize("reference", CORNERS)
def test_corner_comes_back_to_its_point(reference):
    points = np.random.default_rng(1).uniform((-0.2, -0.2, -0.85), (0.2, 0.2, -0.65), (500, 3))
    corners = leg_corners(LEG, up_branch(LEG, points, reference))
    np.testing.assert_allclose(corners[:, CORNERS.index(reference)], points, rtol=0, atol=1e-12)


def test_all_corners_of_a_posture_give_the_same_lengths():
    corners = leg_corners(LEG, postures(seed=2))
    one, two, three = (leg_inverse(LEG, corners[:, i], name) for name, i in HEIGHTS.items())
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-12)
    np.testing.assert_allclose(three, one, rtol=0, atol=1e-12)


def test_corners_stay_a_triangle():
    corners = leg_corners(LEG, postures(seed=3))
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    np.testing.assert_allclose(sides, LEG.b, rtol=1e-12)


# Printed equations and numbers


def test_corners_are_where_equations_8_and_13_put_them():
    length, alpha, beta = up = np.array((0.7, 0.2, -0.3))
    t_m, s_a, c_a, s_b, c_b = (
        length + LEG.x2,
        *(f(x) for x in (alpha, beta) for f in (math.sin, math.cos)),
    )
    e_1 = (-t_m * s_a * c_b, t_m * s_b, -t_m * c_a * c_b - LEG.x1)
    e_2 = (
        -B_S * c_a - B_C * s_a * s_b - t_m * s_a * c_b,
        -B_C * c_b + t_m * s_b,
        B_S * s_a - B_C * c_a * s_b - t_m * c_a * c_b - LEG.x1,
    )
    np.testing.assert_allclose(leg_corners(LEG, up)[:2], (e_1, e_2), rtol=0, atol=1e-15)


def test_lengths_are_those_of_equation_12():
    _, alpha, beta = up = np.array((0.7, 0.2, -0.3))
    x, y, z = leg_corners(LEG, up)[0]
    s_a, c_a, s_b, c_b = math.sin(alpha), math.cos(alpha), math.sin(beta), math.cos(beta)
    expected = []
    for sign in (-1.0, 1.0):
        a_s, b_s, a_c = sign * 0.5 * LEG.a, sign * B_S, 0.5 * math.sqrt(3.0) * LEG.a
        expected.append(
            math.hypot(
                b_s * c_a - B_C * s_a * s_b + LEG.x3 * s_a * c_b + x - a_s,
                -B_C * c_b - LEG.x3 * s_b + y + a_c,
                -b_s * s_a - B_C * c_a * s_b + LEG.x3 * c_a * c_b + z + LEG.x1,
            )
        )
    np.testing.assert_allclose(branch_lengths(LEG, up)[1:], expected, rtol=0, atol=1e-15)


def test_hanging_straight_and_retracted_all_branches_are_at_the_end_of_their_strokes():
    lengths = leg_inverse(LEG, (0.0, 0.0, -LEG.retracted_height))
    np.testing.assert_allclose(1e3 * lengths, (591.4, 574.00223, 574.00223), rtol=0, atol=5e-6)


def test_hanging_straight_and_extended_the_ups_branches_have_stroke_left():
    lengths = leg_inverse(LEG, (0.0, 0.0, -(0.8914 + LEG.x1 + LEG.x2)))
    np.testing.assert_allclose(1e3 * lengths, (891.4, 872.077, 872.077), rtol=0, atol=5e-4)


def test_mirrored_points_swap_the_ups_branches():
    points = np.random.default_rng(4).uniform((-0.2, -0.2, -0.85), (0.2, 0.2, -0.65), (100, 3))
    mirrored = leg_inverse(LEG, points * (-1.0, 1.0, 1.0), "E1")
    np.testing.assert_allclose(
        mirrored, leg_inverse(LEG, points, "E1")[:, [0, 2, 1]], rtol=0, atol=1e-14
    )
    mirrored = leg_inverse(LEG, points * (-1.0, 1.0, 1.0), "E3")
    np.testing.assert_allclose(
        mirrored, leg_inverse(LEG, points, "E2")[:, [0, 2, 1]], rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("angles", [(-10, -15), (10, 15), (-10, 15), (10, -15)])
def test_only_one_pair_of_the_printed_roots_recovers_the_angles(angles):
    up, point = posture_of_e2(*angles)
    for sign_v in (1.0, -1.0):
        for sign_u in (1.0, -1.0):
            v, u = printed_roots(point, sign_v, sign_u)
            found = np.array((2.0 * math.atan(u), 2.0 * math.atan(v)))
            agrees = np.allclose(found, up[1:], rtol=0, atol=1e-9)
            assert agrees == (sign_v == 1.0 and sign_u == -1.0)


def test_angles_as_printed_in_equation_19_make_lengths_wrong_by_most_of_a_millimetre():
    up, point = posture_of_e2(10.0, 15.0)
    v, u = printed_roots(point, 1.0, -1.0)
    printed = np.array((up[0], math.atan(2.0 * u), math.atan(2.0 * v)))
    error = branch_lengths(LEG, printed) - leg_inverse(LEG, point, "E2")
    np.testing.assert_allclose(1e3 * error, (0.0, -0.61, -0.80), rtol=0, atol=5e-3)


# Bad input


@pytest.mark.parametrize("reference", CORNERS)
@pytest.mark.parametrize(
    "point",
    [
        (0.0, 0.0, -0.054),
        (0.0, 0.0, -0.07),
        (0.0, 0.0, 0.6),
        (0.1, 0.1, 0.6),
        (0.0, 2.0, -0.054),
        (math.nan, 0.0, -0.7),
        (0.0, math.inf, -0.7),
    ],
)
def test_a_point_out_of_reach_gives_nan(point, reference):
    assert np.isnan(leg_inverse(LEG, point, reference)).all()
    assert np.isnan(up_branch(LEG, point, reference)).all()


def test_a_point_out_of_reach_leaves_the_others_of_a_batch_alone():
    points = np.array(((0.0, 0.0, -0.7), (0.0, 0.0, 0.7), (0.1, 0.0, -0.7)))
    lengths = leg_inverse(LEG, points, ["E1", "E2", "E3"])
    assert np.isnan(lengths).all(axis=-1).tolist() == [False, True, False]
    np.testing.assert_array_equal(lengths[2], leg_inverse(LEG, points[2], "E3"))


def test_lengths_outside_the_strokes_are_given():
    assert leg_inverse(LEG, (0.0, 0.0, -0.3))[0] < LEG.up_stroke[0]


def test_batches_and_references_broadcast():
    points = np.random.default_rng(5).uniform((-0.1, -0.1, -0.8), (0.1, 0.1, -0.7), (6, 1, 3))
    lengths = leg_inverse(LEG, points, [[1, 2, 3]])
    assert lengths.shape == (6, 3, 3)
    for i, name in enumerate(CORNERS):
        np.testing.assert_allclose(
            lengths[:, i], leg_inverse(LEG, points[:, 0], name), rtol=0, atol=1e-15
        )


def test_an_unknown_corner_is_refused():
    with pytest.raises(ValueError, match="one of E1, E2, E3"):
        leg_inverse(LEG, (0.0, 0.0, -0.7), "E4")


QUARTER = 0.5 * math.pi


def assemblies(lengths):
    """Angles (alpha, beta) within the joints' range: the polynomial of degree 4 in cos(alpha)."""
    a, b, s_30, c_30 = LEG.a, LEG.b, 0.5, 0.5 * math.sqrt(3.0)
    h = lengths[0] + LEG.x2 - LEG.x3
    k_2, k_3 = (0.5 * (a**2 + b**2 + h**2 - length**2) for length in lengths[1:])
    s, d = 0.5 * (k_2 + k_3), 0.5 * (k_2 - k_3)
    rho, delta = math.hypot(b * c_30, h), math.atan2(h, b * c_30)
    p, q = a * s_30 * b * s_30, a * c_30 * rho
    polynomial = np.polymul((-1.0, 0.0, 1.0), (-p * p, 2.0 * s * p, q * q - s * s))
    polynomial[-1] -= 3.0 * d * d
    roots = np.roots(polynomial / np.abs(polynomial).max())
    found = []
    for root in roots[(np.abs(roots.imag) < 1e-6) & (np.abs(roots.real) < 1.0 + 1e-9)].real:
        cosine = min(max(root, -1.0), 1.0)
        psi = math.acos(min(max((s - p * cosine) / q, -1.0), 1.0))
        alpha, beta = math.copysign(math.acos(cosine), d), psi - delta
        if abs(alpha) < QUARTER and abs(beta) < QUARTER:
            found.append((alpha, beta))
    return np.array(found).reshape(-1, 2)


def random_lengths(count, seed):
    low, high = LEG.strokes.T
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def test_posture_is_recovered_from_its_lengths():
    rng = np.random.default_rng(0)
    up = rng.uniform((*LEG.up_stroke[:1], -0.7, -0.7), (LEG.up_stroke[1], 0.7, 0.7), (3000, 3))
    found = leg_forward(LEG, branch_lengths(LEG, up))
    np.testing.assert_allclose(found.alpha, up[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.beta, up[:, 2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.point, leg_corners(LEG, up)[:, 0], rtol=0, atol=1e-12)


def test_lengths_are_recovered_from_their_posture_wherever_there_is_one():
    lengths = random_lengths(5000, 1)
    point, alpha, beta = leg_forward(LEG, lengths)
    found = np.isfinite(alpha)
    assert 0.67 < found.mean() < 0.72
    again = leg_inverse(LEG, point[found])
    np.testing.assert_allclose(again, lengths[found], rtol=0, atol=1e-12)
    assert (np.abs(alpha[found]) < QUARTER).all()
    assert (np.abs(beta[found]) < QUARTER).all()


def test_a_posture_is_found_exactly_where_the_polynomial_has_one_and_it_is_that():
    lengths = random_lengths(1500, 2)
    up = up_of_lengths(LEG, lengths)
    for triple, (_, *angles) in zip(lengths, up, strict=True):
        expected = assemblies(triple)
        assert np.isfinite(angles).all() == (len(expected) > 0)
        if len(expected):
            # The double root at alpha = 0 makes the polynomial's solutions poor.
            assert np.abs(expected - angles).max(axis=1).min() < 1e-4


def test_leg_without_side_swing_is_found_exactly_where_the_polynomial_has_a_double_root():
    up = np.array((0.7, 0.0, -0.2))
    alpha, beta = leg_forward(LEG, branch_lengths(LEG, up))[1:]
    assert alpha == 0.0
    assert beta == pytest.approx(-0.2, abs=1e-14)


def test_hanging_straight_is_found_at_once():
    point, alpha, beta = leg_forward(LEG, leg_inverse(LEG, (0.0, 0.0, -0.78)))
    np.testing.assert_allclose(point, (0.0, 0.0, -0.78), rtol=0, atol=1e-15)
    assert (alpha, beta) == pytest.approx((0.0, 0.0), abs=1e-15)


@pytest.mark.parametrize(
    "lengths",
    [
        (0.8914, 0.574, 0.574),
        (0.5914, 0.874, 0.874),
        (0.7, 0.0, 0.0),
        (0.7, -0.68, 0.68),
        (-0.7, 0.68, 0.68),
        (0.0, 0.0, 0.0),
        (math.nan, 0.68, 0.68),
        (0.7, math.inf, 0.68),
        (1e6, 0.68, 0.68),
    ],
)
def test_lengths_that_no_leg_can_have_give_nan(lengths):
    for value in leg_forward(LEG, lengths):
        assert np.isnan(value).all()


def test_lengths_that_no_leg_can_have_leave_the_others_of_a_batch_alone():
    good = leg_inverse(LEG, (0.05, -0.1, -0.75))
    found = leg_forward(LEG, np.array((good, (0.8914, 0.574, 0.574), good)))
    assert np.isnan(found.alpha).tolist() == [False, True, False]
    for point in found.point[[0, 2]]:
        np.testing.assert_allclose(point, (0.05, -0.1, -0.75), rtol=0, atol=1e-12)


def test_whole_numbers_are_lengths_too():
    found = leg_forward(LEG, np.ones((2, 5, 3), dtype=int)).point
    assert found.shape == (2, 5, 3)
    np.testing.assert_array_equal(found[1, 4], leg_forward(LEG, (1.0, 1.0, 1.0)).point)
    assert np.isfinite(found).all()


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def test_names_and_numbers_of_corners_mean_the_same():
    assert corner_numbers("E2") == 2
    assert corner_numbers(3) == 3
    np.testing.assert_array_equal(corner_numbers(CORNERS), (1, 2, 3))
    np.testing.assert_array_equal(corner_numbers(np.array([["E3", "E1"]])), [[3, 1]])
    np.testing.assert_array_equal(corner_numbers([1, 2, 3]), (1, 2, 3))
    np.testing.assert_array_equal(corner_numbers(np.array(["E1", "E2"], dtype=object)), (1, 2))


@pytest.mark.parametrize(
    "reference", ["E4", "e1", "", 0, 4, -1, 1.5, math.nan, None, True, ["E1", "E0"], [1, 4]]
)
def test_a_corner_that_does_not_exist_is_refused_with_those_that_do(reference):
    with pytest.raises(ValueError, match=r"one of E1, E2, E3 or its number 1, 2, 3, not"):
        corner_numbers(reference)


def test_the_first_unknown_corner_is_named():
    with pytest.raises(ValueError, match="not 'E9'"):
        corner_numbers(["E1", "E9", "E8"])


def test_corners_are_looked_up_per_element():
    np.testing.assert_array_equal(reference_corner(LEG, ["E3", "E1"]), LEG.corners[[2, 0]])


@pytest.mark.parametrize(("beta", "corner"), [(-0.1, 1), (0.0, 1), (0.1, 2)])
def test_rule_of_the_lowest_corner_without_side_swing(beta, corner):
    assert lowest_corner(LEG, (0.7, 0.0, beta)) == corner


@pytest.mark.parametrize("reference", CORNERS)
def test_the_rule_may_be_asked_with_any_corner(reference):
    for ahead in (-0.1, -0.01, 0.01, 0.1):
        point = LEG.corners[CORNERS.index(reference)] + (0.0, ahead, -0.78)
        found = lowest_corner(LEG, up_branch(LEG, point, reference))
        assert found == (2 if ahead > 0.0 else 1)


def test_no_corner_is_lower_than_the_lowest_in_any_attitude_of_the_leg():
    rng = np.random.default_rng(1)
    up = rng.uniform((0.6, -0.5, -0.5), (0.85, 0.5, 0.5), (200, 3))
    tilt = rng.uniform(-0.3, 0.3, 200)
    c, s, o, i = np.cos(tilt), np.sin(tilt), np.zeros(200), np.ones(200)
    rotation = turned(2.0) @ np.moveaxis(np.array(((i, o, o), (o, c, -s), (o, s, c))), -1, 0)
    heights = np.einsum("nij,nkj->nki", rotation, leg_corners(LEG, up))[..., 2]
    found = lowest_corner(LEG, up, rotation) - 1
    assert set(found) == {0, 1, 2}
    np.testing.assert_allclose(
        np.take_along_axis(heights, found[:, None], axis=1)[:, 0], heights.min(axis=1), atol=1e-15
    )
