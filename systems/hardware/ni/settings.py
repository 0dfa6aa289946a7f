"""Which channels of an NI card are connected to what, and where the card is."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class NiDaqParams:
    """What is connected to the card, and where the card is.

    Attributes:
        target: "" for a card in this computer; else the NI gRPC Device Server of the computer
            that has it, "host:port" or "unix:/path". The connection is not encrypted.
        outputs: analog outputs to the motor drivers, one for each actuator, as a DAQmx channel
            string.
        counters: counters that the encoders are connected to, one for each actuator, at their
            default terminals.
        inputs: digital inputs of the limit switches.
        relay: digital output that closes the relay in the supply of the motor drivers.
        product: the card's type, as NI-DAQmx names it.
        metres_per_count: one count of an encoder [m]; all four edges of signals A and B count.
            An assumption, as the encoder's resolution in simulation.
        extension_at_start: extensions of the actuators when the device is configured [m]; None:
            not known.
        supply_voltage: of the motor drivers [V]; the prototype's actuators are for 12 V.
        neutral: output voltage at which an actuator stands still [V]; 2.5 for a Sabertooth 2x25
            in analog mode (its manual, "Mode 1: analog input").
        span: change of the output voltage from neutral to full supply voltage [V]; 2.5, as above.
        output_min: smallest output voltage [V]; 0, as above.
        output_max: largest output voltage [V]; 5, as above.
        timeout: longest time for one call [s]; ten periods at 20 Hz.
        configure_timeout: longest time to configure [s]; a driver that has to be loaded first
            takes seconds.
    """

    target: str = ""
    outputs: str = "PXI1Slot2/ao0:3"
    counters: tuple[str, ...] = (
        "PXI1Slot2/ctr0",
        "PXI1Slot2/ctr1",
        "PXI1Slot2/ctr2",
        "PXI1Slot2/ctr3",
    )
    inputs: str = "PXI1Slot2/port0/line0:11"
    relay: str = "PXI1Slot2/port0/line12"
    product: str = "PXIe-6363"
    metres_per_count: float = 1e-5
    extension_at_start: tuple[float, ...] | None = None
    supply_voltage: float = 12.0
    neutral: float = 2.5
    span: float = 2.5
    output_min: float = 0.0
    output_max: float = 5.0
    timeout: float = 0.5
    configure_timeout: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "counters", tuple(self.counters))
        devices = {name.partition("/")[0] for name in self._channels}
        if len(devices) != 1:
            raise ValueError(f"the channels are of {len(devices)} cards: {', '.join(devices)}")
        size = len(expand_channels(self.outputs))
        if len(self.counters) != size or any(len(expand_channels(c)) > 1 for c in self.counters):
            raise ValueError(
                f"each of the {size} outputs needs one counter, not {', '.join(self.counters)}"
            )
        start = self.extension_at_start
        if start is not None and not (len(start) == size and all(map(math.isfinite, start))):
            raise ValueError(f"extension_at_start must be {size} finite values, not {start}")
        for name in (
            "metres_per_count",
            "supply_voltage",
            "span",
            "timeout",
            "configure_timeout",
        ):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be above 0 and finite, not {getattr(self, name)}")
        if not -math.inf < self.output_min < self.neutral < self.output_max < math.inf:
            raise ValueError(
                f"neutral must lie between output_min and output_max, not {self.neutral} "
                f"between {self.output_min} and {self.output_max}"
            )

    @property
    def device(self) -> str:
        """The card's name."""
        return self._channels[0].partition("/")[0]

    @property
    def _channels(self) -> tuple[str, ...]:
        return expand_channels(",".join((self.outputs, *self.counters, self.inputs, self.relay)))


def expand_channels(text: str) -> tuple[str, ...]:
    """The physical channels that a DAQmx channel string names, in its order.

    Args:
        text: names and ranges separated by commas, as in "Dev1/ao0,Dev1/ao2:3".

    Raises:
        ValueError: it is not such a string.
    """
    return tuple(name for part in text.split(",") for name in _expand_range(part.strip(), text))


def _expand_range(part: str, text: str) -> Iterator[str]:
    found = re.fullmatch(r"([^:/\s]+/[^:\s]*?)(\d+)(?::(\d+))?", part)
    if found is None:
        raise ValueError(f'{text!r} does not name channels, as "Dev1/ao0:3" does')
    first = int(found[2])
    last = first if found[3] is None else int(found[3])
    step = 1 if last >= first else -1
    return (f"{found[1]}{number}" for number in range(first, last + step, step))
