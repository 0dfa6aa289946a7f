"""A controller in another program, in the place of a machine's own."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, InputPort, State

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read
from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.bus import Bus, Inbox
from parapod.systems.hardware.buses.connection import connect as open_bus
from parapod.systems.hardware.buses.message import Layout, Message, Signal, Table
from parapod.systems.hardware.buses.served_part import ServedPart
from parapod.systems.hardware.clock import monotonic, sleep

type Values = Mapping[str, Sequence[float]]

# Parts on the bus beside those of the machine: the station as a whole, the controller, the job.
STATION, CONTROLLER, JOB = "station", "controller", "job"
# Signal of a part that tells whether its emergency stop is pressed.
EMERGENCY_STOP = "emergency_stop"
# Part of the machine's signals that tells how its devices are; it is told with the station.
_DEVICES = "status."
# Signals of the station as a whole: numbers of parts that are neutral, and latched.
_COUNTS = {"neutral": Signal(1), "latched": Signal(1)}
# Longest wait for the first commands, and pause between two looks for some [s].
_BEGINNING, _PAUSE = 2.0, 2e-4


class BusController(LeafSystem):
    """A controller behind a bus: publishes what its machine measures, and takes commands.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `neutral` | 1 | - | number of parts that are neutral for want of commands |

    Besides, one input for each measurement of the machine and each signal of its job, and one
    output for each command and each further signal of the controller, by the names of their ports.

    Each part of the machine is a `ServedPart`. The channel of the station comes last at each
    instant: a controller that answers it has all measurements of that instant. Other signals of
    the controller than commands may be published on a channel of its own, for experiments that
    record them; until then they are NaN.

    With `patience` every instant waits for commands that were sent after its measurements, so that
    a simulation goes on as fast as the controller answers; without, the newest commands count. A
    controller that has been waited for in vain is not waited for again before it answers.

    State: discrete, every output's value, in a periodic unrestricted update. The bus is opened at
    the first instant, and kept beside the Context.

    Bad input: measurements are published as they are.
    """

    def __init__(
        self,
        address: Address,
        measures: Table,
        commands: Table,
        job: Table | None = None,
        signals: Table | None = None,
        period: float = 0.01,
        timeout: float = 0.1,
        patience: float = 0.0,
    ):
        """Creates the system.

        Args:
            address: address of the bus.
            measures: measurements of the machine.
            commands: commands to the machine.
            job: signals of the job that the controller may follow.
            signals: further signals of the controller.
            period: period of the controller [s].
            timeout: age from which commands are too old [s].
            patience: longest wait for commands at an instant, and age from which they are too
                old where that is longer [s]; 0: none.
        """
        super().__init__()
        self.set_name("bus_controller")
        self._patience, self._commands = patience, tuple(commands)

        def connect() -> ServedStation:
            return ServedStation(
                *(open_bus(address), measures, commands, job or {}, signals or {}),
                timeout=max(timeout, patience),
            )

        self._connect = connect
        self._station: ServedStation | None = None
        self._ports: dict[str, InputPort] = {
            name: self.DeclareVectorInputPort(name, signal.size)
            for name, signal in {**measures, **(job or {})}.items()
        }
        first = {name: np.full(signal.size, signal.idle) for name, signal in commands.items()}
        first |= {name: np.full(other.size, math.nan) for name, other in (signals or {}).items()}
        self._groups: dict[str, int] = {}
        for name, values in (first | {"neutral": np.zeros(1)}).items():
            group = self.DeclareDiscreteState(values)
            self._groups[name] = int(group)
            self.DeclareStateOutputPort(name, group)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    @property
    def station(self) -> "ServedStation":
        """The machine on the bus, which is opened when it is first asked for.

        Raises:
            DeviceError: the bus cannot be opened.
        """
        if self._station is None:
            self._station = self._connect()
        return self._station

    def close(self) -> None:
        """Ends the connection; another instant opens a new one."""
        station, self._station = self._station, None
        if station is not None:
            station.bus.close()

    def _update(self, context: Context, state: State) -> None:
        discrete, present = state.get_mutable_discrete_state(), context.get_discrete_state()
        values = {name: read(port, context) for name, port in self._ports.items()}
        for name in self._commands:
            values[name] = present.get_vector(self._groups[name]).value().tolist()
        self.station.publish(values, context.get_time())
        if self._patience:
            self.station.wait(self._patience)
        for name, latest in self.station.outputs().items():
            discrete.set_value(self._groups[name], np.array(latest))


class _Channel(NamedTuple):
    """A channel on which something is published, and the ports whose values are in it."""

    name: str
    layout: Layout
    ports: Sequence[str]


class ServedStation:
    """A whole machine on an open bus.

    Attributes:
        bus: the bus.
        parts: parts of the machine.
    """

    def __init__(
        self,
        bus: Bus,
        measures: Table,
        commands: Table,
        job: Table,
        signals: Table,
        timeout: float,
    ):
        """Opens the channels; see `BusController`."""
        self.bus = bus
        own = {name: each for name, each in measures.items() if not name.startswith(_DEVICES)}
        devices = {
            name.removeprefix(_DEVICES): each for name, each in measures.items() if name not in own
        }
        names = dict.fromkeys(name.partition(".")[0] for name in (*own, *commands))
        self.parts = [
            ServedPart(part, bus, _within(part, own), _within(part, commands), timeout)
            for part in names
        ]
        self._published = monotonic()
        of_job = _Channel(bus.address.channels_of(JOB).status, Layout(job, JOB), tuple(job))
        of_station = _Channel(
            bus.address.channels_of(STATION).status,
            Layout(_COUNTS | devices, STATION),
            (*_COUNTS, *(f"{_DEVICES}{name}" for name in devices)),
        )
        others = [each for each in (of_job, of_station) if each.ports]
        for each in others:
            bus.advertise(each.name, each.layout)
        # The station's is the last of an instant.
        self._channels = [
            *(
                _Channel(p.status, p.layout, tuple(f"{p.part}.{n}" for n in p.layout.signals))
                for p in self.parts
            ),
            *others,
        ]
        self._stops = [n for n in measures if n.endswith(f".{EMERGENCY_STOP}")]
        channel = bus.address.channels_of(CONTROLLER).status
        self._signals = {
            name: Inbox(channel, Layout({name: signal}), math.inf, math.inf)
            for name, signal in signals.items()
        }
        for inbox in self._signals.values():
            bus.subscribe(inbox)
        self._has_heard = self._is_silent = False

    @property
    def published(self) -> dict[str, Table]:
        """Signals that are published, by channel."""
        return {channel.name: channel.layout.signals for channel in self._channels}

    @property
    def taken(self) -> dict[str, Layout]:
        """Commands that are taken, by channel."""
        inboxes = [part.inbox for part in self.parts]
        return {inbox.channel: inbox.layout for inbox in inboxes if inbox.layout.signals}

    def publish(self, values: Values, time: float) -> None:
        """Publishes an instant.

        Args:
            values: measurements, commands that are obeyed, and signals of the job.
            time: time of the instant [s].
        """
        self._published = monotonic()
        latched = sum(part.latched is not None for part in self.parts)
        instant = {**values, "neutral": self._neutral, "latched": (float(latched),)}
        for name, layout, ports in self._channels:
            packed = [value for port in ports for value in instant[port]]
            self.bus.publish(name, Message(layout.names, packed, time))
        self.bus.tell(time, any(value > 0.5 for name in self._stops for value in values[name]))

    def wait(self, patience: float) -> None:
        """Waits for commands that came after the last instant, of the parts that have had some.

        Args:
            patience: longest wait, once there have been commands [s].

        Raises:
            ParapodError: there have never been any.
        """
        inboxes, since = [part.inbox for part in self.parts], self._published
        if self._is_silent:
            patience = _PAUSE
        end = since + (patience if self._has_heard else _BEGINNING)
        if not self._has_heard:
            self.bus.channels()  # LCM notes from here on what comes
        while monotonic() < end:
            newest = [inbox.newest for inbox in inboxes if inbox.newest is not None]
            if newest and all(each.arrived >= since for each in newest):
                self._has_heard, self._is_silent = True, False
                return
            sleep(_PAUSE)
        self._is_silent = True
        if not self._has_heard:
            there = ", ".join(self.bus.channels()) or "no channel"
            wrong = [
                p.words for p in (i.problem(monotonic()) for i in inboxes if i.layout.signals) if p
            ]
            raise ParapodError(
                f"no commands in {_BEGINNING:g} s: {'; '.join(wrong)}; others publish {there} on "
                f"{self.bus.name}"
            )

    def outputs(self) -> dict[str, tuple[float, ...]]:
        """The newest commands by the names of their ports, and further signals that came."""
        now, outputs = monotonic(), {}
        for part in self.parts:
            for name, values in part.commands(now).items():
                outputs[f"{part.part}.{name}"] = tuple(values)
        for name, inbox in self._signals.items():
            if inbox.newest is not None:
                outputs[name] = inbox.newest.signals[name]
        return outputs | {"neutral": self._neutral}

    @property
    def _neutral(self) -> tuple[float]:
        """Number of parts that are neutral, of those that take commands."""
        return (float(sum(part.is_neutral for part in self.parts if part.inbox.layout.signals)),)


def _within(part: str, signals: Table) -> Table:
    """Signals of a part, by their names within it."""
    start = f"{part}."
    return {n.removeprefix(start): each for n, each in signals.items() if n.startswith(start)}
