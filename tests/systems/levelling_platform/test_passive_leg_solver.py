import math

import numpy as np
import pytest

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
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND)
EXTENSION_RATE = posture_jacobian(GEOMETRY, POSTURE, GROUND) @ RATE
TRIPLES = pytest.mark.parametrize(
    "active", [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3), (3, 1, 0)]
)


def inputs(active=(0, 1, 2)):
    return {
        "active": EXTENSION[list(active)],
        "active_rate": EXTENSION_RATE[list(active)],
        "posture": POSTURE,
        "posture_rate": RATE,
        "ground": GROUND,
    }


def ports(values):
    """Values of the input ports, of which two hold values and rates in one."""
    return {
        "active_desired_state": np.concatenate([values["active"], values["active_rate"]]),
        "posture_desired_state": np.concatenate([values["posture"], values["posture_rate"]]),
        "ground": values["ground"],
    }


def changed(before, after):
    """The entries of `after` that differ."""
    return {name: after[name] for name in before if not np.array_equal(before[name], after[name])}


def output_of(system, context):
    """Extensions and rates by name."""
    state = system.GetOutputPort("extension_desired_state").Eval(context).copy()
    extension, rate = np.split(state, 2)
    return {"extension": extension, "extension_rate": rate}


def evaluated(system, fix, **changes):
    context = system.CreateDefaultContext()
    fix(system, context, **ports(inputs(system.active_legs) | changes))
    return output_of(system, context)


@TRIPLES
def test_consistent_legs_are_completed_to_inverse_kinematics(fix, active):
    output = evaluated(PassiveLegSolver(GEOMETRY, active), fix)
    np.testing.assert_allclose(output["extension"], EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(output["extension_rate"], EXTENSION_RATE, atol=1e-13)


@TRIPLES
def test_active_legs_pass_unchanged_and_the_passive_one_obeys_equation_31(fix, active):
    drifted = EXTENSION[list(active)] + (0.001, -0.002, 0.0015)
    solver = PassiveLegSolver(GEOMETRY, active)
    extension = evaluated(solver, fix, active=drifted)["extension"]
    np.testing.assert_array_equal(extension[list(active)], drifted)
    (passive,) = set(range(4)) - set(active)
    expected = passive_extension(GEOMETRY, drifted, GROUND, POSTURE[:2], legs=active)
    assert extension[passive] == pytest.approx(expected, abs=1e-14)


def test_height_comes_from_the_first_active_leg(fix):
    solver = PassiveLegSolver(GEOMETRY)
    for i, depends in enumerate((True, False, False)):
        change = EXTENSION[:3].copy()
        change[i] += 0.001
        output = evaluated(solver, fix, active=change)
        assert (output["extension"][3] != pytest.approx(EXTENSION[3], abs=1e-12)) == depends


def test_rates_are_the_derivatives_along_the_motion(fix):
    solver, step = PassiveLegSolver(GEOMETRY), 1e-6
    ahead, behind = (
        evaluated(
            solver,
            fix,
            active=EXTENSION[:3] + t * EXTENSION_RATE[:3],
            posture=POSTURE + t * RATE,
        )["extension"]
        for t in (step, -step)
    )
    rate = evaluated(solver, fix)["extension_rate"]
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_passive_leg_that_cannot_reach_is_nan_and_the_active_ones_pass(fix):
    output = evaluated(PassiveLegSolver(GEOMETRY), fix, posture=(0.0, 0.5, 0.475))
    np.testing.assert_array_equal(output["extension"][:3], EXTENSION[:3])
    assert math.isnan(output["extension"][3])
    assert math.isnan(output["extension_rate"][3])


@pytest.mark.parametrize("name", ["active", "ground", "posture"])
def test_nan_input_gives_nan_for_the_passive_leg(fix, name):
    bad = inputs()[name].copy()
    bad[0] = math.nan
    output = evaluated(PassiveLegSolver(GEOMETRY), fix, **{name: bad})
    assert math.isnan(output["extension"][3])
    assert math.isnan(output["extension_rate"][3])


@pytest.mark.parametrize("name", ["active_rate", "posture_rate"])
def test_nan_rate_gives_nan_for_the_rate_of_the_passive_leg_alone(fix, name):
    bad = inputs()[name].copy()
    bad[0] = math.nan
    output = evaluated(PassiveLegSolver(GEOMETRY), fix, **{name: bad})
    good = evaluated(PassiveLegSolver(GEOMETRY), fix)
    np.testing.assert_array_equal(output["extension"], good["extension"])
    assert math.isnan(output["extension_rate"][3])
    active = bad if name == "active_rate" else EXTENSION_RATE[:3]
    np.testing.assert_array_equal(output["extension_rate"][:3], active)


BOTH = {"extension", "extension_rate"}


@pytest.mark.parametrize(
    ("name", "value", "names"),
    [
        ("active", EXTENSION[:3] + 0.001, BOTH),
        ("active_rate", 2.0 * EXTENSION_RATE[:3], {"extension_rate"}),
        ("posture", POSTURE + 0.001, BOTH),
        ("posture_rate", 2.0 * RATE, {"extension_rate"}),
        ("ground", GROUND + 0.001, BOTH),
    ],
)
def test_each_input_moves_what_depends_on_it(fix, name, value, names):
    solver = PassiveLegSolver(GEOMETRY)
    context = solver.CreateDefaultContext()
    given = ports(inputs())
    fix(solver, context, **given)
    before = output_of(solver, context)
    # The other ports are left alone, so that they do not invalidate anything.
    fix(solver, context, **changed(given, ports(inputs() | {name: value})))
    assert set(changed(before, output_of(solver, context))) == names


def test_desired_height_does_not_matter(fix):
    solver = PassiveLegSolver(GEOMETRY)
    higher = evaluated(solver, fix, posture=np.append(POSTURE[:2], 0.6))
    for name, value in evaluated(solver, fix).items():
        np.testing.assert_array_equal(higher[name], value)


def test_it_completes_what_the_feedforward_gives(fix):
    active = (3, 0, 2)
    feedforward = KinematicFeedforward(GEOMETRY, active_legs=active)
    context = feedforward.CreateDefaultContext()
    given = ports(inputs(active))
    del given["active_desired_state"]
    fix(feedforward, context, **given)
    solver = PassiveLegSolver(GEOMETRY, active)
    solver_context = solver.CreateDefaultContext()
    three = feedforward.GetOutputPort("active_desired_state").Eval(context)
    fix(solver, solver_context, **(given | {"active_desired_state": three}))
    four = output_of(solver, solver_context)
    np.testing.assert_allclose(four["extension"], EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(four["extension_rate"], EXTENSION_RATE, rtol=0, atol=1e-13)


def test_derivatives_agree_with_differences(assert_gradient_agrees, fix):
    def evaluate(system, x):
        context = system.CreateDefaultContext()
        fix(system, context, active_desired_state=x[:6], posture_desired_state=x[6:12])
        fix(system, context, ground=x[12:14])
        return system.GetOutputPort("extension_desired_state").Eval(context)

    x = np.concatenate(list(inputs((3, 1, 0)).values()))
    assert_gradient_agrees(PassiveLegSolver(GEOMETRY, (3, 1, 0)), evaluate, x)


def test_converted_system_keeps_its_settings():
    system = PassiveLegSolver(GEOMETRY, (3, 1, 0)).ToAutoDiffXd()
    assert (system.geometry, system.active_legs) == (GEOMETRY, (3, 1, 0))
