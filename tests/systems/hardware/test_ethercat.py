"""Axes on EtherCAT, as far as a fake of pysoem's master with emulated drives can show it."""

import sys
import time
import types

import pytest

from parapod.systems.hardware.canopen import Entry
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.controller import Timing
from parapod.systems.hardware.cia402.emulated_drive import Cia402Node, EmulatedMotor, MeasuredMotor
from parapod.systems.hardware.cia402.makers import MAKERS
from parapod.systems.hardware.cia402.positions import Cia402Positions
from parapod.systems.hardware.cia402.settings import GearSettings, PositionTurnSettings
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.cia402.velocities import Cia402Velocities
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.canopen_slave import SlaveLine
from parapod.systems.hardware.emulation.harness import Misbehaviour
from parapod.systems.hardware.ethercat import EthercatBus

GEAR = 26.0
PRE, SAFE, OPERATIONAL = 2, 4, 8


class Nowhere:
    """A bus without anybody: the drives' own frames are not those of EtherCAT."""

    def send(self, message):
        pass


class Slave:
    """A slave of pysoem's, with an emulated drive behind it."""

    def __init__(self, number, soem, motor):
        line = SlaveLine(Nowhere(), Misbehaviour(), lambda: 0.0)
        self.drive, self.soem = Cia402Node(number, line, motor), soem
        self.state, self.al_status, self.output, self.input = PRE, 0, b"", b""
        self.watchdog, self.assigned, self.callback, self.is_stuck = None, {}, None, False

    def sdo_read(self, index, subindex=0):
        try:
            return self.drive._slave.node.get_data(index, subindex)
        except Exception as error:
            raise self.soem.SdoError(str(error)) from error

    def sdo_write(self, index, subindex, data):
        if index in (0x1C12, 0x1C13):
            assert self.state == PRE
            self.assigned[index, subindex] = data
            return
        try:
            self.drive._slave.node.set_data(index, subindex, data)
        except Exception as error:
            raise self.soem.SdoError(str(error)) from error

    def set_watchdog(self, kind, milliseconds):
        assert kind == "processdata"
        self.watchdog = milliseconds

    def add_emergency_callback(self, callback):
        self.callback = callback

    def write_state(self):
        pass

    def mapped(self, assignment):
        """Index, subindex and size of what is exchanged one way."""
        assert self.assigned[assignment, 0] == b"\x01"
        return self.drive._slave._mapped(int.from_bytes(self.assigned[assignment, 1], "little"))

    def exchange(self):
        if self.state == OPERATIONAL:
            data, parts = self.output, []
            for index, subindex, size in self.mapped(0x1C12):
                parts.append((index, subindex, data[:size]))
                data = data[size:]
            assert data == b""
            for part in reversed(parts):  # the controlword last
                self.drive._slave.node.set_data(*part)
        self.drive.step(time.monotonic())
        node = self.drive._slave.node
        self.input = b"".join(node.get_data(i, k) for i, k, _ in self.mapped(0x1C13))


class Master:
    """A master of pysoem's, on a ring of drives."""

    def __init__(self, soem):
        self.soem, self.slaves, self.state = soem, [], PRE
        self.expected_wkc, self.missing = 0, 0

    def open(self, name):
        if name != "eth9":
            raise ConnectionError(f"could not open interface {name}")

    def config_init(self):
        self.slaves = self.soem.ring
        return len(self.slaves)

    def config_map(self):
        self.expected_wkc = 3 * len(self.slaves)

    def write_state(self):
        for slave in self.slaves:
            slave.state = slave.state if slave.is_stuck else self.state

    def read_state(self):
        pass

    def send_processdata(self):
        for slave in self.slaves:
            slave.exchange()

    def receive_processdata(self, timeout):
        return sum(3 for slave in self.slaves if slave.state == OPERATIONAL)

    def close(self):
        self.slaves = []


@pytest.fixture
def ring(monkeypatch):
    """ring(drive): slaves of two axes of a maker."""
    pytest.importorskip("canopen")
    soem = types.ModuleType("pysoem")
    for name in ("SdoError", "MailboxError", "PacketError", "WkcError", "ConfigMapError"):
        setattr(soem, name, type(name, (Exception,), {}))
    soem.INIT_STATE, soem.PREOP_STATE, soem.SAFEOP_STATE, soem.OP_STATE = 1, PRE, SAFE, OPERATIONAL
    soem.Master = lambda: Master(soem)
    monkeypatch.setitem(sys.modules, "pysoem", soem)

    def make(drive):
        motor = EmulatedMotor(gear=GEAR, maker=MAKERS[drive])
        soem.ring = [Slave(number, soem, motor) for number in (1, 2)]
        return soem.ring

    return make


def axes(drive, kind=GearSettings, device=Cia402Velocities, **changes):
    settings = {"interface": "ethercat", "channel": "eth9", "node_ids": [1, 2], "gear": GEAR}
    settings |= {"drive": drive, "max_velocity_rpm": 800.0}
    return device(kind(**settings | changes), Timing(timeout=0.5, sdo_timeout=0.5))


@pytest.mark.parametrize("drive", MAKERS)
def test_axes_live_on_a_ring_as_on_a_bus(ring, drive):
    slaves, device = ring(drive), axes(drive)
    device.configure()
    assert {slave.drive.state for slave in slaves} == {DriveState.SWITCH_ON_DISABLED}
    assert [slave.watchdog for slave in slaves] == [0.0, 0.0]
    device.activate()
    assert [slave.watchdog for slave in slaves] == [100.0, 100.0]
    assert {slave.drive.state for slave in slaves} == {DriveState.OPERATION_ENABLED}
    device.write({"velocity_command": (1.0, -2.0), "brake": (0.0,)})
    targets = [slave.drive._slave.get(objects.TARGET_VELOCITY) for slave in slaves]
    unit = slaves[0].drive._per_rpm * GEAR * 60.0 / 6.283185307179586
    assert targets == [round(unit), round(-2.0 * unit)]
    slaves[0].drive.measured = MeasuredMotor(position=0.5, velocity=1.0)
    reading = device.read()
    assert reading["position"] == pytest.approx([0.5, 0.0], abs=1e-3)
    assert reading["velocity"] == pytest.approx([1.0, 0.0], abs=5e-3)
    slaves[0].drive.measured = MeasuredMotor(position=0.5)
    device.write({"velocity_command": (1.0, -2.0), "brake": (1.0,)})
    assert {slave.drive.state for slave in slaves} == {DriveState.QUICK_STOP_ACTIVE}
    device.deactivate()
    assert {slave.drive.state for slave in slaves} == {DriveState.SWITCH_ON_DISABLED}
    assert [slave.watchdog for slave in slaves] == [0.0, 0.0]
    device.close()
    device.close()


@pytest.mark.parametrize("drive", ["epos4", "elmo"])
def test_positions_and_what_is_fed_forward_are_one_image(ring, drive):
    slaves = ring(drive)
    device = axes(drive, PositionTurnSettings, Cia402Positions, feedforward=1.0)
    device.configure()
    device.activate()
    device.read()
    device.write({"position_command": (0.1, -0.1), "brake": (0.0,)})
    sent = [slave.drive._slave.get(objects.TARGET_POSITION) for slave in slaves]
    assert sent[0] == -sent[1] >= 0
    carried = [(index, subindex) for index, subindex, _ in slaves[0].mapped(0x1C12)]
    assert carried == [(0x6040, 0), (0x607A, 0), (0x60B1, 0)]
    device.close()


def test_a_ring_that_is_too_short_or_not_there_is_told(ring):
    ring("epos4")
    for changes, fault, words in (
        ({"channel": "eth1"}, DeviceFault.UNPLUGGED, "no bus: ConnectionError: could not open"),
        ({"node_ids": [1, 3]}, DeviceFault.SILENT, "2 slaves on the ring, and node 3 is wanted"),
    ):
        with pytest.raises(DeviceError) as caught:
            axes("epos4", **changes).configure()
        assert caught.value.fault is fault
        assert words in str(caught.value)


def test_a_slave_that_falls_silent_is_named(ring):
    slaves, device = ring("elmo"), axes("elmo")
    device.configure()
    device.activate()
    slaves[1].state = SAFE
    with pytest.raises(DeviceError, match="node 2 does not answer SYNC") as caught:
        device.read()
    assert caught.value.fault is DeviceFault.SILENT
    slaves[1].callback(types.SimpleNamespace(error_code=0x2340))
    with pytest.raises(DeviceError, match=r"node 2 is in fault: EMCY 0x2340 \(short circuit\)"):
        device.read()
    device.close()


def test_an_entry_that_a_slave_does_not_have_is_refused_by_name(ring):
    ring("epos4")
    bus = EthercatBus("a ring", [1], 0.1)
    bus.open({"channel": "eth9"})
    with pytest.raises(DeviceError, match="node 1 refuses to read 0x5FFF:01"):
        bus.get(1, Entry(0x5FFF, 1, "<I"))
    bus.close()
    with pytest.raises(DeviceError, match="not open"):
        bus.get(1, objects.VENDOR)
