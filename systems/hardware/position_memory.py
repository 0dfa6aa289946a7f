"""Positions of self-locking actuators, from the end of one program to the next.

Incremental encoders forget where they are; self-locking screws stay there.
"""

import json
import math
import os
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from parapod.systems.core.quoting import quoted_path, show
from parapod.systems.hardware.clock import sleep
from parapod.systems.hardware.device import Device, DeviceError

# Without power an actuator stands still after this: ten mechanical time constants and more [s].
_COASTING = 0.05
# Keys of the file beside the positions.
_SAVED, _PROGRAMS, _REFERENCE = "saved", "programs_since_measured", "reference"
# Origin of positions that the settings give.
_BY_HAND = "measured by hand"
# Largest number of looks whether it stands; an encoder on an edge may never be quiet.
_LOOKS = 10


class PositionMemory:
    """A file that knows the positions of actuators while nothing can move them.

    Incremental encoders forget where they are; self-locking screws stay there. While the drives
    have power the file says only that it knows nothing, so a program that is killed leaves no
    wrong positions behind, and the next one refuses to begin.

    Attributes:
        path: path of the file; its folder must exist.
        signal: signal that is remembered, as "position": errors and the scenario's keys are named
            after it.
    """

    def __init__(self, path: Path, size: int, signal: str = "position"):
        """Creates the memory; nothing is read or written.

        Args:
            path: path of the file.
            size: number of actuators.
            signal: see the class.
        """
        self.path, self.signal, self._size = Path(path), signal, size
        self._key = f"{signal}_m"
        self._saved: datetime | None = None
        self._programs, self._reference = 0, _BY_HAND

    @property
    def provenance(self) -> str:
        """Age of the positions, how they have been found, and number of programs since."""
        when = "an unknown time"
        if self._saved is not None:
            age = (datetime.now(UTC) - self._saved).total_seconds()
            when = f"{_duration(age)} ago ({self._saved:%Y-%m-%d %H:%M} UTC)"
        programs = "one program" if self._programs == 1 else f"{self._programs} programs"
        since = f"counted by {programs} since they were {self._reference}"
        return f"{self.signal}s as of {when}, {since}"

    def recall(self) -> tuple[float, ...] | None:
        """The positions [m]; None if there is no file.

        Raises:
            DeviceError: the file says that they are not known, or is none of ours.
        """
        try:
            document = json.loads(self.path.read_text(encoding="utf-8"))
            entry = document[self._key]
            self._saved, self._programs, self._reference = _provenance(document)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise self._refused(f"cannot be read: {error}") from None
        if entry is None:
            raise self._refused(
                "says that the last program ended while the drives had power, so the "
                f"{self.signal}s are unknown; find them with `parapod home`, or measure them, and "
                f"delete the file to begin with measured ones, given as {self.signal}_at_start_mm"
            )
        is_list = isinstance(entry, list) and len(entry) == self._size
        if not is_list or not all(isinstance(x, float) and math.isfinite(x) for x in entry):
            raise self._refused(f"must have {self._size} {self.signal}s, not {show(entry)}")
        return tuple(entry)

    def forget(self) -> None:
        """From now on the positions are not known.

        Raises:
            DeviceError: the file cannot be written.
        """
        self._write({self._key: None})

    def save(self, positions: Sequence[float], reference: str | None = None) -> None:
        """The drives have no power and the actuators stand still, here [m].

        Args:
            positions: positions of the actuators [m].
            reference: origin of this program's own reference, such as "measured by
                hand"; None: it began with the positions of the file.

        Raises:
            DeviceError: the file cannot be written.
        """
        self._programs = self._programs + 1 if reference is None else 1
        self._reference = reference or self._reference
        self._saved = datetime.now(UTC)
        self._write(
            {
                self._key: [float(x) for x in positions],
                _SAVED: self._saved.isoformat(timespec="seconds"),
                _PROGRAMS: self._programs,
                _REFERENCE: self._reference,
            }
        )

    def _write(self, document: Mapping[str, Any]) -> None:
        text = json.dumps(document) + "\n"
        temporary = self.path.with_name(f"{self.path.name}.new")
        try:
            with open(temporary, "w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(self.path)
        except OSError as error:
            raise self._refused(f"cannot be written: {error.strerror or error}") from None

    def _refused(self, why: str) -> DeviceError:
        return DeviceError(f"{self.signal}s' file {quoted_path(self.path)}", why)


def _provenance(document: Mapping[str, Any]) -> tuple[datetime | None, int, str]:
    """Instant at which positions were saved, number of programs, and how they were found.

    Older files do not say.
    """
    saved, programs = document.get(_SAVED), document.get(_PROGRAMS, 0)
    when = datetime.fromisoformat(saved) if saved else None
    return when, int(programs), str(document.get(_REFERENCE, "measured"))


def _duration(seconds: float) -> str:
    """A time in the largest unit of which it has two."""
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    whole = max(round(seconds), 0)
    return "1 second" if whole == 1 else f"{whole} seconds"


class IncrementalDevice(Device):
    """A device whose encoders count from wherever they are.

    With a memory it begins with the positions with which the last program ended. While there is
    no such file, a reference that the device has by itself counts, from its settings; without that
    either, the positions are unknown and nothing begins. From `activate` on the file knows
    nothing; after `deactivate` it knows where the actuators stand, unless the positions are
    `distrust`ed. A reference that the device itself contradicts, by its end switches say, is
    refused.

    **Homing.** After `seek_reference` a device is configured without a reference: positions are
    ways from wherever it is, and the memory knows nothing until a reference is set and
    remembered by `remember`.

    A device defines `_open`, `_energise` and `_release` in place of `configure`, `activate` and
    `deactivate`.

    Attributes:
        position_signal: signal whose values mean something once there is a reference.
    """

    position_signal: str

    def __init__(self, path: str, size: int, part: str):
        """Prepares the memory; nothing is read or written.

        Args:
            path: file of the positions; "" for a device without a memory.
            size: number of actuators.
            part: part of the machine, as errors call it.
        """
        self._part, self._is_moving, self._is_measured = part, False, False
        self._is_homing = False
        self._memory = PositionMemory(Path(path), size, self.position_signal) if path else None

    @property
    @abstractmethod
    def is_referenced(self) -> bool:
        """Whether it is known which positions the counts mean."""

    def configure(self) -> None:
        """Opens the connection, sets up the device and recalls its reference.

        Even if that is refused the outputs are neutral afterwards: after a program that was killed
        they may hold.

        Raises:
            MissingExtra: the library is not installed.
            DeviceError: see `Device` and `PositionMemory.recall`; or there is no file, and the
                settings do not say the positions either.
        """
        self._open()
        if self._is_homing:
            return
        try:
            if self._memory is not None:
                self._recall(self._memory)
            if self.is_referenced and (why := self._contradiction()):
                raise DeviceError(self.name, f"{why}: find the reference with `parapod home`")
        except BaseException:
            self.close()
            raise

    def _recall(self, memory: PositionMemory) -> None:
        """Begins with the memory's positions, or else with those of the settings."""
        remembered, signal = memory.recall(), self.position_signal
        if remembered is not None:
            self.set_reference(remembered)
            self.remarks = [*self.remarks, memory.provenance]
        elif not self.is_referenced:
            raise DeviceError(
                self.name,
                f"the {self._part}' {signal}s are unknown: find them with `parapod home`, or "
                f"measure them and give {signal}_at_start_mm (there is no "
                f"{quoted_path(memory.path)} that knows them)",
            )
        self._is_measured = remembered is None

    def seek_reference(self) -> None:
        """Has the device configured without a reference, from the next time on.

        Raises:
            DeviceError: there is no file that would keep what is found.
        """
        if self._memory is None:
            raise DeviceError(self.name, f"has no {self.position_signal}_file to keep a reference")
        self._is_homing = True

    def remember(self, reference: str) -> None:
        """Has the memory know where the actuators stand without power, by a reference that is set.

        Args:
            reference: origin of the reference, such as "homed, again within 0.05 mm".

        Raises:
            DeviceError: the file cannot be written, or the device not be read.
        """
        assert self._memory is not None
        self._memory.save(self._at_rest(), reference)

    def activate(self) -> None:
        """Gives power to neutral outputs; from now on the memory knows nothing."""
        if self._memory is not None:
            self._memory.forget()
            self._is_moving = True
        self._energise()

    def deactivate(self) -> None:
        """Takes the power from the outputs; then the memory knows where the actuators stand."""
        self._release()
        if self._memory is not None and self._is_moving and not self._is_homing:
            self._memory.save(self._at_rest(), _BY_HAND if self._is_measured else None)
            self._is_moving = False

    def distrust(self) -> None:
        """Leaves the positions unknown to the memory, also when the device is deactivated."""
        self._is_moving = False

    def set_reference(self, values: Sequence[float]) -> None:
        """Makes the present counts mean these positions.

        Args:
            values: present positions [m or rad], as known from a reference: the ends of the
                strokes, or a measurement by hand.

        Raises:
            DeviceError: the encoders cannot be read.
            ValueError: not as many finite values as there are axes.
        """
        size = self.measures[self.position_signal]
        if len(values) != size or not all(map(math.isfinite, values)):
            what = f"{size} finite {self.position_signal}s"
            raise ValueError(f"{what} are needed, not {tuple(values)}")
        self._set_reference(values)
        self._is_measured = True

    def _contradiction(self) -> str:
        """Reason why the reference cannot be, by what else the device measures; "" if it can."""
        return ""

    def _at_rest(self) -> Sequence[float]:
        """Positions that do not change any more."""
        positions = None
        for _ in range(_LOOKS):
            sleep(_COASTING)
            before, positions = positions, self.read()[self.position_signal]
            if positions == before:
                break
        return positions or ()

    @abstractmethod
    def _open(self) -> None:
        """See `Device.configure`."""

    @abstractmethod
    def _energise(self) -> None:
        """See `Device.activate`."""

    @abstractmethod
    def _release(self) -> None:
        """See `Device.deactivate`."""

    @abstractmethod
    def _set_reference(self, values: Sequence[float]) -> None:
        """See `set_reference`; the values are good."""
