"""An ADIS16448 on an SPI bus of this computer, or an emulated one."""

import math
import re
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from parapod.systems.core.extras import need
from parapod.systems.core.quoting import show
from parapod.systems.hardware.adis16448.registers import (
    BURST_CRC,
    BURST_WORDS,
    DATA_READY,
    DECIMATION_SHIFT,
    INTERNAL_CLOCK,
    MEASURES,
    PRODUCT_ID,
    RANGE_1000,
    SOFTWARE_RESET,
    START_UP_TIME,
    Register,
    crc16,
    decode_burst,
    failures,
    mounted,
    mounting_axes,
)
from parapod.systems.hardware.adis16448.settings import SpiSettings
from parapod.systems.hardware.clock import answer_time, monotonic, sleep
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals

_SOCKET = "unix:"
_DEVICE = re.compile(r"/.+|\d+\.\d+")
# Between two words (data sheet: 9 us), and between two looks whether it has started [s].
_STALL, _POLL = 20e-6, 0.005
_WRITE = 0x80
_BURST = [Register.GLOB_CMD, 0] + [0, 0] * BURST_WORDS
# Before the bytes of a transfer through a socket, in both directions: how many they are.
LENGTH = struct.Struct(">H")
# Words read from a line that is not driven, and its level.
_STUCK = {0xFFFF: "high", 0x0000: "low"}


class SpiBus(Protocol):
    """A chip on an SPI bus, in the words of spidev's `SpiDev`."""

    def xfer2(self, values: list[int], /) -> Sequence[int]:
        """Sends bytes and receives as many, with the chip selected all the time.

        Raises:
            OSError: nothing could be transferred.
        """

    def close(self) -> None:
        """Ends the connection."""


class Adis16448Spi(Device):
    """Angular velocity, specific force, magnetic field and temperature, in one burst.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `gyro` | 3 | rad/s | angular velocity |
    | measure `accel` | 3 | m/s^2 | specific force; level and at rest: (0, 0, g) |
    | measure `mag` | 3 | T | magnetic field |
    | measure `temperature` | 1 | degC | of the sensor |

    Vectors are in the platform's frame, see the settings' `mounting_deg`. Check it before use:
    with the platform level and at rest, `accel` must be (0, 0, g).

    `configure` identifies the sensor, resets it, which ends whatever it was set to, and sets its
    range, decimation and CRC; nothing is written to its flash memory. A sensor that was away, or
    lost its supply, is identified and set up again by the first `read` that finds it. Parts of
    early lots have no CRC in their burst and are refused.

    `read` tells faults apart: a line that is stuck or a bus that does not answer is `SILENT`; a
    wrong CRC, twice, is `CORRUPT`; flags of DIAG_STAT are `FAILED`, and named (the CRC does not
    cover them); a bus that is gone is `UNPLUGGED`.
    """

    measures: Mapping[str, int] = MEASURES

    def __init__(
        self,
        settings: SpiSettings,
        bus: SpiBus | None = None,
        start_up_time: float = START_UP_TIME,
    ):
        """Creates a device that is not configured.

        Args:
            settings: place of the sensor, and how it samples.
            bus: bus to transfer through in place of the settings' address.
            start_up_time: time from power on or a reset to the first measurement [s].

        Raises:
            ValueError: settings that it does not have.
        """
        _check(settings)
        self._settings, self._given, self._start_up_time = settings, bus, start_up_time
        self.place = settings.place if bus is None else ""
        self.name = f"ADIS16448 at {self.place or type(bus).__name__}"
        self._axes = mounting_axes(settings.mounting)
        self._bus: SpiBus | None = None
        self._is_configured = self._is_set_up = False
        self._deadline = math.inf

    def configure(self) -> None:
        """Opens the bus, identifies the sensor, resets it and sets it up."""
        self.close()
        self._deadline = math.inf
        try:
            self._open()
            self._identify(self._start_up_time)
            self._write_byte(Register.GLOB_CMD, SOFTWARE_RESET)
            sleep(self._start_up_time)
            self._identify(self._settings.timeout)
            self._set_up()
        except BaseException:
            self.close()
            raise
        self._is_configured = True

    def read(self) -> Signals:
        """The newest sample."""
        if not self._is_configured:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        # The last transfer begins before the deadline and takes the other half at most.
        self._deadline = time.monotonic() + answer_time(0.5 * self._settings.timeout)
        try:
            if not self._is_set_up:
                self._open()
                self._identify(0.0)
                self._set_up()
            words = self._read_burst()
        except DeviceError as error:
            self._is_set_up = False
            if error.fault is DeviceFault.UNPLUGGED:
                self._hang_up()
            raise
        self._refuse_failures(words[0])
        return mounted(decode_burst(words), self._axes)

    def close(self) -> None:
        """Ends the connection."""
        self._is_configured = self._is_set_up = False
        self._hang_up()

    def _open(self) -> None:
        if self._bus is not None:
            return
        try:
            self._bus = _open_bus(self._settings) if self._given is None else self._given
        except OSError as error:
            raise DeviceError(
                self.name, f"cannot be reached: {error}", DeviceFault.UNPLUGGED
            ) from error

    def _hang_up(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _identify(self, patience: float) -> None:
        """Makes sure that this is the sensor, waiting so long for it to start [s]."""
        deadline = monotonic() + patience
        while (answer := self._read_register(Register.PROD_ID)) != PRODUCT_ID:
            if monotonic() >= deadline:
                self._refuse_stuck([answer])
                raise DeviceError(
                    self.name,
                    f"PROD_ID is 0x{answer:04X} ({answer}), not 0x{PRODUCT_ID:04X} ({PRODUCT_ID})",
                    DeviceFault.CORRUPT,
                )
            sleep(_POLL)

    def _set_up(self) -> None:
        """Sets range, decimation and CRC, and asks whether the sensor is well."""
        # No Bartlett filter: the mean of the decimation alone, as in simulation.
        self._write_register(Register.SENS_AVG, RANGE_1000)
        decimation = self._settings.decimation << DECIMATION_SHIFT
        self._write_register(Register.SMPL_PRD, decimation | INTERNAL_CLOCK)
        self._write_register(Register.MSC_CTRL, DATA_READY | BURST_CRC)
        # Reading clears flags of the past; what is still wrong is set again.
        self._read_register(Register.DIAG_STAT)
        self._refuse_failures(self._read_register(Register.DIAG_STAT))
        self._is_set_up = True

    def _read_burst(self) -> list[int]:
        """A burst with the right CRC; one disturbance may hit one burst."""
        words = self._exchange(_BURST)[1:]
        if words[-1] != crc16(words[1:-1]):
            self._refuse_stuck(words)
            words = self._exchange(_BURST)[1:]
        self._refuse_stuck(words)
        expected = crc16(words[1:-1])
        if words[-1] != expected:
            raise DeviceError(
                self.name,
                f"CRC of the burst is 0x{words[-1]:04X}, not 0x{expected:04X}",
                DeviceFault.CORRUPT,
            )
        return words

    def _refuse_stuck(self, words: list[int]) -> None:
        level = _STUCK.get(words[0])
        if level is not None and words.count(words[0]) == len(words):
            raise DeviceError(
                self.name,
                f"does not answer: all that is read is 0x{words[0]:04X} (MISO is stuck {level})",
                DeviceFault.SILENT,
            )

    def _refuse_failures(self, diagnosis: int) -> None:
        failed_tests = failures(diagnosis)
        if failed_tests:
            raise DeviceError(
                self.name,
                f"{', '.join(failed_tests)} (DIAG_STAT 0x{diagnosis:04X})",
                DeviceFault.FAILED,
            )

    def _read_register(self, register: Register) -> int:
        """A register, as the sensor sends it while it gets the next word."""
        self._send(register, 0)
        return self._send(0, 0)

    def _write_register(self, register: Register, value: int) -> None:
        """Writes both halves of a register and makes sure that they arrived."""
        self._write_byte(register, value & 0xFF)
        self._write_byte(register + 1, value >> 8)
        answer = self._read_register(register)
        if answer != value:
            self._refuse_stuck([answer])
            raise DeviceError(
                self.name,
                f"{register.name} is 0x{answer:04X} after 0x{value:04X} was written",
                DeviceFault.CORRUPT,
            )

    def _write_byte(self, address: int, value: int) -> None:
        self._send(address | _WRITE, value)

    def _send(self, address: int, value: int) -> int:
        """Sends one word; the word received meanwhile."""
        (answer,) = self._exchange([address, value])
        time.sleep(_STALL)
        return answer

    def _exchange(self, values: list[int]) -> list[int]:
        """The words received in one transfer."""
        assert self._bus is not None
        late = f"no answer within {self._settings.timeout:g} s"
        if time.monotonic() > self._deadline:
            raise DeviceError(self.name, late, DeviceFault.SILENT)
        try:
            answer = self._bus.xfer2(list(values))
        except TimeoutError as error:
            raise DeviceError(self.name, late, DeviceFault.SILENT) from error
        except OSError as error:
            text = f"cannot transfer: {error}"
            raise DeviceError(self.name, text, DeviceFault.UNPLUGGED) from error
        if len(answer) != len(values):
            text = f"{len(answer)} bytes were received for {len(values)}"
            raise DeviceError(self.name, text, DeviceFault.CORRUPT)
        return [answer[i] << 8 | answer[i + 1] for i in range(0, len(answer), 2)]


def _open_bus(settings: SpiSettings) -> SpiBus:
    """The bus at an address.

    Raises:
        MissingExtra: spidev is not installed.
        OSError: it cannot be opened.
    """
    address = settings.place
    if address.startswith(_SOCKET):
        return SpiSocketClient(address.removeprefix(_SOCKET), 0.5 * settings.timeout)
    bus = need("spidev").SpiDev()
    try:
        bus.open_path(address)
        # The clock idles high and the second edge counts (data sheet).
        bus.mode = 0b11
        bus.bits_per_word = 8
        bus.max_speed_hz = round(settings.clock)
    except BaseException:
        bus.close()
        raise
    opened: SpiBus = bus
    return opened


class SpiSocketClient:
    """A chip on the bus of an `SpiSocketServer`.

    A connection that fails is closed; the next transfer makes another one.
    """

    def __init__(self, path: str | Path, timeout: float):
        """Connects to a server.

        Args:
            path: path of its socket.
            timeout: longest time for one transfer [s].

        Raises:
            OSError: there is none.
        """
        self._path, self._timeout = str(path), timeout
        self._socket: socket.socket | None = None
        self._connected(time.monotonic() + answer_time(timeout))

    def xfer2(self, values: Sequence[int], /) -> list[int]:
        """Sends bytes and receives as many.

        Raises:
            TimeoutError: the server did not answer in time.
            OSError: the connection is gone.
        """
        deadline = time.monotonic() + answer_time(self._timeout)
        try:
            connection = self._connected(deadline)
            connection.sendall(LENGTH.pack(len(values)) + bytes(values))
            (size,) = LENGTH.unpack(_received(connection, LENGTH.size, deadline))
            return list(_received(connection, size, deadline))
        except OSError:
            # What comes later would be taken for the answer to the next transfer.
            self.close()
            raise

    def close(self) -> None:
        """Ends the connection."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _connected(self, deadline: float) -> socket.socket:
        if self._socket is None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                _limit(self._socket, deadline)
                self._socket.connect(self._path)
            except OSError:
                self.close()
                raise
        _limit(self._socket, deadline)
        return self._socket


def _limit(connection: socket.socket, deadline: float) -> None:
    """Makes the next operation end by then."""
    time_left = deadline - time.monotonic()
    if time_left <= 0.0:
        raise TimeoutError("timed out")
    connection.settimeout(time_left)


def _received(connection: socket.socket, size: int, deadline: float) -> bytes:
    """That many bytes."""
    data = b""
    while len(data) < size:
        _limit(connection, deadline)
        chunk = connection.recv(size - len(data))
        if not chunk:
            raise ConnectionResetError("the other end has hung up")
        data += chunk
    return data


def _check(settings: SpiSettings) -> None:
    """Refuses settings that the sensor does not have."""
    if not (settings.address.startswith(_SOCKET) or _DEVICE.fullmatch(settings.address)):
        raise ValueError(
            'address must be as "/dev/spidev0.0", "0.0" or "unix:/path", '
            f"not {show(settings.address)}"
        )
