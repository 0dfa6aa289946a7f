"""A part that a machine has a port for and does not have."""

from collections.abc import Mapping

from parapod.systems.hardware.device import Device, Signals


class NotFitted(Device):
    """Takes commands and does nothing; shows zeros."""

    def __init__(self, name: str, measures: Mapping[str, int], commands: Mapping[str, int]):
        """Creates it.

        Args:
            name: of the part.
            measures: signals that are shown as zeros, and their sizes.
            commands: signals that are ignored, and their sizes.
        """
        self.name = f"{name} (not fitted)"
        self.measures, self.commands = dict(measures), dict(commands)

    def configure(self) -> None:
        """Does nothing."""

    def read(self) -> Signals:
        """Zeros."""
        return {name: (0.0,) * size for name, size in self.measures.items()}

    def close(self) -> None:
        """Does nothing."""
