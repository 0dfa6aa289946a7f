"""A flexible rod behind ports: beginning, prescribed bases, tip, order of the step, bad input."""

import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.systems.core.physics import GRAVITY

ROD = FlexibleRod(damping_ratio=0.0)
OUTPUTS = ("tip_pose", "tip_velocity", "wrench", "bending_force", "deflection", "modal_state")
SWING = SerialArm(
    (ArmJoint("turn", (0.1, 0.2, 0.3)), ArmJoint("swing", axis=(0.0, 1.0, 0.0))), (ArmLink(),) * 2
)
MASS = ROD.mass + ROD.tip_mass
CENTRE = (0.5 * ROD.mass + ROD.tip_mass) * ROD.length / MASS


def pose_of(roll=0.0, pitch=0.0, yaw=0.0, place=(0.0, 0.0, 0.0)):
    quaternion = RollPitchYaw(roll, pitch, yaw).ToQuaternion().wxyz()
    return np.array([*quaternion, *place])


def transform(pose):
    return RigidTransform(Quaternion(pose[:4] / np.linalg.norm(pose[:4])), pose[4:])


class Leaning(LeafSystem):
    """A base, or a joint on it, that leans smoothly from upright to 45 deg in a second."""

    def __init__(self, has_joints):
        super().__init__()
        place = (0.3, 0.0, 1.0)
        below = np.subtract(place, SWING.joints[0].place)
        signals = {
            "base_pose": lambda t: pose_of(pitch=self.motion(t)[0], place=place),
            "base_velocity": lambda t: [0, self.motion(t)[1], 0, 0, 0, 0],
            "joint_state": lambda t: [],
        }
        if has_joints:
            signals = {
                "base_pose": lambda t: pose_of(place=below),
                "base_velocity": lambda t: [0] * 6,
                "joint_state": lambda t: [0, self.motion(t)[0], 0, self.motion(t)[1]],
            }
        for name, calc in signals.items():

            def show(context, output, calc=calc):
                output.SetFromVector(np.array(calc(context.get_time()), dtype=float))

            size = BasicVector(len(calc(0.0)))
            self.DeclareVectorOutputPort(name, size, show, {self.time_ticket()})

    @staticmethod
    def motion(t):
        if t >= 1.0:
            return 0.25 * math.pi, 0.0, 0.0
        s = max(0.0, t)
        way = 0.25 * math.pi
        return (
            way * s**3 * (10 - 15 * s + 6 * s * s),
            way * 30 * s * s * (1 - s) ** 2,
            way * 60 * s * (1 - s) * (1 - 2 * s),
        )


def lean(period, has_velocity=True, has_joints=False):
    """Outputs by name (n, size) at multiples of 20 ms, of a rod whose clamp leans."""
    builder = DiagramBuilder()
    base = builder.AddSystem(Leaning(has_joints))
    chain, begins = SerialArm(), pose_of(place=(0.3, 0.0, 1.0))
    if has_joints:
        chain, begins = SWING, pose_of(place=np.subtract(begins[4:], SWING.joints[0].place))
    motion = "velocity" if has_velocity else "pose"
    arm = builder.AddSystem(FlexibleArm(ROD, period, chain, begins, motion))
    for i in range(base.num_output_ports()):
        name = base.get_output_port(i).get_name()
        builder.Connect(base.GetOutputPort(name), arm.GetInputPort(name))
    logs = {n: LogVectorOutput(arm.GetOutputPort(n), builder, 0.02) for n in OUTPUTS}
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2.0)
    return {n: log.FindLog(simulator.get_context()).data().T for n, log in logs.items()}


def alone(base_motion="pose", **inputs):
    """An arm without a diagram, its context, a function that ticks it and one that reads it."""
    arm = FlexibleArm(FlexibleRod(), base_motion=base_motion)
    context = arm.CreateDefaultContext()
    arm.GetInputPort("joint_state").FixValue(context, [])

    def tick(times=1, **inputs):
        for name, value in inputs.items():
            arm.GetInputPort(name).FixValue(context, value)
        for _ in range(times):
            ahead = arm.EvalUniquePeriodicDiscreteUpdate(context)
            context.get_mutable_discrete_state().SetFrom(ahead)

    def show(name):
        return arm.GetOutputPort(name).Eval(context)

    tick(0, **inputs)
    return arm, context, tick, show


@pytest.mark.parametrize("pose", [pose_of(), pose_of(0.3, -0.7, 1.0, (1, 2, 3)), pose_of(pitch=2)])
def test_it_begins_at_rest_on_the_first_pose_and_stays_there(pose):
    _, _, tick, show = alone(base_pose=pose)
    tick()
    rest = show("modal_state").copy()
    tick(200)
    np.testing.assert_allclose(show("modal_state"), rest, atol=1e-9)
    rotation = transform(pose).rotation().matrix()
    force = rotation.T @ [0.0, 0.0, GRAVITY]
    sags = [FlexibleRod().sag(force[i], force[2], i) for i in range(2)]
    expected = [sags[0].across, sags[1].across, -sags[0].along - sags[1].along]
    np.testing.assert_allclose(show("deflection"), expected, atol=1e-9)
    tip = transform(show("tip_pose"))
    straight = np.array([0.0, 0.0, 2.02])
    np.testing.assert_allclose(tip.translation(), pose[4:] + rotation @ (straight + expected))
    turn = RotationMatrix(rotation.T @ tip.rotation().matrix()).ToAngleAxis()
    bent = [-sags[1].slope, sags[0].slope, 0.0]
    np.testing.assert_allclose(turn.angle() * turn.axis(), bent, atol=1e-9)
    np.testing.assert_allclose(show("tip_velocity"), 0.0, atol=1e-9)


def test_wrench_at_rest_is_the_weight_at_its_bent_place():
    pose = pose_of(pitch=0.5 * math.pi)  # horizontal, forward
    _, _, tick, show = alone(base_pose=pose)
    tick()
    rotation = transform(pose).rotation()
    moment, force = (rotation @ part for part in np.split(show("wrench"), 2))
    np.testing.assert_allclose(force, [0.0, 0.0, -MASS * GRAVITY], atol=1e-9)
    assert moment[1] == pytest.approx(MASS * GRAVITY * CENTRE, rel=1e-3)
    bent, no_force = np.split(show("bending_force"), 2)
    np.testing.assert_allclose(no_force, 0.0, atol=1e-9)
    # Sideways nothing turns it; the sag moves the weight along the line of gravity only.
    np.testing.assert_allclose(bent, 0.0, atol=1e-9)


def test_put_at_rest_it_is_as_at_the_first_pose():
    pose = pose_of(pitch=0.4)
    _, _, tick, show = alone(base_pose=pose)
    tick()
    arm = FlexibleArm(FlexibleRod())
    context = arm.CreateDefaultContext()
    arm.set_rest(context, pose)
    for name in ("deflection", "wrench", "bending_force", "modal_state"):
        there = arm.GetOutputPort(name).Eval(context)
        np.testing.assert_allclose(there, show(name), rtol=1e-12)


@pytest.mark.parametrize("has_velocity", [True, False])
def test_error_halves_with_the_period(has_velocity):
    exact = lean(1e-4)
    for name, size in (("deflection", 0.15), ("wrench", 20.0), ("bending_force", 20.0)):
        coarse, fine = (
            np.abs(lean(period, has_velocity)[name] - exact[name])[5:].max()
            for period in (4e-3, 2e-3)
        )
        assert coarse < 0.12 * size
        assert coarse / fine == pytest.approx(2.0, rel=0.15)


def test_with_velocities_the_rod_is_that_of_the_middle_between_updates():
    def modal_at(instants, period):
        builder = DiagramBuilder()
        base = builder.AddSystem(Leaning(has_joints=False))
        begins = pose_of(place=(0.3, 0.0, 1.0))
        arm = builder.AddSystem(FlexibleArm(ROD, period, base_pose=begins))
        for name in ("base_pose", "base_velocity", "joint_state"):
            builder.Connect(base.GetOutputPort(name), arm.GetInputPort(name))
        simulator, shown = Simulator(builder.Build()), []
        context = simulator.get_context()
        for instant in instants:
            simulator.AdvanceTo(instant)
            port = arm.GetOutputPort("modal_state")
            shown.append(port.Eval(arm.GetMyContextFromRoot(context)).copy())
        return np.array(shown)

    for period in (8e-3, 4e-3):
        middles = (0.5 + np.arange(1, round(1.6 / period))) * period
        shown = modal_at(middles, period)
        # Middles of some of the short steps, too.
        exact = modal_at(middles, period / 41)
        half_a_period_s_way = 0.5 * np.abs(np.diff(exact, axis=0))[:, :4].max()
        assert np.abs(shown - exact)[:, :4].max() < 0.2 * half_a_period_s_way


@pytest.mark.parametrize("has_velocity", [True, False])
def test_clamp_that_a_joint_moves_is_as_one_that_the_base_moves(has_velocity):
    by_base, by_joint = (lean(1e-3, has_velocity, joints) for joints in (False, True))
    for name in ("tip_pose", "tip_velocity", "deflection", "modal_state"):
        np.testing.assert_allclose(by_joint[name], by_base[name], atol=1e-9)
    place = np.array(SWING.joints[0].place)
    moment, force, efforts = np.split(by_joint["bending_force"], [3, 6], axis=1)
    moment_there, force_there = np.split(by_base["bending_force"], 2, axis=1)
    np.testing.assert_allclose(force, force_there, atol=1e-9)
    np.testing.assert_allclose(moment, moment_there + np.cross(place, force), atol=1e-9)
    np.testing.assert_allclose(efforts, moment_there[:, [2, 1]], atol=1e-9)
    # The joint's base does not lean: its axes are the world's.
    lean_angles = np.array([Leaning.motion(t)[0] for t in 0.02 * np.arange(len(force))])
    turn = [RollPitchYaw(0.0, a, 0.0).ToRotationMatrix().matrix() for a in lean_angles]
    moment, force = np.split(by_joint["wrench"], 2, axis=1)
    moment_there, force_there = np.split(by_base["wrench"], 2, axis=1)
    at_rest = len(force) // 2 + 1
    force_there = np.einsum("nij,nj->ni", turn, force_there)[at_rest:]
    moment_there = np.einsum("nij,nj->ni", turn, moment_there)[at_rest:]
    np.testing.assert_allclose(force[at_rest:], force_there, atol=1e-9)
    expected = moment_there + np.cross(place, force_there)
    np.testing.assert_allclose(moment[at_rest:], expected, atol=1e-9)


def test_vibration_after_a_swing_is_that_of_an_oscillator():
    run = lean(1e-3)
    # One mode by Duhamel's integral, without what the weight softens.
    mode = FlexibleRod(modes=1, damping_ratio=0.0)
    omega = mode.frequencies[0, 0]
    t = np.linspace(0.0, 1.0, 20001)
    load = -mode.rotation[0] * np.array([Leaning.motion(s)[2] for s in t])
    amplitude = abs(np.trapezoid(load * np.exp(1j * omega * t), t)) / omega
    after = run["deflection"][51:, 0]
    swing = 0.5 * np.ptp(after)
    assert swing == pytest.approx(amplitude * mode.shape(mode.length)[0], rel=0.12)


def test_tip_velocity_is_the_rate_of_the_tip():
    run = lean(1e-3)
    place, velocity = run["tip_pose"][:, 4:], run["tip_velocity"][:, 3:]
    rate = (place[2:] - place[:-2]) / 0.04
    np.testing.assert_allclose(velocity[1:-1], rate, atol=0.03)
    assert np.abs(velocity).max() > 1.0


def test_input_that_is_not_finite_keeps_the_motion():
    pose = pose_of(pitch=0.4)
    nothing = np.full(7, np.nan)
    _, context, tick, show = alone("velocity", base_pose=nothing, base_velocity=[0.0] * 6)
    tick(2)
    assert np.isfinite(show("modal_state")).all()
    tick(1, base_pose=pose)
    rest = show("modal_state").copy()
    for bad in (math.nan, math.inf):
        tick(50, base_pose=[*pose[:4], bad, 0.0, 0.0])
        np.testing.assert_allclose(show("modal_state"), rest, atol=1e-9)
    tick(3, base_pose=pose, base_velocity=[math.nan] * 6)
    assert np.isfinite(show("wrench")).all()
    groups = (context.get_discrete_state(i).value() for i in range(3))
    assert all(np.isfinite(group).all() for group in groups)


def test_mode_that_the_period_cannot_carry_is_refused():
    with pytest.raises(ValueError, match=r"modes = 2: mode 2 of the rod has 34.8 Hz"):
        FlexibleArm(FlexibleRod(), 0.02)


def test_rod_that_its_own_weight_buckles_is_refused():
    with pytest.raises(ValueError, match=r"bending_stiffness = 10 N m\^2.* must be above 13\.1"):
        FlexibleArm(FlexibleRod(bending_stiffness=(430.0, 10.0)))
