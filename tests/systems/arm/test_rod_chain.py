"""The chain of rigid bodies is the beam of Euler and Bernoulli, and what it tells is converged."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.systems.arm.rod_chain import (
    CENIC,
    EXPLICIT,
    GRAVITY,
    HORIZONTAL,
    UPRIGHT,
    Chain,
    Rod,
    base_wrench_and_tip,
    beam_frequencies,
    beam_sag,
    loaded_beam_frequencies,
    swing_of,
)

ROD = Rod()
FLAT = Rod(stiffness=(430.0, 150.0))


def test_the_beams_frequencies_are_those_of_its_equation_and_of_ritz():
    """Known without a tip mass: beta L is 1.87510 and 4.69409 (any textbook)."""
    bare = Rod(tip_mass=0.0)
    unit = math.sqrt(430.0 / (bare.density * bare.length**4))
    expected = unit * np.array((1.875104069, 4.694091133)) ** 2
    np.testing.assert_allclose(beam_frequencies(bare), expected, rtol=1e-8)
    for rod in (bare, ROD, FLAT):
        for plane in (0, 1):
            np.testing.assert_allclose(
                loaded_beam_frequencies(rod, 0.0, plane=plane),
                beam_frequencies(rod, plane=plane),
                rtol=1e-9,
            )


def test_gravity_lowers_the_first_frequency_of_a_beam_that_stands_as_its_buckling_says():
    """The first mode is nearly the static shape, so its square falls in proportion to the load."""
    squares = [loaded_beam_frequencies(ROD, up)[0] ** 2 for up in (-1.0, 0.0, 1.0)]
    assert squares[0] + squares[2] == pytest.approx(2.0 * squares[1], rel=1e-4)
    # A column with all of the load at its end buckles at pi^2 E I / (4 L^2).
    tip_only = Rod(mass=1e-6, tip_mass=1.0)
    buckling = math.pi**2 * 430.0 / (4.0 * tip_only.length**2)
    share = GRAVITY / buckling
    square = loaded_beam_frequencies(tip_only, 1.0)[0] ** 2
    expected = beam_frequencies(tip_only)[0] ** 2 * (1.0 - share)
    assert square == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("rod", [ROD, FLAT], ids=["round", "flat"])
@pytest.mark.parametrize(
    ("attitude", "gravity", "up"),
    [(UPRIGHT, 0.0, 0.0), (UPRIGHT, GRAVITY, 1.0), (math.pi, GRAVITY, -1.0)],
    ids=["weightless", "upright", "hanging"],
)
def test_the_chain_vibrates_as_the_beam(rod, attitude, gravity, up):
    chain = Chain(rod, attitude, gravity=gravity)
    expected = np.ravel([loaded_beam_frequencies(rod, up, plane=plane) for plane in (0, 1)])
    np.testing.assert_allclose(chain.frequencies(), np.sort(expected), rtol=4e-4)
    # Gravity changes the first one by 1.5 % or more, of which the chain has all but 1.5 %.
    assert chain.frequencies()[0] == pytest.approx(np.sort(expected)[0], rel=2e-4)


def test_errors_of_frequencies_fall_by_sixteen_when_hinges_double():
    expected = beam_frequencies(ROD)[1]
    coarse, fine = (
        abs(Chain(gravity=0.0, hinges=hinges).frequencies(3)[2] - expected) for hinges in (4, 8)
    )
    assert 10.0 < coarse / fine < 60.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_horizontal_rod_sags_as_the_beam_and_weighs_on_its_base(sign):
    chain = Chain(FLAT, sign * HORIZONTAL)
    chain.set_rest()
    sag, *_ = chain.deflection()
    assert sag == pytest.approx(sign * beam_sag(FLAT), rel=2e-3)
    moment, force = chain.base_wrench()
    weight = (FLAT.mass + FLAT.tip_mass) * GRAVITY
    np.testing.assert_allclose(force, (sign * weight, 0.0, 0.0), atol=2e-4)
    lever = (0.5 * FLAT.mass + FLAT.tip_mass) * GRAVITY * FLAT.length
    np.testing.assert_allclose(moment, (0.0, sign * lever, 0.0), rtol=1e-3, atol=1e-9)


def test_the_base_feels_what_changes_the_momentum_of_the_rod():
    """About the clamp, while the base turns."""
    chain, rows = Chain(swing=swing_of()), []
    plant, context, rod = chain.plant, chain.context, [chain.instance]
    weight = np.array((0.0, 0.0, -GRAVITY * plant.CalcTotalMass(context, rod)))
    times = np.linspace(0.0, 0.1, 201)
    for _ in chain.advance(times):
        turn = chain.base.EvalPoseInWorld(context).rotation().matrix()
        moment, force = (turn @ part for part in chain.base_wrench())
        centre = plant.CalcCenterOfMassPositionInWorld(context, rod)
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, rod, np.zeros(3))
        acting = (np.cross(centre, weight) - moment, weight - force)
        rows.append(np.concatenate((*acting, momentum.rotational(), momentum.translational())))
    rows = np.array(rows)
    impulse = np.trapezoid(rows[:, :6], times, axis=0)
    change = rows[-1, 6:] - rows[0, 6:]
    assert np.abs(change).min() < 1e-9 < 0.1 < np.abs(change).max()
    np.testing.assert_allclose(impulse, change, atol=2e-3 * np.abs(change).max())


def vibration(times, deflection, guess):
    """Frequency [rad/s] and damping ratio of samples of a vibration about its mean."""

    def errors(parameters):
        mean, cosine, sine, frequency, damping = parameters
        decay = np.exp(-damping * frequency * times)
        phase = frequency * times
        return mean + decay * (cosine * np.cos(phase) + sine * np.sin(phase)) - deflection

    start = (deflection.mean(), deflection[0] - deflection.mean(), 0.0, guess, 0.0)
    return least_squares(errors, start, x_scale=(0.05, 0.05, 0.05, 1.0, 1e-3)).x[3:]


@pytest.mark.slow
def test_nothing_damps_the_chain_under_cenic(record_property):
    """Ten seconds after a release from straight, horizontal."""
    chain = Chain(attitude=HORIZONTAL, scheme=CENIC)
    times, rows = 0.02 * np.arange(501), []
    for _ in chain.advance(times):
        rows.append((chain.deflection()[0], chain.energy()))
    deflection, energy = np.array(rows).T
    record_property("real_time_factor", chain.simulator.get_actual_realtime_rate())
    guess = beam_frequencies(ROD)[0]
    frequency, damping = vibration(times, deflection, guess)
    assert frequency == pytest.approx(Chain(attitude=HORIZONTAL).frequencies(2)[1], rel=5e-4)
    assert abs(damping) < 5e-5
    # The energy that goes to and fro is that of the static sag, two times.
    swinging = GRAVITY * (0.5 * ROD.mass + ROD.tip_mass) * beam_sag(ROD)
    assert np.abs(energy - energy[0]).max() < 5e-3 * swinging
    assert deflection.max() == pytest.approx(2.0 * beam_sag(ROD), rel=5e-3)


@pytest.mark.slow
def test_joints_damp_a_mode_in_proportion_to_its_frequency():
    """Damping c of joints with springs k damps as Kelvin and Voigt: c / k omega / 2."""
    damping = 0.5
    chain = Chain(attitude=HORIZONTAL, damping=damping)
    times, rows = 0.02 * np.arange(151), []
    for _ in chain.advance(times):
        rows.append(chain.deflection()[0])
    frequency = beam_frequencies(ROD)[0]
    spring = ROD.stiffness[0] / (ROD.length / 8)
    _, ratio = vibration(times, np.array(rows), frequency)
    assert ratio == pytest.approx(0.5 * frequency * damping / spring, rel=3e-3)


@pytest.fixture(scope="module")
def swung():
    """A swing by 45 deg in 1 s."""
    return base_wrench_and_tip()


def differences(one, other):
    """Largest differences of tip, moment and force, by the largest value."""
    return [
        np.abs(getattr(one, part) - getattr(other, part)).max()
        / np.abs(getattr(other, part)).max()
        for part in ("tip", "moment", "force")
    ]


@pytest.mark.slow
def test_a_swing_is_converged(swung, record_property):
    record_property("real_time_factor", swung.real_time_factor)
    halved = base_wrench_and_tip(accuracy=5e-6)
    assert max(differences(swung, halved)) < 2e-3
    finer = base_wrench_and_tip(hinges=12)
    tip, moment, force = differences(swung, finer)
    assert tip < 1e-3
    assert moment < 2e-3
    # The sudden acceleration of the cubic shakes modes that a beam has and a chain has not.
    assert force < 1e-2


@pytest.mark.slow
def test_a_swing_begins_upright_and_follows_the_cubic_in_its_plane(swung):
    swing = swing_of()
    expected = [swing.value(time).item() for time in swung.time]
    np.testing.assert_allclose(swung.angle, expected, atol=5e-6)
    weight = (ROD.mass + ROD.tip_mass) * GRAVITY
    # All but what the cubic's first acceleration adds to the rest.
    np.testing.assert_allclose(swung.force[0, 1:], (0.0, -weight), rtol=1e-5, atol=1e-6)
    for out_of_plane in (swung.tip[:, 1], swung.force[:, 1], swung.moment[:, ::2]):
        assert np.abs(out_of_plane).max() < 1e-9
    # Behind the base at first, and about the sag of 45 deg in the end.
    assert swung.tip[:10, 0].min() < -1e-3
    after = swung.time > 1.0
    sag = math.sin(math.radians(45.0)) * beam_sag(ROD)
    assert swung.tip[after, 0].mean() == pytest.approx(sag, rel=0.1)


@pytest.mark.slow
def test_on_a_sprung_base_cenic_and_an_explicit_integrator_agree(record_property):
    shown = []
    for scheme in (CENIC, EXPLICIT):
        chain = Chain(FLAT, math.radians(30.0), springs=(2e4, 1e5), scheme=scheme)
        rows = [
            (*chain.deflection(), *chain.base.EvalPoseInWorld(chain.context).translation())
            for _ in chain.advance(np.linspace(0.0, 0.6, 61))
        ]
        record_property(f"{scheme}_real_time_factor", chain.simulator.get_actual_realtime_rate())
        shown.append(np.array(rows))
    one, other = shown
    largest = np.abs(other).max(0)
    assert largest[0] > 0.02
    # The base goes down by twice its own static deflection.
    assert largest[5] == pytest.approx(2.0 * 51.0 * GRAVITY / 1e5, rel=0.1)
    assert np.abs(one - other)[:, :3].max() < 3e-3 * largest[0]
    assert np.abs(one - other)[:, 3:].max() < 1e-2 * largest[5]


@pytest.mark.slow
def test_a_free_base_and_its_rod_keep_their_momentum():
    chain = Chain(springs=(0.0, 0.0), gravity=0.0)
    # Bent in both planes, as a force at the tip would.
    for hinge, angle in enumerate(np.linspace(0.01, 0.0, 8), start=1):
        for axis in ("(1, 0, 0)", "(0, 1, 0)"):
            joint = chain.plant.GetJointByName(f"hinge_{hinge}_{axis}")
            joint.set_angle(chain.context, angle)
    plant, context, before = chain.plant, chain.context, chain.energy()
    for _ in chain.advance((0.05, 0.1)):
        whole, rod = (
            plant.CalcSpatialMomentumInWorldAboutPoint(context, instances, np.zeros(3))
            for instances in ([chain.base.model_instance(), chain.instance], [chain.instance])
        )
        assert np.linalg.norm(rod.get_coeffs()) > 0.02
        assert np.linalg.norm(whole.get_coeffs()) < 5e-3 * np.linalg.norm(rod.get_coeffs())
    assert chain.energy() == pytest.approx(before, rel=1e-4)
