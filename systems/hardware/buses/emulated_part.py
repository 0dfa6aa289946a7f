"""An emulated part behind a bus: between its channels and the wires of a simulated machine."""

import threading
from typing import Self

from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.bus import Bus
from parapod.systems.hardware.buses.connection import connect
from parapod.systems.hardware.buses.message import Layout, Message, Signal
from parapod.systems.hardware.buses.served_part import ServedPart
from parapod.systems.hardware.clock import monotonic, wait_until
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


class EmulatedBusPart:
    """A part that publishes its status and takes commands, as `ServedPart` does.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `<part>.<command>` | n | SI | its commands; idle ones while it is neutral |
    | from the machine `<part>.<measurement>` | n | SI | its measurements |

    Misbehaviour: a part that is `off`, `intermittent` or `unplugged` publishes nothing and hears
    nothing, and is neutral once it has heard nothing for as long as that may last; `garbage` takes
    names out of its messages; anything else changes what it measures.
    """

    def __init__(
        self,
        part: str,
        address: Address,
        harness: Harness,
        misbehaviour: Misbehaviour | None = None,
        *,
        rate: float = 100.0,
    ):
        """Describes the part; its channels are open within a `with` block.

        Args:
            part: name of the part.
            address: address of the bus.
            harness: the wires.
            misbehaviour: faults of the part.
            rate: messages a second [Hz].
        """
        self.part, self._address, self._rate = part, address, rate
        self._harness, self._misbehaviour = harness, misbehaviour or Misbehaviour()
        signals = harness.signals_of(part)
        self._measures = {n: Signal(size) for n, (size, idle) in signals.items() if idle is None}
        self._commands = {
            n: Signal(size, idle=idle) for n, (size, idle) in signals.items() if idle is not None
        }
        self._measured = Layout(self._measures)
        self._over = threading.Event()
        self._bus: Bus | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._over.clear()
        self._bus = connect(self._address, "emulator")
        served = ServedPart(self.part, self._bus, self._measures, self._commands)
        self._thread = threading.Thread(target=self._run, args=(served,), daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        if self._bus is not None:
            self._bus.close()

    def _run(self, served: ServedPart) -> None:
        last, period, instant = monotonic(), 1.0 / self._rate, 0
        while True:
            # The same for all parts; those that are over are left out.
            instant = max(instant, int(monotonic() / period)) + 1
            if wait_until(self._over, instant * period):
                return
            now = monotonic()
            answers = self._misbehaviour.answers(now)
            last = now if answers else last
            if answers or now - last > served.timeout:
                commands = served.commands(now) if answers else served.idle
                for name, values in commands.items():
                    self._harness.set(f"{self.part}.{name}", values)
            if answers:
                self._publish(served, now)

    def _publish(self, served: ServedPart, now: float) -> None:
        measured = {n: self._harness.get(f"{self.part}.{n}") for n in self._measures}
        values = self._misbehaviour.shown(self._measured.pack(measured), now)
        start = 0
        for name, signal in self._measures.items():
            measured[name] = values[start : start + signal.size]
            start += signal.size
        commanded = {n: self._harness.get(f"{self.part}.{n}") for n in self._commands}
        if self._misbehaviour.is_garbled and self._bus is not None:
            names = [f"?{name}" for name in self._measured.names]
            self._bus.publish(served.status, Message(names, values, now))
        else:
            served.publish(measured | commanded, now)
