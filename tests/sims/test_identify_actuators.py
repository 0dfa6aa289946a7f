"""The experiment `identify-actuators`: its estimator, its numbers, its refusals."""

import io
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

from parapod.diagrams.scenario import dump_scenario, load_scenario
from parapod.sims.experiment import ENTRIES, RunOptions
from parapod.sims.figures import render
from parapod.sims.identify_actuators import (
    EXPERIMENT,
    IdentifyActuatorsScenario,
    Recording,
    identify,
    run,
    schedule,
)
from parapod.sims.outputs import read_log
from parapod.systems.errors import OutputError, ScenarioError

DEFAULT = Path(str(files("parapod.sims.scenarios"))) / "identify-actuators.yaml"


def scenario_with(*overrides):
    return load_scenario(IdentifyActuatorsScenario, DEFAULT, None, overrides)


def options(**changes):
    return replace(RunOptions(console=Console(file=io.StringIO())), **changes)


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("identify") / "a.npz"
    quick = scenario_with("plant.leg_model=reduced", "plant.time_step=0.005")
    return run(quick, options(log=path)), read_log(path)


def values(result):
    return {metric.key: metric.value for metric in result.metrics}


def test_the_experiment_is_listed_and_its_default_scenario_is_the_schema_s():
    (entry,) = [entry for entry in ENTRIES if entry.name == EXPERIMENT.name]
    assert entry.load() is EXPERIMENT
    assert entry.summary == EXPERIMENT.summary
    written = yaml.safe_load(DEFAULT.read_text())
    assert written == yaml.safe_load(dump_scenario(IdentifyActuatorsScenario()))


def test_the_estimator_finds_the_slope_of_each_ramp_behind_its_transient():
    time = np.arange(0.0, 3.0, 0.01)
    voltage = np.select([(time >= 0.5) & (time < 1.5), time >= 2.0], [2.0, -1.0], 0.0)
    gain = np.array([0.008, 0.009, 0.010, 0.011])
    extension = 0.4 + np.outer(np.cumsum(voltage) * 0.01, gain)
    extension[(time >= 0.5) & (time < 0.55)] += 0.01  # a transient
    found = identify(Recording(time, np.tile(voltage[:, None], 4), extension), 0.1)
    assert found.voltage.tolist() == [2.0, -1.0]
    assert np.allclose(found.gain, gain)
    assert found.deviation_percent == pytest.approx(20.0)


def test_the_schedule_travels_the_same_way_in_every_step():
    trajectory = schedule(scenario_with().steps)
    time = np.arange(0.0, trajectory.end_time(), 1e-3) + 5e-4
    voltage = trajectory.vector_values(time)[0]
    assert 1e-3 * 0.01 * np.abs(voltage).sum() == pytest.approx(10 * 12e-3, rel=0.01)
    assert len(set(voltage.tolist()) - {0.0}) == 10
    assert trajectory.value(trajectory.end_time())[0, 0] == 0.0


def test_all_bounds_hold_and_load_slows_only_the_steps_that_lift(logged):
    result, log = logged
    assert result.passed, result.broken
    assert -5.0 < values(result)["load_effect_percent"] < 0.0
    cases = [
        identify(Recording(log.time, *(log.signals[f"{case}.legs.{n}"] for n in names)), 0.1)
        for names in [("voltage", "extension")]
        for case in ("unloaded", "loaded")
    ]
    slower = 1.0 - (cases[1].gain / cases[0].gain).mean(axis=1)
    lifts = cases[0].voltage < 0.0
    assert (slower[lifts] > 0.01).all()
    assert (np.abs(slower[~lifts]) < 0.01).all()
    assert cases[0].gain.mean() == pytest.approx(values(result)["gain_unloaded"])


def test_figures_are_the_paper_s(logged):
    figures = logged[0].figures
    assert [f.name.split("_")[0] for f in figures] == ["fig13", "fig14", "fig15a", "fig15b"]
    for figure in figures:
        assert f"Fig. {figure.name[3:].split('_')[0]}" in figure.caption
        assert b"<svg" in render(figure)


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("steps.voltages.3=0", "steps.voltages.3"),
        ("steps.voltages.1=2", "steps.voltages.2"),
        ("steps.voltages.9=-11", "steps.voltages.9"),
        ("actuators.supply_voltage=2.9", "steps.voltages.9"),
    ],
)
def test_steps_that_do_not_fit_are_refused(override, key):
    with pytest.raises(ScenarioError) as error:
        run(scenario_with(override), options())
    assert error.value.key == key


@pytest.mark.parametrize("option", ["html", "graphviz", "meshcat"])
def test_what_is_not_supported_is_refused(option, tmp_path):
    with pytest.raises(OutputError, match=f"--{option} is not supported"):
        run(scenario_with(), options(**{option: option == "meshcat" or tmp_path / "x"}))
