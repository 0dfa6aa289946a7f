import dataclasses
import gc
import itertools
import threading
import time

import pytest

from parapod.systems.hardware.cia402.controller import Timing
from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
from parapod.systems.hardware.cia402.emulator import Cia402Nodes
from parapod.systems.hardware.cia402.forces import Cia402Forces
from parapod.systems.hardware.cia402.makers import MAKERS
from parapod.systems.hardware.cia402.positions import Cia402Positions
from parapod.systems.hardware.cia402.settings import Control, GearSettings
from parapod.systems.hardware.cia402.velocities import Cia402Velocities
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import SUPPLY, Harness, Misbehaviour

CHANNELS = (f"test_cia402 {k}" for k in itertools.count())
# Steep ramps, so that a test does not wait for them; a patient guard, for busy machines.
QUICK = {
    "acceleration": 1e4,
    "quick_stop_deceleration": 1e4,
    "gear": 26.0,
    "node_ids": [1, 2, 3, 4],
}
DEVICES = {
    Control.VELOCITY: Cia402Velocities,
    Control.POSITION: Cia402Positions,
    Control.FORCE: Cia402Forces,
}
PATIENT = {"heartbeat_timeout": 2.0, "timeout": 0.5, "sdo_timeout": 2.0}


@pytest.fixture(scope="module", autouse=True)
def collected():
    """Destroys what other tests have left here: Meshcat aborts when a device's thread does it."""
    gc.collect()


class FakeDevice(Device):
    """Counts its readings, remembers what happens to it, and fails when told to."""

    def __init__(self, name="fake", size=2):
        self.name = name
        self.measures = {"position": size}
        self.commands = {"velocity": size, "brake": 1}
        self.events = []
        self.written = []
        self.error = None
        self.stall = 0.0
        self.readings = 0
        self.lock = threading.Lock()

    def _do(self, event):
        self.events.append(event)
        if self.error is not None:
            raise self.error

    def configure(self):
        self._do("configure")

    def activate(self):
        self._do("activate")

    def read(self):
        time.sleep(self.stall)
        if self.error is not None:
            raise self.error
        self.readings += 1
        return {"position": (float(self.readings),) * self.measures["position"]}

    def write(self, commands):
        if self.error is not None:
            raise self.error
        self.written.append({name: tuple(values) for name, values in commands.items()})

    def neutral(self):
        self._do("neutral")

    def close(self):
        self.events.append("close")


@pytest.fixture
def fake():
    return FakeDevice


@pytest.fixture
def failure():
    return DeviceError("fake", "the fuse is blown", DeviceFault.FAILED)


@pytest.fixture
def until():
    """Waits for something to become so; says whether it did."""

    def wait(condition, timeout=60.0):
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if condition():
                return True
            time.sleep(1e-3)
        return condition()

    return wait


def split(kind, values):
    """Settings of a kind, times, and whether to read synchronously; see `Rig`."""
    values = dict(values)
    is_synchronous = values.pop("is_synchronous", True)
    timing = Timing(**{name: values.pop(name) for name in Timing._fields if name in values})
    names = {field.name for field in dataclasses.fields(kind)}
    properties = {name: value for name, value in values.items() if name not in names}
    settings = type(kind.__name__, (kind,), properties)
    fields = {name: value for name, value in values.items() if name in names}
    return settings(**fields), timing, is_synchronous


class Rig:
    """Drives, the emulated nodes that they are on, and the wires behind these."""

    def __init__(
        self,
        changes=None,
        kind=GearSettings,
        part="wheels",
        axes=4,
        position=0.0,
        make_harness=Harness,
        clock=time.monotonic,
        **node,
    ):
        """Prepares the rig.

        Args:
            changes: settings, times, or properties of the settings in SI units.
            kind: class of the settings.
            part: part of the machine.
            axes: number of axes.
            position: of all axes [rad or m].
            make_harness: makes the wires of the sizes of their signals.
            clock: that of the drives [s].
            node: arguments of the emulator.
        """
        self.part, self.misbehaviour = part, Misbehaviour()
        channel = next(CHANNELS)
        self.settings, timing, is_synchronous = split(
            kind,
            {"interface": "virtual", "channel": channel, "part": part}
            | QUICK
            | PATIENT
            | (changes or {}),
        )
        device = DEVICES[self.settings.control]
        sizes = {
            self.settings.command_signal: axes,
            "brake": 1,
            "emergency_stop": 1,
        } | dict.fromkeys(("position", "velocity", "current"), axes)
        wires = {f"{part}.{name}": size for name, size in sizes.items()} | {SUPPLY: 1}
        for group in self.settings.switches:
            wires |= dict.fromkeys((group.measure, group.command), len(group.switches))
        self.harness = make_harness(wires)
        self.harness.set(SUPPLY, (1.0,))
        self.harness.set(f"{part}.position", [position] * axes)
        motor = node.pop("motor", EmulatedMotor())
        self.nodes = Cia402Nodes(
            self.harness,
            channel=channel,
            misbehaviour=self.misbehaviour,
            part=part,
            switches=self.settings.switches,
            motor=motor._replace(maker=node.pop("maker", MAKERS[self.settings.drive])),
            **node,
        )
        self.drives = device(self.settings, timing, is_synchronous, clock)

    def __enter__(self):
        self.nodes.__enter__()
        return self

    def __exit__(self, *_):
        self.drives.close()
        self.nodes.__exit__()

    def activate(self):
        self.drives.configure()
        self.drives.activate()

    @property
    def command(self):
        return self.harness.get(f"{self.part}.{self.drives.command_signal}")

    @property
    def is_braked(self):
        return self.harness.get(f"{self.part}.brake") == (1.0,)

    def wait(self, condition, call=None):
        """Waits for a condition, and goes on reading meanwhile as an owner does, or calls."""
        deadline = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < deadline, (self.command, self.nodes.states)
            (call or self.drives.read)()
            time.sleep(0.001)

    def wait_alone(self, condition):
        """Waits for a condition without a call of the drives."""
        self.wait(condition, lambda: None)

    def wait_for(self, state):
        """Waits for all nodes to be in a state, without a call of the drives."""
        self.wait_alone(lambda: set(self.nodes.states) == {state})


@pytest.fixture(scope="session")
def make_rig():
    """make_rig(params, ...): see `Rig`; to be entered."""
    pytest.importorskip("canopen")
    return Rig
