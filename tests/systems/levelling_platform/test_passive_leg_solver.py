import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematic_feedforward import KinematicFeedforward
from parapod.systems.levelling_platform.kinematics import (
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)
from parapod.systems.levelling_platform.passive_leg_solver import PassiveLegSolver

GEOMETRY = PlatformGeometry(foot_radius=0.025)
POSTURE = np.array((0.01, -0.02, 0.475))
RATE = np.array((0.02, 0.01, 0.005))
GROUND = np.array((0.02, -0.03))
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND)
EXTENSION_RATE = posture_jacobian(GEOMETRY, POSTURE, GROUND) @ RATE
TRIPLES = pytest.mark.parametrize(
    "active", [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3), (3, 1, 0)]
)


def inputs(active=(0, 1, 2)):
    return {
        "extension_active": EXTENSION[list(active)],
        "extension_rate_active": EXTENSION_RATE[list(active)],
        "posture_desired": POSTURE,
        "posture_rate_desired": RATE,
        "ground": GROUND,
    }


def evaluated(system, fix, read, **changes):
    context = system.CreateDefaultContext()
    fix(system, context, **(inputs(system.active_legs) | changes))
    return read(system, context)


@TRIPLES
def test_consistent_legs_are_completed_to_inverse_kinematics(fix, read, active):
    output = evaluated(PassiveLegSolver(GEOMETRY, active), fix, read)
    np.testing.assert_allclose(output["extension_desired"], EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(output["extension_rate_desired"], EXTENSION_RATE, atol=1e-13)


@TRIPLES
def test_active_legs_pass_unchanged_and_the_passive_one_obeys_equation_31(fix, read, active):
    drifted = EXTENSION[list(active)] + (0.001, -0.002, 0.0015)
    solver = PassiveLegSolver(GEOMETRY, active)
    extension = evaluated(solver, fix, read, extension_active=drifted)["extension_desired"]
    np.testing.assert_array_equal(extension[list(active)], drifted)
    (passive,) = set(range(4)) - set(active)
    expected = passive_extension(GEOMETRY, drifted, GROUND, POSTURE[:2], legs=active)
    assert extension[passive] == pytest.approx(expected, abs=1e-14)


def test_height_comes_from_the_first_active_leg(fix, read):
    solver = PassiveLegSolver(GEOMETRY)
    for i, depends in enumerate((True, False, False)):
        change = EXTENSION[:3].copy()
        change[i] += 0.001
        output = evaluated(solver, fix, read, extension_active=change)
        assert (output["extension_desired"][3] != pytest.approx(EXTENSION[3], abs=1e-12)) == (
            depends
        )


def test_rates_are_the_derivatives_along_the_motion(fix, read):
    solver, step = PassiveLegSolver(GEOMETRY), 1e-6
    ahead, behind = (
        evaluated(
            solver,
            fix,
            read,
            extension_active=EXTENSION[:3] + t * EXTENSION_RATE[:3],
            posture_desired=POSTURE + t * RATE,
        )["extension_desired"]
        for t in (step, -step)
    )
    rate = evaluated(solver, fix, read)["extension_rate_desired"]
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_passive_leg_that_cannot_reach_is_nan_and_the_active_ones_pass(fix, read):
    output = evaluated(PassiveLegSolver(GEOMETRY), fix, read, posture_desired=(0.0, 0.5, 0.475))
    np.testing.assert_array_equal(output["extension_desired"][:3], EXTENSION[:3])
    assert math.isnan(output["extension_desired"][3])
    assert math.isnan(output["extension_rate_desired"][3])


@pytest.mark.parametrize("name", ["extension_active", "ground", "posture_desired"])
def test_nan_input_gives_nan_for_the_passive_leg(fix, read, name):
    bad = inputs()[name].copy()
    bad[0] = math.nan
    output = evaluated(PassiveLegSolver(GEOMETRY), fix, read, **{name: bad})
    assert math.isnan(output["extension_desired"][3])


BOTH = {"extension_desired", "extension_rate_desired"}


@pytest.mark.parametrize(
    ("name", "value", "names"),
    [
        ("extension_active", EXTENSION[:3] + 0.001, BOTH),
        ("extension_rate_active", 2.0 * EXTENSION_RATE[:3], {"extension_rate_desired"}),
        ("posture_desired", POSTURE + 0.001, BOTH),
        ("posture_rate_desired", 2.0 * RATE, {"extension_rate_desired"}),
        ("ground", GROUND + 0.001, BOTH),
    ],
)
def test_each_input_moves_what_depends_on_it(fix, moved, name, value, names):
    solver = PassiveLegSolver(GEOMETRY)
    context = solver.CreateDefaultContext()
    fix(solver, context, **inputs())
    assert moved(solver, context, lambda: fix(solver, context, **{name: value})) == names


def test_desired_height_does_not_matter(fix, read):
    solver = PassiveLegSolver(GEOMETRY)
    higher = evaluated(solver, fix, read, posture_desired=np.append(POSTURE[:2], 0.6))
    for name, value in evaluated(solver, fix, read).items():
        np.testing.assert_array_equal(higher[name], value)


def test_it_completes_what_the_feedforward_gives(fix, read):
    active = (3, 0, 2)
    feedforward = KinematicFeedforward(GEOMETRY, active_legs=active)
    context = feedforward.CreateDefaultContext()
    fix(feedforward, context, posture_desired=POSTURE, posture_rate_desired=RATE, ground=GROUND)
    three = read(feedforward, context)
    four = evaluated(
        PassiveLegSolver(GEOMETRY, active),
        fix,
        read,
        extension_active=three["extension_desired"],
        extension_rate_active=three["extension_rate_desired"],
    )
    np.testing.assert_allclose(four["extension_desired"], EXTENSION, rtol=0, atol=1e-13)


def test_derivatives_agree_with_differences(assert_gradient_agrees, fix):
    def evaluate(system, x):
        context = system.CreateDefaultContext()
        fix(system, context, extension_active=x[:3], extension_rate_active=x[3:6])
        fix(system, context, posture_desired=x[6:9], posture_rate_desired=x[9:12])
        fix(system, context, ground=x[12:14])
        ports = ("extension_desired", "extension_rate_desired")
        return np.concatenate([system.GetOutputPort(name).Eval(context) for name in ports])

    x = np.concatenate(list(inputs((3, 1, 0)).values()))
    assert_gradient_agrees(PassiveLegSolver(GEOMETRY, (3, 1, 0)), evaluate, x)


def test_converted_system_keeps_its_settings():
    system = PassiveLegSolver(GEOMETRY, (3, 1, 0)).ToAutoDiffXd()
    assert (system.geometry, system.active_legs) == (GEOMETRY, (3, 1, 0))
