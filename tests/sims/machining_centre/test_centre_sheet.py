"""Data sheet of the machining centres against samples, statics, plans of jobs, and hand."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from parapod.diagrams.machining_centre.design import CentreDesign
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.sims.machining_centre.sheet import CentreSheet
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.machining_centre.platform_mode import forward_kinematics, inverse_kinematics
from parapod.systems.machining_centre.ranges import drilling_poses, holding_forces
from parapod.systems.machining_centre.statics import CentreStatics
from parapod.systems.machining_centre.wrench_monitor import WrenchMonitor

each_count = pytest.mark.parametrize("limbs", [3, 4, 5])


def scenario_of(limbs):
    return CentreScenario(machine=CentreDesign(limbs=limbs))


def sheet_of(limbs, wrench=None):
    return CentreSheet(scenario_of(limbs), wrench)


def test_heights_are_those_of_a_leg_beside_its_pivot():
    # Cosine rule in the plan: radii of 100 and 180 mm, 45 deg apart.
    aside = 100**2 + 180**2 - 2 * 100 * 180 * math.cos(math.pi / 4)
    sheet = sheet_of(3)
    assert sheet.lowest_height_mm == pytest.approx(math.sqrt(390**2 - aside) + 42)
    assert sheet.highest_height_mm == pytest.approx(math.sqrt(650**2 - aside) + 42)
    assert sheet.depth_mm == pytest.approx(480 - sheet.lowest_height_mm)


@each_count
def test_the_volume_is_that_of_random_places(limbs):
    sheet = sheet_of(limbs)
    geometry = sheet.scenario.machine.geometry
    places = sheet._places
    low, high = places.low - 0.02, places.high + 0.02
    low[2] = max(0.0, low[2])
    points = np.random.default_rng(1).uniform(low, high, (100_000, 3))
    feet = np.repeat(geometry.footholds[:, :3], 2, axis=0)
    lengths = np.linalg.norm(points[:, None] + geometry.pivots - feet, axis=-1)
    inside = ((lengths >= geometry.stroke_min) & (lengths <= geometry.stroke_max)).all(axis=1)
    volume = inside.mean() * (high - low).prod()
    assert sheet.platform_volume_m3 == pytest.approx(volume, rel=0.02)
    extents = 1e3 * np.ptp(points[inside], axis=0)
    own = (sheet.platform_extent_x_mm, sheet.platform_extent_y_mm, sheet.platform_extent_z_mm)
    assert own == pytest.approx(extents, rel=0.05)


@each_count
def test_a_hole_that_leans_farther_is_out_of_reach(limbs):
    sheet = sheet_of(limbs)
    geometry, feet = sheet.scenario.machine.geometry, sheet._posture.feet
    azimuths = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)

    def lean(tilt):
        for azimuth in azimuths:
            axis = np.array((-math.sin(azimuth), math.cos(azimuth), 0.0))
            turn = Rotation.from_rotvec(math.radians(tilt) * axis)
            out = turn.as_matrix()[:, 2]
            # A drill may turn about itself; the sheet's rotations have no yaw.
            roll, pitch = -math.asin(out[1]), math.atan2(out[0], out[2])
            pose = (*(geometry.tool_length * out), roll, pitch, 0.0)
            inverse_kinematics(geometry, pose, feet)

    lean(0.999 * sheet.tilt_deg)
    with pytest.raises(UnreachablePosture):
        lean(1.001 * sheet.tilt_deg)


@each_count
def test_holes_farther_than_the_reach_are_out_of_reach(limbs):
    sheet = sheet_of(limbs)
    geometry, feet, panel = sheet.scenario.machine.geometry, sheet._posture.feet, sheet._panel

    def drill(reach):
        for azimuth in np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False):
            place = 1e-3 * reach * np.array((math.cos(azimuth), math.sin(azimuth)))
            pose = panel.frame(*place, height=geometry.tool_length)
            inverse_kinematics(geometry, pose, feet)

    drill(0.999 * sheet.drill_reach_mm)
    with pytest.raises(UnreachablePosture):
        drill(1.001 * sheet.drill_reach_mm)


def test_poses_on_the_panel_are_its_frames():
    panel = sheet_of(3)._panel
    expected = [panel.frame(0.2, -0.1, height=0.48), panel.frame(-0.3, 0.05, height=0.48)]
    assert drilling_poses(panel, (0.2, -0.3), (-0.1, 0.05), 0.48) == pytest.approx(
        np.array(expected)
    )


@each_count
def test_forces_of_the_legs_are_those_of_the_statics(limbs):
    sheet = sheet_of(limbs)
    geometry, process, posture = sheet.geometry, sheet._process, sheet._posture
    statics = CentreStatics(geometry, process.masses)
    context = statics.CreateDefaultContext()
    values = {
        "pose": posture.pose,
        "feet": posture.feet.ravel(),
        "clamps_closed": np.ones(limbs),
        "tool_force": (process.thrust, process.torque),
    }
    for name, value in values.items():
        statics.GetInputPort(name).FixValue(context, np.array(value))
    wrench = process.wrench(geometry, posture.pose)
    forces = holding_forces(geometry, *posture, wrench)
    assert forces == pytest.approx(statics.GetOutputPort("leg_force").Eval(context))
    assert np.abs(forces).max() <= sheet.leg_load_N


@each_count
def test_the_tip_gives_way_by_what_the_legs_are_shortened(limbs):
    wrench = (30.0, -20.0, -150.0, 2.0, 1.0, 3.0)
    sheet = sheet_of(limbs, wrench)
    geometry, (pose, feet) = sheet.geometry, sheet._posture
    tip = np.array((0.0, 0.0, -geometry.tool_length))
    force, moment = np.array(wrench[:3]), np.array(wrench[3:])
    about = np.concatenate((moment + np.cross(tip, force), force))
    stiffness = 1e6 * sheet.scenario.machine.legs.stiffness_N_um
    lengths = inverse_kinematics(geometry, pose, feet)
    shortened = lengths - holding_forces(geometry, pose, feet, about) / stiffness
    moved = forward_kinematics(geometry, shortened, pose, feet).pose
    place = moved[:3] + Rotation.from_euler("xyz", moved[3:]).apply(tip)
    change = place - (pose[:3] + tip)
    assert sheet.deflection_mm == pytest.approx(1e3 * np.linalg.norm(change), rel=1e-3)
    assert sheet.sinking_mm == pytest.approx(1e3 * abs(change[2]), rel=1e-2)


@each_count
def test_the_largest_thrust_leaves_no_margin(limbs):
    sheet = sheet_of(limbs)
    geometry, process, posture = sheet.geometry, sheet._process, sheet._posture
    monitor = WrenchMonitor(geometry, process.largest_leg_force, process.masses)
    context = monitor.CreateDefaultContext()
    values = {
        "pose_desired": posture.pose,
        "feet": posture.feet.ravel(),
        "clamps_closed": np.ones(limbs),
        "tool_force": (sheet.thrust_N, process.torque),
    }
    for name, value in values.items():
        monitor.GetInputPort(name).FixValue(context, np.array(value))
    Simulator(monitor, context).Initialize()
    assert monitor.GetOutputPort("wrench_margin").Eval(context) == pytest.approx(0.0, abs=1e-6)


def test_more_limbs_resist_more_and_give_way_less():
    sheets = [sheet_of(limbs) for limbs in (3, 4, 5)]
    capacities = [sheet.wrench_capacity_N for sheet in sheets]
    assert capacities == sorted(capacities)
    assert sheets[2].deflection_mm < sheets[0].deflection_mm


def test_conditioning_is_that_of_the_singular_values():
    sheet = sheet_of(4)
    assert 0.0 < sheet.least_conditioning <= sheet.global_conditioning < 1.0
    assert sheet.least_singular <= sheet.local_conditioning * math.sqrt(8.0)
