"""Pictures of diagrams: every block, port and wire is there, as deep as is asked for."""

import re
from xml.etree import ElementTree

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Gain, LogVectorOutput

from parapod.diagrams.block_diagram import draw

_SVG = "{http://www.w3.org/2000/svg}"


def doubled(name):
    """A diagram of two gains, one behind the other."""
    builder = DiagramBuilder()
    first = builder.AddNamedSystem("first", Gain(2.0, 3))
    second = builder.AddNamedSystem("second", Gain(0.5, 3))
    builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportInput(first.get_input_port(), "asked")
    builder.ExportOutput(second.get_output_port(), "done")
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


@pytest.fixture(scope="module")
def loop():
    """A source, two diagrams of gains in a row, a gain whose output goes out, and a recording."""
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0, 2.0, 3.0]))
    builder.AddNamedSystem("unused", ConstantVectorSource([1.0]))
    one, two = (builder.AddSystem(doubled(name)) for name in ("one", "two"))
    last = builder.AddNamedSystem("last", Gain(1.0, 3))
    for begin, end in ((source, one), (one, two), (two, last)):
        builder.Connect(begin.get_output_port(), end.get_input_port())
    builder.ExportOutput(last.get_output_port(), "out")
    LogVectorOutput(last.get_output_port(), builder)
    return builder.Build()


def wires(picture):
    """Texts of the tips of its wires."""
    return set(re.findall(r'-> .*\[tooltip="(.*)"\]', str(picture)))


def test_one_level_has_its_systems_as_blocks(loop):
    assert wires(draw(loop)) == {
        "source.y0 (3) → one.asked",
        "one.done (3) → two.asked",
        "two.done (3) → last.u0",
        "last → out",
    }
    assert "first" not in str(draw(loop))


def test_two_levels_have_the_blocks_inside_and_wires_from_block_to_block(loop):
    picture = draw(loop, 2)
    assert wires(picture) == {
        "source.y0 (3) → first.u0",
        "first.y0 (3) → second.u0",
        "second.y0 (3) → first.u0",
        "second.y0 (3) → last.u0",
        "last → out",
    }
    assert len(re.findall("-> ", str(picture))) == 6
    assert re.findall(r'subgraph cluster_\d+ {\n  label="(\w+)"', str(picture)) == ["one", "two"]


def test_a_deeper_level_than_there_is_shows_all_and_none_is_refused(loop):
    assert str(draw(loop, 9)) == str(draw(loop, 2))
    with pytest.raises(ValueError, match="depth must be at least 1, not 0"):
        draw(loop, 0)


def test_what_is_recorded_or_connected_to_nothing_is_left_out(loop):
    text = str(draw(loop, 2))
    assert "unused" not in text
    assert "Log" not in text


def test_the_picture_shows_every_block_and_wire_and_says_where_wires_end(loop):
    pytest.importorskip("pygraphviz")
    picture = ElementTree.fromstring(draw(loop, 2).render())
    groups = picture.iter(f"{_SVG}g")
    kinds = [group.get("class") for group in groups]
    assert kinds.count("edge") == 6
    assert kinds.count("cluster") == 2
    assert kinds.count("node") == 7
    texts = {text.text for text in picture.iter(f"{_SVG}text")}
    assert {"first", "second", "one", "two", "last", "u0", "out"} <= texts
    tips = {end.get("{http://www.w3.org/1999/xlink}title") for end in picture.iter(f"{_SVG}a")}
    assert "first.y0 (3) → second.u0" in tips
    assert ".edge:hover" in picture.find(f"{_SVG}style").text
    assert draw(loop).render("png").startswith(b"\x89PNG")


def test_a_picture_in_a_page_changes_nothing_beside_it_and_is_no_wider(loop):
    pytest.importorskip("pygraphviz")
    shown = draw(loop)._repr_html_()
    assert shown.startswith('<div style="overflow-x: auto"><svg style="background: #FFFFFF"')
    (rules,) = re.findall("<style>(.*?)</style>", shown, re.DOTALL)
    selectors = re.findall(r"^(.*?) \{", rules, re.MULTILINE)
    assert selectors
    assert all(each.startswith(".edge") for rule in selectors for each in rule.split(", "))
