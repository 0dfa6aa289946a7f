"""A station with the real machine behind its ports."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from parapod.diagrams.hardware_parts import Parts, add_parts, make_parts
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.ports import PortSpec
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect


class Control(Protocol):
    """The part of a scenario that all controllers have."""

    period: float


class OnHardware(Protocol):
    """What a scenario must have for the backend "hardware"."""

    hardware: HardwareScenario

    @property
    def control(self) -> Control:
        """Of the controller."""


@dataclass(frozen=True)
class HardwareStation[Scenario: OnHardware](Station[Scenario]):
    """A station whose devices obey while `active` lasts.

    Attributes:
        parts: the devices.
    """

    parts: Parts

    def reset(self, root_context: Context, scenario: Scenario | None = None) -> None:
        """Begins with what the devices measure now; a scenario changes nothing about a machine.

        Raises:
            DeviceError: a device has a fault, or is not active yet.
        """
        self.parts.reset(root_context)

    @contextmanager
    def active(self) -> Iterator[None]:
        """See `Parts.active`."""
        with self.parts.active():
            yield


def measured(outputs: Sequence[PortSpec]) -> tuple[PortSpec, ...]:
    """What devices measure; how the devices are is known of all of them."""
    return tuple(spec for spec in outputs if not spec.name.startswith("status."))


def build_hardware_station[Scenario: OnHardware](
    scenario: Scenario,
    inputs: Sequence[PortSpec],
    outputs: Sequence[PortSpec],
    status_parts: Sequence[str],
) -> HardwareStation[Scenario]:
    """Builds a station from the drivers of a scenario; nothing is opened yet.

    Args:
        scenario: its `hardware` and `control.period` are taken.
        inputs: of the machine.
        outputs: of the machine, with `status.age` and `status.fault`.
        status_parts: what the elements of these two are about.

    Raises:
        ScenarioError: drivers that do not make this machine.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    parts = make_parts(scenario.hardware.drivers, inputs, measured(outputs), period)
    status = add_parts(builder, parts, inputs, measured(outputs), period)
    for name in ("age", "fault"):
        each = add(builder, Multiplexer(len(status_parts)), f"status_{name}")
        for i, part in enumerate(status_parts):
            connect(builder, status[f"{part}.{name}"], each.get_input_port(i))
        builder.ExportOutput(each.get_output_port(0), f"status.{name}")
    diagram = builder.Build()
    diagram.set_name("station")
    return HardwareStation(diagram, scenario, parts)
