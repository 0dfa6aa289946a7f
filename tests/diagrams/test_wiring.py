import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from parapod.diagrams.wiring import add, connect
from parapod.systems.errors import WiringError


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
