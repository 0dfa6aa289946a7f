import threading
import time

import pytest

from parapod.systems.hardware.device import Device, DeviceError, DeviceFault


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

    def wait(condition, timeout=2.0):
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if condition():
                return True
            time.sleep(1e-3)
        return condition()

    return wait
