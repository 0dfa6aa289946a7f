"""A part of a machine as it serves itself on a bus: it publishes its status and takes commands."""

import math

from parapod.systems.hardware.buses.bus import Bus, Inbox, Problem
from parapod.systems.hardware.buses.message import Layout, Message, Table, is_active
from parapod.systems.hardware.device import DeviceFault, Signals

# Silence of a controller that has given the part up, by the longest admissible one [-].
_GIVEN_UP = 10.0


class ServedPart:
    """One part of a machine on a bus.

    Its status has what is measured, and after it what is commanded, by the names of its signals.
    Commands that do not come in time, or that are wrong, make the part neutral, and it stays so
    until its sender has given it up: by a message that is not `active`, or by silence ten times as
    long as it may be.

    Attributes:
        part: name of the part.
        status: channel of its status.
        layout: signals of its status.
        inbox: commands as they come.
        idle: commands while it is neutral.
        timeout: age from which the newest command is too old [s].
        latched: fault that has made the part neutral, until its sender gives it up; None: none.
        is_neutral: true if the commands last asked for were those of a neutral part.
    """

    def __init__(
        self,
        part: str,
        bus: Bus,
        measures: Table,
        commands: Table,
        timeout: float = 0.1,
    ):
        """Opens its channels.

        Args:
            part: name of the part.
            bus: the bus.
            measures: signals that it measures.
            commands: signals that it takes.
            timeout: age from which the newest command is too old [s].
        """
        self.part, self._bus = part, bus
        self.status, command = bus.address.channels_of(part)
        self.layout = Layout({**measures, **commands}, part)
        bus.advertise(self.status, self.layout)
        self.idle = {name: (signal.idle,) * signal.size for name, signal in commands.items()}
        self.inbox = Inbox(command, Layout(commands, part), math.inf, timeout)
        self.timeout = timeout
        self.latched: Problem | None = None
        self.is_neutral, self._has_begun = True, False
        if commands:
            bus.subscribe(self.inbox)

    def publish(self, signals: Signals, stamp: float) -> None:
        """Publishes the status.

        Args:
            signals: values of what it measures, and of what it is commanded.
            stamp: time of the measurements [s].
        """
        values = self.layout.pack(signals)
        self._bus.publish(self.status, Message(self.layout.names, values, stamp))

    def commands(self, now: float) -> Signals:
        """The newest commands, or those of a neutral part where none count.

        Args:
            now: time of devices [s].
        """
        newest, problem = self.inbox.newest, self.inbox.problem(now)
        if self._bus.stop:
            problem = Problem(DeviceFault.FAILED, self._bus.stop)
        self.is_neutral = True
        if newest is None:
            return self.idle
        if not is_active(newest.message) or now - newest.arrived > _GIVEN_UP * self.timeout:
            self.latched, self._has_begun = None, False
            return self.idle
        if problem is not None and self._has_begun:
            self.latched, self._has_begun = problem, False
        if problem is not None or self.latched is not None:
            return self.idle
        self.is_neutral, self._has_begun = False, True
        return newest.signals
