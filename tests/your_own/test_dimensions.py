"""Machines that are not the papers', from files of dimensions: they hold their bounds."""

import json
from pathlib import Path

import pytest

from parapod.sims.cli.main import main

MACHINES = Path(__file__).parents[2] / "examples" / "machines"
# Jobs of each machine, and what is set beside it.
JOBS = [
    ("large_platform", "level", ()),
    ("large_platform", "deploy", ("backend=kinematic",)),
    (
        "childs_chair",
        "chair-walk",
        ("passenger.mass_kg=25", "passenger.height_mm=260", "passenger.gyration_mm=190"),
    ),
    ("five_limbs", "centre-machining", ()),
]


def test_every_file_has_a_job():
    assert {path.stem for path in MACHINES.glob("*.yaml")} == {name for name, *_ in JOBS}


@pytest.mark.parametrize(("name", "job", "settings"), JOBS)
def test_a_machine_of_other_dimensions_holds_the_bounds_of_its_job(name, job, settings, tmp_path):
    options = ["--machine", str(MACHINES / f"{name}.yaml"), "--json", str(tmp_path / "job.json")]
    if settings:
        options += ["--set", *settings]
    assert main(["run", job, *options]) == 0
    result = json.loads((tmp_path / "job.json").read_text())
    assert result["passed"]
    assert result["bounds"]


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.base={body: {mass_kg: 9000}}", "cannot lift itself: that takes 13.1 V"),
        ("machine.base={body: {mass_kg: 20, centre_mm: [0, 2000, 0]}}", "it tips over"),
        ("machine.actuators.stop_min_mm=395", "not within the end stops of machine.actuators"),
        ("machine.legs.l_4_mm=900", "cannot stand level on actuators of 390 to 420 mm"),
        (
            "machine.legs={l_3_mm: 60, l_4_mm: 360, alpha_deg: 78}",
            "the parallelogram of leg 1 is flat at an extension of 420.0 mm",
        ),
        (
            "machine.legs={l_3_mm: 60, l_4_mm: 366, alpha_deg: 79}",
            "its base touches the ground: in the lowest posture F is 130 mm high",
        ),
        ("machine.legs.l_4_mm=0.44", "is it in another unit than mm?"),
        (
            "machine.each_leg=[{}, {}, {yaw_deg: 229}, {yaw_deg: 131}]",
            "must go round against the clock",
        ),
        ("machine.arm.urdf=nothing.urdf", "there is no such file"),
    ],
)
def test_a_platform_that_cannot_be_is_refused_in_one_line(setting, words, capsys, tmp_path):
    result = tmp_path / "level.json"
    assert main(["run", "level", "--set", setting, "--json", str(result)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not result.exists()
