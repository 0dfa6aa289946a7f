"""Homing of a part: from a device without a reference to a file that knows one."""

import itertools
import json
import math
import time
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from parapod.diagrams.devices import Parts
from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.homing import BySwitch, Check, Homing, HomingError, find_ends
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.real_machine.homing import _Hands, home_part
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.device import DeviceError, DeviceFault, NotFitted
from parapod.systems.hardware.io import Sample
from parapod.systems.hardware.position_memory import IncrementalDevice, PositionMemory

END, START = 0.010, (0.009, 0.0085, 0.0092, 0.009)
HOMING = Homing(
    command="voltage",
    measures="extension",
    gain=0.02,
    fast=1.0,
    slow=0.25,
    longest=0.05,
    sign=lambda driver, i, period: BySwitch("legs.limits", i),
    positions=lambda driver: [0.46] * 4,
    size=4,
    in_turn=False,
    rest={"stop": 0.0},
)
PARTS = sorted({port.part for port in (*PLATFORM.inputs, *PLATFORM.measured)})


class FakeLegs(IncrementalDevice):
    """Legs that move as they are commanded, from a place that the encoders do not know."""

    position_signal = "extension"

    def __init__(self, path, ports):
        self.name, self.measures, self.commands = "fake legs", ports.measures, ports.commands
        super().__init__(str(path), 4, "legs")
        self.true, self.offset, self.then = list(START), [0.0] * 4, time.monotonic()
        self.volts, self.asked, self.is_pressed, self.fails_at = (0.0,) * 4, [], False, None
        self.has_power = False

    @property
    def is_referenced(self):
        return False

    def _open(self):
        self.offset = list(self.true)

    def _energise(self):
        self.has_power, self.then = True, time.monotonic()

    def _release(self):
        self._move()
        self.volts, self.has_power = (0.0,) * 4, False

    def _set_reference(self, values):
        self.offset = [true - value for true, value in zip(self.true, values, strict=True)]

    def _move(self):
        now = time.monotonic()
        # A computer that stalls does not make the legs run on: the device stops by itself.
        elapsed, self.then = min(now - self.then, 0.02), now
        self.true = [
            min(x + 0.02 * v * elapsed, END + 1e-3)
            for x, v in zip(self.true, self.volts, strict=True)
        ]

    def read(self):
        self._move()
        if self.fails_at is not None and self.true[0] > self.fails_at:
            raise DeviceError(self.name, "the fuse is blown", DeviceFault.FAILED)
        shown = [x - offset for x, offset in zip(self.true, self.offset, strict=True)]
        limits = [float(x >= END) for x in self.true] + [0.0] * 8
        return {
            "extension": shown,
            "velocity": (0.0,) * 4,
            "limits": limits,
            "emergency_stop": (float(self.is_pressed),),
        }

    def write(self, commands):
        self._move()
        self.volts = tuple(commands["voltage"])
        self.asked.append(self.volts)

    def neutral(self):
        self.volts = (0.0,) * 4

    def close(self):
        self.volts, self.has_power = (0.0,) * 4, False


@dataclass
class _FakeDriver(Driver):
    path: str = ""
    made: FakeLegs | None = None

    def make(self, ports):
        if self.part != "legs":
            return NotFitted(self.part, ports.measures, ports.commands)
        self.made = self.made or FakeLegs(self.path, ports)
        return self.made


def _check(value):
    def check(homing, driver, period):
        seen = yield [0.0] * 4
        yield [0.0] * 4
        return [Check("seen_mm", 1e3 * seen["legs.extension"][0], "mm", value, "the first")]

    return check


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """rig(bound): a function that homes, the driver, and the file."""
    monkeypatch.setattr("parapod.diagrams.homing._SETTLING", 0.02)  # these legs have no inertia
    path = tmp_path / "extensions.json"

    def make(bound=1e3):
        drivers = [_FakeDriver(part, str(path)) for part in PARTS]
        scenario = LevellingScenario(backend="hardware", hardware=HardwareScenario(drivers))
        homing = replace(HOMING, checks=_check(bound))
        real = replace(PLATFORM.real, homings={"legs": homing})
        machine = replace(PLATFORM, real=real, variant=None)
        driver = drivers[PARTS.index("legs")]
        driver.make(_ports())
        said = []
        return lambda: home_part(machine, scenario, "legs", said.append), driver.made, path

    return make


def _ports():
    measures = {"extension": 4, "velocity": 4, "limits": 12, "emergency_stop": 1}
    return PartPorts(measures, {"voltage": 4, "stop": 1})


def test_what_is_found_is_remembered_and_says_how(rig):
    home, legs, path = rig()
    metrics = {metric.key: metric for metric in home()}
    assert all(metric.passed for metric in metrics.values())
    told = json.loads(path.read_text())
    expected = [0.46 + x - END for x in legs.true]
    # Two measurements of a leg at 5 mm/s; a busy computer measures less often.
    assert told["extension_m"] == pytest.approx(expected, abs=4e-4)
    assert told["reference"].startswith("homed, again within")
    assert not legs.has_power
    assert legs.volts == (0.0,) * 4


def test_a_reference_that_the_checks_contradict_is_refused_and_not_remembered(rig):
    home, legs, path = rig(bound=1.0)
    metrics = {metric.key: metric for metric in home()}
    assert metrics["seen_mm"].verdict == "BROKEN"
    assert json.loads(path.read_text()) == {"extension_m": None}
    assert not legs.has_power


@pytest.mark.parametrize("what", ["fuse", "stop"])
def test_whatever_ends_it_leaves_no_power_and_a_file_that_knows_nothing(rig, what):
    home, legs, path = rig()
    PositionMemory(path, 4, "extension").save((0.4,) * 4)
    legs.fails_at = 0.0095 if what == "fuse" else None
    legs.is_pressed = what == "stop"
    words = "the fuse is blown" if what == "fuse" else "the emergency stop is pressed"
    with pytest.raises((DeviceError, HomingError), match=words):
        home()
    assert json.loads(path.read_text()) == {"extension_m": None}
    assert not legs.has_power
    assert legs.volts == (0.0,) * 4


COARSE = replace(HOMING, spread=1e-3)  # measured late, ends are found less exactly


class LateLegs:
    """Legs and the thread of their device, which is late, by a clock of their own."""

    error = None

    def __init__(self, late, sign=1.0):
        self.now, self.late, self.sign = 1000.0, late, sign
        self.true, self.then, self.volts = np.array(START), self.now, np.zeros(4)
        self.device = SimpleNamespace(
            name="late legs", measures={"extension": 4, "limits": 12}, commands={"voltage": 4}
        )
        self.sample = Sample({}, self.now, DeviceFault.NONE, "")
        self.posted, self.obeys_since = (0.0,) * 4, self.now
        self.reading, self.free_at = None, self.now
        self.sleep(0.2)

    def hands(self):
        return _Hands(COARSE, "legs", Parts({"legs": [self]}), 0.01, self.clock, self.sleep)

    def search(self):
        return find_ends(COARSE, None, "legs", 0.01, lambda line: None)

    def clock(self):
        return self.now

    def post(self, signals, measured):
        if tuple(signals["voltage"]) != self.posted:
            self.posted, self.obeys_since = tuple(signals["voltage"]), math.inf

    def sleep(self, seconds):
        for _ in range(max(1, round(1e3 * seconds))):
            self.now += 1e-3
            self.true = self.true + 1e-3 * self.sign * 0.02 * self.volts
            if self.now >= self.free_at:
                self._serve()

    def _serve(self):
        """A reading ends, the newest command is written, and the next reading begins."""
        self.sample = self.reading or self.sample
        self.volts = np.array(self.posted)
        self.obeys_since = min(self.obeys_since, self.now)
        limits = [float(x >= END) for x in self.true] + [0.0] * 8
        values = {"extension": tuple(self.true), "limits": limits}
        self.reading = Sample(values, self.now, DeviceFault.NONE, "")
        self.free_at = self.now + self.late()


def _at_times():
    """Late in every third reading."""
    readings = itertools.count()
    return lambda: 0.095 if next(readings) % 3 == 0 else 0.005


def _anything():
    random = np.random.default_rng(1)
    return lambda: random.uniform(1e-3, 0.1)


# How long readings take [s].
LATE = {
    "usual": lambda: lambda: 0.01,
    "slow": lambda: lambda: 0.03,
    "slower": lambda: lambda: 0.048,
    "at times": _at_times,
    "anything": _anything,
}


@pytest.mark.parametrize("late", LATE.values(), ids=LATE)
def test_late_measurements_accuse_nobody(late):
    legs = LateLegs(late())
    found = legs.hands().carry_out(legs.search())
    # The end lies between two measurements, at the slow command.
    assert found.edge == pytest.approx([END] * 4, abs=0.1 * 0.02 * 0.25)


@pytest.mark.parametrize("late", LATE.values(), ids=LATE)
def test_swapped_motors_are_found_however_late_measurements_are(late):
    legs = LateLegs(late(), sign=-1.0)
    with pytest.raises(HomingError, match="legs 1 moves against its command"):
        legs.hands().carry_out(legs.search())
    assert np.abs(legs.true - START).max() < 0.008


def test_a_part_that_cannot_be_homed_is_named_with_those_that_can():
    scenario = LevellingScenario(backend="hardware")
    with pytest.raises(ScenarioError, match="'wheels' cannot be homed; those that can: legs"):
        home_part(PLATFORM, scenario, "wheels", print)


# On emulated devices, one start after the other


@pytest.mark.slow
@pytest.mark.parametrize("of", ["level", "chair-walk"])
def test_emulated_machines_find_their_references(of, emulate_on_wheels, emulate_chair):
    pytest.importorskip("canopen")
    pytest.importorskip("nidaqmx")
    emulator = emulate_on_wheels() if of == "level" else emulate_chair()
    emulator.memory.forget()  # as a killed program leaves it
    program = emulator.parapod("run", of, "--backend", "hardware")
    said = program.communicate(timeout=600)[1]
    assert program.returncode == 2
    assert "find them with `parapod home`" in said
    emulator.run_well("home", "--of", of, "--yes")
    told = json.loads(emulator.memory.path.read_text())
    assert told["reference"].startswith("homed, again within 0.0")
    signal = emulator.remembered[0]
    true = emulator.wires.get(f"legs.{signal}")
    assert told[f"{signal}_m"] == pytest.approx(true, abs=1e-4)


@pytest.mark.slow
def test_legs_that_are_stuck_find_nothing_and_the_file_knows_nothing(emulate_on_wheels):
    pytest.importorskip("nidaqmx")
    emulator = emulate_on_wheels()
    emulator.misbehave("legs", "stuck")
    program = emulator.parapod("home", "--yes")
    said = program.communicate(timeout=600)[1]
    assert program.returncode == 2
    assert "legs 1 stands, but its end has not shown" in said
    assert json.loads(emulator.memory.path.read_text()) == {"extension_m": None}
    assert emulator.is_neutral
