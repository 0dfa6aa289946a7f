"""What an emulated machine can be asked to break, and how its physics and switches take it."""

import io
import itertools
from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.sims.real_machine import emulator
from parapod.sims.real_machine.disturbances import (
    Circuit,
    Schedule,
    disturbable,
    kinds_of,
    parsed_fault,
)
from parapod.sims.real_machine.emulator import EmulatedMachine, Lateness
from parapod.sims.real_machine.real_time import RealTimeLoop
from parapod.systems.core.errors import ScenarioError


def test_everything_that_can_be_disturbed_is_known_by_its_name():
    platform = disturbable(PLATFORM, ("imu", "legs"))
    assert platform == ("imu", "legs", "drives", "emergency_stop", "supply", "switches")
    # Its drives are devices, and it has no switches.
    assert disturbable(CHAIR, ("legs",)) == ("legs", "emergency_stop", "supply")
    for part in platform:
        kinds = kinds_of(part)
        assert len(set(kinds)) == len(kinds) >= 2
        for kind in kinds:
            assert parsed_fault(f"2.5 {part} {kind}", platform).kind == kind


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("supply well", "'supply well' is not PART KIND, with a kind of lost, back for supply"),
        ("switches stuck", "with a kind of closed, open, well for switches"),
        ("drives lost", "with a kind of off, stuck, "),
        ("roof off", "with a part of legs, drives, emergency_stop, supply, switches"),
        ("", "is not PART KIND"),
    ],
)
def test_other_requests_are_refused_with_what_is_admissible(text, words):
    with pytest.raises(ScenarioError, match=words):
        parsed_fault(text, disturbable(PLATFORM, ("legs",)), at=0.0)


def test_requests_are_done_at_their_times_and_ended_by_their_last_word():
    supply, console = Circuit(), Console(file=io.StringIO())
    requests = [parsed_fault(f"{at} supply {kind}", ["supply"]) for at, kind in ((2, "back"),)]
    requests.append(parsed_fault("1 supply lost", ["supply"]))
    schedule = Schedule({"supply": supply}, requests, console)
    states = []
    for now in (0.5, 1.0, 1.5, 2.0):
        schedule.advance(now)
        states.append(supply.is_broken)
    assert states == [False, True, True, False]
    assert console.file.getvalue() == "1.00 s: supply lost\n2.00 s: supply back\n"


FOLDERS = itertools.count()


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """The emulated platform without devices; whose wires are driven by the test."""
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "e"))
    machine = EmulatedMachine(PLATFORM, LevellingScenario(backend="kinematic"))
    yield machine
    machine._program.close()


@pytest.mark.parametrize(("rate", "sizes"), [(None, [3]), (0.5, [3]), (1.0, [1, 1, 1])])
def test_devices_share_a_process_unless_they_go_by_the_computers_clock(
    rate, sizes, tmp_path, monkeypatch
):
    begun = []
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "e"))
    monkeypatch.setattr(
        emulator, "emulated_devices", lambda groups, *_: nullcontext(begun.append(groups))
    )
    scenario = LevellingScenario(backend="kinematic")
    with EmulatedMachine(PLATFORM, scenario, rate).devices():
        (groups,) = begun
    assert [len(group) for group in groups] == sizes
    assert [one.part for group in groups for one in group] == ["legs", "imu", "wheels"]


def moved(machine, *disturbed):
    """By how much the legs move in 0.1 s at 3 V [m], with this broken; and the switches then."""
    for part, kind in disturbed:
        machine.disturbed()[part].begin(kind, 0.0)
    before = np.array(machine.harness.get("legs.extension"))
    machine.harness.set("legs.voltage", (3.0, 3.0, 3.0, 3.0))
    machine.harness.set("legs.stop", (0.0,))
    machine.run(0.1, lambda root: None)
    after = np.array(machine.harness.get("legs.extension"))
    return (after - before).mean(), machine.harness.get("legs.limits")


def test_legs_move_as_they_are_driven(machine):
    way, switches = moved(machine)
    assert 1e-3 < way < 4e-3  # 0.01 (m/s)/V, less what the motors take to begin
    assert 0.0 in switches
    assert machine.harness.get("supply") == (1.0,)


@pytest.mark.parametrize(
    ("part", "kind", "low", "high"),
    [
        ("supply", "lost", -1e-4, 1e-4),
        ("emergency_stop", "pressed", -1e-4, 1e-4),
        ("drives", "off", -1e-4, 1e-4),
        ("drives", "wrong", -4e-3, -1e-3),
    ],
)
def test_legs_do_what_broken_drives_let_them(machine, part, kind, low, high):
    way, _ = moved(machine, (part, kind))
    assert low < way < high
    # The button has a contact, the supply has none.
    assert machine.harness.get("legs.emergency_stop") == (float(part == "emergency_stop"),)
    assert machine.harness.get("supply") == (float(part != "supply"),)


@pytest.mark.parametrize(("kind", "shown"), [("closed", 1.0), ("open", 0.0)])
def test_broken_switches_show_the_same_wherever_the_legs_are(machine, kind, shown):
    way, switches = moved(machine, ("switches", kind))
    assert switches == (shown,) * 12
    assert way > 1e-3
    machine.disturbed()["switches"].end()
    machine.run(0.12, lambda root: None)
    assert 0.0 in machine.harness.get("legs.limits")
    assert 1.0 in machine.harness.get("legs.limits")


def test_switches_are_looked_at_every_ten_milliseconds(machine):
    shown = []
    machine.disturbed()["switches"].begin("closed", 0.0)
    machine.run(0.02, lambda root: shown.append(set(machine.harness.get("legs.limits"))))
    changed = [states == {1.0} for states in shown]
    assert len(changed) == 10  # exchanges every 2 ms
    assert changed.index(True) in range(1, 5)
    assert all(changed[changed.index(True) :])


class SlowComputer:
    """A clock by which each tick of 2 ms takes 3."""

    def __init__(self):
        self.now = 0.0

    def tick(self, root=None):
        self.now += 0.003

    def sleep(self, duration):
        self.now += duration


def test_what_physics_lose_is_counted_and_told(machine, monkeypatch):
    slow = SlowComputer()
    loop = partial(RealTimeLoop, clock=lambda: slow.now, sleep=slow.sleep)
    monkeypatch.setattr(emulator, "RealTimeLoop", loop)
    machine.run(1.0, slow.tick)
    # Each second of physics takes 1.5; up to 0.2 s of it may still be made up for.
    assert slow.now == pytest.approx(1.5, abs=0.01)
    assert 0.3 - 0.01 <= machine.lost <= 0.5
    assert 0.0 < machine.late <= 0.21
    said = []
    lateness = Lateness(PLATFORM, "multibody", said.append)
    steps = ((0.5, 0.0), (1.0, 0.21), (2.0, 0.4), (11.1, 0.5), (30.0, 0.5))
    for now, lost in steps:
        lateness.judge(now, 0.02, lost)
    first, second = said
    assert first.startswith("1.00 s: this computer is too slow or too busy")
    assert "they are 0.02 s late, and 0.21 s are lost; " in first
    assert first.endswith("; --backend kinematic needs less")
    assert second.startswith("11.10 s: ")
    assert "0.29 s are lost; " in second
    lateness.judge(31.0, 0.06, 0.5)
    assert said[2:] == [said[2]]
    assert "they are 0.06 s late, and 0.00 s are lost" in said[2]


def test_the_cheapest_physics_have_no_cheaper_ones():
    said = []
    Lateness(PLATFORM, "kinematic", said.append).judge(1.0, 0.2, 0.3)
    assert said[0].endswith("measurements that are too old")


def test_an_emulator_says_on_its_console_that_it_is_late(tmp_path, monkeypatch):
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "e"))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    slow = SlowComputer()
    loop = partial(RealTimeLoop, clock=lambda: slow.tick() or slow.now, sleep=slow.sleep)
    monkeypatch.setattr(emulator, "RealTimeLoop", loop)
    scenario = LevellingScenario(backend="kinematic")
    scenario.hardware.drivers = []
    console = Console(file=io.StringIO())
    emulator.emulate(PLATFORM, scenario, duration=0.1, console=console)
    said = console.file.getvalue().splitlines()
    assert len([line for line in said if "too slow or too busy" in line]) == 1
