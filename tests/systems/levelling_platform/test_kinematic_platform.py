import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import foot_to_centre, footprint
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, rod_arm
from parapod.systems.levelling_platform.wheels import WheelGeometry

POINT = PlatformGeometry()
ROLLER = PlatformGeometry(foot_radius=0.025)
PARAMS = KinematicPlatformParams()
STIFF = replace(PARAMS, foot_stiffness=1e9)
CENTRED = rod_arm((0.0, 0.0, 0.145))
WEIGHT = 51.0 * PARAMS.gravity
POSTURE = np.array((0.02, -0.01, 0.475))
GROUND = np.array((0.03, -0.04))
LEVEL = (0.0, 0.0)
UPRIGHT = (0.0, 0.0)


@pytest.fixture
def stand(stand):
    """stand(extension, velocity, arm, ground, geometry, params): the platform."""

    def on_ground(
        extension,
        velocity=(0.0, 0.0, 0.0, 0.0),
        arm=UPRIGHT,
        ground=LEVEL,
        geometry=POINT,
        params=STIFF,
    ):
        platform = KinematicPlatform(geometry, params)
        standing = stand(platform, extension=extension, velocity=velocity, arm_position=arm)
        platform.set_ground(standing.context, ground)
        return standing

    return on_ground


def rotation(attitude):
    return RollPitchYaw(attitude[0], attitude[1], 0.0).ToRotationMatrix().matrix()


def feet_of(extension, geometry=POINT):
    """Feet from F, in the platform's frame (4 x 3)."""
    pairs = zip(geometry.legs, np.asarray(extension).tolist(), strict=True)
    return -np.array([foot_to_centre(leg, d) for leg, d in pairs])


def centre_of_mass(arm, params=PARAMS):
    """From F, in the platform's frame."""
    turn, swing = arm
    along = np.array(
        (math.sin(swing) * math.cos(turn), math.sin(swing) * math.sin(turn), math.cos(swing))
    )
    rod, base = params.arm.links[1], params.arm.joints[0].place
    moment = rod.mass * (np.array(base) + rod.centre[2] * along)
    return (params.mass * np.array(params.centre_of_mass) + moment) / (params.mass + rod.mass)


def cases(count=30, seed=0):
    """Postures with coplanar feet, on random grounds with random arms."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        ground = rng.uniform(-0.06, 0.06, 2)
        posture = np.append(ground * rng.uniform(0.5, 1.0, 2), rng.uniform(0.45, 0.49))
        arm = np.append(rng.uniform(-3.0, 3.0), rng.uniform(-0.8, 0.8))
        extension = inverse_kinematics(POINT, posture, ground, on_unreachable="nan")
        if np.isfinite(extension).all():
            yield posture, ground, arm, extension


# Statics


def test_forces_of_the_level_platform_are_a_quarter_of_the_weight_each(stand):
    centred = replace(STIFF, arm=CENTRED)
    output = stand([0.405] * 4, params=centred)
    # 51 kg on four feet: 125 N each.
    np.testing.assert_allclose(output["contact_force"], 51.0 * 9.81 / 4.0, rtol=1e-9)
    assert output["contact_force"][0] == pytest.approx(125.0, abs=0.1)
    # At .405 the height changes by about 5.9 times the extension: .74 kN hold it.
    np.testing.assert_allclose(output["load_force"], -740.0, rtol=0.01)


def test_forces_and_moments_balance_and_do_not_depend_on_the_stiffness(stand):
    for posture, ground, arm, extension in cases(seed=1):
        force = stand(extension, arm=arm, ground=ground)["contact_force"]
        soft = stand(extension, arm=arm, ground=ground, params=PARAMS)["contact_force"]
        # Feet lie in one plane.
        np.testing.assert_allclose(soft, force, rtol=1e-4)
        R = rotation(posture)
        ground_axes = rotation(ground)
        n = ground_axes[:, 2]
        assert force.min() >= 0.0
        assert force.sum() == pytest.approx(WEIGHT * n[2], rel=1e-7)
        assert soft.sum() == pytest.approx(WEIGHT * n[2], rel=1e-5)
        feet = feet_of(extension) @ R.T
        origin = feet[0]  # in the ground's plane, where friction has no lever
        com = R @ centre_of_mass(arm)
        moment = np.cross(com - origin, (0.0, 0.0, -WEIGHT))
        moment += np.cross(feet - origin, np.outer(force, n)).sum(axis=0)
        np.testing.assert_allclose(ground_axes[:, :2].T @ moment, 0.0, atol=1e-4)


@pytest.mark.parametrize("geometry", [POINT, ROLLER], ids=["point", "roller"])
def test_posture_of_stiff_feet_is_forward_kinematics(stand, geometry):
    extension = inverse_kinematics(geometry, POSTURE, GROUND)
    output = stand(extension, ground=GROUND, geometry=geometry)
    np.testing.assert_allclose(output["posture"], POSTURE, rtol=0, atol=1e-6)
    np.testing.assert_allclose(output["attitude"], (*POSTURE[:2], 0.0), rtol=0, atol=1e-6)
    np.testing.assert_allclose(output["foot_height"], 0.0, atol=1e-9)
    pose = output["base_pose"]
    orientation = RotationMatrix(Quaternion(pose[:4]))
    turned, angles = orientation.matrix(), RollPitchYaw(orientation).vector()
    np.testing.assert_allclose(angles[:2], POSTURE[:2], rtol=0, atol=1e-6)
    normal = rotation(GROUND)[:, 2]
    # The lowest points of the feet, which roll, have their middle at the origin.
    bottoms = feet_of(extension, geometry) - [0.0, 0.0, geometry.foot_radius]
    feet = pose[4:] + bottoms @ turned.T
    middle = feet.mean(axis=0)
    heading = RollPitchYaw(0.0, 0.0, angles[2]).ToRotationMatrix().matrix()
    up = heading @ normal
    assert up @ pose[4:] == pytest.approx(POSTURE[2], abs=1e-6)
    np.testing.assert_allclose(middle - up * (up @ middle), 0.0, atol=1e-6)
    # They are turned least against those of legs of one length: no yaw more or less is nearer.
    alike = footprint(geometry.legs, GROUND)
    away = [
        np.linalg.norm((feet - middle)[:, :2] @ turn(by).T - alike) for by in (-1e-4, 0.0, 1e-4)
    ]
    assert away[1] < min(away[0], away[2])


def turn(yaw):
    """Rotation of the plane."""
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


def test_legs_of_one_length_have_no_yaw(stand):
    pose = stand([0.405] * 4, ground=GROUND)["base_pose"]
    assert RollPitchYaw(RotationMatrix(Quaternion(pose[:4]))).yaw_angle() == pytest.approx(
        0.0, abs=1e-8
    )


def test_platform_sinks_by_force_over_stiffness(stand):
    soft = replace(PARAMS, arm=CENTRED, foot_stiffness=2e6)
    height = [
        stand([0.405] * 4, params=params)["posture"][2]
        for params in (soft, replace(soft, foot_stiffness=1e15))
    ]
    assert height[1] - height[0] == pytest.approx(WEIGHT / 4.0 / 2e6, rel=1e-6)


def test_lengthening_one_foot_loads_its_diagonal(stand):
    flat = stand([0.405] * 4, params=PARAMS)["contact_force"]
    lowered = stand([0.40501, 0.405, 0.405, 0.405], params=PARAMS)["contact_force"]
    # A longer actuator lifts foot 1: it and its opposite carry less.
    assert (np.sign(lowered - flat) == (-1.0, 1.0, -1.0, 1.0)).all()
    # Four springs in series: excess / 4 times the stiffness, up to the feet's places.
    lift = 5.87 * 1e-5
    assert flat[0] - lowered[0] == pytest.approx(lift / 4.0 * PARAMS.foot_stiffness, rel=0.02)


# Three legs


def leaning(leg):
    """An arm position that takes the load off a leg, and off it alone."""
    foot = feet_of([0.405] * 4)[leg]
    return math.atan2(-foot[1], -foot[0]), 0.6


@pytest.mark.parametrize("lifted", range(4))
@pytest.mark.parametrize("across", [False, True])
def test_three_legs_carry_when_one_is_short_and_the_platform_leans_off_it_or_across(
    stand, lifted, across
):
    """A short leg or the one across it is in the air: the one from which the arm leans away."""
    extension = np.array((0.405, 0.406, 0.404, 0.403))
    extension[(lifted + 2) % 4 if across else lifted] += 0.006
    carrying = [i for i in range(4) if i != lifted]
    arm = leaning(lifted)
    output = stand(extension, arm=arm)
    force = output["contact_force"]
    assert force[lifted] == output["load_force"][lifted] == 0.0
    assert (force[carrying] > 0.0).all()
    posture = forward_kinematics(POINT, extension, LEVEL, legs=carrying)
    np.testing.assert_allclose(output["posture"], posture, rtol=0, atol=1e-6)
    R = rotation(posture)
    feet = feet_of(extension) @ R.T
    above = posture[2] + feet[lifted, 2]
    assert above > 0.005
    assert output["foot_height"][lifted] == pytest.approx(above, abs=1e-6)
    np.testing.assert_allclose(output["foot_height"][carrying], 0.0, atol=1e-9)
    assert force.sum() == pytest.approx(WEIGHT, rel=1e-3)
    pressure = force @ feet[:, :2] / force.sum()
    np.testing.assert_allclose(pressure, (R @ centre_of_mass(arm))[:2], atol=2e-3)


def test_three_legs_follow_their_velocities(stand):
    extension = np.full(4, 0.404)
    extension[3] += 0.006
    velocity = np.array((0.002, -0.001, 0.003, 0.0))
    arm, step = leaning(3), 1e-5
    ahead, behind = (stand(extension + t * velocity, arm=arm)["attitude"] for t in (step, -step))
    rates = (ahead - behind) / (2.0 * step)
    roll = stand(extension, arm=arm)["attitude"][0]
    expected = (rates[0], rates[1] * math.cos(roll), -rates[1] * math.sin(roll))
    omega = stand(extension, velocity, arm=arm)["angular_velocity"]
    np.testing.assert_allclose(omega, expected, atol=1e-6)


@pytest.mark.parametrize(("turn", "axis"), [(0.0, 0), (0.5 * math.pi, 1)])
def test_an_arm_that_swings_moves_the_load_to_where_it_leans(stand, turn, axis):
    feet = feet_of([0.405] * 4)[:, axis]
    loads = []
    for swing in (-0.8, -0.4, 0.0, 0.4, 0.8):
        force = stand([0.405] * 4, arm=(turn, swing))["contact_force"]
        loads.append(force[feet > 0.0].sum())
    assert (np.diff(loads) > 1.0).all()
    # Levers: the feet stand 2 x apart, and the arm's centre goes r sin(swing) to the side.
    moment = 1.0 * PARAMS.gravity * 1.747 * math.sin(0.8)
    expected = moment / (2.0 * feet.max())
    assert loads[-1] - loads[2] == pytest.approx(expected, rel=1e-6)


# Motion


def test_power_of_the_actuators_is_the_rate_of_the_potential_energy(stand):
    rng = np.random.default_rng(3)
    step = 1e-6
    for _ in range(20):
        posture = np.append(rng.uniform(-0.02, 0.02, 2), rng.uniform(0.45, 0.49))
        rate = rng.uniform(-1.0, 1.0, 3) * (0.03, 0.03, 0.02)
        arm = np.append(rng.uniform(-3.0, 3.0), rng.uniform(-0.8, 0.8))
        extension = inverse_kinematics(POINT, posture, LEVEL)
        velocity = posture_jacobian(POINT, posture, LEVEL) @ rate
        load = stand(extension, velocity, arm=arm)["load_force"]
        heights = [
            y[2] + (rotation(y) @ centre_of_mass(arm))[2]
            for y in (posture + step * rate, posture - step * rate)
        ]
        power = WEIGHT * (heights[0] - heights[1]) / (2.0 * step)
        assert load @ velocity == pytest.approx(power, abs=1e-5)


def test_angular_velocity_integrates_to_the_attitude(stand):
    def attitude_at(t):
        return np.array((0.03 * math.sin(t), 0.04 * math.sin(0.7 * t + 0.5), 0.0))

    def posture_at(t):
        return np.append(attitude_at(t)[:2], 0.475 + 0.01 * math.sin(1.3 * t))

    R = RollPitchYaw(attitude_at(0.0)).ToRotationMatrix().matrix()
    step, h = 1e-6, 0.02
    for k in range(100):
        t = (k + 0.5) * h
        rate = (posture_at(t + step) - posture_at(t - step)) / (2.0 * step)
        posture = posture_at(t)
        extension = inverse_kinematics(POINT, posture, GROUND)
        velocity = posture_jacobian(POINT, posture, GROUND) @ rate
        wx, wy, wz = h * stand(extension, velocity, ground=GROUND)["angular_velocity"]
        spin = np.array([(0.0, -wz, wy), (wz, 0.0, -wx), (-wy, wx, 0.0)])
        R = R @ (np.eye(3) + spin + 0.5 * spin @ spin)
    end = RollPitchYaw(attitude_at(2.0)).ToRotationMatrix().matrix()
    np.testing.assert_allclose(R, end, atol=2e-5)


def test_a_platform_at_rest_on_a_slope_has_its_attitude_and_measures_gravity_alone(stand):
    for ground in itertools.product((-0.05, 0.0, 0.08), repeat=2):
        output = stand([0.405] * 4, ground=ground)
        np.testing.assert_allclose(output["attitude"], (*ground, 0.0), rtol=0, atol=1e-6)
        np.testing.assert_array_equal(output["angular_velocity"], np.zeros(3))
        expected = rotation(output["attitude"]).T @ (0.0, 0.0, PARAMS.gravity)
        np.testing.assert_allclose(output["specific_force"], expected, atol=1e-14)
        assert (output["load_force"] < 0.0).all()  # extending lowers the platform


# Inputs


@pytest.mark.parametrize("bad", [math.nan, 0.35, 0.53])
def test_extension_that_cannot_be_built_gives_nan(stand, bad):
    output = stand([0.405, 0.405, bad, 0.405])
    for name in ("posture", "attitude", "angular_velocity", "specific_force"):
        assert np.isnan(output[name][:2]).all()
    for name in ("contact_force", "foot_height"):
        assert np.isnan(output[name]).all()


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("mass", 60.0, "contact_force"),
        ("centre_of_mass", (0.05, 0.0, -0.13), "contact_force"),
        ("arm", rod_arm(mass=2.0), "contact_force"),
        ("arm", rod_arm((0.2, 0.0, 0.1)), "contact_force"),
        ("arm", rod_arm(centre=1.0), "contact_force"),
        ("foot_stiffness", 1e5, "posture"),
        ("gravity", 1.62, "specific_force"),
    ],
)
def test_each_param_counts(stand, field, value, name):
    arm = (0.4, 0.5)
    changed = stand([0.405] * 4, arm=arm, params=replace(PARAMS, **{field: value}))
    assert (changed[name] != stand([0.405] * 4, arm=arm, params=PARAMS)[name]).any()


def test_stance_shows_what_the_other_ports_show(stand):
    platform = stand((0.404, 0.405, 0.406, 0.405), (0.001, 0.0, -0.001, 0.002), ground=GROUND)
    names = ("posture", "attitude", "angular_velocity", "specific_force")
    names += ("contact_force", "load_force", "foot_height")
    shown = np.concatenate([platform[name] for name in names])
    np.testing.assert_array_equal(platform["stance"], shown)
    assert np.count_nonzero(shown) > 15


# Loads


def test_a_weight_that_acts_as_a_load_is_as_one_of_the_platform(stand):
    for posture, ground, arm, extension in cases(10, seed=5):
        whole = stand(extension, arm=arm, ground=ground)
        # The arm's weight, at its centre of mass, from a platform whose arm weighs nothing.
        bare = replace(STIFF, arm=rod_arm(mass=0.0))
        rotation_of_gravity = rotation(whole["attitude"]).T @ [0.0, 0.0, -PARAMS.gravity]
        rod = PARAMS.arm.links[1]
        moment = np.array(PARAMS.arm.first_moment(arm.tolist()))
        load = [*np.cross(moment, rotation_of_gravity), *(rod.mass * rotation_of_gravity)]
        platform = KinematicPlatform(POINT, bare)
        context = platform.CreateDefaultContext()
        platform.set_ground(context, ground)
        for name, value in (
            *(("extension", extension), ("velocity", [0.0] * 4), ("arm_position", arm)),
            ("load", load),
        ):
            platform.GetInputPort(name).FixValue(context, value)
        for name in ("posture", "contact_force", "load_force"):
            there = platform.GetOutputPort(name).Eval(context)
            np.testing.assert_allclose(there, whole[name], rtol=1e-6, atol=1e-6)
        assert np.isfinite(posture).all()


def test_sideways_load_moves_the_forces_by_its_moment_about_the_ground(stand):
    centred = replace(STIFF, arm=CENTRED)
    extension, push = [0.405] * 4, 20.0
    platform = KinematicPlatform(POINT, centred)
    context = platform.CreateDefaultContext()
    for name, value in (
        *(("extension", extension), ("velocity", [0.0] * 4), ("arm_position", UPRIGHT)),
        ("load", [0.0, 0.0, 0.0, push, 0.0, 0.0]),
    ):
        platform.GetInputPort(name).FixValue(context, value)
    forces = platform.GetOutputPort("contact_force").Eval(context)
    height = platform.GetOutputPort("posture").Eval(context)[2]
    feet = feet_of(extension)
    assert forces.sum() == pytest.approx(WEIGHT, rel=1e-9)
    assert feet[:, 0] @ forces == pytest.approx(push * height, rel=1e-6)
    assert feet[:, 1] @ forces == pytest.approx(0.0, abs=1e-6)


def test_load_that_lifts_it_off_leaves_nothing_known():
    platform = KinematicPlatform(POINT, STIFF)
    context = platform.CreateDefaultContext()
    for name, value in (
        ("extension", [0.405] * 4),
        ("velocity", [0.0] * 4),
        ("load", [0.0, 0.0, 0.0, 0.0, 0.0, 600.0]),
    ):
        platform.GetInputPort(name).FixValue(context, value)
    assert np.isnan(platform.GetOutputPort("contact_force").Eval(context)).all()


@pytest.fixture
def risen(fix, read):
    """risen(platform, rising): outputs of a platform on ground that moves."""

    def outputs(platform, rising):
        context = platform.CreateDefaultContext()
        extension = inverse_kinematics(ROLLER, POSTURE, GROUND)
        given = {"extension": extension, "velocity": np.zeros(4), "arm_position": (1.0, 0.8)}
        fix(platform, context, **given, rising=np.array(rising))
        return read(platform, context)

    return outputs


# Wheels in the air, and wheels that carry beside two feet.
@pytest.mark.parametrize("wheels", [None, WheelGeometry(), WheelGeometry(height=-0.351)])
def test_ground_that_moves_turns_the_platform_at_the_rate_of_its_attitude(risen, wheels):
    platform = KinematicPlatform(ROLLER, STIFF, wheels, GROUND)
    rates, time, step = np.array([0.0, -0.02, 0.0, 0.005]), 0.1, 1e-5
    before, now, after = (
        risen(platform, [*(rates * moment), *rates]) for moment in (time - step, time, time + step)
    )
    change = rotation(after["attitude"]) - rotation(before["attitude"])
    turn = rotation(now["attitude"]).T @ change / (2.0 * step)
    spin = [turn[2, 1], turn[0, 2], turn[1, 0]]
    assert np.linalg.norm(spin) > 1e-3
    np.testing.assert_allclose(now["angular_velocity"], spin, atol=2e-6)


def test_ground_that_has_risen_is_ground_with_offsets(risen):
    offsets, none = [0.0, -0.01, 0.002, 0.0], [0.0] * 4
    on_offsets = KinematicPlatform(ROLLER, STIFF, None, GROUND, offsets)
    on_plane = KinematicPlatform(ROLLER, STIFF, None, GROUND)
    np.testing.assert_array_equal(
        risen(on_plane, [*offsets, *none])["stance"], risen(on_offsets, none + none)["stance"]
    )
