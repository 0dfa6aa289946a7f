"""Drivers of parts that another program serves on a bus: LCM, or ROS 2."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self
from zlib import crc32

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.buses.address import LCM, ROS2, Address, address_of

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

# LCM's ports for emulators: one for each folder of an emulator; and ROS 2's domains for them.
_FIRST_PORT, _PORTS = 20_000, 20_000
_FIRST_DOMAIN, _DOMAINS = 1, 100
# Share of the messages that a part may send, that an emulator sends [-].
_EMULATED = 0.5


@dataclass
class _BusPart(Driver):
    """A part that another program serves: see `BusPart`.

    Attributes:
        part: part of the machine.
        rate_Hz: messages of its status a second, at most; an emulator sends half as many [Hz].
        timeout_ms: age from which its newest message is too old [ms].
        key: key that has the address.
    """

    is_program: ClassVar[bool] = True
    key: ClassVar[str]
    part: str = "legs"
    rate_Hz: float = quantity(200.0, 1.0, 2000.0)  # noqa: N815 (the unit's symbol)
    timeout_ms: float = quantity(100.0, 1.0, 10_000.0)

    @property
    def _address(self) -> Address:
        """Address of the bus."""
        raise NotImplementedError

    @property
    def _place(self) -> str:
        """Address for the lock against a second controller."""
        raise NotImplementedError

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.buses.message import Signal
        from parapod.systems.hardware.buses.part import BusPart

        measures, commands = (
            {name: Signal(size, ports.units.get(name, "")) for name, size in sizes.items()}
            for sizes in (ports.measures, ports.commands)
        )
        return BusPart(
            *(self.part, self._address, measures, commands),
            fail_safe=ports.switches,
            place=self._place,
            rate=self.rate_Hz,
            timeout=1e-3 * self.timeout_ms,
        )

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: the part as it serves itself."""
        from parapod.systems.hardware.buses.emulated_part import EmulatedBusPart

        emulated(getattr(self, self.key), f"!{type(self).__name__}.{self.key}")
        return EmulatedBusPart(
            *(self.part, self._address, harness, misbehaviour), rate=_EMULATED * self.rate_Hz
        )


@dataclass
class LcmBus(Schema):
    """A bus of LCM with a name; keys are those of Drake's `DrakeLcmParams`.

    Attributes:
        name: its name.
        lcm_url: address of LCM, as Drake has it, such as udpm://239.255.76.67:7667?ttl=0; empty:
            LCM's usual one, on this computer.
        channel_suffix: end of the channels' names, of one machine of several.
    """

    name: str = "default"
    lcm_url: str = ""
    channel_suffix: str = ""

    @property
    def address(self) -> Address:
        """Address of the bus."""
        return Address(LCM, self.lcm_url, self.channel_suffix)


def bus_named(buses: Sequence[LcmBus], name: str, key: str) -> LcmBus:
    """The bus of a name.

    Args:
        buses: buses that there are.
        name: the name.
        key: key of the scenario that has it.

    Raises:
        ScenarioError: there is none.
    """
    named = {bus.name: bus for bus in buses}
    if name not in named:
        there = f"one of lcm_buses: {', '.join(named)}" if named else "there: lcm_buses is empty"
        raise ScenarioError(f"{key} = {quoted(name)} is not {there}", key)
    return named[name]


@dataclass
class LcmPart(_BusPart):
    """A part that another program serves on LCM, as `parapod serve --lcm` does: see `BusPart`.

    Attributes:
        lcm_url: address of LCM, as Drake has it, such as udpm://239.255.76.67:7667?ttl=0; empty:
            LCM's usual one, on this computer.
        channel_suffix: end of the channels' names, of one machine of several.
        lcm_bus: name of one of `hardware.lcm_buses`, whose address and suffix count in place of
            these; empty: none.
    """

    key: ClassVar[str] = "lcm_url"
    lcm_url: str = "emulator/lcm"
    channel_suffix: str = ""
    lcm_bus: str = ""

    def on_bus(self, bus: LcmBus) -> Self:
        """The driver with the address of a bus.

        Args:
            bus: the bus.
        """
        return replace(self, lcm_url=bus.lcm_url, channel_suffix=bus.channel_suffix)

    @property
    def _address(self) -> Address:
        url, path = self.lcm_url, resolved(self.lcm_url)
        if path != url:
            port = _FIRST_PORT + crc32(path.encode()) % _PORTS
            url = f"udpm://239.255.76.67:{port}?ttl=0"
        return Address(LCM, url, self.channel_suffix)

    @property
    def _place(self) -> str:
        from parapod.systems.hardware.buses.lcm import local

        return local(resolved(self.lcm_url))


@dataclass
class Ros2Part(_BusPart):
    """A part that another program serves on ROS 2, as `parapod serve --ros2` does: see `BusPart`.

    Its status may also be a standard message that has all its signals, such as the JointState of
    another machine's driver.

    Attributes:
        ros2_graph: domain and namespace, such as ros2://42#left; ros2:// has the domain of the
            environment and no namespace, and ros2://42?range=subnet finds other computers.
        status_topic: topic of the part's status, such as /joint_states; empty: /PART/status.
    """

    key: ClassVar[str] = "ros2_graph"
    ros2_graph: str = "emulator/ros2"
    status_topic: str = ""

    @property
    def _address(self) -> Address:
        path = resolved(self.ros2_graph)
        if path != self.ros2_graph:
            number = crc32(path.encode())
            domain, space = _FIRST_DOMAIN + number % _DOMAINS, f"emulator_{number:08x}"
            return Address(ROS2, str(domain), space)
        address = address_of(self.ros2_graph, f"!{type(self).__name__}.ros2_graph")
        return address._replace(status=self.status_topic)

    @property
    def _place(self) -> str:
        path = resolved(self.ros2_graph)
        domain = self._address.place.partition("?")[0]
        return path if path != self.ros2_graph else f"{ROS2}://{domain}"


PARTS: dict[str, type[Driver]] = {LCM: LcmPart, ROS2: Ros2Part}
"""Drivers of parts by the kind of their bus."""


def parts_on_bus(machine: Any, kind: str) -> list[Driver]:
    """Drivers of all parts of a machine, each behind a bus.

    Args:
        machine: a `Machine`, as its scenario has it.
        kind: kind of the bus, see `PARTS`.
    """
    parts = dict.fromkeys(port.part for port in (*machine.inputs, *machine.measured))
    return [PARTS[kind](part=part) for part in parts]
