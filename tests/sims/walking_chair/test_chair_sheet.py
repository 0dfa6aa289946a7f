"""Data sheet of the walking chair against checks of gaits, energy, samples, and hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.diagrams.walking_chair.scenario import ChairScenario, PassengerScenario
from parapod.sims.walking_chair.sheet import ChairSheet
from parapod.systems.walking_chair.checks import (
    ForceExceeded,
    SpeedExceeded,
    StrokeExceeded,
    check_forces,
    check_gait,
    stroke_excess,
)
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.leg import branch_lengths, is_within_joints, up_of_corner
from parapod.systems.walking_chair.ranges import (
    body_stiffness,
    level_range,
    overlap,
    straight_lengths,
    straight_stance,
)
from parapod.systems.walking_chair.statics import rest

FAST = 1.0  # a speed that no gait needs [m/s]


@pytest.fixture(scope="module")
def scenario():
    return ChairScenario()


@pytest.fixture(scope="module")
def sheet(scenario):
    return ChairSheet(scenario)


def gait_of(scenario):
    return replace(scenario.walk.gaits[0], cycles=1)


def test_the_lowest_seat_is_that_of_retracted_up_branches(sheet):
    # Table 1: t_1 + d_1 + d_2, l_11, d_5; and the seat.
    assert sheet.lowest_seat_mm == pytest.approx(10 + 21 + 23 + 591.4 + 20 + 198)


def test_the_highest_seat_is_that_of_extended_ups_branches(sheet):
    # 80 mm aside, and 23 mm more than the UP branch.
    upright = math.sqrt(874.0**2 - 80.0**2)
    assert sheet.highest_seat_mm == pytest.approx(54 + min(891.4, upright + 23) + 20 + 198)


@pytest.mark.parametrize(
    ("name", "size"), [("longest_step_mm", "step"), ("highest_swing_mm", "swing_height")]
)
def test_a_gait_beyond_the_largest_size_leaves_a_stroke(scenario, sheet, name, size):
    geometry, gait = scenario.machine.geometry, gait_of(scenario)
    largest = 1e-3 * sheet.value(name)
    check_gait(geometry, replace(gait, **{size: 0.999 * largest}), FAST)
    with pytest.raises(StrokeExceeded):
        check_gait(geometry, replace(gait, **{size: 1.001 * largest}), FAST)


def test_the_fastest_walk_needs_the_speed_of_the_drives(scenario, sheet):
    geometry, gait = scenario.machine.geometry, gait_of(scenario)
    duration = gait.step / (3e-3 * sheet.walking_speed_mm_s)
    limit = 1e-3 * scenario.machine.drives.max_velocity_mm_s
    check_gait(geometry, replace(gait, phase_duration=1.005 * duration), limit)
    with pytest.raises(SpeedExceeded):
        check_gait(geometry, replace(gait, phase_duration=0.995 * duration), limit)


def test_a_passenger_beyond_the_heaviest_is_refused(scenario, sheet):
    machine, walk = scenario.machine, Walk((gait_of(scenario),))
    drives = machine.drives

    def seat(mass):
        passenger = replace(scenario.passenger.passenger, mass=mass)
        limits = drives.max_force_N, drives.stiffness
        check_forces(machine.geometry, walk, passenger, machine.masses, *limits)

    seat(0.999 * sheet.passenger_kg)
    with pytest.raises(ForceExceeded):
        seat(1.001 * sheet.passenger_kg)


def test_the_volume_of_a_foot_is_that_of_random_places(scenario, sheet):
    leg = scenario.machine.geometry.leg
    places = sheet._places.place
    low, high = places.min(axis=0) - 0.02, places.max(axis=0) + 0.02
    points = np.random.default_rng(0).uniform(low, high, (200_000, 3))
    with np.errstate(all="ignore"):
        up = up_of_corner(leg, points - leg.upper_joints[0], leg.corners.mean(axis=0))
        lengths = branch_lengths(leg, up)
        reached = (stroke_excess(leg, lengths) <= 0.0).all(axis=-1) & is_within_joints(up)
    reached &= (np.abs(up[:, 1:]) <= math.radians(45.0)).all(axis=-1)
    assert sheet.foot_volume_m3 == pytest.approx(reached.mean() * (high - low).prod(), rel=0.01)


def test_on_the_steepest_ground_legs_are_at_both_ends_of_their_range():
    scenario = ChairScenario()
    leg = scenario.machine.placements[0]  # behind on the left, from now on farther
    leg.x_mm, leg.y_mm = -200.0, -300.0
    sheet, uphill = ChairSheet(scenario), np.array((-0.6, -0.8))
    azimuth = math.atan2(*uphill[::-1])
    rise = np.tan(level_range(scenario.machine.geometry, azimuth))
    # A level sole rests on its corner that is farthest uphill.
    heights = [max(rise * corner @ uphill for corner in foot) for foot in sheet._feet]
    assert 1e3 * (max(heights) - min(heights)) == pytest.approx(sheet.step_height_mm)


def test_stiffness_is_the_curvature_of_the_energy_in_the_branches(scenario):
    geometry, stiffness = scenario.machine.geometry, 2e6
    leg = geometry.leg
    lengths = straight_lengths(leg, np.full(4, leg.retracted_height + 0.1))
    middle = leg.corners.mean(axis=0)
    feet = np.array([middle[0], middle[1], -leg.retracted_height - 0.1])

    def energy(motion):
        moved = feet - leg.upper_joints[0]
        total = 0.0
        for R, p in zip(geometry.R_SA, geometry.p_SA, strict=True):
            arm = p + R @ feet
            change = R.T @ -(motion[:3] + np.cross(motion[3:], arm))
            now = branch_lengths(leg, up_of_corner(leg, moved + change, middle))
            total += 0.5 * stiffness * float(((now - lengths[0]) ** 2).sum())
        return total

    step = 1e-5
    basis = step * np.eye(6)
    curvature = np.array(
        [[(energy(a + b) - energy(a - b)) / (2.0 * step**2) for b in basis] for a in basis]
    )
    matrix = body_stiffness(geometry, lengths, stiffness)
    assert curvature == pytest.approx(matrix, rel=1e-3, abs=1e-4 * matrix.max())


def test_the_seat_sinks_by_its_load_through_the_stiffness(scenario):
    one, two = (ChairSheet(scenario, (0.0, 0.0, load, 0.0, 0.0, 0.0)) for load in (-100, -200))
    assert two.deflection_mm == pytest.approx(2.0 * one.deflection_mm)
    soft = ChairScenario()
    soft.machine.drives.stiffness_N_um = 0.5
    assert ChairSheet(soft, one.wrench).deflection_mm == pytest.approx(2.0 * one.deflection_mm)


def test_a_push_at_the_seat_does_the_work_that_the_branches_store(scenario):
    push = np.array((80.0, 0.0, 0.0))
    sheet = ChairSheet(scenario, (*push.tolist(), 0.0, 0.0, 0.0))
    seat = np.array((0.0, 0.0, scenario.machine.geometry.seat_height))
    motion = np.linalg.solve(sheet._stiffness, np.concatenate((push, np.cross(seat, push))))
    # To the side, where it is pushed, by the chair's symmetry.
    work = motion @ sheet._stiffness @ motion
    assert 1e-3 * sheet.deflection_mm * push[0] == pytest.approx(work)


def test_the_retracted_chair_bears_its_weight_on_four_feet(scenario):
    machine = scenario.machine
    (corners,), (by_vertical,) = straight_stance(machine.geometry)[1:]
    weight = machine.masses.total * 9.81
    at_rest = rest(corners.reshape(12, 3), by_vertical, weight, np.zeros(2))
    assert at_rest.loads.sum() == pytest.approx(weight, rel=1e-6)
    assert at_rest.height == pytest.approx(machine.geometry.leg.retracted_height, abs=1e-3)


def test_squares_overlap_by_their_common_width():
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    assert overlap(square, np.add(square, (0.7, 0.1))) == pytest.approx(0.3)
    assert overlap(square, np.add(square, (1.5, 0.0))) == pytest.approx(-0.5)


def test_an_empty_seat_lowers_the_load_and_the_centre(scenario, sheet):
    empty = ChairSheet(replace(scenario, passenger=PassengerScenario(0.0)))
    assert empty.branch_load_N < sheet.branch_load_N
    assert empty.centre_of_mass_mm < sheet.centre_of_mass_mm
    assert empty.passenger_kg == pytest.approx(sheet.passenger_kg)
