"""The drivers of axes on EPOS2 controllers: what becomes of a scenario's settings."""

import json
import math

import pytest

from parapod.diagrams.drivers.driver import PartPorts
from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY

AXES = 12
PORTS = PartPorts({}, {})


def test_a_screws_motor_turns_by_lead_and_reduction():
    driver = Epos2Legs(lead_mm=4.0, reduction=3.0)
    assert driver.motor_per_unit == pytest.approx(2.0 * math.pi * 3.0 / 4e-3, rel=1e-12)
    # 2000 counts a turn: 4 mm are three turns.
    assert driver.position(6000) == pytest.approx(4e-3, rel=1e-12)


def test_the_default_screws_move_with_80_mm_s_at_most():
    driver = Epos2Legs()
    assert driver.max_velocity == pytest.approx(0.08, rel=1e-12)
    assert driver.velocity(4800) == pytest.approx(0.08, rel=1e-12)
    assert driver.rpm(0.08) == driver.rpm(1.0) == 4800
    assert driver.measures_current


def test_the_default_limits_are_the_strokes_of_the_chair():
    limits = Epos2Legs().limits
    strokes = CHAIR_GEOMETRY.leg.strokes
    assert limits.lower == pytest.approx(strokes[:, 0].tolist() * LEG_COUNT, abs=1e-12)
    assert limits.upper == pytest.approx(strokes[:, 1].tolist() * LEG_COUNT, abs=1e-12)


def test_settings_arrive_in_si_units():
    driver = Epos2Legs(
        signs=[1, -1] * 6,
        acceleration_mm_s2=500.0,
        quick_stop_mm_s2=1500.0,
        position_min_mm=[600.0] * AXES,
        position_max_mm=[700.0] * AXES,
        limit_lead_ms=200.0,
        position_at_start_mm=[650.0] * AXES,
        heartbeat_timeout_ms=80.0,
    )
    assert driver.directions == (1, -1) * 6
    assert driver.acceleration == 0.5
    assert driver.quick_stop_deceleration == 1.5
    assert driver.limits.lower == pytest.approx((0.6,) * AXES)
    assert driver.limits.upper == pytest.approx((0.7,) * AXES)
    assert (driver.limits.lead, driver.limits.deceleration) == (0.2, 0.5)
    assert driver.position_at_start == pytest.approx((0.65,) * AXES)
    assert driver.heartbeat_timeout == 0.08


def test_nobody_guesses_the_positions_of_a_machine():
    assert Epos2Legs().position_at_start_mm is None
    assert Epos2Legs().position_at_start is None


def test_wheels_have_no_file_no_limits_and_no_current():
    wheels = Epos2Wheels().make(PORTS)
    assert set(wheels.measures) == {"position", "velocity"}
    assert Epos2Wheels().limits is None
    assert Epos2Wheels().motor_per_unit == 26.0


@pytest.mark.parametrize("key", ["signs", "position_min_mm", "position_at_start_mm", "node_ids"])
def test_lists_of_another_length_are_refused_with_their_key(tmp_path, key):
    file = tmp_path / "lab.yaml"
    file.write_text(f"hardware: {{drivers: [!Epos2Legs {{{key}: [1, 1]}}]}}\n")
    with pytest.raises(ScenarioError, match=rf"drivers\.0\.{key} must be a list of 12 "):
        load_scenario(ChairScenario, file)


def test_a_dumped_driver_loads_as_an_equal_one(tmp_path):
    scenario = ChairScenario(backend="hardware")
    scenario.hardware.drivers = [
        Epos2Legs(
            interface="socketcan",
            channel="can0",
            signs=[-1] * AXES,
            position_at_start_mm=[600.5] * AXES,
            position_file="positions.json",
        )
    ]
    file = tmp_path / "dumped.yaml"
    file.write_text(dump_scenario(scenario))
    assert load_scenario(ChairScenario, file) == scenario
    assert load_scenario(ChairScenario, file).hardware.drivers[0].signs == [-1] * AXES


# The emulator


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """emulated(driver): files known before, with what they say after it is emulated."""
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "emulator"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "emulator").mkdir()

    def emulate(driver):
        files = ("emulator/positions.json", "mine.json")
        for file in files:
            (tmp_path / file).write_text('{"position_m": null}')
        sizes = {"velocity_command": AXES, "brake": 1} | dict.fromkeys(
            ("position", "velocity", "current"), AXES
        )
        harness = Harness({f"legs.{name}": size for name, size in sizes.items()})
        harness.set("legs.position", [0.6 + 0.01 * i for i in range(AXES)])
        driver.emulate(harness, Misbehaviour())
        return {file: json.loads((tmp_path / file).read_text())["position_m"] for file in files}

    return emulate


def test_emulated_legs_know_where_the_emulated_machine_stands(emulated):
    said = emulated(Epos2Legs())
    assert said == {
        "emulator/positions.json": [0.6 + 0.01 * i for i in range(AXES)],
        "mine.json": None,
    }


def test_emulated_legs_leave_the_file_of_another_machine_alone(emulated):
    assert set(emulated(Epos2Legs(position_file="mine.json")).values()) == {None}
