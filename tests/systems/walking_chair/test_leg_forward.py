import math

import numpy as np
import pytest

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import (
    branch_lengths,
    leg_corners,
    leg_forward,
    leg_inverse,
    up_of_lengths,
)

LEG = LegGeometry()
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


def test_lengths_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"lengths must have shape \(\.\.\., 3\)"):
        leg_forward(LEG, (0.7, 0.7))
