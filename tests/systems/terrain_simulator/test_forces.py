"""Force cells, slider currents, and the drive that plays the other legs."""

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.model import add_bench
from parapod.systems.core.physics import GRAVITY
from parapod.systems.terrain_simulator.cells import (
    cell_forces,
    inertial_load,
    load_of_cells,
)
from parapod.systems.terrain_simulator.hip_support import HipSupport, HipSupportParams
from parapod.systems.terrain_simulator.kinematics import slider_forces, slider_rates
from parapod.systems.terrain_simulator.load_estimator import (
    drive_forces,
    load_of_drives,
)

POSES = {"pedal": (0.5, 0.28, 0.1), "treadmill": (0.85, 0.19, 0.05)}
BENCHES = {name: BenchDesign(configuration=name) for name in POSES}
both = pytest.mark.parametrize("configuration", POSES)
STILL = np.zeros(6)


@both
def test_cells_and_loads_are_inverse_to_each_other(configuration):
    load = np.random.default_rng(0).uniform(-500.0, 500.0, (20, 3))
    cells = BENCHES[configuration].cells_geometry
    np.testing.assert_allclose(load_of_cells(cells, cell_forces(cells, load)), load, atol=1e-9)


def test_a_weight_at_the_front_presses_the_front_cell_alone():
    cells = BENCHES["pedal"].cells_geometry
    load = np.array((0.0, -100.0, 100.0 * cells.apart))
    np.testing.assert_allclose(cell_forces(cells, load), (0.0, 100.0, 0.0), atol=1e-9)


@both
def test_a_tread_at_rest_weighs_on_its_cells(configuration):
    cells = BENCHES[configuration].cells_geometry
    load = inertial_load(cells, np.concatenate((POSES[configuration][:2], [0.0], STILL)))
    np.testing.assert_allclose(load, (0.0, -cells.mass * GRAVITY, 0.0), atol=1e-12)


def test_a_tread_that_falls_freely_does_not_weigh():
    motion = np.concatenate(((0.5, 0.28, 0.3), np.zeros(3), (0.0, -GRAVITY, 0.0)))
    np.testing.assert_allclose(
        inertial_load(BENCHES["pedal"].cells_geometry, motion), 0.0, atol=1e-12
    )


@both
def test_a_tread_in_motion_loads_its_cells_by_newton_and_euler(configuration):
    """Its centre of mass follows from the pose alone, and its acceleration from differences."""
    cells, random = BENCHES[configuration].cells_geometry, np.random.default_rng(0)
    pose, rate, jerked = random.uniform(-1.0, 1.0, (3, 3)) * ((1.0,), (3.0,), (20.0,))

    def turn(phi):  # about y: the front end goes down
        return np.array(((np.cos(phi), np.sin(phi)), (-np.sin(phi), np.cos(phi))))

    def centre(time):
        x, z, phi = pose + rate * time + 0.5 * jerked * time**2
        return np.array((x, z)) + turn(phi) @ cells.centre

    step = 1e-4
    acceleration = (centre(step) - 2.0 * centre(0.0) + centre(-step)) / step**2
    force = -cells.mass * (acceleration + np.array((0.0, GRAVITY)))
    arm = centre(0.0) - pose[:2]
    moment = arm[1] * force[0] - arm[0] * force[1] - cells.inertia * jerked[2]
    load = inertial_load(cells, np.concatenate((pose, rate, jerked)))
    np.testing.assert_allclose(load, (*(turn(pose[2]).T @ force), moment), rtol=1e-5, atol=1e-5)


@both
def test_drives_push_as_rigid_bodies_need_it(configuration):
    """Against Drake's inverse dynamics of the tree, projected onto the sliders."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    model = add_bench(plant, BENCHES[configuration].geometry)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context, geometry = plant.GetMyMutableContextFromRoot(root), model.geometry
    random, step = np.random.default_rng(1), 1e-5
    for _ in range(4):
        pose = np.array(POSES[configuration]) + random.uniform(-0.03, 0.03, 3)
        twist, change = random.uniform(-1, 1, 3), random.uniform(-8, 8, 3)
        load = random.uniform(-300.0, 300.0, 3)
        model.stand(context, pose, twist)

        def rates(t, pose=pose, twist=twist, change=change):
            where = pose + twist * t + 0.5 * change * t * t
            return model.motion(where, twist + change * t)[1]

        accelerations = np.zeros(plant.num_velocities())
        accelerations[model.order] = (rates(step) - rates(-step)) / (2.0 * step)
        gravity = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, gravity)
        torque = plant.CalcInverseDynamics(context, accelerations, gravity)[model.order]
        by_pose = np.array([model.motion(pose, unit)[1] for unit in np.eye(3)])
        by_twist = slider_rates(geometry, pose, np.eye(3)).T
        needed = np.linalg.solve(by_twist.T, by_pose @ torque - load)
        motion = np.concatenate((pose, twist, change))
        found = drive_forces(geometry, BENCHES[configuration].masses, motion, load)
        np.testing.assert_allclose(found, needed, rtol=1e-6, atol=1e-3)
        back = load_of_drives(geometry, BENCHES[configuration].masses, motion, found)
        np.testing.assert_allclose(back, load, atol=1e-9)


@both
def test_at_rest_drives_differ_by_the_statics_of_the_load(configuration):
    geometry, masses = BENCHES[configuration].geometry, BENCHES[configuration].masses
    motion = np.concatenate((POSES[configuration], STILL))
    load = np.array((20.0, -600.0, 15.0))
    more = drive_forces(geometry, masses, motion, load)
    more -= drive_forces(geometry, masses, motion, np.zeros(3))
    np.testing.assert_allclose(more, slider_forces(geometry, motion[:3], load), rtol=1e-9)


def test_the_slides_drive_holds_the_height_and_lets_a_lasting_force_go():
    params = HipSupportParams(stiffness=1e4, damping=0.0, washout=0.2, largest=500.0)
    support = HipSupport(params, 0.01)
    context = support.CreateDefaultContext()
    for name, value in (
        ("hip_force", [40.0]),
        ("hip_desired", [0.9, 0.0]),
        ("hip_measured", [0.89]),
        ("hip_rate", [0.0]),
    ):
        support.GetInputPort(name).FixValue(context, value)
    port = support.get_output_port()
    assert port.Eval(context)[0] == pytest.approx(140.0)
    for _ in range(20):
        state = support.EvalUniquePeriodicDiscreteUpdate(context)
        context.SetDiscreteState(0, state.value(0).copy())
    assert port.Eval(context)[0] == pytest.approx(40.0 + 100.0 * np.exp(-1.0), rel=1e-6)
    support.GetInputPort("hip_measured").FixValue(context, [0.7])
    assert port.Eval(context)[0] == 500.0, "its largest force"
    support.GetInputPort("hip_measured").FixValue(context, [0.95])
    assert port.Eval(context)[0] < -400.0
