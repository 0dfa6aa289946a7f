"""Positions of self-locking actuators, from the end of one program to the next.

Incremental encoders forget where they are; self-locking screws stay there.
"""

import json
import math
import os
import time
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path

from parapod.systems.hardware.device import Device, DeviceError, Signals


class PositionMemory:
    """A file that knows the positions of actuators while nothing can move them.

    Incremental encoders forget where they are; self-locking screws stay there. While the drives
    have power the file says only that it knows nothing, so a program that is killed leaves no
    wrong positions behind, and the next one refuses to begin.

    Attributes:
        path: of the file; its folder must exist.
        signal: that is remembered, as "position": errors and the scenario's keys are named
            after it.
    """

    def __init__(self, path: Path, size: int, signal: str = "position"):
        """Creates the memory; nothing is read or written.

        Args:
            path: of the file.
            size: number of actuators.
            signal: see the class.
        """
        self.path, self.signal, self._size = Path(path), signal, size
        self._key = f"{signal}_m"

    def recall(self) -> tuple[float, ...] | None:
        """The positions [m]; None if there is no file.

        Raises:
            DeviceError: the file says that they are not known, or is none of ours.
        """
        try:
            known = json.loads(self.path.read_text(encoding="utf-8"))[self._key]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise self._refused(f"cannot be read: {error}") from None
        if known is None:
            raise self._refused(
                "says that the last program ended while the drives had power, so nobody knows the "
                f"{self.signal}s; measure them, and delete the file to begin with what you "
                f"measured, given as {self.signal}_at_start_mm"
            )
        is_list = isinstance(known, list) and len(known) == self._size
        if not is_list or not all(isinstance(x, float) and math.isfinite(x) for x in known):
            raise self._refused(f"must have {self._size} {self.signal}s, not {known}")
        return tuple(known)

    def forget(self) -> None:
        """From now on the positions are not known.

        Raises:
            DeviceError: the file cannot be written.
        """
        self._write(None)

    def save(self, positions: Sequence[float]) -> None:
        """The drives have no power and the actuators stand still, here [m].

        Raises:
            DeviceError: the file cannot be written.
        """
        self._write([float(x) for x in positions])

    def _write(self, positions: list[float] | None) -> None:
        text = json.dumps({self._key: positions}) + "\n"
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
        return DeviceError(f"{self.signal}s' file '{self.path}'", why)


class IncrementalDevice(Device):
    """A device whose encoders count from wherever they are.

    Attributes:
        position_signal: the signal whose values mean something once there is a reference.
    """

    position_signal: str

    @property
    @abstractmethod
    def is_referenced(self) -> bool:
        """Whether it is known which positions the counts mean."""

    def set_reference(self, values: Sequence[float]) -> None:
        """Makes the present counts mean these positions.

        Args:
            values: what the positions are now [m or rad], as known from a reference: the ends of
                the strokes, or a measurement by hand.

        Raises:
            DeviceError: the encoders cannot be read.
            ValueError: not as many finite values as there are axes.
        """
        size = self.measures[self.position_signal]
        if len(values) != size or not all(map(math.isfinite, values)):
            what = f"{size} finite {self.position_signal}s"
            raise ValueError(f"{what} are needed, not {tuple(values)}")
        self._set_reference(values)

    @abstractmethod
    def _set_reference(self, values: Sequence[float]) -> None:
        """As `set_reference`, with values that are good."""


# Without power an actuator stands still after this: ten mechanical time constants and more [s].
_COASTING = 0.05
# So many times it is looked whether that is so; an encoder on an edge may never be quiet.
_LOOKS = 10


class Referenced(Device):
    """A device that begins with the positions with which the last program ended.

    They are kept in a file (see `PositionMemory`). While there is none, a reference that the
    device has by itself counts, from its parameters; without that either, nobody knows the
    positions, and nothing begins.

    Attributes:
        device: that is referenced.
    """

    def __init__(self, device: IncrementalDevice, path: Path, part: str = "legs"):
        """Describes the device; nothing is opened.

        Args:
            device: with incremental encoders.
            path: of the file.
            part: of the machine, as errors call it.
        """
        self.device, self._part = device, part
        self.name, self.measures, self.commands = device.name, device.measures, device.commands
        signal = device.position_signal
        self._memory = PositionMemory(path, device.measures[signal], signal)
        self._is_moving = False

    def configure(self) -> None:
        """As the device; refuses positions that nobody knows.

        Even then the outputs are neutral afterwards: after a program that was killed they may
        hold.

        Raises:
            DeviceError: see there, and `PositionMemory.recall`; or there is no file, and the
                parameters do not say it either.
        """
        self.device.configure()
        signal = self.device.position_signal
        try:
            known = self._memory.recall()
            if known is not None:
                self.device.set_reference(known)
            elif not self.device.is_referenced:
                raise DeviceError(
                    self.name,
                    f"nobody knows the {self._part}' {signal}s: measure them and give "
                    f"{signal}_at_start_mm (there is no '{self._memory.path}' that knows them)",
                )
        except BaseException:
            self.close()
            raise

    def activate(self) -> None:
        """As the device; from now on the file knows nothing."""
        self._memory.forget()
        self._is_moving = True
        self.device.activate()

    def read(self) -> Signals:
        """As the device."""
        return self.device.read()

    def write(self, commands: Signals) -> None:
        """As the device."""
        self.device.write(commands)

    def neutral(self) -> None:
        """As the device."""
        self.device.neutral()

    def deactivate(self) -> None:
        """As the device; then the file knows where the actuators stand."""
        self.device.deactivate()
        if self._is_moving:
            self._memory.save(self._at_rest())
            self._is_moving = False

    def _at_rest(self) -> Sequence[float]:
        """Positions that do not change any more."""
        signal, positions = self.device.position_signal, None
        for _ in range(_LOOKS):
            time.sleep(_COASTING)
            before, positions = positions, self.device.read()[signal]
            if positions == before:
                break
        return positions or ()

    def close(self) -> None:
        """As the device."""
        self.device.close()
