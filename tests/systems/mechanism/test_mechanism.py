"""Laws of mechanisms from model files: freedoms, poses, motion, forces, singular positions."""

from typing import Any

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.core.errors import ScenarioError
from parapod.systems.mechanism.equations import UnsolvedPose
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.statics import motor_forces
from tests.systems.mechanism.conftest import MECHANISMS, MODELS

# File, freedoms, independent and all equations.
FILES = {
    "hexapod": (MECHANISMS / "hexapod" / "hexapod.urdf", 6, 15, 15),
    "delta": (MECHANISMS / "delta" / "delta.xml", 3, 18, 18),
    "three_rps": (MODELS / "three_rps.urdf", 3, 6, 6),
    "four_bar": (MODELS / "four_bar.sdf", 1, 2, 6),
}
LOADED: dict[str, Mechanism] = {}
# Motor positions about those at home [m, rad].
WAY = {"hexapod": 0.05, "delta": 0.3, "three_rps": 0.04, "four_bar": 0.4}


def load(name: str) -> Mechanism:
    if name not in LOADED:
        LOADED[name] = Mechanism.load(FILES[name][0])
    return LOADED[name]


each_mechanism = pytest.mark.parametrize("name", FILES)


def drawn_motors(mechanism: Mechanism, name: str, count: int, seed: int = 0) -> np.ndarray:
    begin = mechanism.motor_positions(mechanism.home)
    random = np.random.default_rng(seed)
    return begin + WAY[name] * random.uniform(-1.0, 1.0, (count, len(begin)))


@each_mechanism
def test_freedoms_are_counted(name):
    mechanism, (_, freedoms, rank, equations) = load(name), FILES[name]
    of = mechanism.mobility
    assert (of.freedoms, of.rank, of.equations) == (freedoms, rank, equations)
    assert of.governed == freedoms
    assert of.idle == ()
    assert len(mechanism.motors) == freedoms
    mechanism.check_motors()


def test_equations_that_follow_from_others_are_named():
    redundant = load("four_bar").mobility.redundant
    assert set(redundant) == {"bearing (near)", "bearing (far)"}
    # Each of the two ball joints in place of a hinge could do alone in a plane.
    assert set(redundant.values()) == {3}


@each_mechanism
def test_all_loops_are_closed_wherever_the_motors_are(name):
    mechanism = load(name)
    motors = drawn_motors(mechanism, name, 20)
    for goal in motors:
        q = mechanism.forward(goal)
        assert np.abs(mechanism.residual(q)).max() < 1e-11
        np.testing.assert_allclose(mechanism.motor_positions(q), goal, rtol=0.0, atol=1e-15)


@each_mechanism
def test_rows_are_the_poses_one_by_one(name):
    mechanism = load(name)
    motors = drawn_motors(mechanism, name, 20)
    rows, is_closed = mechanism.forward_rows(motors)
    assert is_closed.all()
    for goal, row in zip(motors, rows, strict=True):
        np.testing.assert_allclose(row, mechanism.forward(goal), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", ["hexapod", "delta", "three_rps"])
def test_inverse_and_forward_kinematics_undo_each_other(name):
    mechanism = load(name)
    poses = [mechanism.forward(goal) for goal in drawn_motors(mechanism, name, 10)]
    goals = np.array([pose_of(mechanism, q) for q in poses])
    if name != "hexapod":  # as many parts of the pose as there are freedoms
        goals[:, [3, 4, 5] if name == "delta" else [0, 1, 5]] = np.nan
    rows, is_closed = mechanism.inverse_rows("platform", goals)
    assert is_closed.all()
    for q, goal, row in zip(poses, goals, rows, strict=True):
        back = mechanism.inverse("platform", goal)
        np.testing.assert_allclose(back, q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(row, q, rtol=0.0, atol=1e-9)


def pose_of(mechanism: Mechanism, q: np.ndarray) -> np.ndarray:
    pose = mechanism.pose("platform", q)
    return np.concatenate((pose.translation(), RollPitchYaw(pose.rotation()).vector()))


def test_legs_of_the_hexapod_are_as_long_as_their_ends_are_apart():
    mechanism = load("hexapod")
    base, top = np.radians([-10, 10, 110, 130, 230, 250]), np.radians([-50, 50, 70, 170, 190, 290])
    feet = 0.35 * np.column_stack((np.cos(base), np.sin(base), np.zeros(6)))
    ends = 0.22 * np.column_stack((np.cos(top), np.sin(top), np.zeros(6)))
    middle = np.linalg.norm(ends + np.array((0.0, 0.0, 0.45)) - feet, axis=1)
    random = np.random.default_rng(1)
    goals = random.uniform(-1.0, 1.0, (200, 6)) * (0.05, 0.05, 0.05, 0.2, 0.2, 0.2)
    goals += (0.0, 0.0, 0.45, 0.0, 0.0, 0.0)
    rows, is_closed = mechanism.inverse_rows("platform", goals)
    assert is_closed.all()
    for goal, lengths in zip(goals, mechanism.motor_positions(rows), strict=True):
        turn = RollPitchYaw(*goal[3:]).ToRotationMatrix().matrix()
        closed = np.linalg.norm(goal[:3] + ends @ turn.T - feet, axis=1) - middle
        np.testing.assert_allclose(lengths, closed, rtol=0.0, atol=1e-9)


def test_the_platform_of_the_delta_shifts_and_does_not_turn():
    mechanism = load("delta")
    for motors in drawn_motors(mechanism, "delta", 10):
        q = mechanism.forward(motors)
        turn = mechanism.pose("platform", q).rotation().matrix()
        np.testing.assert_allclose(turn, np.eye(3), rtol=0.0, atol=1e-9)
        # Rods are as long as drawn, between elbows and wrists in the directions of the arms.
        place = mechanism.pose("platform", q).translation()
        for arm, angle in enumerate(motors):
            out = np.radians(120.0 * arm)
            radial = np.array((np.cos(out), np.sin(out), 0.0))
            elbow = (0.2 + 0.2 * np.cos(angle)) * radial - (0.0, 0.0, 0.2 * np.sin(angle))
            assert np.linalg.norm(place + 0.06 * radial - elbow) == pytest.approx(0.45, abs=1e-9)


@each_mechanism
def test_velocities_are_rates_of_poses(name):
    mechanism = load(name)
    (begin,) = drawn_motors(mechanism, name, 1, seed=2)
    q = mechanism.forward(begin)
    rates = mechanism.velocity_map(q)
    for column in range(len(begin)):
        step = np.zeros(len(begin))
        step[column] = 1e-5
        ahead, back = (mechanism.forward(begin + sign * step, near=q) for sign in (1.0, -1.0))
        moved = mechanism.moved(q, 1e-5 * rates[:, column])
        np.testing.assert_allclose(ahead - q, moved - q, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(ahead + back - 2.0 * q, 0.0, rtol=0.0, atol=1e-7)


@each_mechanism
def test_power_of_the_motors_is_the_growth_of_energy(name):
    mechanism = load(name)
    plant, (begin,) = mechanism.plant, drawn_motors(mechanism, name, 1, seed=3)
    random = np.random.default_rng(4)
    rates, changes = WAY[name] * random.uniform(-1.0, 1.0, (2, len(begin)))
    time = 1e-4

    def at(t: float) -> tuple[Any, np.ndarray, np.ndarray]:
        q = mechanism.forward(begin + rates * t + 0.5 * changes * t * t)
        now = rates + changes * t
        return motor_forces(mechanism, q, now, changes), q, now

    def energy(t: float) -> float:
        forces, q, _ = at(t)
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, q)
        plant.SetVelocities(context, forces.velocities)
        return float(plant.EvalPotentialEnergy(context) + plant.EvalKineticEnergy(context))

    forces, _, _ = at(0.0)
    growth = (energy(time) - energy(-time)) / (2.0 * time)
    lost = 0.0
    for joint in mechanism.joints:
        first, count = joint.velocity_start(), joint.num_velocities()
        speed = forces.velocities[first : first + count]
        lost += float(joint.default_damping_vector() @ speed**2)
    assert forces.forces @ rates == pytest.approx(growth + lost, rel=1e-6, abs=1e-9)


def test_motors_hold_a_wrench_through_the_frame_s_jacobian():
    mechanism = load("hexapod")
    q = mechanism.forward(drawn_motors(mechanism, "hexapod", 1)[0])
    wrench = np.array((1.0, -2.0, 3.0, 40.0, 50.0, -60.0))
    loaded = motor_forces(mechanism, q, wrenches={"platform": wrench})
    change = loaded.forces - motor_forces(mechanism, q).forces
    expected = -mechanism.frame_jacobian("platform", q).T @ wrench
    np.testing.assert_allclose(change, expected, rtol=1e-10)


def test_accelerations_keep_the_loops_closed():
    mechanism = load("hexapod")
    begin = drawn_motors(mechanism, "hexapod", 1)[0]
    rates, h = np.full(6, 0.1) * (1, -1, 1, 1, -1, 0.5), 1e-3
    ways = [mechanism.forward(begin + rates * t) for t in (-h, 0.0, h)]
    forces = motor_forces(mechanism, ways[1], rates)
    legs = [joint.position_start() for joint in mechanism.joints if joint.num_velocities() == 1]
    speeds = [joint.velocity_start() for joint in mechanism.joints if joint.num_velocities() == 1]
    second = (ways[0] - 2.0 * ways[1] + ways[2])[legs] / h**2
    np.testing.assert_allclose(forces.accelerations[speeds], second, rtol=0.0, atol=1e-5)


def test_a_flat_parallelogram_is_singular():
    mechanism = load("four_bar")
    upright = mechanism.home
    assert mechanism.dexterity(upright).held > 0.05
    near = mechanism.forward([0.5 * np.pi - 1e-4], near=upright)
    assert mechanism.dexterity(near).held < 1e-3
    with pytest.raises(UnsolvedPose, match="singular position, at shaft"):
        # The coupler can go on level or turned over; Newton's method must not choose.
        mechanism.forward([0.5 * np.pi + 0.2], near=upright)


def test_the_assembly_stays_the_same_on_a_way_there_and_back():
    mechanism = load("four_bar")
    there = mechanism.forward([1.2])
    np.testing.assert_allclose(mechanism.forward([0.0], near=there), mechanism.home, atol=1e-9)
    # The coupler of a parallelogram stays level as long as it is not flat.
    turn = mechanism.pose("coupler", there).rotation().matrix()
    np.testing.assert_allclose(turn, np.eye(3), rtol=0.0, atol=1e-9)


def test_a_target_out_of_reach_is_refused_with_what_is_missed():
    with pytest.raises(UnsolvedPose, match=r"platform cannot get there: missed .* by .* mm"):
        load("delta").inverse("platform", (0.0, 0.0, -2.0))
    rows, is_closed = load("delta").inverse_rows("platform", [(0.0, 0.0, -2.0), (0.0, 0.0, -0.3)])
    assert is_closed.tolist() == [False, True]
    assert rows.shape == (2, load("delta").plant.num_positions())


def test_limits_are_kept_where_that_can_be_and_told_where_not():
    mechanism = load("hexapod")
    high = mechanism.inverse("platform", (0.0, 0.0, 0.65, 0.0, 0.0, 0.0))
    beyond = mechanism.beyond_limits(high)
    assert set(beyond) == {f"leg_{i}" for i in range(1, 7)}
    q = mechanism.motor_positions(high)
    assert all(beyond[f"leg_{i + 1}"] == pytest.approx(q[i] - 0.12) for i in range(6))
    assert mechanism.beyond_limits(mechanism.home) == {}


def test_motors_that_do_not_fit_are_refused_in_a_line():
    path = FILES["four_bar"][0]
    with pytest.raises(ScenarioError, match="2 motors are too many for 1 freedoms; name 1 of"):
        Mechanism.load(path, motors=["shaft", "pin_1"]).check_motors()
    plant = load("three_rps").plant
    unmoved = Mechanism(plant, [], load("three_rps").loops)
    with pytest.raises(ScenarioError, match="no joint has a motor: 3 are needed, of hinge_1"):
        unmoved.check_motors()
    with pytest.raises(ScenarioError, match="there are 6 motors, not 2"):
        load("hexapod").forward([0.0, 0.0])


def test_a_frame_that_does_not_exist_is_refused_by_name():
    with pytest.raises(ScenarioError, match=r"no frame 'platfrom' \(did you mean platform\?\)"):
        load("hexapod").pose("platfrom", load("hexapod").home)
