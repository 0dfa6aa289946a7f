"""Settings of NI cards: their places, and what is connected to their channels."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from parapod.systems.core.quoting import show
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.hardware.addresses import resolved


@dataclass
class NiCardSettings(Schema):
    """Place of a multifunction card.

    Attributes:
        part: part of the machine, as in the names of its ports.
        target: NI gRPC Device Server of another computer, "host:port" or "unix:/path", over a
            connection that is not encrypted; "" for a card in this one.
        product: type of the card, as NI-DAQmx names it and as it must answer.
        timeout_ms: longest time for one call [ms].
    """

    part: str = "legs"
    target: str = "unix:emulator/ni.sock"
    product: str = "PXIe-6363"
    timeout_ms: float = quantity(200.0, 5.0, 10000.0)

    @property
    def all_channels(self) -> str:
        """Everything that is used of the card, as a channel string."""
        raise NotImplementedError(f"{type(self).__name__} does not define all_channels")

    @property
    def address(self) -> str:
        """Target of a gRPC channel, an emulator's address resolved; "": none."""
        return resolved(self.target)

    @property
    def device(self) -> str:
        """Name of the card.

        Raises:
            ValueError: the channels are not of one card.
        """
        cards = {name.partition("/")[0] for name in expand_channels(self.all_channels)}
        if len(cards) != 1:
            raise ValueError(f"the channels are of {len(cards)} cards: {', '.join(cards)}")
        return cards.pop()

    @property
    def place(self) -> str:
        """Name of the card with its server, if it has one."""
        return f"{self.device} at {self.address}" if self.target else self.device

    @property
    def timeout(self) -> float:
        """Longest time for one call [s]."""
        return 1e-3 * self.timeout_ms


@dataclass
class NiDaqSettings(NiCardSettings):
    """Actuators, encoders and limit switches on a multifunction card, and the card's place.

    Attributes:
        outputs: analog outputs to the motor drivers, one an actuator, as a DAQmx channel string.
        counters: counters of the encoders, one an actuator, at their default terminals.
        inputs: digital inputs of the limit switches: extended, retracted, contact, each by
            actuator.
        relay: digital output of the relay in the motor drivers' supply; low is open.
        stop_input: digital input of the emergency stop's feedback contact, which is closed, and
            the line high, while it is not pressed: a broken wire counts as pressed; "" for none.
        um_per_count: one count of an encoder [um]; all four edges of signals A and B count. An
            assumption, as the encoder's resolution in simulation.
        extension_at_start_mm: measured extensions at the start of the program [mm]; null: not
            measured, so the file must know them.
        extension_file: file that keeps the extensions from one program to the next, in the folder
            in which the program is started if it has no other, or "" for none; while there is
            none, a program begins with `extension_at_start_mm`.
        extended_mm: extension at which the switches "extended" close [mm]; null: that of the
            machine, or where no machine says it, they are not compared with the extensions, and
            nothing can be homed against them.
        retracted_mm: extension at which the switches "retracted" close [mm]; null: as above.
        switch_tolerance_mm: largest difference between switch and extension at the start of a
            program, which is refused beyond it [mm].
        supply_voltage: supply of the motor drivers [V]; the prototype's actuators are for 12 V.
        watchdog_ms: time without this program after which the card opens the relay by itself
            [ms], up to the 34 s of an X Series card's timer; 0: never.
    """

    outputs: str = "PXI1Slot2/ao0:3"
    counters: str = "PXI1Slot2/ctr0:3"
    inputs: str = "PXI1Slot2/port0/line0:11"
    relay: str = "PXI1Slot2/port0/line12"
    stop_input: str = "PXI1Slot2/port0/line13"
    um_per_count: float = quantity(10.0, 0.01, 1000.0)
    # No default: a guess would be believed, and the stroke's ends would be where they are not.
    extension_at_start_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    extension_file: str = "emulator/extensions.json"
    extended_mm: float | None = quantity(None, 0.0, 20_000.0)
    retracted_mm: float | None = quantity(None, 0.0, 20_000.0)
    switch_tolerance_mm: float = quantity(1.0, 0.01, 100.0)
    supply_voltage: float = quantity(12.0, 1.0, 48.0)
    watchdog_ms: float = quantity(100.0, 0.0, 34000.0)

    @property
    def extensions_path(self) -> str:
        """File that keeps the extensions; "": none."""
        return resolved(self.extension_file)

    @property
    def all_channels(self) -> str:
        """See `NiCardSettings`."""
        return ",".join((self.outputs, self.counters, self.all_inputs, self.relay))

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
    def watchdog_timeout(self) -> float:
        """Time after which the card opens the relay by itself [s]; 0: never."""
        return 1e-3 * self.watchdog_ms


class ForceCell(NamedTuple):
    """A force cell behind its amplifier.

    Attributes:
        channel: analog input at which it is.
        newton_per_volt: force by voltage [N/V].
        zero: voltage without a force [V].
    """

    channel: str
    newton_per_volt: float
    zero: float


@dataclass
class NiForceCellSettings(NiCardSettings):
    """Force cells whose amplifiers are at analog inputs of a multifunction card.

    Attributes:
        channels: analog inputs of the amplifiers, one a cell, as a DAQmx channel string; each is
            differential, as the card has it by default.
        newton_per_volt: force of each cell by the voltage of its amplifier [N/V]; below 0 where
            a voltage below 0 means a positive force.
        zero_V: voltage of each cell's amplifier without a force [V].
        range_V: largest voltage that is measured, either way [V]; the card takes the smallest of
            its ranges that holds it, up to the 10 V of a PXIe-6363. A voltage at its end is that
            of a broken wire or of an overload.
        samples: voltages of each cell of which a reading is the mean [-]. They are taken on
            demand, one scan after another as fast as the driver can, and not by a clock.
    """

    part: str = "cells"
    target: str = "unix:emulator/ni_cells.sock"
    channels: str = "PXI1Slot2/ai0:2"
    newton_per_volt: list[float] = quantity([200.0] * 3, -1e5, 1e5)
    zero_V: list[float] = quantity([0.0] * 3, -10.0, 10.0)  # noqa: N815 (the unit's symbol)
    range_V: float = quantity(10.0, 0.1, 10.0)  # noqa: N815
    samples: int = quantity(1, 1, 100)

    @property
    def all_channels(self) -> str:
        """See `NiCardSettings`."""
        return self.channels

    @property
    def cells(self) -> tuple[ForceCell, ...]:
        """The cells, in the order of their channels.

        Raises:
            ValueError: lists of other lengths, or a cell without a sensitivity.
        """
        channels = expand_channels(self.channels)
        for name in ("newton_per_volt", "zero_V"):
            if (size := len(getattr(self, name))) != len(channels):
                raise ValueError(f"{name} must be {len(channels)} values, not {size}")
        if 0.0 in self.newton_per_volt:
            raise ValueError(f"newton_per_volt must not be 0: {self.newton_per_volt}")
        return tuple(map(ForceCell, channels, self.newton_per_volt, self.zero_V))


def expand_channels(text: str) -> tuple[str, ...]:
    """The physical channels that a DAQmx channel string names, in its order.

    Args:
        text: names and ranges separated by commas, as in "Dev1/ao0,Dev1/ao2:3".

    Raises:
        ValueError: it is not such a string.
    """
    return tuple(name for part in text.split(",") for name in _expand_range(part.strip(), text))


def _expand_range(part: str, text: str) -> Iterator[str]:
    match = re.fullmatch(r"([^:/\s]+/[^:\s]*?)(\d+)(?::(\d+))?", part)
    if match is None:
        raise ValueError(f'{show(text)} does not name channels, as "Dev1/ao0:3" does')
    first = int(match[2])
    last = first if match[3] is None else int(match[3])
    step = 1 if last >= first else -1
    return (f"{match[1]}{number}" for number in range(first, last + step, step))
