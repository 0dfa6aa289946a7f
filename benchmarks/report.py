"""Report of a measurement."""

from dataclasses import dataclass

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Measurement:
    """One figure beside the floor that it must reach and the aim that it should.

    `at_most` turns the floor into a ceiling.
    """

    name: str
    value: float
    unit: str
    floor: float | None = None
    aim: float | None = None
    at_most: bool = False

    @property
    def passed(self) -> bool:
        if self.floor is None:
            return True
        return self.value <= self.floor if self.at_most else self.value >= self.floor


def print_measurements(title: str, measurements: list[Measurement], console: Console) -> None:
    table = Table(title=title, title_justify="left", title_style="bold")
    for heading in ("measured", "value", "bound", "aim", ""):
        table.add_column(heading, justify="left" if heading == "measured" else "right")
    for m in measurements:
        sign = "<=" if m.at_most else ">="
        table.add_row(
            m.name,
            f"{m.value:.3g} {m.unit}",
            "" if m.floor is None else f"{sign} {m.floor:g}",
            "" if m.aim is None else f"{sign} {m.aim:g}",
            "ok" if m.passed else "[bold red]missed[/]",
        )
    console.print(table)


def best_of(repeats: int, seconds: list[float]) -> float:
    """The shortest of the last `repeats` times: what the code costs without its neighbours."""
    return min(seconds[-repeats:])
