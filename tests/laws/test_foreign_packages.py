"""Machines' experiments from other packages: found, run and set like parapod's own, or named."""

import json
import os
import re
import subprocess
import sys

import pytest

import parapod
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_entry, list_entries
from parapod.systems.core.errors import ParapodError


def test_its_experiment_is_listed_under_its_package_behind_parapod_s_own(pendula, capsys):
    entry = list_entries()[-1]
    assert (entry.name, entry.package, entry.group) == ("swing", "pendula", "Pendula")
    assert entry.summary == "Swing a pendulum and count its periods."
    assert main(["list"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"\nPendula\n +swing +Swing a pendulum and count its periods\. +1 s *\n", out)
    assert err == ""


def test_its_experiment_runs_with_all_that_a_run_offers(pendula, work, capsys):
    files = "--json a.json --figures figures --log a.csv --graphviz a.dot --html a.html"
    assert main(["run", "swing", *files.split()]) == 0
    out, err = capsys.readouterr()
    assert "swing (exact, seed 0)" in out
    assert err == ""
    data = json.loads((work / "a.json").read_text())
    # The YAML beside the module holds: a quarter of the length swings in half the time.
    assert data["period_s"] == pytest.approx(1.00303, rel=1e-5)
    assert data["scenario"]["length_m"] == 0.25
    assert sorted(path.name for path in work.iterdir()) == [
        "a.csv", "a.dot", "a.html", "a.json", "figures"
    ]  # fmt: skip
    assert "bob" in (work / "a.dot").read_text()
    assert len((work / "a.html").read_text()) > 1e6
    assert main(["run", "swing", "--set", "length_m=4"]) == 1
    assert "broken: period_s = 4.0121 s (bound 2.5 s)" in capsys.readouterr().out


def test_its_switch_is_an_option_and_its_keys_are_explained(pendula, capsys):
    assert main(["scenario", "swing", "--heavy"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^heavy: true +# whether the string has a mass$", out, re.MULTILINE)
    assert re.search(r"^length_m: 0.25 +# length of the string \[m\] \(0.1..10\)$", out, re.M)
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "swing: give the string a mass" in " ".join(capsys.readouterr().out.split())
    assert main(["run", "level", "--heavy"]) == 2
    assert capsys.readouterr().err == (
        "parapod: error: the experiment 'level' has no option --heavy\n"
    )


def test_its_seeds_run_in_processes_of_their_own(pendula, tmp_path, work):
    # As a user does it: workers find the package where the program does.
    command = [sys.executable, "-m", "parapod.sims", "run", "swing", "--seeds", "2"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "All bounds held in 2 of 2 runs" in done.stdout


@pytest.mark.parametrize(
    ("module", "reason", "is_readable"),
    [
        # What has a docstring can be listed without being imported.
        ("1 / 0\n", r"ZeroDivisionError: division by zero", True),
        ('"""Do nothing."""\n', r"AttributeError: .*Swing.*", True),
        ("def\n", r"SyntaxError: .*", False),
        (None, r"ModuleNotFoundError: .*", False),
    ],
)
def test_a_package_that_cannot_be_loaded_is_named_and_the_others_stay_usable(
    install, pendula, capsys, module, reason, is_readable
):
    files = {"broken/__init__.py": ""} if module is not None else {}
    files |= {"broken/swing.py": module} if module is not None else {}
    install("broken", "[parapod.experiments]\nbroken = broken.swing:Swing\n", files)
    assert main(["run", "broken"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    said = r"the experiment 'broken' of the package 'broken' cannot be loaded: "
    assert re.fullmatch(rf"parapod: error: {said}{reason}\n", err)
    assert main(["list"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"^ +level +Level the platform", out, re.MULTILINE)
    assert re.search(r"^ +swing +Swing", out, re.MULTILINE)
    assert ("  broken" in out) == is_readable
    assert is_readable == (err == "")
    assert is_readable or re.fullmatch(rf"parapod: {said}{reason}\n", err)
    assert main(["run", "swing"]) == 0
    assert main(["scenario", "chair-gait"]) == 0


SAID = "parapod: the experiment 'broken' of the package 'broken' cannot be loaded: "


@pytest.mark.parametrize("constant", ["switches = make()", "takes = f'{1} s'"])
def test_constants_that_cannot_be_read_without_running_them_are_named(install, capsys, constant):
    text = f'"""Do it."""\n\nclass Swing:\n    """It."""\n\n    {constant}\n'
    files = {"broken/__init__.py": "", "broken/swing.py": text}
    install("broken", "[parapod.experiments]\nbroken = broken.swing:Swing\n", files)
    assert main(["list"]) == 0
    out, err = capsys.readouterr()
    assert "level" in out
    name = constant.split()[0]
    words = f"`{name}` of Swing must be a literal, for it is not executed"
    assert err == f"{SAID}{words}\n"
    assert not re.search(r"^Broken|  broken", out, re.MULTILINE)
    # Switches are read for every command.
    assert main(["scenario", "chair-gait"]) == 0


def test_no_package_takes_the_name_of_an_experiment_of_parapod(install):
    points = "[parapod.experiments]\nlevel = broken.swing:Swing\n"
    install("broken", points, {"broken/__init__.py": "", "broken/swing.py": '"""Level."""'})
    assert find_entry("level").package == "parapod"


def test_a_machine_that_cannot_be_loaded_is_named_and_the_others_stay_usable(install, capsys):
    points = "[parapod.machines]\nrocker = broken.machine:ROCKER\n"
    install("broken", points, {"broken/__init__.py": "1 / 0\n"})
    with pytest.raises(ParapodError) as refused:
        find_machine("rocker")
    assert str(refused.value) == (
        "the machine 'rocker' of the package 'broken' cannot be loaded: "
        "ZeroDivisionError: division by zero"
    )
    assert find_machine("walking_chair").name == "walking_chair"
    assert main(["emulate", "chair-gait"]) == 2
    assert capsys.readouterr().err == (
        "parapod: error: 'chair-gait' has no machine that can be emulated\n"
    )


def test_drivers_that_cannot_be_imported_are_named_and_the_others_stay_usable(
    install, pendula, capsys, monkeypatch
):
    monkeypatch.setattr(Driver, "not_imported", ())  # and empty again afterwards
    for package, module in (("broken", "1 / 0\n"), ("ended", "exit(3)\n"), ("sound", "")):
        points = f"[parapod.drivers]\narm = {package}.arm\n"
        install(package, points, {f"{package}/__init__.py": "", f"{package}/arm.py": module})
    said = [
        f"the drivers 'arm' of the package '{package}' cannot be imported: {reason}"
        for package, reason in (
            ("broken", "ZeroDivisionError: division by zero"),
            ("ended", "SystemExit: 3"),
        )
    ]
    assert main(["run", "swing"]) == 0
    warned = capsys.readouterr().err.splitlines()
    assert sorted(warned) == [f"parapod: warning: {words}" for words in said]
    assert "sound.arm" in sys.modules
    # A run that needs one of them says why there is none.
    assert main(["run", "level", "--set", "hardware.drivers=[!BrokenArm {part: arm}]"]) == 2
    refusal = capsys.readouterr().err.splitlines()[-1]
    assert refusal.startswith("parapod: error: hardware.drivers.0 must begin with one of the tags")
    assert "--drivers FILE" in refusal
    assert all(words in refusal for words in said)
    with pytest.warns(UserWarning, match="cannot be imported") as caught:
        parapod.scenario("swing")
    assert sorted(str(warning.message) for warning in caught) == said


def test_a_file_of_drivers_and_its_neighbours_take_no_module_s_place(work, capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("serial", "json"):
        (work / f"{name}.py").write_text("raise AssertionError('imported')\n")
    (work / "my_lift.py").write_text("import serial\nserial.Serial\n")
    assert main(["scenario", "level", "--drivers", "my_lift.py"]) == 0
    assert main(["scenario", "level", "--drivers", "json.py"]) == 2
    words = r"parapod: error: drivers '?json\.py'?: there is another module of that name, .*"
    assert re.fullmatch(rf"{words}__init__\.py'?; rename the file\n", capsys.readouterr().err)


TAKEN = """
from dataclasses import dataclass
from parapod.diagrams.drivers.driver import Driver

@dataclass
class NiDaqLegs(Driver):
    pass
"""


def test_a_driver_with_the_name_of_parapod_s_own_takes_nobody_s_place(install, tmp_path, work):
    files = {"taken/__init__.py": "", "taken/legs.py": TAKEN}
    install("taken", "[parapod.drivers]\nlegs = taken.legs\n", files)
    (work / "my_legs.py").write_text(TAKEN)
    said = r"!NiDaqLegs of {} is not used: parapod\.\S+ has one of that name\n"
    # A class cannot be taken back, hence in a program of its own.
    program = (
        "from parapod.sims.cli.main import main\n"
        "assert main(['scenario', 'level']) == 0\n"
        "assert main(['scenario', 'level', '--drivers', 'my_legs.py']) == 2\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # A file is named on purpose.
    warning = "parapod: warning: " + said.format(r"taken\.legs")
    refusal = r"parapod: error: drivers '?my_legs\.py'?: " + said.format("my_legs")
    assert re.fullmatch(2 * warning + refusal, done.stderr)
