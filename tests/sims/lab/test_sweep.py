"""The same experiment with many seeds."""

import io
import json
import re
import statistics

import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.sweep import as_json, print_spread, run_seeds
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Metric, Result
from parapod.systems.core.scenario_file import load_scenario


def results(*values, at_least=None):
    """Results with seeds 3, 4, ... whose one number takes these values."""
    return [
        Result("tilt", "kinematic", 3 + i, (Metric("tilt", v, "deg", 2.0, at_least=at_least),))
        for i, v in enumerate(values)
    ]


def spread(*values, **options):
    stream = io.StringIO()
    print_spread(results(*values, **options), Console(file=stream, width=100))
    return stream.getvalue()


def test_json_has_seeds_and_smallest_middle_and_largest_values():
    assert as_json(results(1.0, -0.5, 1.5)) == {
        "experiment": "tilt",
        "backend": "kinematic",
        "seeds": [3, 4, 5],
        "passed": True,
        "tilt": {"min": -0.5, "median": 1.0, "max": 1.5},
    }
    assert as_json(results(1.0, 2.5))["passed"] is False


def test_the_table_shows_the_spread_and_the_bound():
    text = spread(1.0, -0.5, 1.5)
    assert "tilt (kinematic, seeds 3..5)" in text
    assert re.search(r"tilt \[deg\] +-0\.5 +1 +1\.5 +<= 2 +3 of 3", text)
    assert "all bounds held with all 3 seeds" in text


def test_the_table_names_seeds_that_broke_a_bound():
    text = spread(1.0, 2.5, -3.0)
    assert "1 of 3" in text
    assert "broken with seed 4: tilt = 2.5 deg (bound 2 deg)" in text
    assert "broken with seed 5: tilt = -3 deg (bound 2 deg)" in text
    assert "all bounds held" not in text


def test_a_lower_bound_is_shown_and_counted():
    text = spread(0.5, 1.5, at_least=1.0)
    assert "1..2" in text
    assert "1 of 2" in text


def test_a_value_that_is_not_finite_can_be_written():
    # A platform that never gets level has no settling time.
    data = as_json(results(1.0, float("inf")))
    assert data["passed"] is False
    assert json.loads(json.dumps(data, allow_nan=False))["tilt"]["min"] == 1.0


def test_seeds_follow_the_scenario_s_and_give_what_single_runs_give(pendula):
    experiment, quiet = find_experiment("swing"), Console(quiet=True)
    scenario = load_scenario(experiment.schema, overrides=["seed=5"])
    swept = run_seeds(experiment, scenario, 2, quiet)
    assert [result.seed for result in swept] == [5, 6]
    assert scenario.seed == 5
    assert all(result.figures == () and result.afterwards is None for result in swept)
    single = experiment.execute(scenario, RunOptions(console=quiet))
    assert swept[0].metrics == single.metrics
    assert swept[1].metrics != single.metrics


def test_the_command_shows_and_writes_the_spread(pendula, work, capsys):
    assert main(["run", "swing", "--seeds", "2", "--json", "swing.json"]) == 0
    out = capsys.readouterr().out
    assert "swing (exact, seeds 0..1)" in out
    for column in ("min", "median", "max", "2 of 2"):
        assert column in out
    assert "wrote swing.json" in out
    data = json.loads((work / "swing.json").read_text())
    assert (data["seeds"], data["passed"]) == ([0, 1], True)
    period = data["period_s"]
    assert period["min"] < period["max"]
    assert period["median"] == pytest.approx(statistics.mean((period["min"], period["max"])))
    assert main(["run", "swing", "--seeds", "2", "--set", "length_m=4"]) == 1
    assert "broken with seed 1: period_s = 4.0161 s" in capsys.readouterr().out
