"""Devices with encoders that know no absolute position, and need to be told it."""

import math
from abc import abstractmethod
from collections.abc import Sequence

from parapod.systems.hardware.device import Device


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
