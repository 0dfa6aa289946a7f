"""The experiment `arm-workspace`: the tip's reach beside forward kinematics, and its sag."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parapod
from parapod.diagrams.levelling_platform.pointing import carried_arm
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.levelling_platform.arm_workspace import horizontal_sag_error, level_volume
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.tip_columns import TipColumns

LEVEL = (0.0, 0.0)
CRANE = Path(__file__).parents[3] / "examples" / "machines" / "reach_arm.urdf"
STEPS, COUNT = 4, 12  # of attitudes, and columns in each direction
# Leans of the arm beyond the horizontal, and not up to it.
SECTOR = "[{lower_deg: -10, upper_deg: 120}, {lower_deg: -75, upper_deg: 40}]"
ARMS = ("[{}, {}]", SECTOR, "[{}, {upper_deg: 150}]")


def carried_with(*overrides):
    settings = ("machine.arm=!FlexibleRod {}", *overrides)
    return carried_arm(load_scenario(LevellingScenario, overrides=settings))


FLEXIBLE = carried_with()
RIGID = replace(FLEXIBLE, rod=None)


def reached_tips(carried, is_locked, count=1500):
    """Tips (m, 3) at random heights, attitudes and joints that nothing forbids."""
    random = np.random.default_rng(3)
    attitude = random.uniform(-0.16, 0.16, (40 * count, 2))
    low, high = height_range(carried.geometry, attitude, LEVEL).T
    fits = np.flatnonzero(low < high)[:count]
    height = random.uniform(low[fits], high[fits])
    turntable, arm = carried.arm.joints
    turns = random.uniform(
        max(turntable.lower, -math.pi), min(turntable.upper, math.pi), len(fits)
    )
    joints = [0.0 * turns if is_locked else turns, random.uniform(arm.lower, arm.upper, len(fits))]
    posture, joints = np.column_stack([attitude[fits], height]), np.column_stack(joints)
    tips = carried.tip_position(posture, joints)
    return tips[carried.admits(posture, joints) & (tips[:, 2] > 0.0)]


def distance_from(columns, tips):
    """Distance of tips (m) above or below their columns [m]; below zero inside."""
    low, high = columns.intervals(tips[:, :2])
    beyond = np.maximum(low - tips[:, 2:], tips[:, 2:] - high)
    return np.where(np.isnan(beyond), math.inf, beyond).min(axis=1)


@pytest.mark.parametrize("is_locked", [False, True])
@pytest.mark.parametrize("arm", ARMS)
def test_random_postures_bring_the_tip_into_its_column(arm, is_locked):
    carried = carried_with(f"machine.arm.each_drive={arm}")
    tips = reached_tips(carried, is_locked)
    beyond = distance_from(TipColumns(carried, STEPS, is_locked), tips)
    assert len(tips) > 500
    assert (beyond > 1e-3).mean() < 0.01
    assert np.median(beyond) < -0.01


def test_points_inside_a_column_are_reached_by_the_redundant_chain_too():
    random = np.random.default_rng(5)
    columns = TipColumns(FLEXIBLE, STEPS)
    angle = random.uniform(-math.pi, math.pi, 12)
    radius = np.linspace(0.3, 0.98, 12) * columns.radius(angle)
    places = columns.joint[:2] + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    low, high = columns.intervals(places)[..., 0]
    for place, z in zip(places, low + random.uniform(0.05, 0.95, 12) * (high - low), strict=True):
        assert FLEXIBLE.reach([*place, z]).solution.is_reached


def test_points_just_outside_a_column_are_not_reached():
    columns = TipColumns(FLEXIBLE, 8)
    places = columns.joint[:2] + np.array([[1.0, 0.0], [0.0, 1.7], [-1.5, 1.2]])
    low, high = columns.intervals(places)[..., 0]
    for place, *ends in zip(places, low - 0.02, high + 0.02, strict=True):
        for z in ends:
            with pytest.raises(parapod.ParapodError, match="does not reach"):
                FLEXIBLE.reach([*place, z])


@pytest.mark.parametrize("carried", [RIGID, FLEXIBLE], ids=["rigid", "flexible"])
def test_level_volume_is_its_quadrature(carried):
    assert TipColumns(carried, 0).volume(2 * COUNT) == pytest.approx(
        level_volume(carried), rel=1e-3
    )


def test_level_rigid_rod_fills_the_disc_below_it_times_the_heights():
    low, high = height_range(RIGID.geometry, LEVEL, LEVEL)
    disc = math.pi * RIGID.arm.tip_place[2] ** 2
    assert level_volume(RIGID) == pytest.approx(disc * (high - low), rel=1e-4)


def test_quadrature_counts_a_curve_that_turns_back_below_the_horizontal():
    bent = carried_with("machine.arm.each_drive=[{}, {upper_deg: 100}]")
    assert TipColumns(bent, 0).volume(2 * COUNT) == pytest.approx(level_volume(bent), rel=5e-3)
    assert level_volume(bent) > 1.01 * level_volume(FLEXIBLE)


def test_heights_that_are_reached_above_and_below_the_joint_count_once():
    bent = carried_with("machine.arm.each_drive=[{}, {upper_deg: 100}]")
    columns = TipColumns(replace(bent, rod=None), 0)
    place = columns.joint[:2] + np.array([0.9992 * float(columns.radius(0.0)), 0.0])
    low, high = columns.intervals(place[np.newaxis])[:, 0]
    assert low.max() < high.min()
    assert columns.lengths(place[np.newaxis]) == pytest.approx(high.max() - low.min())


def test_quadrature_is_left_out_where_something_else_limits_the_reach():
    assert level_volume(carried_with("machine.arm.each_drive=[{}, {upper_deg: 150}]")) is None
    assert level_volume(carried_with("machine.arm.each_drive=[{upper_deg: 90}, {}]")) is not None
    narrow = "machine.arm.each_drive=[{lower_deg: -90, upper_deg: 90}, {}]"
    assert level_volume(carried_with(narrow)) is None


def test_more_freedom_reaches_more():
    level, tilting, locked = (
        TipColumns(FLEXIBLE, *which).volume(COUNT) for which in ((0,), (3,), (3, True))
    )
    assert locked < level < tilting


@pytest.mark.parametrize(("is_locked", "bound"), [(False, 0.01), (True, 0.02)])
def test_half_the_columns_give_nearly_the_same_volume(is_locked, bound):
    half, whole = (TipColumns(RIGID, 2, is_locked).volume(count) for count in (12, 24))
    assert half == pytest.approx(whole, rel=bound)


@pytest.mark.parametrize("is_locked", [False, True])
def test_few_attitudes_give_nearly_the_volume_of_many(is_locked):
    few, many = (TipColumns(FLEXIBLE, steps, is_locked).volume(COUNT) for steps in (2, 8))
    assert few == pytest.approx(many, rel=1e-2)


def test_half_a_turn_of_the_turntable_is_enough_for_an_arm_that_swings_to_both_sides():
    half = carried_with("machine.arm.each_drive=[{lower_deg: -90, upper_deg: 90}, {}]")
    whole = TipColumns(FLEXIBLE, 2).volume(COUNT)
    assert TipColumns(half, 2).volume(COUNT) == pytest.approx(whole, rel=0.02)


def test_ground_and_margin_take_from_the_reach():
    places = TipColumns(FLEXIBLE, 2).grid(COUNT)[0].reshape(-1, 2)
    low, _ = TipColumns(
        carried_with("machine.arm.each_drive=[{}, {upper_deg: 150}]"), 2
    ).intervals(places)
    assert np.nanmin(low) == 0.0
    firm = replace(FLEXIBLE, margin=0.6)
    assert (
        TipColumns(firm, 2).lengths(places).sum() < TipColumns(FLEXIBLE, 2).lengths(places).sum()
    )


def test_horizontal_rod_sags_as_a_clamped_beam():
    rod = FLEXIBLE.rod
    load = FLEXIBLE.params.gravity * (rod.tip_mass / 3.0 + rod.mass / 8.0)
    stiff = replace(FLEXIBLE, params=replace(FLEXIBLE.params, arm=FLEXIBLE.params.arm.stiff))
    down = stiff.deflection(stiff.postures[0], (0.0, 0.5 * math.pi))[2]
    assert -down == pytest.approx(load * rod.length**3 / rod.bending_stiffness[0], rel=1e-9)
    assert horizontal_sag_error(FLEXIBLE) < 1e-9


def test_upright_rod_on_a_level_platform_does_not_sag_and_a_rigid_one_never_does():
    joints, level = np.outer(np.linspace(-3.0, 3.0, 7), (1.0, 0.0)), FLEXIBLE.postures[0]
    np.testing.assert_allclose(FLEXIBLE.deflection(level, joints), 0.0, atol=1e-12)
    np.testing.assert_array_equal(RIGID.deflection(level, joints + 0.5), 0.0)


def test_rigid_rod_has_no_metrics_of_bending():
    result = parapod.run("arm-workspace", "machine.arm=!Rod {}", "resolution=16")
    values = {metric.key: metric.value for metric in result.metrics}
    assert values["largest_sag_mm"] == 0.0
    assert not {"horizontal_sag_error", "level_by_rigid"} & set(values)
    assert [figure.name for figure in result.figures] == ["arm_reach"]


@pytest.mark.parametrize("arm", ["!None {}", f"!Urdf {{file: {CRANE}, mount: foot, tip: tip}}"])
def test_other_arms_are_refused(arm):
    with pytest.raises(ScenarioError, match=r"^machine\.arm must be !Rod or !FlexibleRod, a rod "):
        parapod.run("arm-workspace", f"machine.arm={arm}")
