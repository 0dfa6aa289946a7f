"""Addresses of buses, as people give them."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted

if TYPE_CHECKING:
    from parapod.systems.hardware.buses.bus import Bus

LCM = "lcm"
KINDS = (LCM,)


class Address(NamedTuple):
    """A bus, and the machine on it.

    Attributes:
        kind: one of `KINDS`.
        place: address of the bus; "": the usual one.
        suffix: end of the channels' names, of one machine of several.
    """

    kind: str
    place: str = ""
    suffix: str = ""

    def open(self) -> "Bus":
        """Connects to the bus.

        Raises:
            DeviceError: see the kind's.
        """
        return _OPENERS[self.kind](self.place)


def is_address(text: str) -> bool:
    """Whether a text names a bus."""
    return text.partition(":")[0] in KINDS


def address_of(text: str, key: str) -> Address:
    """The address that a text names, such as "lcm", or "lcm://239.255.76.67:7667?ttl=0#_LEFT".

    Args:
        text: kind of the bus, place and, after #, the suffix of the channels.
        key: key of the scenario, or option, that has the text.

    Raises:
        ScenarioError: another kind.
    """
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise ScenarioError(f"{key} = {quoted(text)} must begin with {', '.join(KINDS)}", key)
    place, _, suffix = rest.removeprefix("//").partition("#")
    return Address(kind, place, suffix)


def _open_lcm(place: str) -> "Bus":
    from parapod.systems.hardware.buses.lcm import LcmBus

    return LcmBus(place if not place or ":/" in place else f"udpm://{place}")


_OPENERS: "dict[str, Callable[[str], Bus]]" = {LCM: _open_lcm}
