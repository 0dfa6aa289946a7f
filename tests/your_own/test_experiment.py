"""The experiment that the documents show: installed as they say, and run."""

import json
import re
from pathlib import Path

import pytest

import parapod
from parapod.sims.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "your_own" / "experiment.md"
RUN = ("run", "level-effort", "--backend", "kinematic")


@pytest.fixture(autouse=True)
def installed(reader_of):
    return reader_of(PAGE)


def test_it_is_listed_by_its_first_line(capsys):
    assert main(["list"]) == 0
    listed = " ".join(capsys.readouterr().out.split())
    assert "level-effort Ask how much of their voltage the legs need while" in listed


def test_it_says_what_the_page_shows(capsys, installed):
    assert (
        main([*RUN, "--json", "effort.json", "--figures", "figures", "--log", "effort.npz"]) == 0
    )
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    (shown,) = re.findall(r"kinematic\n(level-effort .*?)\n\$", PAGE.read_text(), re.DOTALL)
    for line in shown.splitlines():
        assert re.match("[ -]*-[ -]*$", line) or line.split() in printed, line
    result = json.loads(Path("effort.json").read_text())
    assert 0.05 < result["voltage_share"] < 0.2
    assert {path.name for path in installed.iterdir()} >= {"effort.npz", "figures"}


def test_its_own_key_is_its_bound(capsys):
    assert main([*RUN, "--set", "effort.largest_share=0.05"]) == 1
    assert "broken: voltage_share" in capsys.readouterr().out


def test_it_runs_without_being_installed(monkeypatch):
    (code,) = re.findall(r"```python\n(from level_effort.*?)```", PAGE.read_text(), re.DOTALL)
    names = {}
    *lines, last = code.strip().splitlines()
    exec("\n".join(lines), names)
    result = eval(last, names)
    assert isinstance(result, parapod.Result)
    assert result.passed
    assert names["scenario"].ground.pitch_deg == 4.0
