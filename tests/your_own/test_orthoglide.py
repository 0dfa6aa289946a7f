"""The Orthoglide: a package with a data sheet, designed by it as its authors have."""

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

KINEMATICS = Path(__file__).parents[2] / "examples/orthoglide/parapod_orthoglide/kinematics.py"
EDGE = 200.0  # edge of the cube [mm]
# Where the ratios along the diagonal are 2 and 1/2, in closed form.
LEG = EDGE / (1.0 / math.sqrt(18.0) + 1.0 / math.sqrt(6.0))
HIGH, LOW = LEG / math.sqrt(18.0), -LEG / math.sqrt(6.0)


@pytest.fixture(scope="module")
def kinematics():
    """The package's module of plain functions."""
    spec = importlib.util.spec_from_file_location("orthoglide_kinematics", KINEMATICS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def command(command_with):
    """Runs the command with the package installed."""
    return command_with("orthoglide")


def places(count=50):
    return np.random.default_rng(1).uniform(1e-3 * LOW, 1e-3 * HIGH, (count, 3))


def test_places_and_positions_of_the_drives_tell_each_other(kinematics):
    leg = 1e-3 * LEG
    for place in places():
        position = kinematics.inverse(leg, place)
        ends = np.diag(position)
        np.testing.assert_allclose(np.linalg.norm(ends - place, axis=1), leg, rtol=1e-12)
        np.testing.assert_allclose(kinematics.forward(leg, position), place, atol=1e-12)


def test_the_jacobian_is_the_derivative_of_the_positions(kinematics):
    leg, step = 1e-3 * LEG, 1e-6
    for place in places(10):
        moved = place + step * np.vstack((np.eye(3), -np.eye(3)))
        ahead, behind = np.split(kinematics.inverse(leg, moved), 2)
        derivative = (ahead - behind).T / (2.0 * step)
        found = kinematics.inverse_jacobian(leg, place)
        np.testing.assert_allclose(found, derivative, atol=1e-7)


def test_a_search_finds_the_legs_and_the_cube_of_the_conditions(command, tmp_path):
    chosen, ran = tmp_path / "chosen.yaml", tmp_path / "ran.json"
    done = command(
        *("design", "orthoglide-diagonal", "--minimise", "leg_mm"),
        *("--vary", "machine.leg_mm=250:450", "machine.middle_mm=-60:20"),
        *("--hold", "most_ratio<=2", "least_ratio>=0.5"),
        *("--designs", 1000, "--into", chosen, "--simulate"),
    )
    assert done.returncode == 0, done.stderr
    machine = yaml.safe_load(chosen.read_text())
    assert machine["leg_mm"] == pytest.approx(LEG, rel=1e-3)
    assert machine["leg_mm"] > LEG - 1e-3
    assert machine["middle_mm"] == pytest.approx(0.5 * (LOW + HIGH), abs=0.5)
    said = " ".join(done.stdout.split())
    assert "simulated along the diagonal of the cube: all bounds held" in said
    done = command("run", "orthoglide-diagonal", "--machine", chosen, "--json", ran)
    assert done.returncode == 0, done.stderr
    result = json.loads(ran.read_text())
    # At the ends themselves, where they are 2 and 1/2, the tool stands.
    assert 1.9 < result["diagonal_most_ratio"] < 2.01
    assert 0.49 < result["diagonal_least_ratio"] < 0.51


def test_its_sheet_tells_the_way_of_the_drives(command, tmp_path):
    told = tmp_path / "sheet.json"
    design = f"machine.leg_mm={LEG:.6f} machine.middle_mm={0.5 * (LOW + HIGH):.6f}"
    done = command("sheet", "orthoglide-diagonal", "--set", *design.split(), "--json", told)
    assert done.returncode == 0, done.stderr
    entries = {n: e["value"] for n, e in json.loads(told.read_text())["entries"].items()}
    assert entries["travel_mm"] == pytest.approx(HIGH + LEG - (LOW + LEG / math.sqrt(1.5)))
    assert entries["most_ratio"] == pytest.approx(2.0, rel=1e-6)
    assert entries["least_ratio"] == pytest.approx(0.5, rel=1e-6)


def test_legs_that_are_too_short_are_refused_with_what_would_do(command):
    done = command("run", "orthoglide-diagonal", "--set", "machine.leg_mm=120")
    assert done.returncode == 2
    said = "machine.leg_mm = 120 mm does not reach the corners of the cube: more than 141.4 mm"
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_where_no_first_design_is_admissible_the_search_keeps_within_its_designs(command):
    done = command(
        *("design", "orthoglide-diagonal", "--minimise", "leg_mm", "--designs", 100),
        *("--vary", "machine.leg_mm=50:140", "machine.middle_mm=-1:1"),
    )
    assert "100 designs: 0 admissible, 100 refused" in done.stdout
    assert "Traceback" not in done.stderr
