"""The simulated plants against each other, against the kinematic model and against statics."""

import math
from functools import cache

import numpy as np
import pytest
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    LevellingScenario,
)
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_motion, foot_to_centre
from parapod.systems.levelling_platform.model import (
    ParallelLinks,
    PlatformPose,
    PlatformTruth,
    standing_pose,
)
from parapod.systems.levelling_platform.plane import normal_of, to_platform

VARIANTS = ("full", "reduced")
BEGIN = 0.5  # of the levelling [s]
STOOD = 0.4  # when the platform has settled on its feet [s]
GRAVITY = 9.81
GROUND = (0.03, -0.05)
LOG = (
    "truth.posture",
    "truth.extension",
    "truth.contact_force",
    "truth.load_force",
    "truth.loop_error",
)


# Motion: two seconds of levelling on a slope of 5 deg, with ideal sensors


def perfect_scenario(ground=(0.0, 5.0), **plant):
    scenario = LevellingScenario(ground=GroundScenario(*ground))
    scenario.machine.sensors = SensorScenario(0.0, False, 0.0, 0.0)
    scenario.machine.actuators.gain_error = 0.0
    scenario.job.estimate_at = BEGIN
    for key, value in plant.items():
        setattr(scenario.plant, key, value)
    return scenario


@pytest.fixture(scope="module")
def levelling(record):
    """levelling(leg_model, time_step): signals of the run."""
    runs = {}

    def get(leg_model="full", time_step=1e-3):
        key = leg_model, time_step
        if key not in runs:
            scenario = perfect_scenario(leg_model=leg_model, time_step=time_step)
            recording = record(ClosedLoop(PLATFORM, scenario, log=LOG), BEGIN + 2.2)
            runs[key] = dict(recording) | {"t": recording.time}
        return runs[key]

    return get


def test_short_run_moves_the_platform(levelling):
    signals = levelling()
    assert np.degrees(np.ptp(signals["truth.posture"][:, 1])) > 1.0
    assert np.ptp(signals["truth.extension"], axis=0).min() > 1e-3


@pytest.mark.parametrize("variant", VARIANTS)
def test_moving_multibody_plant_agrees_with_the_kinematic_model(levelling, variant):
    signals = levelling(variant)
    later = signals["t"] > STOOD
    predicted = forward_kinematics(DRAWN, signals["truth.extension"], (0.0, math.radians(5.0)))
    error = np.abs(signals["truth.posture"] - predicted)[later].max(axis=0)
    assert np.degrees(error[:2]).max() <= 0.02
    assert error[2] <= 1e-4


def test_loops_stay_closed(levelling):
    signals = levelling()
    assert signals["truth.loop_error"][signals["t"] > STOOD].max() <= 5e-6


def test_reduced_legs_move_the_platform_as_full_ones_do(levelling):
    full, reduced = levelling("full"), levelling("reduced")
    later = full["t"] > STOOD
    difference = np.abs(full["truth.posture"] - reduced["truth.posture"])[later].max(axis=0)
    assert np.degrees(difference[:2]).max() <= 0.02
    assert difference[2] <= 1.5e-4


def test_reduced_legs_have_no_gap_in_their_loops(levelling):
    np.testing.assert_array_equal(levelling("reduced")["truth.loop_error"], 0.0)


# Forces at rest


class Standing:
    """A multibody station that has come to rest on its feet without voltage."""

    def __init__(self, machine):
        self.ground = machine.station.scenario.ground.inclination
        self.model, self.read = machine.station.behind.handle.plant.model, machine.read
        machine.run(STOOD)

    def leg_weights(self, extension):
        """Potential energy of each leg's own parts if the platform were held [J]."""
        plant = self.model.plant
        context = plant.CreateDefaultContext()
        q = self.model.positions(extension, self.read("truth.posture"), self.ground, (0.0, 0.0))
        plant.SetPositions(context, q)
        energies = []
        for leg in self.model.legs:
            bodies = [plant.get_body(i) for i in plant.GetBodyIndices(leg)]
            heights = [
                (body.EvalPoseInWorld(context) @ body.default_spatial_inertia().get_com())[2]
                for body in bodies
            ]
            masses = [body.default_mass() for body in bodies]
            energies.append(GRAVITY * float(np.dot(masses, heights)))
        return np.array(energies)


@pytest.fixture(scope="module")
def standing(make_machine):
    """standing(variant, ground): see `Standing`."""
    return cache(
        lambda variant, ground: Standing(make_machine(perfect_scenario(ground, leg_model=variant)))
    )


at_rest = pytest.mark.parametrize("ground", [(0.0, 0.0), (2.0, 3.0)], ids=str)


@pytest.mark.parametrize("variant", VARIANTS)
@at_rest
def test_contact_forces_at_rest_carry_the_weight(standing, variant, ground):
    machine = standing(variant, ground)
    plant = machine.model.plant
    mass = plant.CalcTotalMass(plant.CreateDefaultContext())
    mass -= plant.GetBodyByName("ground").default_mass()
    normal = normal_of(*machine.ground)[2]
    total = machine.read("truth.contact_force").sum()
    assert mass == pytest.approx(51.0, abs=0.01)
    assert total == pytest.approx(mass * GRAVITY * normal, rel=0.01)


@pytest.mark.parametrize("variant", VARIANTS)
@at_rest
def test_actuators_at_rest_hold_what_virtual_work_demands(standing, variant, ground):
    # A rod that extends lifts its foot towards the platform, and with it the leg's own parts;
    # what it must hold is the foot's share of the weight less those.
    machine = standing(variant, ground)
    extension = machine.read("truth.extension")
    roll, pitch, _ = machine.read("truth.posture")
    g = np.array(to_platform(normal_of(*machine.ground), roll, pitch))
    transmission = np.array(
        [g @ foot_motion(leg, d)[1] for leg, d in zip(DRAWN.legs, extension.tolist(), strict=True)]
    )
    step = 1e-5
    own = (machine.leg_weights(extension + step) - machine.leg_weights(extension - step)) / (
        2.0 * step
    )
    expected = machine.read("truth.contact_force") * transmission + own
    np.testing.assert_allclose(machine.read("truth.load_force"), expected, rtol=0.03)


@pytest.fixture
def quasi_static(make_machine):
    """quasi_static(ground): the kinematic backend at rest."""

    def make(ground):
        scenario = perfect_scenario(ground)
        scenario.backend = "kinematic"
        return make_machine(scenario)

    return make


@at_rest
def test_quasi_static_actuators_hold_the_contact_force_times_the_transmission(
    quasi_static, ground
):
    machine, names = quasi_static(ground), ("extension", "posture", "contact_force", "load_force")
    extension, posture, contact, load = (machine.read(f"truth.{name}") for name in names)
    g = np.array(to_platform(normal_of(*np.radians(ground).tolist()), *posture[:2].tolist()))
    step = 1e-6
    transmission = [
        g @ (np.array(foot_to_centre(leg, d + step)) - foot_to_centre(leg, d - step)) / (2 * step)
        for leg, d in zip(DRAWN.legs, extension.tolist(), strict=True)
    ]
    np.testing.assert_allclose(load, contact * transmission, rtol=1e-5)


@at_rest
def test_quasi_static_actuators_hold_more_as_they_lift_the_legs_own_mass_too(
    quasi_static, standing, ground
):
    ratio = quasi_static(ground).read("truth.load_force")
    ratio /= standing("full", ground).read("truth.load_force")
    # A third of the machine's mass is in its legs.
    assert (ratio > 1.0).all()
    assert (ratio < 1.5).all()


# Truth and drawing


@pytest.fixture(scope="module", params=VARIANTS)
def model(request, make_model):
    return make_model(request.param)


def random_stances(count=5, seed=0):
    """Extensions whose feet lie in one plane, and grounds."""
    rng = np.random.default_rng(seed)
    for ground in rng.uniform(-0.08, 0.08, (count, 2)):
        a, b = rng.uniform(0.395, 0.415, 2)
        yield np.array([a, a, b, b]), ground


def test_posture_is_the_one_that_was_set_whatever_the_yaw(model):
    truth = PlatformTruth(model.model)
    context = truth.CreateDefaultContext()
    rng = np.random.default_rng(1)
    for _ in range(10):
        ground, attitude = rng.uniform(-0.2, 0.2, 2), rng.uniform((-1.0, -1.0, -3.0), (1, 1, 3))
        height, (along, across) = rng.uniform(0.4, 0.6), rng.uniform(-1.0, 1.0, 2)
        R_WG = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()
        p_WF = R_WG @ (along, across, height)  # anywhere above the ground
        plant_context = model.plant.CreateDefaultContext()
        X_WF = RigidTransform(RollPitchYaw(attitude), p_WF)
        model.plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, model.model.base, X_WF)
        state = np.array(model.plant.get_state_output_port().Eval(plant_context))
        truth.set_ground(context, ground)
        truth.GetInputPort("state").FixValue(context, state)
        posture = truth.GetOutputPort("posture").Eval(context)
        np.testing.assert_allclose(posture, (*attitude[:2], height), rtol=0.0, atol=1e-9)


def test_posture_does_not_depend_on_the_quaternions_length(model):
    truth = PlatformTruth(model.model)
    context = truth.CreateDefaultContext()
    state = np.zeros(model.plant.num_multibody_states())
    start = model.model.base.floating_positions_start()
    quaternion = RollPitchYaw(0.1, -0.2, 0.3).ToQuaternion().wxyz()
    for length in (1.0, 1.001, -2.0):
        state[start : start + 4] = length * quaternion
        truth.GetInputPort("state").FixValue(context, state)
        posture = truth.GetOutputPort("posture").Eval(context)
        np.testing.assert_allclose(posture, (0.1, -0.2, 0.0), rtol=0.0, atol=1e-12)


def test_feet_of_a_standing_platform_are_on_the_inclined_ground(model):
    for extension, ground in random_stances():
        model.stand(extension, ground)
        np.testing.assert_allclose(model.read("foot_height"), 0.0, rtol=0.0, atol=1e-9)


def test_feet_rise_with_the_base(model):
    model.stand([0.41] * 4, GROUND)
    q = model.plant.GetPositions(model.context)
    start = model.model.base.floating_positions_start() + 4
    q[start : start + 3] += 0.01 * np.array(normal_of(*GROUND))
    model.plant.SetPositions(model.context, q)
    np.testing.assert_allclose(model.read("foot_height"), 0.01, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(model.read("contact_force"), 0.0)


def test_loops_of_a_set_pose_are_closed(model):
    rng = np.random.default_rng(3)
    for extension in rng.uniform(0.385, 0.455, (5, 4)):
        model.stand(extension, GROUND)
        np.testing.assert_allclose(model.read("loop_error"), 0.0, rtol=0.0, atol=1e-12)


def test_loop_error_is_the_gap_that_was_opened(make_model):
    model = make_model("full")
    model.stand([0.41] * 4, (0.0, 0.0))
    for i, leg in enumerate(model.model.legs):
        joint = model.plant.GetJointByName("extension", leg)
        joint.set_translation(model.context, 0.41 + 1e-3 * (i + 1))
    expected = 1e-3 * np.arange(1, 5)
    np.testing.assert_allclose(model.read("loop_error"), expected, rtol=0.0, atol=1e-9)


def test_drawn_pose_is_the_models_and_closes_the_loops(model, fix):
    pose = PlatformPose(model.model)
    context = pose.CreateDefaultContext()
    for extension, ground in random_stances(7, seed=4):
        posture = forward_kinematics(DRAWN, extension, ground)
        base_pose = standing_pose(posture, ground)
        fix(pose, context, extension=extension, base_pose=base_pose, arm_position=[0.3, 0.2])
        found = np.array(pose.GetOutputPort("positions").Eval(context))
        expected = model.model.positions(extension, posture, ground, (0.3, 0.2))
        np.testing.assert_array_equal(found, expected)
        model.stand(extension, ground)
        model.plant.SetPositions(model.context, found)
        np.testing.assert_allclose(model.read("loop_error"), 0.0, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(model.read("foot_height"), 0.0, rtol=0.0, atol=1e-9)


def test_drawn_pose_follows_each_of_its_inputs(model, fix, moved):
    pose = PlatformPose(model.model)
    context = pose.CreateDefaultContext()
    base_pose = standing_pose((0.0, 0.0, 0.44), GROUND)
    fix(pose, context, extension=[0.41] * 4, base_pose=base_pose, arm_position=[0.0, 0.0])
    for change in (
        lambda: fix(pose, context, extension=[0.40] * 4),
        lambda: fix(pose, context, base_pose=standing_pose((0.0, 0.1, 0.44), GROUND)),
        lambda: fix(pose, context, arm_position=[0.0, 0.1]),
    ):
        assert moved(pose, context, change) == {"positions"}


def test_drawn_parallel_links_are_finite_and_turn_with_the_swing(model):
    scene_graph = SceneGraph()
    links = ParallelLinks(model.model, scene_graph, model.plant.num_positions())
    inspector = scene_graph.model_inspector()
    frames = [f for f in inspector.GetAllFrameIds() if "parallel_link" in inspector.GetName(f)]
    assert len(frames) == 4
    context = links.CreateDefaultContext()
    posture = np.array([0.0, 0.0, 0.44])

    def poses(extension):
        q = model.model.positions(extension, posture, (0.0, 0.0), (0.0, 0.0))
        links.get_input_port().FixValue(context, q)
        value = links.get_output_port().Eval(context)
        return q, [value.value(frame) for frame in frames]

    q_1, before = poses([0.40] * 4)
    q_2, after = poses([0.41] * 4)
    for i, (one, other) in enumerate(zip(before, after, strict=True)):
        assert np.isfinite(one.GetAsMatrix34()).all()
        np.testing.assert_allclose(one.translation(), other.translation(), rtol=0.0, atol=1e-12)
        turned = (one.rotation().inverse() @ other.rotation()).ToAngleAxis().angle()
        swung = model.model.swing(i, q_2) - model.model.swing(i, q_1)
        assert abs(turned) == pytest.approx(abs(swung), abs=1e-9)
        assert abs(swung) > 0.01
