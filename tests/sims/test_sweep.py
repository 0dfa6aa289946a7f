"""The same experiment with many seeds."""

import io
import json
import re
import statistics

import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import ENTRIES, RunOptions
from parapod.sims.lab.results import Metric, Result
from parapod.sims.lab.sweep import as_json, print_spread, run_seeds
from parapod.systems.core.scenario_file import load_scenario

# As little as passes for a job, with a gain error that differs from seed to seed.
BRIEF = (
    "backend=kinematic",
    "ground.roll_deg=0.3",
    "ground.pitch_deg=0.2",
    "sensors={encoder_resolution_mm: 0, imu_noise: false, accel_bias_mg: 1, gyro_bias_deg_s: 0}",
    "job.initial_extension_mm=405",
    "job.estimate_at=1.5",
    "job.settled_after=1.5",
    "job.waypoints=[]",
    "job.arm={start: 0.5, duration: 0.5}",
    "job.end=2",
)


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


@pytest.fixture(scope="module")
def level():
    (entry,) = [entry for entry in ENTRIES if entry.name == "level"]
    return entry


def test_seeds_follow_the_scenario_s_and_give_what_single_runs_give(level):
    experiment, quiet = level.load(), Console(quiet=True)
    scenario = load_scenario(LevellingScenario, level.default_scenario, None, (*BRIEF, "seed=5"))
    swept = run_seeds(experiment, scenario, 2, quiet)
    assert [result.seed for result in swept] == [5, 6]
    assert scenario.seed == 5
    for result in swept:
        assert result.figures == ()
        assert result.afterwards is None
    single = experiment.run(scenario, RunOptions(console=quiet))

    def values(result):
        return {m.key: m.value for m in result.metrics if m.key != "realtime_factor"}

    assert values(swept[0]) == values(single)
    assert values(swept[1]) != values(single)


def test_the_command_shows_and_writes_the_spread(tmp_path, capsys):
    path = tmp_path / "level.json"
    command = ["run", "level", "--backend", "kinematic", "--seeds", "2", "--json", str(path)]
    assert main([*command, "--set", *BRIEF]) == 0
    out = capsys.readouterr().out
    assert "level (kinematic, seeds 0..1)" in out
    for column in ("min", "median", "max", "2 of 2"):
        assert column in out
    assert f"wrote {path}" in out.replace("\n", "")
    data = json.loads(path.read_text())
    assert (data["seeds"], data["passed"]) == ([0, 1], True)
    roll = data["roll_error_deg"]
    assert roll["min"] < roll["max"]
    assert roll["median"] == pytest.approx(statistics.mean((roll["min"], roll["max"])))


@pytest.mark.parametrize("option", ["html", "log", "graphviz", "figures"])
def test_outputs_of_a_single_run_are_refused_in_one_line(tmp_path, capsys, option):
    path = tmp_path / "level.dot"
    assert main(["run", "level", "--seeds", "2", f"--{option}", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    text = f"--{option} shows a single run and does not go with --seeds"
    assert err == f"parapod: error: {text}\n"
    assert not path.exists()


@pytest.mark.parametrize("count", ["0", "-1", "1.5", "many"])
def test_a_number_of_seeds_that_is_none_is_refused_in_one_line(capsys, count):
    assert main(["run", "level", f"--seeds={count}"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"parapod: error: .*whole number .* not '{count}'.*\n", err)
