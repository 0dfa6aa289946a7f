import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Role, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.model import DRAWN, add_platform
from parapod.systems.levelling_platform.geometry import ARM_BASE
from parapod.systems.levelling_platform.kinematics import (
    PlatformGeometry,
    forward_kinematics,
    inverse_kinematics,
)
from parapod.systems.levelling_platform.leg import diagonal_angle, foot_to_centre, swing_angle
from parapod.systems.levelling_platform.model import ParallelLinks
from parapod.systems.levelling_platform.statics import KinematicPlatformParams

VARIANTS = ("full", "reduced")
LEGS = DRAWN.legs


class Machine:
    """A platform with the diagram that keeps it alive."""

    def __init__(self, variant, wheels="braked"):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self.model = add_platform(self.plant, variant, wheels)
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def pose(self, body):
        return self.plant.EvalBodyPoseInWorld(self.context, body)

    def place(self, extension, posture=None, ground=(0.0, 0.0), arm=(0.0, 0.0)):
        if posture is None:
            posture = forward_kinematics(DRAWN, extension, ground)
        positions = self.model.positions(extension, posture, ground, arm)
        self.plant.SetPositions(self.context, positions)
        return posture

    def stand(self, extension, ground):
        positions = self.model.standing_positions(extension, ground)
        self.model.put(self.context, positions, ground)

    def in_base(self, body, point=(0.0, 0.0, 0.0)):
        """A point of a body in the platform's frame F."""
        X_FB = self.pose(self.model.base).inverse() @ self.pose(body)
        return X_FB @ np.array(point)

    @property
    def scene(self):
        """Geometry as it stands, for queries."""
        context = self.scene_graph.GetMyContextFromRoot(self.root)
        return self.scene_graph.get_query_output_port().Eval(context)

    def in_leg(self, leg, body, point=(0.0, 0.0, 0.0)):
        """A point of a body in the frame D of its leg, whose x axis points inwards."""
        hip = self.model.leg_bodies("hip")[leg]
        return (self.pose(hip).inverse() @ self.pose(body)) @ np.array(point)


@pytest.fixture(scope="module")
def full():
    return Machine("full")


@pytest.fixture(scope="module")
def reduced():
    return Machine("reduced")


@pytest.fixture(scope="module", params=VARIANTS)
def machine(request):
    return request.getfixturevalue(request.param)


def random_extensions(count=20, seed=0):
    return np.random.default_rng(seed).uniform(0.385, 0.455, (count, 4))


def bodies(plant):
    return [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]


# Parsing


def test_an_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="'half' is none of full, reduced"):
        Machine("half")


@pytest.mark.parametrize("variant", VARIANTS)
def test_wheels_can_be_braked_or_roll(variant):
    braked, rolling = Machine(variant), Machine(variant, "rolling")
    assert (braked.model.has_rolling_wheels, rolling.model.has_rolling_wheels) == (False, True)
    assert rolling.plant.num_positions() - braked.plant.num_positions() == 4


# Kinematics


def test_hips_stand_where_table_2_puts_them_and_legs_are_turned_by_beta(machine):
    machine.place([0.405] * 4)
    X_WF = machine.pose(machine.model.base)
    for leg, hip in zip(LEGS, machine.model.leg_bodies("hip"), strict=True):
        X_FD = X_WF.inverse() @ machine.pose(hip)
        expected = (-leg.l_x, -leg.l_y, -leg.l_z)
        np.testing.assert_allclose(X_FD.translation(), expected, rtol=0, atol=1e-12)
        R_FD = X_FD.rotation().matrix()
        np.testing.assert_allclose(R_FD[:, 0], (*leg.e_b, 0.0), rtol=0, atol=1e-12)
        np.testing.assert_allclose(R_FD[:, 2], (0.0, 0.0, 1.0), rtol=0, atol=1e-12)


def test_roller_centres_are_those_of_the_closed_form(machine):
    for extension in random_extensions():
        machine.place(extension)
        for leg, d, roller in zip(
            LEGS, extension, machine.model.leg_bodies("roller"), strict=True
        ):
            expected = -np.array(foot_to_centre(leg, float(d)))
            np.testing.assert_allclose(machine.in_base(roller), expected, rtol=0, atol=1e-12)


def point_k(leg, d):
    """K of the leg in its frame D: the end of the actuator, d (cos z, sin z)."""
    z = diagonal_angle(leg, d)
    return np.array((d * math.cos(z), 0.0, d * math.sin(z)))


def test_couplers_never_turn_and_rods_end_at_their_point_k(full, reduced):
    assert (full.model.is_full, reduced.model.is_full) == (True, False)
    for extension in random_extensions(seed=2):
        full.place(extension)
        for i, (leg, d) in enumerate(zip(LEGS, extension.tolist(), strict=True)):
            hip, coupler, rod = (
                full.model.leg_bodies(name)[i] for name in ("hip", "coupler", "rod")
            )
            R = (full.pose(hip).inverse() @ full.pose(coupler)).rotation().matrix()
            np.testing.assert_allclose(R, np.eye(3), rtol=0, atol=1e-12)
            p_MK = (leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1])
            expected = point_k(leg, d)
            found = full.in_leg(i, coupler, p_MK)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
            np.testing.assert_allclose(full.in_leg(i, rod), expected, rtol=0, atol=1e-12)


def test_drawn_parallel_links_reach_from_the_short_side_to_point_k(machine):
    scene_graph = SceneGraph()
    links = ParallelLinks(machine.model, scene_graph, machine.plant.num_positions())
    inspector = scene_graph.model_inspector()
    frames = {inspector.GetName(frame): frame for frame in inspector.GetAllFrameIds()}
    context = links.CreateDefaultContext()
    for extension in random_extensions(5, seed=4):
        machine.place(extension, ground=(0.03, -0.05))
        positions = machine.plant.GetPositions(machine.context)
        links.get_input_port().FixValue(context, positions)
        poses = links.get_output_port().Eval(context)
        for i, (leg, d) in enumerate(zip(LEGS, extension.tolist(), strict=True)):
            X_WD = machine.pose(machine.model.leg_bodies("hip")[i])
            X_DL = X_WD.inverse() @ poses.value(frames[f"parallel_link_{i + 1}"])
            start, end = X_DL.translation(), X_DL @ np.array((leg.l_4, 0.0, 0.0))
            corner = (leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1])
            np.testing.assert_allclose(start, corner, rtol=0, atol=1e-12)
            np.testing.assert_allclose(end, point_k(leg, d), rtol=0, atol=1e-12)


def test_legs_swing_by_the_closed_form_and_couplers_back_by_as_much(machine):
    for i, instance in enumerate(machine.model.legs):
        angles = machine.model.leg_angles(i, 0.405)
        assert angles["swing"] == pytest.approx(swing_angle(LEGS[i], 0.405), abs=1e-15)
        assert all(machine.plant.HasJointNamed(joint, instance) for joint in angles)
        if machine.model.is_full:
            assert angles["coupler_swing"] == -angles["swing"]


def test_base_stands_at_the_posture_above_the_origin(machine):
    ground = (0.03, -0.05)
    posture = machine.place([0.40, 0.41, 0.40, 0.405], ground=ground)
    pose = machine.pose(machine.model.base)
    attitude = RollPitchYaw(pose.rotation()).vector()
    np.testing.assert_allclose(attitude, (*posture[:2], 0.0), rtol=0, atol=1e-12)
    n = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()[:, 2]
    np.testing.assert_allclose(pose.translation(), posture[2] * n, rtol=0, atol=1e-12)


def test_arm_stands_on_the_base_that_the_workspace_assumes(machine):
    machine.place([0.405] * 4, ground=(0.02, -0.04))
    turntable = machine.plant.GetBodyByName("turntable", machine.model.arm)
    mount = machine.plant.GetFrameByName("arm_mount")
    np.testing.assert_array_equal(mount.GetFixedPoseInBodyFrame().translation(), ARM_BASE)
    np.testing.assert_allclose(machine.in_base(turntable)[:2], ARM_BASE[:2], rtol=0, atol=1e-12)


def test_arm_stands_upright_at_zero_and_swings_forward(machine):
    tip = (0.0, 0.0, 2.02)
    link = machine.plant.GetBodyByName("link", machine.model.arm)
    base = np.array(ARM_BASE)
    for arm, expected in (
        ((0.0, 0.0), (0.0, 0.0, 2.02)),
        ((0.0, 0.5), (2.02 * math.sin(0.5), 0.0, 2.02 * math.cos(0.5))),
        ((0.5 * math.pi, 0.5), (0.0, 2.02 * math.sin(0.5), 2.02 * math.cos(0.5))),
    ):
        machine.place([0.405] * 4, arm=arm)
        found = machine.in_base(link, tip) - base
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_full_and_reduced_legs_have_the_same_centre_of_mass_over_the_stroke(full, reduced):
    for extension in np.linspace(0.390, 0.420, 7):
        centres = []
        for machine in (full, reduced):
            machine.place([extension] * 4, ground=(0.02, -0.04))
            centre_of = machine.plant.CalcCenterOfMassPositionInWorld
            centres.append([centre_of(machine.context, [leg]) for leg in machine.model.legs])
        np.testing.assert_allclose(centres[0], centres[1], rtol=0, atol=1e-3)


# Masses


def mass_of(machine, keep):
    return sum(body.default_mass() for body in bodies(machine.plant) if keep(body))


def is_arm_link(machine, body):
    return body.name() == "link" and body.model_instance() == machine.model.arm


def is_ground(body):
    return body.name() == "ground"


def test_the_machine_weighs_50_kg_its_arm_1_kg_and_its_legs_alike_in_both_variants(machine):
    legs = mass_of(machine, lambda body: body.model_instance() in machine.model.legs)
    assert legs == pytest.approx(4.0 * 4.2, abs=1e-9)
    assert mass_of(machine, lambda body: is_arm_link(machine, body)) == pytest.approx(1.0)
    rest = mass_of(machine, lambda body: not (is_arm_link(machine, body) or is_ground(body)))
    assert rest == pytest.approx(50.0, abs=1e-9)


def test_centre_of_mass_is_that_of_the_quasi_static_plant(machine):
    params = KinematicPlatformParams()
    machine.place([0.405] * 4)
    masses, moments = 0.0, np.zeros(3)
    for body in bodies(machine.plant):
        if is_ground(body) or is_arm_link(machine, body):
            continue
        com = body.default_spatial_inertia().get_com()
        masses += body.default_mass()
        moments += body.default_mass() * machine.in_base(body, com)
    assert masses == pytest.approx(params.mass, abs=1e-9)
    np.testing.assert_allclose(moments / masses, params.centre_of_mass, rtol=0, atol=0.02)
    link = machine.plant.GetBodyByName("link", machine.model.arm)
    centre = link.default_spatial_inertia().get_com()
    np.testing.assert_allclose(centre, params.arm.links[1].centre, rtol=0, atol=1e-3)


# Contact


def ground_distances(machine):
    """Signed distances of the rollers' spheres to the ground's plane, leg by leg."""
    query = machine.scene
    plane = machine.plant.GetCollisionGeometriesForBody(machine.plant.GetBodyByName("ground"))[0]
    inspector = query.inspector()
    distances = []
    for roller in machine.model.leg_bodies("roller"):
        (sphere,) = machine.plant.GetCollisionGeometriesForBody(roller)
        radius = inspector.GetShape(sphere).radius()
        assert radius == DRAWN.foot_radius
        X_GS = query.GetPoseInWorld(plane).inverse() @ query.GetPoseInWorld(sphere)
        distances.append(X_GS.translation()[2] - radius)
    return np.array(distances)


def test_standing_platform_touches_the_inclined_ground_with_all_rollers(machine):
    rng = np.random.default_rng(7)
    wide = replace(DRAWN, extension_min=0.37, extension_max=0.45)
    for ground in rng.uniform(-0.087, 0.087, (10, 2)):
        posture = (*rng.uniform(-0.02, 0.02, 2), 0.475)
        extension = inverse_kinematics(wide, posture, ground)
        machine.stand(extension, ground)
        np.testing.assert_allclose(ground_distances(machine), 0.0, rtol=0, atol=1e-12)
        slab = machine.pose(machine.plant.GetBodyByName("ground"))
        expected = RigidTransform(RollPitchYaw(*ground, 0.0), np.zeros(3))
        assert slab.IsNearlyEqualTo(expected, 1e-12)
        assert not machine.plant.GetVelocities(machine.context).any()


def test_contact_pairs_on_a_slope_have_the_slopes_normal(machine):
    ground = (0.04, -0.06)
    wide = replace(DRAWN, extension_min=0.37, extension_max=0.45)
    extension = inverse_kinematics(wide, (0.0, 0.0, 0.475), ground)
    machine.stand(extension, ground)
    machine.plant.SetPositions(
        machine.context,
        machine.model.positions(
            extension - 1e-5, forward_kinematics(DRAWN, extension, ground), ground, (0, 0)
        ),
    )
    n = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()[:, 2]
    pairs = machine.scene.ComputePointPairPenetration()
    assert len(pairs) == 4
    for pair in pairs:
        assert abs(pair.nhat_BA_W @ n) == pytest.approx(1.0, abs=1e-12)


def test_machine_meets_the_ground_with_nothing_but_its_rollers_in_its_workspace(machine):
    for d in (0.390, 0.405, 0.419):
        machine.stand([d] * 4, (0.0, 0.0))
        query = machine.scene
        inspector = query.inspector()
        rollers = {body.index() for body in machine.model.leg_bodies("roller")}
        for pair in query.ComputePointPairPenetration():
            frames = [inspector.GetFrameId(geometry) for geometry in (pair.id_A, pair.id_B)]
            touching = {machine.plant.GetBodyFromFrameId(frame).index() for frame in frames}
            assert touching & rollers


def test_wheels_reach_the_ground_at_the_lowest_supported_pose(machine):
    # .420 m is the lowest pose: the platform stands on its wheels, h = .390 m.
    posture = machine.place([0.420] * 4)
    assert posture[2] == pytest.approx(0.390, abs=1e-3)
    wheels = [body for body in bodies(machine.plant) if body.name().startswith("wheel")]
    assert len(wheels) == 4
    for wheel in wheels:
        (tyre,) = machine.plant.GetCollisionGeometriesForBody(wheel)
        radius = machine.scene_graph.model_inspector().GetShape(tyre).radius()
        assert machine.pose(wheel).translation()[2] - radius == pytest.approx(0.0, abs=1e-3)


def test_model_geometry_is_the_papers_with_rollers():
    assert replace(DRAWN, foot_radius=0.0) == PlatformGeometry()
    assert DRAWN.foot_radius == 0.025


def test_every_moving_part_is_drawn(full):
    machine = full
    inspector = machine.scene_graph.model_inspector()
    for name in ("lower_link", "coupler", "roller"):
        for body in machine.model.leg_bodies(name):
            frame = machine.plant.GetBodyFrameIdOrThrow(body.index())
            assert inspector.NumGeometriesForFrameWithRole(frame, Role.kIllustration) > 0
