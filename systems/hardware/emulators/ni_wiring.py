"""What an emulated NI card is connected to: motor drivers, relay, encoders and switches."""

import time
from collections.abc import Mapping, Sequence

from parapod.systems.hardware.emulators.harness import Harness
from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour

# A Sabertooth 2x25 in analog mode stands still at half of 5 V (its manual) [V].
_STILL = 2.5

# Analog outputs of a 6363.
_OUTPUTS = 4


class NiWiring:
    """The terminals of the card and the wires behind them.

    Outputs ao0.. go to motor drivers in analog mode, one for each element of `legs.voltage`;
    counters ctr0.. count the encoders of `legs.extension`; lines port0/line0.. are `legs.limits`;
    one line closes the relay in the drivers' supply. With the relay open `legs.voltage` is 0 and
    `legs.stop` is 1. The outputs hold what was last written.
    """

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour,
        supply_voltage: float = 12.0,
        metres_per_count: float = 1e-5,
        zero_extension: Sequence[float] | None = None,
        relay_line: str = "port0/line12",
    ):
        """Switches the card on: outputs at 0 V, relay open.

        Args:
            harness: wires to the simulated machine.
            misbehaviour: what is wrong with what the card measures.
            supply_voltage: of the motor drivers [V].
            metres_per_count: one edge of an encoder's signals [m].
            zero_extension: extensions at which the counters are zero [m]; None: those at which
                they are started, as it is in truth.
            relay_line: line of the relay.
        """
        self._harness, self._misbehaviour = harness, misbehaviour
        self._supply, self._metres_per_count = supply_voltage, metres_per_count
        self._is_started_at_zero = zero_extension is None
        self._zero = self._edges(zero_extension or harness.get("legs.extension"))
        self._relay_line = relay_line
        self._outputs = {f"ao{index}": 0.0 for index in range(_OUTPUTS)}
        self._lines: dict[str, bool] = {}
        self._apply()

    @property
    def outputs(self) -> tuple[float, ...]:
        """Voltages at the analog outputs [V]."""
        return tuple(self._outputs.values())

    @property
    def is_relay_closed(self) -> bool:
        """Whether the motor drivers have their supply."""
        return self._lines.get(self._relay_line, False)

    def set_outputs(self, volts: Mapping[str, float]) -> None:
        """Sets analog outputs, by their names [V]."""
        self._outputs.update(volts)
        self._apply()

    def set_lines(self, values: Mapping[str, bool]) -> None:
        """Sets digital outputs, by their names."""
        self._lines.update(values)
        self._apply()

    def start_counter(self, counter: int) -> None:
        """Lets a counter begin at zero, if counters do."""
        if self._is_started_at_zero:
            self._zero[counter] = self._edges(self._harness.get("legs.extension"))[counter]

    def measure(self) -> tuple[tuple[int, ...], tuple[bool, ...]]:
        """Edges that the counters have counted, and switches, as they are shown."""
        edges = self._edges(self._harness.get("legs.extension"))
        counts = [edge - zero for edge, zero in zip(edges, self._zero, strict=True)]
        # Plus and minus one: what is wrong or garbage changes a switch, too.
        bits = [1.0 if value > 0.5 else -1.0 for value in self._harness.get("legs.limits")]
        shown = self._misbehaviour.shown((*counts, *bits), time.monotonic())
        size = len(counts)
        return tuple(map(round, shown[:size])), tuple(value > 0.0 for value in shown[size:])

    def _edges(self, extension: Sequence[float]) -> list[int]:
        return [round(value / self._metres_per_count) for value in extension]

    def _apply(self) -> None:
        """Puts the outputs on the wires, as motor drivers and relay do."""
        size = len(self._harness.get("legs.voltage"))
        is_on = self.is_relay_closed
        shares = ((volts - _STILL) / _STILL for volts in self.outputs[:size])
        voltage = [self._supply * min(max(share, -1.0), 1.0) if is_on else 0.0 for share in shares]
        self._harness.set("legs.voltage", voltage)
        self._harness.set("legs.stop", (0.0 if is_on else 1.0,))
