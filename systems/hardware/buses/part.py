"""A part of a machine that another program serves on a bus."""

import math
from collections.abc import Collection

from parapod.systems.core.switching import switched
from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.bus import Bus, Inbox
from parapod.systems.hardware.buses.connection import connect
from parapod.systems.hardware.buses.message import ACTIVE, Layout, Message, Table
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals

# How long a part may take until its first message comes, and the pause between two looks [s].
_PATIENCE, _PAUSE = 1.8, 5e-3
# Number of messages that say that a part is to be neutral, and pause after each [s].
_TIMES, _BETWEEN = 3, 3e-3
# Least time between two commands: LCM's unit [s].
_APART = 1e-6


class BusPart(Device):
    """A part behind a bus, whose other end publishes what it measures and takes commands.

    Commands are one message with all signals and `active`, which is 0 while the outputs are to be
    neutral: before `activate`, after `deactivate`, while a command is not finite or a switch is
    near neither 0 nor 1, and once the controller has fallen silent. The other end must become
    neutral by itself when no message comes any more.

    A measurement is as old as its message: from its arrival on.
    """

    def __init__(
        self,
        part: str,
        address: Address,
        measures: Table,
        commands: Table,
        *,
        fail_safe: Collection[str] = (),
        place: str = "",
        rate: float = 100.0,
        timeout: float = 0.1,
        patience: float = _PATIENCE,
    ):
        """Describes the part; nothing is opened.

        Args:
            part: name of the part.
            address: address of the bus.
            measures: signals that it measures.
            commands: signals that it takes.
            fail_safe: those of the commands that are switches, see `Device`.
            place: address of the bus, for the lock against a second controller.
            rate: messages a second that it publishes, at most [Hz].
            timeout: age from which its newest message is too old [s].
            patience: time for which its first message is waited for [s].
        """
        self.measures = {name: signal.size for name, signal in measures.items()}
        self.commands = {name: signal.size for name, signal in commands.items()}
        self.fail_safe = frozenset(fail_safe)
        self.is_asked = not measures
        self._status, self._command = address.channels_of(part)
        self.place = f"{self._command} at {place}" if commands else ""
        self.name = f"{part} on {self._status if measures else self._command}"
        self._part, self._address, self._rate = part, address, rate
        self._timeout, self._patience = timeout, patience
        self._measured, self._commanded = Layout(measures, part), Layout(commands, part)
        self._names = (*self._commanded.names, ACTIVE)
        self._idle = [float(n.partition("[")[0] in self.fail_safe) for n in self._commanded.names]
        self._bus: Bus | None = None
        self._inbox: Inbox | None = None
        self._is_active, self._sent = False, 0.0

    def configure(self) -> None:
        """Connects, and waits for the first message.

        Raises:
            DeviceError: none comes; tells which channels there are.
        """
        self.close()
        begin = monotonic()
        self._bus = connect(self._address)
        self._inbox = Inbox(self._status, self._measured, self._rate, self._timeout)
        self._inbox.on_taken = self._came
        if self.measures:
            self._bus.subscribe(self._inbox)
            self._await(begin + self._patience)
        self.neutral()

    def _came(self) -> None:
        if self.on_measured is not None:
            self.on_measured()

    def _await(self, end: float) -> None:
        assert self._bus is not None
        assert self._inbox is not None
        self._bus.channels()  # LCM notes from here on what comes
        while self._inbox.newest is None:
            if monotonic() > end:
                bus, inbox = self._bus, self._inbox
                problem = inbox.problem(monotonic())
                words = f"no message on {self._status} in {self._patience:g} s"
                if problem is not None and problem.fault != DeviceFault.SILENT:
                    raise self._error(problem.fault, problem.words)
                there = ", ".join(bus.channels()) or "no channel at all"
                raise self._error(DeviceFault.UNPLUGGED, f"{words}; {bus.name} has {there}")
            sleep(_PAUSE)

    def _error(self, fault: DeviceFault, words: str) -> DeviceError:
        """The error, once the bus is closed: nothing stays open."""
        self.close()
        return DeviceError(self.name, words, fault)

    def activate(self) -> None:
        """Says that the part is controlled from here on."""
        self._is_active = True

    def read(self) -> Signals:
        """See `Device`.

        Raises:
            DeviceError: no message has come in time, or what came was wrong.
        """
        self._insist()
        if not self.measures:
            return {}
        assert self._inbox is not None
        if (problem := self._inbox.problem(monotonic())) is not None:
            raise DeviceError(self.name, problem.words, problem.fault)
        newest = self._inbox.newest
        assert newest is not None
        self.stamp, self.sends_every = newest.arrived, self._inbox.interval
        return newest.signals

    def _insist(self) -> None:
        """Refuses what needs a connection.

        Raises:
            DeviceError: there is none.
        """
        if self._bus is None:
            raise DeviceError(self.name, "not configured", DeviceFault.UNPLUGGED)

    def write(self, commands: Signals) -> None:
        """See `Device`."""
        self._insist()
        values = self._commanded.pack(commands)
        are_sure = all(
            switched(value) is not None for n in self.fail_safe for value in commands[n]
        )
        is_active = self._is_active and are_sure and all(map(math.isfinite, values))
        is_active = is_active and not (self._bus and self._bus.stop)
        self._publish(values if is_active else self._idle, is_active)

    def neutral(self) -> None:
        """See `Device`; said several times, since a bus may lose messages."""
        for _ in range(_TIMES):
            self._publish(self._idle, is_active=False)
            sleep(_BETWEEN)

    def deactivate(self) -> None:
        """See `Device`."""
        self._is_active = False
        self.neutral()

    def _publish(self, values: list[float], is_active: bool) -> None:
        if self._bus is not None and self.commands:
            # No two have one time, by which they could not be told apart.
            self._sent = max(monotonic(), self._sent + _APART)
            message = Message(self._names, [*values, float(is_active)], self._sent)
            self._bus.publish(self._command, message)

    def close(self) -> None:
        """See `Device`."""
        bus, self._bus = self._bus, None
        self._is_active = False
        if bus is not None:
            if self._inbox is not None:
                bus.unsubscribe(self._inbox)
            bus.close()
