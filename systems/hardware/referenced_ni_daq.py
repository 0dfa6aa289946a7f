"""An NI card whose encoders' reference survives the end of a program."""

import time
from pathlib import Path

from parapod.systems.hardware.extension_memory import ExtensionMemory
from parapod.systems.hardware.ni_daq import NiDaq
from parapod.systems.hardware.ni_params import NiDaqParams

# Without power a rod stands still after this: ten mechanical time constants and more [s].
_COASTING = 0.05


class ReferencedNiDaq(NiDaq):
    """A `NiDaq` that begins with the extensions with which the last program ended.

    They are kept in a file (see `ExtensionMemory`). Without one the parameters'
    `extension_at_start` counts.
    """

    def __init__(self, params: NiDaqParams, path: Path):
        """Describes the card; nothing is opened.

        Args:
            params: of the card.
            path: of the file.
        """
        super().__init__(params)
        self._memory = ExtensionMemory(path, len(params.counters))
        self._is_moving = False

    def configure(self) -> None:
        """As `NiDaq`; refuses extensions that nobody knows.

        Even then the outputs are neutral afterwards: after a program that was killed they hold.

        Raises:
            DeviceError: see there, and `ExtensionMemory.recall`.
        """
        super().configure()
        try:
            known = self._memory.recall()
            if known is not None:
                self.set_extension(known)
        except BaseException:
            self.close()
            raise

    def activate(self) -> None:
        """As `NiDaq`; from now on the file knows nothing."""
        self._memory.forget()
        self._is_moving = True
        super().activate()

    def deactivate(self) -> None:
        """As `NiDaq`; then the file knows where the actuators stand."""
        super().deactivate()
        if self._is_moving:
            time.sleep(_COASTING)
            self._memory.save(self.read()["extension"])
            self._is_moving = False
