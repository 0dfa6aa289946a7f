"""Where self-locking actuators stood when a program ended, for the next one."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path

from parapod.systems.core.quoting import quoted_path, show
from parapod.systems.hardware.device import DeviceError


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
            raise self._refused(f"must have {self._size} {self.signal}s, not {show(known)}")
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
        return DeviceError(f"{self.signal}s' file {quoted_path(self.path)}", why)
