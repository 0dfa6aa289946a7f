"""Settings of an NI card: its place, and what is connected to its channels."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from parapod.systems.core.quoting import show
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.hardware.addresses import resolved


@dataclass
class NiDaqSettings(Schema):
    """Actuators, encoders and limit switches on a multifunction card, and the card's place.

    Attributes:
        part: part of the machine, as in the names of its ports.
        target: NI gRPC Device Server of another computer, "host:port" or "unix:/path", over a
            connection that is not encrypted; "" for a card in this one.
        outputs: analog outputs to the motor drivers, one an actuator, as a DAQmx channel string.
        counters: counters of the encoders, one an actuator, at their default terminals.
        inputs: digital inputs of the limit switches: extended, retracted, contact, each by
            actuator.
        relay: digital output of the relay in the motor drivers' supply; low is open.
        stop_input: digital input of the emergency stop's feedback contact, which is closed, and
            the line high, while it is not pressed: a broken wire counts as pressed; "" for none.
        product: type of the card, as NI-DAQmx names it and as it must answer.
        um_per_count: one count of an encoder [um]; all four edges of signals A and B count. An
            assumption, as the encoder's resolution in simulation.
        extension_at_start_mm: measured extensions at the start of the program [mm]; null: not
            measured, so the file must know them.
        extension_file: file that keeps the extensions from one program to the next, in the folder
            in which the program is started if it has no other, or "" for none; while there is
            none, a program begins with `extension_at_start_mm`.
        extended_mm: extension at which the switches "extended" close [mm]; null: they are not
            compared with the extensions, and nothing can be homed against them.
        retracted_mm: extension at which the switches "retracted" close [mm]; null: they are not
            compared either.
        switch_tolerance_mm: largest difference between switch and extension at the start of a
            program, which is refused beyond it [mm].
        supply_voltage: supply of the motor drivers [V]; the prototype's actuators are for 12 V.
        timeout_ms: longest time for one call [ms].
        watchdog_ms: time without this program after which the card opens the relay by itself
            [ms], up to the 34 s of an X Series card's timer; 0: never.
    """

    part: str = "legs"
    target: str = "unix:emulator/ni.sock"
    outputs: str = "PXI1Slot2/ao0:3"
    counters: str = "PXI1Slot2/ctr0:3"
    inputs: str = "PXI1Slot2/port0/line0:11"
    relay: str = "PXI1Slot2/port0/line12"
    stop_input: str = "PXI1Slot2/port0/line13"
    product: str = "PXIe-6363"
    um_per_count: float = quantity(10.0, 0.01, 1000.0)
    # No default: a guess would be believed, and the stroke's ends would be where they are not.
    extension_at_start_mm: list[float] | None = quantity(None, 0.0, 2000.0)
    extension_file: str = "emulator/extensions.json"
    extended_mm: float | None = quantity(459.5, 0.0, 2000.0)
    retracted_mm: float | None = quantity(380.5, 0.0, 2000.0)
    switch_tolerance_mm: float = quantity(1.0, 0.01, 100.0)
    supply_voltage: float = quantity(12.0, 1.0, 48.0)
    timeout_ms: float = quantity(200.0, 5.0, 10000.0)
    watchdog_ms: float = quantity(100.0, 0.0, 34000.0)

    @property
    def address(self) -> str:
        """Target of a gRPC channel, an emulator's address resolved; "": none."""
        return resolved(self.target)

    @property
    def extensions_path(self) -> str:
        """File that keeps the extensions; "": none."""
        return resolved(self.extension_file)

    @property
    def device(self) -> str:
        """Name of the card.

        Raises:
            ValueError: the channels are not of one card.
        """
        text = ",".join((self.outputs, self.counters, self.all_inputs, self.relay))
        cards = {name.partition("/")[0] for name in expand_channels(text)}
        if len(cards) != 1:
            raise ValueError(f"the channels are of {len(cards)} cards: {', '.join(cards)}")
        return cards.pop()

    @property
    def all_inputs(self) -> str:
        """Limit switches, then the emergency stop if there is one, as a channel string."""
        return f"{self.inputs},{self.stop_input}" if self.stop_input else self.inputs

    @property
    def counter_names(self) -> tuple[str, ...]:
        """Counters, one by one."""
        return expand_channels(self.counters)

    @property
    def metres_per_count(self) -> float:
        """One count of an encoder [m]."""
        return 1e-6 * self.um_per_count

    @property
    def extension_at_start(self) -> tuple[float, ...] | None:
        """Extensions when the program starts [m]; None: not known."""
        start = self.extension_at_start_mm
        return None if start is None else tuple(1e-3 * mm for mm in start)

    @property
    def timeout(self) -> float:
        """Longest time for one call [s]."""
        return 1e-3 * self.timeout_ms

    @property
    def watchdog_timeout(self) -> float:
        """Time after which the card opens the relay by itself [s]; 0: never."""
        return 1e-3 * self.watchdog_ms


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
        raise ValueError(f'{show(text)} does not name channels, as "Dev1/ao0:3" does')
    first = int(found[2])
    last = first if found[3] is None else int(found[3])
    step = 1 if last >= first else -1
    return (f"{found[1]}{number}" for number in range(first, last + step, step))
