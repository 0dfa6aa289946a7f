"""Connections to buses of all kinds, by their addresses."""

from parapod.systems.hardware.buses.address import LCM, Address
from parapod.systems.hardware.buses.bus import Bus


def connect(address: Address, name: str = "parapod") -> Bus:
    """Connects to a bus.

    Args:
        address: its address.
        name: name of the connection, as ROS 2 shows its nodes.

    Raises:
        DeviceError: see the kind's.
        MissingExtra: ROS 2 is not installed.
    """
    if address.kind == LCM:
        from parapod.systems.hardware.buses.lcm import LcmBus

        return LcmBus(address)
    from parapod.systems.hardware.buses.ros2.bus import Ros2Bus

    return Ros2Bus(address, name)
