"""The experiment `workspace`: its numbers, its files, its refusals."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import ENTRIES, RunOptions
from parapod.sims.lab.figures import render
from parapod.sims.levelling_platform.solid import figures
from parapod.sims.levelling_platform.workspace import EXPERIMENT, WorkspaceScenario, run
from parapod.systems.core.errors import OutputError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.workspace import ArmGeometry

KEYS = {
    "volume_m3",
    "volume_resolution_error",
    "extent_x_mm",
    "extent_y_mm",
    "extent_z_mm",
    "round_trip_error_m",
    "inside_fraction",
    "inside_fraction_counted",
    "inside_fraction_best",
    "unreachable_fraction",
    "enclosed_volume_m3",
    "inclined_difference_mm",
    "inclined_difference_fraction",
}
TURNTABLE_KEYS = {
    "leaning_volume_m3",
    "swept_volume_m3",
    "swept_resolution_error",
    "swept_gain",
    "stability_margin_mm",
}


def scenario_with(*overrides):
    return load_scenario(WorkspaceScenario, overrides=("resolution=32", *overrides))


def options(**changes):
    return replace(RunOptions(console=Console(file=io.StringIO())), **changes)


@pytest.fixture(scope="module")
def result():
    return run(scenario_with("turntable=true"), options())


@pytest.fixture(scope="module")
def values(result):
    return {metric.key: metric.value for metric in result.metrics}


def test_the_experiment_is_listed_as_it_describes_itself():
    (entry,) = [entry for entry in ENTRIES if entry.name == EXPERIMENT.name]
    assert entry.load() is EXPERIMENT
    assert entry.summary == EXPERIMENT.summary
    for override, _ in entry.switches.values():
        scenario_with(override)


def test_the_default_arm_is_the_paper_s():
    assert scenario_with().arm.upright == ArmGeometry()


def test_the_default_run_holds_its_bounds(result):
    assert result.broken == ()
    assert {metric.key for metric in result.metrics} == KEYS | TURNTABLE_KEYS


def test_the_numbers_are_those_of_the_docs(values):
    assert values["volume_m3"] == pytest.approx(0.01557, rel=0.005)
    assert values["inside_fraction"] == pytest.approx(0.975, abs=0.003)
    assert values["inside_fraction_counted"] == pytest.approx(0.974, abs=0.003)
    assert values["inside_fraction_best"] == pytest.approx(0.975, abs=0.003)
    assert values["unreachable_fraction"] == pytest.approx(0.054, abs=0.004)
    assert values["swept_volume_m3"] == pytest.approx(0.409, rel=0.01)
    extents = [values[f"extent_{axis}_mm"] for axis in "xyz"]
    np.testing.assert_allclose(extents, [629.4, 829.2, 177.5], rtol=0.01)


def test_another_base_of_the_arm_breaks_the_paper_s_share():
    further_forward = run(scenario_with("arm.offset_mm=[10, 20, 145]"), options())
    assert [metric.key for metric in further_forward.broken] == ["inside_fraction"]


def test_the_notes_say_what_the_share_hangs_on(result):
    text = " ".join(result.notes)
    assert re.search(
        r"\(0, 20, 145\) mm is assumed; .*, 97\.\d %, is that of \(\d, 19, 14\d\)", text
    )
    assert "second decimal" in text
    assert "Eq. (14) is not exact" in text


def test_level_ground_is_where_eq_14_is_exact():
    level = run(scenario_with("ground={roll_deg: 0, pitch_deg: 0}"), options())
    values = {metric.key: metric.value for metric in level.metrics}
    assert values["inclined_difference_mm"] == pytest.approx(0.0, abs=1e-9)
    assert values["inclined_difference_fraction"] == pytest.approx(0.0, abs=1e-12)
    assert not TURNTABLE_KEYS & set(values)


@pytest.mark.parametrize("option", ["log", "graphviz"])
def test_what_a_simulation_would_write_is_refused(option, tmp_path):
    with pytest.raises(OutputError, match=f"--{option} has nothing to write"):
        run(scenario_with(), options(**{option: tmp_path / "x"}))
    assert list(tmp_path.iterdir()) == []


def test_every_figure_can_be_drawn():
    drawn = figures(scenario_with("turntable=true"))
    assert len({figure.name for figure in drawn}) == 3
    assert len(figures(scenario_with())) == 2
    for figure in drawn[:2]:
        assert b"<svg" in render(figure)


def test_the_command_with_its_switch_writes_picture_and_numbers(tmp_path, capsys):
    page, numbers = tmp_path / "a.html", tmp_path / "a.json"
    outputs = ("--html", str(page), "--json", str(numbers))
    assert main(["run", "workspace", "--turntable", "--set", "resolution=16", *outputs]) == 0
    assert "all bounds held: 5 of 5" in capsys.readouterr().out
    assert set(json.loads(numbers.read_text())) >= KEYS | TURNTABLE_KEYS
    html = page.read_text()
    assert not re.search(r"<script[^>]*\bsrc=", html)
    assert len(html) > 1e6


def test_the_switch_is_in_the_scenario(capsys):
    assert main(["scenario", "workspace", "--turntable"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["turntable"] is True


def test_the_switch_is_refused_by_an_experiment_without_it(capsys):
    assert main(["run", "level", "--turntable"]) == 2
    error = "parapod: error: the experiment 'level' has no option --turntable\n"
    assert capsys.readouterr() == ("", error)
