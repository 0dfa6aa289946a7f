"""A study: one experiment, its variables and its sampling; how it is carried out."""

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from parapod.sims.lab.discovery import Entry, find_entry
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.work import Crew
from parapod.sims.study.campaign import campaign
from parapod.sims.study.records import Records
from parapod.sims.study.runs import Order, Software, carry_out_runs
from parapod.sims.study.sampling import Sampling
from parapod.sims.study.variables import Variable, read_variables
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import inline, load_scenario
from parapod.systems.core.schema import checked, differing

# Runs simulated together of a study that is watched, so that it grows every few seconds.
_MOST_WATCHED = 200


@dataclass(frozen=True)
class Study:
    """An experiment over the values of some keys of its scenario.

    Attributes:
        entry: the experiment.
        tree: the scenario that the variables change, as plain data.
        sampling: the runs.
        software: versions of the software that carries it out.
    """

    entry: Entry
    tree: Mapping[str, Any]
    sampling: Sampling
    software: Software

    @classmethod
    def make(
        cls,
        experiment: str,
        scenario: Any,
        vary: Mapping[str, str | Sequence[Any]],
        sampling: str = "grid",
        runs: int | None = None,
        sampling_seed: int = 0,
    ) -> "Study":
        """A study, checked before anything is run.

        Args:
            experiment: name of the experiment.
            scenario: the scenario that the variables change.
            vary: values by dotted key, see `variables`.
            sampling: "grid", "latin" or "sobol".
            runs: number of runs; a grid has its own.
            sampling_seed: seed of the random samplings.

        Raises:
            UnknownExperiment: there is none of that name.
            ScenarioError: variables or a sampling that are not admissible.
        """
        entry = find_entry(experiment)
        tree = checked(scenario)
        if tree["backend"] == "hardware":
            raise ScenarioError("a study simulates; the backend is hardware", "backend")
        variables = read_variables(type(scenario), tree, vary)
        for variable in variables:
            if variable.key == "backend" and "hardware" in variable.values:
                raise ScenarioError(
                    "a study simulates; one of its backends is hardware", "backend"
                )
        chosen = Sampling.make(sampling, variables, runs, sampling_seed)
        return cls(entry, tree, chosen, Software.from_entry(entry))

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The variables."""
        return self.sampling.variables

    @property
    def schema(self) -> type:
        """Class of the scenarios."""
        schema: type = self.entry.load().schema
        return schema

    @property
    def order(self) -> Order:
        """The part of it that workers need."""
        keys = tuple(variable.key for variable in self.variables)
        return Order(self.entry.name, self.tree, keys, self.software)

    def as_json(self) -> dict[str, Any]:
        """Everything that distinguishes it from other studies, as JSON can say it."""
        return {
            "software": asdict(self.software),
            "experiment": self.entry.name,
            "variables": {variable.key: variable.text for variable in self.variables},
            "sampling": self.sampling.kind,
            "runs": self.sampling.runs,
            "sampling_seed": self.sampling.seed,
            "scenario": json.loads(json.dumps(self.tree)),
        }

    def command(self, run: int) -> str:
        """Shell command that repeats a run alone."""
        default = checked(load_scenario(self.schema, self.entry.default_scenario))
        changed = dict(differing(default, self.order.tree))
        values = self.sampling.values(run)
        values_by_key = dict(zip(self.order.keys, values, strict=True))
        # Of a part that differs whole, the variables' own keys come last and win.
        settings = [
            f"{key}={'' if value == '' else inline(value)}"
            for key, value in (changed | values_by_key).items()
        ]
        return shlex.join(["parapod", "run", self.entry.name, "--set", *settings])

    def carry_out(
        self,
        crew: Crew,
        records: Records,
        console: Console,
        path: Path | None = None,
        resume: bool = False,
        rows: int | None = None,
        look: Callable[[], None] | None = None,
    ) -> None:
        """Carries out what a file does not have yet.

        Args:
            crew: does the work.
            records: empty ones; they take what the file has, and what comes out.
            console: console for progress.
            path: the table that is written, *.parquet; None for none.
            resume: true to go on with an existing one.
            rows: largest number of runs that are simulated together, as rows; 0: each alone; None:
                as many as are fast, where there are laws over rows.
            look: called whenever runs are done, which then come in smaller parcels; None: nothing
                is.

        Raises:
            ParapodError: rows of what has no laws over rows.
            OutputError: the file cannot be written, or is not to be gone on with.
            NoWorkers: nothing carries out anything any more; what is done is in the file.
            AnotherVersion: a worker has other software.
        """
        most = self._most_rows() if rows != 0 else 0
        if rows and not most:
            raise ParapodError(
                f"runs of '{self.entry.name}' on {self.tree['backend']} have no laws over rows: "
                "those of a closed loop on kinematic or mujoco have; rows must be 0 or auto"
            )
        together = rows if most else 1
        if look is not None:
            most = min(most, _MOST_WATCHED)
        work = partial(carry_out_runs, self.order, together)
        file = None if path is None else (path, self.as_json(), resume)
        name, runs = self.entry.name, (crew, records, console, file, together or most, look)
        with campaign(name, work, *runs) as work_out:
            work_out(self._in_order(np.flatnonzero(~records.done)))

    def _in_order(self, runs: NDArray[np.int_]) -> list[int]:
        """Runs of the same structure after each other, for workers build each structure once."""
        codes = []
        for i, variable in enumerate(self.variables):
            if variable.quantile is None and self._is_built_in(variable):
                column = [repr(self.sampling.values(run)[i]) for run in runs.tolist()]
                codes.append(np.unique(column, return_inverse=True)[1])
        ordered: list[int] = (runs[np.lexsort(codes)] if codes else runs).tolist()
        return ordered

    def _most_rows(self) -> int:
        """Number of runs to be simulated together; 0: none are."""
        experiment = self.entry.load()
        if not isinstance(experiment, LoopExperiment):
            return 0
        scenario = self.order.scenario(experiment.schema, self.sampling.values(0))
        return experiment.most_rows(scenario)

    def _is_built_in(self, variable: Variable) -> bool:
        """Whether loops of its values are of different structures."""
        experiment = self.entry.load()
        if not isinstance(experiment, LoopExperiment):
            return False
        structures = set()
        for value in (variable.values[0], variable.values[-1]):
            order = replace(self.order, keys=(variable.key,))
            scenario = order.scenario(experiment.schema, (value,))
            structures.add(experiment.structure(scenario))
        return len(structures) > 1
