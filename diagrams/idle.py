"""What an idle machine is told on the ports that nothing else drives."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.wiring import add, connect


def idle_inputs(builder: DiagramBuilder, machine: Diagram, values: Mapping[str, float]) -> None:
    """Puts a constant on every input of a station that nothing drives yet.

    Args:
        builder: has the station and what drives it.
        machine: the station's diagram.
        values: by the name of a port; 0 for those that are left out.
    """
    for i in range(machine.num_input_ports()):
        port = machine.get_input_port(i)
        if not builder.IsConnectedOrExported(port):
            name = port.get_name()
            value = np.full(port.size(), values.get(name, 0.0))
            idle = add(builder, ConstantVectorSource(value), f"idle.{name}")
            connect(builder, idle.get_output_port(), port)
