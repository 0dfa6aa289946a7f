"""A bus as this program sees it: channels to publish on, and inboxes that judge what comes."""

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, NamedTuple

from numpy.typing import ArrayLike
from pydrake.geometry import Shape
from pydrake.math import RigidTransform

from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.message import Layout, Message, WrongMessage
from parapod.systems.hardware.device import DeviceFault

type Poses = Mapping[str, tuple[ArrayLike, ArrayLike]]

# A sender's clock that goes on by so much more or less than ours has jumped [s].
JUMP = 1.0
# Messages that come so much more often than they may are those of two senders [-], and so are so
# many that come out of order of those [-] of a time [s].
_CROWD, _MIXED, _COUNTED = 1.5, 0.2, 0.5


class Visual(NamedTuple):
    """One solid by which a body is seen.

    Attributes:
        shape: a box, sphere, cylinder, ellipsoid or mesh of Drake's.
        pose: its pose in the body's frame.
        colour: (4,) red, green, blue and opacity, from 0 to 1.
    """

    shape: Shape
    pose: RigidTransform
    colour: tuple[float, float, float, float]


class Received(NamedTuple):
    """A message that was accepted.

    Attributes:
        signals: values by the signals' names.
        message: message as it came.
        arrived: time of devices (`clock.monotonic`) at which it did [s].
    """

    signals: dict[str, tuple[float, ...]]
    message: Message
    arrived: float


class Problem(NamedTuple):
    """Fault of a channel, and its words."""

    fault: DeviceFault
    words: str


class Inbox:
    """Newest message of a channel, and what is wrong with those that came.

    A message that came before, or is older than the newest, is ignored and counted. One of other
    names or sizes, or with a value that is not finite, is a fault for as long as a message may be
    late; so is a clock of the sender that jumps, and so are two senders on one channel: known by
    messages of one time that differ, by a fifth of them that is out of order, or by messages that
    come half as often again as they may.

    Attributes:
        channel: name of the channel.
        layout: signals of its messages.
        newest: the newest message that was accepted; None before the first.
        ignored: number of messages that came twice, and of those that came out of order.
        on_taken: called when there is a newer one, from the thread that receives.
    """

    def __init__(self, channel: str, layout: Layout, rate: float, timeout: float):
        """Opens an empty inbox.

        Args:
            channel: name of the channel.
            layout: signals that its messages have.
            rate: messages a second that its sender publishes, at most [Hz]; infinite: any number.
            timeout: age from which the newest message is too old [s].
        """
        self.channel, self.layout = channel, layout
        self.newest: Received | None = None
        self.ignored = [0, 0]
        self.on_taken: Callable[[], None] | None = None
        self._timeout = timeout
        self._most = _CROWD * rate * _COUNTED + 2.0
        self._wrong: tuple[float, str] | None = None
        self._arrivals: deque[tuple[float, bool]] = deque()
        self._older = 0  # of them, out of order

    def take(self, message: Message, arrived: float) -> None:
        """Judges a message.

        Args:
            message: message as it came.
            arrived: time of devices at which it did [s].
        """
        last = self.newest
        has_stamps = last is not None and message.stamp > 0.0 and last.message.stamp > 0.0
        ahead = message.stamp - last.message.stamp if last is not None and has_stamps else 1.0
        self._look_for_two(arrived, -JUMP < ahead < 0.0)
        try:
            signals = self.layout.unpack(message)
        except WrongMessage as error:
            self.refuse(str(error), arrived)
            return
        if last is not None and has_stamps:
            if -JUMP < ahead <= 0.0:
                self.ignored[0 if ahead == 0.0 else 1] += 1
                if ahead == 0.0 and signals != last.signals:
                    self.refuse("two messages of one time, as of two senders", arrived)
                return
            if abs(ahead - (arrived - last.arrived)) > JUMP:
                self.refuse(f"the sender's clock has jumped by {ahead:+.3g} s", arrived)
        self.newest = Received(signals, message, arrived)
        if self.on_taken is not None:
            self.on_taken()

    @property
    def interval(self) -> float:
        """Mean time between the messages of the last half second [s]; infinite before two came."""
        arrivals = self._arrivals
        count = len(arrivals) - 1
        return (arrivals[-1][0] - arrivals[0][0]) / count if count > 0 else math.inf

    def _look_for_two(self, arrived: float, is_older: bool) -> None:
        """Refuses messages that come as those of two senders do."""
        arrivals = self._arrivals
        arrivals.append((arrived, is_older))
        self._older += is_older
        while arrivals[0][0] < arrived - _COUNTED:
            self._older -= arrivals.popleft()[1]
        count, older = len(arrivals), self._older
        if count > self._most:
            self.refuse(f"{count / _COUNTED:.0f} messages a second, as of two senders", arrived)
        elif older > max(2.0, _MIXED * count):
            self.refuse(f"{older} of {count} messages out of order, as of two senders", arrived)

    def refuse(self, words: str, arrived: float) -> None:
        """Notes what is wrong with a message.

        Args:
            words: fault, to follow the name of the channel.
            arrived: time of devices [s].
        """
        self._wrong = arrived, words

    def problem(self, now: float) -> Problem | None:
        """Fault of the channel now; None if it has none.

        Args:
            now: time of devices [s].
        """
        if self._wrong is not None and now - self._wrong[0] <= self._timeout:
            return Problem(DeviceFault.CORRUPT, f"{self.channel}: {self._wrong[1]}")
        if self.newest is None:
            return Problem(DeviceFault.SILENT, f"no message on {self.channel} yet")
        age = now - self.newest.arrived
        if age > self._timeout:
            return Problem(DeviceFault.SILENT, f"no message on {self.channel} for {age:.2g} s")
        return None


class Bus(ABC):
    """A connection to a bus; a thread of its own receives.

    Several parts may share one: see `connect`. A kind of bus overrides `advertise`, `also`,
    `tell`, `describe`, `is_watched` and `place` if it has a use for them.

    Attributes:
        name: kind and address, as errors call it.
        address: address of the bus, which names the channels.
        draws: true if its tools draw machines by `describe` and `place`.
    """

    draws: ClassVar[bool] = False

    name: str

    def __init__(self, address: Address):
        """Begins with one user and no inbox.

        Args:
            address: address of the bus.
        """
        self.address = address
        self._inboxes: dict[str, tuple[Inbox, ...]] = {}
        self._users, self._sharing = 1, threading.Lock()

    def share(self) -> bool:
        """Counts one more user, unless the connection has ended; true if it has not."""
        with self._sharing:
            self._users += bool(self._users)
            return self._users > 0

    def close(self) -> None:
        """Ends one use of the connection, and with the last the connection; never raises."""
        with self._sharing:
            self._users -= 1
            is_over = self._users == 0
        if is_over:
            self._end()

    def subscribe(self, inbox: Inbox) -> None:
        """Has an inbox take the messages of its channel from here on."""
        with self._sharing:
            others = self._inboxes.get(inbox.channel)
            self._inboxes[inbox.channel] = (*(others or ()), inbox)
        if others is None:
            self._listen(inbox.channel)

    def unsubscribe(self, inbox: Inbox) -> None:
        """Has an inbox take nothing any more."""
        with self._sharing:
            others = self._inboxes.get(inbox.channel, ())
            self._inboxes[inbox.channel] = tuple(one for one in others if one is not inbox)

    def advertise(self, channel: str, layout: Layout) -> None:  # noqa: B027
        """Prepares for messages of a part's status; buses with types of their own need it.

        Args:
            channel: channel of the status.
            layout: its signals, with their units.
        """

    def also(self, layout: Layout) -> Sequence[str]:
        """Types of standard messages that may come in place of a part's own.

        Args:
            layout: signals that follow from them.
        """
        return ()

    def tell(self, time: float, is_stopped: bool) -> None:  # noqa: B027
        """Tells of an instant, once its messages are published.

        Args:
            time: time of the machine [s].
            is_stopped: true if an emergency stop of the machine is pressed.
        """

    def describe(self, urdf: str, visuals: Mapping[str, Sequence[Visual]]) -> None:  # noqa: B027
        """Tells how the machine looks, on buses whose tools draw it.

        Args:
            urdf: text of a URDF, whose links are the bodies.
            visuals: solids of each body.
        """

    def place(self, poses: Poses, time: float) -> None:  # noqa: B027
        """Tells where the bodies of the description are.

        Args:
            poses: position (3) [m] and quaternion (w, x, y, z) of each body in the world.
            time: time of the machine [s].
        """

    @property
    def is_watched(self) -> bool:
        """Whether somebody on the bus looks at the machine."""
        return False

    @property
    def stop(self) -> str:
        """Reason for which others on the bus have all parts stopped; "" while they do not."""
        return ""

    @abstractmethod
    def publish(self, channel: str, message: Message) -> None:
        """Sends a message.

        Raises:
            DeviceError: it cannot be sent.
        """

    @abstractmethod
    def channels(self) -> Sequence[str]:
        """Channels on which others have published, at least from the first call on."""

    @abstractmethod
    def _listen(self, channel: str) -> None:
        """Has the inboxes of a channel take its messages from here on."""

    @abstractmethod
    def _end(self) -> None:
        """Ends the connection; never raises."""
