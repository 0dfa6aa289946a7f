"""An LCM of a test's own, on this computer."""

import socket
import time

import pytest

from parapod.systems.hardware.buses.address import LCM, Address
from parapod.systems.hardware.buses.bus import Inbox
from parapod.systems.hardware.buses.lcm import LcmBus
from parapod.systems.hardware.buses.message import Layout, Message, Signal

_PATIENCE = 5.0


def until(condition, patience=20.0):
    """Waits for what a thread or another program does."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(1e-3)


@pytest.fixture(scope="session")
def lcm_url():
    """Address of an LCM that no other test has; skips where no message comes back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        url = f"udpm://239.255.76.67:{free.getsockname()[1]}?ttl=0"
    one, other = LcmBus(Address(LCM, url)), LcmBus(Address(LCM, url))
    inbox = Inbox("HELLO", Layout({"word": Signal(1)}), 1e9, 1.0)
    one.subscribe(inbox)
    end = time.monotonic() + _PATIENCE
    while inbox.newest is None and time.monotonic() < end:
        other.publish("HELLO", Message(("word",), (1.0,), 1.0))
        time.sleep(0.01)
    one.close()
    other.close()
    if inbox.newest is None:
        pytest.skip("no multicast on this computer: LCM's messages do not come back")
    return url
