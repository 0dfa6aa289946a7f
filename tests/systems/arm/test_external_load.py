"""Pushes and a payload as a plant takes them: by virtual work, and by the payload's energy."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from parapod.systems.arm.external_load import ExternalLoad
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.physics import GRAVITY
from parapod.systems.levelling_platform.statics import PAPER_ARM

PLACES = (0.3, -0.1, 0.05), (-0.2, 0.15, -0.1)
PUSHES = np.array([1.0, -2.0, 3.0, 40.0, -50.0, 60.0, 0.5, 0.2, -0.7, -10.0, 30.0, 5.0])
PLACE, ANGLES, JOINTS = np.array([0.2, -0.4, 0.5]), (0.1, -0.2, 0.6), (0.7, 0.4)


def turn(angles=ANGLES):
    return RollPitchYaw(*angles).ToRotationMatrix()


def pose_of(rotation, place=PLACE):
    return [*rotation.ToQuaternion().wxyz(), *place]


@pytest.fixture
def load(stand):
    """load(arm=, places=, inputs): outputs after an update."""

    def stands(arm=PAPER_ARM, places=PLACES, **inputs):
        system = ExternalLoad(places, arm)
        given = {
            "base_pose": pose_of(turn()),
            "pushes": np.zeros(6 * len(places)),
            "joint_state": [*JOINTS, 0.0, 0.0][: 2 * arm.count],
            **inputs,
        }
        context = system.CreateDefaultContext()
        for name, value in given.items():
            system.GetInputPort(name).FixValue(context, np.asarray(value, dtype=float))
        for _ in range(2):
            state = system.EvalUniquePeriodicDiscreteUpdate(context)
            context.SetDiscreteState(state)
        return {n: system.GetOutputPort(n).Eval(context) for n in ("wrench", "applied_force")}

    return stands


def test_pushes_work_as_much_along_velocities_as_at_their_places(load):
    applied = load(pushes=PUSHES)["applied_force"]
    random, R_WF = np.random.default_rng(1), turn().matrix()
    for _ in range(5):
        spin, velocity, rates = (random.normal(size=n) for n in (3, 3, 2))
        power = 0.0
        for place, push in zip(PLACES, PUSHES.reshape(-1, 6), strict=True):
            there = velocity + np.cross(spin, R_WF @ place)
            power += push[:3] @ spin + push[3:] @ there
        assert applied @ [*spin, *velocity, *rates] == pytest.approx(power, rel=1e-12)


def test_a_payload_works_as_much_as_its_energy_falls(load):
    applied = load(payload=[0.5])["applied_force"]

    def energy(rotation, place, joints):
        tip = RigidTransform(rotation, place) @ np.array(PAPER_ARM.tip_pose(joints).place)
        return 0.5 * GRAVITY * tip[2]

    step, start = 1e-6, (turn(), PLACE, np.array(JOINTS))
    for i in range(8):
        change = np.zeros(8)
        change[i] = step
        ends = []
        for sign in (1.0, -1.0):
            spin, way, joints = np.split(sign * change, [3, 6])
            length = np.linalg.norm(spin)
            turned = start[0]
            if length:
                half = 0.5 * length
                wxyz = [np.cos(half), *(np.sin(half) * spin / length)]
                turned = RotationMatrix(Quaternion(np.array(wxyz))) @ start[0]
            ends.append(energy(turned, start[1] + way, start[2] + joints))
        fall = -(ends[0] - ends[1]) / (2.0 * step)
        assert applied[i] == pytest.approx(fall, abs=1e-8)


def test_the_wrench_is_the_same_by_the_axes_of_the_base(load):
    shown = load(pushes=PUSHES, payload=[0.3])
    R_WF = turn().matrix()
    moment, force = np.split(shown["wrench"], 2)
    np.testing.assert_allclose(
        [*(R_WF @ moment), *(R_WF @ force)], shown["applied_force"][:6], rtol=1e-12, atol=1e-12
    )


def test_a_platform_without_an_arm_is_pushed_too(load):
    shown = load(arm=SerialArm(), pushes=PUSHES)
    assert shown["applied_force"].shape == (6,)
    np.testing.assert_allclose(
        shown["applied_force"][3:], PUSHES.reshape(-1, 6)[:, 3:].sum(axis=0), rtol=1e-12
    )


def test_what_is_not_finite_changes_nothing(load):
    for bad in ({"base_pose": [np.nan] * 7}, {"pushes": [np.inf] * 12}, {"payload": [np.nan]}):
        shown = load(**{"pushes": PUSHES, **bad})
        assert not shown["wrench"].any()
        assert not shown["applied_force"].any()
