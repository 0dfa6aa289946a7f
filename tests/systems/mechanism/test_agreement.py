"""Numerical mechanisms against closed forms: each proves the other."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.model import DRAWN, add_platform
from parapod.diagrams.machining_centre.model import add_centre
from parapod.diagrams.terrain_simulator.model import add_bench
from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.mechanism.equations import pose_vector
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.statics import motor_forces
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.masses import Passenger
from tests.systems.mechanism.conftest import MODELS, example_module

closed_rps: Any = example_module("three_rps/parapod_three_rps/kinematics.py")
POSES = 12
UPRIGHT = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5)


def empty_plant() -> Any:
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1e-3)
    return plant


def platform(random: np.random.Generator) -> tuple[Any, str, Iterator[Any]]:
    plant = empty_plant()
    model = add_platform(plant)
    low, high = DRAWN.extension_min, DRAWN.extension_max
    extensions = random.uniform(low + 0.01, high - 0.01, (POSES, 4))
    return plant, "roller", (model.positions_at(d, UPRIGHT) for d in extensions)


def chair(random: np.random.Generator) -> tuple[Any, str, Iterator[Any]]:
    plant = empty_plant()
    model = add_chair(plant, Passenger())
    leg = model.geometry.leg
    middle = np.array((0.0, 0.0, -leg.retracted_height - 0.5 * leg.stroke))
    feet = middle + 0.2 * leg.stroke * random.uniform(-1.0, 1.0, (POSES, 4, 3))
    return plant, "foot", (model.positions(leg_inverse(leg, foot), UPRIGHT) for foot in feet)


def centre(random: np.random.Generator) -> tuple[Any, str, Iterator[Any]]:
    plant = empty_plant()
    geometry = CentreGeometry()
    model = add_centre(plant, geometry)
    middle = 0.5 * (geometry.stroke_min + geometry.stroke_max)
    spread = np.array((*[0.08 * middle] * 3, 0.08, 0.08, 0.08))
    poses = (0.0, 0.0, middle, 0.0, 0.0, 0.0) + spread * random.uniform(-1.0, 1.0, (POSES, 6))
    return plant, "platform", (model.positions(pose) for pose in poses)


def bench(random: np.random.Generator) -> tuple[Any, str, Iterator[Any]]:
    plant = empty_plant()
    geometry = BenchGeometry.treadmill()
    model = add_bench(plant, geometry)
    middle = 0.5 * (geometry.slider_min + geometry.slider_max)
    height = np.sqrt(0.5) * geometry.link
    poses = (middle, height, 0.02) + random.uniform(-1.0, 1.0, (POSES, 3)) * (0.1, 0.05, 0.05)
    context = plant.CreateDefaultContext()

    def positions(pose: np.ndarray) -> Any:
        model.stand(context, pose)
        return plant.GetPositions(context)

    return plant, "plate", (positions(pose) for pose in poses)


MACHINES = {"platform": platform, "chair": chair, "centre": centre, "bench": bench}


@pytest.mark.parametrize("name", MACHINES)
def test_motors_of_machines_lead_to_the_poses_of_their_closed_forms(name):
    plant, _, poses = MACHINES[name](np.random.default_rng(3))
    mechanism = Mechanism(plant)
    q, *others = list(poses)
    assert np.abs(mechanism.residual(q)).max() < 1e-9
    for pose in others:
        way = mechanism.forward(mechanism.motor_positions(pose), near=q)
        np.testing.assert_allclose(way, pose, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["centre", "bench"])
def test_inverse_kinematics_of_machines_are_those_of_their_closed_forms(name):
    plant, frame, poses = MACHINES[name](np.random.default_rng(4))
    mechanism = Mechanism(plant)
    q, *others = list(poses)
    for pose in others:
        goal = pose_vector(mechanism.pose(frame, pose))
        if name == "bench":  # a plane machine: its other three are what they are
            goal[[1, 3, 5]] = np.nan
        way = mechanism.inverse(frame, goal, near=q)
        np.testing.assert_allclose(way, pose, rtol=0.0, atol=1e-9)


def rps_goal(geometry: Any, pose: np.ndarray) -> np.ndarray:
    """Height, roll and pitch of the platform at a pose of the closed form."""
    tilt = float(np.hypot(*pose[:2]))
    axis = np.array((*pose[:2], 0.0)) / tilt if tilt else np.array((1.0, 0.0, 0.0))
    roll, pitch, _ = RollPitchYaw(RotationMatrix(AngleAxis(tilt, axis))).vector()
    return np.array((np.nan, np.nan, pose[2], roll, pitch, np.nan))


def rps_poses() -> np.ndarray:
    random = np.random.default_rng(5)
    return random.uniform((-0.3, -0.3, 0.45), (0.3, 0.3, 0.55), (40, 3))


def test_legs_of_the_3_rps_are_as_long_as_in_closed_form():
    mechanism, geometry = Mechanism.load(MODELS / "three_rps.urdf"), closed_rps.Geometry()
    near = mechanism.inverse("platform", (np.nan, np.nan, 0.5, 0.0, 0.0, np.nan))
    poses = rps_poses()
    goals = np.array([rps_goal(geometry, pose) for pose in poses])
    rows, is_closed = mechanism.inverse_rows("platform", goals, near)
    assert is_closed.all()
    lengths = closed_rps.inverse(geometry, poses)
    np.testing.assert_allclose(mechanism.motor_positions(rows), lengths, rtol=0.0, atol=1e-9)
    for goal, length in zip(goals, lengths, strict=True):
        q = mechanism.inverse("platform", goal, near)
        np.testing.assert_allclose(mechanism.motor_positions(q), length, rtol=0.0, atol=1e-9)
    back, is_closed = mechanism.forward_rows(lengths, near)
    assert is_closed.all()
    np.testing.assert_allclose(back, rows, rtol=0.0, atol=1e-9)


def test_legs_of_the_3_rps_carry_what_they_do_in_closed_form():
    mechanism, geometry = Mechanism.load(MODELS / "three_rps.urdf"), closed_rps.Geometry()
    near = mechanism.inverse("platform", (np.nan, np.nan, 0.5, 0.0, 0.0, np.nan))
    for pose in rps_poses()[:5]:
        q = mechanism.inverse("platform", rps_goal(geometry, pose), near)
        held = motor_forces(mechanism, q)
        # The closed form takes its Jacobian by differences, and 9.81 for Drake's 9.81.
        closed = closed_rps.leg_forces(geometry, pose)
        np.testing.assert_allclose(held.forces, closed, rtol=1e-7)
        assert held.unheld < 1e-9


def test_pose_vectors_are_those_of_their_transforms():
    pose = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(pose_vector(pose), [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], atol=1e-15)
