"""Connections to buses of all kinds, by their addresses."""

import threading
from weakref import WeakValueDictionary

from parapod.systems.hardware.buses.address import LCM, Address
from parapod.systems.hardware.buses.bus import Bus

_OPEN = WeakValueDictionary[tuple[Address, str], Bus]()
_LOCK = threading.Lock()


def connect(address: Address, name: str = "parapod") -> Bus:
    """Connects to a bus, by the connection of this name that there is, if one is open.

    All parts of a machine have one thread that receives, and one node in a graph of ROS 2.

    Args:
        address: its address.
        name: name of the connection, as ROS 2 shows its nodes.

    Raises:
        DeviceError: see the kind's.
        MissingExtra: ROS 2 is not installed.
    """
    key = address._replace(status=""), name
    with _LOCK:
        bus = _OPEN.get(key)
        if bus is None or not bus.share():
            bus = _OPEN[key] = _opened(*key)
        return bus


def _opened(address: Address, name: str) -> Bus:
    """A connection of its own."""
    if address.kind == LCM:
        from parapod.systems.hardware.buses.lcm import LcmBus

        return LcmBus(address)
    from parapod.systems.hardware.buses.ros2.bus import Ros2Bus

    return Ros2Bus(address, name)
