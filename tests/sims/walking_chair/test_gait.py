"""The experiment `chair-gait`: its numbers, its symmetries, and what each bound is about."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.sims.output.figures import render
from parapod.sims.walking_chair.gait import (
    ChairGaitScenario,
    check_walks,
    gait_metrics,
    sample_walk,
)
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR = ChairGeometry()


def scenario_with(*overrides):
    return load_scenario(ChairGaitScenario, overrides=overrides)


@pytest.fixture(scope="module")
def logged(finished):
    return finished("chair-gait")


@pytest.fixture(scope="module")
def walks():
    return tuple(sample_walk(CHAIR, walk) for walk in scenario_with().walks)


def broken(printed, smooth):
    return {metric.key for metric in gait_metrics(printed, smooth) if not metric.passed}


def test_the_numbers_are_those_of_the_papers_gait(logged):
    values = logged.values
    assert values["max_branch_speed_mm_s"] == pytest.approx(75.163, abs=1e-3)
    assert values["velocity_step_printed_mm_s"] == pytest.approx(22.94, abs=1e-6)
    assert values["velocity_step_mm_s"] < 1e-9
    assert values["lift_speed_printed_mm_s"] == pytest.approx(22.94, abs=1e-3)
    assert values["lift_speed_smooth_mm_s"] == pytest.approx(28.68, abs=0.01)
    assert values["shift_speed_printed_mm_s"] == pytest.approx(4.87, abs=0.01)
    assert values["shift_speed_smooth_mm_s"] == pytest.approx(5.65, abs=0.01)
    assert values["swing_acceleration_mm_s2"] == pytest.approx(92.34, abs=0.01)
    assert values["body_acceleration_smooth_mm_s2"] == pytest.approx(45.0, abs=0.1)
    assert values["body_acceleration_printed_mm_s2"] == pytest.approx(0.60, abs=0.01)
    ranges = [values[f"{kind}_{end}_mm"] for kind in ("up", "ups") for end in
              ("shortest", "longest")]  # fmt: skip
    np.testing.assert_allclose(ranges, (591.4, 713.327, 574.002, 704.513), atol=1e-3)
    assert values["same_time_difference_mm"] == pytest.approx(111.56, abs=0.05)


@pytest.mark.parametrize(
    ("order", "way", "law", "cycles"),
    [
        ("13-24", "forward", "ramped", 2),
        ("24-13", "forward", "cycloid", 1),
        ("13-24", "back", "quintic", 1),
        ("24-13", "back", "ramped", 1),
        ("13-24", "forward and back", "cycloid", 1),
        ("24-13", "forward and back", "quintic", 1),
    ],
)
def test_every_order_way_and_smooth_law_holds_the_bounds(execute, order, way, law, cycles):
    values = {"order": order, "way": way, "body_law": law, "cycles": cycles}
    result = execute("chair-gait", *(f"gait.{key}={value}" for key, value in values.items()))
    assert result.broken == ()
    if (order, way) == ("24-13", "back"):
        assert b"second swing" in render(result.figures[0])


def test_eq_45_as_the_smooth_law_breaks_the_bounds_on_steps(execute):
    result = execute("chair-gait", "gait.body_law=linear")
    keys = {metric.key for metric in result.broken}
    assert keys == {"velocity_step_mm_s", "acceleration_step_mm_s2"}


# What each bound is about


def test_bounds_of_strokes_and_speeds(walks):
    printed, smooth = walks
    for length, keys in (
        (-1e-5, {"up_shortest_mm"}),
        (0.2, {"up_longest_mm"}),
    ):
        branches = smooth.branches.length.copy()
        branches[:, :, 0] += length
        moved = replace(smooth, branches=smooth.branches._replace(length=branches))
        assert keys <= broken(printed, moved)
    branches = smooth.branches.length.copy()
    branches[:, :, 1:] -= 1e-5
    assert "ups_shortest_mm" in broken(
        printed, replace(smooth, branches=smooth.branches._replace(length=branches))
    )
    branches[:, :, 1:] += 0.2
    assert "ups_longest_mm" in broken(
        printed, replace(smooth, branches=smooth.branches._replace(length=branches))
    )
    for walk, other in ((printed, smooth), (smooth, printed)):
        faster = walk.branches._replace(velocity=1.07 * walk.branches.velocity)
        moved = replace(walk, branches=faster)
        both = (moved, other) if walk is printed else (other, moved)
        assert broken(*both) == {"max_branch_speed_mm_s"}


@pytest.mark.parametrize("which", [0, 1])
def test_a_corner_below_the_ground_breaks_its_bound(walks, which):
    lowered = replace(walks[which], body=walks[which].body - (0.0, 0.0, 2e-6))
    pair = (lowered, walks[1]) if which == 0 else (walks[0], lowered)
    assert broken(*pair) == {"lowest_corner_mm"}


def test_a_leg_that_is_early_breaks_the_symmetry(walks):
    printed, smooth = walks
    length = smooth.branches.length.copy()
    length[:, 3] = np.roll(length[:, 3], 1, axis=0)
    early = replace(smooth, branches=smooth.branches._replace(length=length))
    assert broken(printed, early) == {"time_reversal_error_mm", "lowest_corner_mm"}


def test_branches_that_differ_break_their_bound(walks):
    printed, smooth = walks
    length = smooth.branches.length.copy()
    # A micrometre, the same in all legs: the symmetry of legs is kept.
    length[1500, :, 2] += 1e-6
    length[-1501, :, 2] += 1e-6
    uneven = replace(smooth, branches=smooth.branches._replace(length=length))
    assert "ups_difference_mm" in broken(printed, uneven)
    assert "time_reversal_error_mm" not in broken(printed, uneven)


def test_steps_between_phases_are_seen_from_both_sides(walks):
    printed, smooth = walks
    steps = np.abs(printed.velocity_steps).max(axis=(1, 2))
    # In the paper's gait at 0, 5, 10, 15, 20 and 25 s.
    np.testing.assert_allclose(1e3 * steps, (22.94, 22.94, 4.87, 4.87, 22.94, 22.94), atol=0.01)
    assert np.abs(smooth.velocity_steps).max() < 1e-12
    assert np.abs(smooth.acceleration_steps).max() < 1e-12


def test_both_sides_of_every_phase_are_sampled(walks):
    for walk in walks:
        ends = np.array(walk.walk.ends[:-1])
        twice = walk.time[:-1][np.diff(walk.time) == 0.0]
        np.testing.assert_allclose(twice, ends)
        assert (np.diff(walk.phase) >= 0).all()
        # Velocities are derivatives of the lengths, but not across the ends.
        inside = np.diff(walk.phase) == 0
        slope = (
            np.diff(walk.branches.length, axis=0)[inside] / np.diff(walk.time)[inside, None, None]
        )
        middle = 0.5 * (walk.branches.velocity[1:] + walk.branches.velocity[:-1])[inside]
        np.testing.assert_allclose(slope, middle, atol=1e-6)


def test_time_goes_on_on_the_way_back():
    printed, _ = scenario_with("gait.way=forward and back").walks
    walk = sample_walk(CHAIR, printed)
    assert (np.diff(walk.time) >= 0.0).all()
    assert walk.time[-1] == walk.walk.duration == 50.0
    np.testing.assert_allclose(walk.time[:-1][np.diff(walk.time) == 0.0], walk.walk.ends[:-1])
    assert walk.phase.max() == len(walk.walk.phases) - 1
    np.testing.assert_allclose(walk.body[-1], walk.body[0], atol=1e-12)


def test_the_log_has_both_laws(logged):
    log = logged.log
    for name in ("length", "velocity", "acceleration"):
        assert log.signals[f"linear.{name}"].shape == (len(log.time), 12)
    assert log.signals["smooth.foot_corners"].shape == (len(log.time), 36)
    for law, lift in (("linear", 22.94), ("smooth", 28.68)):
        speed = 1e3 * np.abs(log.signals[f"{law}.velocity"])
        assert speed.max() == pytest.approx(75.163, abs=1e-3)
        assert speed[log.time < 5.0].max() == pytest.approx(lift, abs=0.01)
    assert log.signals["smooth.foot_corners"][:, 2::3].min() > -1e-9


def test_as_many_cycles_as_can_be_drawn_are_admissible():
    check_walks(scenario_with("gait.cycles=10"), CHAIR)
