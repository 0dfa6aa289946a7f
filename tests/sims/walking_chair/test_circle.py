"""The experiment `chair-circle`: its numbers, and what each of its bounds is about."""

import io

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.output.figures import draw
from parapod.sims.walking_chair.circle import (
    PAPER_RADIAL_MM,
    ChairCircleScenario,
    sensitivities,
)
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_forward, leg_inverse
from parapod.systems.walking_chair.trajectories import FootCircle

QUICK = "circle.laps=1"


def scenario_with(*overrides):
    return load_scenario(ChairCircleScenario, overrides=overrides)


@pytest.fixture(scope="module")
def values(finished):
    return finished("chair-circle").values


def test_the_modes_differ_as_the_equations_have_it(values):
    assert values["foot_error_compound_mm"] == pytest.approx(0.507, abs=0.01)
    assert values["foot_error_velocity_mm"] == pytest.approx(3.935, abs=0.03)
    assert values["foot_error_position_mm"] == pytest.approx(1.0, abs=0.2)
    assert values["largest_error_compound_mm"] == pytest.approx(3.47, abs=0.1)
    assert values["radial_error_compound_mm"] == pytest.approx(0.511, abs=0.01)
    assert values["radial_error_velocity_mm"] == pytest.approx(0.174, abs=0.01)
    assert values["ripple_compound_mm_s"] == pytest.approx(0.21, abs=0.02)
    assert values["ripple_velocity_mm_s"] == pytest.approx(1.25, abs=0.03)
    assert values["ripple_position_mm_s"] == pytest.approx(4.9, abs=0.3)


def test_the_drawing_of_the_circle_says_how_much_larger_its_errors_are(finished):
    (figure,) = (f for f in finished("chair-circle").result.figures if f.name == "fig14_circle")
    for axes in draw(figure).axes:
        _, foot = axes.get_lines()
        assert "error\n20 times as large" in foot.get_label()
        named = [text.get_text() for text in axes.get_legend().get_texts()]
        assert foot.get_label() in named


def test_what_the_circle_asks_of_the_branches(values):
    assert values["planned_branch_speed_mm_s"] == pytest.approx(55.743, abs=1e-3)
    assert values["stroke_left_mm"] == pytest.approx(7.081, abs=1e-3)


def test_nothing_accumulates_over_the_laps(finished, values):
    assert abs(values["growth_compound_mm"]) < 0.02
    log = finished("chair-circle").log
    error = np.linalg.norm(log.signals["compound.foot"] - log.signals["foot_desired"], axis=1)
    by_lap = [error[(log.time >= t) & (log.time <= t + 4.0)].max() for t in (1.0, 6.0, 11.0)]
    np.testing.assert_allclose(by_lap, by_lap[0], rtol=0.02)


def test_the_log_alone_gives_the_errors(finished, values):
    log = finished("chair-circle").log
    settled = (log.time >= 1.0) & (log.time <= 15.0)
    for mode in ("compound", "velocity", "position"):
        foot = leg_forward(LegGeometry(), log.signals[f"{mode}.position"]).point
        error = np.linalg.norm(foot - log.signals["foot_desired"], axis=1)[settled]
        assert 1e3 * error.max() == pytest.approx(values[f"foot_error_{mode}_mm"], rel=1e-6)
    assert np.allclose(np.diff(log.time), 1e-3)


def test_the_diagram_is_the_one_of_the_paper_s_fig_10(finished):
    for part in ("circle_reference", "compound_position_controller", "velocity_servo"):
        assert part in finished("chair-circle").diagram


def test_errors_double_with_the_period_and_the_bound_goes_with_it(execute, values):
    slow = execute("chair-circle", QUICK, "control.period=0.02")
    assert slow.broken == ()
    assert slow["foot_error_compound_mm"] == pytest.approx(1.01, abs=0.02)
    assert slow["foot_error_velocity_mm"] == pytest.approx(7.84, abs=0.05)
    for mode in ("compound", "velocity"):
        key = f"foot_error_{mode}_mm"
        assert slow[key] / values[key] == pytest.approx(2.0, abs=0.05)
    # One lap tells nothing about growth.
    assert "growth_compound_mm" not in {metric.key for metric in slow.metrics}


def test_a_ramp_takes_the_errors_from_the_ends(execute, values):
    ramped = execute("chair-circle", QUICK, "circle.ramp=1.25")
    assert ramped["largest_error_compound_mm"] < 0.6
    assert values["largest_error_compound_mm"] > 3.0


@pytest.mark.parametrize(
    ("overrides", "broken"),
    [
        # Nothing corrects the position, and the modes are the same; nothing sums the errors up.
        (
            ("circle.laps=2", "control.proportional=0", "control.k_i=0"),
            {"foot_error_compound_mm", "compound_by_velocity", "growth_compound_mm"},
        ),
        (
            (QUICK, "drives.encoder_resolution_mm=0.5", "drives.max_velocity_mm_s=56"),
            {"ripple_by_position", "max_branch_speed_mm_s"},
        ),
    ],
)
def test_bounds_are_broken_by_what_they_are_about(execute, overrides, broken):
    result = execute("chair-circle", *overrides)
    assert broken <= {metric.key for metric in result.broken}


def test_lengths_that_are_off_move_the_foot_as_the_sensitivity_says():
    any_way, radially = sensitivities(FootCircle())
    assert any_way == pytest.approx(5.074, abs=1e-3)
    assert radially == pytest.approx(4.647, abs=1e-3)
    random = np.random.default_rng(0)
    places = FootCircle().motion(np.linspace(0.0, 5.0, 400)).position
    lengths = leg_inverse(LegGeometry(), places)
    off = random.normal(size=(400, *lengths.shape))
    off *= 1e-6 / np.linalg.norm(off, axis=-1, keepdims=True)
    foot = leg_forward(LegGeometry(), lengths + off).point
    moved = np.linalg.norm(foot - places, axis=-1).max() / 1e-6
    assert 0.97 * any_way < moved < 1.001 * any_way
    radius = np.hypot(foot[..., 0], foot[..., 1] - 0.1) - 0.1
    assert 0.97 * radially < np.abs(radius).max() / 1e-6 < 1.001 * radially


def test_the_notes_say_what_the_papers_radius_is_off_by(finished, values):
    text = " ".join(finished("chair-circle").result.notes)
    assert f"The {PAPER_RADIAL_MM:g} mm" in text
    assert f"{values['branch_error_for_paper_mm']:.2f} mm (root of the sum of squares" in text
    needed = values["branch_error_for_paper_mm"] * values["radial_error_by_branch_error"]
    assert needed == pytest.approx(2.454)


def test_the_seed_draws_the_drives_and_the_same_seed_the_same():
    several = ("drives.gain_error=0.03", "drives.offset_error_mm_s=1", "circle.laps=1")
    loops = [scenario_with(*several, f"seed={seed}").loop("compound") for seed in (1, 1, 2)]
    assert loops[0] == loops[1]
    assert loops[0].gain != loops[2].gain
    assert np.abs(np.subtract(loops[0].gain, (1.02, 0.985, 1.01))).max() <= 0.03
    assert np.abs(np.subtract(loops[0].offset, -1e-3)).max() <= 1e-3
    # By default the drives are those of the scenario.
    assert scenario_with("seed=5").loop("compound").gain == (1.02, 0.985, 1.01)


def test_values_of_the_scenario_reach_the_loop():
    overrides = (
        "control.period=0.02",
        "control.k_p=0.5",
        "control.k_i=0.2",
        "control.proportional=12",
        "drives.time_constant_ms=30",
        "drives.max_velocity_mm_s=70",
        "drives.encoder_resolution_mm=0.02",
        "drives.gain=[1, 1.1, 0.9]",
        "drives.offset_mm_s=[0, 1, 2]",
    )
    loop = scenario_with(*overrides).loop("velocity")
    control, drive = loop.controller, loop.drive
    assert (loop.period, control.mode, control.k_p, control.k_i) == (0.02, "velocity", 0.5, 0.2)
    assert control.proportional == 12.0
    assert control.velocity_limit == drive.max_velocity == pytest.approx(0.07)
    assert drive.time_constant == pytest.approx(0.03)
    assert drive.resolution == control.dead_band == pytest.approx(2e-5)
    assert loop.gain == (1.0, 1.1, 0.9)
    assert loop.offset == pytest.approx((0.0, 1e-3, 2e-3))
    # A perfect encoder has no counts, and a drive stands still all the same.
    perfect = scenario_with("drives.encoder_resolution_mm=0").loop("position")
    assert (perfect.drive.resolution, perfect.controller.dead_band) == (0.0, 1e-6)


def test_drives_of_every_seed_hold_the_bounds_and_every_mode_says_how_far_it_is(execute):
    errors, console = [], Console(file=io.StringIO(), force_terminal=True, width=80)
    for seed in range(2):
        overrides = (QUICK, "drives.gain_error=0.03", f"seed={seed}")
        result = execute("chair-circle", *overrides, console=console)
        assert result.broken == ()
        errors.append(result.metrics[0].value)
    assert errors[0] != errors[1]
    for mode in ("compound", "velocity", "position"):
        assert f"mode {mode}" in console.file.getvalue()
