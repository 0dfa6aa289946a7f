"""Pictures of diagrams: every block, port and wire is there, as deep as is asked for."""

import re
from xml.etree import ElementTree

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    LogVectorOutput,
    Multiplexer,
)

from parapod.diagrams.block_diagram import draw, part_of
from parapod.sims.cli.main import main
from parapod.systems.core.errors import ParapodError

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


def test_without_ports_one_wire_stands_for_all_between_two_blocks():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", Demultiplexer([1, 2]))
    sink = builder.AddNamedSystem("sink", Multiplexer([1, 2]))
    for i in range(2):
        builder.Connect(source.get_output_port(i), sink.get_input_port(i))
    text = str(draw(builder.Build(), ports=False))
    assert re.findall(r"n\d+ -> n\d+ \[.*\]", text) == [
        'n0 -> n1 [penwidth=1.8, tooltip="source.y0 (1) → sink.u0\\nsource.y1 (2) → sink.u1"]'
    ]
    assert "PORT=" not in text
    assert "rankdir=TB" in text


def test_inputs_are_listed_in_the_order_of_their_wires():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", Demultiplexer([1, 1]))
    sink = builder.AddNamedSystem("sink", Multiplexer([1, 1]))
    builder.Connect(source.get_output_port(0), sink.get_input_port(1))
    builder.Connect(source.get_output_port(1), sink.get_input_port(0))
    (block,) = re.findall(r"n1 \[label=.*", str(draw(builder.Build())))
    assert re.findall(r">(u\d)<", block) == ["u1", "u0"]


def test_systems_and_parts_are_left_out_with_their_wires(loop):
    assert wires(draw(loop, 2, without=["one"])) == {
        "first.y0 (3) → second.u0",
        "second.y0 (3) → last.u0",
        "last → out",
    }
    text = str(draw(loop, 2, without=["two/first", "last"]))
    assert wires(text) == {"source.y0 (3) → first.u0", "first.y0 (3) → second.u0"}
    assert re.findall(r'label="(\w+)"', text) == ["one"]  # nothing is left in the other frame
    assert not re.search(r"\bout0\b", text)


def test_a_system_that_does_not_exist_cannot_be_left_out(loop):
    with pytest.raises(ParapodError, match=r"'frst' .*: source, unused, one, first, second, two"):
        draw(loop, 2, without=["frst"])
    with pytest.raises(ParapodError, match="there is no system 'first'"):  # at this level
        draw(loop, without=["first"])


def test_a_part_is_drawn_alone_with_its_own_ends(loop):
    assert wires(draw(part_of(loop, "two"))) == {
        "asked → first",
        "first.y0 (3) → second.u0",
        "second → done",
    }
    with pytest.raises(ParapodError, match=r"there is no part 'first'; there are: one, two$"):
        part_of(loop, "first")


def test_a_direction_that_does_not_exist_is_refused(loop):
    assert "rankdir=TB" in str(draw(loop, direction="down"))
    with pytest.raises(ValueError, match="direction must be right or down, not 'up'"):
        draw(loop, direction="up")


@pytest.mark.parametrize("width", [84.0, 277.0])
def test_a_picture_is_as_wide_as_is_asked_for(loop, width):
    pytest.importorskip("pygraphviz")
    picture = draw(loop, 2, width_mm=width)
    assert f'size="{width / 25.4:.4f},' in str(picture)
    svg = ElementTree.fromstring(picture.render())
    assert svg.get("width") == f"{width:g}mm"
    box = [float(number) for number in svg.get("viewBox").split()]
    height = float(svg.get("height").removesuffix("mm"))
    assert height / width == pytest.approx(box[3] / box[2], rel=0.01)
    wide = re.search(rb"MediaBox \[ 0 0 ([\d.]+) ", picture.render("pdf"))[1]
    assert float(wide) == pytest.approx(width / 25.4 * 72, abs=1.0)
    header = picture.render("png")[16:20]  # width in pixels
    assert int.from_bytes(header) == pytest.approx(width / 25.4 * 200, abs=3)


@pytest.mark.parametrize("name", ["level", "chair-walk", "centre-machining", "bench-walk"])
def test_loops_fit_a_page_with_letters_that_can_be_read(name, tmp_path):
    pytest.importorskip("pygraphviz")
    path = tmp_path / "loop.svg"
    assert main(["draw", name, "--out", str(path)]) == 0
    svg = path.read_text()
    wide, high = (
        float(size) for size in re.search(r'width="(.*?)pt" height="(.*?)pt"', svg).groups()
    )
    assert wide <= 297.0 / 25.4 * 72
    assert high <= 210.0 / 25.4 * 72
    scale = float(re.search(r"scale\(([\d.]+)", svg)[1])
    (letters,) = {float(size) for size in re.findall(r'font-size="([\d.]+)"', svg)} - {14.0}
    assert scale * letters >= 6.0  # [pt]


def test_the_command_leaves_out_what_is_named_and_draws_parts(tmp_path):
    path = tmp_path / "loop.dot"
    command = ["draw", "level", "--out", str(path)]
    assert main([*command, "--without", "plant", "--without", "controller"]) == 0
    text = path.read_text()
    assert '"controller"' not in text
    assert "MultibodyPlant" not in text
    assert "pi_controller" not in text
    assert "linear_actuator" in text
    assert main([*command, "--only", "controller", "--width-mm", "84"]) == 0
    text = path.read_text()
    assert "pi_controller" in text
    assert "linear_actuator" not in text
    assert "PORT=" in text
    assert f'size="{84 / 25.4:.4f},' in text


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--without", "plan"], r"no system 'plan' to leave out; there are: .*\bplant\b"),
        (["--only", "plant"], r"no part 'plant'; there are: .*\bcontroller\b"),
        (["--width-mm", "5"], r"from 40 to 1000 mm, not '5'"),
        (["--direction", "up"], r"choose from '?right'?, '?down'?"),
        (["--depth", "0"], r"whole number of 1 or more, not '0'"),
    ],
)
def test_the_command_refuses_wrong_values_in_one_line(options, says, tmp_path, capsys):
    path = tmp_path / "loop.dot"
    assert main(["draw", "level", "--out", str(path), *options]) == 2
    said = capsys.readouterr().err
    assert re.fullmatch(rf"parapod: error: .*{says}.*\n", said)
    assert not path.exists()
