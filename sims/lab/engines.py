"""Two physics engines on one job: differences of their signals, and convergence of their steps.

Both simulate the same bodies behind the same ports, from the same scenario and seed. Results on
which they agree are not peculiar to a solver; what they do not is explained, or is a fault of one.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Backends of rigid bodies, and how figures call them.
ENGINES = {"multibody": "Drake", "mujoco": "MuJoCo"}

# Up to this step of the plants their loops are closed to micrometres [s].
FINE_STEP = 1e-3

_COLUMNS = 4  # largest number of columns of a figure

type Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """A signal by which engines are compared.

    Attributes:
        key: stem of its metrics.
        signal: name of its port, or of a derived signal.
        unit: unit in which it is shown.
        scale: the shown number by the signal's.
        meaning: meaning, for people.
        elements: elements of the signal that are compared.
        bound: largest admissible difference [unit]; None for none.
        counts: true if its convergence is shown.
        is_rough: true if single samples say little, as those of forces at a touchdown do: the root
            mean square is measured instead of the largest.
    """

    key: str
    signal: str
    unit: str
    scale: float
    meaning: str
    elements: tuple[int, ...]
    bound: float | None = None
    counts: bool = False
    is_rough: bool = False

    def values(self, signals: Mapping[str, Floats]) -> Floats:
        """(n, k) values of a run, as they are shown."""
        values: Floats = self.scale * signals[self.signal][:, list(self.elements)]
        return values

    def difference(
        self, pair: Mapping[Any, Mapping[str, Floats]], when: NDArray[np.bool_]
    ) -> float:
        """Difference between two runs over the times that count [unit]."""
        one, other = (self.values(signals)[when] for signals in pair.values())
        if self.is_rough:
            return float(np.sqrt(np.mean((other - one) ** 2)))
        return float(np.abs(other - one).max())


@dataclass(frozen=True)
class Engines:
    """Runs of both engines.

    Attributes:
        run: run that was watched.
        signals: signals with the scenario's step, by backend.
        steps: steps of the repetitions, the longest first [s].
        repeated: signals of the repetitions, by backend, in the order of the steps.
    """

    run: Run
    signals: Mapping[str, Mapping[str, Floats]]
    steps: Floats
    repeated: Mapping[str, Sequence[Mapping[str, Floats]]]


class EngineComparison[S](LoopExperiment[S, Engines]):
    """An experiment that runs both engines on the same job.

    Its scenario has `plant.time_step`, and `steps_ms` of the repetitions.

    Attributes:
        quantities: signals that are compared.
        gap: name of the signal that tells how far loops are open [m].
        most_open: largest admissible gap with steps up to `FINE_STEP` [um].
    """

    backends = tuple(ENGINES)
    quantities: ClassVar[Sequence[Quantity]] = ()
    gap: ClassVar[str] = "truth.loop_error"
    most_open: ClassVar[float] = 2.0

    def check(self, scenario: S) -> None:
        """Refuses steps that make no comparison.

        Raises:
            ScenarioError: steps that are not different, or longer than the controller's period.
        """
        super().check(scenario)
        settings: Any = scenario
        steps, key = settings.steps_ms, "steps_ms"
        if len(set(steps)) < len(steps):
            raise ScenarioError(f"{key} has a step twice: {steps}", key)
        longest = 1e3 * settings.control.period
        if steps and max(steps) > longest:
            raise ScenarioError(
                f"{key} = {max(steps):g} ms is above control.period = {longest:g} ms", key
            )

    def scales(self, scenario: S) -> Mapping[str, float]:
        """Factors of the bounds by their units: of a machine of another size or weight [-]."""
        raise NotImplementedError(f"{type(self).__name__} does not define scales")

    def counts_from(self, scenario: S) -> float:
        """Time from which on differences count: the machine has settled [s]."""
        raise NotImplementedError(f"{type(self).__name__} does not define counts_from")

    def derived(self, scenario: S, signals: Mapping[str, Floats]) -> Mapping[str, Floats]:
        """Further signals (n, k), by names that no port has."""
        return {}

    def run(self, scenario: S, runner: Runner) -> Engines:
        """Runs both with the scenario's step, and again with every other one."""
        settings: Any = scenario
        runs = {
            backend: self.run_loop(
                with_engine(scenario, backend), runner, watched=backend == settings.backend
            )
            for backend in ENGINES
        }
        own, steps = settings.plant.time_step, sorted(settings.steps_ms, reverse=True)
        repeated: dict[str, list[Mapping[str, Floats]]] = {backend: [] for backend in ENGINES}
        for step in steps:
            for backend in ENGINES:
                run = runs[backend]
                if not np.isclose(1e-3 * step, own):
                    again = with_engine(scenario, backend, 1e-3 * step)
                    run = self.run_loop(again, runner, watched=False)
                repeated[backend].append(self._all_signals(scenario, run))
        return Engines(
            runs[settings.backend],
            {backend: self._all_signals(scenario, run) for backend, run in runs.items()},
            1e-3 * np.array(steps),
            repeated,
        )

    def _all_signals(self, scenario: S, run: Run) -> dict[str, Floats]:
        signals: dict[str, Floats] = {name: run[name] for name in self.signals}
        return {**signals, **self.derived(scenario, signals)}

    def measure(self, scenario: S, data: Engines) -> Iterator[Metric]:
        """Largest differences, gaps, and how fast each was."""
        late = data.run.time >= self.counts_from(scenario)
        scales = self.scales(scenario)
        for quantity in self.quantities:
            kind = ("largest", "root mean square")[quantity.is_rough]
            yield Metric(
                f"{quantity.key}_difference_{quantity.unit}",
                quantity.difference(data.signals, late),
                quantity.unit,
                quantity.bound and quantity.bound * scales.get(quantity.unit, 1.0),
                meaning=f"difference of {quantity.meaning} between the engines, {kind}",
            )
        settings: Any = scenario
        is_fine = settings.plant.time_step <= FINE_STEP
        most = self.most_open * scales["mm"] if is_fine else None
        for backend, signals in data.signals.items():
            gap = 1e6 * float(signals[self.gap].max())
            meaning = f"largest gap in the loops, {ENGINES[backend]}"
            yield Metric(f"{backend}_loop_error_um", gap, "um", most, meaning=meaning)
        yield from self._convergence(data, late)
        yield realtime_metric(data.run)

    def _convergence(self, data: Engines, late: NDArray[np.bool_]) -> Iterator[Metric]:
        """Differences of the engines at each step."""
        for quantity in self.quantities:
            if not quantity.counts:
                continue
            for k, step in enumerate(data.steps):
                pair = {backend: runs[k] for backend, runs in data.repeated.items()}
                yield Metric(
                    f"{quantity.key}_difference_at_{1e6 * step:.0f}_us",
                    quantity.difference(pair, late),
                    quantity.unit,
                    meaning=f"difference of {quantity.meaning} between the engines, steps of "
                    f"{1e3 * step:g} ms",
                )

    def draw(self, scenario: S, data: Engines) -> Iterator[Figure]:
        """Signals of both engines beside each other, and what shorter steps change."""
        start = self.counts_from(scenario)
        yield self._signals(data, start)
        if len(data.steps) > 1:
            yield self._steps(data, start)

    def _signals(self, data: Engines, start: float) -> Figure:
        rows = math.ceil(len(self.quantities) / _COLUMNS)
        columns = math.ceil(len(self.quantities) / rows)

        def draw(canvas: "Canvas") -> None:
            ratios = (2, 1) * rows
            all_axes: Any = canvas.subplots(
                2 * rows, columns, sharex=True, squeeze=False, height_ratios=ratios
            )
            time = data.run.time
            late = time >= start
            for k, quantity in enumerate(self.quantities):
                row, i = divmod(k, columns)
                axes = all_axes[2 * row : 2 * row + 2]
                for (backend, signals), colour in zip(data.signals.items(), COLOURS, strict=False):
                    width = 2.2 if backend == next(iter(ENGINES)) else 1.0
                    lines = axes[0, i].plot(
                        time, quantity.values(signals), color=colour, linewidth=width
                    )
                    lines[0].set_label(ENGINES[backend])
                one, other = map(quantity.values, data.signals.values())
                axes[1, i].plot(time[late], (other - one)[late], color=COLOURS[2], linewidth=0.8)
                axes[0, i].set_ylabel(f"{quantity.meaning} [{quantity.unit}]")
                axes[1, i].set_ylabel(f"difference [{quantity.unit}]")
                axes[1, i].set_xlabel("time [s]")
            columns_used = len(self.quantities) - columns * (rows - 1)  # of the last row
            for unused in all_axes[-2:, columns_used:].flat:
                unused.remove()
            canvas.legend(
                *all_axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2
            )

        return Figure(
            f"{_stem(self.name)}_signals",
            "Two engines on one job",
            "The same bodies, drives and commands, simulated by Drake and by MuJoCo; below, "
            "MuJoCo's signals less Drake's.",
            draw,
            (3.2 * columns, 4.4 * rows),
        )

    def _steps(self, data: Engines, start: float) -> Figure:
        counted = [quantity for quantity in self.quantities if quantity.counts]
        late = data.run.time >= start

        def draw(canvas: "Canvas") -> None:
            axes: Any = canvas.subplots(1, len(counted), squeeze=False)
            steps = 1e3 * data.steps
            for axis, quantity in zip(axes[0], counted, strict=True):
                for (backend, runs), colour in zip(data.repeated.items(), COLOURS, strict=False):
                    own = [
                        quantity.difference({"": run, "finest": runs[-1]}, late)
                        for run in runs[:-1]
                    ]
                    axis.loglog(steps[:-1], own, "o-", color=colour, label=ENGINES[backend])
                between = [
                    quantity.difference(dict(enumerate(pair)), late)
                    for pair in zip(*data.repeated.values(), strict=True)
                ]
                axis.loglog(steps, between, "s--", color=COLOURS[2], label="between both")
                axis.set_xlabel("step [ms]")
                axis.set_ylabel(f"{quantity.meaning} [{quantity.unit}]")
            canvas.legend(
                *axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3
            )

        return Figure(
            f"{_stem(self.name)}_steps",
            "Convergence of both engines",
            "Largest difference of each engine from its own result with the finest step, and of "
            "the engines from each other at the same step.",
            draw,
            (3.4 * len(counted), 3.2),
        )


def with_engine[S](scenario: S, backend: str, step: float | None = None) -> S:
    """The scenario on a backend, with another step [s] if one is given."""
    settings: Any = scenario
    plant = settings.plant if step is None else replace(settings.plant, time_step=step)
    changed: S = replace(settings, backend=backend, plant=plant)
    return changed


def _stem(name: str) -> str:
    return name.replace("-", "_")
