"""Port tables, which every system has in its docstring, as data."""

import inspect
import re
from typing import NamedTuple

_ROW = re.compile(
    r"^\s*\| (in|out) `([^`]+)` \|([^|]*)\|([^|]*)\|([^|]*)\|\s*$",
    re.MULTILINE,
)


class PortRow(NamedTuple):
    """A row of a port table.

    Attributes:
        direction: "in" or "out".
        name: the port.
        size: number of elements, or a letter for what follows from the arguments.
        unit: unit of the elements, separated by commas where they differ.
        meaning: meaning of the signal.
    """

    direction: str
    name: str
    size: str
    unit: str
    meaning: str


def port_table(kind: type) -> list[PortRow]:
    """Rows of the port table in the docstring of a class of systems; none where it has none."""
    rows = _ROW.findall(inspect.getdoc(kind) or "")
    return [PortRow(*(cell.strip() for cell in row)) for row in rows]
