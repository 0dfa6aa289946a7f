"""Forces of legs at rest, the margin of what they resist, and the masses that they carry."""

import numpy as np
import pytest

from parapod.diagrams.machining_centre.held_centre import make_held_centre
from parapod.systems.core.physics import GRAVITY
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian, leg_lengths, moved
from parapod.systems.machining_centre.statics import CentreMasses, CentreStatics
from parapod.systems.machining_centre.wrench import wrench_indices
from parapod.systems.machining_centre.wrench_monitor import WrenchMonitor

STEP = 1e-6
HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
TILTED = np.array((0.02, -0.01, 0.49, 0.05, 0.1, 0.2))


def third_axis(pose):
    roll, pitch, yaw = pose[3:]
    first = np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll)
    second = np.sin(yaw) * np.sin(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(roll)
    return np.array((first, second, np.cos(pitch) * np.cos(roll)))


@pytest.fixture
def legs(stand, geometry):
    """legs(pose, feet, clamps, tool): their forces."""
    machine = stand(CentreStatics(geometry))

    def forces(pose, feet=None, clamps=None, tool=(0.0, 0.0)):
        feet = geometry.footholds if feet is None else feet
        clamps = np.ones(geometry.limbs) if clamps is None else clamps
        machine.set(pose=pose, feet=np.ravel(feet), clamps_closed=clamps, tool_force=tool)
        return machine["leg_force"]

    return forces


@pytest.mark.parametrize("limbs", [3, 4])
def test_masses_are_those_of_the_bodies(limbs):
    model = make_held_centre(CentreGeometry(limbs), 1e-3).model
    plant, context = model.plant, model.plant.CreateDefaultContext()
    platform = plant.CalcTotalMass(context, [model.platform.model_instance()])
    masses = CentreMasses()
    assert platform == pytest.approx(masses.platform, abs=1e-12)
    for limb in model.limbs:
        assert plant.CalcTotalMass(context, [limb]) == pytest.approx(masses.limb, abs=1e-12)
    assert -plant.gravity_field().gravity_vector()[2] == pytest.approx(GRAVITY)
    down = 9.81 * (masses.platform + limbs * masses.limb / 2)
    weight = masses.weight(model.geometry)
    assert np.array_equal(weight, (0.0, 0.0, 0.0, 0.0, 0.0, -down))


def test_power_of_the_legs_is_that_against_the_load(geometry, poses, uneven, legs):
    # By rates of lengths from differences, for any twist: what goes in comes out.
    rng = np.random.default_rng(0)
    for pose, feet in zip(poses(20), uneven(20), strict=True):
        thrust, torque = rng.uniform((0.0, -2.0), (500.0, 2.0))
        forces = legs(pose, feet, tool=(thrust, torque))
        out = third_axis(pose)
        load = CentreMasses().weight(geometry) + np.concatenate((torque * out, thrust * out))
        for twist in rng.normal(size=(5, 6)):
            ahead, behind = (
                leg_lengths(geometry, moved(pose, sign * STEP * twist), feet) for sign in (1, -1)
            )
            rates = (ahead - behind) / (2.0 * STEP)
            assert forces @ rates == pytest.approx(-load @ twist, abs=1e-5)


def test_legs_of_a_level_centre_push_alike_and_hold_its_weight(geometry, legs):
    forces = legs(HOME)
    assert np.allclose(forces, forces[0], rtol=1e-12)
    assert forces[0] > 0.0
    foot = geometry.footholds[0, :3]
    upright = (HOME[:3] + geometry.pivots[0] - foot)[2] / leg_lengths(geometry, HOME)[0]
    down = 9.81 * (10.2 + 0.5 * 5.2 * geometry.limbs)
    assert forces.sum() * upright == pytest.approx(down)
    assert np.allclose(legs(HOME, tool=(down, 0.0)), 0.0, atol=1e-9)


def test_a_loose_limb_has_no_forces(geometry, legs):
    for limb in range(geometry.limbs):
        clamps = np.ones(geometry.limbs)
        clamps[limb] = 0.0
        forces = legs(TILTED, clamps=clamps).reshape(-1, 2)
        assert np.abs(forces[limb]).max() < 1e-12
        assert np.abs(np.delete(forces, limb, axis=0)).min() > 1.0


def test_of_eight_legs_forces_are_the_smallest_that_balance(stand):
    geometry = CentreGeometry(4)
    machine = stand(CentreStatics(geometry), clamps_closed=np.ones(4), tool_force=(100.0, 1.0))
    for pose in (HOME, TILTED):
        machine.set(pose=pose, feet=geometry.footholds.ravel())
        forces = machine["leg_force"]
        _, _, right = np.linalg.svd(jacobian(geometry, pose).T)
        assert np.abs(right[6:] @ forces).max() < 1e-9 * np.linalg.norm(forces)


def test_a_posture_that_is_no_number_has_no_forces(geometry, legs):
    assert np.isnan(legs(HOME * np.nan)).all()
    assert np.isnan(legs(HOME, np.full(6 * geometry.limbs, np.inf))).all()
    assert np.isnan(legs(HOME, tool=(np.nan, 0.0))).all()


@pytest.fixture
def monitor(stand, geometry):
    def make(**inputs):
        usual = {
            "pose_desired": HOME,
            "feet": geometry.footholds.ravel(),
            "clamps_closed": np.ones(geometry.limbs),
            "tool_force": (0.0, 0.0),
        }
        return stand(WrenchMonitor(geometry, 800.0), **(usual | inputs))

    return make


def test_the_margin_is_what_is_resisted_less_weight_thrust_and_torque(geometry, monitor):
    machine = monitor().tick()
    index = float(wrench_indices(geometry, HOME).w_minmax)
    assert machine["wrench_index"][0] == pytest.approx(index)
    down = 9.81 * (10.2 + 0.5 * 5.2 * geometry.limbs)
    resisted = index * geometry.legs * 800.0
    for thrust, torque in ((0.0, 0.0), (150.0, 0.0), (-150.0, 3.0), (100.0, -5.0)):
        machine.set(tool_force=(thrust, torque))
        needed = np.hypot(down + abs(thrust), torque / 0.1)
        assert machine["wrench_margin"][0] == pytest.approx(resisted - needed)


def test_the_index_is_that_of_the_limbs_that_are_clamped(geometry, monitor):
    clamps = np.ones(geometry.limbs)
    clamps[1] = 0.0
    machine = monitor(clamps_closed=clamps).tick()
    if geometry.limbs == 3:
        assert machine["wrench_index"][0] == 0.0
        assert machine["wrench_margin"][0] < 0.0
    else:
        expected = wrench_indices(geometry, HOME, standing=(1, 3, 4)).w_minmax
        assert machine["wrench_index"][0] == pytest.approx(float(expected))


def test_a_posture_or_load_that_is_no_number_counts_as_none(geometry, monitor):
    assert monitor(pose_desired=HOME * np.nan).tick()["wrench_index"][0] == 0.0
    assert monitor(feet=np.full(6 * geometry.limbs, np.inf)).tick()["wrench_index"][0] == 0.0
    machine = monitor().tick()
    before = machine["wrench_margin"][0]
    machine.set(tool_force=(np.nan, np.inf))
    assert machine["wrench_margin"][0] == before
