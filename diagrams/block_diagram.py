"""Block diagrams: the systems of one level with their named ports, as Graphviz draws them."""

import html
import re
import shutil
import subprocess
from typing import Any

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex
from pydrake.systems.primitives import VectorLogSink

from parapod.systems.core.errors import ParapodError

_HEAD = """\
digraph {
  rankdir=LR; nodesep=0.35; ranksep=1.1; splines=spline;
  node [shape=plain, fontname="Helvetica", fontsize=11];
  edge [arrowsize=0.7, color="#44546A"];
"""


class BlockDiagram:
    """A picture of one level of a diagram: blocks, named ports and the wires between them.

    Sinks of recordings and idle constants are left out. It shows itself in a notebook where the
    program `dot` of Graphviz is installed; its text is always there.

    Attributes:
        text: the picture in Graphviz's language.
    """

    def __init__(self, diagram: Diagram):
        """Describes a diagram.

        Args:
            diagram: any diagram, such as a closed loop, its station or its controller.
        """
        self.text = _describe(diagram)
        self._name = diagram.get_name()

    def __repr__(self) -> str:
        return f"<block diagram of '{self._name}'>"

    def __str__(self) -> str:
        return self.text

    def render(self, suffix: str = "svg") -> bytes:
        """The picture as the content of a file.

        Args:
            suffix: "svg", "png" or "pdf".

        Raises:
            ParapodError: `dot` is not installed, or refuses.
        """
        dot = shutil.which("dot")
        if dot is None:
            raise ParapodError(
                "pictures need the program 'dot' of Graphviz (on Debian: apt install graphviz)"
            )
        command = [dot, f"-T{suffix}"]
        done = subprocess.run(command, input=self.text.encode(), capture_output=True, check=False)
        if done.returncode != 0:
            reason = " ".join(done.stderr.decode().split()) or f"exit code {done.returncode}"
            raise ParapodError(f"dot: {reason}")
        return done.stdout

    def _repr_html_(self) -> str:
        try:
            svg = self.render().decode()
        except ParapodError as error:
            text = (
                f"<summary>{html.escape(str(error))}</summary><pre>{html.escape(self.text)}</pre>"
            )
            return f"<details>{text}</details>"
        return svg[svg.index("<svg") :]


def draw(diagram: Diagram) -> BlockDiagram:
    """Draws one level of a diagram: blocks and named ports; see `BlockDiagram`."""
    return BlockDiagram(diagram)


def type_name(system: Any) -> str:
    """Name of a system's type as people write it, without the scalar type."""
    return re.sub(r"_?(\[.*\]|𝓣.*𝓤)$", "", type(system).__name__)


def _describe(diagram: Diagram) -> str:
    systems = [s for s in diagram.GetSystems() if not _is_left_out(s)]
    number = {s: i for i, s in enumerate(systems)}
    inner: Any = diagram
    wires = [
        (number[source], out, number[sink], into)
        for (sink, into), (source, out) in inner.connection_map().items()
        if sink in number and source in number
    ]
    ins: dict[int, set[int]] = {i: set() for i in number.values()}
    outs: dict[int, set[int]] = {i: set() for i in number.values()}
    for source, out, sink, into in wires:
        outs[source].add(int(out))
        ins[sink].add(int(into))
    lines, exported = [], []
    for i in range(diagram.num_input_ports()):
        name = diagram.get_input_port(i).get_name()
        for system, port in inner.GetInputPortLocators(InputPortIndex(i)):
            if system in number:
                ins[number[system]].add(int(port))
                exported.append(f"  in{i}:e -> n{number[system]}:i{int(port)}:w;")
        lines.append(f'  in{i} [label="{name}", shape=cds, style=filled, fillcolor="#FFF2CC"];')
    for i in range(diagram.num_output_ports()):
        name = diagram.get_output_port(i).get_name()
        system, port = inner.get_output_port_locator(OutputPortIndex(i))
        if system in number:
            outs[number[system]].add(int(port))
            exported.append(f"  n{number[system]}:o{int(port)}:e -> out{i}:w;")
            lines.append(
                f'  out{i} [label="{name}", shape=cds, style=filled, fillcolor="#E2EFDA"];'
            )
    lines += [_block(i, system, ins[i], outs[i]) for system, i in number.items()]
    lines += [f"  n{a}:o{int(o)}:e -> n{b}:i{int(k)}:w;" for a, o, b, k in wires]
    return _HEAD + "\n".join((*lines, *exported)) + "\n}\n"


def _is_left_out(system: Any) -> bool:
    return isinstance(system, VectorLogSink) or system.get_name().startswith("idle.")


def _block(number: int, system: Any, ins: set[int], outs: set[int]) -> str:
    """A table: name and type above, inputs on the left and outputs on the right."""
    name, kind = html.escape(system.get_name()), html.escape(type_name(system))
    left = [(f"i{i}", system.get_input_port(i).get_name()) for i in sorted(ins)]
    right = [(f"o{i}", system.get_output_port(i).get_name()) for i in sorted(outs)]
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
    head = f'<TR><TD COLSPAN="2" BGCOLOR="#DDEBF7"><B>{name}</B>{below}</TD></TR>'
    table = '<TABLE BORDER="1" CELLBORDER="0" CELLSPACING="0" CELLPADDING="4">'
    return f"  n{number} [label=<{table}{head}{''.join(rows)}</TABLE>>];"
