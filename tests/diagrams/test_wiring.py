import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from parapod.diagrams.wiring import add, connect, split_states
from parapod.systems.core.errors import WiringError


def test_second_source_is_refused_by_the_names_of_both_ports():
    builder = DiagramBuilder()
    first, second = (add(builder, ConstantVectorSource([1.0]), name) for name in ("a", "b"))
    sink = add(builder, PassThrough(1), "sink")
    connect(builder, first.get_output_port(), sink.get_input_port())
    with pytest.raises(WiringError, match=r"'u' of 'sink' is wired already; 'y0' of 'b'"):
        connect(builder, second.get_output_port(), sink.get_input_port())


def test_source_of_an_exported_port_is_refused():
    builder = DiagramBuilder()
    source, sink = add(builder, ConstantVectorSource([1.0])), add(builder, PassThrough(1), "sink")
    builder.ExportInput(sink.get_input_port(), "outside")
    with pytest.raises(WiringError, match="'sink' is wired already"):
        connect(builder, source.get_output_port(), sink.get_input_port())


@pytest.mark.parametrize("groups", [1, 2, 3, 6])
def test_states_are_split_into_positions_and_velocities_of_each_group(groups):
    builder = DiagramBuilder()
    positions, velocities = np.arange(6.0), 10.0 + np.arange(6.0)
    states = add(builder, ConstantVectorSource(np.concatenate((positions, velocities))))
    for i, port in enumerate(split_states(builder, "parts", states.get_output_port(), groups)):
        builder.ExportOutput(port, str(i))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    size = 6 // groups
    for i in range(groups):
        part = slice(i * size, (i + 1) * size)
        expected = np.concatenate((positions[part], velocities[part]))
        np.testing.assert_array_equal(diagram.get_output_port(i).Eval(context), expected)
