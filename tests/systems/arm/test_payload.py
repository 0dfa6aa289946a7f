"""A payload at the tip of a rod that bends: the rod is a heavier one then, in every respect."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.core.physics import GRAVITY

ROD, MASS, PERIOD = FlexibleRod(), 0.5, 2e-3
HEAVIER = replace(ROD, tip_mass=ROD.tip_mass + MASS)
POSES = {
    "level": [math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0, 0.1, 0.2, 0.3],
    "leaning": [math.cos(0.4), math.sin(0.4) * 0.6, math.sin(0.4) * 0.8, 0.0, 0.0, 0.0, 0.5],
}
each_pose = pytest.mark.parametrize("pose", POSES.values(), ids=POSES)


class Standing:
    """A rod on a base at rest."""

    def __init__(self, pose, rod=ROD, payload=MASS):
        self.system = FlexibleArm(rod, PERIOD, base_pose=pose, payload=payload)
        self.context = self.system.CreateDefaultContext()
        for name, value in (("base_pose", pose), ("base_velocity", np.zeros(6))):
            self.system.GetInputPort(name).FixValue(self.context, value)
        self.system.GetInputPort("joint_state").FixValue(self.context, [])

    def go(self, payload, seconds=0.0, show="deflection"):
        """Values of an output at each of the steps."""
        self.system.GetInputPort("payload").FixValue(self.context, [payload])
        shown = []
        for _ in range(round(seconds / PERIOD)):
            state = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            self.context.SetDiscreteState(state)
            shown.append(self[show])
        return np.array(shown)

    def __getitem__(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).copy()


def damped(rod):
    return replace(rod, damping_ratio=0.4)


@each_pose
def test_at_rest_it_is_the_heavier_rod(pose):
    loaded = Standing(pose, damped(ROD))
    loaded.go(MASS, 12.0)
    heavier = Standing(pose, damped(HEAVIER), 0.0)
    for name in ("tip_pose", "deflection", "wrench"):
        np.testing.assert_allclose(loaded[name], heavier[name], rtol=0, atol=1e-7)


@each_pose
def test_a_plant_with_the_light_rigid_rod_bears_all_of_it(pose):
    loaded = Standing(pose, damped(ROD))
    before = loaded["bending_force"]
    loaded.go(MASS, 12.0)
    added = loaded["bending_force"] - before
    np.testing.assert_allclose(added[3:6], [0.0, 0.0, -MASS * GRAVITY], rtol=0, atol=2e-3)


def test_it_swings_at_the_frequency_of_the_heavier_rod():
    pose = POSES["level"]
    swing = Standing(pose, replace(ROD, damping_ratio=0.0)).go(MASS, 12.0)[:, 0]
    middle = Standing(pose, HEAVIER, 0.0)["deflection"][0]
    crossings = np.flatnonzero(np.diff(np.sign(swing - middle)) > 0)
    turns = PERIOD * (crossings[-1] - crossings[0]) / (len(crossings) - 1)
    expected = 2.0 * math.pi / HEAVIER.loaded_frequencies(0.0)[0, 0]
    assert turns == pytest.approx(expected, rel=2e-3)
    # It begins at rest where the light rod was, and swings as far beyond the middle.
    assert np.ptp(swing) == pytest.approx(2.0 * abs(middle - swing[0]), rel=0.02)


def test_what_is_still_borne_from_outside_does_not_bend_it():
    pose, share = POSES["level"], 0.3 * MASS
    partly = Standing(pose, damped(ROD))
    partly.go(share, 12.0)
    part = Standing(pose, damped(replace(ROD, tip_mass=ROD.tip_mass + share)), 0.0)
    np.testing.assert_allclose(partly["deflection"][:2], part["deflection"][:2], atol=1e-9)
    np.testing.assert_allclose(partly["wrench"], part["wrench"], rtol=0, atol=1e-7)


def test_put_down_it_is_the_rod_that_it_was():
    pose = POSES["leaning"]
    rod = Standing(pose, damped(ROD))
    before = {name: rod[name] for name in ("tip_pose", "wrench", "modal_state")}
    rod.go(MASS, 4.0)
    assert np.linalg.norm(rod["tip_pose"][4:] - before["tip_pose"][4:]) > 0.01
    rod.go(0.0, 12.0)
    for name, value in before.items():
        np.testing.assert_allclose(rod[name], value, rtol=0, atol=1e-7)


def test_the_tip_does_not_jump_as_it_is_taken_and_put_down():
    for begins, ends in ((0.0, 1e-9), (MASS, 0.0)):
        rod = Standing(POSES["level"], damped(ROD))
        rod.go(begins, 6.0)
        before = rod["deflection"]
        # The modes are others, and two do not show all of it.
        after = rod.go(ends, PERIOD)
        np.testing.assert_allclose(after, [before], rtol=0, atol=3e-5)


def test_coordinates_go_over_into_another_rods_modes():
    there, back = HEAVIER.coordinates_from(ROD), ROD.coordinates_from(HEAVIER)
    np.testing.assert_allclose(ROD.coordinates_from(ROD), np.eye(2), atol=1e-12)
    z = np.linspace(0.0, ROD.length, 50)
    np.testing.assert_allclose(HEAVIER.shape(z) @ there, ROD.shape(z), atol=0.02)
    np.testing.assert_allclose(back @ there, np.eye(2), atol=0.02)


@pytest.mark.parametrize("payload", [math.nan, -1.0])
def test_a_payload_that_is_none_is_not_taken(payload):
    rod = Standing(POSES["level"], damped(ROD))
    before = rod["deflection"]
    np.testing.assert_allclose(rod.go(payload, 0.1), np.tile(before, (50, 1)), atol=1e-12)
