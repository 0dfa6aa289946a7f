"""An emulated CANopen node sends and obeys the process data that it has been told last."""

from types import SimpleNamespace

import pytest

from parapod.systems.hardware.canopen import (
    HEARTBEAT_CONSUMED,
    HEARTBEAT_PRODUCED,
    SYNC_ID,
    Entry,
)
from parapod.systems.hardware.emulation.canopen_slave import (
    CanopenSlave,
    SlaveLine,
    process_data_defaults,
)
from parapod.systems.hardware.emulation.harness import Misbehaviour

NODE = 5
FIRST, SECOND = Entry(0x2001, 0, "<H"), Entry(0x2002, 0, "<B")


class Bus:
    """Keeps what is sent."""

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append((message.arbitration_id, bytes(message.data)))


@pytest.fixture
def node():
    """An operational node, and what it does with a frame."""
    bus = Bus()
    line = SlaveLine(bus, Misbehaviour(), lambda: 0.0)
    heartbeats = {HEARTBEAT_CONSUMED: 0, HEARTBEAT_PRODUCED: 0}
    defaults = {FIRST: 0x1234, SECOND: 0x56, **heartbeats, **process_data_defaults(NODE)}
    slave = CanopenSlave(NODE, defaults, line, lambda: None)

    def write(entry, value):
        slave.node.set_data(entry.index, entry.subindex, entry.pack(value))

    def hear(can_id, data=b""):
        bus.sent.clear()
        line.receive(SimpleNamespace(arbitration_id=can_id, data=data, timestamp=0.0))
        return list(bus.sent)

    slave.node.nmt.state = "OPERATIONAL"
    return SimpleNamespace(slave=slave, write=write, hear=hear)


def carry(node, communication, mapping, can_id, entry):
    node.write(Entry(communication, 1, "<I"), can_id)
    node.write(Entry(communication, 2, "<B"), 1)
    node.write(Entry(mapping, 1, "<I"), entry.mapping)
    node.write(Entry(mapping, 0, "<B"), 1)


def test_sync_is_answered_with_what_is_mapped_now(node):
    assert node.hear(SYNC_ID) == []
    carry(node, 0x1800, 0x1A00, 0x185, FIRST)
    assert node.hear(SYNC_ID) == [(0x185, b"\x34\x12")]
    node.write(FIRST, 0xABCD)
    assert node.hear(SYNC_ID) == [(0x185, b"\xcd\xab")]
    carry(node, 0x1800, 0x1A00, 0x186, SECOND)
    assert node.hear(SYNC_ID) == [(0x186, b"\x56")]
    node.slave.boot()
    node.slave.node.nmt.state = "OPERATIONAL"
    assert node.hear(SYNC_ID) == []
    assert node.slave.get(FIRST) == 0x1234


def test_commands_reach_what_is_mapped_now(node):
    carry(node, 0x1400, 0x1600, 0x205, FIRST)
    node.hear(0x205, b"\x01\x00")
    assert (node.slave.get(FIRST), node.slave.get(SECOND)) == (1, 0x56)
    carry(node, 0x1400, 0x1600, 0x205, SECOND)
    node.hear(0x205, b"\x02")
    assert (node.slave.get(FIRST), node.slave.get(SECOND)) == (1, 2)
