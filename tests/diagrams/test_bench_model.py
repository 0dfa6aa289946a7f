"""The terrain simulator's bodies against its closed forms: poses, loops, forces, motions."""

import math

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForce,
)
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.terrain_simulator.model import STIFFNESS, add_bench
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    slider_forces,
    slider_places,
    slider_rates,
)
from parapod.systems.terrain_simulator.path import Gait, PlatePath, check_path
from parapod.systems.terrain_simulator.terrain import Level

# Pose in the middle, amplitudes and frequencies of a motion [m, rad, Hz].
PEDAL = ((0.5, 0.28, 0.0), (0.06, 0.03, 0.2), (1.0, 3.0, 2.0))
TREADMILL = ((0.85, 0.19, 0.0), (0.05, 0.02, 0.1), (1.0, 3.0, 2.0))
NAMES = ("rail", "slider_1", "slider_2", "slider_3", "link_1", "link_2", "plate", "tread", "strut")
MOTIONS = {"pedal": PEDAL, "treadmill": TREADMILL}
GEOMETRIES = {"pedal": BenchGeometry.pedal(), "treadmill": BenchGeometry.treadmill()}
BOTH = pytest.mark.parametrize("configuration", MOTIONS)


class Bench:
    """A bench with the diagram that keeps it alive."""

    def __init__(self, configuration, time_step=1e-3, stiffness=STIFFNESS):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
        self.model = add_bench(self.plant, GEOMETRIES[configuration], stiffness)
        self.geometry = self.model.geometry
        self.simulator = Simulator(builder.Build())
        root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(root)
        self.rail = self.plant.GetModelInstanceByName("rail")
        self.middle, self.size, self.frequency = map(np.array, MOTIONS[configuration])

    def motion(self, time):
        """Pose and twist of the plate [m, rad]."""
        rate = 2.0 * math.pi * self.frequency
        pose = self.middle + self.size * np.sin(rate * time)
        return pose, self.size * rate * np.cos(rate * time)

    def lead(self, pose, twist=(0.0, 0.0, 0.0)):
        """Tells the sliders where to be."""
        sliders = slider_places(self.geometry, pose), slider_rates(self.geometry, pose, twist)
        port = self.plant.get_desired_state_input_port(self.rail)
        port.FixValue(self.context, np.concatenate(sliders))

    def follow(self, duration, preview=True):
        """Largest errors of the pose (3) and of the loops [m, m, rad], [m]."""
        self.model.stand(self.context, *self.motion(0.0))
        errors, gaps, step = [], [], self.plant.time_step()
        for k in range(round(duration / step)):
            self.lead(*self.motion((k + preview) * step))
            self.simulator.AdvanceTo((k + 1) * step)
            errors.append(self.model.pose(self.context) - self.motion((k + 1) * step)[0])
            gaps.append(self.model.loop_error(self.context))
        return np.abs(errors).max(axis=0), np.max(gaps)


@BOTH
def test_loops_are_closed_and_the_plate_is_where_it_is_put(configuration):
    bench = Bench(configuration)
    for time in np.linspace(0.0, 1.0, 11):
        pose, _ = bench.motion(time)
        bench.model.stand(bench.context, pose)
        np.testing.assert_allclose(bench.model.pose(bench.context), pose, atol=1e-14)
        assert not bench.plant.GetVelocities(bench.context).any()
        assert bench.model.loop_error(bench.context).max() < 1e-14
        found = [
            bench.plant.GetJointByName(f"slider_{k + 1}").get_translation(bench.context)
            for k in range(3)
        ]
        np.testing.assert_allclose(found, slider_places(bench.geometry, pose), atol=1e-15)


@BOTH
def test_a_loop_that_is_opened_is_told_by_how_much(configuration):
    bench = Bench(configuration)
    bench.model.stand(bench.context, bench.motion(0.1)[0])
    for name, loop in (("slider_2", 0), ("slider_3", 1)):
        joint = bench.plant.GetJointByName(name)
        was = joint.get_translation(bench.context)
        joint.set_translation(bench.context, was + 1e-3)
        assert bench.model.loop_error(bench.context)[loop] == pytest.approx(1e-3)
        joint.set_translation(bench.context, was)


@BOTH
def test_velocities_are_those_of_the_twist_and_keep_the_loops_closed(configuration):
    bench = Bench(configuration)
    pose, twist = bench.motion(0.07)
    bench.model.stand(bench.context, pose, twist)
    plate = bench.plant.GetBodyByName("plate")
    velocity = plate.EvalSpatialVelocityInWorld(bench.context)
    assert velocity.rotational() == pytest.approx((0.0, twist[2], 0.0), abs=1e-12)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, z = bench.geometry.p_OP
    arm = np.array((c * x + s * z, 0.0, c * z - s * x))
    expected = np.array((twist[0], 0.0, twist[1])) + np.cross((0.0, twist[2], 0.0), arm)
    np.testing.assert_allclose(velocity.translational(), expected, atol=1e-12)
    # A little later the loops are as closed as the square of the time allows.
    for short in (1e-3, 5e-4):
        q = bench.plant.GetPositions(bench.context) + short * bench.plant.GetVelocities(
            bench.context
        )
        moved = bench.plant.CreateDefaultContext()
        bench.plant.SetPositions(moved, q)
        assert bench.model.loop_error(moved).max() < 40.0 * short**2


@BOTH
@pytest.mark.parametrize("load", [(100.0, -500.0, 0.0), (-200.0, 0.0, 10.0)])
def test_sliders_hold_a_load_as_statics_say(configuration, load):
    bench = Bench(configuration, stiffness=PdControllerGains(p=1e9, d=1e5))
    pose = bench.middle + np.array((0.02, 0.01, 0.05))
    held = []
    for share in (0.0, 1.0):
        force = ExternallyAppliedSpatialForce()
        force.body_index = bench.plant.GetBodyByName("plate").index()
        force.p_BoBq_B = -np.array((bench.geometry.p_OP[0], 0.0, bench.geometry.p_OP[1]))
        f_x, f_z, m_y = share * np.array(load)
        force.F_Bq_W = SpatialForce(np.array((0.0, m_y, 0.0)), np.array((f_x, 0.0, f_z)))
        bench.plant.get_applied_spatial_force_input_port().FixValue(bench.context, [force])
        bench.simulator.get_mutable_context().SetTime(0.0)
        bench.model.stand(bench.context, pose)
        bench.lead(pose)
        bench.simulator.Initialize()
        bench.simulator.AdvanceTo(0.1)
        port = bench.plant.get_net_actuation_output_port()
        held.append(port.Eval(bench.context).copy())
    expected = slider_forces(bench.geometry, pose, load)
    np.testing.assert_allclose(held[1] - held[0], expected, atol=1e-3 * np.abs(expected).max())


@BOTH
def test_a_plate_led_one_step_ahead_is_where_it_is_to_be(configuration):
    (x, z, phi), gap = Bench(configuration).follow(0.5)
    assert max(x, z) < 1e-4
    assert math.degrees(phi) < 0.01
    assert gap < 2e-5


def test_the_pedal_follows_a_walking_trot():
    path = PlatePath(Level(), Gait(1.5, ramp=0.28), x_c=0.513, z_c=0.30)
    bench = Bench("pedal")
    check_path(bench.geometry, path)
    bench.motion = lambda time: path.at(time)[:2]
    (x, z, phi), gap = bench.follow(1.0)
    assert max(x, z) < 1e-4
    assert math.degrees(phi) < 0.01
    assert gap < 2e-5


def test_without_looking_ahead_a_plate_is_late_by_a_step():
    bench = Bench("pedal")
    (x, z, _), _ = bench.follow(0.5, preview=False)
    fastest = bench.size * 2.0 * math.pi * bench.frequency
    assert x == pytest.approx(1e-3 * fastest[0], rel=0.15)
    assert z == pytest.approx(1e-3 * fastest[1], rel=0.15)


@BOTH
def test_loops_close_four_times_as_well_at_half_the_step(configuration):
    coarse, fine = (Bench(configuration, step).follow(0.35)[1] for step in (4e-3, 2e-3))
    assert coarse / fine == pytest.approx(4.0, rel=0.15)


@BOTH
def test_the_plate_alone_can_be_touched_and_its_middle_is_on_its_surface(configuration):
    bench = Bench(configuration)
    plant = bench.plant
    touched = {
        name: plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name)) for name in NAMES
    }
    assert [name for name, found in touched.items() if found] == ["tread"]
    (surface,) = touched["tread"]
    inspector = bench.scene_graph.model_inspector()
    box, X_PB = inspector.GetShape(surface), inspector.GetPoseInFrame(surface)
    x, z = bench.geometry.p_OP
    assert box.width() == bench.geometry.plate
    top = X_PB.translation() + np.array((0.0, 0.0, 0.5 * box.height()))
    np.testing.assert_allclose(top, (-x, 0.0, -z), atol=1e-12)
