"""The driver of a part that another program serves on LCM."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from zlib import crc32

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated
from parapod.systems.core.schema import quantity
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.buses.address import LCM, Address

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

# LCM's ports for emulators: one for each folder of an emulator.
_FIRST_PORT, _PORTS = 20_000, 20_000


@dataclass
class LcmPart(Driver):
    """A part that another program serves on LCM, as `parapod serve --lcm` does: see `BusPart`.

    Attributes:
        part: part of the machine.
        lcm_url: address of LCM, as Drake has it, such as udpm://239.255.76.67:7667?ttl=0; empty:
            LCM's usual one, on this computer.
        channel_suffix: end of the channels' names, of one machine of several.
        rate_Hz: messages of its status a second, at most [Hz].
        timeout_ms: age from which its newest message is too old [ms].
    """

    part: str = "legs"
    lcm_url: str = "emulator/lcm"
    channel_suffix: str = ""
    rate_Hz: float = quantity(200.0, 1.0, 2000.0)  # noqa: N815 (the unit's symbol)
    timeout_ms: float = quantity(100.0, 1.0, 10_000.0)

    @property
    def _address(self) -> Address:
        url, path = self.lcm_url, resolved(self.lcm_url)
        if path != url:
            port = _FIRST_PORT + crc32(path.encode()) % _PORTS
            url = f"udpm://239.255.76.67:{port}?ttl=0"
        return Address(LCM, url, self.channel_suffix)

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.buses.lcm import local
        from parapod.systems.hardware.buses.part import BusPart

        address = self._address
        return BusPart(
            *(self.part, address.open, ports.measures, ports.commands),
            fail_safe=ports.switches,
            place=local(resolved(self.lcm_url)),
            suffix=address.suffix,
            rate=self.rate_Hz,
            timeout=1e-3 * self.timeout_ms,
        )

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: the part as it serves itself."""
        from parapod.systems.hardware.buses.emulated_part import EmulatedBusPart

        emulated(self.lcm_url, f"!{type(self).__name__}.lcm_url")
        address = self._address
        return EmulatedBusPart(
            *(self.part, address.open, harness, misbehaviour),
            suffix=address.suffix,
            rate=self.rate_Hz,
        )


def parts_on_lcm(machine: Any) -> list[Driver]:
    """Drivers of all parts of a machine, each behind LCM.

    Args:
        machine: a `Machine`, as its scenario has it.
    """
    parts = dict.fromkeys(port.part for port in (*machine.inputs, *machine.measured))
    return [LcmPart(part=part) for part in parts]
