"""One system alone in a diagram: sources on its inputs, recordings of its ports."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    PortDataType,
    System,
)
from pydrake.systems.primitives import (
    ConstantVectorSource,
    TrajectorySource,
    VectorLogSink,
)
from pydrake.trajectories import Trajectory

from parapod.diagrams.recording import Recording
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect, inputs_of, outputs_of
from parapod.systems.core.errors import WiringError
from parapod.systems.core.port_table import port_table

type Input = ArrayLike | Trajectory | System


class Alone(Diagram):
    """A system that can be simulated by itself: `Simulator(Alone(system, inputs))`.

    Each input is driven by a source of its own, and inputs and outputs are recorded; inputs that
    are left out stay unconnected.

        alone = Alone(LinearActuator(channels=1), {"voltage": 3.0})
        simulator = Simulator(alone)
        simulator.AdvanceTo(1.0)
        alone.recording(simulator.get_context()).plot("extension", "velocity")

    Attributes:
        system: the system.
        logs: sinks of the recorded signals, by port name.
    """

    def __init__(self, system: System, inputs: Mapping[str, Input], period: float = 0.01):
        """Builds the diagram.

        Args:
            system: a LeafSystem or Diagram, which from now on belongs to this one.
            inputs: input by port name: a constant (a number stands for all elements), a trajectory
                (a column over time), or a system with a single output.
            period: time between two samples of a recording [s].

        Raises:
            WiringError: there is no such input, or what is to drive it has not its size.
            ValueError: a period that is not positive.
        """
        super().__init__()
        if not period > 0.0:
            raise ValueError(f"the period of a recording must be positive, not {period}")
        builder = DiagramBuilder()
        self.system = add(builder, system)
        ports = inputs_of(system)
        driven = {
            name: _drive(builder, ports, name, value, system.get_name())
            for name, value in inputs.items()
        }
        sources = {**driven, **dict(_vectors(system))}
        self._units = {name: unit for name, unit in _units(system).items() if name in sources}
        self.logs: dict[str, VectorLogSink] = {}
        for name, port in sources.items():
            # Not `LogVectorOutput`, whose sink would never let go of the diagram.
            self.logs[name] = add(builder, VectorLogSink(port.size(), period), f"log.{name}")
            connect(builder, port, self.logs[name].get_input_port())
        builder.BuildInto(self)
        self.set_name(f"{system.get_name()} alone")

    def __repr__(self) -> str:
        return f"<{self.get_name()}>"

    def recording(self, context: Context) -> Recording:
        """The signals recorded in a context of this diagram, by port name.

        Units are those of the port table in the system's docstring, or of the machine whose
        station it is; "-" where there is none.
        """
        logs = {name: sink.FindLog(context) for name, sink in self.logs.items()}
        time = next((log.sample_times().copy() for log in logs.values()), np.empty(0))
        signals = {name: log.data().T.copy() for name, log in logs.items()}
        return Recording(time, signals, {name: self._units.get(name, "-") for name in signals})


def _drive(
    builder: DiagramBuilder, ports: Mapping[str, InputPort], name: str, value: Input, system: str
) -> OutputPort:
    """Connects an input to a source of its own; the source's output."""
    if name not in ports:
        port_names = ", ".join(ports) or "none"
        raise WiringError(f"'{system}' has no input '{name}'; there are: {port_names}")
    size = ports[name].size()
    if isinstance(value, System):
        source = value
        if source.num_output_ports() != 1:
            raise WiringError(
                f"'{source.get_name()}' has {source.num_output_ports()} outputs; "
                f"a source of '{name}' has one"
            )
    elif isinstance(value, Trajectory):
        source = TrajectorySource(value)
    else:
        constant = np.asarray(value, dtype=float)
        source = ConstantVectorSource(np.full(size, constant) if constant.ndim == 0 else constant)
    port = add(builder, source, source.get_name() or name).get_output_port()
    if port.size() != size:
        raise WiringError(f"'{name}' of '{system}' has {size} elements, its source {port.size()}")
    connect(builder, port, ports[name])
    return port


def _vectors(system: System) -> Iterator[tuple[str, OutputPort]]:
    """Outputs of numbers, by name."""
    for name, port in outputs_of(system).items():
        if port.get_data_type() == PortDataType.kVectorValued:
            yield name, port


def _units(system: System) -> dict[str, str]:
    """Units by port name, as far as system or machine declares them."""
    if isinstance(system, Station):
        return {name: port.unit for name, port in system.machine.table.items()}
    return {row.name: row.unit for row in port_table(type(system))}
