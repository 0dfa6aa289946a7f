"""A device whose encoders' reference survives the end of a program."""

import time
from collections.abc import Sequence
from pathlib import Path

from parapod.systems.core.quoting import quoted_path
from parapod.systems.hardware.device import Device, DeviceError, Signals
from parapod.systems.hardware.incremental_device import IncrementalDevice
from parapod.systems.hardware.position_memory import PositionMemory

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
                    f"{signal}_at_start_mm (there is no {quoted_path(self._memory.path)} that "
                    "knows them)",
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
