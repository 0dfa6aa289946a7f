"""Drivers of a multifunction card of National Instruments."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.diagrams.scenario import quantity
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.device import Device, Signals
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour, MutedHarness
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.emulator import NiServer
from parapod.systems.hardware.ni.settings import NiDaqParams, expand_channels
from parapod.systems.hardware.position_memory import PositionMemory, Referenced


@dataclass
class NiDaqLegs(Driver):
    """Analog motor drivers, encoders and limit switches on an NI PXIe-6363: see `NiDaq`.

    Attributes:
        part: of the machine.
        target: "" for a card in this computer; else the NI gRPC Device Server of another one,
            "host:port" or "unix:/path".
        outputs: analog outputs to the motor drivers.
        counters: of the encoders, one a leg.
        inputs: digital inputs of the limit switches: extended, retracted, contact, by leg.
        relay: digital output of the relay in the motor drivers' supply.
        product: the card's type, as it must answer.
        um_per_count: one count of an encoder [um].
        extension_at_start_mm: what the extensions are when the program starts, as somebody has
            measured them [mm]; None: nobody has, and the file must know them.
        extension_file: where the extensions are kept from one program to the next, in the folder
            in which the program is started if it has no other; while there is none, and with ""
            for nowhere, a program begins with `extension_at_start_mm`.
        supply_voltage: of the motor drivers [V].
        timeout_ms: longest time for one call [ms].
    """

    part: str = "legs"
    target: str = "unix:emulator/ni.sock"
    outputs: str = "PXI1Slot2/ao0:3"
    counters: str = "PXI1Slot2/ctr0:3"
    inputs: str = "PXI1Slot2/port0/line0:11"
    relay: str = "PXI1Slot2/port0/line12"
    product: str = "PXIe-6363"
    um_per_count: float = quantity(10.0, 0.01, 1000.0)
    # No default: a guess would be believed, and the stroke's ends would be where they are not.
    extension_at_start_mm: list[float] | None = quantity(None, 0.0, 2000.0, length=4)
    extension_file: str = "emulator/extensions.json"
    supply_voltage: float = quantity(12.0, 1.0, 48.0)
    timeout_ms: float = quantity(200.0, 5.0, 10000.0)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        return self._card()

    def _card(self) -> Device:
        if self.extension_file:
            card = NiDaq(self._params())
            return Referenced(card, Path(resolved(self.extension_file)), self.part)
        with named(self):
            if self.extension_at_start_mm is None:
                raise ValueError("without extension_file it needs extension_at_start_mm")
        return NiDaq(self._params())

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: an NI gRPC Device Server, and a file that knows the extensions."""
        params = self._params()
        path = emulated(self.target, f"!{type(self).__name__}.target").removeprefix("unix:")
        kept = resolved(self.extension_file)
        if kept != self.extension_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(kept), len(params.counters), NiDaq.position_signal)
            memory.save(harness.get("legs.extension"))
        return NiServer(
            path,
            harness,
            misbehaviour,
            device=params.device,
            product=self.product,
            supply_voltage=self.supply_voltage,
            metres_per_count=params.metres_per_count,
            relay_line=self.relay.partition("/")[2],
        )

    def _params(self) -> NiDaqParams:
        start = self.extension_at_start_mm
        with named(self):
            return NiDaqParams(
                target=resolved(self.target),
                outputs=self.outputs,
                counters=expand_channels(self.counters),
                inputs=self.inputs,
                relay=self.relay,
                product=self.product,
                metres_per_count=1e-6 * self.um_per_count,
                extension_at_start=None if start is None else tuple(1e-3 * mm for mm in start),
                supply_voltage=self.supply_voltage,
                timeout=1e-3 * self.timeout_ms,
            )


@dataclass
class NiDaqEncoders(NiDaqLegs):
    """The same card for encoders, limit switches and relay only; other drivers drive the motors.

    Its analog outputs are kept neutral, and nothing should be connected to them.
    """

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        return _WithoutVoltage(self._card())

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: as for `NiDaqLegs`, without wires to the motors."""
        return super().emulate(MutedHarness(harness, ["legs.voltage"]), misbehaviour)


class _WithoutVoltage(Device):
    """A card that is not asked for voltages."""

    def __init__(self, card: Device):
        self._card = card
        self.name, self.measures = card.name, card.measures
        self.commands = {"stop": 1}
        self._neutral = (0.0,) * card.commands["voltage"]

    def configure(self) -> None:
        self._card.configure()

    def activate(self) -> None:
        self._card.activate()

    def read(self) -> Signals:
        return self._card.read()

    def write(self, commands: Signals) -> None:
        self._card.write({"voltage": self._neutral, **commands})

    def neutral(self) -> None:
        self._card.neutral()

    def deactivate(self) -> None:
        self._card.deactivate()

    def close(self) -> None:
        self._card.close()
