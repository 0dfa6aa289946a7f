"""Linear actuators on Sabertooth motor drivers that share one serial line."""

import math
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from parapod.systems.core.extras import need
from parapod.systems.core.switching import switched
from parapod.systems.hardware.clock import answer_time, monotonic, sleep
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals
from parapod.systems.hardware.sabertooth.protocol import (
    ADDRESSES,
    BITS_PER_BYTE,
    MOTORS,
    PACKET_BYTES,
    STOPPED,
    Command,
    Power,
    motor_packet,
    packet,
    power,
    timeout_packet,
)
from parapod.systems.hardware.sabertooth.settings import BAUDS, SabertoothSettings

# Longest time between two packets to a motor, if `write` is called that often, and between two
# settings of a driver's serial timeout [s].
_REFRESH_INTERVAL, _ARMING_INTERVAL = 0.05, 1.0
# A driver restarts after a change of its baud rate, for some 200 ms according to the maker's
# library for Arduino [s].
_RESTART = 0.5
# Time between two looks at a port that is being emptied [s].
_POLL = 0.001


class SabertoothSerial(Device):
    """Motor drivers in packet serial mode; it measures nothing, since they say nothing.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | command `voltage` | n | V | at the actuators, within plus and minus the supply voltage |
    | command `stop` | 1 | - | above 0.5: no voltage at any actuator |

    Voltages are rounded to 1/127 of the supply. The drivers' own dead band and ramps, as they are
    in their EEPROM, come on top of it.

    **Identity.** The line goes one way. `configure` refuses a port that is not there, is not a
    serial port, or is another program's; whether any driver hears it, at this speed and these
    addresses, in packet serial mode and with power, only the motors' motion tells. V2 drivers
    have their baud rate in EEPROM and need no bauding character (170), and none is sent: older
    drivers, which need it, stay deaf, as they should, because they have no serial timeout.

    **Timeout.** Drivers that hear nothing for `serial_timeout_ms` stop the motors: when this
    program is killed or hangs, when the computer fails or the cable is pulled. It is off when a
    driver is switched on, and it does not tell that it was: so it is set by `configure`, by
    `activate`, and by `write` again and again. A driver that loses its power meanwhile goes
    without it for little more than a second. Only calls of `write` and `neutral` send anything; no
    thread keeps the drivers going behind the back of a controller that hangs. For an emergency
    stop that depends on no program, the drivers have inputs S2.

    **Line.** No more is written than the line can carry: never does more than one packet for each
    motor, and one that sets a timeout, wait in the port. A `write` that cannot send all sends to
    the motors whose command has changed or is due again, those first that have waited longest. A
    stop of all motors does not wait for that; the port then has twice as much to send at most. A
    packet that noise destroys is made good by the next one.

    Bad input: a voltage that is not finite is neutral; a stop that is near neither 0 nor 1 is one.

    A port that was unplugged needs `configure` again.
    """

    def __init__(
        self,
        settings: SabertoothSettings,
        actuators: int | None = None,
        clock: Callable[[], float] = monotonic,
    ):
        """Describes the drivers; nothing is opened.

        Args:
            settings: settings of drivers and line.
            actuators: number of actuators; None: two for each driver.
            clock: monotonic [s].

        Raises:
            ValueError: settings that do not fit together.
        """
        self._settings, self._clock = settings, clock
        self.name, self.place = f"Sabertooth on {settings.path}", settings.place
        within = f"{settings.serial_timeout:g} s"
        self.watchdog = f"without packets the motor drivers stop the motors within {within}"
        self._motors = settings.motors[:actuators]
        self._size = len(self._motors)
        _check(settings, self._size)
        self.commands = {"voltage": self._size, "stop": 1}
        self.fail_safe = ("stop",)
        self._port: Any = None
        self._is_active = False
        self._forget()

    def configure(self) -> None:
        """Opens the port, sets the drivers' serial timeout and stops the motors.

        Raises:
            MissingExtra: pyserial is not installed.
            DeviceError: the port cannot be opened; who listens at it is not known.
        """
        self.close()
        baud, old_baud = self._settings.baud, self._settings.power_on_baud
        try:
            self._forget()
            if old_baud is not None and old_baud != baud:
                self._change_baud(old_baud)
            self._port = self._open(baud)
            self._set_up()
        except BaseException:
            self.close()
            raise

    def activate(self) -> None:
        """Sets the serial timeout again, stops the motors, and obeys `write` from now on."""
        self._set_up()
        self._is_active = True

    def read(self) -> Signals:
        """Nothing, if the port is there."""
        self._waiting()
        return {}

    def write(self, commands: Signals) -> None:
        """Sends voltages, as many as the line can carry; on a stop, zeros.

        While the device is not active, whatever is asked is neutral.
        """
        voltage = commands["voltage"]
        if len(voltage) != self._size:
            raise ValueError(f"voltage has {self._size} elements, not {len(voltage)}")
        if self._is_active and switched(*commands["stop"]) is False:
            self._send([power(value, self._settings.supply_voltage) for value in voltage])
        else:
            self.neutral()

    def neutral(self) -> None:
        """Stops all motors."""
        self._send([STOPPED] * self._size)

    def deactivate(self) -> None:
        """Stops all motors and obeys `write` no longer."""
        self._is_active = False
        self.neutral()

    def close(self) -> None:
        """Stops all motors and closes the port; never raises."""
        self._is_active = False
        port = self._port
        if port is None:
            return
        with suppress(Exception):
            self.neutral()
        self._port = None
        with suppress(Exception):
            self._empty(port)
        with suppress(Exception):
            port.close()

    def _forget(self) -> None:
        """Nothing is known of drivers that were not spoken to."""
        # A full set: one packet for each motor, and one that arms a timeout.
        self._line = _Line(_packet_time(self._settings), self._size + 1)
        self._sent = [_UNKNOWN] * self._size
        # The actuators, beginning with the one that was commanded least recently.
        self._turns = list(range(self._size))
        self._armed = dict.fromkeys(self._settings.addresses, -math.inf)
        self._had_room = self._clock()

    def _open(self, baud: int) -> Any:
        serial = need("serial")
        with self._port_errors("no port"):
            return serial.Serial(
                self._settings.path,
                baud,
                timeout=0.0,
                write_timeout=answer_time(self._settings.serial_timeout),
                exclusive=True,
            )

    def _change_baud(self, old: int) -> None:
        """Changes the speed of drivers that still listen at another one."""
        data = BAUDS[self._settings.baud]
        with self._open(old) as port, self._port_errors("the speed is not changed"):
            for address in self._settings.addresses:
                port.write(packet(address, Command.BAUD_RATE, data))
            self._empty(port)
            sleep(_RESTART)

    def _empty(self, port: Any) -> None:
        """Waits until what was written has left the port; what should have by now is dropped."""
        deadline = time.monotonic() + answer_time(self._settings.serial_timeout)
        while port.out_waiting:
            if time.monotonic() > deadline:
                # Or the operating system would wait for it when the port is closed.
                port.reset_output_buffer()
                return
            time.sleep(_POLL)

    def _set_up(self) -> None:
        """Sets the timeout of all drivers and stops all motors, whatever was commanded before."""
        now = self._clock()
        for address in self._settings.addresses:
            self._arm(address, now)
        self._drive(range(self._size), [STOPPED] * self._size, now)
        self._had_room = now

    def _send(self, powers: Sequence[Power]) -> None:
        """Sends the most urgent commands, or all if the line can carry them."""
        waiting, now = self._waiting(), self._clock()
        room = self._line.room(now, waiting)
        if all(power == STOPPED for power in powers):
            moving = [i for i, sent in enumerate(self._sent) if sent.power != STOPPED]
            self._drive(moving, powers, now)
            room -= len(moving)
        if room > 0:
            self._had_room = now
            oldest = min(self._armed, key=lambda address: self._armed[address])
            if now - self._armed[oldest] >= _ARMING_INTERVAL:
                self._arm(oldest, now)
                room -= 1
            self._drive(self._due(powers, room, now), powers, now)
        elif now - self._had_room > self._settings.serial_timeout:
            text = f"nothing leaves the port; {waiting} bytes wait"
            raise DeviceError(self.name, text, DeviceFault.SILENT)

    def _due(self, powers: Sequence[Power], room: int, now: float) -> list[int]:
        """The actuators whose turn it is, if there is room for their packets."""
        if room >= self._size:
            return [*self._turns]
        interval = _REFRESH_INTERVAL
        due = (
            i
            for i in self._turns
            if self._sent[i].power != powers[i] or now - self._sent[i].at >= interval
        )
        return list(due)[:room]

    def _drive(self, which: Sequence[int], powers: Sequence[Power], now: float) -> None:
        """Commands some of the motors."""
        motors = [self._motors[i] for i in which]
        data = [motor_packet(*motor, powers[i]) for motor, i in zip(motors, which, strict=True)]
        for i in which:
            self._sent[i] = _UNKNOWN
        self._transmit(data, now)
        for i in which:
            self._sent[i] = _Sent(powers[i], now)
        self._turns = [i for i in self._turns if i not in which] + [*which]

    def _arm(self, address: int, now: float) -> None:
        """Sets the serial timeout of a driver."""
        self._transmit([timeout_packet(address, self._settings.serial_timeout)], now)
        self._armed[address] = now

    def _transmit(self, packets: Sequence[bytes], now: float) -> None:
        if not packets:
            return
        with self._port_errors("the port does not send"):
            self._opened().write(b"".join(packets))
        self._line.take(len(packets), now)

    def _waiting(self) -> int:
        """Number of bytes that the port has not sent yet."""
        with self._port_errors("the port is gone"):
            return self._opened().out_waiting

    def _opened(self) -> Any:
        if self._port is None:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        return self._port

    @contextmanager
    def _port_errors(self, what: str) -> Iterator[None]:
        """Makes what the operating system says of the port errors of the device."""
        try:
            yield
        # Setting up a port that goes away meanwhile raises termios' own error.
        except (OSError, termios.error) as error:
            is_late = isinstance(error, need("serial").SerialTimeoutException)
            fault = DeviceFault.SILENT if is_late else DeviceFault.UNPLUGGED
            raise DeviceError(self.name, f"{what}: {error}", fault) from error


class _Sent(NamedTuple):
    """Last command sent to a motor and its time [s]; None if unknown."""

    power: Power | None
    at: float


_UNKNOWN = _Sent(None, -math.inf)


class _Line:
    """Number of packets that may be written so that never more than a set of them waits."""

    def __init__(self, packet_time: float, set_size: int):
        self._packet_time, self._set_size = packet_time, set_size
        self._idle_from = -math.inf

    def room(self, now: float, waiting: int) -> int:
        """Number of packets; 0 or less: none.

        Args:
            now: the time [s].
            waiting: bytes that the port still has; an adapter's own buffer is not among them,
                so what the line must have carried since counts, too.
        """
        written = (self._idle_from - now) / self._packet_time
        backlog = max(written, waiting / PACKET_BYTES, 0.0)
        # Rounding must not cost a packet on a line that has just become idle.
        return math.floor(self._set_size - backlog + 1e-6)

    def take(self, packets: int, now: float) -> None:
        """Counts packets that are written."""
        self._idle_from = max(self._idle_from, now) + packets * self._packet_time


def _packet_time(settings: SabertoothSettings) -> float:
    """Time that a packet takes on the line [s]."""
    return PACKET_BYTES * BITS_PER_BYTE / settings.baud


def _check(settings: SabertoothSettings, actuators: int) -> None:
    """Refuses settings that do not fit together."""
    addresses = tuple(settings.addresses)
    admissible = {address for address in addresses if address in ADDRESSES}
    if not admissible or len(admissible) != len(addresses):
        raise ValueError(
            f"addresses must be different ones of {ADDRESSES[0]}..{ADDRESSES[-1]}, not {addresses}"
        )
    if not actuators:
        raise ValueError(f"actuators must be 1 to {MOTORS * len(addresses)}, not 0")
    timeout = settings.serial_timeout
    timeout_packet(addresses[0], timeout)
    # So that one lost packet stops nothing.
    least, most = (actuators + 1) * _packet_time(settings), 0.5 * timeout
    if not least <= _REFRESH_INTERVAL <= most:
        raise ValueError(
            f"refresh_interval must be {least:.4f} s (a set of packets at {settings.baud} bit/s) "
            f"to {most} s (half of serial_timeout), not {_REFRESH_INTERVAL} s"
        )
