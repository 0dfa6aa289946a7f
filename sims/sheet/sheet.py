"""Data sheet of a machine as a scenario sets it: entries in closed form, evaluated when asked for.

A machine's sheet is a class with one method an entry, whose first line says what it is:

    class PlatformSheet(Sheet[LevellingScenario, PlatformGeometry, KinematicPlatformParams]):
        @entry("ground", "deg")
        def level_range_deg(self) -> float:
            \"\"\"Largest inclination of ground that it levels in every direction.\"\"\"

Each is worked out once. A search over designs asks for few of them, and nothing else is computed.
Sheets are found by the name of their machine among the entry points `parapod.sheets`.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from parapod.sims.output.figures import Figure
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.installed import installed
from parapod.systems.core.quoting import did_you_mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

GROUP = "parapod.sheets"
# Components of a wrench.
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")

type Wrench = tuple[float, float, float, float, float, float]


class Entry(cached_property[Any]):
    """One number of a sheet.

    Attributes:
        group: heading below which it stands.
        unit: its unit; "" without one.
        meaning: first sentence of its docstring, without the full stop.
    """

    def __init__(self, work: Callable[[Any], float], group: str, unit: str):
        """Wraps a method; see `entry`."""
        super().__init__(work)
        self.group, self.unit = group, unit
        first, *_ = inspect.cleandoc(work.__doc__ or "").split("\n\n")
        self.meaning = " ".join(first.split()).rstrip(".")


def entry(group: str, unit: str = "") -> Callable[[Callable[[Any], float]], Any]:
    """Decorator of a method that works out an entry; its name ends with the unit.

    Args:
        group: heading below which it stands.
        unit: its unit; "" without one.
    """
    return partial(Entry, group=group, unit=unit)


def extents(
    group: str, meanings: Sequence[str], work: Callable[[Any], NDArray[np.float64]]
) -> list[Any]:
    """Entries of the extents of a workspace along x, y and z, in mm.

    Args:
        group: heading below which they stand.
        meanings: first sentence of each, without the full stop.
        work: works out lowest and highest places (2, 3) of a sheet [m].
    """

    def along(axis: int, meaning: str) -> Any:
        def extent(sheet: Any) -> float:
            return 1e3 * float(np.ptp(work(sheet)[:, axis]))

        extent.__doc__ = meaning
        return Entry(extent, group, "mm")

    return [along(axis, meaning) for axis, meaning in enumerate(meanings)]


@dataclass(frozen=True)
class Dimension:
    """A dimension line in a drawing.

    Attributes:
        view: drawing in which it stands.
        start: its first point (3), in the drawing's frame [m].
        end: its second point (3) [m].
        name: name of the length, such as "l_4"; "" for the number alone.
    """

    view: Literal["plan", "elevation"]
    start: Sequence[float]
    end: Sequence[float]
    name: str = ""


@dataclass(frozen=True)
class Demonstration:
    """A run with rigid bodies that shows an entry.

    Attributes:
        entry: name of the entry.
        settings: values of the experiment's scenario by dotted keys.
        words: description of what is run, such as "on ground of 5 deg".
    """

    entry: str
    settings: Mapping[str, Any]
    words: str


@dataclass(frozen=True)
class Table:
    """A table of a sheet.

    Attributes:
        title: a few words.
        columns: headings, with their units.
        rows: texts and numbers of each row.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float]]


class Sheet[S, G, M]:
    """Data sheet of one machine; a base for those of the kinds.

    Attributes:
        usual_wrench: wrench where none is asked for [N, N m].
        highlights: names of the entries that stand above all others.
        scenario: the scenario that sets it.
        wrench: force and moment at the tool or the seat under which its deflection is told
            [N, N m].
    """

    usual_wrench: ClassVar[Wrench] = (0.0, 0.0, -100.0, 0.0, 0.0, 0.0)
    highlights: ClassVar[Sequence[str]] = ()
    scenario: S
    wrench: Wrench

    def __init__(self, scenario: S, wrench: Wrench | None = None):
        """Works out nothing yet.

        Args:
            scenario: a scenario of the machine.
            wrench: force and moment at the tool or the seat, along the machine's axes [N, N m];
                None: the usual one.
        """
        self.scenario = scenario
        self.wrench = self.usual_wrench if wrench is None else wrench

    @cached_property
    def geometry(self) -> G:
        """Dimensions of the machine in SI units."""
        scenario: Any = self.scenario
        geometry: G = scenario.machine.geometry
        return geometry

    @cached_property
    def masses(self) -> M:
        """Masses of the machine."""
        scenario: Any = self.scenario
        masses: M = scenario.machine.masses
        return masses

    @classmethod
    def entries(cls) -> Mapping[str, Entry]:
        """Its entries by their names, in the order in which they are written."""
        kind: Any = cls
        return _entries_of(kind)

    def value(self, name: str) -> float:
        """An entry's value.

        Raises:
            ParapodError: there is no entry of this name; names those that there are.
        """
        entries = self.entries()
        if name not in entries:
            hint = did_you_mean(name, entries)
            raise ParapodError(
                f"the sheet has no entry '{name}'; there are: {', '.join(entries)}{hint}"
            )
        return float(getattr(self, name))

    def values(self, names: Iterable[str] | None = None) -> dict[str, float]:
        """Values of entries by their names; of all, if none are named."""
        return {name: self.value(name) for name in (self.entries() if names is None else names)}

    def by_group(self) -> dict[str, dict[str, Entry]]:
        """Its entries below their headings."""
        groups: dict[str, dict[str, Entry]] = {}
        for name, part in self.entries().items():
            groups.setdefault(part.group, {})[name] = part
        return groups

    def signals(self) -> Mapping[str, NDArray[np.float64]]:
        """Signals by which it is drawn; none: those at the beginning of its scenario."""
        return {}

    def demonstrations(self) -> Iterable[Demonstration]:
        """Runs of its machine's experiment that show entries."""
        return ()

    def dimensions(self) -> Iterable[Dimension]:
        """Dimension lines beside those of length, width and height."""
        return ()

    def tables(self) -> Iterable[Table]:
        """Tables, such as that of its drives."""
        return ()

    def figures(self) -> Iterable[Figure]:
        """Figures beside the dimensioned drawings."""
        return ()

    def as_json(self) -> dict[str, Any]:
        """Entries with their units, and tables; no number stands where there is none."""
        entries = self.entries()
        return {
            "entries": {
                name: {
                    "value": value if math.isfinite(value) else None,
                    "unit": entries[name].unit,
                    "group": entries[name].group,
                    "meaning": entries[name].meaning,
                }
                for name, value in self.values().items()
            },
            "tables": {
                table.title: [dict(zip(table.columns, row, strict=True)) for row in table.rows]
                for table in self.tables()
            },
            "wrench": dict(zip(WRENCH, self.wrench, strict=True)),
        }


type AnySheet = Sheet[Any, Any, Any]


@cache
def _entries_of(kind: Any) -> Mapping[str, Entry]:
    bases = reversed(kind.__mro__)
    parts = (item for base in bases for item in vars(base).items())
    return {name: part for name, part in parts if isinstance(part, Entry)}


@cache
def find_sheet(machine: str) -> type[Sheet[Any, Any, Any]]:
    """The kind of sheet of a machine, by the machine's name.

    Raises:
        ParapodError: there is none.
    """
    sheets = {point.name: point for point in installed(GROUP)}
    if machine not in sheets:
        names = ", ".join(sorted(sheets))
        raise ParapodError(f"the machine '{machine}' has no data sheet; there are: {names}")
    kind: type[Sheet[Any, Any, Any]] = sheets[machine].load()
    return kind


def conditioning(jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Local conditioning index (...) of Jacobians (..., n, m): 1 over the condition number.

    Gosselin and Angeles, J. Mech. Design 113 (1991), p. 220, whose global index is the mean of it
    over the workspace. Columns of angles must be divided by a characteristic length before.
    """
    singular = np.linalg.svd(jacobian, compute_uv=False)
    return singular[..., -1] / singular[..., 0]


def polar_axes(canvas: "Canvas") -> Any:
    """Axes of a quantity that begins at zero, by the direction from above."""
    axes: Any = canvas.add_subplot(projection="polar")
    axes.set_thetagrids(range(0, 360, 90), ("x", "y", "-x", "-y"))
    return axes
