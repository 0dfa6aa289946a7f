"""EtherCAT with CANopen's objects (CoE), behind what `CanopenBus` offers to a controller.

**Not tested on a wire**: proved with a fake of pysoem's master only. Source: ETG.1000.6 (process
data assignment 0x1C12 and 0x1C13, states), and pysoem's documentation.
"""

import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.canopen import NMT_START, Entry, Pdo, service_error, unplugged
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.device import DeviceError, DeviceFault

# Mapping of all process data of one direction, and the object that assigns it: received, sent.
_RECEIVED, _SENT = (0x1600, 0x1C12), (0x1A00, 0x1C13)
# Longest time until all slaves are operational [s], and pause between two looks [s].
_STARTING, _LOOK = 3.0, 0.002
_MICROSECONDS = 1e6


class EthercatBus:
    """A ring of slaves whose process data one thread exchanges.

    A node's address is its place on the ring, from 1. What a node obeys is one image: it has it
    again with every exchange, so an entry of it is written there, and not by service data. A
    silence of this computer is noticed by the slaves' watchdog of process data, and no heartbeat.

    Attributes:
        sdo_timeout: longest wait for the answer to a service data request [s].
    """

    def __init__(
        self,
        name: str,
        node_ids: Sequence[int],
        sdo_timeout: float,
        clock: Callable[[], float] = monotonic,
    ):
        """Prepares a bus.

        Args:
            name: name in errors.
            node_ids: places on the ring that are used.
            sdo_timeout: longest wait for the answer to a service data request [s].
            clock: monotonic [s].
        """
        self._name, self._ids, self.sdo_timeout, self._clock = name, node_ids, sdo_timeout, clock
        self._soem = need("pysoem")
        self._master: Any = None
        self._is_operational = False
        # By node: values of what it obeys, its reports, and code of its newest emergency.
        self._images: dict[int, dict[Entry, int]] = {}
        self._reports: dict[int, list[Pdo]] = {}
        self._codes: dict[int, int] = {}

    def open(self, options: Mapping[str, Any]) -> None:
        """Opens the network interface that is the option `channel`, and looks for slaves.

        Raises:
            DeviceError: the interface is missing, or may not be used; or it has too few slaves.
        """
        self._master = self._soem.Master()
        try:
            self._master.open(options["channel"])
            count = self._master.config_init()
        except (OSError, self._soem.PacketError, self._soem.WkcError) as error:
            raise unplugged(self._name, error) from error
        if count < max(self._ids):
            text = f"{max(count, 0)} slaves on the ring, and node {max(self._ids)} is wanted"
            raise DeviceError(self._name, text, DeviceFault.SILENT)
        for node_id in self._ids:
            self._slave(node_id).add_emergency_callback(partial(self._note, node_id))

    def close(self) -> None:
        """Ends the connection; never raises."""
        master, self._master = self._master, None
        if master is None:
            return
        with suppress(Exception):
            master.state = self._soem.INIT_STATE
            master.write_state()
        with suppress(Exception):
            master.close()

    def get(self, node_id: int, entry: Entry) -> int:
        """The value of an entry of a node's object dictionary.

        Raises:
            DeviceError: it does not answer, or refuses.
        """
        with self._service(node_id, f"read {entry}") as slave:
            return entry.unpack(slave.sdo_read(entry.index, entry.subindex))

    def set(self, node_id: int, entry: Entry, value: int) -> None:
        """Writes an entry of a node's object dictionary.

        Raises:
            DeviceError: it does not answer, or refuses.
        """
        image = self._images.get(node_id, {})
        if entry in image:
            image[entry] = value
        if self._is_operational and entry in image:
            self._exchange()
            return
        with self._service(node_id, f"set {entry} to {value}") as slave:
            slave.sdo_write(entry.index, entry.subindex, entry.pack(value))

    def beat(self) -> None:
        """Exchanges process data, which keeps the slaves' watchdogs quiet."""
        if self._is_operational:
            self._exchange()

    def guard(self, node_id: int, timeout: float) -> None:
        """Has a node react when no process data come for so long [s]; 0: no more."""
        with self._service(node_id, "guard process data") as slave:
            slave.set_watchdog("processdata", 1e3 * timeout)

    def carry(self, node_id: int, pdos: Sequence[Pdo]) -> None:
        """Has a node obey and send these process data, all of one direction in one object."""
        obeyed = [pdo for pdo in pdos if pdo.mapping < _SENT[0]]
        self._reports[node_id] = reports = [pdo for pdo in pdos if pdo.mapping >= _SENT[0]]
        entries = list(dict.fromkeys(entry for pdo in obeyed for entry in pdo.entries))
        sent = [entry for pdo in reports for entry in pdo.entries]
        for (mapping, assignment), carried in ((_RECEIVED, entries), (_SENT, sent)):
            self.set(node_id, Entry(assignment, 0, "<B"), 0)
            self.set(node_id, Entry(mapping, 0, "<B"), 0)
            for number, entry in enumerate(carried, start=1):
                self.set(node_id, Entry(mapping, number, "<I"), entry.mapping)
            self.set(node_id, Entry(mapping, 0, "<B"), len(carried))
            self.set(node_id, Entry(assignment, 1, "<H"), mapping)
            self.set(node_id, Entry(assignment, 0, "<B"), 1)
        self._images[node_id] = {entry: self.get(node_id, entry) for entry in entries}

    def command(self, node_id: int, pdo: Pdo, *values: int) -> None:
        """Gives a node process data.

        Raises:
            DeviceError: the bus is gone.
        """
        self._images[node_id].update(zip(pdo.entries, values, strict=True))
        self.beat()

    def manage(self, node_id: int, command: int) -> None:
        """Has a node leave the exchange of process data for being set up, or join it again.

        Those that are set up join it together, when the first one is wanted.
        """
        if command != NMT_START:
            self._is_operational = False
            self._slave(node_id).state = self._soem.PREOP_STATE
            self._slave(node_id).write_state()

    def listen(self, can_ids: Collection[int]) -> None:
        """Nothing has to be said: all slaves answer each exchange."""

    def synchronise(self, expected: Collection[int], timeout: float) -> dict[int, bytes]:
        """Exchanges process data: see `CanopenBus.synchronise`.

        Raises:
            DeviceError: the bus is gone, or slaves do not become operational.
        """
        if not self._is_operational:
            self._start()
        silent = [] if self._exchange(timeout) else self._lagging(self._soem.OP_STATE)
        frames: dict[int, bytes] = {}
        for node_id, pdos in self._reports.items():
            data = b"" if node_id in silent else bytes(self._slave(node_id).input)
            for pdo in pdos if data else ():
                frames[pdo.base + node_id], data = data[: pdo.size], data[pdo.size :]
        return {can_id: frame for can_id, frame in frames.items() if can_id in expected}

    def emergency(self, node_id: int) -> int | None:
        """Code of the newest emergency that a node has sent and not taken back."""
        return self._codes.get(node_id) or None

    def answering(self) -> list[int]:
        """Places of the slaves on the ring."""
        return [] if self._master is None else list(range(1, len(self._master.slaves) + 1))

    def _start(self) -> None:
        """Leads all slaves to the exchange of process data.

        Raises:
            DeviceError: one stays behind.
        """
        master, soem = self._opened(), self._soem
        try:
            master.config_map()
        except soem.ConfigMapError as error:
            raise DeviceError(self._name, f"process data are refused: {error}") from error
        for state in (soem.SAFEOP_STATE, soem.OP_STATE):
            master.state = state
            master.write_state()
            deadline = self._clock() + _STARTING
            while late := self._lagging(state):
                self._exchange()  # they become operational only with outputs
                if self._clock() > deadline:
                    codes = ", ".join(
                        f"node {i} (AL status 0x{self._slave(i).al_status:04X})" for i in late
                    )
                    text = f"not ready for process data: {codes}"
                    raise DeviceError(self._name, text, DeviceFault.SILENT)
                sleep(_LOOK)
        self._is_operational = True

    def _lagging(self, state: int) -> list[int]:
        """Nodes that are not in a state yet."""
        self._master.read_state()
        return [i for i in self._ids if self._slave(i).state & 0x0F < state]

    def _exchange(self, timeout: float = 0.01) -> bool:
        """Sends what all nodes are to obey and takes what they send; false: some did not."""
        master = self._opened()
        for node_id, image in self._images.items():
            parts = (entry.pack(value) for entry, value in image.items())
            self._slave(node_id).output = b"".join(parts)
        master.send_processdata()
        answers = master.receive_processdata(round(_MICROSECONDS * timeout))
        return bool(answers >= master.expected_wkc)

    def _opened(self) -> Any:
        if self._master is None:
            raise unplugged(self._name, None)
        return self._master

    def _slave(self, node_id: int) -> Any:
        return self._opened().slaves[node_id - 1]

    def _note(self, node_id: int, emergency: Any) -> None:
        """Keeps the code of an emergency; 0 takes it back."""
        self._codes[node_id] = emergency.error_code

    @contextmanager
    def _service(self, node_id: int, what: str) -> Iterator[Any]:
        """Yields a slave for service data, whose errors name it.

        Raises:
            DeviceError: it does not answer, or refuses.
        """
        soem, slave = self._soem, self._slave(node_id)
        timeout = round(_MICROSECONDS * self.sdo_timeout)
        self._master.sdo_read_timeout = self._master.sdo_write_timeout = timeout
        silences = (soem.MailboxError, soem.PacketError, soem.WkcError)
        try:
            yield slave
        except (soem.SdoError, struct.error, *silences) as error:
            is_refusal = isinstance(error, soem.SdoError)
            raise service_error(self._name, node_id, what, error, is_refusal) from error
