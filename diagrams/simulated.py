"""Ports of simulated drives and devices, as all machines have them."""

from collections.abc import Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort

from parapod.diagrams.wiring import add
from parapod.systems.sensors.device_status import DeviceStatus


def ports_of_drives(
    drives: Diagram, command: str, part: str = "legs"
) -> tuple[dict[str, InputPort], dict[str, OutputPort]]:
    """Inputs and outputs of drives that stand behind a part, by the station's names.

    Args:
        drives: drives with `brake`, `position_measured` and `velocity_measured`.
        command: name of what they follow.
        part: the part.
    """
    inputs = {f"{part}.{name}": drives.GetInputPort(name) for name in (command, "brake")}
    outputs = {
        f"{part}.{name}": drives.GetOutputPort(f"{name}_measured")
        for name in ("position", "velocity")
    }
    return inputs, outputs


def add_status(builder: DiagramBuilder, parts: Sequence[str]) -> dict[str, OutputPort]:
    """Adds `status.*` of parts whose data are never old, and which never fail.

    Args:
        builder: builder of the station.
        parts: the machine's parts.
    """
    status = add(builder, DeviceStatus(tuple(parts), (0.0,) * len(parts)))
    return {f"status.{name}": status.GetOutputPort(name) for name in ("age", "fault")}
