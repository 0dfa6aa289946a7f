"""Kinematics of the chair as a system, and an eased start."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.walking_chair.feedforward import (
    FARTHEST,
    ChairFeedforward,
    EasedStart,
    NotAtStart,
)
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


LENGTH = np.linspace(0.60, 0.71, 12)


def start(fix, offset, **settings):
    system = EasedStart(**settings)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, length=LENGTH, position_measured=LENGTH + offset)
    return system, simulator, context


def node(system, context):
    return system.get_output_port().Eval(context).copy()


def test_nodes_become_the_gaits_smoothly(fix):
    system, simulator, context = start(fix, 0.015, duration=1.0)
    nodes = []
    for time in np.arange(0.0, 1.2, 0.01):
        simulator.AdvanceTo(time + 0.005)
        nodes.append(node(system, context)[0])
    speed = np.diff(nodes) / 0.01
    assert nodes[-1] == LENGTH[0]
    # A quintic's largest slope is 15/8; it begins and ends at rest.
    assert np.abs(speed).max() == pytest.approx(15.0 / 8.0 * 0.015, rel=1e-3)
    assert abs(speed[0]) < 1e-3
    assert abs(speed[99]) < 1e-3


def test_measurements_after_the_first_do_not_count(fix):
    system, simulator, context = start(fix, 0.01)
    simulator.AdvanceTo(0.105)
    before = node(system, context)
    fix(system, context, position_measured=LENGTH + 0.5)
    np.testing.assert_array_equal(node(system, context), before)


def test_the_gait_is_followed_while_the_offset_fades(fix):
    system, simulator, context = start(fix, 0.01)
    simulator.AdvanceTo(0.505)
    before = node(system, context)
    fix(system, context, length=LENGTH + 0.02)
    np.testing.assert_allclose(node(system, context) - before, 0.02, rtol=0, atol=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_branch_that_is_too_far_off_is_refused_by_name(fix, sign):
    offset = np.zeros(12)
    offset[7] = sign * (FARTHEST + 1e-3)
    _, simulator, _ = start(fix, offset)
    with pytest.raises(NotAtStart, match="branch 32 is") as caught:
        simulator.AdvanceTo(0.005)
    assert caught.value.length == pytest.approx(LENGTH[7] + offset[7])
    assert f"{1e3 * LENGTH[7]:.2f} mm" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_value_that_is_not_finite_has_no_offset(fix, bad):
    measured = LENGTH.copy()
    measured[3] = bad
    system, simulator, context = start(fix, 0.0)
    fix(system, context, position_measured=measured)
    np.testing.assert_array_equal(node(system, context), LENGTH)
    simulator.AdvanceTo(0.105)
    np.testing.assert_array_equal(node(system, context), LENGTH)
