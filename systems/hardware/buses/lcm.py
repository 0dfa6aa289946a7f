"""LCM by Drake's own client: a message of a part is one `lcmt_drake_signal`."""

import struct
import threading
from collections.abc import Sequence
from functools import cache, lru_cache, partial
from time import sleep

from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.buses.address import LCM, Address
from parapod.systems.hardware.buses.bus import Bus
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

    def __init__(self, address: Address = Address(LCM)):
        """Connects.

        Args:
            address: its place is such as "udpm://239.255.76.67:7667?ttl=0", or "memq://" within
                this program; "": the usual one.

        Raises:
            DeviceError: an address that LCM does not take.
        """
        from pydrake.lcm import DrakeLcm

        super().__init__(address)
        url = address.place
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
        self._lock, self._over, self._notes = threading.Lock(), False, False
        self._thread = threading.Thread(target=self._receive, name=self.name, daemon=True)
        self._thread.start()

    @property
    def _is_memory(self) -> bool:
        return self.url.startswith("memq:")

    def publish(self, channel: str, message: Message) -> None:
        """See `Bus`."""
        self._own.add(channel)
        data = encoded(message)
        with self._lock:
            self._sending.Publish(channel, data)

    def channels(self) -> Sequence[str]:
        """See `Bus`: from the first call on, because every message is then looked at."""
        with self._lock:
            if not self._notes:
                # Apart from those of inboxes: between looks Drake's client keeps one message of a
                # subscription.
                self._lcm.SubscribeAllChannels(self._see)
            self._notes = True
        return sorted(self._seen - self._own)

    def _listen(self, channel: str) -> None:
        """See `Bus`."""
        with self._lock:
            self._lcm.Subscribe(channel, partial(self._take, channel))

    def _end(self) -> None:
        """See `Bus`."""
        self._over = True
        self._thread.join()

    def _receive(self) -> None:
        while not self._over:
            sleep(_LOOK)
            with self._lock:
                self._lcm.HandleSubscriptions(0)

    def _see(self, channel: str, data: bytes) -> None:
        if channel != _SELF_TEST:
            self._seen.add(channel)

    def _take(self, channel: str, data: bytes) -> None:
        """Gives what has come to the inboxes; must not raise."""
        now, inboxes = monotonic(), self._inboxes[channel]
        try:
            message = decoded(data)
        except (ValueError, struct.error):
            for inbox in inboxes:
                words = f"a message of {len(data)} bytes is not of the type lcmt_drake_signal"
                inbox.refuse(words, now)
            return
        for inbox in inboxes:
            inbox.take(message, now)


def encoded(message: Message) -> bytes:
    """A message as `lcmt_drake_signal`; Drake's own way takes ten times as long."""
    count = len(message.values)
    if len(message.names) != count:
        raise ValueError(f"{len(message.names)} names for {count} values")
    numbers = struct.pack(f">i{count}d", count, *message.values)
    stamp = struct.pack(">q", round(1e6 * message.stamp))
    return b"".join((_fingerprint(), numbers, _packed(tuple(message.names)), stamp))


def decoded(data: bytes) -> Message:
    """The message in an `lcmt_drake_signal`.

    Raises:
        ValueError: data of another type.
        struct.error: data that end too early.
    """
    if data[:8] != _fingerprint():
        raise ValueError("data of another type")
    (count,) = struct.unpack_from(">i", data, 8)
    values = struct.unpack_from(f">{count}d", data, 12)
    names = _unpacked(data[12 + 8 * count : -8], count)
    (microseconds,) = struct.unpack_from(">q", data, len(data) - 8)
    return Message(names, values, 1e-6 * microseconds)


@cache
def _fingerprint() -> bytes:
    """Beginning of all messages of Drake's type."""
    from drake import lcmt_drake_signal  # type: ignore[import-untyped]

    fingerprint: bytes = lcmt_drake_signal._get_packed_fingerprint()
    return fingerprint


@lru_cache(maxsize=256)
def _packed(names: tuple[str, ...]) -> bytes:
    texts = [name.encode() + b"\0" for name in names]
    return b"".join(struct.pack(">i", len(text)) + text for text in texts)


@lru_cache(maxsize=256)
def _unpacked(data: bytes, count: int) -> tuple[str, ...]:
    names, at = [], 0
    for _ in range(count):
        (size,) = struct.unpack_from(">i", data, at)
        text = data[at + 4 : at + 4 + size]
        if len(text) != size or text[-1:] != b"\0":
            raise ValueError("a name ends too early")
        names.append(text[:-1].decode())
        at += 4 + size
    if at != len(data):
        raise ValueError("there is more than the names")
    return tuple(names)


def local(url: str) -> str:
    """An address whose messages stay on this computer unless it says otherwise."""
    address = url or USUAL
    if not address.startswith("udpm:") or "ttl=" in address:
        return address
    return f"{address}{'&' if '?' in address else '?'}ttl=0"
