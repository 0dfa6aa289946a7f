"""The same experiment with many seeds."""

import json

import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.output.options import RunOptions
from parapod.sims.study.seeds import results_of, run_seeds
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.scenario_file import load_scenario

QUIET = Console(quiet=True)


def test_seeds_follow_the_scenario_s_and_give_what_single_runs_give(pendula):
    experiment = find_experiment("swing")
    scenario = load_scenario(experiment.schema, overrides=["seed=5"])
    results = results_of(run_seeds("swing", scenario, 2, QUIET))
    assert [result.seed for result in results] == [5, 6]
    assert scenario.seed == 5
    single = experiment.execute(scenario, RunOptions(console=QUIET))
    assert [(m.key, m.value, m.bound) for m in results[0].metrics] == [
        (m.key, m.value, m.bound) for m in single.metrics
    ]
    assert results[1].metrics != results[0].metrics


def test_a_seed_that_fails_is_named():
    scenario = load_scenario(find_experiment("level").schema, overrides=["ground.pitch_deg=8"])
    scenario.backend = "kinematic"
    with pytest.raises(ParapodError, match=r"seed 0: leg . would need an extension"):
        results_of(run_seeds("level", scenario, 1, QUIET))


def test_the_command_shows_and_writes_the_spread(pendula, work, capsys):
    assert main(["run", "swing", "--seeds", "2", "--json", "swing.json"]) == 0
    out = capsys.readouterr().out
    for column in ("min", "median", "max", "2/2", "All bounds held in 2 of 2 runs"):
        assert column in out
    assert "wrote swing.json" in out
    data = json.loads((work / "swing.json").read_text())
    period = data["metrics"]["period_s"]
    assert period["min"] < period["max"]
    assert main(["run", "swing", "--seeds", "2", "--set", "length_m=4"]) == 1
    assert "parapod run swing --set length_m=4" in capsys.readouterr().out
