"""Block diagrams: systems with their named ports, in the frames of the diagrams that hold them."""

import html
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex
from pydrake.systems.primitives import VectorLogSink

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.extras import need

_FONT = "Helvetica,Arial,sans-serif"
_HEAD = f"""\
digraph {{
  rankdir=LR; nodesep=0.3; ranksep=0.9; splines=spline; newrank=true; bgcolor="transparent";
  graph [fontname="{_FONT}", fontsize=14, labeljust=l, style="rounded,filled", color="#8497B0"];
  node [shape=plain, fontname="{_FONT}", fontsize=11];
  edge [arrowsize=0.7, color="#44546A"];
"""
# Fills: of frames, of a block's head and body, and of the diagram's own inputs and outputs.
_FRAME, _TITLE, _BODY, _INPUT, _OUTPUT = "#F2F5F9", "#DDEBF7", "#FFFFFF", "#FFF2CC", "#E2EFDA"
# A wire under the pointer stands out; its ends are told by the browser.
_STYLE = """<style>
.edge path, .edge polygon { pointer-events: all; }
.edge:hover path { stroke: #C00000; stroke-width: 3; }
.edge:hover polygon { fill: #C00000; stroke: #C00000; }
</style>"""
# Graphviz in a program of its own: it complains on the channel of errors of whoever calls it.
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

    def __init__(self, diagram: Diagram, depth: int = 1):
        """Describes a diagram.

        Args:
            diagram: any diagram, such as a closed loop, its station or its controller.
            depth: levels that are shown: 1 its own systems as blocks, 2 also theirs, in frames.

        Raises:
            ValueError: a depth below 1.
        """
        if depth < 1:
            raise ValueError(f"depth must be at least 1, not {depth}")
        self.text = _Picture(diagram, depth).text
        self._name = diagram.get_name()

    def __repr__(self) -> str:
        return f"<block diagram of '{self._name}'>"

    def __str__(self) -> str:
        return self.text

    def render(self, suffix: str = "svg") -> bytes:
        """The picture as the content of a file.

        Args:
            suffix: "svg", "png" or "pdf". In an SVG the pointer tells a wire's ends.

        Raises:
            MissingExtra: pygraphviz is not installed.
            ParapodError: Graphviz refuses.
        """
        picture = render(self.text, suffix)
        if suffix != "svg":
            return picture
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


def draw(diagram: Diagram, depth: int = 1) -> BlockDiagram:
    """Draws a diagram: blocks and named ports, and its diagrams' own to a depth.

    See `BlockDiagram`.
    """
    return BlockDiagram(diagram, depth)


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
    done = subprocess.run(command, input=text.encode(), capture_output=True, check=False)
    if done.returncode != 0:
        complaints = done.stderr.decode().strip().splitlines()
        raise ParapodError(f"Graphviz: {complaints[-1] if complaints else done.returncode}")
    return done.stdout


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
    ins: set[int] = field(default_factory=set)
    outs: set[int] = field(default_factory=set)


class _Picture:
    """Graphviz's text of a diagram."""

    def __init__(self, diagram: Diagram, depth: int):
        self._blocks: dict[Any, _Block] = {}
        self._frames = 0
        self._opened: set[Any] = set()
        self._collect(diagram, depth)
        edges = [*self._wires(diagram), *self._exported(diagram)]
        # Where others are connected, what is not says nothing.
        self._is_alone = not edges
        body = [*self._frame(diagram), *self._ends(diagram), *edges]
        self.text = _HEAD + "\n".join(body) + "\n}\n"

    def _collect(self, diagram: Any, depth: int) -> None:
        self._opened.add(diagram)
        for system in _shown(diagram):
            if depth > 1 and isinstance(system, Diagram) and len(_shown(system)) > 1:
                self._collect(system, depth - 1)
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

    def _wires(self, diagram: Any) -> Iterator[str]:
        for (sink, into), (source, out) in diagram.connection_map().items():
            begin = self._source(source, int(out))
            for end in self._sinks(sink, int(into)) if begin else ():
                assert begin is not None
                yield self._wire(self._leaving(begin), self._entering(end), _tip(begin, end))
        for system in diagram.GetSystems():
            if system in self._opened:
                yield from self._wires(system)

    def _exported(self, diagram: Any) -> Iterator[str]:
        for i in range(diagram.num_input_ports()):
            for end in self._sinks(diagram, i):
                name = f"{diagram.get_input_port(i).get_name()} → {end.system.get_name()}"
                yield self._wire(f"in{i}:e", self._entering(end), name)
        for i in range(diagram.num_output_ports()):
            if begin := self._source(diagram, i):
                name = f"{begin.system.get_name()} → {diagram.get_output_port(i).get_name()}"
                yield self._wire(self._leaving(begin), f"out{i}:w", name)

    def _leaving(self, port: _Port) -> str:
        block = self._blocks[port.system]
        block.outs.add(port.number)
        return f"n{block.number}:o{port.number}:e"

    def _entering(self, port: _Port) -> str:
        block = self._blocks[port.system]
        block.ins.add(port.number)
        return f"n{block.number}:i{port.number}:w"

    @staticmethod
    def _wire(begin: str, end: str, tip: str) -> str:
        return f"  {begin} -> {end} [tooltip={_quoted(tip)}];"

    # --- what they connect

    def _frame(self, diagram: Any) -> Iterator[str]:
        """Blocks of a diagram, those of its opened diagrams in frames."""
        for system in diagram.GetSystems():
            block = self._blocks.get(system)
            if block is not None and (block.ins or block.outs or self._is_alone):
                yield self._block(block)
            elif system in self._opened:
                self._frames += 1
                title = _quoted(system.get_name())
                yield f"  subgraph cluster_{self._frames} {{"
                yield f'  label={title}; tooltip={title}; fillcolor="{_FRAME}";'
                yield from self._frame(system)
                yield "  }"

    @staticmethod
    def _ends(diagram: Any) -> Iterator[str]:
        """The diagram's own inputs and outputs, as far as blocks are behind them."""
        for letter, count, port_of, fill in (
            ("in", diagram.num_input_ports(), diagram.get_input_port, _INPUT),
            ("out", diagram.num_output_ports(), diagram.get_output_port, _OUTPUT),
        ):
            for i in range(count):
                name = _quoted(port_of(i).get_name())
                yield f'  {letter}{i} [label={name}, shape=cds, style=filled, fillcolor="{fill}"];'

    @staticmethod
    def _block(block: _Block) -> str:
        """A table: name and type above, inputs on the left and outputs on the right."""
        system = block.system
        name, kind = html.escape(system.get_name()), html.escape(type_name(system))
        left = [(f"i{i}", system.get_input_port(i).get_name()) for i in sorted(block.ins)]
        right = [(f"o{i}", system.get_output_port(i).get_name()) for i in sorted(block.outs)]
        rows = []
        for k in range(max(len(left), len(right))):
            cells = []
            for side, align in ((left, "LEFT"), (right, "RIGHT")):
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


def _is_left_out(system: Any) -> bool:
    return isinstance(system, VectorLogSink) or system.get_name().startswith("idle.")
