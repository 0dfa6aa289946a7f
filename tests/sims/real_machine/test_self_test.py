"""The self-test of a part whose devices are fakes."""

from dataclasses import dataclass
from functools import partial

import pytest

from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.real_machine.self_test import Move, check_part
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.clock import EmulatedClock, going_by, hold, monotonic
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault
from parapod.systems.hardware.io import DeviceThread

PARTS = sorted({port.part for port in (*PLATFORM.inputs, *PLATFORM.measured)})


class FakePart(Device):
    """Turns its wheels as it is commanded, and has a fuse that can blow meanwhile."""

    def __init__(self, part, ports):
        self.name, self.measures, self.commands = f"fake {part}", ports.measures, ports.commands
        self.velocity, self.angle, self.then = (0.0,) * 4, [0.0] * 4, monotonic()
        self.asked, self.blows_at, self.end = [], None, 1e9

    def configure(self):
        pass

    def read(self):
        now = monotonic()
        for wheel, velocity in enumerate(self.velocity):
            self.angle[wheel] = min(self.end, self.angle[wheel] + velocity * (now - self.then))
        self.then = now
        if self.blows_at is not None and self.blows_at in self.velocity:
            raise DeviceError(self.name, "the fuse is blown", DeviceFault.FAILED)
        zeros = {name: (0.0,) * size for name, size in self.measures.items()}
        return zeros | {"position": tuple(self.angle)}

    def write(self, commands):
        self.velocity = tuple(commands["velocity_command"])
        self.asked.append(self.velocity)

    def neutral(self):
        self.velocity = (0.0,) * 4

    def close(self):
        pass


@dataclass
class _FakeDriver(Driver):
    made: FakePart | None = None
    blows_at: float | None = None
    end: float = 1e9

    def make(self, ports):
        self.made = FakePart(self.part, ports)
        self.made.blows_at, self.made.end = self.blows_at, self.end
        return self.made


@pytest.fixture
def check(monkeypatch, tmp_path):
    """check(move, **settings): metrics of the wheels' self-test by key, and the device.

    Time waits for the test's threads, on a computer that pauses or is slow.
    """
    # A computer that pauses for longer than usual ends no test.
    patient = partial(DeviceThread, command_timeout=60.0)
    monkeypatch.setattr("parapod.diagrams.devices.DeviceThread", patient)

    def run(move, may_move=lambda: True, **settings):
        drivers = [_FakeDriver(part, **settings) for part in PARTS]
        scenario = LevellingScenario(backend="hardware", hardware=HardwareScenario(drivers))
        with going_by(EmulatedClock(tmp_path / "clock", 1.0)):
            hold()
            metrics = check_part(
                PLATFORM, scenario, "wheels", move, 0.1, lambda line: None, may_move
            )
        return {metric.key: metric for metric in metrics}, drivers[PARTS.index("wheels")].made

    return run


class PressedLegs(FakePart):
    """Legs one of whose switches is pressed for a moment."""

    def read(self):
        values = {name: [0.0] * size for name, size in self.measures.items()}
        self.asked.append(None)
        values["limits"][4] = float(5 <= len(self.asked) < 8)
        return values


@dataclass
class _PressedDriver(Driver):
    def make(self, ports):
        return PressedLegs(self.part, ports)


def test_switches_are_told_when_they_change_and_the_rest_with_units():
    drivers = [_PressedDriver(part) for part in PARTS]
    scenario = LevellingScenario(backend="hardware", hardware=HardwareScenario(drivers))
    said = []
    check_part(PLATFORM, scenario, "legs", None, 0.15, said.append)
    told = [line for line in said if line.startswith("limits")]
    open_, pressed = "limits: 0 0 0 0 0 0 0 0 0 0 0 0", "limits: 0 0 0 0 1 0 0 0 0 0 0 0"
    assert told == [open_, pressed, open_]
    assert "extension [m]: 0, 0, 0, 0 (spread 0)" in said
    assert said.count("emergency_stop: 0") == 1


def test_a_motion_goes_there_and_back_on_ramps_and_ends_at_rest(check):
    metrics, wheels = check(Move(1, 2.0, 0.5))
    assert all(metric.passed for metric in metrics.values()), metrics
    # The area of a trapezium of 2 rad/s with ramps of 0.2 s in 0.5 s: 2 (0.5 - 0.2).
    assert metrics["reached"].meaning == "measured way, 0.6 rad expected"
    asked = [velocity[1] for velocity in wheels.asked]
    assert max(asked) == pytest.approx(2.0)
    assert min(asked) == pytest.approx(-2.0)
    assert asked[-1] == 0.0
    assert not any(velocity[i] for velocity in wheels.asked for i in (0, 2, 3))


def test_an_axis_at_its_end_has_not_moved_although_it_comes_back(check):
    metrics, wheels = check(Move(1, 2.0, 0.5), end=0.0)
    assert min(wheels.angle) < -0.4
    assert abs(metrics["reached"].value) < 0.1
    assert not metrics["wrong_sign"].passed
    assert "at its end?" in metrics["wrong_sign"].meaning


def test_only_a_move_that_can_be_made_is_asked_about_and_a_no_opens_nothing(check):
    asked = []

    def no():
        asked.append(True)
        return False

    with pytest.raises(ScenarioError, match=r"wheels have numbers 1\.\.4, not 5"):
        check(Move(4, 2.0, 0.5), may_move=no)
    assert asked == []
    metrics, wheels = check(Move(3, 2.0, 0.5), may_move=no)
    assert (asked, metrics, wheels.asked) == ([True], {}, [])


def test_a_device_that_fails_on_the_way_is_named_once(check):
    with pytest.raises(DeviceError) as caught:
        check(Move(1, 2.0, 0.5), blows_at=2.0)
    assert str(caught.value) == "fake wheels: the fuse is blown"
    assert caught.value.fault is DeviceFault.FAILED
