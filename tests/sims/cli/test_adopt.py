"""`parapod adopt`: identified values, from a result into a scenario file."""

import json

import pytest

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.systems.core.scenario_file import load_scenario

GAINS = [0.0101, 0.0102, 0.0099, 0.0098]


def result(**changes):
    return {
        "experiment": "identify-actuators",
        "passed": True,
        "gain": 0.01,
        "bounds": {"gain": {"verdict": "held"}},
        "identified": {"control.actuator_gains": GAINS},
    } | changes


@pytest.fixture
def adopt(work):
    """adopt(result, *options): writes the result, and adopts it into lab.yaml."""

    def run(document, *options):
        (work / "found.json").write_text(json.dumps(document))
        return main(["adopt", "found.json", "--into", "lab.yaml", *options])

    return run


def test_each_key_is_told_with_its_old_and_new_value(adopt, work, capsys):
    assert adopt(result()) == 0
    first = capsys.readouterr().out.splitlines()
    new = "[0.0101, 0.0102, 0.0099, 0.0098]"
    assert first == [
        f"control.actuator_gains: null (default) -> {new}",
        "wrote lab.yaml",
    ]
    assert adopt(result()) == 0
    again = capsys.readouterr().out.splitlines()
    assert again[0] == f"control.actuator_gains: {new} -> {new}"
    scenario = load_scenario(LevellingScenario, None, work / "lab.yaml")
    assert scenario.control.actuator_gains == GAINS


def test_other_keys_and_comments_of_the_file_stay(adopt, work):
    (work / "lab.yaml").write_text("# ours\ncontrol:\n  pole: 8  # slow\n")
    assert adopt(result()) == 0
    text = (work / "lab.yaml").read_text()
    assert text.startswith("# ours\ncontrol:\n  pole: 8  # slow\n  actuator_gains: [0.0101")


def test_a_result_with_broken_bounds_is_taken_over_only_if_that_is_asked_for(adopt, work, capsys):
    broken = result(bounds={"gain": {"verdict": "BROKEN"}}, passed=False)
    assert adopt(broken) == 2
    line = capsys.readouterr().err
    assert "bounds are broken: gain; take it over all the same with --broken-bounds" in line
    assert not (work / "lab.yaml").exists()
    assert adopt(broken, "--broken-bounds") == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"identified": {}}, "holds no identified values"),
        ({"identified": {"control.gain": 1.0}}, "unknown key 'control.gain'"),
        ({"identified": {"control.actuator_gains": [1.0]}}, "must be a list of 4 numbers"),
        ({"identified": {"control.actuator_gains": [20.0] * 4}}, "outside 1e-05..10"),
        ({"experiment": "nothing"}, "there is no experiment 'nothing'"),
        ({"experiment": "workspace"}, "has no machine"),
    ],
)
def test_what_cannot_be_taken_over_is_refused_and_the_file_stays(
    adopt, work, capsys, changes, words
):
    (work / "lab.yaml").write_text("seed: 3\n")
    assert adopt(result(**changes)) == 2
    line = capsys.readouterr().err
    assert line.startswith("parapod: error: ")
    assert words in line
    assert line.count("\n") == 1
    assert (work / "lab.yaml").read_text() == "seed: 3\n"
