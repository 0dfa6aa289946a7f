"""Shapes of a rod that bends, where they are drawn."""

import numpy as np
import pytest
from pydrake.geometry import Box, Cylinder, Role, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia

from parapod.systems.arm.bent_rod import BentRod
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.flexible_rod import FlexibleRod

ROD = FlexibleRod()
COLOUR = np.array([0.5, 0.5, 0.5, 1.0])
CLAMP = np.array([*RollPitchYaw(0.1, 0.4, -0.7).ToQuaternion().wxyz(), 0.3, -0.2, 1.1])


@pytest.fixture
def drawing():
    """The system, its context, and poses of the shapes by their names."""
    plant, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    link = plant.AddRigidBody("link", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    shapes = {
        "tube": (Cylinder(0.01, ROD.length), (0.0, 0.0, 0.5 * ROD.length)),
        "hub": (Box(0.1, 0.1, 0.1), (0.0, 0.0, 0.0)),
        "camera": (Box(0.09, 0.07, 0.06), (0.01, 0.0, ROD.length)),
    }
    for name, (shape, place) in shapes.items():
        plant.RegisterVisualGeometry(link, RigidTransform(np.array(place)), shape, name, COLOUR)
    plant.Finalize()
    bent = BentRod(ROD, plant, link, scene_graph)
    frame = plant.GetBodyFrameIdOrThrow(link.index())
    inspector = scene_graph.model_inspector()
    assert not inspector.GetGeometries(frame, Role.kIllustration)
    context = bent.CreateDefaultContext()
    names = {inspector.GetName(frame): frame for frame in inspector.GetAllFrameIds()}

    def poses(clamp, modal):
        bent.GetInputPort("clamp_pose").FixValue(context, clamp)
        bent.GetInputPort("modal_state").FixValue(context, modal)
        value = bent.get_output_port().Eval(context)
        return {name: value.value(f) for name, f in names.items() if value.has_id(f)}

    return poses


def test_straight_rod_is_drawn_as_the_rigid_link_was(drawing):
    poses = drawing(CLAMP, np.zeros(8))
    assert len(poses) == 2 + 16
    X_WL = RigidTransform(RollPitchYaw(0.1, 0.4, -0.7), CLAMP[4:])
    for name, place in (("hub_0", (0.0, 0.0, 0.0)), ("camera_0", (0.01, 0.0, ROD.length))):
        expected = X_WL.multiply(RigidTransform(np.array(place)))
        assert poses[name].IsNearlyEqualTo(expected, 1e-9)
    middles = [X_WL.inverse() @ poses[f"tube_{i}"].translation() for i in range(16)]
    heights = (np.arange(16) + 0.5) / 16 * ROD.length
    np.testing.assert_allclose(middles, [[0.0, 0.0, z] for z in heights], atol=1e-9)


def test_what_is_at_the_tip_is_where_the_arm_has_it(drawing):
    arm = FlexibleArm(ROD, base_pose=CLAMP)
    context = arm.CreateDefaultContext()
    arm.GetInputPort("base_pose").FixValue(context, CLAMP)
    arm.GetInputPort("joint_state").FixValue(context, [])
    modal = np.array([0.08, 0.001, -0.05, 0.002, 0.0, 0.0, 0.0, 0.0])
    state = context.get_discrete_state(0).value().copy()
    state[:8] = modal
    context.SetDiscreteState(0, state)
    tip = arm.GetOutputPort("tip_pose").Eval(context)
    poses = drawing(CLAMP, modal)
    behind = poses["camera_0"] @ np.array([-0.01, 0.0, 0.0])
    # Its way towards the clamp, some millimetres, is not drawn.
    np.testing.assert_allclose(behind, tip[4:], atol=5e-3)
    # Neighbours meet: pieces turn with the rod.
    ends = [
        (poses[f"tube_{i}"] @ np.array([0.0, 0.0, s * ROD.length / 32]))
        for i in range(16)
        for s in (-1.0, 1.0)
    ]
    gaps = [np.linalg.norm(a - b) for a, b in zip(ends[1::2], ends[2::2], strict=False)]
    assert max(gaps) < 1e-3


def test_numbers_that_are_not_finite_draw_it_at_the_origin(drawing):
    poses = drawing(np.full(7, np.nan), np.zeros(8))
    assert all(pose.IsExactlyIdentity() for pose in poses.values())
