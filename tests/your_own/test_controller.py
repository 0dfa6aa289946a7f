"""The controller that the documents compare with the platform's own."""

import re
from pathlib import Path

import numpy as np
import pytest

import parapod
from parapod.diagrams.machine import list_machines
from parapod.diagrams.wiring import outputs_of
from tests.laws.test_experiments import BRIEF

ROOT = Path(__file__).parents[2]
FILE = ROOT / "examples" / "controllers" / "lqr_level.py"
PAGE = (ROOT / "docs" / "your_own" / "controller.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def module():
    spaces = {}
    exec(compile(FILE.read_text(), FILE, "exec"), spaces)
    return spaces


def test_every_listing_of_the_page_is_a_piece_of_the_file():
    usual, *listings = re.findall(r"```python\n(.*?)\n```", PAGE, re.DOTALL)
    assert "return machine.controller(scenario)" in usual
    assert len(listings) == 2
    for listing in listings:
        assert listing in FILE.read_text()


def test_the_page_names_the_outputs_of_each_machine():
    for machine in list_machines():
        outputs = outputs_of(machine.controller(machine.scenario()))
        for name in {port.name for port in machine.inputs} & set(outputs):
            assert f"`{name}`" in PAGE


def test_it_levels_the_platform_within_bounds():
    result = parapod.run("level", *BRIEF["level"], f"control.controller={FILE}:make")
    assert result.passed, result
    usual = parapod.run("level", *BRIEF["level"])
    assert result["peak_voltage_V"] != usual["peak_voltage_V"]


def test_the_gain_is_stable_and_leads_every_leg_alone(module):
    scenario = parapod.scenario("level")
    per_volt, period = 0.01, 0.01
    gain = module["gain"](scenario, per_volt, period)
    # Leg 4 is not one of those that decide the inclination.
    assert np.abs(gain[3, 4:]).max() < 1e-9
    assert np.linalg.eigvals(np.eye(4) - period * per_volt * gain[:, :4]).real.max() < 1.0
