"""The driver of a part that there is not."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.device import Device, NotFitted
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class NotFittedPart(Driver):
    """A part that the machine does not have: commands are ignored, measurements are zero.

    Refused for the parts without which nothing may move.
    """

    part: str = "arm"

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        if self.part in ("legs", "imu"):
            raise ScenarioError(
                f"hardware.drivers: the machine does not work without its {self.part}",
                "hardware.drivers",
            )
        return NotFitted(self.part, ports.measures, ports.commands)

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: nothing."""
        return nullcontext()
