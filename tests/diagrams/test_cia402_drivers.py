"""The drivers of axes on EPOS2 controllers: what becomes of a scenario's settings."""

import json
import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.devices import make_parts
from parapod.diagrams.drivers.cia402 import Epos2PositionScrews, Epos2Screws
from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.machine import Machine, MachineScenario
from parapod.diagrams.ports import In, Out
from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.hardware.cia402.settings import ScrewSettings
from parapod.systems.hardware.cia402.switches import switches_of_limbs
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry

CHAIR_GEOMETRY = ChairGeometry()

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
    (driver,) = CHAIR.drivers(ChairScenario())
    limits = driver.limits
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


# Position-controlled screws with locks and clamps

LIMBS = 3


def screws(limbs=LIMBS, **settings):
    """Legs of a machine of limbs, two each, with its locks and clamps."""
    legs = 2 * limbs
    ends = {"position_min_mm": [600.0] * legs, "position_max_mm": [800.0] * legs}
    places = {"part": "legs", "node_ids": [*range(1, legs + 1)], "signs": [1] * legs}
    return Epos2PositionScrews(
        **places | ends | switches_of_limbs(limbs) | {"position_file": "p"} | settings
    )


def ports_of_centre(limbs=LIMBS):
    legs, locks = 2 * limbs, 4 * limbs
    return (
        In("legs.position_command", legs, "m", "lengths"),
        In("legs.brake", 1, "-", "brake", idle=1.0),
        In("locks.command", locks, "-", "locks", idle=math.nan),
        In("clamps.command", limbs, "-", "clamps", idle=math.nan),
        Out("legs.position", legs, "m", "lengths"),
        Out("legs.velocity", legs, "m/s", "velocities"),
        Out("legs.current", legs, "A", "currents"),
        Out("legs.emergency_stop", 1, "0/1", "emergency stop", default=0.0),
        Out("locks.closed", locks, "0/1", "locks"),
        Out("clamps.closed", limbs, "0/1", "clamps"),
    )


def centre(drivers, ports=None, parts=("legs", "locks")):
    """Station of a machine whose legs' device stands behind its locks and clamps."""

    @dataclass
    class _Scenario(MachineScenario):
        backend: str = "hardware"
        hardware: HardwareScenario = field(default_factory=HardwareScenario)

    machine = Machine(
        "centre",
        "the centre",
        _Scenario,
        ports_of_centre() if ports is None else ports,
        parts,
        plants={},
        controller=lambda scenario: None,
    )
    return Station(machine, _Scenario(hardware=HardwareScenario(drivers)))


def parts_of(*drivers, ports=None):
    ports = ports_of_centre() if ports is None else ports
    inputs, outputs = ([p for p in ports if p.direction == way] for way in ("in", "out"))
    return make_parts(drivers, inputs, outputs, 0.01)


def said(call, *arguments, **options):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix("hardware.drivers: ")


@pytest.mark.parametrize("limbs", [3, 4])
def test_limbs_have_their_locks_at_the_left_leg_s_node_and_their_clamp_at_the_right_s(limbs):
    driver = screws(limbs)
    locks, clamps = driver.switches
    assert [tuple(switch) for switch in locks.switches] == [
        (2 * limb + 1, k, k) for limb in range(limbs) for k in (1, 2, 3, 4)
    ]
    assert [tuple(switch) for switch in clamps.switches] == [
        (2 * limb + 2, 1, 1) for limb in range(limbs)
    ]
    assert (driver.stop_node, driver.stop_input) == (2, 5)
    device = driver.make(PartPorts({"emergency_stop": 1}, {}))
    assert device.measures == {
        "position": 2 * limbs,
        "velocity": 2 * limbs,
        "current": 2 * limbs,
        "emergency_stop": 1,
        "locks.closed": 4 * limbs,
        "clamps.closed": limbs,
    }
    assert device.commands == {
        "position_command": 2 * limbs,
        "brake": 1,
        "locks.command": 4 * limbs,
        "clamps.command": limbs,
    }


def test_screws_without_locks_and_clamps_have_no_signals_of_them():
    ends = {"position_min_mm": [600.0], "position_max_mm": [800.0]}
    device = Epos2PositionScrews(part="legs", **ends).make(PORTS)
    assert set(device.commands) == {"position_command", "brake"}


def test_what_a_mode_does_not_need_is_no_setting_of_it():
    velocity, position = vars(Epos2Screws()), vars(Epos2PositionScrews())
    assert set(velocity) - set(position) == {"acceleration_mm_s2", "limit_lead_ms"}
    assert not [name for name in velocity if name.startswith(("lock_", "clamp_", "following"))]


def test_screws_have_two_millimetres_of_following_error():
    assert Epos2PositionScrews().following_error == 2e-3
    assert ScrewSettings().following_error is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"lock_nodes": [1] * 11},
            "lock_nodes, lock_outputs and lock_inputs must be of the same length, not 11, 12 and "
            "12",
        ),
        (
            {"clamp_inputs": []},
            "clamp_nodes, clamp_outputs and clamp_inputs must be of the same length, not 3, 3 and "
            "0",
        ),
        ({"clamp_nodes": [2, 4, 9]}, "clamp_nodes must be of the node_ids, not 9"),
        (
            {"lock_outputs": [1, 2, 3, 3] * 3},
            "output 3 of node 1 is given twice: locks 3 and locks 4",
        ),
        (
            {"lock_inputs": [1, 2, 3, 2] * 3},
            "input 2 of node 1 is given twice: locks 2 and locks 4",
        ),
        (
            {"clamp_nodes": [1, 4, 6], "clamp_inputs": [6, 1, 1]},
            "output 1 of node 1 is given twice: locks 1 and clamps 1",
        ),
        (
            {"stop_input": 1},
            "input 1 of node 2 is given twice: stop_input and clamps 1",
        ),
        ({"position_max_mm": [800.0] * 5}, "6 lower limits and 5 upper ones"),
        (
            {"position_min_mm": [600.0] * 5, "position_max_mm": [800.0] * 5},
            "limits must be 6, not 5",
        ),
    ],
)
def test_switches_that_cannot_be_wired_so_are_refused_by_name(settings, words):
    text = said(screws(**settings).make, PartPorts({"emergency_stop": 1}, {}))
    assert text == f"!Epos2PositionScrews of legs: {words}"


@pytest.mark.parametrize(("key", "bad"), [("lock_outputs", 5), ("lock_inputs", 7)])
def test_an_output_or_input_that_a_controller_does_not_have_is_refused(key, bad):
    with pytest.raises(ScenarioError, match=rf"^{key}\.0 = {bad} is outside 1\.\."):
        screws(**{key: [bad] * 12})


def test_dumped_screws_with_locks_load_as_equal_ones(tmp_path):
    scenario = ChairScenario(backend="hardware")
    scenario.hardware.drivers = [screws(4, clamp_outputs=[1, 1, 2, 1])]
    file = tmp_path / "dumped.yaml"
    file.write_text(dump_scenario(scenario))
    assert load_scenario(ChairScenario, file) == scenario


# Signals of other parts


class _Switches(Device):
    """A device of locks alone, or of anything."""

    name = "a relay card"

    def __init__(self, measures, commands):
        self.measures, self.commands = measures, commands

    def configure(self):
        pass

    def close(self):
        pass


@dataclass
class _Relays(Driver):
    part: str = "locks"
    measures: dict | None = None
    commands: dict | None = None

    def make(self, ports):
        return _Switches(self.measures or {}, self.commands or {})


def test_a_device_of_the_legs_stands_behind_locks_and_clamps():
    station = centre([screws()], parts=("legs", "clamps", "locks"))
    assert station.GetInputPort("locks.command").size() == 12
    assert station.GetInputPort("clamps.command").size() == 3
    assert station.GetOutputPort("status.age").size() == 3
    (thread,) = station.behind.handle.all_threads
    posted = []
    thread.post = lambda commands, measured: posted.append(commands)
    measured = {"locks.closed": tuple(map(float, range(12))), "clamps.closed": (1.0, 0.0, 1.0)}
    thread._sample = thread.sample._replace(values=measured, stamp=math.inf)
    thread._sample = thread._sample._replace(fault=0)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    values = {"legs.position_command": 0.7, "legs.brake": 0.0}
    for name in ("legs.position_command", "legs.brake", "locks.command", "clamps.command"):
        port = station.GetInputPort(name)
        port.FixValue(context, np.full(port.size(), values.get(name, 0.25 * port.size())))
    station.reset(context)
    simulator.AdvanceTo(0.005)
    assert station.GetOutputPort("locks.closed").Eval(context).tolist() == [*range(12)]
    assert station.GetOutputPort("clamps.closed").Eval(context).tolist() == [1.0, 0.0, 1.0]
    assert posted[-1] == {
        "position_command": (0.7,) * 6,
        "brake": (0.0,),
        "locks.command": (3.0,) * 12,
        "clamps.command": (0.75,) * 3,
    }


def test_the_status_of_a_part_without_a_device_is_that_of_the_device_behind_it():
    parts = parts_of(screws())
    assert set(parts.threads) == {"legs"}
    assert parts.behind("locks") == parts.behind("clamps") == parts.behind("legs") == "legs"
    with pytest.raises(KeyError):
        parts.behind("arm")


CENTRE = "EPOS2 on slcan"


def test_signals_of_other_parts_that_make_no_machine_are_refused():
    without = [p for p in ports_of_centre() if p.name != "clamps.command"]
    assert said(parts_of, screws(), ports=without).endswith(
        " takes clamps.command, which is not a port"
    )
    unlocked = screws(lock_nodes=[], lock_outputs=[], lock_inputs=[])
    assert said(parts_of, unlocked) == (
        "locks.closed is measured by no driver (those with part: locks: none)"
    )
    shown = _Relays(measures={"closed": 12})
    assert said(parts_of, unlocked, shown) == (
        "locks.command is driven by no driver (those with part: locks: a relay card)"
    )
    text = said(parts_of, screws(), shown)
    assert text.startswith(f"locks.closed is measured by {CENTRE} ")
    assert text.endswith(" and a relay card; it must be one")
    text = said(parts_of, screws(), _Relays(commands={"command": 12}))
    assert text.startswith(f"locks.command is driven by {CENTRE} ")
    assert text.endswith(" and a relay card; it must be of one part")
    few = _Relays("clamps", measures={"locks.closed": 11, "closed": 3}, commands={"command": 3})
    kinds = ("nodes", "outputs", "inputs")
    bare = screws(**{f"{switch}_{kind}": [] for switch in ("lock", "clamp") for kind in kinds})
    assert said(parts_of, bare, few) == "a relay card has 11 elements of locks.closed, the port 12"
