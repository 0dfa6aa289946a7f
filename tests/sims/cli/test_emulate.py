"""The command that an emulator asks for in another terminal."""

import shlex

import pytest

from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import main, make_parser
from parapod.sims.real_machine import emulator


@pytest.mark.parametrize(
    ("options", "repeated"),
    [
        ("--backend kinematic", ""),
        ("--set backend=kinematic plant.leg_model=reduced", ""),
        ("--machine 'my platform.yaml' --seed 3", "--machine 'my platform.yaml' --seed 3"),
        (
            "--scenario job.yaml --set ground.roll_deg=1 backend=kinematic --set job.end=30",
            "--scenario job.yaml --set ground.roll_deg=1 job.end=30",
        ),
    ],
)
def test_an_emulator_repeats_its_options_in_the_command_that_is_to_run(
    options, repeated, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("my platform.yaml", "job.yaml"):
        (tmp_path / name).write_text("{}\n")
    seen = {}
    monkeypatch.setattr(
        emulator, "emulate", lambda *_, options, **more: seen.update(options=options)
    )
    assert main(["emulate", "level", *shlex.split(options)]) == 0
    assert shlex.join(seen["options"]) == repeated
    again = make_parser().parse_args(["run", "level", *seen["options"]])
    assert again.name == "level"


def test_settings_of_a_job_on_devices_come_before_those_of_the_command(monkeypatch):
    seen = {}
    monkeypatch.setattr(
        emulator, "emulate", lambda *_, options, **more: seen.update(options=options)
    )
    assert main(["emulate", "bench-walk", "--set", "gait.frequency_Hz=0.9"]) == 0
    assert seen["options"][0] == "--set"
    assert seen["options"][-1] == "gait.frequency_Hz=0.9"
    assert "control.period=0.01" in seen["options"][1:-1]


def test_the_ready_line_can_be_pasted(capsys):
    from rich.console import Console

    machine = find_machine("levelling_platform")
    scenario = machine.scenario()
    options = ("--machine", "my platform.yaml")

    class Emulated:
        clock = None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(emulator, "_described", lambda clock: "as it is")
        emulator._introduce(Emulated(), scenario, "level", options, Console())
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ready")]
    command = "parapod run level --backend hardware --machine 'my platform.yaml'"
    assert line == f"ready: in another terminal, {command}"
