"""Kinematic feedforward of three legs, and the fourth one that follows from them."""

import math

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)

GEOMETRY = PlatformGeometry(foot_radius=0.025)
POSTURE = np.array((0.01, -0.02, 0.475))
RATE = np.array((0.02, 0.01, 0.005))
GROUND = np.array((0.02, -0.03))
OFFSETS = np.array((0.004, -0.003, 0.002, -0.005))
UNDERFOOT = {"ground": GROUND, "foot_offsets": OFFSETS}
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND, OFFSETS)
EXTENSION_RATE = posture_jacobian(GEOMETRY, POSTURE, GROUND, extension=EXTENSION) @ RATE
MEASURED = np.array((0.400, 0.403, 0.406, 0.409))
TRIPLES = pytest.mark.parametrize("active", [(0, 1, 2), (0, 1, 3), (3, 2, 1), (2, 0, 3)])


@pytest.fixture
def feedforward(stand):
    """feedforward(law, active, **inputs): the system in the motion above, but for the inputs."""

    def begin(law="exact", active=(0, 1, 2), **inputs):
        system = KinematicFeedforward(GEOMETRY, law, active)
        given = {
            "posture_desired_state": [*POSTURE, *RATE],
            "extension_measured": MEASURED,
            "enable": 0.0,
        }
        return stand(system, **(UNDERFOOT | given | inputs))

    return begin


def active_legs(stand):
    """Desired extensions and rates of the active legs."""
    return np.split(stand["active_desired_state"], 2)


def test_extension_on_level_ground_is_that_of_the_table(stand):
    # d = .400: h = .505429 m, and dp_z/dd = -6.047 there.
    extension, rate = active_legs(
        stand(
            KinematicFeedforward(),
            posture_desired_state=(0.0, 0.0, 0.505429, 0.0, 0.0, 1.0),
            ground=(0.0, 0.0),
        )
    )
    np.testing.assert_allclose(extension, 0.400, atol=1e-7)
    np.testing.assert_allclose(rate, -1.0 / 6.047, rtol=1e-4)


@TRIPLES
def test_exact_law_is_inverse_kinematics_and_its_derivative_along_the_motion(feedforward, active):
    extension, rate = active_legs(feedforward("exact", active))
    np.testing.assert_allclose(extension, EXTENSION[list(active)], rtol=0, atol=1e-14)
    np.testing.assert_allclose(rate, EXTENSION_RATE[list(active)], atol=1e-14)
    step = 1e-6
    ahead, behind = (
        inverse_kinematics(GEOMETRY, POSTURE + t * RATE, GROUND, OFFSETS)[list(active)]
        for t in (step, -step)
    )
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_a_leg_that_cannot_reach_is_nan_and_the_others_are_not_clamped(feedforward):
    beyond = [0.0, 0.75, 0.477, *RATE]
    extension, rate = active_legs(feedforward(posture_desired_state=beyond))
    bad = np.isnan(extension)
    assert bad.any()
    assert not bad.all()
    assert np.isnan(rate[bad]).all()
    assert ((extension[~bad] < 0.390) | (extension[~bad] > 0.420)).all()


@pytest.mark.parametrize(
    ("name", "element", "spoilt"),
    [
        ("posture_desired_state", 0, [True] * 6),
        ("ground", 0, [True] * 6),
        ("posture_desired_state", 3, [False] * 3 + [True] * 3),
        ("foot_offsets", 1, [False, True, False] * 2),
    ],
)
def test_nan_spoils_the_legs_that_it_concerns(feedforward, name, element, spoilt):
    system = feedforward()
    value = system.system.GetInputPort(name).Eval(system.context).copy()
    value[element] = math.nan
    found = system.set(**{name: value})["active_desired_state"]
    assert np.isnan(found).tolist() == spoilt


def test_unknown_law_is_refused():
    with pytest.raises(ValueError, match="law"):
        KinematicFeedforward(GEOMETRY, law="newton")


# The differential law


def worst_error(stand, law, period):
    """Largest error along a smooth motion of 2 s, started from consistent extensions."""
    knots = np.array(
        [(0.0, 0.0, 0.45), (0.02, -0.02, 0.47), (-0.01, 0.03, 0.48), (0.02, 0.01, 0.46)]
    ).T
    motion = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        [0.0, 0.7, 1.4, 2.0], knots, np.zeros(3), np.zeros(3)
    )
    start = inverse_kinematics(GEOMETRY, knots[:, 0], GROUND)
    system = KinematicFeedforward(GEOMETRY, law, period=period)
    driven = stand(system, ground=GROUND, extension_measured=start, enable=1.0)
    worst = 0.0
    for time in np.arange(0.0, 2.0, period).tolist():
        state = np.concatenate([motion.value(time), motion.EvalDerivative(time)]).flatten()
        driven.set(posture_desired_state=state)
        if law == "differential":
            # An update leads to the end of its period.
            driven.tick()
            state[:3] = motion.value(time + period).flatten()
        exact = inverse_kinematics(GEOMETRY, state[:3], GROUND)[:3]
        worst = max(worst, np.abs(active_legs(driven)[0] - exact).max())
    return worst


def test_error_of_the_differential_law_falls_with_the_period_and_the_exact_one_has_none(stand):
    errors = [worst_error(stand, "differential", period) for period in (0.02, 0.01, 0.005)]
    assert 1e-6 < errors[-1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.15)
    assert worst_error(stand, "exact", 0.01) < 1e-14


@TRIPLES
def test_differential_law_integrates_from_the_measured_extensions_while_enabled(
    feedforward, active
):
    system = feedforward("differential", active)
    np.testing.assert_array_equal(active_legs(system)[0], MEASURED[list(active)])
    measured = MEASURED + 0.001
    extension, rate = active_legs(system.tick(3, extension_measured=measured))
    np.testing.assert_array_equal(extension, measured[list(active)])
    # Once it integrates, measurements no longer count, nor do heights of the feet.
    system.tick(enable=1.0).set(extension_measured=np.full(4, 0.39), foot_offsets=-OFFSETS)
    np.testing.assert_allclose(active_legs(system)[0], extension + 0.01 * rate, atol=1e-15)
    at_rest = [*POSTURE, 0.0, 0.0, 0.0]
    before = active_legs(system)[0]
    after = active_legs(system.tick(10, posture_desired_state=at_rest))[0]
    np.testing.assert_array_equal(after, before)
    # It starts anew where the legs are.
    np.testing.assert_allclose(active_legs(system.tick(2, enable=0.0))[0], 0.39, atol=1e-15)


# The passive leg


SOLVED_TRIPLES = pytest.mark.parametrize(
    "active", [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3), (3, 1, 0)]
)


@pytest.fixture
def completed(stand):
    """completed(active, **changes): desired extensions and rates of all legs."""

    def split(active=(0, 1, 2), **changes):
        legs = list(active)
        given = {
            "extension": EXTENSION[legs],
            "extension_rate": EXTENSION_RATE[legs],
            "posture": POSTURE,
            "posture_rate": RATE,
            **UNDERFOOT,
        } | changes
        solver = stand(
            PassiveLegSolver(GEOMETRY, active),
            active_desired_state=[*given["extension"], *given["extension_rate"]],
            posture_desired_state=[*given["posture"], *given["posture_rate"]],
            ground=given["ground"],
            foot_offsets=given["foot_offsets"],
        )
        return np.split(solver["extension_desired_state"], 2)

    return split


@SOLVED_TRIPLES
def test_consistent_legs_are_completed_to_inverse_kinematics(completed, active):
    extension, rate = completed(active)
    np.testing.assert_allclose(extension, EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rate, EXTENSION_RATE, atol=1e-13)


@SOLVED_TRIPLES
def test_active_legs_pass_unchanged_and_the_passive_one_obeys_equation_31(completed, active):
    drifted = EXTENSION[list(active)] + (0.001, -0.002, 0.0015)
    extension, _ = completed(active, extension=drifted, foot_offsets=np.zeros(4))
    np.testing.assert_array_equal(extension[list(active)], drifted)
    (passive,) = set(range(4)) - set(active)
    expected = passive_extension(GEOMETRY, drifted, GROUND, POSTURE[:2], legs=active)
    assert extension[passive] == pytest.approx(expected, abs=1e-14)


def test_height_comes_from_the_first_active_leg_and_not_from_the_desired_posture(completed):
    for i, depends in enumerate((True, False, False)):
        changed = completed(extension=EXTENSION[:3] + 0.001 * (np.arange(3) == i))[0]
        assert (changed[3] != pytest.approx(EXTENSION[3], abs=1e-12)) == depends
    higher = completed(posture=(*POSTURE[:2], 0.6))
    np.testing.assert_array_equal(higher, completed())


@pytest.mark.parametrize(
    ("change", "spoilt"),
    [
        # It cannot reach.
        ({"posture": (0.0, 0.5, 0.475)}, [3, 7]),
        ({"posture": (math.nan, *POSTURE[1:])}, [3, 7]),
        ({"ground": (math.nan, 0.0)}, [3, 7]),
        ({"extension": (math.nan, *EXTENSION[1:3])}, [0, 3, 7]),
        ({"posture_rate": (math.nan, *RATE[1:])}, [7]),
        ({"extension_rate": (math.nan, *EXTENSION_RATE[1:3])}, [4, 7]),
    ],
)
def test_a_passive_leg_that_is_not_known_is_nan_and_the_active_ones_pass(
    completed, change, spoilt
):
    found, good = np.concatenate(completed(**change)), np.concatenate(completed())
    # A rate can be NaN because its extension is; the other active legs are what they were.
    assert np.flatnonzero(np.isnan(found)).tolist() == spoilt
    kept = [i for i in (0, 1, 2, 4, 5, 6) if i not in spoilt]
    np.testing.assert_array_equal(found[kept], good[kept])
