"""Buses of LCM by their names in a scenario, and the neutral side of switches."""

import pytest

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.machine import list_machines
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.hardware.buses.address import LCM, Address

BUSES = """
hardware:
  lcm_buses:
    - {name: left, lcm_url: "udpm://239.255.76.67:7667?ttl=0", channel_suffix: _LEFT}
    - {name: inside, lcm_url: "memq://"}
  drivers:
    - !LcmPart {part: legs, lcm_bus: left}
    - !LcmPart {part: imu, lcm_bus: inside}
    - !LcmPart {part: wheels}
"""


def scenario_of(text, tmp_path):
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    return load_scenario(PLATFORM.scenario, path)


def test_drivers_and_controllers_find_a_bus_by_its_name(tmp_path):
    scenario = scenario_of(BUSES, tmp_path)
    legs, imu, wheels = PLATFORM.drivers(scenario)
    assert (legs.lcm_url, legs.channel_suffix) == ("udpm://239.255.76.67:7667?ttl=0", "_LEFT")
    assert imu.lcm_url == "memq://"
    assert wheels.lcm_url == "emulator/lcm"
    left = Address(LCM, "udpm://239.255.76.67:7667?ttl=0", "_LEFT")
    assert scenario.hardware.address("lcm://left", "bus") == left
    assert left.channels_of("legs").command == "LEGS_COMMAND_LEFT"
    other = Address(LCM, "udpm://239.255.76.67:7667?ttl=0", "_X")
    text = "lcm://239.255.76.67:7667?ttl=0#_X"
    assert scenario.hardware.address(text, "bus") == other
    path = tmp_path / "again.yaml"
    path.write_text(dump_scenario(scenario))
    assert load_scenario(PLATFORM.scenario, path) == scenario


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("right", "hardware.drivers.0.lcm_bus = 'right' is not one of lcm_buses: left, inside"),
        ("", None),
    ],
)
def test_a_bus_that_there_is_not_is_named_with_those_there_are(tmp_path, name, words):
    scenario = scenario_of(BUSES.replace("lcm_bus: left", f"lcm_bus: '{name}'"), tmp_path)
    if words is None:
        assert PLATFORM.drivers(scenario)[0].lcm_url == "emulator/lcm"
        return
    with pytest.raises(ScenarioError) as caught:
        PLATFORM.drivers(scenario)
    assert str(caught.value) == words
    with pytest.raises(
        ScenarioError, match=f"^bus = '{name}' is not one of lcm_buses: left, inside$"
    ):
        scenario.hardware.address(f"lcm://{name}", "bus")
    scenario.hardware.lcm_buses = []
    with pytest.raises(ScenarioError, match="is not there: lcm_buses is empty"):
        PLATFORM.drivers(scenario)


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
def test_switches_of_a_neutral_part_are_on_their_safe_side(machine):
    for port in machine.inputs:
        assert port.neutral == (1.0 if port.unit == "-" else port.idle)
