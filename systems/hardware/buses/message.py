"""Messages of one part of a machine: names and values of its signals, and the time of them."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from parapod.systems.core.errors import ParapodError

ACTIVE = "active"
"""Name in messages of commands: 1 while the sender controls the part; 0: it is to be neutral."""


type Twist = Sequence[Sequence[float]]


class Signal(NamedTuple):
    """A signal of a part, as the part's messages have it.

    Attributes:
        size: number of elements.
        unit: its unit, as its port declares it; "" where that is not known.
        idle: value of each element of a command while the part is neutral.
        twist: values (size, 2) by forward speed [m/s] and yaw rate [rad/s] of the machine, of a
            signal that follows from them; empty: it does not.
    """

    size: int
    unit: str = ""
    idle: float = 0.0
    twist: Twist = ()


type Table = Mapping[str, Signal]


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
    """Signals of a part, as names in messages.

    Attributes:
        part: name of the part.
        signals: its signals, by their names within the part.
        names: names of all elements, in order.
    """

    def __init__(self, signals: Table, part: str = ""):
        """Names the elements.

        Args:
            signals: signals of the part, by their names within it.
            part: name of the part.
        """
        self.part, self.signals = part, dict(signals)
        self.names = tuple(
            f"{name}[{i}]" if signal.size > 1 else name
            for name, signal in self.signals.items()
            for i in range(signal.size)
        )

    def pack(self, signals: Mapping[str, Sequence[float]]) -> list[float]:
        """Values of all elements, in the order of `names`."""
        return [float(value) for name in self.signals for value in signals[name]]

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
        for name, signal in self.signals.items():
            signals[name] = tuple(values[start : start + signal.size])
            start += signal.size
        return signals


def is_active(message: Message) -> bool:
    """Whether a message of commands says that its sender controls the part; a lack is a yes."""
    names = tuple(message.names)
    return ACTIVE not in names or message.values[names.index(ACTIVE)] > 0.5
