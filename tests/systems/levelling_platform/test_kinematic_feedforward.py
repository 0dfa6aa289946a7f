import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from parapod.systems.levelling_platform.feedforward import KinematicFeedforward
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
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


def changed(before, after):
    """The entries of `after` that differ."""
    return {name: after[name] for name in before if not np.array_equal(before[name], after[name])}


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


BOTH = {"extension", "extension_rate"}


@pytest.mark.parametrize(
    ("law", "name", "value", "names"),
    [
        ("exact", "posture", POSTURE + 0.001, BOTH),
        ("exact", "posture_rate", 2.0 * RATE, {"extension_rate"}),
        ("exact", "ground", GROUND + 0.001, BOTH),
        ("exact", "extension_measured", np.full(4, 0.41), set()),
        ("exact", "enable", (1.0,), set()),
        ("differential", "posture", POSTURE + 0.001, {"extension_rate"}),
        ("differential", "posture_rate", 2.0 * RATE, {"extension_rate"}),
        ("differential", "ground", GROUND + 0.001, {"extension_rate"}),
        ("differential", "extension_measured", np.full(4, 0.41), BOTH),
        ("differential", "enable", (1.0,), set()),
    ],
)
def test_each_input_moves_what_depends_on_it(fix, law, name, value, names):
    system = KinematicFeedforward(GEOMETRY, law=law)
    context = system.CreateDefaultContext()
    fix(system, context, **ports())
    before = output_of(system, context)
    # The other ports are left alone, so that they do not invalidate anything.
    fix(system, context, **changed(ports(), ports(**{name: value})))
    assert set(changed(before, output_of(system, context))) == names


def test_exact_law_has_no_state():
    assert KinematicFeedforward(GEOMETRY).CreateDefaultContext().is_stateless()


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


# Scalar types


@pytest.mark.parametrize("law", ["exact", "differential"])
def test_derivatives_agree_with_differences(assert_gradient_agrees, fix, law):
    def evaluate(system, x):
        context = system.CreateDefaultContext()
        fix(system, context, posture_desired_state=x[:6], ground=x[6:8])
        fix(system, context, extension_measured=x[8:12], enable=0.0 * x[:1])
        return system.GetOutputPort("active_desired_state").Eval(context)

    x = np.concatenate([POSTURE, RATE, GROUND, (0.401, 0.404, 0.407, 0.41)])
    system = KinematicFeedforward(GEOMETRY, law=law, active_legs=(1, 2, 3))
    assert_gradient_agrees(system, evaluate, x)


def test_derivatives_of_the_differential_laws_update_agree_with_differences(
    assert_gradient_agrees, fix
):
    def update(system, x):
        context = system.CreateDefaultContext()
        fix(system, context, posture_desired_state=x[:6], ground=x[6:8])
        fix(system, context, extension_measured=x[8:12], enable=0.0 * x[:1] + 1.0)
        state = system.EvalUniquePeriodicDiscreteUpdate(context)
        return np.asarray(state.value(0)).flatten()

    x = np.concatenate([POSTURE, RATE, GROUND, (0.401, 0.404, 0.407, 0.41)])
    system = KinematicFeedforward(GEOMETRY, law="differential", period=0.5)
    assert_gradient_agrees(system, update, x)


def test_converted_system_keeps_its_settings():
    system = KinematicFeedforward(GEOMETRY, "differential", (3, 1, 0), 0.004).ToAutoDiffXd()
    assert system.geometry == GEOMETRY
    assert (system.law, system.active_legs, system.period) == ("differential", (3, 1, 0), 0.004)


def test_posture_comes_back_from_forward_kinematics(fix):
    output = evaluated(KinematicFeedforward(GEOMETRY), fix)
    extension = np.append(output["extension"], 0.4)
    posture = forward_kinematics(GEOMETRY, extension, GROUND, legs=(0, 1, 2))
    np.testing.assert_allclose(posture, POSTURE, rtol=0, atol=1e-13)
