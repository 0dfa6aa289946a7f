"""The walking chair's files against the closed-form kinematics, and the model that they make."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.model import ChairPose, ChairTruth
from parapod.systems.walking_chair.payload import FORCE_LIMIT

CHAIR_GEOMETRY = ChairGeometry()

LEG = CHAIR_GEOMETRY.leg
GAIT = TrotGait()


class Machine:
    """A chair with the diagram that keeps it alive."""

    def __init__(self, passenger=Passenger()):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self.model = add_chair(self.plant, passenger)
        self.truth = builder.AddSystem(ChairTruth(self.model))
        builder.Connect(
            self.plant.get_body_poses_output_port(), self.truth.GetInputPort("body_poses")
        )
        builder.Connect(
            self.plant.get_contact_results_output_port(),
            self.truth.GetInputPort("contact_results"),
        )
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def place(self, time, body_position=None, passenger=Passenger()):
        lengths = gait_branches(CHAIR_GEOMETRY, GAIT, time).length
        if body_position is None:
            body_position = gait_motion(CHAIR_GEOMETRY, GAIT, time).body.position
        self.model.stand(self.context, lengths, body_position, passenger)
        return lengths, np.asarray(body_position)

    def pose(self, body):
        return self.plant.EvalBodyPoseInWorld(self.context, body)

    def shown(self, name):
        context = self.truth.GetMyContextFromRoot(self.root)
        return self.truth.GetOutputPort(name).Eval(context)


@pytest.fixture(scope="module")
def machine():
    return Machine()


@pytest.mark.parametrize("time", [0.0, 7.5, 17.5])
def test_feet_and_loops_of_the_files_are_where_the_closed_form_has_them(machine, time):
    lengths, position = machine.place(time)
    corners = foot_corners(CHAIR_GEOMETRY, position, np.eye(3), lengths)
    for leg, foot in enumerate(machine.model.feet):
        found = (machine.pose(foot) @ LEG.corners.T).T
        np.testing.assert_allclose(found, corners[leg], rtol=0, atol=1e-12)
        for ball, rod in zip(LEG.lower_joints[1:], machine.model.rods(leg), strict=True):
            gap = machine.pose(rod).translation() - machine.pose(foot) @ ball
            np.testing.assert_allclose(gap, 0.0, atol=1e-12)


BRANCHES = ("up", "ups_2", "ups_3")


def test_joint_positions_of_the_actuators_are_the_lengths_and_reach_beyond_the_strokes(machine):
    lengths, _ = machine.place(7.5)
    for leg, instance in enumerate(machine.model.legs):
        joints = [machine.plant.GetJointByName(f"{name}_length", instance) for name in BRANCHES]
        found = [joint.get_translation(machine.context) for joint in joints]
        np.testing.assert_allclose(found, lengths[leg], rtol=0, atol=1e-12)
        for joint, (low, high) in zip(joints, LEG.strokes, strict=True):
            assert joint.position_lower_limit() < low
            assert joint.position_upper_limit() > high


def test_actuators_are_in_the_order_of_the_branches_and_as_strong_as_the_papers(machine):
    plant = machine.plant
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]
    names = [(actuator.model_instance(), actuator.name()) for actuator in actuators]
    assert names == [(leg, f"{name}_drive") for leg in machine.model.legs for name in BRANCHES]
    assert {actuator.effort_limit() for actuator in actuators} == {FORCE_LIMIT}


def test_masses_of_the_files_are_those_of_the_statics(machine):
    masses, plant = ChairMasses(), machine.plant
    context = plant.CreateDefaultContext()

    def mass(name, leg=0):
        instance = machine.model.legs[leg]
        return plant.GetBodyByName(name, instance).get_mass(context)

    for leg in range(4):
        assert mass("upper_platform", leg) == pytest.approx(masses.upper_platform)
        assert mass("foot", leg) == pytest.approx(masses.foot)
        for branch in BRANCHES:
            assert mass(f"{branch}_yoke", leg) == pytest.approx(masses.yoke)
            assert mass(f"{branch}_cylinder", leg) == pytest.approx(masses.cylinder)
        for branch in BRANCHES[1:]:
            assert mass(f"{branch}_rod", leg) == pytest.approx(masses.rod)
    body = machine.model.body
    assert body.get_mass(context) == pytest.approx(masses.body)
    height = body.CalcCenterOfMassInBodyFrame(context)[2]
    assert height == pytest.approx(masses.body_height)
    everything = [*machine.model.legs, body.model_instance()]
    total = plant.CalcTotalMass(context, everything)
    assert total == pytest.approx(49.2)  # as weighed, Fig. 19
    assert masses.total == pytest.approx(49.2)


def test_the_passenger_is_as_heavy_and_where_the_scenario_says_or_not_even_drawn(machine):
    passenger = Passenger(80.0, 0.03, -0.05, 0.4)
    _, position = machine.place(2.5, passenger=passenger)
    body = machine.model.passenger
    assert body.get_mass(machine.context) == pytest.approx(80.0)
    place = machine.pose(body).translation() - position
    np.testing.assert_allclose(place, passenger.place, atol=1e-12)
    assert machine.plant.GetVisualGeometriesForBody(body)
    empty = Machine(Passenger(0.0))
    empty.place(0.0, passenger=Passenger(0.0))
    assert empty.model.passenger.get_mass(empty.context) == 0.0
    assert not empty.plant.GetVisualGeometriesForBody(empty.model.passenger)


def test_truth_shows_the_pose_the_feet_and_the_gaps(machine):
    _, position = machine.place(7.5)
    np.testing.assert_allclose(machine.shown("body_position"), position, atol=1e-12)
    np.testing.assert_allclose(machine.shown("body_attitude"), 0.0, atol=1e-12)
    heights = machine.shown("foot_height").reshape(4, 3)
    motion = gait_motion(CHAIR_GEOMETRY, GAIT, 7.5)
    lowest = motion.feet.position[:, 2]
    np.testing.assert_allclose(heights.min(axis=1), lowest, atol=1e-9)
    np.testing.assert_allclose(machine.shown("loop_error"), 0.0, atol=1e-12)
    leg = machine.model.legs[2]
    joint = machine.plant.GetJointByName("ups_3_length", leg)
    joint.set_translation(machine.context, joint.get_translation(machine.context) + 1e-4)
    gaps = machine.shown("loop_error")
    assert gaps[5] == pytest.approx(1e-4, rel=1e-6)
    assert np.delete(gaps, 5).max() < 1e-12


def test_truth_shows_attitudes(machine):
    machine.place(0.0)
    tilted = RigidTransform(RollPitchYaw(0.02, -0.03, 0.4), np.array((1.0, 2.0, 3.0)))
    machine.plant.SetFreeBodyPose(machine.context, machine.model.body, tilted)
    np.testing.assert_allclose(machine.shown("body_attitude"), (0.02, -0.03, 0.4), atol=1e-12)
    np.testing.assert_allclose(machine.shown("body_position"), (1.0, 2.0, 3.0), atol=1e-12)


def test_drawn_positions_are_the_models(machine, stand):
    lengths, position = machine.place(7.5)
    expected = machine.plant.GetPositions(machine.context)
    pose = stand(
        ChairPose(machine.model),
        position=lengths.ravel(),
        body_pose=(1.0, 0.0, 0.0, 0.0, *position),
    )
    np.testing.assert_array_equal(pose["positions"], expected)


def test_feet_have_contact_at_their_corners_only(machine):
    inspector = machine.scene_graph.model_inspector()
    for foot in machine.model.feet:
        ids = machine.plant.GetCollisionGeometriesForBody(foot)
        lowest = []
        for geometry in ids:
            radius = inspector.GetShape(geometry).radius()
            place = inspector.GetPoseInFrame(geometry).translation()
            lowest.append(place - (0.0, 0.0, radius))
        np.testing.assert_allclose(
            sorted(map(tuple, lowest)), sorted(map(tuple, LEG.corners)), rtol=0, atol=1e-9
        )
