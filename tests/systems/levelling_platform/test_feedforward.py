"""Kinematic feedforward of three legs, and the fourth one that follows from them."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
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
INPUTS = {
    "posture": POSTURE,
    "posture_rate": RATE,
    "ground": GROUND,
    "extension_measured": np.full(4, 0.405),
    "enable": (0.0,),
}
TRIPLES = pytest.mark.parametrize("active", [(0, 1, 2), (0, 1, 3), (3, 2, 1), (2, 0, 3)])


def ports(**inputs):
    """Values of the input ports, posture and rate in one; `INPUTS` where nothing is said."""
    values = INPUTS | inputs
    state = np.concatenate([values.pop("posture"), values.pop("posture_rate")])
    return values | {"posture_desired_state": state}


def output_of(system, context):
    """Extensions and rates by name."""
    state = system.GetOutputPort("active_desired_state").Eval(context).copy()
    extension, rate = np.split(state, 2)
    return {"extension": extension, "extension_rate": rate}


def evaluated(system, fix, **inputs):
    context = system.CreateDefaultContext()
    fix(system, context, **ports(**inputs))
    return output_of(system, context)


def test_extension_on_level_ground_is_that_of_the_table(fix):
    # d = .400: h = .505429 m.
    output = evaluated(
        KinematicFeedforward(),
        fix,
        posture=(0.0, 0.0, 0.505429),
        ground=(0.0, 0.0),
        posture_rate=(0.0, 0.0, 1.0),
    )
    np.testing.assert_allclose(output["extension"], 0.400, atol=1e-7)
    # dp_z/dd = -6.047 there.
    np.testing.assert_allclose(output["extension_rate"], -1.0 / 6.047, rtol=1e-4)


@TRIPLES
def test_exact_law_is_inverse_kinematics_and_its_jacobian(fix, active):
    output = evaluated(KinematicFeedforward(GEOMETRY, active_legs=active), fix)
    extension = inverse_kinematics(GEOMETRY, POSTURE, GROUND)[list(active)]
    jacobian = posture_jacobian(GEOMETRY, POSTURE, GROUND)[list(active)]
    np.testing.assert_allclose(output["extension"], extension, rtol=0, atol=1e-14)
    np.testing.assert_allclose(output["extension_rate"], jacobian @ RATE, atol=1e-14)


def test_rate_is_the_derivative_of_the_extension_along_the_motion(fix):
    system, step = KinematicFeedforward(GEOMETRY), 1e-6
    ahead, behind = (
        evaluated(system, fix, posture=POSTURE + t * RATE)["extension"] for t in (step, -step)
    )
    rate = evaluated(system, fix)["extension_rate"]
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_leg_that_cannot_reach_is_nan_and_the_others_are_not_clamped(fix):
    output = evaluated(KinematicFeedforward(GEOMETRY), fix, posture=(0.0, 0.75, 0.477))
    extension = output["extension"]
    bad = np.isnan(extension)
    assert bad.any()
    assert not bad.all()
    assert np.isnan(output["extension_rate"][bad]).all()
    assert ((extension[~bad] < 0.390) | (extension[~bad] > 0.420)).all()


@pytest.mark.parametrize("name", ["posture", "posture_rate", "ground"])
def test_nan_input_gives_nan(fix, name):
    system = KinematicFeedforward(GEOMETRY)
    bad = np.array(INPUTS[name], dtype=float)
    bad[0] = math.nan
    output = evaluated(system, fix, **{name: bad})
    assert np.isnan(output["extension_rate"]).all()
    if name == "posture_rate":
        good = evaluated(system, fix)
        np.testing.assert_array_equal(output["extension"], good["extension"])
    else:
        assert np.isnan(output["extension"]).all()


def test_unknown_law_is_refused():
    with pytest.raises(ValueError, match="law"):
        KinematicFeedforward(GEOMETRY, law="newton")


# The differential law


def driven(law, period):
    """The feedforward along a smooth motion of 2 s, started from consistent extensions."""
    times = [0.0, 0.7, 1.4, 2.0]
    knots = np.array(
        [(0.0, 0.0, 0.45), (0.02, -0.02, 0.47), (-0.01, 0.03, 0.48), (0.02, 0.01, 0.46)]
    ).T
    motion = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        times, knots, np.zeros(3), np.zeros(3)
    )
    start = inverse_kinematics(GEOMETRY, knots[:, 0], GROUND)
    builder = DiagramBuilder()
    system = builder.AddSystem(KinematicFeedforward(GEOMETRY, law=law, period=period))
    for name, source in (
        # Drake puts the values first, then their derivatives.
        ("posture_desired_state", TrajectorySource(motion, output_derivative_order=1)),
        ("ground", ConstantVectorSource(GROUND)),
        ("extension_measured", ConstantVectorSource(start)),
        ("enable", ConstantVectorSource([1.0])),
    ):
        builder.AddNamedSystem(name, source)
        builder.Connect(source.get_output_port(0), system.GetInputPort(name))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    worst, context = 0.0, simulator.get_mutable_context()
    for t in np.linspace(0.2, 2.0, 19).tolist():
        # An update at t counts once the simulation goes on from there.
        simulator.AdvanceTo(t + 1e-6)
        own = system.GetMyContextFromRoot(context)
        extension = output_of(system, own)["extension"]
        elapsed = period * (math.floor(t / period + 1e-9) + 1.0) if law == "differential" else t
        posture = motion.value(min(elapsed, 2.0)).flatten()
        exact = inverse_kinematics(GEOMETRY, posture, GROUND)[:3]
        worst = max(worst, np.abs(extension - exact).max())
    return worst


def test_error_of_the_differential_law_falls_with_the_period():
    errors = [driven("differential", period) for period in (0.02, 0.01, 0.005)]
    assert 1e-6 < errors[-1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.15)


def test_exact_law_does_not_drift():
    assert driven("exact", 0.01) < 1e-6


@TRIPLES
def test_differential_law_starts_from_the_measured_extensions(fix, active):
    system = KinematicFeedforward(GEOMETRY, law="differential", active_legs=active, period=0.01)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    measured = np.array((0.400, 0.403, 0.406, 0.409))
    fix(system, context, **ports(extension_measured=measured))

    def extension():
        return output_of(system, context)["extension"]

    np.testing.assert_array_equal(extension(), measured[list(active)])
    simulator.AdvanceTo(0.055)
    np.testing.assert_array_equal(extension(), measured[list(active)])
    fix(system, context, extension_measured=measured + 0.001)
    np.testing.assert_array_equal(extension(), measured[list(active)] + 0.001)


def test_differential_law_integrates_while_enabled_and_starts_anew_after(fix):
    system = KinematicFeedforward(GEOMETRY, law="differential", period=0.01)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, **ports(enable=(1.0,)))

    def extension():
        return output_of(system, context)["extension"]

    rate = output_of(system, context)["extension_rate"]
    simulator.AdvanceTo(0.005)
    np.testing.assert_allclose(extension(), 0.405 + 0.01 * rate, rtol=0, atol=1e-15)
    # Once it integrates, measurements no longer count.
    fix(system, context, extension_measured=np.full(4, 0.39))
    simulator.AdvanceTo(0.5)
    assert (np.abs(extension() - 0.39) > 1e-4).all()
    fix(system, context, enable=(0.0,))
    simulator.AdvanceTo(0.525)
    np.testing.assert_allclose(extension(), 0.39, rtol=0, atol=1e-15)


def test_differential_law_at_rest_stays(fix):
    system = KinematicFeedforward(GEOMETRY, law="differential")
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, **ports(enable=(1.0,), posture_rate=np.zeros(3)))
    simulator.AdvanceTo(1.0)
    extension = output_of(system, context)["extension"]
    np.testing.assert_array_equal(extension, np.full(3, 0.405))


EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND)
EXTENSION_RATE = posture_jacobian(GEOMETRY, POSTURE, GROUND) @ RATE
SOLVED_TRIPLES = pytest.mark.parametrize(
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


def ports_of(values):
    """Values of the input ports_of, of which two hold values and rates in one."""
    return {
        "active_desired_state": np.concatenate([values["active"], values["active_rate"]]),
        "posture_desired_state": np.concatenate([values["posture"], values["posture_rate"]]),
        "ground": values["ground"],
    }


def legs_of(system, context):
    """Extensions and rates by name."""
    state = system.GetOutputPort("extension_desired_state").Eval(context).copy()
    extension, rate = np.split(state, 2)
    return {"extension": extension, "extension_rate": rate}


def completed(system, fix, **changes):
    context = system.CreateDefaultContext()
    fix(system, context, **ports_of(inputs(system.active_legs) | changes))
    return legs_of(system, context)


@SOLVED_TRIPLES
def test_consistent_legs_are_completed_to_inverse_kinematics(fix, active):
    output = completed(PassiveLegSolver(GEOMETRY, active), fix)
    np.testing.assert_allclose(output["extension"], EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(output["extension_rate"], EXTENSION_RATE, atol=1e-13)


@SOLVED_TRIPLES
def test_active_legs_pass_unchanged_and_the_passive_one_obeys_equation_31(fix, active):
    drifted = EXTENSION[list(active)] + (0.001, -0.002, 0.0015)
    solver = PassiveLegSolver(GEOMETRY, active)
    extension = completed(solver, fix, active=drifted)["extension"]
    np.testing.assert_array_equal(extension[list(active)], drifted)
    (passive,) = set(range(4)) - set(active)
    expected = passive_extension(GEOMETRY, drifted, GROUND, POSTURE[:2], legs=active)
    assert extension[passive] == pytest.approx(expected, abs=1e-14)


def test_height_comes_from_the_first_active_leg(fix):
    solver = PassiveLegSolver(GEOMETRY)
    for i, depends in enumerate((True, False, False)):
        change = EXTENSION[:3].copy()
        change[i] += 0.001
        output = completed(solver, fix, active=change)
        assert (output["extension"][3] != pytest.approx(EXTENSION[3], abs=1e-12)) == depends


def test_rates_are_the_derivatives_along_the_motion(fix):
    solver, step = PassiveLegSolver(GEOMETRY), 1e-6
    ahead, behind = (
        completed(
            solver,
            fix,
            active=EXTENSION[:3] + t * EXTENSION_RATE[:3],
            posture=POSTURE + t * RATE,
        )["extension"]
        for t in (step, -step)
    )
    rate = completed(solver, fix)["extension_rate"]
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_passive_leg_that_cannot_reach_is_nan_and_the_active_ones_pass(fix):
    output = completed(PassiveLegSolver(GEOMETRY), fix, posture=(0.0, 0.5, 0.475))
    np.testing.assert_array_equal(output["extension"][:3], EXTENSION[:3])
    assert math.isnan(output["extension"][3])
    assert math.isnan(output["extension_rate"][3])


@pytest.mark.parametrize("name", ["active", "ground", "posture"])
def test_nan_input_gives_nan_for_the_passive_leg(fix, name):
    bad = inputs()[name].copy()
    bad[0] = math.nan
    output = completed(PassiveLegSolver(GEOMETRY), fix, **{name: bad})
    assert math.isnan(output["extension"][3])
    assert math.isnan(output["extension_rate"][3])


@pytest.mark.parametrize("name", ["active_rate", "posture_rate"])
def test_nan_rate_gives_nan_for_the_rate_of_the_passive_leg_alone(fix, name):
    bad = inputs()[name].copy()
    bad[0] = math.nan
    output = completed(PassiveLegSolver(GEOMETRY), fix, **{name: bad})
    good = completed(PassiveLegSolver(GEOMETRY), fix)
    np.testing.assert_array_equal(output["extension"], good["extension"])
    assert math.isnan(output["extension_rate"][3])
    active = bad if name == "active_rate" else EXTENSION_RATE[:3]
    np.testing.assert_array_equal(output["extension_rate"][:3], active)


def test_desired_height_does_not_matter(fix):
    solver = PassiveLegSolver(GEOMETRY)
    higher = completed(solver, fix, posture=np.append(POSTURE[:2], 0.6))
    for name, value in completed(solver, fix).items():
        np.testing.assert_array_equal(higher[name], value)


def test_it_completes_what_the_feedforward_gives(fix):
    active = (3, 0, 2)
    feedforward = KinematicFeedforward(GEOMETRY, active_legs=active)
    context = feedforward.CreateDefaultContext()
    given = ports_of(inputs(active))
    del given["active_desired_state"]
    fix(feedforward, context, **given)
    solver = PassiveLegSolver(GEOMETRY, active)
    solver_context = solver.CreateDefaultContext()
    three = feedforward.GetOutputPort("active_desired_state").Eval(context)
    fix(solver, solver_context, **(given | {"active_desired_state": three}))
    four = legs_of(solver, solver_context)
    np.testing.assert_allclose(four["extension"], EXTENSION, rtol=0, atol=1e-13)
    np.testing.assert_allclose(four["extension_rate"], EXTENSION_RATE, rtol=0, atol=1e-13)
