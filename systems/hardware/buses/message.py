"""Messages of one part of a machine: names and values of its signals, and the time of them."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from parapod.systems.core.errors import ParapodError

ACTIVE = "active"
"""Name in messages of commands: 1 while the sender controls the part; 0: it is to be neutral."""


type Twist = Sequence[Sequence[float]]


class Message(NamedTuple):
    """Names and values, as they come over a bus.

    Attributes:
        names: names (n), such as "position[0]"; of a signal of one element its own.
        values: values (n), in SI units and radians.
        stamp: time by the sender's clock [s]; 0: it tells none.
    """

    names: Sequence[str]
    values: Sequence[float]
    stamp: float


class WrongMessage(ParapodError):
    """A message that is not what its receiver needs; the text names both."""


class Layout:
    """Signals of a part with their sizes, as names in messages.

    Attributes:
        part: name of the part.
        sizes: number of elements of each signal.
        units: unit of each signal, as its port declares it; "" where that is not known.
        twists: values (n, 2) of signals by forward speed [m/s] and yaw rate [rad/s] of the
            machine; of those that follow from them.
        names: names of all elements, in order.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        units: Mapping[str, str] | None = None,
        part: str = "",
        twists: Mapping[str, Twist] | None = None,
    ):
        """Names the elements.

        Args:
            sizes: number of elements of each signal, by its name within the part.
            units: units of signals.
            part: name of the part.
            twists: see above; those of other signals do not count.
        """
        self.part = part
        self.sizes = dict(sizes)
        self.units = {name: (units or {}).get(name, "") for name in self.sizes}
        self.twists = {n: twist for n, twist in (twists or {}).items() if n in self.sizes}
        self.names = tuple(
            f"{signal}[{i}]" if size > 1 else signal
            for signal, size in self.sizes.items()
            for i in range(size)
        )

    def pack(self, signals: Mapping[str, Sequence[float]]) -> list[float]:
        """Values of all elements, in the order of `names`."""
        return [float(value) for signal in self.sizes for value in signals[signal]]

    def unpack(self, message: Message) -> dict[str, tuple[float, ...]]:
        """Signals of a message, which may have further ones and another order.

        Raises:
            WrongMessage: an element that is missing, or is not finite.
        """
        names, values = tuple(message.names), message.values
        if len(names) != len(values):
            raise WrongMessage(f"has {len(names)} names for {len(values)} values")
        if names[: len(self.names)] != self.names:
            by_name = dict(zip(names, values, strict=True))
            if missing := [name for name in self.names if name not in by_name]:
                raise WrongMessage(
                    f"lacks {', '.join(missing)}; it has {', '.join(names) or 'nothing'}"
                )
            values = [by_name[name] for name in self.names]
        for name, value in zip(self.names, values, strict=False):
            if not math.isfinite(value):
                raise WrongMessage(f"has {value} for {name}")
        signals, start = {}, 0
        for signal, size in self.sizes.items():
            signals[signal] = tuple(values[start : start + size])
            start += size
        return signals


def is_active(message: Message) -> bool:
    """Whether a message of commands says that its sender controls the part; a lack is a yes."""
    names = tuple(message.names)
    return ACTIVE not in names or message.values[names.index(ACTIVE)] > 0.5
