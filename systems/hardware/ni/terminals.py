"""The terminals of an emulated card, and the wires behind them: of legs, or of force cells."""

import math
from collections.abc import Mapping, Sequence

from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.safety.faults import FaultKind

# A Sabertooth 2x25 in analog mode stands still at half of 5 V (its manual) [V].
_STILL = 2.5

# Analog outputs and counters of a 6363 (its specifications).
OUTPUTS, COUNTERS = 4, 4


class NiWiring:
    """The terminals of a card without wires: what is measured there, and what becomes of outputs.

    Attributes:
        misbehaviour: faults of the card's measurements.
    """

    def __init__(self, misbehaviour: Misbehaviour):
        """Creates it; see the class."""
        self.misbehaviour = misbehaviour

    def follow(self) -> None:
        """Does what is due without a call of the driver."""

    def set_outputs(self, volts: Mapping[str, float]) -> None:
        """Sets analog outputs, by their names [V]."""

    def set_lines(self, values: Mapping[str, bool]) -> None:
        """Sets digital outputs, by their names."""

    def start_counter(self, counter: int) -> None:
        """Lets a counter begin at zero, if counters do."""

    def measure(self) -> tuple[tuple[int, ...], dict[str, bool]]:
        """Edges that the counters have counted, and lines that are high, as they are shown."""
        return (0,) * COUNTERS, {}

    def inputs(self) -> dict[str, float]:
        """Voltages at the analog inputs that have a wire, by their names, as shown [V]."""
        return {}


class LegWiring(NiWiring):
    """The wires of legs.

    Outputs ao0.. go to motor drivers in analog mode, one for each element of the part's `voltage`;
    counters ctr0.. count the encoders of its `extension`; lines port0/line0.. are its `limits`;
    one line closes the relay in the drivers' supply, and one shows the emergency stop's feedback
    contact: high while `emergency_stop` is 0. With the relay open, or the stop pressed, `voltage`
    is 0 and `stop` is 1. The outputs hold what was last written; a line without a wire is low.
    """

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour,
        supply_voltage: float = 12.0,
        metres_per_count: float = 1e-5,
        zero_extension: Sequence[float] | None = None,
        relay_line: str = "port0/line12",
        part: str = "legs",
        stop_line: str = "port0/line13",
    ):
        """Switches the card on: outputs at 0 V, relay open.

        Args:
            harness: wires to the simulated machine.
            misbehaviour: faults of the card's measurements.
            supply_voltage: supply voltage of the motor drivers [V].
            metres_per_count: one edge of an encoder's signals [m].
            zero_extension: extensions at which the counters are zero [m]; None: those at which
                they are started, as it is in truth.
            relay_line: line of the relay.
            part: part of the machine.
            stop_line: line of the emergency stop's contact; "": it has no wire.
        """
        super().__init__(misbehaviour)
        self._part, self._stop_line, self._harness = part, stop_line, harness
        self._supply, self._metres_per_count = supply_voltage, metres_per_count
        self._is_started_at_zero = zero_extension is None
        self._zero = self._edges(zero_extension or harness.get(f"{part}.extension"))
        self._relay_line = relay_line
        self._outputs = {f"ao{index}": 0.0 for index in range(OUTPUTS)}
        self._lines: dict[str, bool] = {}
        self._was_pressed = self.is_pressed
        self._apply()

    @property
    def outputs(self) -> tuple[float, ...]:
        """Voltages at the analog outputs [V]."""
        return tuple(self._outputs.values())

    @property
    def is_relay_closed(self) -> bool:
        """Whether the motor drivers have their supply."""
        return self._lines.get(self._relay_line, False)

    @property
    def is_pressed(self) -> bool:
        """Whether the emergency stop is; a machine may have none."""
        name = f"{self._part}.emergency_stop"
        return name in self._harness and self._harness.get(name)[0] > 0.5

    def follow(self) -> None:
        """Takes the drives' supply when the emergency stop is pressed, or gives it back."""
        if self.is_pressed != self._was_pressed:
            self._apply()

    def set_outputs(self, volts: Mapping[str, float]) -> None:
        """See `NiWiring`."""
        self._outputs.update(volts)
        self._apply()

    def set_lines(self, values: Mapping[str, bool]) -> None:
        """See `NiWiring`."""
        self._lines.update(values)
        self._apply()

    def start_counter(self, counter: int) -> None:
        """See `NiWiring`."""
        if self._is_started_at_zero:
            self._zero[counter] = self._edges(self._get("extension"))[counter]

    def measure(self) -> tuple[tuple[int, ...], dict[str, bool]]:
        """See `NiWiring`.

        Encoders and switches that are wrong have swapped wires; those of the stop's contact are
        right.
        """
        edges = self._edges(self._get("extension"))
        counts = [edge - zero for edge, zero in zip(edges, self._zero, strict=True)]
        # Plus and minus one: what is wrong or garbage changes a switch, too.
        bits = [1.0 if value > 0.5 else -1.0 for value in self._get("limits")]
        contact = -1.0 if self.is_pressed else 1.0
        shown_values = self.misbehaviour.shown((*counts, *bits, contact), monotonic())
        size = len(counts)
        lines = {f"port0/line{i}": value > 0.0 for i, value in enumerate(shown_values[size:-1])}
        if self._stop_line:
            is_wrong = self.misbehaviour.kind == FaultKind.WRONG
            lines[self._stop_line] = (contact if is_wrong else shown_values[-1]) > 0.0
        return tuple(map(round, shown_values[:size])), lines

    def _get(self, signal: str) -> tuple[float, ...]:
        return self._harness.get(f"{self._part}.{signal}")

    def _edges(self, extension: Sequence[float]) -> list[int]:
        return [round(value / self._metres_per_count) for value in extension]

    def _apply(self) -> None:
        """Puts the outputs on the wires, as motor drivers and relay do."""
        size = len(self._get("voltage"))
        self._was_pressed = self.is_pressed
        is_on = self.is_relay_closed and not self._was_pressed
        shares = ((volts - _STILL) / _STILL for volts in self.outputs[:size])
        voltage = [self._supply * min(max(share, -1.0), 1.0) if is_on else 0.0 for share in shares]
        self._harness.set(f"{self._part}.voltage", voltage)
        self._harness.set(f"{self._part}.stop", (0.0 if is_on else 1.0,))


class CellWiring(NiWiring):
    """The wires of force cells: an amplifier's output, in proportion to a force, at each input."""

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour,
        newton_per_volt: Mapping[str, float],
        zero: Mapping[str, float],
        part: str = "cells",
    ):
        """Connects the cells.

        Args:
            harness: wires to the simulated machine; with signal `force` of the part.
            misbehaviour: faults of the card's measurements.
            newton_per_volt: sensitivity of each cell, by the input at which it is, in the order of
                the signal's elements [N/V].
            zero: voltages without a force, by their inputs [V].
            part: part of the machine.
        """
        super().__init__(misbehaviour)
        self._harness, self._signal = harness, f"{part}.force"
        self._newton_per_volt, self._zero = dict(newton_per_volt), zero

    def inputs(self) -> dict[str, float]:
        """See `NiWiring`."""
        forces = (x if math.isfinite(x) else 0.0 for x in self._harness.get(self._signal))
        cells = zip(self._newton_per_volt.items(), forces, strict=True)
        volts = [force / per_volt + self._zero[name] for (name, per_volt), force in cells]
        shown_values = self.misbehaviour.shown(volts, monotonic())
        return dict(zip(self._newton_per_volt, shown_values, strict=True))
