"""Drives on EPOS2 controllers, emulated on a bus: `virtual`, or SLCAN for others."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

from parapod.systems.hardware.ds402 import DriveState
from parapod.systems.hardware.emulators.canopen_slave import SlaveLine
from parapod.systems.hardware.emulators.epos2_node import (
    EmulatedMotor,
    Epos2Node,
    MeasuredMotor,
)
from parapod.systems.hardware.emulators.harness import Harness
from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour
from parapod.systems.hardware.emulators.slcan_pty import SlcanPty
from parapod.systems.hardware.extras import need

# Longest time between two looks at ramps and heartbeats [s].
_TICK = 0.002


class Epos2Nodes:
    """EPOS2 controllers between a bus and the wires of one part of a simulated machine.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `<part>.velocity_command` | n | rad/s or m/s | 0 for an axis without power |
    | to the machine `<part>.brake` | 1 | - | 1 unless an axis is enabled |
    | from the machine `<part>.position` | n | rad or m | |
    | from the machine `<part>.velocity` | n | rad/s or m/s | |
    | from the machine `<part>.current` | n | A | if the machine has it |

    The nodes are on a bus of python-can's interface `virtual`, which this process shares; with
    `link`, an emulated serial adapter brings it to other processes. Entering the context switches
    them on: they count from where the axes are then.

    Nodes that are `off` say nothing but still hear; nodes that are `unplugged` hear nothing
    either, and stop the axes when they miss the master's heartbeat.
    """

    def __init__(
        self,
        harness: Harness,
        node_ids: Sequence[int] = (1, 2, 3, 4),
        channel: str = "epos2",
        link: Path | str | None = None,
        misbehaviour: Misbehaviour | None = None,
        motor: EmulatedMotor = EmulatedMotor(),
        part: str = "wheels",
        signs: Sequence[int] = (),
        measures_current: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ):
        """Prepares the nodes; they answer within a `with` block.

        Args:
            harness: the wires.
            node_ids: addresses, in the order of the axes.
            channel: of the interface `virtual`.
            link: where to put a symbolic link to the adapter's port; None: no adapter.
            misbehaviour: what they do wrong.
            motor: that each of them drives.
            part: of the machine.
            signs: of the motors, in place of the `motor`'s; empty: none.
            measures_current: whether the machine has the wire `current`; else it is zero.
            clock: monotonic [s].
        """
        self._harness, self._ids, self.channel = harness, tuple(node_ids), channel
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._clock = clock
        self._motors = [motor._replace(sign=s) for s in signs or (motor.sign,) * len(self._ids)]
        self._part, self._measures_current = part, measures_current
        self.adapter = None if link is None else SlcanPty(channel, link, self._misbehaviour)
        self.nodes: list[Epos2Node] = []
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
            made = zip(self._ids, self._lines, self._motors, self._get("position"), strict=True)
            self.nodes = [Epos2Node(*parts) for parts in made]
            self._publish()
            thread = threading.Thread(
                target=self._run, args=(bus,), name="EPOS2 nodes", daemon=True
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

    def disconnect(self, node_id: int) -> None:
        """Takes a node off the bus: it hears and says nothing any more.

        Args:
            node_id: its address.
        """
        self._lines[self._ids.index(node_id)].is_connected = False

    def _run(self, bus: Any) -> None:
        while not self._stopping.is_set():
            message = bus.recv(_TICK)
            with self._lock:
                self._measure()
                # All that has come, before anybody misses a heartbeat among it.
                while message is not None:
                    self._receive(message)
                    message = bus.recv(0.0)
                now = self._clock()
                for line, node in zip(self._lines, self.nodes, strict=True):
                    line.step(now)
                    node.step(now)
                self._publish()

    def _receive(self, message: Any) -> None:
        if self._misbehaviour.is_unplugged:
            return
        now = self._clock()
        for line, node in zip(self._lines, self.nodes, strict=True):
            if line.is_connected:
                node.hear(message.arbitration_id, now)
            # A frame of the wrong length or to an unknown entry: real nodes ignore it, too.
            with suppress(Exception):
                line.receive(message)

    def _measure(self) -> None:
        n = len(self.nodes)
        true = (*self._get("position"), *self._get("velocity"), *self._current())
        shown = self._misbehaviour.shown(true, self._clock())
        shown = tuple(value if math.isfinite(value) else 0.0 for value in shown)
        for i, node in enumerate(self.nodes):
            node.measured = MeasuredMotor(*shown[i::n])

    def _current(self) -> tuple[float, ...]:
        return self._get("current") if self._measures_current else (0.0,) * len(self.nodes)

    def _publish(self) -> None:
        self._set("velocity_command", [node.velocity for node in self.nodes])
        is_enabled = any(node.state is DriveState.OPERATION_ENABLED for node in self.nodes)
        self._set("brake", [0.0 if is_enabled else 1.0])

    def _get(self, signal: str) -> tuple[float, ...]:
        return self._harness.get(f"{self._part}.{signal}")

    def _set(self, signal: str, values: Sequence[float]) -> None:
        self._harness.set(f"{self._part}.{signal}", values)
