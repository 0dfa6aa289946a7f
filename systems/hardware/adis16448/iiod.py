"""Debian's iiod over files that look like the kernel's driver of an ADIS16448."""

import shutil
import socket
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

from parapod.systems.hardware.adis16448.emulator import imu_counts
from parapod.systems.hardware.adis16448.registers import sample_rate, signed, temperature_word
from parapod.systems.hardware.clock import monotonic, wait
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

# How often the files follow the signals, and how long iiod may take to start [s].
_PERIOD, _START = 0.002, 5.0

_PROGRAMS = ("unshare", "setpriv", "iiod")
_NAMESPACE = ("unshare", "--user", "--map-root-user", "--mount")
# Within a namespace of its own, iiod finds the folder where the kernel's devices would be. It ends
# with this process, even if that is killed.
_SCRIPT = """set -e
mount -t tmpfs none /sys
mkdir -p /sys/bus/iio/devices
mount --bind "$1" /sys/bus/iio/devices
exec setpriv --pdeathsig KILL iiod --port "$2"
"""

# Values of the driver (Linux 6.14, drivers/iio/imu/adis16400.c): scales and offset are the
# integers of its macros, the magnetometer's is that of the ADIS16400.
SCALES = {
    "in_anglvel_scale": "0.000698",
    "in_accel_scale": "0.008169",
    "in_magn_scale": "0.000500",
    "in_temp0_scale": "73.860000",
    "in_temp0_offset": "419",
}
_RAW = [f"in_{kind}_{axis}_raw" for kind in ("anglvel", "accel", "magn") for axis in "xyz"]
_RATE = "sampling_frequency"


def is_available() -> str | None:
    """Find the reason why no `IiodServer` can run here; None: one can."""
    missing = [program for program in _PROGRAMS if shutil.which(program) is None]
    if missing:
        return f"{', '.join(missing)} cannot be found"
    attempt = subprocess.run(
        [*_NAMESPACE, "mount", "-t", "tmpfs", "none", "/sys"],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"no namespaces: {' '.join(attempt.stderr.split())}" if attempt.returncode else None


class IiodServer:
    """The kernel's driver of an ADIS16448 behind iiod, for clients in any process.

    It runs from the beginning of a `with` block to its end. The files follow the signals 500 times
    a second; where the driver would ask the sensor, iiod reads them.

    Misbehaviour: a sensor that is off reads -1 everywhere, as the driver shows it, which does not
    check what it reads; while it is unplugged, there is no iiod; everything else changes values.

    Attributes:
        uri: uri of libiio's context.
        temperature: temperature of the sensor [degC].
        process: iiod, while it listens.
    """

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour | None = None,
        port: int | None = None,
        device: str = "adis16448",
        part: str = "imu",
    ):
        """Creates a server that does not run yet.

        Args:
            harness: wires to the simulated machine; with signals `gyro`, `accel` and `mag` of the
                part.
            misbehaviour: faults of the device.
            port: to listen at, on all of the computer's addresses; None: one that is free.
            device: the name that the driver gives to the sensor.
            part: part of the machine.
        """
        self._harness, self._part = harness, part
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._device = device
        self._port = _free_port() if port is None else port
        self.uri = f"ip:127.0.0.1:{self._port}"
        self.temperature = 25.0
        self.process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._shown: dict[str, int] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="iiod", daemon=True)

    def __enter__(self) -> Self:
        reason = is_available()
        if reason is not None:
            raise DeviceError(f"iiod at {self.uri}", reason, DeviceFault.UNPLUGGED)
        self._folder = tempfile.TemporaryDirectory(prefix="iio")
        self._make_files()
        try:
            self._start()
        except BaseException:
            self._clean_up()
            raise
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._clean_up()

    @property
    def rate(self) -> float:
        """The sample rate that a client has set [Hz]."""
        return float(self._file(_RATE).read_text().rstrip("\0\n"))

    def _clean_up(self) -> None:
        self._end()
        if self._folder is not None:
            self._folder.cleanup()

    def _file(self, name: str) -> Path:
        assert self._folder is not None
        return Path(self._folder.name) / "devices" / "iio:device0" / name

    def _make_files(self) -> None:
        self._file("").mkdir(parents=True)
        rate = {_RATE: f"{sample_rate(0):.6f}"}
        for name, text in ({"name": self._device} | SCALES | rate).items():
            self._file(name).write_text(f"{text}\n")
        self._follow()

    def _follow(self) -> None:
        """Puts the newest counts into the files."""
        now = monotonic()
        counts = imu_counts(self._harness, self._misbehaviour, now, self._part)
        # The driver takes the lower 12 bits of TEMP_OUT for a signed number.
        raw_values = dict(zip(_RAW, counts, strict=True))
        raw_values["in_temp0_raw"] = signed(temperature_word(self.temperature), 12)
        if not self._misbehaviour.answers(now):
            raw_values = dict.fromkeys(raw_values, -1)
        for name, count in raw_values.items():
            if self._shown.get(name) != count:
                self._replace(name, f"{count}\n")
        self._shown = raw_values

    def _replace(self, name: str, text: str) -> None:
        """Changes a file at once, so that it is never read half."""
        assert self._folder is not None
        fresh = Path(self._folder.name) / "fresh"
        fresh.write_text(text)
        fresh.replace(self._file(name))

    def _run(self) -> None:
        while not wait(self._closing, _PERIOD):
            if self._misbehaviour.is_unplugged:
                self._end()
                continue
            self._follow()
            if self.process is None:
                # Somebody may have taken the port; it may be free again next time.
                with suppress(DeviceError):
                    self._start()

    def _start(self) -> None:
        assert self._folder is not None
        command = ("sh", "-c", _SCRIPT, "iiod", f"{self._folder.name}/devices", str(self._port))
        log = Path(self._folder.name) / "log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [*_NAMESPACE, *command], stdout=stream, stderr=subprocess.STDOUT
            )
        deadline = time.monotonic() + _START
        while not self._listens():
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                process.wait()
                words = f"it does not start: {log.read_text()}"
                raise DeviceError(f"iiod at {self.uri}", words, DeviceFault.FAILED)
            time.sleep(_PERIOD)
        self.process = process

    def _listens(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self._port), _START).close()
        except OSError:
            return False
        return True

    def _end(self) -> None:
        process, self.process = self.process, None
        if process is not None:
            process.kill()
            process.wait()


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
        return port
