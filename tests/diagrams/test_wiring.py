import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, PassThrough

from parapod.diagrams.wiring import (
    add,
    connect,
    inputs_of,
    named,
    outputs_of,
    split_states,
    wired,
)
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


def doubled():
    """Twice the sum of `left` and `right`, wired by signals."""
    total = named("total", Adder(2, 3)), {"u0": "left", "u1": "right", "sum": "total"}
    twice = named("twice", Gain(2.0, 3)), {"y0": "twice"}
    return total, twice


def test_systems_are_wired_by_the_signals_of_their_ports():
    diagram = wired("doubled", doubled(), ("twice",), {"u0": "total"})
    assert diagram.get_name() == "doubled"
    assert (list(inputs_of(diagram)), list(outputs_of(diagram))) == (["left", "right"], ["twice"])
    context = diagram.CreateDefaultContext()
    for value, name in enumerate(("left", "right")):
        diagram.GetInputPort(name).FixValue(context, [1.0, value, 5.0])
    np.testing.assert_array_equal(diagram.GetOutputPort("twice").Eval(context), [4.0, 2.0, 20.0])


def test_inputs_of_one_signal_are_one_input_and_outputs_may_be_those_of_a_system():
    both = {"u0": "left", "u1": "left"}
    adder = Adder(2, 1)
    diagram = wired("both", [(adder, both)], outputs_of(adder))
    assert (list(inputs_of(diagram)), list(outputs_of(diagram))) == (["left"], ["sum"])


def test_what_nothing_has_to_give_is_no_input():
    diagram = wired("doubled", doubled(), ("twice",), {"u0": "total"}, skip=("right",))
    assert list(inputs_of(diagram)) == ["left"]


@pytest.mark.parametrize(
    ("systems", "outputs", "message"),
    [
        (doubled(), ("half",), "no system has the output 'half'; there are: total, twice"),
        (
            (*doubled(), (named("other", Gain(1.0, 3)), {"u0": "left", "y0": "twice"})),
            (),
            "two systems have an output port 'twice': 'twice' and 'other'",
        ),
        (
            (doubled()[0], (named("pair", ConstantVectorSource(np.zeros(2))), {"y0": "left"})),
            (),
            "'left' has 2 elements as an output of 'pair', but 3 as an input of 'total'",
        ),
    ],
)
def test_signals_that_do_not_fit_are_refused(systems, outputs, message):
    with pytest.raises(WiringError, match=message):
        wired("misfit", systems, outputs)
