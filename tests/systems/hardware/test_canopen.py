"""A serial port whose bytes come from a buffer, and the bus behind it."""

import time

import pytest

from parapod.systems.hardware.canopen import BufferedPort, CanopenBus, Entry
from parapod.systems.hardware.clock import PATIENCE, EmulatedClock, going_by
from parapod.systems.hardware.device import DeviceError, DeviceFault


class Port:
    """A port with bytes that have come, and a count of the calls."""

    def __init__(self, data):
        self.data, self.calls, self.write_timeout, self.baudrate = data, 0, None, 115200
        self.written = []

    @property
    def in_waiting(self):
        return len(self.data)

    def read(self, size):
        self.calls += 1
        taken, self.data = self.data[:size], self.data[size:]
        return taken

    def reset_input_buffer(self):
        self.data = b""

    def write(self, data):
        self.written.append(data)


@pytest.fixture
def port():
    return Port(b"t1812ABCD\rz\r")


def test_bytes_come_one_by_one_and_are_read_at_once(port):
    buffered = BufferedPort(port)
    assert b"".join(buffered.read(1) for _ in range(12)) == b"t1812ABCD\rz\r"
    assert port.calls == 1
    assert buffered.read(1) == b""
    assert port.calls == 2


def test_what_waits_is_counted_in_the_buffer_and_else_in_the_port(port):
    buffered = BufferedPort(port)
    assert buffered.in_waiting == 12
    buffered.read(1)
    assert buffered.in_waiting == 11
    port.data = b"more"
    assert buffered.read(100) == b"1812ABCD\rz\r"
    assert buffered.in_waiting == 4


def test_a_reset_forgets_both(port):
    buffered = BufferedPort(port)
    buffered.read(1)
    port.data = b"more"
    buffered.reset_input_buffer()
    assert buffered.in_waiting == 0
    assert buffered.read(1) == b""


def test_everything_else_is_the_ports(port):
    buffered = BufferedPort(port)
    buffered.write(b"S8\r")
    buffered.write_timeout = 0.05
    assert port.written == [b"S8\r"]
    assert port.write_timeout == buffered.write_timeout == 0.05
    assert buffered.baudrate == 115200


def test_a_cable_that_goes_while_the_bus_is_opened_is_named_and_the_port_closed(monkeypatch):
    can = pytest.importorskip("can")
    pytest.importorskip("canopen")
    ended = []

    class Gone(Port):
        def __setattr__(self, name, value):
            if name == "timeout":
                raise OSError(5, "Input/output error")
            super().__setattr__(name, value)

        def close(self):
            ended.append("port")

    class Opened:
        def __init__(self, ignore_config, channel):
            self.serialPortOrig = Gone(b"")

        def shutdown(self):
            ended.append("bus")

    monkeypatch.setattr(can, "Bus", Opened)
    bus = CanopenBus("EPOS2 on /dev/ttyUSB0", [1], 0.1)
    with pytest.raises(DeviceError, match=r"EPOS2 on /dev/ttyUSB0: .*Input/output error"):
        bus.open({"channel": "/dev/ttyUSB0"})
    bus.close()
    assert ended == ["bus", "port"]


def test_service_data_are_waited_for_as_long_as_the_devices_condition_asks(tmp_path):
    pytest.importorskip("canopen")
    keeper = EmulatedClock(tmp_path / "clock", 1.0)
    with going_by(EmulatedClock(tmp_path / "clock")):
        bus = CanopenBus("EPOS2 on virtual", [1], 0.02)
        bus.open({"interface": "virtual", "channel": "test_canopen"})
        try:
            keeper.is_well = False  # only now
            began = time.monotonic()
            with pytest.raises(DeviceError, match="node 1 does not answer") as error:
                bus.get(1, Entry(0x1018, 1, "<I"))
            assert time.monotonic() - began < 0.5 * PATIENCE
        finally:
            bus.close()
    assert error.value.fault is DeviceFault.SILENT
