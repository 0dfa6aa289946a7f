"""Serial arms against Drake's, and a rod by hand."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    MultibodyForces,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)

from parapod.diagrams.cad_models import OwnModel
from parapod.diagrams.levelling_platform.model import PlatformStructure, add_arm
from parapod.diagrams.serial_arms import serial_arm
from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.urdf import configure_parser

REACH_ARM = Path(__file__).parents[3] / "examples" / "machines" / "reach_arm.urdf"
OWN = OwnModel("machine.arm.file", str(REACH_ARM), "foot", tip="tip")
GRAVITY = (1.1, -2.3, -9.3)


def add_drawn(plant, platform):
    return add_arm(_parser(plant), platform.body_frame(), PlatformStructure())


def add_own(plant, platform):
    structure = PlatformStructure(arm=OWN, arm_base=(0.0, 0.05, 0.03))
    return add_arm(_parser(plant), platform.body_frame(), structure)


def _parser(plant):
    parser = Parser(plant)
    configure_parser(parser)
    return parser


def add_chain(plant, platform):
    """Six joints in any directions, two of which slide, with links of any inertia."""
    random = np.random.default_rng(7)
    joints, before = [], platform

    def frame(body):
        pose = RigidTransform(
            RollPitchYaw(random.uniform(-3.0, 3.0, 3)), random.uniform(-0.5, 0.5, 3)
        )
        return plant.AddFrame(
            FixedOffsetFrame(f"frame_{random.random()}", body.body_frame(), pose)
        )

    for i in range(6):
        moments = random.uniform(0.5, 0.8, 3) * 0.1
        unit = UnitInertia(*moments, *random.uniform(-0.01, 0.01, 3))
        centre = random.uniform(-0.3, 0.3, 3)
        mass = random.uniform(0.5, 3.0)
        inertia = SpatialInertia(mass, centre, unit.ShiftFromCenterOfMass(centre))
        body = plant.AddRigidBody(f"link_{i}", inertia)
        kind = PrismaticJoint if i in (2, 4) else RevoluteJoint
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        limits = (-1.0 - i, 2.0 + i)
        joints.append(
            plant.AddJoint(kind(f"joint_{i}", frame(before), frame(body), axis, *limits))
        )
        before = body
    return tuple(joints), frame(before)


ARMS = {"drawn": add_drawn, "own": add_own, "chain": add_chain}


class Drake:
    """An arm on a body that floats and is held."""

    def __init__(self, add):
        self.plant = plant = MultibodyPlant(time_step=0.0)
        unit = UnitInertia.SolidSphere(1.0)
        self.platform = plant.AddRigidBody("platform", SpatialInertia(1.0, np.zeros(3), unit))
        self.joints, self.tip = add(plant, self.platform)
        plant.mutable_gravity_field().set_gravity_vector(np.array(GRAVITY))
        plant.Finalize()
        self.arm = serial_arm(plant, self.platform.body_frame(), self.joints, self.tip)
        self.moved = plant.GetBodiesKinematicallyAffectedBy([j.index() for j in self.joints])
        self.columns = [joint.velocity_start() for joint in self.joints]
        self.context = plant.CreateDefaultContext()

    def put(self, position):
        for joint, q in zip(self.joints, position, strict=True):
            set_position = getattr(joint, "set_angle", None) or joint.set_translation
            set_position(self.context, q)

    def generalized(self, values):
        whole = np.zeros(self.plant.num_velocities())
        whole[self.columns] = values
        return whole

    def reaction(self, position, rate, acceleration):
        """Force and moment on the platform, and the joints' efforts."""
        plant, context = self.plant, self.context
        self.put(position)
        plant.SetVelocities(context, self.generalized(rate))
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        effort = plant.CalcInverseDynamics(context, self.generalized(acceleration), forces)
        start = self.platform.floating_velocities_start_in_v()
        fixed = [
            plant.get_body(index)
            for index in map(type(self.moved[0]), range(1, plant.num_bodies()))
            if index not in self.moved
        ]
        world = plant.world_frame()
        rest = plant.CalcSpatialInertia(context, world, [body.index() for body in fixed])
        weight = rest.get_mass() * np.array(GRAVITY)
        # What holds the platform bears its own weight too.
        moment = -effort[start : start + 3] - np.cross(rest.get_com(), weight)
        return -effort[start + 3 : start + 6] - weight, moment, effort[self.columns]


@pytest.fixture(scope="module", params=ARMS)
def drake(request):
    return Drake(ARMS[request.param])


def samples(count, number=8):
    random = np.random.default_rng(3)
    return random.uniform(-1.0, 1.0, (number, 3, count)) * [[2.0], [1.5], [4.0]]


def test_pose_jacobian_and_centre_of_mass_are_those_of_drake(drake):
    arm, plant = drake.arm, drake.plant
    for position, _, _ in samples(arm.count):
        drake.put(position)
        X_FT = plant.CalcRelativeTransform(drake.context, drake.platform.body_frame(), drake.tip)
        pose = arm.tip_pose(position.tolist())
        np.testing.assert_allclose(pose.place, X_FT.translation(), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, X_FT.rotation().matrix(), rtol=0.0, atol=1e-12)
        jacobian = plant.CalcJacobianSpatialVelocity(
            drake.context,
            JacobianWrtVariable.kV,
            drake.tip,
            np.zeros(3),
            plant.world_frame(),
            plant.world_frame(),
        )[:, drake.columns]
        np.testing.assert_allclose(
            arm.tip_jacobian(position.tolist()), jacobian, rtol=0.0, atol=1e-12
        )
        whole = plant.CalcSpatialInertia(drake.context, plant.world_frame(), drake.moved)
        assert arm.mass == pytest.approx(whole.get_mass(), rel=1e-12)
        np.testing.assert_allclose(
            arm.centre_of_mass(position.tolist()), whole.get_com(), rtol=0.0, atol=1e-12
        )


def test_efforts_and_the_wrench_on_the_platform_are_those_of_drake(drake):
    for motion in samples(drake.arm.count):
        force, moment, efforts = drake.reaction(*motion)
        found = drake.arm.reaction(*motion.tolist(), GRAVITY)
        np.testing.assert_allclose(found.force, force, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.moment, moment, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.efforts, efforts, rtol=1e-9, atol=1e-9)


def test_limits_and_names_are_taken_from_the_model(drake):
    for joint, own in zip(drake.joints, drake.arm.joints, strict=True):
        assert own.name == joint.name()
        assert (own.lower,) == tuple(joint.position_lower_limits())
        assert (own.upper,) == tuple(joint.position_upper_limits())


def test_a_batch_is_computed_row_by_row(drake):
    arm = drake.arm
    rows = samples(arm.count)
    batch = np.moveaxis(rows, 0, -1)  # motion, joint, row
    for number, row in enumerate(rows.tolist()):
        for function, arguments in (
            (arm.tip_pose, 1),
            (arm.tip_jacobian, 1),
            (arm.centre_of_mass, 1),
            (lambda *motion: arm.reaction(*motion, GRAVITY), 3),
        ):
            of_batch = function(*(list(part) for part in batch[:arguments]))
            of_row = function(*row[:arguments])
            columns = [np.broadcast_to(x, len(rows))[number] for x in leaves(of_batch)]
            np.testing.assert_allclose(columns, list(leaves(of_row)), rtol=0.0, atol=1e-12)


def leaves(result):
    for item in result:
        if isinstance(item, tuple):
            yield from leaves(item)
        else:
            yield item


def test_a_rod_on_a_turntable_is_as_by_hand():
    # It leans by 30 deg in the plane that the turntable has turned by 90 deg, and is swung.
    mass, length, across = 2.0, 0.8, 0.1
    rod = SerialArm(
        (ArmJoint("turn", (0.0, 0.0, 0.3)), ArmJoint("lean", axis=(0.0, 1.0, 0.0))),
        (
            ArmLink(),
            ArmLink(mass, (0.0, 0.0, length), (across, across, 0.0, 0.0, 0.0, 0.0)),
        ),
        (0.0, 0.0, 2.0 * length),
    )
    lean, swing = math.radians(30.0), 1.7
    position = (math.radians(90.0), lean)
    tip = (0.0, 2.0 * length * math.sin(lean), 0.3 + 2.0 * length * math.cos(lean))
    np.testing.assert_allclose(rod.tip_pose(position).place, tip, atol=1e-15)
    still = rod.reaction(position, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, -10.0))
    np.testing.assert_allclose(still.force, (0.0, 0.0, -20.0), atol=1e-14)
    np.testing.assert_allclose(
        still.moment, (-20.0 * length * math.sin(lean), 0.0, 0.0), atol=1e-14
    )
    swung = rod.reaction(position, (0.0, 0.0), (0.0, swing), (0.0, 0.0, 0.0))
    torque = (mass * length**2 + across) * swing
    assert swung.efforts[1] == pytest.approx(torque, rel=1e-14)
    assert still.efforts[1] == pytest.approx(-20.0 * length * math.sin(lean), rel=1e-14)
    # Seen from above, the turntable feels the centrifugal force of a steady turn not at all.
    turning = rod.reaction((0.0, lean), (3.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0))
    radius = length * math.sin(lean)
    np.testing.assert_allclose(turning.force, (mass * radius * 9.0, 0.0, 0.0), atol=1e-14)
    assert turning.efforts[0] == pytest.approx(0.0, abs=1e-14)


def test_without_joints_there_is_no_arm():
    none = SerialArm(tip_place=(0.0, 0.1, 0.2))
    assert none.mass == 0.0
    assert none.first_moment(()) == (0.0, 0.0, 0.0)
    assert none.tip_pose(()).place == (0.0, 0.1, 0.2)
    assert np.shape(none.tip_jacobian(())) == (6, 0)
    assert none.reaction((), (), (), GRAVITY).force == (0.0, 0.0, 0.0)


def test_other_than_one_link_a_joint_and_axes_of_no_length_are_refused():
    with pytest.raises(ValueError, match="1 joints must move as many links"):
        SerialArm((ArmJoint("a"),))
    with pytest.raises(ValueError, match="axis of joint 'a' must have length 1"):
        ArmJoint("a", axis=(0.0, 0.0, 2.0))


def test_positions_that_are_not_finite_give_nan():
    arm = SerialArm((ArmJoint("a", axis=(0.0, 1.0, 0.0)),), (ArmLink(1.0, (0.0, 0.0, 1.0)),))
    for bad in (math.nan, math.inf):
        assert all(map(math.isnan, arm.first_moment((bad,))[::2]))
    assert replace(arm, tip_place=(0.0, 0.0, 1.0)).tip_pose((0.0,)).place == (0.0, 0.0, 1.0)


def test_positions_are_told_in_the_units_of_their_joint():
    assert ArmJoint("a").shown(math.radians(30.0)) == "30 deg"
    assert ArmJoint("a", kind="prismatic").shown(0.25) == "250 mm"


def test_efforts_that_hold_the_arm_are_those_of_its_reaction_at_rest(drake):
    random = np.random.default_rng(5)
    count = drake.arm.count
    still = np.zeros(count)
    for position in random.uniform(-0.8, 0.8, (5, count)):
        efforts = drake.arm.holding_efforts(position.tolist(), GRAVITY)
        expected = drake.arm.reaction(position, still, still, GRAVITY).efforts
        np.testing.assert_allclose(efforts, expected, rtol=1e-12, atol=1e-12)


def test_a_payload_is_a_point_mass_at_the_tip(drake):
    random = np.random.default_rng(6)
    arm, mass, count = drake.arm, 0.7, drake.arm.count
    loaded = arm.bearing(mass)
    assert loaded.mass == pytest.approx(arm.mass + mass)
    position, rate, acceleration = random.uniform(-0.5, 0.5, (3, count))
    jacobian = np.array(arm.tip_jacobian(position))[3:]
    still = np.zeros(count)
    # Its equation of motion along the joints, the bias of its acceleration by differences.
    step = 1e-5
    later, sooner = (
        np.array(arm.tip_jacobian(position + sign * step * rate))[3:] for sign in (1, -1)
    )
    pull = jacobian @ acceleration + (later - sooner) / (2 * step) @ rate - np.array(GRAVITY)
    more = mass * jacobian.T @ pull
    motion = position, rate, acceleration, GRAVITY
    found = np.subtract(loaded.reaction(*motion).efforts, arm.reaction(*motion).efforts)
    np.testing.assert_allclose(found, more, rtol=1e-7, atol=1e-8)
    assert arm.bearing(0.0) is arm
    assert SerialArm().bearing(mass).mass == 0.0
    assert np.isfinite(loaded.reaction(position, still, still, GRAVITY).efforts).all()


def test_joints_give_way_until_their_drives_springs_hold_them(drake):
    compliances = np.linspace(2e-5, 1e-4, drake.arm.count)
    joints = (
        replace(joint, compliance=by)
        for joint, by in zip(drake.arm.joints, compliances, strict=True)
    )
    soft = replace(drake.arm, joints=tuple(joints))
    drives = np.random.default_rng(7).uniform(-0.8, 0.8, soft.count)
    behind = np.array(soft.yielded(drives.tolist(), GRAVITY))
    sprung = (drives - behind) / compliances
    efforts = np.array(soft.holding_efforts(behind.tolist(), GRAVITY))
    assert np.abs(drives - behind).max() > 1e-4
    np.testing.assert_allclose(sprung, efforts, atol=2e-3 * np.abs(efforts).max())
    assert drake.arm.yielded(drives.tolist(), GRAVITY) == tuple(drives)
