"""A CANopen node with process data, SYNC and a heartbeat's consumer, which canopen's own lack."""

from collections.abc import Callable, Mapping
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_CONSUMED,
    NOT_VALID,
    ON_ARRIVAL,
    PDO_COUNT,
    SYNC_ID,
    Entry,
)
from parapod.systems.hardware.emulation.harness import Misbehaviour

# Frames of a garbled node from one that is cut short to the next.
_GARBLED = 5
# Objects that say what process data carry (CiA 301).
_OF_PROCESS_DATA = range(0x1400, 0x1C00)

# By identifier, index, subindex and number of bytes of each entry.
type _Mapped = list[tuple[int, list[tuple[int, int, int]]]]


class SlaveLine:
    """The bus as an emulated node sees it: what it uses of `canopen.Network`, without its threads.

    One thread calls `step` and everything else.

    Attributes:
        is_connected: true if the node is on the bus: otherwise it neither receives nor sends.
    """

    def __init__(self, can_bus: Any, misbehaviour: Misbehaviour, clock: Callable[[], float]):
        """Creates a line.

        Args:
            can_bus: bus of python-can.
            misbehaviour: misbehaviour of all nodes on the bus.
            clock: monotonic [s].
        """
        self._bus, self._misbehaviour, self._clock = can_bus, misbehaviour, clock
        self._message = need("can").Message
        self._subscribers: dict[int, list[Callable[..., None]]] = {}
        self._tasks: list[_Periodic] = []
        self._sent = 0
        self.is_connected = True

    def subscribe(self, can_id: int, callback: Callable[..., None]) -> None:
        """Has frames with this identifier passed on."""
        self._subscribers.setdefault(can_id, []).append(callback)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Sends a frame, unless the nodes are silent."""
        if not self.is_connected or not self._misbehaviour.answers(self._clock()):
            return
        self._sent += 1
        if self._misbehaviour.is_garbled and self._sent % _GARBLED == 0:
            data = bytes(data)[: len(data) // 2]
        self._bus.send(
            self._message(
                arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote
            )
        )

    def send_periodic(
        self, can_id: int, data: bytes, period: float, remote: bool = False
    ) -> "_Periodic":
        """Begins to send a frame periodically [s]."""
        task = _Periodic(self, can_id, data, period, self._clock())
        self._tasks.append(task)
        return task

    def forget(self, task: "_Periodic") -> None:
        """Ends sending a frame periodically."""
        if task in self._tasks:
            self._tasks.remove(task)

    def receive(self, message: Any) -> None:
        """Passes a frame on to whom it concerns."""
        if not self.is_connected:
            return
        for callback in self._subscribers.get(message.arbitration_id, ()):
            callback(message.arbitration_id, message.data, message.timestamp)

    def step(self, now: float) -> None:
        """Sends what is due."""
        for task in tuple(self._tasks):
            task.step(now)


class _Periodic:
    """A frame that is sent periodically, with the interface of canopen's."""

    def __init__(self, line: SlaveLine, can_id: int, data: bytes, period: float, now: float):
        self._line, self._can_id, self._data, self._period = line, can_id, data, period
        self._due = now

    def step(self, now: float) -> None:
        if now >= self._due:
            self._due = now + self._period
            self._line.send_message(self._can_id, bytes(self._data))

    def update(self, data: bytes) -> None:
        self._data = data

    def stop(self) -> None:
        self._line.forget(self)


class CanopenSlave:
    """A CANopen node: canopen's service data, and what it lacks.

    Attributes:
        node: canopen's.
    """

    def __init__(
        self,
        node_id: int,
        defaults: Mapping[Entry, int],
        line: SlaveLine,
        on_heartbeat_lost: Callable[[], None],
    ):
        """Creates a node and puts it on the line.

        Args:
            node_id: its address.
            defaults: the entries of its object dictionary.
            line: the bus.
            on_heartbeat_lost: is called when a heartbeat that is consumed stays away.
        """
        self.id, self._line, self._on_heartbeat_lost = node_id, line, on_heartbeat_lost
        self._guarded: tuple[int, float] | None = None
        self._heard: float | None = None
        self._defaults = dict(defaults)
        self._process_data: tuple[_Mapped, _Mapped] | None = None
        self.node: Any = need("canopen").LocalNode(node_id, _dictionary(defaults))
        self.node.associate_network(line)
        self.node.add_write_callback(self._on_write)
        line.subscribe(SYNC_ID, self._on_sync)
        for number in range(PDO_COUNT):
            base = 0x200 + 0x100 * number
            line.subscribe(base + node_id, self._on_command)
        self.boot()

    def boot(self) -> None:
        """Forgets all settings, says so, and waits for a master."""
        self.node.data_store.clear()
        self._process_data = None
        self._guarded = self._heard = None
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def get(self, entry: Entry) -> int:
        """Value of an entry of the object dictionary that only writing changes.

        Without canopen's ways of asking for it: a dozen nodes are asked a dozen times a tick.
        """
        data = self.node.data_store.get(entry.index, {}).get(entry.subindex)
        return self._defaults[entry] if data is None else entry.unpack(data)

    def written(self, entry: Entry) -> int:
        """Value that has been written to an entry since the last boot; 0 if none has."""
        data = self.node.data_store.get(entry.index, {}).get(entry.subindex)
        return 0 if data is None else entry.unpack(data)

    def hear(self, can_id: int, now: float) -> None:
        """Takes note of a frame that may be the heartbeat that is consumed."""
        if self._guarded is not None and can_id == HEARTBEAT_BASE + self._guarded[0]:
            self._heard = now

    def step(self, now: float) -> None:
        """Boots on request, and misses heartbeats."""
        if self.node.nmt.state == "INITIALISING":
            self.boot()
        if self._guarded is None or self._heard is None:
            return
        if now - self._heard > self._guarded[1]:
            self._heard = None  # until the next one (CiA 301)
            self._on_heartbeat_lost()

    def _on_write(self, index: int, subindex: int, data: bytes, **_: Any) -> None:
        if index in _OF_PROCESS_DATA:
            self._process_data = None
        if index == HEARTBEAT_CONSUMED.index:
            value = HEARTBEAT_CONSUMED.unpack(data)
            timeout = 1e-3 * (value & 0xFFFF)
            self._heard = None
            self._guarded = (value >> 16 & 0x7F, timeout) if timeout else None

    def _on_sync(self, *_: Any) -> None:
        if self.node.nmt.state != "OPERATIONAL":
            return
        sent = self._mapped_data()[1]
        for can_id, entries in sent:
            parts = (self.node.get_data(index, subindex) for index, subindex, _ in entries)
            self._line.send_message(can_id, b"".join(parts))

    def _on_command(self, can_id: int, data: bytes, _timestamp: float) -> None:
        if self.node.nmt.state != "OPERATIONAL":
            return
        received, _ = self._mapped_data()
        for known_entries, entries in received:
            if known_entries != can_id:
                continue
            # From the end, where the target is: the controlword acts when the target is there.
            for index, subindex, size in reversed(entries):
                chunk, data = bytes(data[-size:]), data[:-size]
                self.node.set_data(index, subindex, chunk)

    def _mapped_data(self) -> "tuple[_Mapped, _Mapped]":
        """Process data that are received, and those that answer SYNC, as they are set up now."""
        if self._process_data is None:
            received: _Mapped = []
            sent: _Mapped = []
            for number in range(PDO_COUNT):
                if (can_id := self._identifier(0x1400 + number)) is not None:
                    received.append((can_id, self._mapped(0x1600 + number)))
                if (can_id := self._identifier(0x1800 + number)) is None:
                    continue
                if self._value(0x1800 + number, 2, "<B") <= 240:
                    sent.append((can_id, self._mapped(0x1A00 + number)))
            self._process_data = received, sent
        return self._process_data

    def _identifier(self, communication: int) -> int | None:
        """Identifier of a process data object; None if it is not valid."""
        value = self._value(communication, 1, "<I")
        return None if value & NOT_VALID else value & 0x7FF

    def _mapped(self, mapping: int) -> list[tuple[int, int, int]]:
        """Index, subindex and number of bytes of what a process data object carries."""
        count = self._value(mapping, 0, "<B")
        words = (self._value(mapping, number, "<I") for number in range(1, count + 1))
        return [(word >> 16, word >> 8 & 0xFF, (word & 0xFF) // 8) for word in words]

    def _value(self, index: int, subindex: int, kind: str) -> int:
        return self.get(Entry(index, subindex, kind))


def process_data_defaults(node_id: int) -> dict[Entry, int]:
    """Entries of the process data objects: none is valid, none carries anything."""
    entries: dict[Entry, int] = {}
    for communication, mapping, base in ((0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)):
        for number in range(PDO_COUNT):
            can_id = base + 0x100 * number + node_id
            entries[Entry(communication + number, 1, "<I")] = can_id | NOT_VALID
            entries[Entry(communication + number, 2, "<B")] = ON_ARRIVAL
            entries[Entry(mapping + number, 0, "<B")] = 0
            for position in range(1, 9):
                entries[Entry(mapping + number, position, "<I")] = 0
    return entries


def _dictionary(defaults: Mapping[Entry, int]) -> Any:
    """An object dictionary of canopen's."""
    od = need("canopen.objectdictionary")
    kinds = {
        "<b": od.INTEGER8,
        "<h": od.INTEGER16,
        "<i": od.INTEGER32,
        "<B": od.UNSIGNED8,
        "<H": od.UNSIGNED16,
        "<I": od.UNSIGNED32,
    }
    dictionary = od.ObjectDictionary()
    records = {entry.index for entry in defaults if entry.subindex}
    for entry, default in defaults.items():
        variable = od.ODVariable(str(entry), entry.index, entry.subindex)
        variable.data_type, variable.default = kinds[entry.kind], default
        if entry.index not in records:
            dictionary.add_object(variable)
            continue
        if entry.index not in dictionary:
            dictionary.add_object(od.ODRecord(f"0x{entry.index:04X}", entry.index))
        dictionary[entry.index].add_member(variable)
    return dictionary
