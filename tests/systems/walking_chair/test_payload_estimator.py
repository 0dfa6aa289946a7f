import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import (
    GRAVITY,
    ChairMasses,
    Passenger,
    centre_of_mass,
)
from parapod.systems.walking_chair.payload import (
    PayloadEstimator,
    PayloadEstimatorParams,
)
from parapod.systems.walking_chair.statics import force_map, rest

GEOMETRY, MASSES = ChairGeometry(), ChairMasses()
PARAMS = PayloadEstimatorParams()


def measured(passenger, time):
    """Lengths and currents of a chair at rest at a time of the gait."""
    motion = gait_motion(GEOMETRY, TrotGait(), time)
    body = motion.body.position
    lengths = chair_inverse(GEOMETRY, body, np.eye(3), motion.feet.position, motion.references)
    corners = foot_corners(GEOMETRY, np.zeros(3), np.eye(3), lengths)
    mass, centre = centre_of_mass(MASSES, passenger, corners.mean(axis=-2))
    found = rest(
        corners.reshape(12, 3),
        force_map(GEOMETRY, lengths)[..., 2],
        mass * GRAVITY,
        centre,
        MASSES.foot_end * GRAVITY,
    )
    return lengths.ravel(), found.branch_forces / PARAMS.force_per_current


def estimate(fix, position, current, until=0.01, system=None):
    system = system or PayloadEstimator()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, position=position, current=current)
    simulator.AdvanceTo(until)
    return system.get_output_port().Eval(context).copy()


def test_the_constant_is_the_largest_thrust_at_the_rated_current():
    assert 3.0 * PARAMS.force_per_current == pytest.approx(427.3)


@pytest.mark.parametrize("time", [0.0, 2.5, 7.5, 12.5, 17.5])
@pytest.mark.parametrize("passenger", [Passenger(57.0), Passenger(80.0, 0.03, -0.02)])
def test_mass_and_place_are_found_in_every_phase(fix, time, passenger):
    found = estimate(fix, *measured(passenger, time))
    expected = (passenger.mass, passenger.x, passenger.y)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_an_empty_chair_has_no_payload_and_no_place(fix):
    found = estimate(fix, *measured(Passenger(0.0), 2.5))
    np.testing.assert_allclose(found, 0.0, atol=1e-6)


def test_friction_between_the_feet_leaves_the_mass_alone(fix):
    position, current = measured(Passenger(57.0), 2.5)
    horizontal = np.zeros((12, 3))
    horizontal[0, 0], horizontal[3, 0] = 30.0, -30.0  # feet 1 and 2 pull at each other
    horizontal[0, 1], horizontal[9, 1] = -20.0, 20.0
    force = np.einsum("bca,ca->b", force_map(GEOMETRY, position.reshape(4, 3)), horizontal)
    found = estimate(fix, position, current + force / PARAMS.force_per_current)
    assert found[0] == pytest.approx(57.0, abs=1e-3)
    assert np.hypot(*found[1:]) < 0.02


def test_the_estimate_is_filtered(fix):
    position, current = measured(Passenger(57.0), 2.5)
    lighter = measured(Passenger(20.0), 2.5)[1]
    system = PayloadEstimator(period=0.1)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, position=position, current=current)
    simulator.AdvanceTo(0.05)
    fix(system, context, current=lighter)
    simulator.AdvanceTo(0.55)
    share = math.exp(-0.5 / PARAMS.time_constant)
    found = system.get_output_port().Eval(context)
    assert found[0] == pytest.approx(20.0 + 37.0 * share, abs=1e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["position", "current"])
def test_a_sample_that_is_not_finite_is_left_out(fix, name, bad):
    values = dict(zip(("position", "current"), measured(Passenger(57.0), 2.5), strict=True))
    system = PayloadEstimator(period=0.1)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, **values)
    simulator.AdvanceTo(0.05)
    spoilt = values[name].copy()
    spoilt[3] = bad
    fix(system, context, **{name: spoilt})
    simulator.AdvanceTo(1.0)
    assert system.get_output_port().Eval(context)[0] == pytest.approx(57.0, abs=1e-3)


def test_currents_before_the_first_measurement_are_left_out(fix):
    position, current = measured(Passenger(57.0), 2.5)
    system = PayloadEstimator(period=0.1)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, position=position, current=np.zeros(12))
    simulator.AdvanceTo(0.35)
    fix(system, context, current=current)
    simulator.AdvanceTo(0.45)
    # The first sample that tells anything is taken as it is.
    assert system.get_output_port().Eval(context)[0] == pytest.approx(57.0, abs=1e-3)
