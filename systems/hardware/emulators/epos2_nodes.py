"""The levelling platform's wheel drives, emulated on a bus: `virtual`, or SLCAN for others."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

from parapod.systems.hardware.ds402 import DriveState
from parapod.systems.hardware.emulators.canopen_slave import SlaveLine
from parapod.systems.hardware.emulators.epos2_node import EmulatedMotor, Epos2Node
from parapod.systems.hardware.emulators.harness import Harness
from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour
from parapod.systems.hardware.emulators.slcan_pty import SlcanPty
from parapod.systems.hardware.extras import need

VELOCITY_COMMAND, BRAKE = "wheels.velocity_command", "wheels.brake"
POSITION, VELOCITY = "wheels.position", "wheels.velocity"

# Longest time between two looks at ramps and heartbeats [s].
_TICK = 0.002


class Epos2Nodes:
    """EPOS2 controllers between a bus and the wires of a simulated machine.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `wheels.velocity_command` | n | rad/s | 0 for a wheel that is not enabled |
    | to the machine `wheels.brake` | 1 | - | 1 unless a wheel is enabled |
    | from the machine `wheels.position` | n | rad | |
    | from the machine `wheels.velocity` | n | rad/s | |

    The nodes are on a bus of python-can's interface `virtual`, which this process shares; with
    `link`, an emulated serial adapter brings it to other processes.

    Nodes that are `off` say nothing but still hear; nodes that are `unplugged` hear nothing
    either, and stop the wheels when they miss the master's heartbeat.
    """

    def __init__(
        self,
        harness: Harness,
        node_ids: Sequence[int] = (1, 2, 3, 4),
        channel: str = "epos2",
        link: Path | str | None = None,
        misbehaviour: Misbehaviour | None = None,
        motor: EmulatedMotor = EmulatedMotor(),
        clock: Callable[[], float] = time.monotonic,
    ):
        """Prepares the nodes; they answer within a `with` block.

        Args:
            harness: the wires.
            node_ids: addresses, in the order of the wheels.
            channel: of the interface `virtual`.
            link: where to put a symbolic link to the adapter's port; None: no adapter.
            misbehaviour: what they do wrong.
            motor: that each of them drives.
            clock: monotonic [s].
        """
        self._harness, self._ids, self.channel = harness, tuple(node_ids), channel
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._motor, self._clock = motor, clock
        self.adapter = None if link is None else SlcanPty(channel, link, self._misbehaviour)
        self.nodes: list[Epos2Node] = []
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
            line = SlaveLine(bus, self._misbehaviour, self._clock)
            self.nodes = [Epos2Node(i, line, self._motor) for i in self._ids]
            self._publish()
            thread = threading.Thread(
                target=self._run, args=(bus, line), name="EPOS2 nodes", daemon=True
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
        """Makes a drive fail.

        Args:
            node_id: its address.
            code: of the error.
        """
        with self._lock:
            self.nodes[self._ids.index(node_id)].trip(code)

    def _run(self, bus: Any, line: SlaveLine) -> None:
        while not self._stopping.is_set():
            message = bus.recv(_TICK)
            with self._lock:
                self._measure()
                # All that has come, before anybody misses a heartbeat among it.
                while message is not None:
                    self._receive(line, message)
                    message = bus.recv(0.0)
                now = self._clock()
                line.step(now)
                for node in self.nodes:
                    node.step(now)
                self._publish()

    def _receive(self, line: SlaveLine, message: Any) -> None:
        if self._misbehaviour.is_unplugged:
            return
        now = self._clock()
        for node in self.nodes:
            node.hear(message.arbitration_id, now)
        # A frame of the wrong length or to an unknown entry: real nodes ignore it, too.
        with suppress(Exception):
            line.receive(message)

    def _measure(self) -> None:
        n = len(self.nodes)
        true = (*self._harness.get(POSITION), *self._harness.get(VELOCITY))
        shown = self._misbehaviour.shown(true, self._clock())
        shown = tuple(value if math.isfinite(value) else 0.0 for value in shown)
        for node, position, velocity in zip(self.nodes, shown[:n], shown[n:], strict=True):
            node.measured = position, velocity

    def _publish(self) -> None:
        self._harness.set(VELOCITY_COMMAND, [node.velocity for node in self.nodes])
        is_enabled = any(node.state is DriveState.OPERATION_ENABLED for node in self.nodes)
        self._harness.set(BRAKE, [0.0 if is_enabled else 1.0])
