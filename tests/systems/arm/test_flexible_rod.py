"""Modes, sag and buckling of a clamped rod with a tip mass, beside Euler and Bernoulli."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.core.physics import GRAVITY

ROD = FlexibleRod(modes=3)
RODS = [
    ROD,
    replace(ROD, tip_mass=0.0),
    replace(ROD, tip_mass=40.0),
    FlexibleRod(length=0.7, mass=3.0, tip_mass=0.2, bending_stiffness=(900.0, 90.0), modes=3),
]


@pytest.mark.parametrize("rod", RODS)
def test_wave_numbers_solve_the_frequency_equation(rod):
    x, ratio = rod.wave_numbers, rod.tip_mass / rod.mass
    left = 1.0 + np.cos(x) * np.cosh(x)
    right = ratio * x * (np.sin(x) * np.cosh(x) - np.cos(x) * np.sinh(x))
    np.testing.assert_allclose((left - right) / np.cosh(x), 0.0, atol=1e-9)
    assert (np.diff(x) > 0.0).all()


def test_rod_without_tip_mass_has_the_textbook_wave_numbers():
    # Meirovitch, Fundamentals of Vibrations, 2001, Eq. (8.133): clamped and free.
    expected = [1.875104068711961, 4.694091132974175, 7.854757438237613]
    np.testing.assert_allclose(RODS[1].wave_numbers, expected, rtol=1e-12)


def test_heavy_tip_is_a_mass_on_a_spring():
    rod = replace(ROD, tip_mass=1e6)
    by_spring = math.sqrt(3.0 * rod.bending_stiffness[0] / rod.length**3 / rod.tip_mass)
    assert rod.frequencies[0, 0] == pytest.approx(by_spring, rel=1e-6)
    pinned = 3.9266023120479185  # clamped and pinned
    assert rod.wave_numbers[1] == pytest.approx(pinned, rel=1e-6)


@pytest.mark.parametrize("rod", RODS)
def test_shapes_are_orthonormal_in_mass_and_diagonal_in_stiffness(rod):
    z, step = np.linspace(0.0, rod.length, 4001, retstep=True)
    weights = np.full(z.size, step)
    weights[[0, -1]] *= 0.5
    shape, at_tip = rod.shape(z), rod.shape(rod.length)
    mass = rod.mass / rod.length * (weights * shape.T) @ shape
    mass += rod.tip_mass * np.outer(at_tip, at_tip)
    np.testing.assert_allclose(mass, np.eye(3), atol=2e-5)
    bent = np.gradient(rod.slope(z), step, axis=0, edge_order=2)
    stiffness = rod.bending_stiffness[1] * (weights * bent.T) @ bent
    scale = np.outer(rod.frequencies[1], rod.frequencies[1])
    np.testing.assert_allclose(stiffness / scale, np.eye(3), atol=2e-4)
    np.testing.assert_allclose(
        np.gradient(shape, step, axis=0)[1:-1], rod.slope(z)[1:-1], atol=1e-3
    )
    np.testing.assert_allclose([rod.shape(0.0), rod.slope(0.0)], 0.0, atol=1e-12)


@pytest.mark.parametrize("rod", RODS)
def test_participations_add_up_to_nearly_all_mass(rod):
    first = 0.5 * rod.mass * rod.length + rod.tip_mass * rod.length
    second = rod.mass * rod.length**2 / 3.0 + rod.tip_mass * rod.length**2
    for modal, whole in (
        (rod.translation @ rod.rotation, first),
        (rod.rotation @ rod.rotation, second),
    ):
        assert 0.98 * whole < modal < whole
    assert rod.translation @ rod.translation < rod.mass + rod.tip_mass


@pytest.mark.parametrize("modes", [1, 2, 3])
@pytest.mark.parametrize("plane", [0, 1])
def test_horizontal_rod_sags_as_the_closed_form_says(modes, plane):
    rod = replace(ROD, bending_stiffness=(430.0, 250.0), modes=modes)
    long, per_length, stiffness = rod.length, rod.mass / rod.length, rod.bending_stiffness[plane]
    by_tip = rod.tip_mass * GRAVITY * long**3 / (3.0 * stiffness)
    by_weight = per_length * GRAVITY * long**4 / (8.0 * stiffness)
    sag = rod.sag(GRAVITY, 0.0, plane)
    assert sag.across == pytest.approx(-by_tip - by_weight, rel=1e-9)
    turn = rod.tip_mass * long**2 / 2.0 + per_length * long**3 / 6.0
    assert sag.slope == pytest.approx(-GRAVITY * turn / stiffness, rel=1e-9)
    assert 50e-3 < -replace(rod, bending_stiffness=(430.0, 430.0)).sag(GRAVITY, 0.0).across < 53e-3


@pytest.mark.parametrize("lean", [0.1, 0.8, 1.5, 2.5, 3.1])
def test_leaning_rod_with_its_mass_at_the_tip_sags_as_a_beam_column(lean):
    rod = replace(ROD, mass=1e-7)
    across, along = GRAVITY * math.sin(lean), GRAVITY * math.cos(lean)
    load, thrust = rod.tip_mass * across, rod.tip_mass * along
    k = math.sqrt(abs(thrust) / rod.bending_stiffness[0])
    # Timoshenko and Gere, Theory of Elastic Stability, 1961, section 1.2: tan for a thrust, tanh
    # for a pull.
    bend = math.tan if thrust > 0.0 else math.tanh
    expected = load / thrust * (bend(k * rod.length) / k - rod.length)
    assert rod.sag(across, along).across == pytest.approx(-expected, rel=1e-6)


def test_thrust_of_eulers_load_buckles_it():
    rod = replace(ROD, mass=1e-7, bending_stiffness=(430.0, 250.0))
    euler = math.pi**2 * 250.0 / (4.0 * rod.length**2)
    assert rod.buckling == pytest.approx(euler / rod.tip_mass, rel=1e-3)
    # Greenhill: a column of even mass buckles under 7.837 B / L^3 per unit of length.
    column = replace(RODS[1], bending_stiffness=(430.0, 430.0))
    assert column.buckling * column.mass == pytest.approx(7.837 * 430.0 / 2.02**2, rel=2e-3)


def test_modes_at_rest_are_the_sag():
    force = np.array([1.3, 0.0, 9.0])
    q = ROD.rest(force[0], force[2], 0)
    across = ROD.shape(ROD.length) @ q + ROD.residual[0, 0, 0] * force[0]
    sag = ROD.sag(force[0], force[2])
    assert across == pytest.approx(sag.across, rel=1e-12)
    assert 0.5 * q @ ROD.shortening @ q == pytest.approx(sag.along, rel=1e-12)


def test_bent_rod_keeps_its_length():
    sag = ROD.sag(GRAVITY, 0.0)
    q = ROD.rest(GRAVITY, 0.0, 0)
    z = np.linspace(0.0, ROD.length, 2001)
    slope = ROD.slope(z) @ q
    length = np.trapezoid(np.sqrt(1.0 + slope**2), z)
    assert length - ROD.length == pytest.approx(sag.along, rel=1e-3)


def test_sag_of_a_batch_is_that_of_its_rows():
    across, along = np.array([[1.0, 9.0], [0.3, -4.0]]), np.array([2.0, -9.0])
    batch = ROD.sag(across, along)
    for i, j in np.ndindex(2, 2):
        row = ROD.sag(float(across[i, j]), float(along[j]))
        np.testing.assert_allclose([part[i, j] for part in batch], row, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"length": 0.0}, "length = 0.0 must be above 0"),
        ({"mass": -1.0}, "mass = -1.0 must be above 0"),
        ({"tip_mass": math.nan}, "tip_mass = nan must be"),
        ({"bending_stiffness": (430.0, 0.0)}, "bending_stiffness"),
        ({"damping_ratio": 1.0}, "damping_ratio = 1.0 must be 0 or more"),
        ({"modes": 4}, "modes = 4 must be 1 to 3"),
    ],
)
def test_impossible_rods_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        replace(ROD, **change)
