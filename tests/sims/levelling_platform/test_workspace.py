"""The experiment `workspace`: its numbers, what they hang on, and its switch."""

import re
from pathlib import Path

import numpy as np
import pytest

from parapod.sims.levelling_platform.workspace import (
    MeasureWorkspace,
    WorkspaceScenario,
    check_inclined_ground,
    compare_surfaces,
)
from parapod.sims.output.figures import render
from parapod.sims.output.options import RunOptions
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.workspace import ArmGeometry

LARGE = Path(__file__).parents[3] / "examples" / "machines" / "large_platform.yaml"


def scenario_with(*overrides):
    return load_scenario(WorkspaceScenario, overrides=("resolution=16", *overrides))


@pytest.fixture(scope="module")
def values(finished):
    return finished("workspace").values | finished("turntable").values


def test_the_default_arm_is_the_paper_s():
    assert WorkspaceScenario().upright == ArmGeometry()


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
    further_forward = compare_surfaces(scenario_with("arm.offset_mm=[10, 20, 145]"))
    broken = [metric.key for metric in further_forward.metrics if not metric.passed]
    assert broken == ["inside_fraction"]


def test_the_notes_say_what_the_share_hangs_on(finished):
    text = " ".join(finished("workspace").result.notes)
    assert re.search(
        r"\(0, 20, 145\) mm is assumed; .*, 97\.\d %, is that of \(\d, 19, 14\d\)", text
    )
    assert "second decimal" in text
    assert "Eq. (14) is not exact" in text


def test_level_ground_is_where_eq_14_is_exact():
    level = check_inclined_ground(scenario_with("ground={roll_deg: 0, pitch_deg: 0}"))
    values = {metric.key: metric.value for metric in level.metrics}
    assert values["inclined_difference_mm"] == pytest.approx(0.0, abs=1e-9)
    assert values["inclined_difference_fraction"] == pytest.approx(0.0, abs=1e-12)


def test_the_turntable_adds_its_numbers_and_its_figure(finished):
    upright, turning = finished("workspace"), finished("turntable")
    more = {"leaning_volume_m3", "swept_volume_m3", "swept_resolution_error", "swept_gain"}
    assert set(turning.values) - set(upright.values) == more | {"stability_margin_mm"}
    with_ring, without = (len(each.result.figures) for each in (turning, upright))
    assert with_ring == without + 1


def test_another_machine_has_no_printed_surfaces_but_a_workspace_as_large_as_it():
    experiment = MeasureWorkspace("workspace")
    scenario = load_scenario(WorkspaceScenario, overrides=("resolution=16",), machine=LARGE)
    result = experiment.execute(scenario, RunOptions())
    keys = {metric.key: metric.value for metric in result.metrics}
    assert not any(key.startswith("inside") for key in keys)
    assert keys["extent_x_mm"] > 629.4
    assert [figure.name for figure in result.figures] == ["workspace", "workspace_sections"]
    for figure in result.figures:
        assert render(figure)


def test_the_picture_is_self_contained():
    html = MeasureWorkspace("workspace").scene(scenario_with()).StaticHtml()
    assert not re.search(r"<script[^>]*\bsrc=", html)
    assert len(html) > 1e6
