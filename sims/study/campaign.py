"""Runs that a crew carries out, kept in a file as they come: those of a study, or of a search."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from parapod.sims.lab.work import Crew, WorkerDied, carry_out_parcels
from parapod.sims.output.progress import counted
from parapod.sims.study.file import open_file
from parapod.sims.study.records import Records
from parapod.sims.study.runs import Outcome, Piece


@contextmanager
def campaign(
    name: str,
    work: Callable[[Sequence[Piece]], Sequence[Outcome]],
    crew: Crew,
    records: Records,
    console: Console,
    file: tuple[Path, Mapping[str, Any], bool] | None = None,
    rows: int = 1,
    look: Callable[[], None] | None = None,
) -> Iterator[Callable[[Sequence[int]], None]]:
    """Context in which runs are carried out, by their numbers; what is done already is left out.

    Args:
        name: name beside the progress.
        work: function of runs' numbers and values, which can be pickled.
        crew: does the work.
        records: empty ones; they take what the file has, and what comes out.
        console: console for progress.
        file: the table that is written, what distinguishes its work from others, and true to go
            on with an existing one; None for no file.
        rows: runs in the largest parcel for a worker; 1: their duration decides.
        look: called whenever runs are done; None: nothing is.

    Raises:
        OutputError: the file cannot be written, or is not to be gone on with.
        NoWorkers: nothing carries out anything any more; what is done is in the file.
        AnotherVersion: a worker has other software.
    """
    with ExitStack() as stack:
        keep = None
        if file is not None:
            path, about, resume = file
            keep = stack.enter_context(open_file(path, about, records, resume))
        count = int(records.done.sum())
        report = stack.enter_context(counted(console, name, records.sampling.runs, count))
        report(count)

        def work_out(runs: Sequence[int]) -> None:
            nonlocal count
            missing = [run for run in runs if not records.done[run]]
            pieces = ((run, records.sampling.values(run)) for run in missing)
            size = _parcel(len(missing), crew.size, rows)
            for place, outcome in carry_out_parcels(crew, work, pieces, size):
                if isinstance(outcome, WorkerDied):
                    outcome = Outcome(missing[place], error=str(outcome))
                records.add(outcome)
                if keep is not None:
                    keep.add(outcome)
                count += 1
                # Those of a parcel come at once; shown singly they would look slow, and few.
                if size <= 1 or (place + 1) % size == 0 or place + 1 == len(missing):
                    report(count)
                    if look is not None:
                        look()

        yield work_out


def _parcel(runs: int, workers: int, rows: int) -> int:
    """Number of runs that a worker is sent at once; 0: as many as their duration asks for.

    Every worker has the same number of parcels, of which none is larger than `rows`.
    """
    if rows <= 1:
        return 0
    parcels = workers * math.ceil(runs / (workers * rows))
    return math.ceil(runs / max(parcels, 1))
