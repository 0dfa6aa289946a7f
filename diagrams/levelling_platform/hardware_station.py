"""The levelling platform's station with the real machine behind its ports."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from parapod.diagrams.hardware_parts import Parts, add_parts, make_parts
from parapod.diagrams.levelling_platform.ports import INPUTS, OUTPUTS, STATUS_PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.station_base import Station
from parapod.diagrams.wiring import add, connect

# What devices measure; how the devices are is known of all of them.
MEASURED = tuple(spec for spec in OUTPUTS if not spec.name.startswith("status."))


@dataclass(frozen=True)
class HardwareStation(Station):
    """A station whose devices obey while `active` lasts.

    Attributes:
        parts: the devices.
    """

    parts: Parts

    def reset(self, root_context: Context, scenario: LevellingScenario | None = None) -> None:
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


def make_hardware_station(
    scenario: LevellingScenario, meshcat: Meshcat | None = None
) -> HardwareStation:
    """Builds a station from the drivers of a scenario; nothing is opened yet.

    Args:
        scenario: its `hardware` and `control.period` are taken.
        meshcat: not used; there is no model to draw.

    Raises:
        ScenarioError: drivers that do not make a levelling platform.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    parts = make_parts(scenario.hardware.drivers, INPUTS, MEASURED, period)
    status = add_parts(builder, parts, INPUTS, MEASURED, period)
    for name in ("age", "fault"):
        each = add(builder, Multiplexer(len(STATUS_PARTS)), f"status_{name}")
        for i, part in enumerate(STATUS_PARTS):
            connect(builder, status[f"{part}.{name}"], each.get_input_port(i))
        builder.ExportOutput(each.get_output_port(0), f"status.{name}")
    diagram = builder.Build()
    diagram.set_name("station")
    return HardwareStation(diagram, scenario, parts)
