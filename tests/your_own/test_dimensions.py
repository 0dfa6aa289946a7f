"""Machines that are not the papers', from files of dimensions: they hold their bounds."""

import json
import re
from pathlib import Path

import pytest

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_entry
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario

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
    ("long_bench", "bench-walk", ()),
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


def refuse(experiment, setting, words, capsys, tmp_path):
    result = tmp_path / "result.json"
    assert main(["run", experiment, "--set", setting, "--json", str(result)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not result.exists()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.base={body: {mass_kg: 9000}}", "cannot lift itself: that takes 13.1 V"),
        ("machine.base={body: {mass_kg: 20, centre_mm: [0, 2000, 0]}}", "it tips over"),
        ("machine.actuators.stop_min_mm=395", "not within the end stops of machine.actuators"),
        (
            "machine.actuators.motor_constant_N_V=2000",
            "break away from friction only when the platform is 0.15 deg off, and 0.1 deg is",
        ),
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
        ("machine.arm=!Urdf {file: nothing.urdf}", "there is no such file"),
        ("machine.arm.each_drive=[{}]", "machine.arm.each_drive must have 2 elements or none"),
        ("machine.arm.drives.max_effort_Nm=10", "to hold the arm takes 17.1 N m, and it has 10"),
        ("machine.arm.drives.lower_deg=10", "zero, where it begins, must be between"),
        ("machine.arm.base_mm=[0, 0, -50]", "is 50 mm below the top of the platform's base"),
        ("job.arm.duration=0.4", "it must be 0.5 s or more"),
        ("job.arm={angle_deg: 90, duration: 0.5}", "it must be 1 s or more"),
        ("machine.arm.drives.upper_deg=30", "'arm' goes from -90 deg to 30 deg, not to 45 deg"),
    ],
)
def test_a_platform_that_cannot_be_is_refused_in_one_line(setting, words, capsys, tmp_path):
    refuse("level", setting, words, capsys, tmp_path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.leg.up_extra_mm=480", "needs UPS branches of 901.6 mm"),
        ("machine.leg.a_mm=330", "the platforms of legs 1 and 2 overlap by 17 mm"),
        ("machine.body={mass_kg: 40, centre_mm: [0, 900, 0]}", "it tips over"),
        ("machine.body.mass_kg=500", "it cannot lift itself: a branch has to hold 510 N, 82 N"),
        ("machine.drives.stiffness_N_um=0.3", "at rest a branch gives way by 0.67 mm, and 0.5 mm"),
    ],
)
def test_a_chair_that_cannot_be_is_refused_in_one_line(setting, words, capsys, tmp_path):
    refuse("chair-walk", setting, words, capsys, tmp_path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.foot_diameter_mm=320", "feet overlap at home, where they are 312 mm apart"),
        ("machine.pattern_radius_mm=900", "which are 832 mm beside them"),
        ("machine.tool_length_mm=380", "the drill does not touch it"),
        ("machine.half_angle_deg=1", "the legs of the upright platform do not hold it"),
        ("machine.platform.mass_kg=900", "it cannot lift itself: a leg has to hold 1549 N, 549 N"),
    ],
)
def test_a_centre_that_cannot_be_is_refused_in_one_line(setting, words, capsys, tmp_path):
    refuse("centre-machining", setting, words, capsys, tmp_path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.strut_mm=60", "hold a level plate nowhere with sin mu of 0.25 or more"),
        ("machine.slider_max_mm=400", "is too short for a level plate; it must be more than 455"),
        ("machine.hip_max_mm=300", "must be more than hip_min_mm = 400"),
        ("machine.plate={mass_kg: 900}", "it cannot lift its plate: a slider has to hold 7206 N"),
        (
            "machine.sliders.stiffness_N_um=2",
            "the leg takes the plate 0.093 mm from its path",
        ),
        (
            "machine={configuration: treadmill, sliders: {stiffness_N_um: 20}}",
            "it must be at least",
        ),
    ],
)
def test_a_bench_that_cannot_be_is_refused_in_one_line(setting, words, capsys, tmp_path):
    refuse("bench-walk", setting, words, capsys, tmp_path)


@pytest.mark.parametrize(
    ("experiment", "key", "value"),
    [
        ("level", "machine.actuators.motor_constant_N_V", "2000"),
        ("chair-walk", "machine.drives.stiffness_N_um", "0.3"),
        ("bench-walk", "machine.sliders.stiffness_N_um", "2"),
    ],
)
def test_a_drive_that_is_too_soft_is_refused_with_one_that_would_do(experiment, key, value):
    entry = find_entry(experiment)
    kind = entry.load()

    def check(value):
        overrides = (f"{key}={value}",)
        kind.check(load_scenario(kind.schema, entry.default_scenario, None, overrides))

    with pytest.raises(ScenarioError) as refused:
        check(value)
    assert refused.value.key == key
    least = float(re.search(r"it must be at least ([\d.]+)$", str(refused.value))[1])
    check(least)
    with pytest.raises(ScenarioError, match=key):
        check(0.98 * least)


DECK = """<?xml version="1.0"?>
<robot name="deck">
  <link name="deck">
    <inertial>
      <origin xyz="0 0 -0.05"/>
      <mass value="32"/>
      <inertia ixx="1.2" ixy="0" ixz="0" iyy="2.9" iyz="0" izz="3.9"/>
    </inertial>
    <visual>
      <origin xyz="0 0 -0.05"/>
      <geometry><box size="0.9 0.5 0.1"/></geometry>
    </visual>
  </link>
</robot>
"""


def run_with_deck(folder, text=DECK, frame="deck"):
    """Exit code of a run of the platform with a base from a file."""
    (folder / "deck.urdf").write_text(text)
    (folder / "mine.yaml").write_text(f"base: {{urdf: deck.urdf, frame: {frame}}}\n")
    options = ["--machine", str(folder / "mine.yaml"), "--json", str(folder / "level.json")]
    return main(["run", "level", "--backend", "kinematic", *options])


def test_a_base_from_a_file_is_weighed_and_is_not_the_papers(tmp_path, capsys):
    assert run_with_deck(tmp_path) == 0
    assert "paper" not in capsys.readouterr().out
    design = load_scenario(LevellingScenario, machine=tmp_path / "mine.yaml").machine
    usual = LevellingScenario().machine
    assert design.masses.mass - usual.masses.mass == pytest.approx(32.0 - 27.9)


@pytest.mark.parametrize(
    ("text", "frame", "words"),
    [
        (DECK, "top", "machine.base.frame = 'top' is not a link of"),
        (DECK.replace('value="32"', 'value="0"'), "deck", "mass must be above 0"),
        (DECK.replace('ixx="1.2"', 'ixx="9"'), "deck", "has an inertia of no body"),
        (DECK.replace('<box size="0.9 0.5 0.1"/>', '<mesh filename="gone.obj"/>'), "deck",
         "gone.obj' which does not exist"),
        (DECK.replace("</robot>", ""), "deck", "machine.base.urdf = "),
    ],
)  # fmt: skip
def test_a_base_that_cannot_be_is_refused_in_one_line(text, frame, words, tmp_path, capsys):
    assert run_with_deck(tmp_path, text, frame) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not (tmp_path / "level.json").exists()
