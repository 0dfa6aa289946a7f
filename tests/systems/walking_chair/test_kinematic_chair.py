import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import TrotGait, Walk, starting_lengths, there_and_back
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.kinematic_chair import KinematicChair
from parapod.systems.walking_chair.masses import ChairMasses, Passenger

GEOMETRY = ChairGeometry()
LEVEL = np.eye(3)
WALK = Walk((TrotGait(phase_duration=1.0, body_law="ramped"),))


def lengths_of(walk, time):
    motion = walk.motion(GEOMETRY, time)
    return chair_inverse(
        GEOMETRY, motion.body.position, LEVEL, motion.feet.position, motion.references
    )


def start(fix, passenger=Passenger(), lengths=None, at=(0.0, 0.0)):
    chair = KinematicChair()
    simulator = Simulator(chair)
    context = simulator.get_mutable_context()
    lengths = starting_lengths(GEOMETRY, WALK) if lengths is None else lengths
    fix(chair, context, position=lengths.ravel())
    chair.stand(context, at, passenger)
    return chair, simulator, context


def test_the_body_goes_where_the_gait_has_it(fix, read):
    walk = there_and_back(WALK.gaits[0])
    chair, simulator, context = start(fix)
    for time in np.arange(0.0, walk.duration + 0.005, 0.02):
        fix(chair, context, position=lengths_of(walk, time).ravel())
        simulator.AdvanceTo(time)
        if round(100 * time) % 50 == 0:
            shown = read(chair, context)
            desired = np.asarray(walk.motion(GEOMETRY, time).body.position)
            error = shown["body_position"] - desired
            # Springs give way by a fifth of a millimetre.
            np.testing.assert_allclose(error, 0.0, atol=2.5e-4)
            assert np.degrees(np.abs(shown["body_attitude"])).max() < 0.03
            if time == pytest.approx(WALK.duration):
                assert shown["body_position"][1] == pytest.approx(0.1027, abs=5e-5)
    assert shown["body_position"][1] == pytest.approx(0.0, abs=5e-5)


def test_forces_carry_chair_and_passenger(fix, read):
    passenger = Passenger(57.0, 0.02, 0.03)
    chair, _, context = start(fix, passenger)
    shown = read(chair, context)
    weight = (ChairMasses().total + 57.0) * GRAVITY
    assert shown["contact_force"].sum() == pytest.approx(weight, rel=1e-9)
    # To the right and ahead: leg 3 carries most and leg 1 least.
    assert np.argmax(shown["contact_force"]) == 2
    assert np.argmin(shown["contact_force"]) == 0


def test_the_chair_stands_where_it_is_put(fix, read):
    chair, simulator, context = start(fix, at=(0.3, -0.2))
    simulator.AdvanceTo(0.1)
    np.testing.assert_allclose(
        read(chair, context)["body_position"][:2], (0.3, -0.2), rtol=0, atol=1e-12
    )


def test_feet_that_stand_stay_while_the_body_moves(fix):
    chair, simulator, context = start(fix)
    simulator.AdvanceTo(0.01)
    before = context.get_discrete_state(1).value()[:24].reshape(12, 2).copy()
    for time in np.arange(0.0, 0.9, 0.01):
        fix(chair, context, position=lengths_of(WALK, time).ravel())
        simulator.AdvanceTo(0.02 + time)
    after = context.get_discrete_state(1).value()[:24].reshape(12, 2)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)


def test_pose_is_position_and_attitude(fix, read):
    lengths = starting_lengths(GEOMETRY, WALK).copy()
    lengths[[1, 2]] += 1e-3
    chair, _, context = start(fix, lengths=lengths)
    shown = read(chair, context)
    np.testing.assert_array_equal(shown["body_pose"][4:], shown["body_position"])
    half = 0.5 * shown["body_attitude"]
    np.testing.assert_allclose(shown["body_pose"][1:4], half, atol=1e-5)
    assert abs(shown["body_attitude"][1]) > 1e-3


def test_lengths_that_no_leg_has_give_nan_and_leave_the_state_alone(fix, read):
    chair, simulator, context = start(fix)
    simulator.AdvanceTo(0.05)
    state = context.get_discrete_state(1).value().copy()
    fix(chair, context, position=np.full(12, math.nan))
    simulator.AdvanceTo(0.1)
    assert all(np.isnan(value).all() for value in read(chair, context).values())
    np.testing.assert_array_equal(context.get_discrete_state(1).value(), state)


def test_a_default_context_has_the_passenger_and_the_place_of_the_constructor(fix):
    passenger, place = Passenger(41.0, 0.02, -0.03, 0.3), (0.3, -0.2)
    chair, _, standing = start(fix, passenger, at=place)
    built = KinematicChair(passenger=passenger, place=place)
    context = built.CreateDefaultContext()
    fix(built, context, position=starting_lengths(GEOMETRY, WALK).ravel())
    for name in ("body_position", "force", "contact_force"):
        np.testing.assert_array_equal(
            built.GetOutputPort(name).Eval(context), chair.GetOutputPort(name).Eval(standing)
        )
    assert built.GetOutputPort("body_position").Eval(context)[:2].tolist() == list(place)
