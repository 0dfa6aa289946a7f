"""Result of a study: its table for pandas and polars, its summary, its figures."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.figures import Figure
from parapod.sims.study.figures import draw_study
from parapod.sims.study.file import from_table, load_table, to_table
from parapod.sims.study.page import make_page
from parapod.sims.study.records import Records
from parapod.sims.study.runs import Software
from parapod.sims.study.study import Study
from parapod.sims.study.summary import Summary
from parapod.systems.core.schema import build

if TYPE_CHECKING:
    import pyarrow  # type: ignore[import-untyped]


@dataclass(frozen=True, repr=False)
class StudyResult:
    """Result of a study; pandas and polars read it as a table.

        polars.DataFrame(result)
        result.table.to_pandas()
        result["height_error_mm"]  # values of a column

    Attributes:
        study: the study.
        records: outcomes, column by column.
    """

    study: Study
    records: Records

    @cached_property
    def table(self) -> "pyarrow.Table":
        """One row a run; see `docs/studies.md`.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        return to_table(self.study.as_json(), self.records)

    @cached_property
    def summary(self) -> Summary:
        """Quantiles, bounds, worst runs."""
        return Summary.from_records(self.study, self.records)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """Distributions, contributions of the variables, borders of feasibility."""
        return tuple(draw_study(self.study, self.records))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The table for any library that reads Arrow's."""
        return self.table.__arrow_c_stream__(requested_schema)

    def __getitem__(self, name: str) -> Any:
        """Column (runs) of the table as a numpy array.

        Raises:
            KeyError: there is none of that name; names those that there are.
        """
        if name not in self.table.column_names:
            names = ", ".join(self.table.column_names)
            raise KeyError(f"no column '{name}'; there are: {names}")
        return self.table[name].to_numpy()

    def __len__(self) -> int:
        """Number of runs that have been carried out."""
        return self.summary.done

    def __repr__(self) -> str:
        return (
            f"<study of {self.study.entry.name}, {self.summary.done} of "
            f"{self.study.sampling.runs} runs: all bounds held in {self.summary.passed}>"
        )

    def _repr_html_(self) -> str:
        """Summary and figures, for notebooks."""
        return make_page(self.study, self.summary, self.figures, "part.html.jinja")


def read_study(path: Path | str) -> StudyResult:
    """The result of a study from its table, as far as it has been carried out.

    Args:
        path: the table, *.parquet.

    Raises:
        OutputError: it cannot be read, or is not the table of a study.
        MissingExtra: pyarrow is not installed.
    """
    table, metadata = load_table(Path(path))
    entry = metadata["study"]
    schema = find_entry(entry["experiment"]).load().schema
    study = Study.make(
        entry["experiment"],
        build(schema, entry["scenario"]),
        entry["variables"],
        entry["sampling"],
        entry["runs"],
        entry["sampling_seed"],
    )
    study = replace(study, software=Software(**entry["software"]))
    records = Records(study.sampling)
    from_table(table, metadata["metrics"], records)
    return StudyResult(study, records)
