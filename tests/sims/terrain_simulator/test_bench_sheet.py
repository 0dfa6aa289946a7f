"""Data sheet of the benches against samples, virtual work, checks of paths, and the paper."""

import math

import numpy as np
import pytest

from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.sims.sheet.sheet import find_sheet
from parapod.sims.terrain_simulator.sheet import BenchSheet
from parapod.systems.core.physics import GRAVITY
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    forward_kinematics,
    inverse_jacobian,
    margins,
    slider_forces,
    slider_places,
)
from parapod.systems.terrain_simulator.load_estimator import drive_forces
from parapod.systems.terrain_simulator.path import PathRefused, check_path
from parapod.systems.terrain_simulator.ranges import centre_height, holding_forces, moving_mass
from parapod.systems.terrain_simulator.terrain import Slope, Step

CONFIGURATIONS = ("pedal", "treadmill")
each = pytest.mark.parametrize("configuration", CONFIGURATIONS)
LINE = LIMITS.index("line P T A_3")


def sheet_of(configuration="pedal", wrench=None, **lengths):
    machine = BenchDesign(configuration=configuration, **lengths)
    return BenchSheet(TerrainBenchScenario(machine=machine), wrench)


def is_reached(sheet, points, angles):
    """Which points (n, 2) the plate takes at all angles."""
    poses = np.empty((len(points), len(angles), 3))
    poses[..., :2], poses[..., 2] = points[:, None], angles
    room = margins(sheet.geometry, poses)
    room[..., LINE] -= sheet.scenario.machine.sliders.least_sin_mu
    return (room >= 0.0).all(axis=(1, 2))


@each
def test_areas_are_those_of_random_places(configuration):
    sheet = sheet_of(configuration)
    low, high = np.array((-0.2, 0.0)), np.array((1.5, 0.6))
    points = np.random.default_rng(2).uniform(low, high, (60_000, 2))
    size, most = float((high - low).prod()), sheet._most
    for name, angles in (
        ("area_level_m2", (0.0,)),
        ("area_up_m2", (-most,)),
        ("area_down_m2", (most,)),
        ("area_common_m2", np.linspace(-most, most, 21)),
    ):
        area = is_reached(sheet, points, np.array(angles)).mean() * size
        assert sheet.value(name) == pytest.approx(area, rel=0.05), name


def test_the_widest_boxes_are_those_of_the_experiment():
    # The table of `bench-workspace`: boxes 80 mm high, at all angles.
    assert sheet_of("pedal").box_width_mm == pytest.approx(367.0, abs=1.0)
    assert sheet_of("treadmill").box_width_mm == pytest.approx(457.0, abs=1.0)


def test_the_largest_box_is_reached_at_every_angle_and_no_other_one_is_larger():
    sheet = sheet_of("pedal")
    box, angles = sheet._largest_30, np.radians(np.linspace(-30.0, 30.0, 31))
    edge = np.linspace(1e-4, 1.0 - 1e-4, 9)
    x, z = (axis.ravel() for axis in np.meshgrid(edge, edge))
    inside = np.column_stack((box.x_min + x * box.width, box.z_min + z * box.height))
    assert is_reached(sheet, inside, angles).all()
    area = sheet.box_area_30_m2
    assert area == pytest.approx(1e-6 * sheet.box_width_30_mm * sheet.box_height_30_mm)
    common = sheet._workspace(*angles.tolist())
    heights = np.linspace(0.02, 0.26, 49)
    others = [other.width * h for h in heights if (other := common.widest_box(h))]
    assert max(others) <= 1.01 * area
    assert max(others) >= 0.98 * area


def test_a_box_of_steeper_angles_is_smaller():
    sheet = sheet_of("pedal")
    assert 0.0 < sheet.box_area_m2 < sheet.box_area_30_m2 < sheet.area_level_m2


@each
def test_drives_hold_a_load_beside_the_weight(configuration):
    sheet = sheet_of(configuration)
    geometry, masses = sheet.geometry, sheet.masses
    pose, load = np.add(sheet._pose, (0.02, 0.01, 0.05)), np.array((30.0, -200.0, 7.0))
    own = holding_forces(geometry, masses, pose, np.zeros(3))
    with_load = holding_forces(geometry, masses, pose, load)
    assert with_load - own == pytest.approx(slider_forces(geometry, pose, load))


@each
def test_forces_at_rest_do_the_work_that_lifts_the_centre_of_mass(configuration):
    sheet = sheet_of(configuration)
    geometry, masses, (x, z, _) = sheet.geometry, sheet.masses, sheet._pose
    forces = holding_forces(geometry, masses, np.array((x, z, 0.0)), np.zeros(3))
    by_height = inverse_jacobian(geometry, (x, z, 0.0))[:, 1]
    step = 1e-5
    risen = centre_height(geometry, masses, z + step) - centre_height(geometry, masses, z - step)
    work = moving_mass(masses) * GRAVITY * risen / (2.0 * step)
    assert float(forces @ by_height) == pytest.approx(work, rel=1e-6)


@each
def test_the_largest_load_takes_a_slider_to_its_force(configuration):
    sheet = sheet_of(configuration)
    load = np.array((0.0, -sheet.box_load_N, 0.0))
    forces = holding_forces(sheet.geometry, sheet.masses, sheet._poses, load)
    assert np.abs(forces).max() == pytest.approx(sheet.slider_force_N)


@each
def test_the_load_in_the_gait_is_that_of_the_walk(configuration):
    sheet = sheet_of(configuration)
    walk = sheet.scenario.walk
    plate, on_plate = sheet._motion
    count, first = len(plate) - 1, walk.steady[0]
    strides = count // 240
    motion = walk.at(first + np.linspace(0.0, strides / walk.path.gait.frequency, count + 1))
    aside = motion.foot[0, :, 0] + walk.hip[0] - motion.pose[0, :, 0]
    load = np.stack((0.0 * aside, -motion.force, aside * motion.force), axis=-1)
    # Shortly after touchdown the foot of a treadmill pushes the front end down.
    steady = slice(0, 240 * (strides - 1) - 1)
    assert on_plate[steady] == pytest.approx(load[steady], abs=0.02 * load[:, 1].min() * -1.0)
    forces = drive_forces(sheet.geometry, sheet.masses, np.hstack(motion.pose), load)
    assert sheet.slider_load_N == pytest.approx(np.abs(forces).max(), rel=0.01)


@each
@pytest.mark.parametrize(
    ("name", "terrain"),
    [
        ("slope_up_deg", lambda size, edge: Slope(math.radians(size))),
        ("slope_down_deg", lambda size, edge: Slope(-math.radians(size))),
        ("step_up_mm", lambda size, edge: Step(1e-3 * size, edge)),
        ("step_down_mm", lambda size, edge: Step(-1e-3 * size, edge)),
    ],
)
def test_steeper_or_higher_ground_breaks_a_limit(configuration, name, terrain):
    sheet = sheet_of(configuration)
    path, limits = sheet._path, sheet._limits
    edge = float(path.footholds(4.0)) - 0.5 * path.gait.stride
    duration = 8.0 / path.gait.frequency

    def play(size):
        own = {"terrain": terrain(size, edge)}
        check_path(sheet.geometry, type(path)(**{**vars(path), **own}), limits, duration)

    play(0.98 * sheet.value(name))
    with pytest.raises(PathRefused):
        play(1.02 * sheet.value(name))


@each
def test_a_faster_walk_breaks_a_limit(configuration):
    sheet = sheet_of(configuration)
    speed = sheet.walking_speed_m_s
    check_path(sheet.geometry, sheet._path.at_speed(0.99 * speed), sheet._limits)
    with pytest.raises(PathRefused):
        check_path(sheet.geometry, sheet._path.at_speed(1.01 * speed), sheet._limits)


@each
def test_the_plate_gives_way_by_what_the_sliders_yield(configuration):
    wrench = (200.0, 0.0, -900.0, 0.0, 20.0, 0.0)
    sheet = sheet_of(configuration, wrench)
    geometry, pose = sheet.geometry, sheet._pose
    stiffness = 1e6 * sheet.scenario.machine.sliders.stiffness_N_um
    forces = slider_forces(geometry, pose, (200.0, -900.0, 20.0))
    change = forward_kinematics(geometry, slider_places(geometry, pose) - forces / stiffness)
    change = change - pose
    assert sheet.deflection_mm == pytest.approx(1e3 * np.hypot(*change[:2]), rel=1e-3)
    assert sheet.deflection_deg == pytest.approx(math.degrees(abs(change[2])), rel=1e-3)


@each
def test_every_entry_of_either_bench_is_finite(configuration):
    assert find_sheet("terrain_simulator") is BenchSheet
    for name, value in sheet_of(configuration).values().items():
        assert math.isfinite(value), name


def test_a_bench_of_longer_links_has_a_larger_box():
    longer = {"link_mm": 380.0, "strut_mm": 520.0, "lever_mm": 120.0, "plate_mm": 160.0}
    assert sheet_of(slider_max_mm=1400.0, **longer).box_area_30_m2 > sheet_of().box_area_30_m2
