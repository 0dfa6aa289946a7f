"""Block diagrams: systems with their named ports, in the frames of the diagrams that hold them."""

import html
import re
import subprocess
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex
from pydrake.systems.primitives import VectorLogSink

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted

_FONT = "Helvetica,Arial,sans-serif"
_HEAD = f"""\
digraph {{
  splines=spline; bgcolor="transparent"; margin=0;
  graph [fontname="{_FONT}", fontsize=14, labeljust=l, style="rounded,filled", color="#8497B0"];
  node [shape=plain, fontname="{_FONT}", fontsize=12];
  edge [arrowsize=0.7, color="#44546A"];
"""
# Fills: of frames, of a block's head and body, and of the diagram's own inputs and outputs.
_FRAME, _TITLE, _BODY, _INPUT, _OUTPUT = "#F2F5F9", "#DDEBF7", "#FFFFFF", "#FFF2CC", "#E2EFDA"
# Room between blocks [inch]: wires from port to port need more of it.
_ROOM_FOR_PORTS, _ROOM = "nodesep=0.3; ranksep=0.9;", "nodesep=0.1; ranksep=0.4;"
_RANKS = {"right": "LR", "down": "TB"}
_MERGED = 1.8  # width of a wire that stands for several [pt]
_MM_PER_INCH = 25.4
_A4_LANDSCAPE = (277.0, 190.0)  # within margins of 10 mm [mm]
_NO_LIMIT = 10000.0  # height where only the width counts [mm]
_DPI = 200  # resolution of PNG files with a size: letters of 7 pt stay sharp in print
# A wire under the pointer stands out; the browser shows its ends.
_STYLE = """<style>
.edge path, .edge polygon { pointer-events: all; }
.edge:hover path { stroke: #C00000; stroke-width: 3; }
.edge:hover polygon { fill: #C00000; stroke: #C00000; }
</style>"""
# Graphviz in a program of its own: it complains on the caller's error channel.
_GRAPHVIZ = """
import sys, pygraphviz
graph = pygraphviz.AGraph(sys.stdin.read())
graph.layout("dot")
sys.stdout.buffer.write(graph.draw(format=sys.argv[1]))
"""


class BlockDiagram:
    """A picture of a diagram: blocks, named ports and the wires between them.

    Sinks of recordings and idle constants are left out. It shows itself in a notebook; its text is
    there without Graphviz too.

    Attributes:
        text: the picture in Graphviz's language.
    """

    def __init__(
        self,
        diagram: Diagram,
        depth: int = 1,
        *,
        ports: bool = True,
        direction: str | None = None,
        without: Collection[str] = (),
        width_mm: float | None = None,
        fits_page: bool = False,
    ):
        """Describes a diagram.

        Args:
            diagram: any diagram, such as a closed loop, its station or its controller.
            depth: levels that are shown: 1 its own systems as blocks, 2 also theirs, in frames.
            ports: true if blocks show their ports, and each wire is drawn; otherwise blocks are
                names only, and one wire stands for all from one block to another.
            direction: way that data flow, "right" or "down"; None: right with ports, otherwise
                down, which is the more compact of both.
            without: names of systems and diagrams that are left out with their wires, such as
                "plant" or, where several have that name, "station/plant".
            width_mm: width of the picture in print [mm]; None: as `fits_page` says.
            fits_page: true if the picture must not be larger than a landscape page of A4.

        Raises:
            ValueError: a depth below 1, or a direction that does not exist.
            ParapodError: a name in `without` that is not a system of the picture.
        """
        if depth < 1:
            raise ValueError(f"depth must be at least 1, not {depth}")
        way = direction or ("right" if ports else "down")
        if way not in _RANKS:
            raise ValueError(f"direction must be {' or '.join(_RANKS)}, not {quoted(way)}")
        names = system_names(diagram, depth)
        for name in without:
            if name not in names:
                raise ParapodError(
                    f"there is no system {quoted(name)} to leave out; "
                    f"there are: {', '.join(_without_paths(names))}"
                )
        picture = _Picture(diagram, depth, ports, frozenset(without))
        room = _ROOM_FOR_PORTS if ports else _ROOM
        self._is_sized = width_mm is not None or fits_page
        self._width_mm = width_mm
        size = ""
        if width_mm is not None:
            size = f'\n  size="{_inches(width_mm, _NO_LIMIT)}!";'
        elif fits_page:
            size = f'\n  size="{_inches(*_A4_LANDSCAPE)}";'
        self.text = f"{_HEAD}  rankdir={_RANKS[way]}; {room}{size}\n{picture.body}\n}}\n"
        self._name = diagram.get_name()

    def __repr__(self) -> str:
        return f"<block diagram of '{self._name}'>"

    def __str__(self) -> str:
        return self.text

    def render(self, suffix: str = "svg") -> bytes:
        """The picture as the content of a file.

        Args:
            suffix: "svg", "png" or "pdf". In an SVG the pointer shows a wire's ends.

        Raises:
            MissingExtra: pygraphviz is not installed.
            ParapodError: Graphviz refuses.
        """
        text = self.text
        if suffix == "png" and self._is_sized:
            text = text.replace("\n", f"\n  dpi={_DPI};\n", 1)
        picture = render(text, suffix)
        if suffix != "svg":
            return picture
        if self._width_mm is not None:
            picture = _with_width(picture, self._width_mm)
        opened = rb'<svg style="background: #FFFFFF"\1>' + _STYLE.encode()
        return re.sub(rb"<svg([^>]*)>", opened, picture, count=1)

    def _repr_html_(self) -> str:
        try:
            svg = self.render().decode()
        except ParapodError as error:
            text = (
                f"<summary>{html.escape(str(error))}</summary><pre>{html.escape(self.text)}</pre>"
            )
            return f"<details>{text}</details>"
        # As wide as it is: a page shows a part of it rather than all of it beyond its edge.
        return f'<div style="overflow-x: auto">{svg[svg.index("<svg") :]}</div>'


def draw(
    diagram: Diagram,
    depth: int = 1,
    *,
    ports: bool = True,
    direction: str | None = None,
    without: Collection[str] = (),
    width_mm: float | None = None,
    fits_page: bool = False,
) -> BlockDiagram:
    """Draws a diagram: blocks and named ports, and its diagrams' own to a depth.

    See `BlockDiagram`.
    """
    return BlockDiagram(
        diagram,
        depth,
        ports=ports,
        direction=direction,
        without=without,
        width_mm=width_mm,
        fits_page=fits_page,
    )


def system_names(diagram: Diagram, depth: int) -> list[str]:
    """Names of the systems that a picture can show, those in a frame also with its name.

    Args:
        diagram: diagram of the picture.
        depth: levels of the picture.
    """
    names: dict[str, None] = {}
    for system in _shown(diagram):
        names[system.get_name()] = None
        if depth > 1 and _is_opened(system):
            for inner in system_names(system, depth - 1):
                names |= dict.fromkeys((inner, f"{system.get_name()}/{inner}"))
    return list(names)


def part_of(diagram: Diagram, name: str) -> Diagram:
    """A diagram inside another one, by its name.

    Args:
        diagram: diagram to search, at all levels.
        name: name of the part.

    Raises:
        ParapodError: there is no such part; names those that there are.
    """
    parts = dict(_parts(diagram))
    if name not in parts:
        raise ParapodError(f"there is no part {quoted(name)}; there are: {', '.join(parts)}")
    return parts[name]


def _parts(diagram: Any) -> Iterator[tuple[str, Any]]:
    for system in _shown(diagram):
        if _is_opened(system):
            yield system.get_name(), system
            yield from _parts(system)


def render(text: str, suffix: str = "svg") -> bytes:
    """The picture of a graph in Graphviz's language, as the content of a file.

    Args:
        text: the graph.
        suffix: "svg", "png" or "pdf".

    Raises:
        MissingExtra: pygraphviz is not installed.
        ParapodError: Graphviz refuses.
    """
    need("pygraphviz")
    command = [sys.executable, "-c", _GRAPHVIZ, suffix]
    process = subprocess.run(command, input=text.encode(), capture_output=True, check=False)
    if process.returncode != 0:
        complaints = process.stderr.decode().strip().splitlines()
        raise ParapodError(f"Graphviz: {complaints[-1] if complaints else process.returncode}")
    return process.stdout


def type_name(system: Any) -> str:
    """Name of a system's type as people write it, without the scalar type."""
    return class_name(type(system))


def class_name(kind: type) -> str:
    """Name of a class of systems as people write it, without the scalar type."""
    return re.sub(r"_?(\[.*\]|𝓣.*𝓤)$", "", kind.__name__)


class _Port(NamedTuple):
    """A port of a block, by its number."""

    system: Any
    number: int


@dataclass
class _Block:
    """A system that is drawn as one block, and which of its ports are wired."""

    system: Any
    number: int
    # Inputs, and the block and output behind each.
    ins: dict[int, tuple[int, int]] = field(default_factory=dict)
    outs: set[int] = field(default_factory=set)


class _Picture:
    """Content of a picture, in Graphviz's language.

    Attributes:
        body: blocks, frames and wires.
    """

    def __init__(self, diagram: Diagram, depth: int, ports: bool, without: frozenset[str]):
        self._blocks: dict[Any, _Block] = {}
        self._frames = 0
        self._opened: set[Any] = set()
        self._has_ports, self._without = ports, without
        self._ends_in_use: set[str] = set()
        # Tips of the wires from one place to another.
        self._tips: dict[tuple[str, str], list[str]] = {}
        self._collect(diagram, depth, "")
        self._wires(diagram)
        self._exported(diagram)
        # Where others are connected, what is not says nothing.
        self._is_alone = not self._tips
        edges = (self._wire(*ends, tips) for ends, tips in self._tips.items())
        self.body = "\n".join([*self._frame(diagram), *self._ends(diagram), *edges])

    def _collect(self, diagram: Any, depth: int, path: str) -> None:
        self._opened.add(diagram)
        for system in _shown(diagram):
            full = f"{path}/{system.get_name()}"
            if any(full.endswith(f"/{name}") for name in self._without):
                continue
            if depth > 1 and _is_opened(system):
                self._collect(system, depth - 1, full)
            else:
                self._blocks[system] = _Block(system, len(self._blocks))

    # --- wires, from block to block

    def _source(self, system: Any, port: int) -> _Port | None:
        """The block's output behind an output."""
        while system in self._opened:
            system, port = system.get_output_port_locator(OutputPortIndex(port))
        return _Port(system, int(port)) if system in self._blocks else None

    def _sinks(self, system: Any, port: int) -> Iterator[_Port]:
        """The blocks' inputs behind an input."""
        if system in self._opened:
            for inner, index in system.GetInputPortLocators(InputPortIndex(port)):
                yield from self._sinks(inner, int(index))
        elif system in self._blocks:
            yield _Port(system, int(port))

    def _wires(self, diagram: Any) -> None:
        for (sink, into), (source, out) in diagram.connection_map().items():
            begin = self._source(source, int(out))
            for end in self._sinks(sink, int(into)) if begin else ():
                assert begin is not None
                self._add(self._leaving(begin), self._entering(end, begin), _tip(begin, end))
        for system in diagram.GetSystems():
            if system in self._opened:
                self._wires(system)

    def _exported(self, diagram: Any) -> None:
        for i in range(diagram.num_input_ports()):
            for end in self._sinks(diagram, i):
                name = f"{diagram.get_input_port(i).get_name()} → {end.system.get_name()}"
                self._add(self._end(f"in{i}", "e"), self._entering(end), name)
        for i in range(diagram.num_output_ports()):
            if begin := self._source(diagram, i):
                name = f"{begin.system.get_name()} → {diagram.get_output_port(i).get_name()}"
                self._add(self._leaving(begin), self._end(f"out{i}", "w"), name)

    def _add(self, begin: str, end: str, tip: str) -> None:
        self._tips.setdefault((begin, end), []).append(tip)

    def _leaving(self, port: _Port) -> str:
        block = self._blocks[port.system]
        block.outs.add(port.number)
        return f"n{block.number}" + (f":o{port.number}:e" if self._has_ports else "")

    def _entering(self, port: _Port, begin: _Port | None = None) -> str:
        block = self._blocks[port.system]
        of = (-1, 0) if begin is None else (self._blocks[begin.system].number, begin.number)
        block.ins.setdefault(port.number, of)
        return f"n{block.number}" + (f":i{port.number}:w" if self._has_ports else "")

    def _end(self, name: str, side: str) -> str:
        self._ends_in_use.add(name)
        return f"{name}:{side}" if self._has_ports else name

    @staticmethod
    def _wire(begin: str, end: str, tips: list[str]) -> str:
        width = f"penwidth={_MERGED}, " if len(tips) > 1 else ""
        text = "\\n".join(_quoted(tip)[1:-1] for tip in tips)
        return f'  {begin} -> {end} [{width}tooltip="{text}"];'

    # --- what they connect

    def _frame(self, diagram: Any) -> Iterator[str]:
        """Blocks of a diagram, those of its opened diagrams in frames."""
        for system in diagram.GetSystems():
            block = self._blocks.get(system)
            if block is not None and (block.ins or block.outs or self._is_alone):
                yield self._block(block)
            elif system in self._opened and (inner := [*self._frame(system)]):
                self._frames += 1
                title = _quoted(system.get_name())
                yield f"  subgraph cluster_{self._frames} {{"
                yield f'  label={title}; tooltip={title}; fillcolor="{_FRAME}";'
                yield from inner
                yield "  }"

    def _ends(self, diagram: Any) -> Iterator[str]:
        """The diagram's own inputs and outputs, as far as blocks are behind them."""
        for letter, count, port_of, fill in (
            ("in", diagram.num_input_ports(), diagram.get_input_port, _INPUT),
            ("out", diagram.num_output_ports(), diagram.get_output_port, _OUTPUT),
        ):
            for i in range(count):
                if f"{letter}{i}" not in self._ends_in_use:
                    continue
                name = _quoted(port_of(i).get_name())
                yield f'  {letter}{i} [label={name}, shape=cds, style=filled, fillcolor="{fill}"];'

    def _block(self, block: _Block) -> str:
        """A table: name and type above, inputs on the left and outputs on the right."""
        system = block.system
        name, kind = html.escape(system.get_name()), html.escape(type_name(system))
        # In the order in which their wires come, so that these cross less.
        inputs = sorted(block.ins, key=lambda i: (block.ins[i], i))
        inputs_at_left = [(f"i{i}", system.get_input_port(i).get_name()) for i in inputs]
        right = [(f"o{i}", system.get_output_port(i).get_name()) for i in sorted(block.outs)]
        rows = []
        for k in range(max(len(inputs_at_left), len(right)) if self._has_ports else 0):
            cells = []
            for side, align in ((inputs_at_left, "LEFT"), (right, "RIGHT")):
                port, text = side[k] if k < len(side) else ("", "")
                here = f' PORT="{port}"' if port else ""
                cells.append(f'<TD{here} ALIGN="{align}" BORDER="0">{html.escape(text)}</TD>')
            rows.append(f"<TR>{''.join(cells)}</TR>")
        says_more = (
            kind not in ("Diagram", "Station") and kind.lower() != name.replace("_", "").lower()
        )
        below = f"<BR/><I>{kind}</I>" if says_more else ""
        head = f'<TR><TD COLSPAN="2" BGCOLOR="{_TITLE}"><B>{name}</B>{below}</TD></TR>'
        table = (
            f'<TABLE BORDER="1" CELLBORDER="0" CELLSPACING="0" CELLPADDING="4" BGCOLOR="{_BODY}">'
        )
        tip = _quoted(f"{system.get_name()}: {type_name(system)}")
        label = f"<{table}{head}{''.join(rows)}</TABLE>>"
        return f"  n{block.number} [label={label}, tooltip={tip}];"


def _tip(begin: _Port, end: _Port) -> str:
    """Both ends of a wire, and its width."""
    out, into = begin.system.get_output_port(begin.number), end.system.get_input_port(end.number)
    width = f" ({out.size()})" if out.size() else ""
    ends = (f"{begin.system.get_name()}.{out.get_name()}{width}", end.system.get_name())
    return f"{ends[0]} → {ends[1]}.{into.get_name()}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _shown(diagram: Diagram) -> list[Any]:
    systems: Any = diagram.GetSystems()
    return [system for system in systems if not _is_left_out(system)]


def _is_opened(system: Any) -> bool:
    """Whether a system is a diagram that a deeper level opens."""
    return isinstance(system, Diagram) and len(_shown(system)) > 1


def _without_paths(names: Collection[str]) -> list[str]:
    """Names alone, without those that begin with a frame's."""
    return [name for name in names if "/" not in name]


def _inches(width: float, height: float) -> str:
    return f"{width / _MM_PER_INCH:.4f},{height / _MM_PER_INCH:.4f}"


def _with_width(svg: bytes, width: float) -> bytes:
    """A picture whose size is exact: Graphviz rounds it to points."""
    match = re.search(rb'viewBox="[\d.]+ [\d.]+ ([\d.]+) ([\d.]+)"', svg)
    assert match is not None
    height = width * float(match[2]) / float(match[1])
    size = f'width="{width:g}mm" height="{height:.1f}mm"'.encode()
    return re.sub(rb'width="\d+pt" height="\d+pt"', size, svg, count=1)


def _is_left_out(system: Any) -> bool:
    return isinstance(system, VectorLogSink) or system.get_name().startswith("idle.")
