import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.triples import plus
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import normal_of, to_platform, to_world
from parapod.systems.levelling_platform.turntable import (
    stability_margin,
    stroke_left_turning,
    swept_surface,
    swept_volume,
)
from parapod.systems.levelling_platform.workspace import (
    BOX,
    CENTRE,
    ArmGeometry,
    Workspace,
    enclosed_points,
    faces,
    inside_surfaces,
    posture_grid,
    surface_margins,
    tips_and_volumes,
)

POINT = PlatformGeometry()
ROLLER = PlatformGeometry(foot_radius=0.025)
# Longer legs in front, which also stand further apart.
_REAR, _FRONT = POINT.legs[:2], (replace(leg, l_7=0.212, l_x=-0.43) for leg in POINT.legs[2:])
UNEQUAL = replace(POINT, own_legs=(*_REAR, *_FRONT))
GEOMETRIES = pytest.mark.parametrize(
    "geometry", [POINT, ROLLER, UNEQUAL], ids=["point", "roller", "unequal"]
)
UPRIGHT = ArmGeometry()
LEANING = ArmGeometry(lean=math.radians(45.0), turn=0.7)
ARMS = pytest.mark.parametrize("arm", [UPRIGHT, LEANING], ids=["upright", "leaning"])
LEVEL = (0.0, 0.0)
SLOPE = tuple(np.radians((3.0, 5.0)))
WORKSPACE, ON_SLOPE = Workspace(POINT, UPRIGHT), Workspace(POINT, UPRIGHT, SLOPE)
LOW, HIGH = POINT.extension_min, POINT.extension_max


def drawn(count=500, seed=0):
    """Random extensions of legs 1 to 3 and grounds."""
    random = np.random.default_rng(seed)
    return random.uniform(LOW, HIGH, (count, 3)), random.uniform(-0.1, 0.1, (count, 2))


def middle(geometry=POINT):
    return np.full(4, 0.5 * (geometry.extension_min + geometry.extension_max))


# The tip


@GEOMETRIES
def test_the_tip_of_the_level_platform_is_above_foot_2_by_hand(geometry):
    # Table of the leg at d = .410 m: p_x = .519710, h = .446529 with point feet.
    tip = Workspace(geometry, UPRIGHT).tip_position((0.0, 0.0, 0.446529))
    cos, sin = math.cos(math.radians(49.0)), math.sin(math.radians(49.0))
    by_hand = (0.4 + 0.51971 * cos, 0.17 + 0.51971 * sin + 0.02, 0.446529 + 2.165)
    np.testing.assert_allclose(tip, by_hand, atol=2e-6)


def test_the_paper_s_centre_is_that_of_the_platform_over_leg_2():
    tip = Workspace(POINT, ArmGeometry((0.0, 0.0, 0.0), 0.0)).tip_of_extensions((HIGH,) * 3)
    np.testing.assert_allclose(tip, CENTRE, atol=0.01)


@GEOMETRIES
@ARMS
def test_extensions_to_tip_and_back_is_the_identity(geometry, arm):
    extension, ground = drawn()
    workspace = Workspace(geometry, arm, ground)
    tip = workspace.tip_of_extensions(extension)
    posture, needed = workspace.extensions_reaching(tip)
    np.testing.assert_allclose(needed[:, :3], extension, rtol=0.0, atol=1e-12)
    passive = passive_extension(geometry, extension, ground, posture[:, :2])
    np.testing.assert_allclose(needed[:, 3], passive, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(workspace.tip_position(posture), tip, rtol=0.0, atol=1e-12)


@ARMS
def test_the_jacobian_is_that_of_differences(arm):
    extension, ground = drawn(50)
    workspace = Workspace(ROLLER, arm, ground)
    posture, _ = workspace.extensions_reaching(workspace.tip_of_extensions(extension))
    step = 1e-6
    columns = [
        workspace.tip_position(posture + step * unit)
        - workspace.tip_position(posture - step * unit)
        for unit in np.eye(3)
    ]
    differences = np.stack(columns, axis=-1) / (2.0 * step)
    np.testing.assert_allclose(workspace.tip_jacobian(posture), differences, atol=1e-8)


# Membership


def test_a_point_within_reach_gives_its_posture_and_another_one_names_the_leg_that_limits():
    # Higher at the corner of leg 3 than its stroke allows: it would have to be shorter.
    posture = (0.02, -0.05, 0.55)
    point = WORKSPACE.tip_position(posture)
    needed = inverse_kinematics(PlatformGeometry(extension_min=0.37), posture, LEVEL)
    with pytest.raises(UnreachablePosture) as refused:
        WORKSPACE.posture_reaching(point)
    assert refused.value.leg == int(np.argmin(needed)) + 1
    assert refused.value.extension == pytest.approx(needed.min(), abs=1e-12)
    assert not WORKSPACE.reaches(point)
    # On a slope, within reach, it gives its posture.
    posture = (0.04, 0.06, 0.48)
    given = ON_SLOPE.posture_reaching(ON_SLOPE.tip_position(posture))
    np.testing.assert_allclose(given, posture, rtol=0.0, atol=1e-12)
    assert ON_SLOPE.reaches(ON_SLOPE.tip_position(posture))


@pytest.mark.parametrize("point", [(0.7, 0.5, math.nan), (0.0, 0.0, 9.0)])
def test_points_that_no_leg_reaches_and_nan_are_not_in_the_workspace(point):
    assert not WORKSPACE.reaches(point)
    assert WORKSPACE.stroke_left(point) == -math.inf
    with pytest.raises(UnreachablePosture) as refused:
        WORKSPACE.posture_reaching([np.add(CENTRE, (0.0, 0.0, 2.26)), point])
    assert (refused.value.leg, refused.value.index) == (2, (1,))


def test_a_point_without_three_components_is_refused():
    with pytest.raises(ValueError, match=r"point must have shape \(..., 3\)"):
        WORKSPACE.reaches((0.0, 1.0))


# Faces


@GEOMETRIES
@pytest.mark.parametrize("key", list(faces(POINT, 2)))
def test_a_face_has_its_leg_at_the_stop_and_the_others_within_the_stroke(geometry, key):
    leg, is_long = key
    extension = faces(geometry, 9)[key]
    np.testing.assert_array_equal(extension[..., leg], HIGH if is_long else LOW)
    assert extension.min() >= LOW - 1e-12
    assert extension.max() <= HIGH + 1e-12
    workspace = Workspace(geometry, UPRIGHT)
    _, needed = workspace.extensions_reaching(workspace.tip_of_extensions(extension))
    np.testing.assert_allclose(needed, extension, rtol=0.0, atol=1e-12)


@ARMS
@GEOMETRIES
def test_points_just_inside_the_faces_are_reached_and_just_outside_are_not(geometry, arm):
    workspace = Workspace(geometry, arm)
    heart = workspace.tip_of_extensions(middle())
    for extension in faces(geometry, 9).values():
        # Not on the edges, where the faces' planes meet at an angle.
        tip = workspace.tip_of_extensions(extension[1:-1, 1:-1])
        assert workspace.reaches(tip + 1e-4 * (heart - tip)).all()
        assert not workspace.reaches(tip - 1e-4 * (heart - tip)).any()


@GEOMETRIES
def test_the_faces_close_the_solid(geometry):
    # Divergence theorem: the flux of the position through them is three times the volume.
    flux = 0.0
    workspace = Workspace(geometry, UPRIGHT)
    heart = workspace.tip_of_extensions(middle())
    for extension in faces(geometry, 81).values():
        p = workspace.tip_of_extensions(extension) - heart
        a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
        cells = np.einsum("...i,...i", a, np.cross(b, c)) + np.einsum(
            "...i,...i", a, np.cross(c, d)
        )
        flux += abs(cells.sum() / 6.0)
    grid = posture_grid(geometry, 48)
    assert tips_and_volumes(geometry, UPRIGHT, grid)[1].sum() == pytest.approx(flux, rel=2e-3)


# Volume


@GEOMETRIES
def test_the_volume_is_that_of_the_box_of_extensions_with_leg_4_in_its_stroke(geometry):
    count = 40
    workspace = Workspace(geometry, UPRIGHT)
    share = LOW + (HIGH - LOW) * (np.arange(count) + 0.5) / count
    extension = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    tip = workspace.tip_of_extensions(extension)
    posture, needed = workspace.extensions_reaching(tip)
    fits = (needed[:, 3] >= LOW) & (needed[:, 3] <= HIGH)
    cell = ((HIGH - LOW) / count) ** 3
    by_posture = np.linalg.det(workspace.tip_jacobian(posture[fits]))
    active = np.linalg.det(posture_jacobian(geometry, posture[fits], LEVEL)[:, :3])
    grid = posture_grid(geometry, 40)
    assert grid.count.sum() == pytest.approx(cell * fits.sum(), rel=0.01)
    volume = tips_and_volumes(geometry, UPRIGHT, grid)[1].sum()
    assert volume == pytest.approx(cell * np.abs(by_posture / active).sum(), rel=0.01)


def test_the_workspace_of_a_centred_arm_is_symmetric():
    # The paper's frame {B} is not: foot 2 is at a corner, and the feet move a little.
    centred = Workspace(POINT, ArmGeometry(offset=(0.0, 0.0, 0.145)))
    random = np.random.default_rng(2)
    posture = random.uniform((-0.1, -0.1, 0.42), (0.1, 0.1, 0.53), (200, 3))
    left = centred.stroke_left(centred.tip_position(posture))
    for mirror in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)):
        mirrored = centred.tip_position(posture * mirror)
        np.testing.assert_allclose(centred.stroke_left(mirrored), left, atol=1e-12)


# Inclined ground, Eq. (14)


def test_on_ground_that_rolls_or_pitches_the_workspace_is_turned_about_its_normal_only():
    extension, _ = drawn(200)
    level = WORKSPACE.tip_of_extensions(extension)
    inclined = ON_SLOPE.tip_of_extensions(extension)
    np.testing.assert_allclose(inclined[:, 2], level[:, 2], rtol=0.0, atol=1e-12)
    distance = np.hypot(level[:, 0], level[:, 1])
    np.testing.assert_allclose(np.hypot(inclined[:, 0], inclined[:, 1]), distance, atol=1e-12)
    assert 1e-3 < np.abs(inclined - level).max() < 0.02


def test_eq_14_is_exact_where_roll_and_pitch_do_not_mix():
    # Legs 1 and 4, 2 and 3 in pairs: the platform only rolls, on ground that only rolls.
    posture = np.array([(roll, 0.0, 0.48) for roll in np.linspace(-0.08, 0.08, 9)])
    roll = 0.06
    turned = np.add(posture, (roll, 0.0, 0.0))
    inclined = Workspace(POINT, UPRIGHT, (roll, 0.0)).tip_position(turned)
    np.testing.assert_allclose(inclined, WORKSPACE.tip_position(posture), atol=1e-12)


def test_frame_b_has_the_ground_s_axes():
    posture = (0.04, 0.07, 0.47)
    n = normal_of(*SLOPE)
    extension = inverse_kinematics(POINT, posture, SLOPE)
    foot = foot_to_centre(POINT.legs[1], float(extension[1]))
    arm = UPRIGHT.p_FT
    in_world = to_world(plus(foot, arm), *posture[:2])
    tip = ON_SLOPE.tip_position(posture)
    np.testing.assert_allclose(tip, to_platform(in_world, *SLOPE), atol=1e-14)
    height = np.dot(n, to_world(arm, *posture[:2])) + posture[2]
    assert tip[2] == pytest.approx(height, abs=1e-14)


# The printed surfaces


def test_the_surfaces_are_as_printed():
    x, y, z = 0.1, -0.2, 2.3
    by_hand = [
        -(z**2 - 0.11 * x**2 - 0.1 * y**2 - 5.02 * z + 0.17 * x + 0.13 * y + 6.18),
        z**2 + 0.85 * x**2 + 0.80 * y**2 - 1.22 * x + 0.94 * y - 4.7,
        z**2 + 0.87 * x**2 + 0.96 * y**2 + 1.25 * x - y - 4.70,
        z**2 + x**2 + y**2 + 0.77 * z + 1.47 * y + 1.13 * x - 6.37,
        -(z**2 + 0.49 * x**2 + 0.49 * y**2 - 1.89 * z + 0.74 * x + 0.57 * y - 1.07),
        -(z**2 + 0.85 * x**2 + 1.01 * y**2 + 1.26 * x - 0.96 * y - 5.50),
        -(z**2 + 0.37 * x**2 + 0.32 * y**2 - 2.63 * z - 0.56 * x + 0.43 * y + 0.66),
        -(z**2 + 0.80 * x**2 + 0.88 * y**2 - 1.31 * x - 0.99 * y - 5.50),
    ]
    point = np.add(CENTRE, (x, y, z))
    margins = surface_margins(point)
    np.testing.assert_allclose(margins, by_hand, atol=1e-12)
    np.testing.assert_array_equal(inside_surfaces(point), np.array(by_hand) > 0.0)
    assert not inside_surfaces((math.nan, 0.5, 2.6)).any()


def test_each_surface_follows_another_face():
    # The face on which a surface's equation is nearest to zero; the fit is to 20 mm or so.
    tips = {
        key: WORKSPACE.tip_of_extensions(extension) for key, extension in faces(POINT, 9).items()
    }
    nearest = []
    for i in range(8):
        off = {key: np.abs(surface_margins(tip)[..., i]).mean() for key, tip in tips.items()}
        nearest.append(min(off, key=lambda key: off[key]))
    assert len(set(nearest)) == 8


def test_the_box_holds_all_that_the_surfaces_enclose():
    points, cell = enclosed_points(50)
    low, high = BOX
    side = (high - low) / 50
    assert (points > low + side).all()
    assert (points < high - side).all()
    assert cell * len(points) == pytest.approx(0.016, rel=0.02)


# Turntable


def test_an_upright_arm_gains_nothing_from_the_turntable():
    volume = tips_and_volumes(POINT, UPRIGHT, posture_grid(POINT, 32))[1].sum()
    assert swept_volume(POINT, UPRIGHT, 48) == pytest.approx(volume, rel=0.03)
    turned = replace(UPRIGHT, turn=1.0)
    np.testing.assert_array_equal(turned.p_FT, UPRIGHT.p_FT)


def test_what_is_reached_with_one_turn_is_reached_with_the_turntable():
    random = np.random.default_rng(3)
    arm = replace(LEANING, turn=random.uniform(-math.pi, math.pi, 300))
    extension = np.sort(random.uniform(LOW + 1e-3, HIGH - 1e-3, (300, 1)), axis=1) * np.ones(3)
    tip = Workspace(POINT, arm).tip_of_extensions(extension)
    assert (stroke_left_turning(POINT, LEANING, tip) > 0.9e-3).all()


def test_the_ring_s_surface_is_where_the_stroke_ends():
    surface = swept_surface(POINT, LEANING, 5, 13)
    assert np.abs(stroke_left_turning(POINT, LEANING, surface)).max() < 5e-5
    np.testing.assert_allclose(surface[0], surface[-1], atol=1e-4)
    with pytest.raises(ValueError, match="sweeps no ring"):
        swept_surface(POINT, UPRIGHT, 5, 13)


def test_the_level_platform_stands_as_far_from_tipping_as_its_feet_reach():
    # y of the feet at d = .405 m; the nearest edge is a long side.
    extension = middle()
    _, y, _ = foot_to_centre(POINT.legs[1], float(extension[1]))
    margin = stability_margin(POINT, extension, LEVEL, (0.0, 0.05, -0.1))
    assert margin == pytest.approx(y - 0.05, abs=1e-12)
    attitude = np.add(forward_kinematics(POINT, extension, LEVEL)[:2], (0.1, 0.0))
    assert stability_margin(POINT, extension, attitude, (0.0, 0.0, 0.5)) < y
    assert stability_margin(POINT, extension, LEVEL, (0.0, 2.0, 0.0)) < 0.0
