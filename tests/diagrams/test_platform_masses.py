"""The masses in closed form are those of the plant that is built."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.core.scenario_file import load_scenario

LARGE = Path(__file__).parents[2] / "examples" / "machines" / "large_platform.yaml"
DESIGNS = {
    "paper": PlatformDesign(),
    "large": load_scenario(LevellingScenario, machine=LARGE).machine,
}


@pytest.mark.parametrize("name", DESIGNS)
def test_the_plant_weighs_as_the_closed_form_says(name):
    design = DESIGNS[name]
    masses = design.masses
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    model = add_platform(plant, geometry=design.geometry, structure=design.structure)
    context = plant.CreateDefaultContext()
    geometry = design.geometry
    middle = np.full(4, 0.5 * (geometry.extension_min + geometry.extension_max))
    upright = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    plant.SetPositions(context, model.positions_at(middle, upright, (0.0, 0.0)))
    joints = [plant.GetJointByName(joint.name) for joint in masses.arm.joints]
    arm = plant.GetBodiesKinematicallyAffectedBy([joint.index() for joint in joints])
    ground = plant.GetBodyByName("ground").index()
    others = [
        index
        for index in map(BodyIndex, range(1, plant.num_bodies()))
        if index not in arm and index != ground
    ]
    inertia = plant.CalcSpatialInertia(context, model.base.body_frame(), others)
    assert inertia.get_mass() == pytest.approx(masses.mass, rel=1e-12)
    np.testing.assert_allclose(
        inertia.get_com(), masses.centre_of_mass, rtol=0.0, atol=1e-12 * design.size
    )
    moved = plant.CalcSpatialInertia(context, model.base.body_frame(), arm)
    assert moved.get_mass() == pytest.approx(masses.arm.mass, rel=1e-12)
    centre = masses.arm.centre_of_mass((0.0, 0.0))
    np.testing.assert_allclose(moved.get_com(), centre, atol=1e-12 * design.size)
