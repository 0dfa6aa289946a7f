"""The largest payload, and its estimate from currents."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass
from parapod.systems.walking_chair.payload import (
    FORCE_LIMIT,
    PayloadEstimator,
    PayloadEstimatorParams,
    Stand,
    elastic_forces,
    largest_payload,
    least_branch_force,
    unexplained_forces,
)
from parapod.systems.walking_chair.statics import force_map, rest

CHAIR, GAIT, MASS = ChairGeometry(), TrotGait(), ChairMasses().total
FOUR, TWO, SHIFT = 2.5, 7.5, 12.5
ONLY_E1 = np.arange(12) % 3 == 0


def stand_at(time, place=(0.0, 0.0)):
    motion, lengths = gait_motion(CHAIR, GAIT, time), gait_branches(CHAIR, GAIT, time).length
    corners = foot_corners(CHAIR, motion.body.position, np.eye(3), lengths)
    touching = (corners[..., 2] < 1e-6) & motion.support[:, None]
    from_body = (corners - motion.body.position).reshape(12, 3)
    return Stand(force_map(CHAIR, lengths), from_body, touching.ravel(), MASS, place)


def wrench_of(stand, forces):
    moments = np.cross(stand.corners, forces)
    return np.concatenate((forces.sum(axis=0), moments.sum(axis=0)))


def weight_of(mass, place=(0.0, 0.0)):
    x, y = place
    upwards = GRAVITY * np.array((0.0, 0.0, MASS + mass, mass * y, -mass * x, 0.0))
    return upwards


@pytest.mark.parametrize(
    ("time", "friction", "kilograms"),
    [
        (TWO, 0.0, 168.588),
        (TWO, 0.6, 210.963),
        (FOUR, 0.0, 386.376),
        (FOUR, 0.6, 470.678),
        (SHIFT, 0.0, 200.9),
        (SHIFT, 0.6, 470.6),
    ],
)
def test_largest_payloads(time, friction, kilograms):
    found = largest_payload(stand_at(time), friction)
    assert found.mass == pytest.approx(kilograms, abs=0.1)
    assert np.abs(found.branch_forces).max() == pytest.approx(FORCE_LIMIT)


def test_payload_on_the_up_branches_alone_is_the_closed_form():
    for time, legs, kilograms in ((TWO, 2, 37.92), (FOUR, 4, 125.03)):
        stand = stand_at(time)
        found = largest_payload(stand._replace(touching=stand.touching & ONLY_E1))
        assert found.mass == pytest.approx(kilograms, abs=0.1)
        assert found.mass == pytest.approx(legs * FORCE_LIMIT / GRAVITY - MASS, abs=1e-6)
        ups = found.branch_forces.reshape(4, 3)[stand.touching.reshape(4, 3).any(axis=1)]
        np.testing.assert_allclose(ups, [(FORCE_LIMIT, 0.0, 0.0)] * legs, atol=1e-6)


def test_share_with_which_the_papers_payload_reaches_the_thrust():
    share = 2.0 * FORCE_LIMIT / (GRAVITY * (MASS + 57.0))
    assert share == pytest.approx(0.8203, abs=1e-4)
    # Contact 31.1 mm behind E1 gives the UP branches that share.
    stand = stand_at(TWO)
    behind = (1.0 - share) * 0.1732 / (0.120 * np.cos(np.pi / 6.0))
    forces = np.zeros((12, 3))
    load = 0.5 * GRAVITY * (MASS + 57.0)
    for leg in (1, 3):
        forces[3 * leg : 3 * leg + 3, 2] = load * np.array((1.0 - behind, behind / 2, behind / 2))
    branches = np.einsum("bca,ca->b", stand.force_map, forces)
    assert branches.max() == pytest.approx(FORCE_LIMIT, rel=1e-3)


@pytest.mark.parametrize("solve", ["largest", "least", "elastic"])
@pytest.mark.parametrize("friction", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("time", [FOUR, TWO, 10.3, SHIFT])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.03, -0.02)])
def test_forces_balance_the_weight_and_stay_within_their_cones(solve, friction, time, place):
    stand = stand_at(time, place)
    found = {
        "largest": lambda: largest_payload(stand, friction),
        "least": lambda: least_branch_force(stand, 57.0, friction),
        "elastic": lambda: elastic_forces(stand, 57.0, friction),
    }[solve]()
    wanted = weight_of(found.mass, place)
    np.testing.assert_allclose(wrench_of(stand, found.forces), wanted, atol=1e-3)
    np.testing.assert_allclose(stand.wrench(found.mass), wanted, atol=1e-9)
    x, y, z = found.forces.T
    assert (z >= -1e-9).all()
    assert (np.hypot(x, y) <= friction * z + 1e-6).all()
    assert not found.forces[~stand.touching].any()
    branches = np.einsum("bca,ca->b", stand.force_map, found.forces)
    np.testing.assert_allclose(found.branch_forces, branches, atol=1e-9)


@pytest.mark.parametrize(
    ("friction", "newtons"), [(0.0, 208.4), (0.6, 174.4)], ids=["frictionless", "friction"]
)
def test_smallest_largest_force_under_57_kg(friction, newtons):
    found = least_branch_force(stand_at(TWO), 57.0, friction)
    assert np.abs(found.branch_forces).max() == pytest.approx(newtons, abs=0.05)


@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("time", [FOUR, TWO, 10.5])
def test_the_largest_payload_needs_the_whole_thrust_and_a_smaller_one_less(friction, time):
    stand = stand_at(time)
    largest = largest_payload(stand, friction).mass
    at_limit = least_branch_force(stand, largest, friction)
    assert np.abs(at_limit.branch_forces).max() == pytest.approx(FORCE_LIMIT, rel=1e-6)
    below = least_branch_force(stand, 0.9 * largest, friction)
    assert np.abs(below.branch_forces).max() < FORCE_LIMIT


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_no_other_distribution_needs_less_than_the_least(friction):
    stand = stand_at(TWO)
    least = np.abs(least_branch_force(stand, 57.0, friction).branch_forces).max()
    for ups_stiffness in (0.1, 0.5, 1.0, 2.0):
        other = elastic_forces(stand, 57.0, friction, ups_stiffness)
        assert np.abs(other.branch_forces).max() >= least - 1e-6


def test_payload_goes_with_the_thrust():
    stand = stand_at(TWO)
    single, double = (largest_payload(stand, 0.6, limit).mass for limit in (300.0, 600.0))
    assert double + MASS == pytest.approx(2.0 * (single + MASS))


def test_friction_never_harms():
    for time in (FOUR, TWO, SHIFT):
        masses = [largest_payload(stand_at(time), mu).mass for mu in (0.0, 0.1, 0.3, 0.6, 1.0)]
        assert (np.diff(masses) >= -1e-9).all()


def test_symmetric_legs_bear_symmetric_forces():
    # The payload in the middle: legs 1 and 3, 2 and 4 are each other turned, 2 and 3 mirrored.
    for friction in (0.0, 0.6):
        forces = elastic_forces(stand_at(FOUR), 57.0, friction).branch_forces.reshape(4, 3)
        np.testing.assert_allclose(forces, forces[[2, 3, 0, 1]], atol=1e-4)
        np.testing.assert_allclose(forces, forces[[1, 0, 3, 2]], atol=1e-4)
        np.testing.assert_allclose(forces[:, 1], forces[:, 2], atol=1e-4)
        two = elastic_forces(stand_at(TWO), 57.0, friction).branch_forces.reshape(4, 3)
        np.testing.assert_allclose(two[1], two[3], atol=1e-4)
        np.testing.assert_allclose(two[[0, 2]], 0.0, atol=1e-9)


def test_elastic_branches_share_a_leg_s_load_by_their_stiffness():
    stand = stand_at(TWO)
    up, ups, _ = gait_branches(CHAIR, GAIT, TWO).length[1]
    n_z = (up + CHAIR.leg.x2 - CHAIR.leg.x3) / ups
    load = 0.5 * GRAVITY * (MASS + 57.0)
    for ups_stiffness in (0.05, 0.111, 0.25, 0.5, 1.0):
        forces = elastic_forces(stand, 57.0, 1.0, ups_stiffness).branch_forces
        share = 1.0 / (1.0 + 2.0 * ups_stiffness * n_z**2)
        assert forces.max() / load == pytest.approx(share, abs=1e-3)
    assert elastic_forces(stand, 57.0, 1.0, 0.111).branch_forces.max() == pytest.approx(
        427.3, abs=0.1
    )


def test_elastic_forces_store_the_least_energy():
    stand = stand_at(10.5)
    for friction, ups_stiffness in ((0.0, 1.0), (0.6, 1.0), (0.6, 0.3)):
        stiffness = np.tile((1.0, ups_stiffness, ups_stiffness), 4)

        def energy(forces, stiffness=stiffness):
            return (forces**2 / stiffness).sum()

        least = energy(elastic_forces(stand, 57.0, friction, ups_stiffness).branch_forces)
        for other in (
            least_branch_force(stand, 57.0, friction).branch_forces,
            elastic_forces(stand, 57.0, friction, 2.0 * ups_stiffness).branch_forces,
        ):
            assert energy(other) > least


@pytest.mark.parametrize("time", [FOUR, TWO, SHIFT])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_forces_that_the_ground_can_make_leave_nothing_unexplained(time, friction):
    stand = stand_at(time, (0.02, -0.01))
    forces = elastic_forces(stand, 57.0, friction).branch_forces
    np.testing.assert_allclose(unexplained_forces(stand, 57.0, forces), 0.0, atol=1e-3)


def test_a_foot_hangs_on_its_branches_with_its_own_weight():
    stand, weight = stand_at(TWO), 19.62
    own = stand.force_map[..., 2] @ np.full(12, weight / 3.0)
    forces = elastic_forces(stand, 57.0).branch_forces - own
    np.testing.assert_allclose(unexplained_forces(stand, 57.0, forces, weight), 0.0, atol=1e-3)


def test_a_force_on_a_foot_in_the_air_is_unexplained_as_a_whole():
    stand = stand_at(TWO)  # on legs 2 and 4
    forces = elastic_forces(stand, 57.0).branch_forces
    for branch in (0, 1, 8):
        held = forces + 100.0 * (np.arange(12) == branch)
        expected = 100.0 * (np.arange(12) == branch)
        np.testing.assert_allclose(unexplained_forces(stand, 57.0, held), expected, atol=1e-3)


def test_a_branch_that_carries_nothing_lacks_a_force_that_must_be_there():
    stand = stand_at(TWO)
    forces = elastic_forces(stand, 57.0).branch_forces
    forces[3] = 0.0  # branch 21
    off = unexplained_forces(stand, 57.0, forces)
    assert off[3] == off.min() < -40.0
    assert np.abs(off).argmax() == 3


def test_no_ground_explains_forces_of_a_chair_without_contacts():
    stand = stand_at(TWO)._replace(touching=np.zeros(12, bool))
    np.testing.assert_allclose(unexplained_forces(stand, 57.0, np.arange(12.0)), np.arange(12.0))


def test_payload_aside_is_smaller_and_out_of_the_polygon_impossible():
    masses = [largest_payload(stand_at(TWO, (x, 0.0)), 0.6).mass for x in (0.0, 0.05, 0.1, 0.2)]
    assert (np.diff(masses) < 0.0).all()
    # The chair's own weight holds a small payload beyond the edge.
    outside = largest_payload(stand_at(TWO, (0.5, 0.0)), 0.6).mass
    edge = 0.05705 / 0.7437
    assert outside == pytest.approx(MASS * edge / (0.5 - edge), rel=1e-3)


@pytest.mark.parametrize("corners", [[], [3]], ids=["none", "one"])
def test_without_enough_contacts_nothing_is_carried(corners):
    stand = stand_at(TWO)._replace(touching=np.isin(np.arange(12), corners))
    for found in (
        largest_payload(stand),
        least_branch_force(stand, 57.0),
        elastic_forces(stand, 57.0),
    ):
        assert found.mass == -np.inf
        assert np.isnan(found.forces).all()
        assert np.isnan(found.branch_forces).all()


def test_a_payload_beside_the_line_between_two_contacts_is_not_carried():
    # The chair itself is balanced on two opposite corners.
    stand = stand_at(TWO, (0.05, 0.1))._replace(touching=np.isin(np.arange(12), (3, 9)))
    assert largest_payload(stand).mass == pytest.approx(0.0, abs=1e-9)
    assert least_branch_force(stand, 57.0).mass == -np.inf
    assert elastic_forces(stand, 57.0).mass == -np.inf


def test_numbers_that_are_not_finite_are_refused():
    stand = stand_at(TWO)
    bad = stand._replace(force_map=np.full((12, 12, 3), np.nan))
    for solve in (largest_payload, lambda s: least_branch_force(s, 57.0)):
        with pytest.raises(ValueError, match="nan"):
            solve(bad)


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
