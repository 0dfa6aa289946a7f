import numpy as np
import pytest

from parapod.systems.walking_chair.chair import chair_motion
from parapod.systems.walking_chair.feedforward import ChairFeedforward
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry

GEOMETRY = ChairGeometry()
GAIT = TrotGait(body_law="cycloid")


def inputs(time):
    motion = gait_motion(GEOMETRY, GAIT, time)
    body = motion.body
    return {
        "body_motion": np.concatenate((body.position, body.velocity, body.acceleration)),
        "foot_motion": np.concatenate([part.ravel() for part in motion.feet]),
        "references": motion.references.astype(float),
    }


@pytest.mark.parametrize("time", [1.3, 6.308, 12.5, 17.0])
def test_outputs_are_the_gaits_branches(fix, read, time):
    system = ChairFeedforward()
    context = system.CreateDefaultContext()
    fix(system, context, **inputs(time))
    shown, expected = read(system, context), gait_branches(GEOMETRY, GAIT, time)
    for name in ("length", "velocity", "acceleration"):
        np.testing.assert_allclose(
            shown[name], getattr(expected, name).ravel(), rtol=0, atol=1e-13
        )


def test_velocity_and_acceleration_are_the_rates_of_the_length(fix, read):
    system = ChairFeedforward()
    context = system.CreateDefaultContext()
    h, time = 1e-3, 11.7
    lengths = []
    for k in (-1, 0, 1):
        fix(system, context, **inputs(time + k * h))
        shown = read(system, context)
        lengths.append(shown["length"])
        if k == 0:
            middle = shown
    before, now, after = lengths
    np.testing.assert_allclose((after - before) / (2 * h), middle["velocity"], atol=1e-7)
    np.testing.assert_allclose(
        (after - 2 * now + before) / h**2, middle["acceleration"], atol=1e-5
    )


def test_a_leg_that_cannot_reach_is_nan_and_the_others_are_not(fix, read):
    system = ChairFeedforward()
    context = system.CreateDefaultContext()
    values = inputs(6.0)
    feet = values["foot_motion"].copy()
    feet[1 * 3 + 2] = 2.0  # foot 2 above the body
    fix(system, context, **{**values, "foot_motion": feet})
    for value in read(system, context).values():
        known = np.isfinite(value.reshape(4, 3)).all(axis=1)
        assert known.tolist() == [True, False, True, True]


@pytest.mark.parametrize("name", ["body_motion", "foot_motion", "references"])
def test_each_input_moves_all_outputs(moved, fix, name):
    system = ChairFeedforward()
    context = system.CreateDefaultContext()
    values = inputs(6.308)
    fix(system, context, **values)
    other = {"references": 4.0 - values["references"]}.get(name, values[name] + 1e-3)

    def change():
        fix(system, context, **{name: other})

    assert moved(system, context, change) == {"length", "velocity", "acceleration"}


def test_lengths_depend_on_positions_alone(fix, read):
    system = ChairFeedforward()
    context = system.CreateDefaultContext()
    values = inputs(6.308)
    fix(system, context, **values)
    length = read(system, context)["length"]
    body = values["body_motion"].copy()
    body[3:] += 1.0
    fix(system, context, body_motion=body)
    np.testing.assert_array_equal(read(system, context)["length"], length)


def test_the_chair_stays_level():
    # What the system leaves out must not matter: the gait's body does not turn.
    motion = gait_motion(GEOMETRY, GAIT, 12.0)
    turning = motion.body._replace(angular_velocity=(0.0, 0.0, 0.0))
    a = chair_motion(GEOMETRY, motion.body, motion.feet, motion.references)
    b = chair_motion(GEOMETRY, turning, motion.feet, motion.references)
    np.testing.assert_array_equal(a.velocity, b.velocity)
