"""LCM by Drake's own client: a message of a part is one `lcmt_drake_signal`."""

import threading
from collections.abc import Sequence
from functools import partial
from typing import Any

from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.buses.bus import Bus, Inbox
from parapod.systems.hardware.buses.message import Message
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.device import DeviceError, DeviceFault

# Address of LCM's users, whose messages stay on this computer.
USUAL = "udpm://239.255.76.67:7667?ttl=0"
# Ways of LCM.
_PROVIDERS = ("udpm:", "memq:", "tcpq:", "mpudpm:")
# Channel on which LCM finds out whether messages come back.
_SELF_TEST = "LCM_SELF_TEST"
# Time between two looks for messages [s]: Drake's client keeps Python's lock while it waits.
_LOOK = 1e-3


class LcmBus(Bus):
    """A connection to LCM, at an address as Drake's `DrakeLcm` takes it.

    `coord` has the names of a message's values, `val` these, and `timestamp` the sender's time in
    microseconds. Messages to other computers are asked for: an address without `ttl` gets
    `ttl=0`.
    """

    def __init__(self, url: str = USUAL):
        """Connects.

        Args:
            url: such as "udpm://239.255.76.67:7667?ttl=0", or "memq://" within this program; "":
                the usual one.

        Raises:
            DeviceError: an address that LCM does not take.
        """
        from pydrake.lcm import DrakeLcm

        self.url = local(url)
        self.name = f"LCM {self.url}"
        if not self.url.startswith(_PROVIDERS):
            words = f"{quoted(url)} must begin with {', '.join(_PROVIDERS)}"
            raise DeviceError(self.name, words, DeviceFault.UNPLUGGED)
        self._lcm = DrakeLcm(self.url)
        # One connection to send by and one to receive by: they are used by two threads.
        self._sending = self._lcm if self._is_memory else DrakeLcm(self.url)
        if not (self._lcm.available() and self._sending.available()):
            words = f"LCM cannot be opened at {quoted(url)}"
            raise DeviceError(self.name, words, DeviceFault.UNPLUGGED)
        self._seen, self._own = set[str](), set[str]()
        self._inboxes: dict[str, list[Inbox]] = {}
        self._lock, self._over = threading.Lock(), threading.Event()
        # Between looks Drake's client keeps one message of a subscription; this one is for names.
        self._lcm.SubscribeAllChannels(self._see)
        self._thread = threading.Thread(target=self._receive, name=self.name, daemon=True)
        self._thread.start()

    @property
    def _is_memory(self) -> bool:
        return self.url.startswith("memq:")

    def publish(self, channel: str, message: Message) -> None:
        """See `Bus`."""
        signal = _message_type()()
        signal.dim, signal.timestamp = len(message.values), round(1e6 * message.stamp)
        signal.val, signal.coord = list(message.values), list(message.names)
        self._own.add(channel)
        with self._lock:
            self._sending.Publish(channel, signal.encode())

    def subscribe(self, inbox: Inbox) -> None:
        """See `Bus`."""
        with self._lock:
            if inbox.channel not in self._inboxes:
                self._lcm.Subscribe(inbox.channel, partial(self._take, inbox.channel))
            self._inboxes.setdefault(inbox.channel, []).append(inbox)

    def channels(self) -> Sequence[str]:
        """See `Bus`."""
        return sorted(self._seen - self._own)

    def close(self) -> None:
        """See `Bus`."""
        self._over.set()
        self._thread.join()

    def _receive(self) -> None:
        while not self._over.wait(_LOOK):
            with self._lock:
                self._lcm.HandleSubscriptions(0)

    def _see(self, channel: str, data: bytes) -> None:
        if channel != _SELF_TEST:
            self._seen.add(channel)

    def _take(self, channel: str, data: bytes) -> None:
        """Gives what has come to the inboxes; must not raise."""
        now, inboxes = monotonic(), self._inboxes[channel]
        try:
            signal = _message_type().decode(data)
        except Exception:
            for inbox in inboxes:
                words = f"a message of {len(data)} bytes is not of the type lcmt_drake_signal"
                inbox.refuse(words, now)
            return
        message = Message(signal.coord, signal.val, 1e-6 * signal.timestamp)
        for inbox in inboxes:
            inbox.take(message, now)


def _message_type() -> Any:
    """Drake's type of a message."""
    from drake import lcmt_drake_signal  # type: ignore[import-untyped]

    return lcmt_drake_signal


def local(url: str) -> str:
    """An address whose messages stay on this computer unless it says otherwise."""
    address = url or USUAL
    if not address.startswith("udpm:") or "ttl=" in address:
        return address
    return f"{address}{'&' if '?' in address else '?'}ttl=0"
