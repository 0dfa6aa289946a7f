"""Machines that are not built as drawn, ground that is not a plane, samples that are late."""

import math

import numpy as np
import pytest
from pydrake.geometry import SceneGraph

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.statics import resting_posture

VARIANTS = ("full", "reduced")
BACKENDS = pytest.mark.parametrize("backend", ["kinematic", "multibody"])
GROUND = (0.03, -0.05)
IMU_PERIOD = 8.0 / 819.2


def scenario_with(backend="multibody", seed=0, leg_model="reduced", **plant):
    """A scenario without anything random but the legs' dimensions."""
    scenario = LevellingScenario(backend=backend, seed=seed)
    scenario.machine.sensors = SensorScenario(0.0, False, 0.0, 0.0)
    scenario.machine.actuators.gain_error = 0.0
    scenario.plant.leg_model, scenario.plant.time_step = leg_model, 2e-3
    for key, value in plant.items():
        setattr(scenario.plant, key, value)
    return scenario


TOLERANCES = {"length_error_mm": 2.0, "angle_error_deg": 0.5}


# Dimensions as built


def test_a_machine_without_errors_is_built_as_drawn():
    assert scenario_with().geometry_as_built == DRAWN


def test_dimensions_as_built_come_from_the_seed_and_stay_within_their_tolerances():
    one, again, other = (
        scenario_with(seed=seed, **TOLERANCES).geometry_as_built for seed in (3, 3, 4)
    )
    assert one == again
    assert one != other
    for deviation in one.deviations:
        assert 0.0 < abs(deviation.l_4) <= 2e-3
        assert 0.0 < abs(deviation.beta) <= math.radians(0.5)


def test_errors_of_one_kind_leave_the_other_kind_as_drawn():
    only_lengths = scenario_with(length_error_mm=1.0).geometry_as_built
    only_angles = scenario_with(angle_error_deg=0.5).geometry_as_built
    for built, drawn in zip(only_lengths.legs, DRAWN.legs, strict=True):
        assert (built.alpha, built.beta) == (drawn.alpha, drawn.beta)
    for built, drawn in zip(only_angles.legs, DRAWN.legs, strict=True):
        assert (built.l_x, built.l_4, built.l_7) == (drawn.l_x, drawn.l_4, drawn.l_7)


@pytest.fixture(scope="module", params=VARIANTS)
def built(request, make_model):
    scenario = scenario_with(length_error_mm=5.0, angle_error_deg=2.0)
    return make_model(request.param, scenario.geometry_as_built)


def random_extensions(count=10):
    return np.random.default_rng(0).uniform(0.39, 0.42, (count, 4))


def rollers_of(machine):
    """Centres (4, 3) of the rollers in the platform's frame."""
    X_FW = machine.plant.EvalBodyPoseInWorld(machine.context, machine.model.base).inverse()
    bodies = machine.model.leg_bodies("roller")
    poses = [machine.plant.EvalBodyPoseInWorld(machine.context, body) for body in bodies]
    return np.array([X_FW @ pose.translation() for pose in poses])


def test_rollers_of_legs_as_built_are_where_the_closed_form_puts_them(built):
    for extension in random_extensions():
        built.stand(extension, GROUND)
        expected = [
            -np.array(foot_to_centre(leg, d))
            for leg, d in zip(built.model.geometry.legs, extension.tolist(), strict=True)
        ]
        np.testing.assert_allclose(rollers_of(built), expected, rtol=0, atol=1e-12)


def test_legs_as_built_are_closed_and_stand_on_three_feet_with_none_below_the_ground(built):
    for extension in random_extensions():
        built.stand(extension, GROUND)
        np.testing.assert_allclose(built.read("loop_error"), 0.0, rtol=0, atol=1e-12)
        gap = np.sort(built.read("foot_height"))
        np.testing.assert_allclose(gap[:3], 0.0, rtol=0, atol=1e-9)
        assert gap[3] > 0.0


def test_every_context_has_the_legs_as_built(built):
    hip = built.plant.GetFrameByName("hip_1")
    leg, drawn = built.model.geometry.legs[0], DRAWN.legs[0]
    assert leg != drawn
    default = built.plant.CreateDefaultContext()
    X_FD = hip.CalcPose(default, built.model.base.body_frame())
    np.testing.assert_array_equal(X_FD.translation(), (-leg.l_x, -leg.l_y, -leg.l_z))
    np.testing.assert_allclose(
        X_FD.rotation().matrix()[:, 0],
        (math.cos(leg.beta), math.sin(leg.beta), 0.0),
        rtol=0,
        atol=1e-15,
    )


# Pads

PADS = (0.02, -0.02, 0.02, -0.02)


@pytest.fixture
def on_pads(make_machine):
    """on_pads(backend, heights): a machine whose feet stand on pads."""

    def make(backend="multibody", heights=PADS):
        scenario = scenario_with(backend)
        scenario.ground.foot_heights_mm = [1e3 * height for height in heights]
        return make_machine(scenario)

    return make


@pytest.mark.parametrize("heights", [PADS, (0.01, 0.03, 0.0, 0.02)], ids=str)
@BACKENDS
def test_a_platform_on_pads_stands_with_all_feet(on_pads, backend, heights):
    machine = on_pads(backend, heights)
    np.testing.assert_allclose(machine.read("truth.foot_height"), 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("heights", [PADS, (0.01, 0.03, 0.0, 0.02)], ids=str)
def test_a_platform_on_pads_stays_where_it_was_put(on_pads, heights):
    machine = on_pads(heights=heights)
    before = machine.read("truth.posture")
    machine.run(0.5)
    moved = np.abs(machine.read("truth.posture") - before)
    assert np.degrees(moved[:2]).max() < 0.02
    assert moved[2] < 1e-4
    assert np.abs(machine.read("truth.foot_height")).max() < 1e-4
    assert (machine.read("truth.contact_force") > 0.0).all()


def test_both_backends_stand_in_the_same_posture_on_pads(on_pads):
    multibody, kinematic = (on_pads(backend).read for backend in ("multibody", "kinematic"))
    extension = "truth.extension"
    np.testing.assert_allclose(multibody(extension), kinematic(extension), rtol=0, atol=1e-9)
    # The feet of the quasi-static plant yield to the weight.
    difference = np.abs(multibody("truth.posture") - kinematic("truth.posture"))
    assert np.degrees(difference[:2]).max() < 1e-3
    assert difference[2] < 1e-4


def test_a_plane_has_no_pads(make_model):
    names = []
    for offsets in ((0.0,) * 4, PADS):
        machine = make_model("reduced", DRAWN, offsets)
        assert isinstance(machine.scene_graph, SceneGraph)
        inspector = machine.scene_graph.model_inspector()
        everything = [inspector.GetName(i) for i in inspector.GetAllGeometryIds()]
        names.append({name.split("::")[-1] for name in everything if "pad_" in name})
    assert names[0] == set()
    # Two feet stand on the lowest part of the ground.
    assert names[1] == {"pad_1", "pad_1_visual", "pad_3", "pad_3_visual"}


def test_pads_lift_feet_that_the_legs_alone_would_not(make_model):
    machine = make_model("reduced", DRAWN, PADS)
    extension = random_extensions(1)[0]
    machine.stand(extension, GROUND)
    posture = resting_posture(DRAWN, extension, GROUND, PADS)
    flat = resting_posture(DRAWN, extension, GROUND)
    assert np.abs(posture - flat).max() > 1e-3
    gap = np.sort(machine.read("foot_height"))
    np.testing.assert_allclose(gap[:3], 0.0, rtol=0, atol=1e-9)


# Late samples


@pytest.fixture
def inertial_run(make_machine):
    """Gyro and age (n) at the middle of each period while the platform is lowered in front."""

    def run(delay_ms, samples=20):
        scenario = scenario_with("kinematic")
        scenario.machine.sensors.imu_delay_ms = delay_ms
        machine = make_machine(scenario)
        gyro, age = [], []
        for k in range(samples):
            machine.set("legs.voltage", [0.0, 0.0, 1.0 + k % 7, 1.0 + k % 7])
            machine.simulator.AdvanceTo((k + 0.5) * IMU_PERIOD)
            gyro.append(machine.read("imu.gyro"))
            age.append(machine.read("status.age"))
        return np.array(gyro), np.array(age)

    return run


@pytest.mark.parametrize("late", [1, 5])
def test_late_samples_are_those_of_as_many_periods_ago_and_say_so(inertial_run, late):
    gyro, age = inertial_run(0.0)
    delayed, older = inertial_run(1e3 * late * IMU_PERIOD)
    np.testing.assert_allclose(older - age, np.tile((0.0, late * IMU_PERIOD, 0, 0), (20, 1)))
    assert np.ptp(gyro[:, 1]) > 1e-3
    np.testing.assert_array_equal(delayed[late:], gyro[:-late])


@pytest.mark.parametrize(("delay_ms", "late"), [(4.0, 0), (6.0, 1), (20.0, 2)])
def test_a_delay_is_rounded_to_whole_samples(inertial_run, delay_ms, late):
    _, age = inertial_run(delay_ms, 2)
    assert age[1, 1] == pytest.approx((0.5 + late) * IMU_PERIOD, rel=1e-6)
