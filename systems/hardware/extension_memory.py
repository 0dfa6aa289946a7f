"""What the extensions of self-locking actuators were when a program ended, for the next one."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path

from parapod.systems.hardware.device import DeviceError


class ExtensionMemory:
    """A file that knows the extensions while nothing can move them.

    Incremental encoders forget where they are; self-locking screws stay there. While the drives
    have power the file says only that it knows nothing, so a program that is killed leaves no
    wrong extensions behind, and the next one refuses to begin.
    """

    def __init__(self, path: Path, size: int):
        """Creates the memory; nothing is read or written.

        Args:
            path: of the file; its folder must exist.
            size: number of actuators.
        """
        self.path, self._size = Path(path), size

    def recall(self) -> tuple[float, ...] | None:
        """The extensions [m]; None if there is no file.

        Raises:
            DeviceError: the file says that they are not known, or is none of ours.
        """
        try:
            known = json.loads(self.path.read_text(encoding="utf-8"))["extension_m"]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise self._refused(f"cannot be read: {error}") from None
        if known is None:
            raise self._refused(
                "says that the last program ended while the drives had power, so nobody knows the "
                "extensions; measure them, and delete the file to begin from the scenario's "
                "extension_at_start_mm"
            )
        is_list = isinstance(known, list) and len(known) == self._size
        if not is_list or not all(isinstance(x, float) and math.isfinite(x) for x in known):
            raise self._refused(f"must have {self._size} extensions, not {known}")
        return tuple(known)

    def forget(self) -> None:
        """From now on the extensions are not known.

        Raises:
            DeviceError: the file cannot be written.
        """
        self._write(None)

    def save(self, extension: Sequence[float]) -> None:
        """The drives have no power and the actuators stand still, here [m].

        Raises:
            DeviceError: the file cannot be written.
        """
        self._write([float(x) for x in extension])

    def _write(self, extension: list[float] | None) -> None:
        text = json.dumps({"extension_m": extension}) + "\n"
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
        return DeviceError(f"extensions' file '{self.path}'", why)
