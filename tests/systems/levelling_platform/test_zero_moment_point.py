import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, MultibodyForces
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull

from parapod.diagrams.levelling_platform.model import DRAWN as GEOMETRY
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.serial_arms import serial_arm
from parapod.systems.levelling_platform.geometry import LegDeviation, drawn_deviations
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, rod_arm
from parapod.systems.levelling_platform.turntable import stability_margin
from parapod.systems.levelling_platform.zero_moment_point import (
    ArmMotion,
    ArmMove,
    Footing,
    move_margin,
    support_polygon,
    tipping_margin,
    zero_moment_point,
)

PARAMS = KinematicPlatformParams()
ROD = PARAMS.arm.links[1]
ARM_CENTRE, ARM_INERTIA = ROD.centre[2], ROD.inertia[0]  # the arm weighs 1 kg
# Arm's base on the platform's axis: mirror images are exact.
CENTRED = replace(PARAMS, arm=rod_arm((0.0, 0.0, 0.145)))
MIDDLE = np.full(4, 0.405)
LEVEL = Footing(MIDDLE)
UPRIGHT = ArmMotion((0.0, 0.0))
SWINGING = ArmMotion((0.4, 0.7), (0.5, -0.9), (-1.5, 3.0))
FULL_SWING = ArmMove((0.0, 0.0), (0.0, math.radians(45.0)), 1.0)


def standing_at(posture, ground, **others):
    """Footing of a platform in that posture on that ground."""
    extension = inverse_kinematics(GEOMETRY, posture, ground)
    return Footing(extension, np.asarray(posture)[..., :2], ground, **others)


LEANING = standing_at((0.01, -0.02, 0.475), (0.03, 0.04))


def to_ground(footing):
    """R_GF: rotation from the platform's axes to the ground's, by Drake."""
    R_WF, R_WG = (
        RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()
        for roll, pitch in (footing.attitude, footing.ground)
    )
    return R_WG.T @ R_WF


def centre_of_mass(arm, params=PARAMS):
    """Centre of mass of platform and arm from F, by hand."""
    turn, swing = arm
    along = [math.sin(swing) * math.cos(turn), math.sin(swing) * math.sin(turn), math.cos(swing)]
    rod, base = params.arm.links[1], params.arm.joints[0].place
    on_arm = np.array(base) + rod.centre[2] * np.array(along)
    moment = params.mass * np.array(params.centre_of_mass) + rod.mass * on_arm
    return moment / (params.mass + rod.mass)


def point(footing=LEVEL, motion=UPRIGHT, params=PARAMS):
    return zero_moment_point(GEOMETRY, params, footing, motion)


def margin(footing=LEVEL, motion=UPRIGHT, params=PARAMS):
    return float(tipping_margin(GEOMETRY, params, footing, motion))


# Support polygon


def test_corners_are_the_feet_in_the_grounds_plane():
    corners = support_polygon(GEOMETRY, LEANING)
    for corner, leg, d in zip(corners, GEOMETRY.legs, LEANING.extension, strict=True):
        foot = to_ground(LEANING) @ -np.array(foot_to_centre(leg, float(d)))
        np.testing.assert_allclose(corner, foot[:2], atol=1e-15)
        assert foot[2] == pytest.approx(-(0.475 - GEOMETRY.foot_radius), abs=1e-12)


@pytest.mark.parametrize("lifted", [None, 0, 1, 2, 3])
def test_corners_are_the_convex_hull_of_the_standing_feet(lifted):
    random = np.random.default_rng(5)
    geometry = replace(GEOMETRY, deviations=drawn_deviations(random, 2e-3, 0.01))
    standing = (np.arange(4) != lifted).astype(float)
    for _ in range(10):
        footing = Footing(random.uniform(0.38, 0.46, 4), random.uniform(-0.1, 0.1, 2))
        feet = support_polygon(geometry, footing)[standing > 0.5]
        hull = ConvexHull(feet)
        corners = support_polygon(geometry, footing._replace(standing=standing))
        assert len(hull.vertices) == len(feet)
        assert set(map(tuple, corners)) == set(map(tuple, feet))
        x, y = corners.T
        area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        assert area == pytest.approx(hull.volume, rel=1e-12)  # positive: anticlockwise


def test_the_margin_with_a_foot_in_the_air_is_that_of_the_triangle():
    # The hull's equations are outward normals and offsets: the distance is the largest of them.
    random = np.random.default_rng(6)
    for lifted in range(4):
        standing = np.ones(4)
        standing[lifted] = 0.0
        footing = Footing(MIDDLE, (0.02, 0.03), standing=standing)
        hull = ConvexHull(support_polygon(GEOMETRY, footing)[standing > 0.5])
        inside = 0
        for centre in random.uniform(-0.3, 0.3, (40, 2)):
            params = replace(PARAMS, centre_of_mass=(*centre, -0.1))
            distance = -np.max(
                hull.equations[:, :2] @ point(footing, params=params) + hull.equations[:, 2]
            )
            found = margin(footing, params=params)
            assert (found > 0.0) == (distance > 0.0)
            if distance > 0.0:
                inside += 1
                assert found == pytest.approx(distance, abs=1e-12)
            else:
                assert found <= distance + 1e-12  # a corner is further away than the lines
        assert 5 < inside < 35


def test_a_point_beyond_a_corner_is_as_far_away_as_the_corner():
    beyond = np.add(support_polygon(GEOMETRY, LEVEL)[3], (0.3, 0.4))
    x, y = beyond * CENTRED.total / CENTRED.mass
    params = replace(CENTRED, centre_of_mass=(x, y, -0.1))
    np.testing.assert_allclose(point(params=params), beyond, atol=1e-12)
    assert margin(params=params) == pytest.approx(-0.5, abs=1e-12)


def test_fewer_than_three_feet_carry_nothing():
    for feet in ((), (0,), (2,), (0, 1), (0, 2), (1, 3)):
        standing = [float(i in feet) for i in range(4)]
        assert margin(Footing(MIDDLE, standing=standing)) == -math.inf


# Zero-moment point with the arm at rest


def test_level_and_upright_the_margin_is_the_centre_of_mass_from_the_long_side():
    _, y, _ = centre_of_mass((0.0, 0.0))
    _, foot_y, _ = foot_to_centre(GEOMETRY.legs[1], 0.405)
    assert margin() == pytest.approx(foot_y - abs(y), abs=1e-13)


def test_at_rest_the_point_is_vertically_under_the_centre_of_mass_on_any_plane():
    random = np.random.default_rng(1)
    for _ in range(30):
        ground, tilt = random.uniform(-0.2, 0.2, (2, 2))
        footing = Footing(MIDDLE, ground + 0.1 * tilt, ground)
        arm = random.uniform(-1.5, 1.5, 2)
        R_WF = RollPitchYaw(*footing.attitude, 0.0).ToRotationMatrix().matrix()
        R_WG = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()
        feet = [R_WF @ -np.array(foot_to_centre(leg, 0.405)) for leg in GEOMETRY.legs]
        height = GEOMETRY.foot_radius - np.mean(feet @ R_WG[:, 2])
        p_W = R_WG @ np.array([*point(footing, ArmMotion(arm)), -height])
        np.testing.assert_allclose(p_W[:2], (R_WF @ centre_of_mass(arm))[:2], atol=1e-13)


def test_on_level_ground_it_is_the_margin_of_the_workspace_chapter():
    for arm in ((0.0, 0.0), (1.0, 0.8), (-1.6, 1.5)):
        known = stability_margin(GEOMETRY, MIDDLE, (0.0, 0.0), centre_of_mass(arm))
        assert margin(motion=ArmMotion(arm)) == pytest.approx(float(known), abs=1e-13)


# Symmetry


@pytest.mark.parametrize(
    ("legs", "signs", "turned"),
    [
        # Left and right.
        ((1, 0, 3, 2), (-1.0, 1.0), 0.0),
        # Front and back.
        ((3, 2, 1, 0), (1.0, -1.0), math.pi),
    ],
)
def test_mirror_images_have_mirrored_points_and_the_same_margin(legs, signs, turned):
    mirrored = Footing(
        LEANING.extension[list(legs)],
        np.multiply(LEANING.attitude, signs),
        np.multiply(LEANING.ground, signs),
    )
    (turn, swing), (turn_1, swing_1), (turn_2, swing_2) = SWINGING
    reflected = ArmMotion((turned - turn, swing), (-turn_1, swing_1), (-turn_2, swing_2))
    x, y = point(LEANING, SWINGING, CENTRED)
    expected = np.multiply((x, y), signs[::-1])
    np.testing.assert_allclose(point(mirrored, reflected, CENTRED), expected, atol=1e-14)
    assert margin(mirrored, reflected, CENTRED) == pytest.approx(
        margin(LEANING, SWINGING, CENTRED), abs=1e-14
    )


# With the arm's inertia


class Machine:
    """The multibody model; the platform held still, the arm accelerated."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self.model = add_platform(self.plant, "reduced")
        self.diagram = builder.Build()
        root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(root)
        self.link = self.plant.GetBodyByName("link")
        joints = [self.plant.GetJointByName(name) for name in ("turntable", "arm")]
        base, tip = self.model.base.body_frame(), self.plant.GetFrameByName("arm_tip")
        self.arm = serial_arm(self.plant, base, joints, tip)

    def place(self, footing, angle):
        posture = forward_kinematics(GEOMETRY, footing.extension, footing.ground)
        positions = self.model.positions(footing.extension, posture, footing.ground, angle)
        self.plant.SetPositions(self.context, positions)
        self.plant.SetVelocities(self.context, np.zeros(self.plant.num_velocities()))
        return posture[2]

    def params(self):
        """Masses of platform and arm as they stand."""
        plant, context = self.plant, self.context
        X_WF = plant.EvalBodyPoseInWorld(context, self.model.base)
        bodies = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
        rest = [body for body in bodies if body.name() not in ("ground", "turntable", "link")]
        masses = np.array([body.get_mass(context) for body in rest])
        centres = [
            plant.EvalBodyPoseInWorld(context, body) @ body.CalcCenterOfMassInBodyFrame(context)
            for body in rest
        ]
        return KinematicPlatformParams(
            mass=float(masses.sum()),
            centre_of_mass=tuple(X_WF.inverse() @ (masses @ centres / masses.sum())),
            arm=self.arm,
        )

    def zero_moment_point(self, footing, motion):
        """From the wrench that the ground has to bear, in the ground's axes."""
        height = self.place(footing, motion.position)
        plant, context = self.plant, self.context
        v, vdot = np.zeros((2, plant.num_velocities()))
        plant.SetVelocitiesInArray(self.model.arm, np.array(motion.rate), v)
        plant.SetVelocitiesInArray(self.model.arm, np.array(motion.acceleration), vdot)
        plant.SetVelocities(context, v)
        gravity = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, gravity)
        start = self.model.base.floating_velocities_start_in_v()
        wrench = plant.CalcInverseDynamics(context, vdot, gravity)[start : start + 6]
        R_WG = RollPitchYaw(*footing.ground, 0.0).ToRotationMatrix().matrix()
        moment, force = R_WG.T @ wrench[:3], R_WG.T @ wrench[3:]
        # The moment about (x, y, -height) has no component in the plane.
        at_origin = moment - np.cross((0.0, 0.0, -height), force)
        return np.array([-at_origin[1], at_origin[0]]) / force[2]


@pytest.fixture(scope="module")
def machine():
    return Machine()


def motions(count=15, seed=2):
    random = np.random.default_rng(seed)
    for _ in range(count):
        footing = standing_at(
            (*random.uniform(-0.02, 0.02, 2), 0.475), random.uniform(-0.04, 0.04, 2)
        )
        yield footing, ArmMotion(*(random.uniform(-1.0, 1.0, (3, 2)) * [[1.5], [1.2], [4.7]]))


def test_the_multibody_model_agrees(machine):
    for footing, motion in motions():
        expected = machine.zero_moment_point(footing, motion)
        found = point(footing, motion, machine.params())
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
        at_rest = point(footing, ArmMotion(motion.position), machine.params())
        assert np.linalg.norm(found - at_rest) > 1e-3
        # Its legs' centres of mass move with the stroke; the paper's arm is rounded.
        np.testing.assert_allclose(point(footing, motion), expected, rtol=0.0, atol=1e-3)


def test_the_papers_arm_is_the_drawn_one_but_for_spin_and_what_is_rounded(machine):
    mass, centre, inertia = (
        getattr(machine.arm.links[1], n) for n in ("mass", "centre", "inertia")
    )
    assert mass == pytest.approx(ROD.mass, abs=1e-12)
    np.testing.assert_allclose(centre, ROD.centre, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(inertia, ROD.inertia, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(inertia[:2], ARM_INERTIA, rtol=0.0, atol=1e-12)


def test_swinging_an_upright_arm_pushes_the_point_back():
    # About the plane's point under the arm: m a (h + z + l) and m k^2 for the turning.
    acceleration = 2.0
    height = GEOMETRY.foot_radius + foot_to_centre(GEOMETRY.legs[0], 0.405)[2]
    lever = height + 0.145 + ARM_CENTRE
    moment = (ARM_CENTRE * lever + ARM_INERTIA) * acceleration
    pushed = point(motion=ArmMotion((0.0, 0.0), acceleration=(0.0, acceleration)), params=CENTRED)
    np.testing.assert_allclose(pushed, (-moment / (51.0 * 9.81), 0.0), atol=1e-14)


def test_turning_steadily_pulls_the_point_outwards_and_lightens_nothing():
    lean, rate = 0.8, 2.0
    resting, turning = (
        point(motion=ArmMotion((0.0, lean), rate=(w, 0.0)), params=CENTRED) for w in (0.0, rate)
    )
    height = GEOMETRY.foot_radius + foot_to_centre(GEOMETRY.legs[0], 0.405)[2]
    lever = height + 0.145 + ARM_CENTRE * math.cos(lean)
    force = ARM_CENTRE * math.sin(lean) * rate**2
    moment = force * lever + ARM_INERTIA * math.sin(lean) * math.cos(lean) * rate**2
    np.testing.assert_allclose(turning - resting, (moment / (51.0 * 9.81), 0.0), atol=1e-14)


# Moves


@pytest.mark.parametrize("profile", ["cubic", "quintic"])
def test_a_move_is_the_polynomial_from_rest_to_rest(profile):
    move = ArmMove((0.2, -0.1), (1.0, 0.7), 1.6, profile)
    times = np.linspace(0.0, 1.6, 4001)[:-1]
    angle, rate, acceleration = (
        np.array(column) for column in zip(*(move.at(t) for t in times.tolist()), strict=True)
    )
    step = times[1]
    np.testing.assert_allclose(np.gradient(angle, step, axis=0)[1:-1], rate[1:-1], atol=1e-5)
    np.testing.assert_allclose(
        np.gradient(rate, step, axis=0)[1:-1], acceleration[1:-1], atol=1e-4
    )
    assert (angle[0], rate[0]) == (pytest.approx((0.2, -0.1)), pytest.approx((0.0, 0.0)))
    np.testing.assert_allclose(rate[-1], 0.0, atol=2e-3)
    np.testing.assert_allclose(angle[len(angle) // 2], (0.6, 0.3), atol=1e-12)
    if profile == "quintic":
        np.testing.assert_allclose(acceleration[[0, -1]], 0.0, atol=2e-2)


def test_before_and_after_a_move_the_arm_rests_exactly_at_its_ends():
    move = ArmMove((0.1, 0.2), (0.3, 0.7), 0.7)
    assert move.at(-1e-9) == ArmMotion(move.start)
    assert move.at(0.7) == ArmMotion(move.goal)
    assert move.at(math.inf) == ArmMotion(move.goal)


@pytest.mark.parametrize("profile", ["cubic", "quintic"])
@pytest.mark.parametrize("goal", [(0.0, 0.785), (3.0, 0.1), (-2.0, -1.5)])
def test_the_shortest_move_reaches_one_limit_and_exceeds_none(profile, goal):
    rate, acceleration = np.array((1.0, 0.5)), np.array((4.0, 3.0))
    move = ArmMove.within((0.0, 0.0), goal, tuple(rate), tuple(acceleration), profile)
    motion = [move.at(t) for t in np.linspace(0.0, move.duration, 2001)[:-1].tolist()]
    peak_rate = np.max([np.abs(m.rate) for m in motion], axis=0) / rate
    peak_acceleration = np.max([np.abs(m.acceleration) for m in motion], axis=0) / acceleration
    assert max(*peak_rate, *peak_acceleration) == pytest.approx(1.0, abs=1e-5)


def test_a_move_that_goes_nowhere_takes_no_time_and_is_at_rest():
    here = (0.3, 0.4)
    move = ArmMove.within(here, here, (1.0, 1.0), (1.0, 1.0))
    assert move.duration == 0.0
    assert move.at(0.0) == ArmMotion(here)
    expected = margin(motion=ArmMotion(here))
    assert move_margin(GEOMETRY, PARAMS, LEVEL, move) == pytest.approx(expected, abs=1e-15)


def test_slow_moves_are_quasi_static_and_fast_ones_cost_margin():
    def of(duration, with_acceleration=True):
        move = replace(FULL_SWING, start=(1.6, 0.0), goal=(1.6, 0.8), duration=duration)
        return move_margin(GEOMETRY, PARAMS, LEANING, move, with_acceleration)

    at_rest = of(1.0, with_acceleration=False)
    assert at_rest == of(0.1, with_acceleration=False)
    losses = np.array([at_rest - of(duration) for duration in (0.5, 1.0, 2.0, 4.0, 1e4)])
    assert (np.diff(losses) < 0.0).all()
    assert losses[-1] < 1e-9
    # With the whole push at the end of the swing, the loss goes with one over time squared.
    assert losses[1] / losses[2] == pytest.approx(4.0, rel=0.05)


def test_the_smallest_margin_along_a_move_may_be_at_neither_end():
    # From straight ahead to straight behind, leaning: sideways it is worst.
    move = ArmMove((0.0, 1.2), (math.pi, 1.2), 100.0)
    along = move_margin(GEOMETRY, PARAMS, LEVEL, move, with_acceleration=False)
    sideways = margin(motion=ArmMotion((math.pi / 2, 1.2)))
    assert along == pytest.approx(sideways, abs=1e-12)
    assert along < margin(motion=ArmMotion(move.start)) - 0.02


def test_rest_before_and_after_a_move_counts():
    # On three feet, where the accelerations at both ends happen to push inwards.
    footing = LEVEL._replace(standing=(1.0, 1.0, 1.0, 0.0))
    move = ArmMove((-0.1, 1.5), (0.0, 1.4), 1.0)
    moving = float(tipping_margin(GEOMETRY, PARAMS, footing, move.sampled()).min())
    resting = min(margin(footing, ArmMotion(end)) for end in (move.start, move.goal))
    assert resting < moving - 5e-4
    assert move_margin(GEOMETRY, PARAMS, footing, move) == pytest.approx(resting, abs=1e-15)


def test_between_the_instants_that_are_looked_at_nothing_hides():
    random = np.random.default_rng(7)
    for _ in range(10):
        standing = np.ones(4)
        standing[random.integers(4)] = 0.0
        footing = LEANING._replace(standing=standing)
        start, goal = random.uniform(-1.5, 1.5, (2, 2)) * (4.0, 1.0)
        move = ArmMove.within(tuple(start), tuple(goal), (1.2, 1.2), (4.7, 4.7))
        times = np.linspace(0.0, move.duration, 5000, endpoint=False)
        motions_between = zip(*(move.at(t) for t in times.tolist()), strict=True)
        motion = ArmMotion(*(np.array(column) for column in motions_between))
        exact = float(tipping_margin(GEOMETRY, PARAMS, footing, motion).min())
        found = move_margin(GEOMETRY, PARAMS, footing, move)
        assert found == pytest.approx(exact, abs=5e-5)


SIZES = {"extension": 4, "attitude": 2, "ground": 2, "standing": 4} | dict.fromkeys(
    ArmMotion._fields, 2
)


def margin_with(name, value):
    """Margin of a swinging arm with one part of the footing or of the motion replaced."""
    is_arm = name in ArmMotion._fields
    footing = LEVEL if is_arm else LEVEL._replace(**{name: value})
    motion = SWINGING._replace(**{name: value}) if is_arm else SWINGING
    return tipping_margin(GEOMETRY, PARAMS, footing, motion)


@pytest.mark.parametrize("name", SIZES)
def test_values_that_are_not_finite_leave_no_margin_and_finite_ones_never_give_nan(name):
    part = LEVEL if name in Footing._fields else SWINGING
    for batch in ((), (2,)):
        for bad in (math.nan, math.inf):
            value = np.array(np.broadcast_to(getattr(part, name), (*batch, SIZES[name])))
            value[..., 1] = bad
            found = margin_with(name, value)
            assert found.shape == batch
            assert (found == -math.inf).all()
        for huge in (1e3, 1e100, -1e300):
            assert not np.isnan(margin_with(name, np.full((*batch, SIZES[name]), huge))).any()


def test_an_arm_that_lifts_the_platform_leaves_no_margin_and_no_point():
    # Thrown down, or whirled: the ground would have to pull.
    falling = ArmMotion((0.0, math.pi / 2), acceleration=(0.0, 400.0))
    assert margin(motion=falling) == -math.inf
    assert np.isnan(point(motion=falling)).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mass", 60.0),
        ("centre_of_mass", (0.05, 0.0, -0.1)),
        ("arm", rod_arm(mass=2.0)),
        ("arm", rod_arm((0.1, 0.05, 0.145))),
        ("arm", rod_arm(centre=1.0)),
        ("gravity", 1.62),
    ],
)
def test_each_param_counts(field, value):
    changed = point(LEANING, SWINGING, replace(PARAMS, **{field: value}))
    assert np.linalg.norm(changed - point(LEANING, SWINGING)) > 1e-4


def test_legs_as_built_count():
    deviations = (LegDeviation(l_y=0.01), *(LegDeviation(),) * 3)
    corners = support_polygon(replace(GEOMETRY, deviations=deviations), LEVEL)
    moved = corners - support_polygon(GEOMETRY, LEVEL)
    np.testing.assert_allclose(moved, [[0, -0.01], [0, 0], [0, 0], [0, 0]], atol=1e-15)
