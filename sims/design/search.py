"""A search for designs: variables, goals and an algorithm, carried out like a study.

Designs are numbered in the order in which they are asked for. The algorithm is deterministic, so
that a search that goes on with its file asks for the same designs again and takes what the file
has of them.
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from parapod.diagrams.designs import check_design
from parapod.sims.design.goals import Goal, Hold, check_names
from parapod.sims.design.optimisers import minimise
from parapod.sims.lab.discovery import Entry, find_entry
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.work import Crew
from parapod.sims.output.results import Metric
from parapod.sims.output.together import Together
from parapod.sims.sheet.sheet import AnySheet, find_sheet
from parapod.sims.study.campaign import campaign
from parapod.sims.study.records import Records
from parapod.sims.study.runs import (
    Order,
    Outcome,
    Piece,
    Shop,
    Software,
    open_shop,
    outcome_of,
)
from parapod.sims.study.sampling import Sampling
from parapod.sims.study.variables import Variable, read_variables
from parapod.systems.core.errors import OutputError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import build, checked

type Array = NDArray[np.float64]

_DESIGNS = 2000  # usual number
_POPULATION = 10  # designs of a generation, by the number of variables
_FEWEST, _MOST = 20, 200  # designs of a generation
_DIGITS = 6  # digits of a variable's value
_GRID = np.linspace(0.0, 1.0, 1001)  # shares of a distribution
_ALIKE = 1e-9  # share by which numbers that depend on nothing differ
# Places in a variable's range at which something has to depend on it.
_TRIED = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class Plan(Sampling):
    """Designs that a search has asked for so far.

    Attributes:
        points: values of the variables, by number of the design.
    """

    is_searched: ClassVar[bool] = True
    points: dict[int, tuple[Any, ...]] = field(default_factory=dict)

    def values(self, run: int) -> tuple[Any, ...]:
        """Values of the variables in a design that has been asked for."""
        return self.points[run]

    def take(self, run: int, values: Sequence[Any]) -> None:
        """Notes the values of a design.

        Raises:
            OutputError: the file has another design of that number.
        """
        before = self.points.setdefault(run, tuple(values))
        for one, other in zip(before, values, strict=True):
            is_number = isinstance(one, float) and isinstance(other, float)
            if one != other and not (is_number and abs(one - other) <= 1e-9 * abs(one)):
                raise OutputError(
                    f"design {run} of the file is another one: its search was of another computer "
                    "or version, so it cannot go on here"
                )


@dataclass(frozen=True)
class Search:
    """A search for designs.

    Attributes:
        entry: the experiment whose machine is designed.
        tree: the scenario that the variables change, as plain data.
        sampling: variables, largest number of designs, seed, and designs so far.
        goals: objectives, one or several.
        holds: constraints.
        population: number of designs in a generation.
        software: versions of the software that carries it out.
    """

    entry: Entry
    tree: Mapping[str, Any]
    sampling: Plan
    goals: tuple[Goal, ...]
    holds: tuple[Hold, ...]
    population: int
    software: Software

    @classmethod
    def make(
        cls,
        experiment: str,
        scenario: Any,
        vary: Mapping[str, str | Sequence[Any]],
        goals: Sequence[Goal],
        holds: Sequence[Hold] = (),
        designs: int = _DESIGNS,
        population: int | None = None,
        seed: int = 0,
    ) -> "Search":
        """A search, checked before anything is worked out.

        Args:
            experiment: name of an experiment of the machine.
            scenario: its scenario, which the variables change.
            vary: values by dotted key, see `sims.study.variables`.
            goals: objectives.
            holds: constraints.
            designs: largest number of designs.
            population: number of designs in a generation; None: ten for each variable.
            seed: seed of the algorithm.

        Raises:
            UnknownExperiment: there is none of that name.
            ScenarioError: variables, goals or constraints that are not admissible.
            ParapodError: the machine has no data sheet.
        """
        if not goals:
            raise ScenarioError("a search needs an objective, as in --minimise mass_kg")
        names = [goal.name for goal in goals]
        if len(set(names)) < len(names):
            raise ScenarioError("an objective is given twice")
        entry = find_entry(experiment)
        tree = checked(scenario)
        variables = read_variables(type(scenario), tree, vary)
        for variable in variables:
            if not variable.key.startswith("machine."):
                raise ScenarioError(
                    f"{variable.key} is not below machine: a search varies the machine",
                    variable.key,
                )
        count = population or min(max(_POPULATION * len(variables), _FEWEST), _MOST)
        if count > designs:
            raise ScenarioError(f"{designs} designs are fewer than one generation of {count}")
        search = cls(
            entry,
            tree,
            Plan("search", variables, designs // count * count, seed),
            tuple(goals),
            tuple(holds),
            count,
            Software.from_entry(entry),
        )
        check_names(search.names, search.sheet)
        search.check_variables()
        return search

    @property
    def sheet(self) -> type[AnySheet]:
        """The kind of data sheet of the machine."""
        experiment = self.entry.load()
        if not isinstance(experiment, LoopExperiment):
            raise ScenarioError(f"'{self.entry.name}' runs no machine that can be designed")
        return find_sheet(experiment.machine.name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers that are worked out, objectives first, each once."""
        parts: tuple[Goal | Hold, ...] = (*self.goals, *self.holds)
        return tuple(dict.fromkeys(part.name for part in parts))

    @property
    def order(self) -> "DesignOrder":
        """The part of it that workers need."""
        keys = tuple(variable.key for variable in self.sampling.variables)
        return DesignOrder(self.entry.name, self.tree, keys, self.software, self.names)

    def as_json(self) -> dict[str, Any]:
        """Everything that distinguishes it from other searches, as JSON can say it."""
        return {
            "software": asdict(self.software),
            "experiment": self.entry.name,
            "variables": {variable.key: variable.text for variable in self.sampling.variables},
            "goals": list(map(str, self.goals)),
            "holds": list(map(str, self.holds)),
            "designs": self.sampling.runs,
            "population": self.population,
            "seed": self.sampling.seed,
            "scenario": json.loads(json.dumps(self.tree)),
        }

    def evaluate(self, values: Sequence[Any]) -> Outcome:
        """Works out one design here."""
        (outcome,) = carry_out_designs(self.order, 1, [(-1, tuple(values))])
        return outcome

    def check_variables(self) -> None:
        """Refuses a variable on which nothing depends that is asked for.

        Raises:
            ScenarioError: names it.
        """
        middle = [_value(variable, 0.5) for variable in self.sampling.variables]
        for place, variable in enumerate(self.sampling.variables):
            rows = []
            for share in _TRIED:
                values = [*middle]
                values[place] = _value(variable, share)
                rows.append([metric.value for metric in self.evaluate(values).metrics])
            if all(rows) and np.allclose(rows, rows[0], rtol=_ALIKE, atol=0.0):
                raise ScenarioError(
                    f"{variable.key}: nothing of {', '.join(self.names)} depends on it",
                    variable.key,
                )

    def carry_out(
        self,
        crew: Crew,
        records: Records,
        console: Console,
        path: Path | None = None,
        resume: bool = False,
    ) -> None:
        """Carries out what a file does not have yet.

        Args:
            crew: does the work.
            records: empty ones of `sampling`; they take what the file has, and what comes out.
            console: console for progress.
            path: the table that is written, *.parquet; None for none.
            resume: true to go on with an existing one.

        Raises:
            OutputError: the file cannot be written, or is not to be gone on with.
            NoWorkers: nothing carries out anything any more; what is done is in the file.
            AnotherVersion: a worker has other software.
            MissingExtra: several objectives need pymoo, which is not installed.
        """
        most = self._most_rows()
        work = partial(carry_out_designs, self.order, None if most else 1)
        file = None if path is None else (path, self.as_json(), resume)
        with campaign("designs", work, crew, records, console, file, most or 1) as work_out:
            numbers = itertools.count()

            def score(shares: Array) -> tuple[Array, Array]:
                """Objectives (n, m) to be small, and violations (n), of designs by shares."""
                runs = list(itertools.islice(numbers, len(shares)))
                for run, row in zip(runs, shares.tolist(), strict=True):
                    self.sampling.take(run, _point(self.sampling.variables, row))
                work_out(runs)
                return self.scores(records, runs)

            minimise(score, self._start(), len(self.goals), self.sampling.runs, self.sampling.seed)

    def _most_rows(self) -> int:
        """Number of designs whose loops are simulated together; 0: none are."""
        most = 0
        for name in self.order.experiments:
            experiment = find_entry(name).load()
            if isinstance(experiment, LoopExperiment):
                is_own = name == self.entry.name
                scenario = build(experiment.schema, self.tree) if is_own else experiment.schema()
                most = max(most, experiment.most_rows(scenario))
        return most

    def _start(self) -> Array:
        """Shares (population, variables) of the first designs; the first one is as it is set."""
        from scipy.stats import qmc  # type: ignore[import-untyped]

        count = len(self.sampling.variables)
        shares: Array = qmc.LatinHypercube(count, rng=self.sampling.seed).random(self.population)
        for place, variable in enumerate(self.sampling.variables):
            node: Any = self.tree
            for key in variable.key.split("."):
                node = node[int(key)] if isinstance(node, list) else node[key]
            share = _share(variable, node)
            if share is not None:
                shares[0, place] = share
        return shares

    def scores(self, records: Records, runs: Sequence[int]) -> tuple[Array, Array]:
        """Objectives (n, m) to be small, and violations (n); both infinite where it is refused."""
        columns = {column.key: column for column in records.columns}
        values = {
            name: columns[name].values[list(runs)]
            if name in columns
            else np.full(len(runs), np.nan)
            for name in self.names
        }
        objectives = np.column_stack([goal.sign * values[goal.name] for goal in self.goals])
        violations = np.sum(
            [np.zeros(len(runs)), *(hold.violation(values[hold.name]) for hold in self.holds)],
            axis=0,
        )
        is_refused = ~np.isfinite(np.column_stack([*values.values()])).all(axis=1)
        objectives[is_refused], violations[is_refused] = np.inf, np.inf
        return objectives, violations


@dataclass(frozen=True)
class DesignOrder(Order):
    """Common part of all designs of a search; it can be pickled.

    Attributes:
        names: numbers that are worked out.
    """

    names: tuple[str, ...] = ()

    @property
    def experiments(self) -> tuple[str, ...]:
        """Experiments of which results are asked for."""
        return tuple(dict.fromkeys(name.partition(":")[0] for name in self.names if ":" in name))


def carry_out_designs(
    order: DesignOrder, rows: int | None, pieces: Sequence[Piece]
) -> list[Outcome]:
    """Works out designs; what one refuses and where it fails is its outcome too.

    Args:
        order: facts that all designs share.
        rows: largest number of designs whose loops are simulated together; None: as many as are
            fast.
        pieces: number of each design, and the values of its variables.

    Raises:
        AnotherVersion: the software here is not that of the order.
    """
    names = {order.experiment, *order.experiments}
    shops = {name: open_shop(replace(order, experiment=name)) for name in names}
    together = Together(rows)
    works = [partial(_worked_out, order, shops, together, piece) for piece in pieces]
    return list(together.carry_out(works))


def _worked_out(
    order: DesignOrder, shops: Mapping[str, Shop], together: Together, piece: Piece
) -> Outcome:
    run, values = piece

    def work() -> tuple[Metric, ...]:
        experiment: Any = shops[order.experiment].experiment
        scenario = order.scenario(experiment.schema, values)
        settings = experiment.machine_scenario(scenario)
        check_design(settings.machine)
        sheet = find_sheet(experiment.machine.name)(settings)
        entries, results = sheet.entries(), _Results(order, shops, together, scenario)
        metrics = []
        for name in order.names:
            if name in entries:
                part = entries[name]
                metrics.append(Metric(name, sheet.value(name), part.unit, meaning=part.meaning))
            else:
                metrics.append(results.metric(name))
        return tuple(metrics)

    return outcome_of(run, work)


class _Results:
    """Results of experiments with a machine, each run once."""

    def __init__(
        self,
        order: DesignOrder,
        shops: Mapping[str, Shop],
        together: Together,
        scenario: Any,
    ):
        self._order, self._shops, self._together = order, shops, together
        self._scenario = scenario
        self._metrics: dict[str, dict[str, Metric]] = {}

    def metric(self, name: str) -> Metric:
        """A metric by the names of its experiment and of itself.

        Raises:
            ScenarioError: the experiment has no such metric, or is of another machine.
        """
        experiment, _, key = name.partition(":")
        if experiment not in self._metrics:
            self._metrics[experiment] = self._run(experiment)
        metrics = self._metrics[experiment]
        if key not in metrics:
            raise ScenarioError(
                f"'{experiment}' has no metric '{key}'; there are: {', '.join(metrics)}"
            )
        return replace(metrics[key], key=name, bound=None, at_least=None)

    def _run(self, name: str) -> dict[str, Metric]:
        shop = self._shops[name]
        scenario: Any = self._scenario
        if name != self._order.experiment:
            scenario = load_scenario(shop.experiment.schema, find_entry(name).default_scenario)
            machine = self._scenario.machine
            if type(getattr(scenario, "machine", None)) is not type(machine):
                raise ScenarioError(f"'{name}' is not an experiment of this machine")
            scenario.machine = machine
        options = replace(shop.options, together=self._together)
        result = shop.experiment.execute(scenario, options)
        return {metric.key: metric for metric in result.metrics if not metric.is_timing}


def _point(variables: Sequence[Variable], shares: Sequence[float]) -> tuple[Any, ...]:
    pairs = zip(variables, shares, strict=True)
    return tuple(_value(variable, share) for variable, share in pairs)


def _value(variable: Variable, share: float) -> Any:
    """Value of a variable at a share (0..1) of its range; numbers to six digits."""
    value: Any = variable.at(np.array([share]))[0]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _share(variable: Variable, value: Any) -> float | None:
    """Share of a variable's range at which it has a value; None: it never has."""
    if variable.quantile is None:
        values = list(variable.values)
        return (values.index(value) + 0.5) / len(values) if value in values else None
    if not isinstance(value, int | float):
        return None
    along = variable.quantile(_GRID)
    if not along[0] <= value <= along[-1]:
        return None
    return float(np.interp(value, along, _GRID))
