"""One name for a place that several addresses mean, so that programs see each other's locks."""

import ipaddress
import os
import re
import socket
import threading
from contextlib import suppress
from functools import cache

# Name of a server on this computer.
_HERE = "localhost"
# Longest wait for a name server that does not answer, as without a network [s].
_PATIENCE = 1.0
# Names that gRPC has for its ways to find a server.
_SCHEME = re.compile(r"^(dns:(//[^/]*/)?|ipv4:|ipv6:)", re.IGNORECASE)
_SERVER = re.compile(r"^(\[(?P<bracketed>[^\]]+)\]|(?P<host>[^:/]+))(:(?P<port>\d+))?$")


def normal_form(place: str) -> str:
    """A place in the form that all of its names have in common.

    Of a path it is the real one, whatever links lead there; of a server the address of its
    computer, `localhost` for this one. A host that cannot be found keeps its name.

    Args:
        place: absolute path; `unix:` and a path; name of a card, " at " and a server or socket;
            anything else is its own normal form.
    """
    card, at, server = place.rpartition(" at ")
    if place.startswith("/"):
        return os.path.realpath(place)
    if server.startswith("unix:"):
        path = re.sub("^unix:(//(?=/))?", "", server)
        return f"{card}{at}unix:{os.path.realpath(path)}"
    return f"{card}{at}{_server(server)}" if at else place


def _server(target: str) -> str:
    """Normal form of a server, as gRPC names it."""
    match = _SERVER.match(_SCHEME.sub("", target))
    if match is None:
        return target
    host, port = match["bracketed"] or match["host"], match["port"]
    return f"{_computer(host.lower().rstrip('.'))}:{port}"


@cache
def _computer(host: str) -> str:
    """Address of a computer, the same for all of its names that lead to the same addresses."""
    addresses = _addresses(host)
    if any(_is_here(address) for address in addresses):
        return _HERE
    return min(map(str, addresses), default=host)


def _addresses(host: str) -> list[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    """Addresses of a host; none if they cannot be found in time."""
    addresses: list[str] = []

    def ask() -> None:
        with suppress(OSError, UnicodeError):
            answers = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
            addresses.extend(str(address[0]) for *_, address in answers)

    # A name server that is not there is waited for in a thread, which may go on without us.
    asking = threading.Thread(target=ask, name="host", daemon=True)
    asking.start()
    asking.join(_PATIENCE)
    return [_unmapped(address) for address in tuple(addresses)]


def _unmapped(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """An address; of IPv4 as such, also where it is written as one of IPv6."""
    address_found = ipaddress.ip_address(address)
    return getattr(address_found, "ipv4_mapped", None) or address_found


def _is_here(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether an address is one of this computer's own; nothing is sent."""
    if address.is_loopback or address.is_unspecified:
        return True
    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.bind((str(address), 0))  # only a computer's own addresses can be bound
        return True
    return False
