"""CiA 402 drives of any maker, emulated on a bus: `virtual`, or SLCAN for other processes."""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

from parapod.systems.core.elementwise import clamp
from parapod.systems.core.extras import need
from parapod.systems.hardware.canopen import HEARTBEAT_BASE
from parapod.systems.hardware.cia402.emulated_drive import Cia402Node, EmulatedMotor, MeasuredMotor
from parapod.systems.hardware.cia402.states import DriveState
from parapod.systems.hardware.cia402.switches import SwitchGroup
from parapod.systems.hardware.clock import computer_time, monotonic
from parapod.systems.hardware.emulation.canopen_slave import SlaveLine
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour, is_supplied
from parapod.systems.hardware.emulation.slcan import SlcanPty

# Signal of the emergency stop within its part.
EMERGENCY_STOP = "emergency_stop"
# Mode of a node by the signal with which a machine commands its axes.
_COMMANDS = {
    "velocity_command": "velocity",
    "position_command": "position",
    "force_command": "force",
    "torque_command": "force",
}
# Longest time between two looks at ramps and heartbeats [s].
_TICK = 0.002
# Service data (CiA 301): identifiers of requests, the command that reads, and the objects that say
# how a node communicates.
_REQUESTS, _UPLOAD, _COMMUNICATION_OBJECTS = range(0x600, 0x680), 0x40, range(0x1000, 0x2000)
# Time for which capacitors feed the drives when their supply has been cut [s] (assumption).
_HOLD_UP = 0.02


def _moves_nothing(message: Any) -> bool:
    """True for a frame that reads, or tells how to communicate: a hundred such set up a node."""
    data = message.data
    if message.arbitration_id not in _REQUESTS or len(data) < 4:
        return False
    return data[0] == _UPLOAD or data[1] | data[2] << 8 in _COMMUNICATION_OBJECTS


class Cia402Nodes:
    """Drives between a bus and the wires of one part of a simulated machine.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `<part>.velocity_command` | n | rad/s or m/s | 0 for an axis without power |
    | to the machine `<part>.position_command` | n | rad or m | in its place: see `Cia402Node` |
    | to the machine `<part>.force_command`, `<part>.torque_command` | n | N or N m | ditto |
    | to the machine `<part>.brake` | 1 | - | 1 unless an axis is enabled; if the machine has it |
    | to the machine `<locks>.command` | k | - | of each group of switches; 0: its output is on |
    | from the machine `<part>.position` | n | rad or m | |
    | from the machine `<part>.velocity` | n | rad/s or m/s | |
    | from the machine `<part>.current` | n | A | if the machine has it; not of commanded forces |
    | from the machine `<part>.emergency_stop` | 1 | 0/1 | 1: pressed; if the machine has it |
    | from the machine `<locks>.closed` | k | 0/1 | of each group of switches; 1: voltage |
    | from the machine `supply` | 1 | 0/1 | 0: the motors have none; if the machine has it |

    A pressed emergency stop opens its contact, which otherwise puts voltage to a digital input
    of one node, and cuts the motors' supply of all nodes, not that of their electronics.

    The nodes are on a bus of python-can's interface `virtual`, which this process shares; with
    `link`, an emulated serial adapter brings it to other processes. Entering the context switches
    them on: they count from where the axes are then.

    Nodes that are `off` say nothing but still hear; nodes that are `unplugged` hear nothing
    either, and stop the axes when they miss the master's heartbeat.

    Attributes:
        nodes: the nodes.
        adapter: emulated serial adapter, or None.
        is_stop_wire_broken: true if the wire of the emergency stop's contact is broken.
        broken_wires: switches, as a group's part and a number from 0, whose contact's wire is
            broken.
    """

    def __init__(
        self,
        harness: Harness,
        node_ids: Sequence[int] = (1, 2, 3, 4),
        channel: str = "cia402",
        link: Path | str | None = None,
        misbehaviour: Misbehaviour | None = None,
        motor: EmulatedMotor = EmulatedMotor(),
        part: str = "wheels",
        signs: Sequence[int] = (),
        measures_current: bool = False,
        clock: Callable[[], float] = monotonic,
        stop_contact: tuple[int, int] | None = None,
        hold_up: float = _HOLD_UP,
        switches: Sequence[SwitchGroup] = (),
    ):
        """Prepares the nodes; they answer within a `with` block.

        Args:
            harness: the wires.
            node_ids: addresses, in the order of the axes.
            channel: channel of the interface `virtual`.
            link: path for a symbolic link to the adapter's port; None: no adapter.
            misbehaviour: faults of the devices.
            motor: motor that each of them drives.
            part: part of the machine.
            signs: signs of the motors, in place of the `motor`'s; empty: none.
            measures_current: true if the machine has the wire `current`; else it is zero.
            clock: monotonic [s].
            stop_contact: address of the node, and number of its digital input, at which the
                contact of the emergency stop is; None: nowhere.
            hold_up: time for which the drives are fed when their supply has been cut [s].
            switches: locks and clamps at digital outputs and inputs.
        """
        self._stop_contact, self._hold_up = stop_contact, hold_up
        self._cut_since: float | None = None
        self.is_stop_wire_broken = False
        self._switches = tuple(switches)
        self.broken_wires: set[tuple[str, int]] = set()
        self._harness, self._ids, self.channel = harness, tuple(node_ids), channel
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._clock = clock
        self._motors = [motor._replace(sign=s) for s in signs or (motor.sign,) * len(self._ids)]
        self._part, self._measures_current = part, measures_current
        self.adapter = None if link is None else SlcanPty(channel, link, self._misbehaviour)
        self.nodes: list[Cia402Node] = []
        self._lines: list[SlaveLine] = []
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stopping.clear()
        with ExitStack() as stack:
            bus: Any = need("can").Bus(
                interface="virtual", channel=self.channel, ignore_config=True
            )
            stack.callback(bus.shutdown)
            self._lines = [SlaveLine(bus, self._misbehaviour, self._clock) for _ in self._ids]
            rows = zip(self._ids, self._lines, self._motors, self._get("position"), strict=True)
            self.nodes = [Cia402Node(*parts) for parts in rows]
            self._press(self._clock())
            self._touch()
            self._publish()
            thread = threading.Thread(
                target=self._run, args=(bus,), name="CiA 402 nodes", daemon=True
            )
            thread.start()
            stack.callback(thread.join)
            stack.callback(self._stopping.set)
            if self.adapter is not None:
                stack.enter_context(self.adapter)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def states(self) -> tuple[DriveState, ...]:
        """States of the drives."""
        return tuple(node.state for node in self.nodes)

    def trip(self, node_id: int, code: int) -> None:
        """Makes the drive at an address fail with the code of an error."""
        with self._lock:
            self._node(node_id).trip(code)

    def disconnect(self, node_id: int) -> None:
        """Takes the node at an address off the bus: it hears and says nothing any more."""
        self._lines[self._ids.index(node_id)].is_connected = False

    def _run(self, bus: Any) -> None:
        tick = -math.inf
        while not self._stopping.is_set():
            message = bus.recv(computer_time(clamp(tick - self._clock(), 0.0, _TICK)))
            with self._lock:
                self._measure()
                # All that has come, before anybody misses a heartbeat among it.
                is_due = message is None
                while message is not None:
                    is_due = is_due or not _moves_nothing(message)
                    self._receive(message)
                    message = bus.recv(0.0)
                now = self._clock()
                if not is_due and now < tick:
                    continue
                tick = now + _TICK
                self._press(now)
                self._touch()
                for line, node in zip(self._lines, self.nodes, strict=True):
                    line.step(now)
                    node.step(now)
                self._publish()

    def _receive(self, message: Any) -> None:
        if self._misbehaviour.is_unplugged:
            return
        now = self._clock()
        is_heartbeat = message.arbitration_id >= HEARTBEAT_BASE
        for line, node in zip(self._lines, self.nodes, strict=True):
            if is_heartbeat and line.is_connected:
                node.hear(message.arbitration_id, now)
            # A frame of the wrong length or to an unknown entry: real nodes ignore it, too.
            with suppress(Exception):
                line.receive(message)

    def _press(self, now: float) -> None:
        """Puts to the nodes what the emergency stop does, or a supply that is lost."""
        name = f"{self._part}.{EMERGENCY_STOP}"
        is_pressed = name in self._harness and self._harness.get(name)[0] > 0.5
        if is_supplied(self._harness) and not is_pressed:
            self._cut_since = None
        elif self._cut_since is None:
            self._cut_since = now
        is_fed = self._cut_since is None or now - self._cut_since < self._hold_up
        for node in self.nodes:
            node.supply(is_fed)
        if self._stop_contact is not None:
            node_id, number = self._stop_contact
            is_closed = not (is_pressed or self.is_stop_wire_broken)
            self._node(node_id).connect(number, is_closed)

    def _node(self, node_id: int) -> Cia402Node:
        return self.nodes[self._ids.index(node_id)]

    def _touch(self) -> None:
        """Puts the contacts of switches to the nodes."""
        for group in self._switches:
            closed = self._harness.get(group.measure)
            for i, (node_id, _, number) in enumerate(group.switches):
                is_whole = (group.part, i) not in self.broken_wires
                self._node(node_id).connect(number, is_whole and closed[i] > 0.5)

    def _measure(self) -> None:
        n = len(self.nodes)
        current = self._get("current") if self._measures_current else (0.0,) * n
        true = (*self._get("position"), *self._get("velocity"), *current)
        values = self._misbehaviour.shown(true, self._clock())
        values = tuple(value if math.isfinite(value) else 0.0 for value in values)
        for i, node in enumerate(self.nodes):
            node.measured = MeasuredMotor(*values[i::n])

    def _publish(self) -> None:
        for signal, what in _COMMANDS.items():
            if f"{self._part}.{signal}" in self._harness:
                self._set(signal, [getattr(node, what) for node in self.nodes])
        switching = {node_id for group in self._switches for node_id, *_ in group.switches}
        outputs = {node_id: self._node(node_id).outputs for node_id in switching}
        for group in self._switches:
            are_on = [outputs[node_id][k - 1] for node_id, k, _ in group.switches]
            self._harness.set(group.command, [0.0 if is_on else 1.0 for is_on in are_on])
        is_enabled = any(node.state is DriveState.OPERATION_ENABLED for node in self.nodes)
        if f"{self._part}.brake" in self._harness:
            self._set("brake", [0.0 if is_enabled else 1.0])

    def _get(self, signal: str) -> tuple[float, ...]:
        return self._harness.get(f"{self._part}.{signal}")

    def _set(self, signal: str, values: Sequence[float]) -> None:
        self._harness.set(f"{self._part}.{signal}", values)
