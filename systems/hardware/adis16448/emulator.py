"""An ADIS16448 as its registers show it on an SPI bus, and a socket that brings it to others."""

import random
import selectors
import socket
import stat
import struct
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

from parapod.systems.hardware.adis16448.registers import (
    BURST_CRC,
    BURST_WORDS,
    DATA_READY,
    FILTER_AS_DELIVERED,
    INTERNAL_CLOCK,
    NEW_MAGNETOMETER_DATA,
    PRODUCT_ID,
    RANGE_1000,
    SCALES,
    SENSOR_OUTPUTS,
    SOFTWARE_RESET,
    SPI_FAILURE,
    START_UP_TIME,
    Register,
    crc16,
    temperature_word,
)
from parapod.systems.hardware.adis16448.spi import LENGTH, SpiBus
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

_AS_DELIVERED: dict[int, int] = {
    Register.GPIO_CTRL: 0,
    Register.MSC_CTRL: DATA_READY,
    Register.SMPL_PRD: INTERNAL_CLOCK,
    Register.SENS_AVG: RANGE_1000 | FILTER_AS_DELIVERED,
}
# Bit 15 of what the master sends: write. Bits 14 to 8: the address.
_WRITE = 0x80
_SILENCE = 0xFF


class Adis16448Registers:
    """The sensor at the other end of the bus; a stand-in for spidev's `SpiDev`.

    Each word of 16 bits is answered while the next one is sent. After a read of GLOB_CMD the rest
    of a transfer is a burst: DIAG_STAT, the outputs and, if MSC_CTRL says so, their CRC. Outputs
    are the newest signals, rounded to counts and limited to the warranted range; samples are not
    taken at the sensor's own rate. Until it has started, the sensor sends zeros. Reading DIAG_STAT
    clears the error of a transfer that is not of whole words.

    Misbehaviour: a sensor that is off leaves its line high, so every word is 0xFFFF; garbage
    damages one bit a word, which the CRC shows; unplugged, transfers raise `ConnectionError`;
    everything else changes the outputs. Settings stay, unless `power_cycle` is called.

    Attributes:
        product: content of PROD_ID.
        failed: bits of DIAG_STAT for failures that stay.
        temperature: temperature of the sensor [degC].
        registers: the settings, by address.
        transfers: number of transfers.
    """

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour | None = None,
        start_up_time: float = START_UP_TIME,
        part: str = "imu",
    ):
        """Creates a sensor that has started long ago.

        Args:
            harness: wires to the simulated machine; with signals `gyro`, `accel` and `mag` of the
                part.
            misbehaviour: faults of the device.
            start_up_time: time after a reset [s].
            part: part of the machine.
        """
        self._harness, self._part = harness, part
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._start_up_time = start_up_time
        self._ready = 0.0
        self._answer = 0
        self._transient = 0
        self._random = random.Random(0)
        self._lock = threading.Lock()
        self.product = PRODUCT_ID
        self.failed = 0
        self.temperature = 25.0
        self.registers = dict(_AS_DELIVERED)
        self.transfers = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Does nothing: the bus can be used again."""

    def power_cycle(self) -> None:
        """Takes the supply away and gives it back: settings are as delivered."""
        with self._lock:
            self._reset()

    def xfer2(self, values: Sequence[int], /) -> list[int]:
        """Exchanges bytes, with the chip selected all the time.

        Raises:
            ConnectionError: it is unplugged.
        """
        with self._lock:
            self.transfers += 1
            now = monotonic()
            if self._misbehaviour.is_unplugged:
                raise ConnectionError("the cable is out")
            if not self._misbehaviour.answers(now):
                return [_SILENCE] * len(values)
            if len(values) % 2:
                self._transient |= SPI_FAILURE
                return [0] * len(values)
            words = [values[i] << 8 | values[i + 1] for i in range(0, len(values), 2)]
            answers = self._exchanged(words, now)
            if self._misbehaviour.is_garbled:
                answers = [word ^ 1 << self._random.randrange(16) for word in answers]
            return [byte for word in answers for byte in divmod(word, 256)]

    def _exchanged(self, words: list[int], now: float) -> list[int]:
        if now < self._ready or not words:
            return [0] * len(words)
        if words[0] == Register.GLOB_CMD << 8 and len(words) > 1:
            burst = self._burst(now)
            # Longer than that, there is nothing more to send.
            burst += [0] * (len(words) - 1 - len(burst))
            answers = [self._answer, *burst[: len(words) - 1]]
            self._answer = 0
            return answers
        answers = []
        for word in words:
            answers.append(self._answer)
            self._answer = self._obey(word, now)
        return answers

    def _burst(self, now: float) -> list[int]:
        outputs = [*self._outputs(now), 0, temperature_word(self.temperature)]
        words = [self._diagnosis() | NEW_MAGNETOMETER_DATA, *outputs]
        has_crc = self.registers[Register.MSC_CTRL] & BURST_CRC
        words += [crc16(outputs)] if has_crc else [0]
        assert len(words) == BURST_WORDS
        return words

    def _outputs(self, now: float) -> list[int]:
        return [
            count & 0xFFFF
            for count in imu_counts(self._harness, self._misbehaviour, now, self._part)
        ]

    def _diagnosis(self) -> int:
        diagnosis_bits, self._transient = self.failed | self._transient, 0
        return diagnosis_bits

    def _obey(self, word: int, now: float) -> int:
        """Does what a word asks; what is sent during the next one."""
        address, data = word >> 8, word & 0xFF
        if address & _WRITE:
            self._write(address & ~_WRITE, data)
            return 0
        match address & ~1:
            case Register.PROD_ID:
                return self.product
            case Register.DIAG_STAT:
                return self._diagnosis()
            case Register.TEMP_OUT:
                return temperature_word(self.temperature)
            case output if output in SENSOR_OUTPUTS:
                return self._outputs(now)[SENSOR_OUTPUTS.index(Register(output))]
            case other:
                return self.registers.get(other, 0)

    def _write(self, address: int, data: int) -> None:
        """Writes one half of a register; what cannot be written stays."""
        register = address & ~1
        if register == Register.GLOB_CMD:
            if address == register and data & SOFTWARE_RESET:
                self._reset()
        elif register in self.registers:
            value_before = self.registers[register]
            self.registers[register] = (
                value_before & 0x00FF | data << 8 if address & 1 else value_before & 0xFF00 | data
            )

    def _reset(self) -> None:
        self.registers.update(_AS_DELIVERED)
        self._answer = self._transient = 0
        self._ready = monotonic() + self._start_up_time


def imu_counts(
    harness: Harness, misbehaviour: Misbehaviour, now: float, part: str = "imu"
) -> list[int]:
    """Nine outputs of the sensors at that time [s], in counts."""
    truth = [value for name in SCALES for value in harness.get(f"{part}.{name}")]
    shown_values = misbehaviour.shown(truth, now)
    return [
        scale.counts(value)
        for index, scale in enumerate(SCALES.values())
        for value in shown_values[3 * index : 3 * index + 3]
    ]


# Time between two looks of the server at its cable [s].
_POLL = 0.002
_CHUNK = 4096


class SpiSocketServer:
    """Serves a chip to other processes, from the beginning of a `with` block to its end.

    While the misbehaviour is `unplugged`, there are no connections and no socket; everything else
    is up to the chip.

    Attributes:
        address: address of the chip, for `SpiSettings.address`.
    """

    def __init__(self, path: str | Path, bus: SpiBus, misbehaviour: Misbehaviour | None = None):
        """Creates a server that does not listen yet.

        Args:
            path: path of the socket; at most some 100 characters.
            bus: the chip.
            misbehaviour: faults of the device.
        """
        self._path, self._bus = Path(path), bus
        self.address = f"unix:{path}"
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._listener: socket.socket | None = None
        self._buffers: dict[socket.socket, bytes] = {}
        self._selector = selectors.DefaultSelector()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="SPI socket", daemon=True)

    def __enter__(self) -> Self:
        self._plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._unplug()
        self._selector.close()

    def _plug_in(self) -> None:
        if self._path.exists() and stat.S_ISSOCK(self._path.stat().st_mode):
            # One that a server has left behind which was killed.
            self._path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self._path))
        self._listener.listen()
        self._selector.register(self._listener, selectors.EVENT_READ)

    def _unplug(self) -> None:
        for connection in list(self._buffers):
            self._hang_up(connection)
        listener, self._listener = self._listener, None
        if listener is not None:
            self._selector.unregister(listener)
            listener.close()
            self._path.unlink(missing_ok=True)

    def _hang_up(self, connection: socket.socket) -> None:
        del self._buffers[connection]
        self._selector.unregister(connection)
        connection.close()

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._misbehaviour.is_unplugged:
                self._unplug()
                self._closing.wait(_POLL)
                continue
            if self._listener is None:
                self._plug_in()
            for key, _ in self._selector.select(_POLL):
                if key.fileobj is self._listener:
                    self._accept(self._listener)
                elif isinstance(key.fileobj, socket.socket):
                    self._answer(key.fileobj)

    def _accept(self, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        connection.setblocking(False)
        self._buffers[connection] = b""
        self._selector.register(connection, selectors.EVENT_READ)

    def _answer(self, connection: socket.socket) -> None:
        """Transfers complete requests; hangs up on a client that is gone or asks too much."""
        try:
            data = connection.recv(_CHUNK)
            if not data:
                raise ConnectionResetError
            self._buffers[connection] += data
            while (values := self._taken(connection)) is not None:
                answer = bytes(self._bus.xfer2(values))
                connection.sendall(LENGTH.pack(len(answer)) + answer)
        except OSError:
            self._hang_up(connection)

    def _taken(self, connection: socket.socket) -> list[int] | None:
        """The next whole transfer that has come."""
        buffer = self._buffers[connection]
        with suppress(struct.error):
            (size,) = LENGTH.unpack_from(buffer)
            end = LENGTH.size + size
            if len(buffer) >= end:
                self._buffers[connection] = buffer[end:]
                return list(buffer[LENGTH.size : end])
        return None
