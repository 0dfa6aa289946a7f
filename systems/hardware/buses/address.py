"""Addresses of buses, as people give them."""

from typing import NamedTuple

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted

LCM, ROS2 = "lcm", "ros2"
KINDS = (LCM, ROS2)
SUBNET = "range=subnet"
"""Option of an address of ROS 2: other computers are found."""
# Numbers of ROS 2's domains.
_DOMAINS = range(233)


class Channels(NamedTuple):
    """Names of the two channels of a part: its status, and its commands."""

    status: str
    command: str


class Address(NamedTuple):
    """A bus, and the machine on it.

    Attributes:
        kind: one of `KINDS`.
        place: address of the bus, such as LCM's URL, or ROS 2's domain; "": the usual one.
        suffix: end of LCM's channels, or namespace of ROS 2's topics, of one machine of several.
        status: topic of a part's status in place of the usual one; "": that.
    """

    kind: str
    place: str = ""
    suffix: str = ""
    status: str = ""

    def channels_of(self, part: str) -> Channels:
        """Names of a part's channels.

        Args:
            part: name of the part.
        """
        if self.kind == LCM:
            name = part.upper()
            return Channels(f"{name}_STATUS{self.suffix}", f"{name}_COMMAND{self.suffix}")
        name = f"/{self.suffix}/{part}" if self.suffix else f"/{part}"
        return Channels(self.status or f"{name}/status", f"{name}/command")


def is_address(text: str) -> bool:
    """Whether a text names a bus, of any kind: `address_of` says which are admissible."""
    return text.partition(":")[0] in KINDS or "://" in text


def address_of(text: str, key: str) -> Address:
    """The address that a text names.

    Examples are "lcm", "lcm://239.255.76.67:7667?ttl=0#_LEFT", "ros2://" and "ros2://42#left".

    Args:
        text: kind of the bus, place and, after #, the suffix of the channels.
        key: key of the scenario, or option, that has the text.

    Raises:
        ScenarioError: another kind, or a place that the kind does not have.
    """
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise ScenarioError(f"{key} = {quoted(text)} must begin with {' or '.join(KINDS)}", key)
    place, _, suffix = rest.removeprefix("//").partition("#")
    if kind == LCM:
        return Address(kind, place if not place or ":/" in place else f"udpm://{place}", suffix)
    domain, _, option = place.partition("?")
    is_domain = domain in ("", *map(str, _DOMAINS))
    if not is_domain or option not in ("", SUBNET):
        raise ScenarioError(
            f"{key} = {quoted(text)} must be ros2://DOMAIN?{SUBNET}#NAMESPACE, where DOMAIN is "
            f"0..{_DOMAINS[-1]} and each of the three may be left out",
            key,
        )
    if suffix and not all(part.isidentifier() and part.isascii() for part in suffix.split("/")):
        raise ScenarioError(
            f"{key} = {quoted(text)} must have a namespace of letters, digits and _", key
        )
    return Address(kind, place, suffix)
