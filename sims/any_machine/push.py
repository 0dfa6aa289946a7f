"""Find how hard a machine can be pushed before a bound of an experiment breaks.

Any experiment is run again and again with a push in it, whatever its machine. In each direction
the push grows until a bound breaks, then the interval between the largest force that was held and
the least that was not is halved until it is small. All directions are looked at together, on all
cores.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.disturbances import Push
from parapod.sims.lab.discovery import Entry, find_entry
from parapod.sims.lab.experiment import Experiment, LoopExperiment
from parapod.sims.lab.runner import Runner
from parapod.sims.lab.work import LocalCrew, WorkerDied, carry_out
from parapod.sims.output.figures import Figure
from parapod.sims.output.progress import counted, waiting
from parapod.sims.output.results import Metric, amount
from parapod.sims.study.runs import Order, Outcome, Software, carry_out_runs
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.core.scenario_file import inline, load_scenario
from parapod.systems.core.schema import TAG, Schema, choice, fields_of, plain, quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_KEY = "disturbances"
_BACKENDS = ("multibody", "mujoco", "kinematic")


@dataclass
class PushScenario(Schema):
    """Pushes in all directions, in any experiment with `disturbances`.

    Attributes:
        backend: backend of the experiment.
        seed: its seed.
        experiment: name of the experiment that is run with pushes, such as `level`, `chair-walk`,
            `centre-machining` or `bench-walk`.
        settings: settings of its scenario, each as for `--set`.
        bounds: names of the metrics whose bounds count; empty: all.
        body: name of the body that is pushed; empty: the machine's platform or body.
        place_mm: place of the push, from the body's origin by the body's axes [mm].
        at: beginning of the push [s]; null: the middle of the run.
        duration: time that it takes to rise and fall [s].
        directions: number of horizontal directions, evenly spread from the world's x axis towards
            y; 0: along the world's z axis, upwards and downwards.
        first_N: force that is tried first [N].
        most_N: force above which none is tried [N].
        share: width of the interval at the end, by the force that was held [-].
        asked_N: force that has to be held in each direction [N].
    """

    backend: str = choice("multibody", _BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    experiment: str = "level"
    settings: list[str] = field(default_factory=list)
    bounds: list[str] = field(default_factory=list)
    body: str = ""
    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)
    at: float | None = quantity(None, 0.0, 1e6)
    duration: float = quantity(0.3, 1e-3, 1e4)
    directions: int = quantity(4, 0, 72)
    first_N: float = quantity(200.0, 1e-3, 1e6)  # noqa: N815
    most_N: float = quantity(50_000.0, 1e-3, 1e6)  # noqa: N815
    share: float = quantity(0.05, 1e-3, 1.0)
    asked_N: float = quantity(100.0, 0.0, 1e6)  # noqa: N815

    @property
    def ways(self) -> "tuple[Way, ...]":
        """The directions."""
        if not self.directions:
            return Way("up", (0.0, 0.0, 1.0)), Way("down", (0.0, 0.0, -1.0))
        degrees = [360.0 * i / self.directions for i in range(self.directions)]
        return tuple(
            Way(f"{angle:g} deg", (_cos(angle), _cos(angle - 90.0), 0.0)) for angle in degrees
        )


def _cos(degrees: float) -> float:
    """Cosine that is zero at right angles."""
    return round(math.cos(math.radians(degrees)), 15) + 0.0


@dataclass(frozen=True)
class Way:
    """A direction.

    Attributes:
        name: its name for people.
        along: unit vector, by the world's axes.
    """

    name: str
    along: tuple[float, float, float]

    @property
    def key(self) -> str:
        """Its part in the name of a metric."""
        return self.name.replace(" ", "_").replace(".", "_")


@dataclass(frozen=True)
class Border:
    """Forces between which a bound breaks, in one direction.

    Attributes:
        way: the direction.
        held: largest force with which all bounds held, of all that were tried below `broken` [N].
        broken: least force with which one broke [N]; infinite if none did.
        why: bounds that broke then, or the error.
    """

    way: Way
    held: float = 0.0
    broken: float = math.inf
    why: tuple[str, ...] = ()

    def next(self, scenario: PushScenario) -> float | None:
        """Force to be tried next [N]; None: the border is known."""
        if math.isinf(self.broken):
            if self.held >= scenario.most_N:
                return None
            return min(max(2.0 * self.held, scenario.first_N), scenario.most_N)
        if self.broken - self.held <= scenario.share * max(self.held, scenario.first_N):
            return None
        return 0.5 * (self.held + self.broken)

    def runs_left(self, scenario: PushScenario) -> int:
        """Largest number of runs until the border is known."""
        halvings = math.ceil(-math.log2(scenario.share))
        if self.next(scenario) is None:
            return 0
        if math.isinf(self.broken):
            begin = max(self.held, 0.5 * scenario.first_N)
            return halvings + math.ceil(math.log2(scenario.most_N / begin))
        width = (self.broken - self.held) / max(self.held, scenario.first_N)
        return math.ceil(math.log2(width / scenario.share))

    def learn(self, force: float, why: tuple[str, ...]) -> "Border":
        """The border, after a force has been tried that broke what `why` names."""
        if why:
            return replace(self, broken=force, why=why)
        return replace(self, held=force)


@dataclass(frozen=True)
class _Pushed:
    """The experiment that is run, with a push."""

    entry: Entry
    experiment: LoopExperiment[Any, Any]
    scenario: Any
    push: Push

    @classmethod
    def of(cls, scenario: PushScenario) -> "_Pushed":
        """Finds experiment and scenario.

        Raises:
            ScenarioError: an experiment that has no disturbances, or settings that it refuses.
        """
        entry = find_entry(scenario.experiment)
        experiment = entry.load()
        if not isinstance(experiment, LoopExperiment) or _KEY not in fields_of(experiment.schema):
            raise ScenarioError(
                f"experiment = {quoted(entry.name)} cannot be pushed: its scenario has no "
                f"'{_KEY}'",
                "experiment",
            )
        settings = [*scenario.settings, f"backend={scenario.backend}", f"seed={scenario.seed}"]
        inner: Any = load_scenario(experiment.schema, entry.default_scenario, None, settings)
        experiment.check_backend(inner.backend)
        middle = round(0.5 * experiment.duration(inner), 2)
        push = Push(
            at=middle if scenario.at is None else scenario.at,
            duration=scenario.duration,
            body=scenario.body,
            place_mm=list(scenario.place_mm),
        )
        return cls(entry, experiment, inner, push)

    def with_push(self, way: Way, force: float) -> list[Any]:
        """Disturbances of the scenario with a push, as plain data."""
        pushed = replace(self.push, force_N=[force * part for part in way.along])
        usual, tree = plain(Push()), plain(pushed)
        needed = {key: tree[key] for key in tree if key == TAG or tree[key] != usual[key]}
        return [*plain(self.scenario.disturbances), needed]

    @property
    def order(self) -> Order:
        """Facts that all runs share."""
        return Order(
            self.entry.name, plain(self.scenario), (_KEY,), Software.from_entry(self.entry)
        )


class FindPush(Experiment[PushScenario, list[Border]]):
    """Halves intervals of forces."""

    schema = PushScenario
    backends = _BACKENDS
    takes = "4 min"

    def check(self, scenario: PushScenario) -> None:
        """Refuses an experiment or a body that cannot be pushed, and bounds that it has not."""
        pushed = _Pushed.of(scenario)
        _check(pushed, pushed.with_push(scenario.ways[0], 0.0))

    def run(self, scenario: PushScenario, runner: Runner) -> list[Border]:
        """Runs the experiment without a push, then tries forces in all directions at once."""
        pushed = _Pushed.of(scenario)
        borders = [Border(way) for way in scenario.ways]
        work = partial(_outcome, pushed.order, tuple(scenario.bounds))
        with LocalCrew() as crew:
            with waiting(runner.console, f"{self.name}: {pushed.entry.name} without a push"):
                ((_, why),) = carry_out(crew, work, [pushed.with_push(borders[0].way, 0.0)])
            if why := _unless_given_up(why):
                raise ScenarioError(
                    f"{pushed.entry.name} does not hold its bounds without a push: "
                    f"{', '.join(why)}"
                )
            total = sum(border.runs_left(scenario) for border in borders)
            with counted(runner.console, "pushes at most", total) as report:
                while tries := _tries(borders, scenario):
                    pieces = [pushed.with_push(borders[i].way, force) for i, force in tries]
                    for number, broken in carry_out(crew, work, pieces):
                        i, force = tries[number]
                        borders[i] = borders[i].learn(force, _unless_given_up(broken))
                        report(total - sum(border.runs_left(scenario) for border in borders))
        return borders

    def measure(self, scenario: PushScenario, data: list[Border]) -> Iterator[Metric]:
        """Forces that are held."""
        least = min(data, key=lambda border: border.held)
        yield Metric(
            "least_held_N",
            least.held,
            "N",
            at_least=scenario.asked_N,
            meaning=f"largest push that is held in the weakest direction, {least.way.name}",
        )
        for border in data:
            yield Metric(
                f"held_{border.way.key}_N",
                border.held,
                "N",
                meaning=f"largest push that is held, {border.way.name}",
            )

    def note(self, scenario: PushScenario, data: list[Border]) -> Iterable[str]:
        """Bounds that break first, and the command that shows it."""
        yield from map(_line, data)
        broken = [border for border in data if border.why]
        if not broken:
            return
        least, pushed = min(broken, key=lambda border: border.broken), _Pushed.of(scenario)
        disturbances = inline(pushed.with_push(least.way, round(least.broken, 1)))
        settings = [*scenario.settings, f"backend={scenario.backend}", f"{_KEY}={disturbances}"]
        words = " ".join(f'--set "{text}"' for text in settings)
        yield f"to see it: parapod run {scenario.experiment} {words} --meshcat"

    def draw(self, scenario: PushScenario, data: list[Border]) -> Iterable[Figure]:
        """Forces by their direction."""
        if scenario.directions < 2:
            return
        yield Figure(
            "push",
            f"Pushes that '{scenario.experiment}' bears",
            f"Largest push of {scenario.duration:g} s with which all bounds hold, and the least "
            "with which one breaks, by the direction into which it pushes, from above.",
            partial(_draw, data),
            (4.8, 4.2),
        )


def _check(pushed: _Pushed, disturbances: Sequence[Any]) -> None:
    """Refuses what the experiment refuses: a body that is not there, a backend of no bodies."""
    tree = plain(pushed.scenario) | {_KEY: list(disturbances)}
    order = replace(pushed.order, tree=tree)
    scenario = order.scenario(pushed.experiment.schema, (tree[_KEY],))
    pushed.experiment.check(scenario)
    pushed.experiment.loop(scenario)


def _outcome(order: Order, bounds: tuple[str, ...], disturbances: Sequence[Any]) -> Any:
    """In a worker: bounds that a run breaks, or the error with which it ends.

    Raises:
        ScenarioError: bounds that the experiment does not have.
    """
    (outcome,) = carry_out_runs(order, None, [(0, (list(disturbances),))])
    return broken_by(outcome, bounds)


def broken_by(outcome: Outcome, bounds: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the bounds that a run broke, or the error with which it ended.

    Args:
        outcome: outcome of the run.
        bounds: metrics whose bounds count; empty: all.

    Raises:
        ScenarioError: a metric without a bound, or one that the run does not have.
    """
    if outcome.error:
        return (outcome.error,)
    bounded = {metric.key: metric for metric in outcome.metrics if metric.is_bounded}
    for key in bounds:
        if key not in bounded:
            raise ScenarioError(
                f"bounds: {quoted(key)} has no bound; those that have one: {', '.join(bounded)}",
                "bounds",
            )
    return tuple(
        f"{key} = {amount(metric.value, metric.unit)} for {metric.limits}"
        for key, metric in bounded.items()
        if key in (bounds or bounded) and not metric.passed
    )


def _unless_given_up(why: tuple[str, ...] | WorkerDied) -> tuple[str, ...]:
    if isinstance(why, WorkerDied):
        raise ParapodError(f"a run was given up: {why}")
    return why


def _tries(borders: Sequence[Border], scenario: PushScenario) -> list[tuple[int, float]]:
    """Directions whose border is not known yet, and the force to be tried there."""
    forces = ((i, border.next(scenario)) for i, border in enumerate(borders))
    return [(i, force) for i, force in forces if force is not None]


def _line(border: Border) -> str:
    """Force that a direction bears, and what breaks first."""
    held = f"{border.way.name}: {amount(border.held, 'N')} held"
    if not border.why:
        return held
    return f"{held}, {amount(border.broken, 'N')} not: {', '.join(border.why)}"


def _draw(data: Sequence[Border], canvas: "Canvas") -> None:
    from parapod.sims.sheet.sheet import polar_axes

    axes = polar_axes(canvas)
    angles = [math.atan2(border.way.along[1], border.way.along[0]) for border in data]
    around = np.array([*angles, angles[0] + 2.0 * math.pi])
    for name, style in (("held", "-"), ("broken", "--")):
        forces = [getattr(border, name) for border in data]
        if np.isfinite(forces).all():
            axes.plot(around, [*forces, forces[0]], style, marker="o", markersize=3, label=name)
    axes.set_rmin(0.0)
    axes.set_rlabel_position(45.0)
    axes.set_xlabel("push [N]")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.15, -0.1))
