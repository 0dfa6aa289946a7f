"""Machines that are not the papers', from files of dimensions: they hold their bounds."""

import json
from pathlib import Path

import pytest

from parapod.sims.cli.main import main

MACHINES = Path(__file__).parents[2] / "examples" / "machines"
# Job of each machine, and what is set beside it.
JOBS = {
    "large_platform": ("level", ()),
    "childs_chair": ("chair-walk", ("passenger.mass_kg=25",)),
    "five_limbs": ("centre-machining", ()),
}


def test_every_file_has_a_job():
    assert {path.stem for path in MACHINES.glob("*.yaml")} == set(JOBS)


@pytest.mark.parametrize("name", JOBS)
def test_a_machine_of_other_dimensions_holds_the_bounds_of_its_job(name, tmp_path):
    job, settings = JOBS[name]
    options = ["--machine", str(MACHINES / f"{name}.yaml"), "--json", str(tmp_path / "job.json")]
    if settings:
        options += ["--set", *settings]
    assert main(["run", job, *options]) == 0
    result = json.loads((tmp_path / "job.json").read_text())
    assert result["passed"]
    assert result["bounds"]
