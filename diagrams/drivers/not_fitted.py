"""The driver of a part that the machine does not have."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.systems.core.errors import ScenarioError

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class NotFittedPart(Driver):
    """A part that the machine does not have: commands are ignored, measurements are zero.

    Refused for the parts without which nothing may move.
    """

    is_timeless: ClassVar[bool] = True
    part: str = "arm"

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.device import NotFitted

        if self.part in ("legs", "imu"):
            raise ScenarioError(
                f"hardware.drivers: the machine does not work without its {self.part}",
                "hardware.drivers",
            )
        return NotFitted(self.part, ports.measures, ports.commands)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: nothing."""
        return nullcontext()
