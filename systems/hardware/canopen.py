"""CANopen seen from the master: objects, process data, and a bus whose errors name the node.

Source: CiA 301, the communication profile.
"""

import logging
import struct
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import answer_time, awaiting_answer, search_time
from parapod.systems.hardware.device import DeviceError, DeviceFault

# Identifiers of frames; those of a node have its id added.
SYNC_ID, NMT_ID, HEARTBEAT_BASE = 0x080, 0x000, 0x700
# Commands of the network management (NMT).
NMT_START, NMT_PRE_OPERATIONAL = 0x01, 0x80
# Transmission types of process data, and the bit of an identifier that switches them off.
ON_SYNC, ON_ARRIVAL = 1, 255
NOT_VALID = 1 << 31
PDO_COUNT = 4  # in each direction


@dataclass(frozen=True)
class Entry:
    """An entry of the object dictionary.

    Attributes:
        index: index of the object.
        subindex: within the object.
        kind: format for `struct`; CANopen is little-endian.
    """

    index: int
    subindex: int
    kind: str

    @property
    def size(self) -> int:
        """Number of bytes."""
        return struct.calcsize(self.kind)

    @property
    def mapping(self) -> int:
        """Mapping of the entry to a PDO: index, subindex and number of bits (CiA 301)."""
        return self.index << 16 | self.subindex << 8 | 8 * self.size

    def pack(self, value: int) -> bytes:
        """The value as it travels."""
        return struct.pack(self.kind, value)

    def unpack(self, data: bytes) -> int:
        """The value that has travelled.

        Raises:
            struct.error: the wrong number of bytes.
        """
        value: int = struct.unpack(self.kind, data)[0]
        return value

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X}"


# Node id under which this computer sends its heartbeat.
MASTER_ID = 127
HEARTBEAT_CONSUMED = Entry(0x1016, 1, "<I")  # node id << 16 | timeout [ms]
HEARTBEAT_PRODUCED = Entry(0x1017, 0, "<H")  # [ms]; 0: none


def wrapped(value: int, bits: int = 32) -> int:
    """Value of a number after overflow in a signed integer of `bits` bits."""
    half = 1 << bits - 1
    return (value + half) % (1 << bits) - half


@dataclass(frozen=True)
class Pdo:
    """A process data object.

    Attributes:
        base: its identifier on the bus without the node's id.
        communication: index of its communication parameters.
        mapping: index of its mapping parameters.
        transmission: its transmission type.
        entries: objects that it carries.
    """

    base: int
    communication: int
    mapping: int
    transmission: int
    entries: tuple[Entry, ...]

    @cached_property
    def _codec(self) -> struct.Struct:
        return struct.Struct("<" + "".join(entry.kind[-1] for entry in self.entries))

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """The values that a frame carries.

        Raises:
            struct.error: the frame has the wrong length.
        """
        return self._codec.unpack(data)

    def pack(self, *values: int) -> bytes:
        """The frame that carries the values."""
        return self._codec.pack(*values)

    @property
    def size(self) -> int:
        """Number of bytes of the frame."""
        return self._codec.size


def mapping_of(pdos: Sequence[Pdo], node_id: int) -> Iterator[tuple[Entry, int]]:
    """Entries that have a node send and obey these process data, and no others, in order.

    CiA 301 prescribes the order: each is not valid while it is set up.
    """
    used = {pdo.communication for pdo in pdos}
    for first, base in ((0x1400, 0x200), (0x1800, 0x180)):
        for k in range(PDO_COUNT):
            if first + k not in used:  # a drive might send or obey it on its own
                yield Entry(first + k, 1, "<I"), base + 0x100 * k + node_id | NOT_VALID
    for pdo in pdos:
        can_id = pdo.base + node_id
        yield Entry(pdo.communication, 1, "<I"), can_id | NOT_VALID
        yield Entry(pdo.communication, 2, "<B"), pdo.transmission
        yield Entry(pdo.mapping, 0, "<B"), 0
        for number, entry in enumerate(pdo.entries, start=1):
            yield Entry(pdo.mapping, number, "<I"), entry.mapping
        yield Entry(pdo.mapping, 0, "<B"), len(pdo.entries)
        yield Entry(pdo.communication, 1, "<I"), can_id


# The receiving thread looks this often whether it should end [s].
_RECEIVE_CYCLE = 0.05
# Longest time until nodes answer a search [s].
_SEARCH_TIME = 0.1
# Every cycle sends a few frames at most: a bus that does not take one for so long is gone [s].
_SEND_TIMEOUT = 0.05


class BufferedPort:
    """A pyserial port whose single bytes come from what has been read at once.

    python-can's SLCAN interface asks the system for every byte; with the frames of a dozen nodes
    that takes milliseconds of each cycle. Everything else is the port's own.
    """

    __slots__ = ("_buffer", "_port")

    def __init__(self, port: Any):
        """Wraps a port of pyserial that is open."""
        self._port, self._buffer = port, bytearray()

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; fewer if the port's timeout passes meanwhile."""
        if not self._buffer:
            self._buffer += self._port.read(max(size, self._port.in_waiting))
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        return data

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once."""
        return len(self._buffer) or self._port.in_waiting

    def reset_input_buffer(self) -> None:
        """Forgets what has come and not been read."""
        self._buffer.clear()
        self._port.reset_input_buffer()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__slots__:
            object.__setattr__(self, name, value)
        else:
            setattr(self._port, name, value)


class CanopenBus:
    """A bus that one thread commands while another receives.

    What canopen has is used for service data, network management and emergencies. The receiving
    thread is not python-can's notifier: that one dies of the first damaged line of a serial
    adapter, silently.

    Attributes:
        sdo_timeout: longest wait for the answer to a service data request [s].
    """

    def __init__(self, name: str, node_ids: Sequence[int], sdo_timeout: float):
        """Prepares a bus.

        Args:
            name: name in errors.
            node_ids: node ids that are used.
            sdo_timeout: longest wait for the answer to a service data request [s].
        """
        self._name, self.sdo_timeout = name, sdo_timeout
        self._inbox = _Inbox()
        self._closing = threading.Event()
        self._broken: Exception | None = None
        self._can = need("can")
        canopen = need("canopen")
        # Its errors come as exceptions; without a handler it would print them besides.
        logging.getLogger("canopen").addHandler(logging.NullHandler())
        self._aborted = canopen.SdoAbortedError
        self._network = canopen.Network()
        self._network.send_message = self.send
        self._nodes = {i: self._network.add_node(i, canopen.ObjectDictionary()) for i in node_ids}
        self._bus: Any = None
        self._thread: threading.Thread | None = None

    def open(self, options: Mapping[str, Any]) -> None:
        """Opens the bus with these arguments of `can.Bus`.

        Raises:
            DeviceError: there is none.
        """
        try:
            # Without the user's configuration files: what is opened is what was asked for.
            self._bus = self._can.Bus(ignore_config=True, **options)
            if hasattr(self._bus, "serialPortOrig"):
                self._bus.serialPortOrig = BufferedPort(self._bus.serialPortOrig)
                # Bytes wake it at once all the same; python-can would look a thousand times a
                # second.
                self._bus.serialPortOrig.timeout = _RECEIVE_CYCLE
        except (self._can.CanError, OSError, ValueError) as error:
            raise unplugged(self._name, error) from error
        name = f"receive {self._name}"
        self._thread = threading.Thread(target=self._receive, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the connection; never raises."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(10.0 * _RECEIVE_CYCLE)
        bus, self._bus = self._bus, None
        if bus is None:
            return
        with suppress(Exception):
            bus.shutdown()
        # An SLCAN bus whose adapter is gone fails to say goodbye and leaves the port open.
        with suppress(Exception):
            bus.serialPortOrig.close()

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Sends a frame.

        Raises:
            DeviceError: the bus is gone.
        """
        if self._broken is not None or self._bus is None:
            raise unplugged(self._name, self._broken)
        message = self._can.Message(
            arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote
        )
        try:
            self._bus.send(message, timeout=answer_time(_SEND_TIMEOUT))
        except (self._can.CanError, OSError) as error:
            raise unplugged(self._name, error) from error

    def get(self, node_id: int, entry: Entry) -> int:
        """The value of an entry of a node's object dictionary.

        Raises:
            DeviceError: it does not answer, or refuses.
        """
        with self._service(node_id, f"read {entry}") as sdo:
            return entry.unpack(sdo.upload(entry.index, entry.subindex))

    def set(self, node_id: int, entry: Entry, value: int) -> None:
        """Writes an entry of a node's object dictionary.

        Raises:
            DeviceError: it does not answer, or refuses.
        """
        with self._service(node_id, f"set {entry} to {value}") as sdo:
            sdo.download(entry.index, entry.subindex, entry.pack(value))

    def beat(self) -> None:
        """Sends this computer's heartbeat."""
        self.send(HEARTBEAT_BASE + MASTER_ID, b"\x05")  # operational

    def guard(self, node_id: int, timeout: float) -> None:
        """Has a node react when this computer falls silent for so long [s]; 0: no more."""
        whose = MASTER_ID << 16 | round(1e3 * timeout)
        self.set(node_id, HEARTBEAT_CONSUMED, whose if timeout else 0)

    def carry(self, node_id: int, pdos: Sequence[Pdo]) -> None:
        """Has a node send and obey these process data, and nothing else, also no heartbeat."""
        self.set(node_id, HEARTBEAT_PRODUCED, 0)
        for entry, value in mapping_of(pdos, node_id):
            self.set(node_id, entry, value)

    def command(self, node_id: int, pdo: Pdo, *values: int) -> None:
        """Sends a node process data; nothing confirms them."""
        self.send(pdo.base + node_id, pdo.pack(*values))

    def manage(self, node_id: int, command: int) -> None:
        """Sends a node a command of the network management (NMT)."""
        self.send(NMT_ID, bytes((command, node_id)))

    def listen(self, can_ids: Collection[int]) -> None:
        """Has frames with these identifiers collected by `synchronise`."""
        for can_id in can_ids:
            self._network.subscribe(can_id, self._inbox.put)

    def synchronise(self, expected: Collection[int], timeout: float) -> dict[int, bytes]:
        """Sends SYNC and waits for the frames that answer it.

        Args:
            expected: their identifiers.
            timeout: longest wait for them [s].

        Returns:
            The frames that have come in time, by identifier.

        Raises:
            DeviceError: the bus is gone.
        """
        self._inbox.expect(expected)
        self.send(SYNC_ID, b"")
        with awaiting_answer(timeout) as longest:
            frames = self._inbox.wait(longest)
        if self._broken is not None:
            raise unplugged(self._name, self._broken)
        return frames

    def emergency(self, node_id: int) -> int | None:
        """Code of the newest emergency that a node has sent and not taken back."""
        active = self._nodes[node_id].emcy.active
        return active[-1].code if active else None

    def answering(self) -> list[int]:
        """Ids of the nodes that are on the bus."""
        with suppress(DeviceError):
            self._network.scanner.search()
            time.sleep(search_time(_SEARCH_TIME))
        return sorted(self._network.scanner.nodes)

    @contextmanager
    def _service(self, node_id: int, what: str) -> Iterator[Any]:
        """Yields a node's service data, whose answers have their time from now on.

        Raises:
            DeviceError: it does not answer, or refuses; names the node.
        """
        sdo = self._nodes[node_id].sdo
        try:
            with awaiting_answer(self.sdo_timeout) as sdo.RESPONSE_TIMEOUT:
                yield sdo
        except DeviceError:
            raise
        except Exception as error:
            if self._broken is not None:
                raise unplugged(self._name, self._broken) from error
            is_refusal = isinstance(error, self._aborted)
            raise service_error(self._name, node_id, what, error, is_refusal) from error

    def _receive(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_RECEIVE_CYCLE)
            except Exception as error:
                if _is_damaged_line(error):
                    with suppress(Exception):
                        self._bus.flush()
                    continue
                self._broken = error
                self._inbox.give_up()
                return
            if message is None or message.is_error_frame or message.is_remote_frame:
                continue
            # canopen unpacks service data and emergencies of any length.
            with suppress(struct.error):
                self._network.notify(message.arbitration_id, message.data, message.timestamp)


def service_error(
    name: str, node_id: int, what: str, error: Exception, is_refusal: bool
) -> DeviceError:
    """Error of a request, as "read 0x6041:00", that a node refuses, garbles or does not answer."""
    if is_refusal:
        return DeviceError(name, f"node {node_id} refuses to {what}: {error}")
    if isinstance(error, struct.error):
        return DeviceError(name, f"node {node_id}: {what}: {error}", DeviceFault.CORRUPT)
    text = f"node {node_id} does not answer ({what}: {error})"
    return DeviceError(name, text, DeviceFault.SILENT)


def unplugged(name: str, error: Exception | None) -> DeviceError:
    """Error of a bus of this name that is gone by an error of its library; None: not open."""
    text = "not open" if error is None else f"{type(error).__name__}: {error}"
    return DeviceError(name, f"no bus: {text}", DeviceFault.UNPLUGGED)


def _is_damaged_line(error: Exception) -> bool:
    """Whether an error is what python-can makes of a damaged line of a serial adapter."""
    return isinstance(error, ValueError | IndexError) or isinstance(error.__cause__, ValueError)


class _Inbox:
    """The newest frames, and whether all that are waited for have come."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._complete = threading.Event()
        self._missing: set[int] = set()
        self._frames: dict[int, bytes] = {}

    def expect(self, can_ids: Collection[int]) -> None:
        with self._lock:
            self._missing, self._frames = set(can_ids), {}
            self._complete.clear()

    def put(self, can_id: int, data: bytes, _timestamp: float) -> None:
        with self._lock:
            self._frames[can_id] = bytes(data)
            self._missing.discard(can_id)
            if not self._missing:
                self._complete.set()

    def give_up(self) -> None:
        self._complete.set()

    def wait(self, timeout: float) -> dict[int, bytes]:
        self._complete.wait(timeout)
        with self._lock:
            return self._frames
