"""Sabertooth motor drivers behind a serial port that is a pseudo terminal."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.emulation.pty import PtyPort
from parapod.systems.hardware.sabertooth.protocol import (
    MOTORS,
    STOPPED,
    TIMEOUT_UNIT,
    Command,
    Packet,
    PacketParser,
    Power,
    motor_of,
    voltage,
)
from parapod.systems.hardware.sabertooth.settings import BAUDS

# Longest time between two looks at timeouts and misbehaviour [s].
_CYCLE = 0.002
# Bytes of a garbled line from one that is damaged to the next, and the damaged bits.
_GARBLED, _DAMAGE = 7, 0x2A
# A driver restarts so long after a change of its baud rate (the maker's library for Arduino) [s].
_RESTART = 0.2


class SabertoothPty:
    """All drivers on a serial line, between a port and the wires of a simulated machine.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `<part>.voltage` | n | V | motors 1, 2 of each address in turn |
    | to the machine `<part>.stop` | 1 | - | 0, if there is such a wire: nothing cuts the supply |

    As the real ones, the drivers never answer, ignore what is for others, has a wrong checksum or
    comes at another speed, and stop both motors when their serial timeout, off at power-on, has
    passed without a packet for them. Ramps and dead band are not emulated.

    Misbehaviour: drivers that are `off` or `intermittent` hear nothing; on a line with `garbage`
    bytes are damaged; while it is `unplugged` there is no port; everything else changes what the
    motors get, whatever is commanded: `stuck` ones do not stop.

    Attributes:
        link: the symbolic link to the port, for `SabertoothSettings.port`.
    """

    def __init__(
        self,
        link: Path | str,
        harness: Harness,
        misbehaviour: Misbehaviour | None = None,
        addresses: Sequence[int] = (128, 129),
        supply_voltage: float = 12.0,
        baud: int = 38400,
        part: str = "legs",
        clock: Callable[[], float] = monotonic,
    ):
        """Switches the drivers on; the port is there within a `with` block.

        Args:
            link: path for a symbolic link to the port.
            harness: the wires.
            misbehaviour: faults of the devices.
            addresses: addresses of the drivers.
            supply_voltage: supply voltage of the drivers [V].
            baud: speed at which they listen [bit/s].
            part: part of the machine.
            clock: monotonic [s].

        Raises:
            ValueError: there are more actuators than motors.
        """
        self._harness, self._misbehaviour = harness, misbehaviour or Misbehaviour()
        self._supply, self._clock = supply_voltage, clock
        self._voltage, self._stop = f"{part}.voltage", f"{part}.stop"
        self._drivers = [_Driver(address, baud) for address in addresses]
        self._size, motors = len(harness.get(self._voltage)), MOTORS * len(self._drivers)
        if self._size > motors:
            raise ValueError(f"{self._voltage} has {self._size} elements for {motors} motors")
        self._has_stop = _has(harness, self._stop)
        self._port = PtyPort(link)
        self.link = self._port.link
        self._bytes = 0
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self._stopping.clear()
        self._port.plug_in()
        self._thread = threading.Thread(target=self._run, name="Sabertooth", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._port.unplug()

    @property
    def timeouts(self) -> tuple[float, ...]:
        """Serial timeouts of the drivers [s]; 0: off."""
        return tuple(driver.timeout for driver in self._drivers)

    @property
    def bauds(self) -> tuple[int, ...]:
        """Speeds at which the drivers listen [bit/s]."""
        return tuple(driver.baud for driver in self._drivers)

    @property
    def rejected(self) -> int:
        """Number of packets with a wrong checksum, as all drivers count them."""
        return sum(driver.rejected for driver in self._drivers)

    def restart(self, address: int) -> None:
        """Takes the power from a driver for a moment; it keeps its baud rate alone."""
        with self._lock:
            for driver in self._drivers:
                if driver.address == address:
                    driver.restart()

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._port.follow(self._misbehaviour.is_unplugged)
            if not self._port.is_plugged:
                self._stopping.wait(_CYCLE)
            data, baud = self._port.read(_CYCLE), self._port.baud
            now = self._clock()
            with self._lock:
                if data and self._misbehaviour.answers(now):
                    data = self._received(data)
                    for driver in self._drivers:
                        driver.hear(data, baud, now)
                for driver in self._drivers:
                    driver.watch(now)
                self._publish(now)

    def _received(self, data: bytes) -> bytes:
        """The bytes as they arrive."""
        first, self._bytes = self._bytes, self._bytes + len(data)
        if not self._misbehaviour.is_garbled:
            return data
        return bytes(byte ^ (0 if i % _GARBLED else _DAMAGE) for i, byte in enumerate(data, first))

    def _publish(self, now: float) -> None:
        powers = [power for driver in self._drivers for power in driver.powers]
        volts = tuple(voltage(power, self._supply) for power in powers[: self._size])
        # Garbage is on the line here, not at the motors.
        if not self._misbehaviour.is_garbled:
            volts = self._misbehaviour.shown(volts, now)
        self._harness.set(self._voltage, volts)
        if self._has_stop:
            self._harness.set(self._stop, (0.0,))


def _has(harness: Harness, name: str) -> bool:
    """Whether there is a wire of that name."""
    try:
        harness.get(name)
    except KeyError:
        return False
    return True


class _Driver:
    """A Sabertooth 2x25 V2 in packet serial mode."""

    def __init__(self, address: int, baud: int):
        self.address, self.baud = address, baud
        self._parser = PacketParser()
        self._deaf_until = 0.0
        self.restart()

    @property
    def rejected(self) -> int:
        return self._parser.rejected

    def restart(self) -> None:
        """Forgets all but what is in EEPROM."""
        self.powers: list[Power] = [STOPPED] * MOTORS
        self.timeout = 0.0
        self._heard = 0.0
        self._parser.reset()

    def hear(self, data: bytes, baud: int | None, now: float) -> None:
        """Takes bytes that come at a speed."""
        if baud != self.baud or now < self._deaf_until:
            self._parser.reset()
            return
        for packet in self._parser.feed(data):
            if packet.address == self.address:
                self._heard = now
                self._obey(packet, now)

    def watch(self, now: float) -> None:
        """Stops the motors when the timeout has passed."""
        if self.timeout > 0.0 and now - self._heard >= self.timeout:
            self.powers = [STOPPED] * MOTORS

    def _obey(self, packet: Packet, now: float) -> None:
        driven = motor_of(packet.command)
        if driven is not None:
            motor, direction = driven
            self.powers[motor - 1] = Power(direction, packet.data)
        elif packet.command == Command.SERIAL_TIMEOUT:
            self.timeout = packet.data * TIMEOUT_UNIT
        elif packet.command == Command.BAUD_RATE:
            self.baud = next((b for b, data in BAUDS.items() if data == packet.data), self.baud)
            self.restart()
            self._deaf_until = now + _RESTART
