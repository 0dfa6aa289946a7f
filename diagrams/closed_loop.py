"""Station and controller in one diagram, with signals logged: what all machines' loops share."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from parapod.diagrams.station import Station


@dataclass(frozen=True)
class ClosedLoop[Scenario]:
    """A machine that can be simulated.

    Attributes:
        diagram: the whole.
        station: the machine in it.
        controller: the controller in it.
        ports: all that can be recorded, by port name.
        logs: what is recorded, likewise.
    """

    diagram: Diagram
    station: Station[Scenario]
    controller: Diagram
    ports: dict[str, OutputPort]
    logs: dict[str, VectorLogSink]

    def reset(self, context: Context, scenario: Scenario | None = None) -> None:
        """Puts everything at its beginning; see `Station.reset`."""
        self.diagram.SetDefaultContext(context)
        context.SetTime(0.0)
        self.station.reset(context, scenario)
        for log in self.logs.values():
            log.FindMutableLog(context).Clear()

    def recorded(self, context: Context) -> tuple[NDArray[np.float64], dict[str, NDArray]]:
        """Times (n) [s], and for each port name the samples (n, size); empty without logs."""
        time, samples = np.empty(0), {}
        for name, sink in self.logs.items():
            log = sink.FindLog(context)
            time, samples[name] = log.sample_times().copy(), log.data().T.copy()
        return time, samples


def output_ports(*systems: Any) -> dict[str, OutputPort]:
    """All output ports of systems, by their names."""
    return {
        system.get_output_port(i).get_name(): system.get_output_port(i)
        for system in systems
        for i in range(system.num_output_ports())
    }


def log_ports(
    builder: DiagramBuilder,
    ports: dict[str, OutputPort],
    period: float,
    names: Collection[str] | None,
) -> dict[str, VectorLogSink]:
    """Records ports in a diagram.

    Args:
        builder: of the diagram.
        ports: by name.
        period: between samples [s].
        names: of those that are recorded; None for all of them.
    """
    return {
        name: LogVectorOutput(port, builder, period)
        for name, port in ports.items()
        if names is None or name in names
    }
