"""Experiments: hooks in the order of their story, run by a framework that owns the rest.

An experiment is a module whose docstring says what it is about, with a class of hooks:

    class Level(LoopExperiment[LevellingScenario]):
        machine = PLATFORM
        signals = ("truth.posture",)

        def check(self, scenario): ...       # refuse before anything moves
        def duration(self, scenario): ...    # end of the run [s]
        def measure(self, scenario, run): ...  # metrics with bounds
        def draw(self, scenario, run): ...   # figures

One with a diagram of its own overrides `loop`; one without a diagram is an `Experiment` with
`run`. Experiments are found by the entry points `parapod.experiments`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.block_diagram import BlockDiagram
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.designs import check_design, is_published
from parapod.diagrams.machine import Machine
from parapod.diagrams.own_controller import OWN, own_name
from parapod.diagrams.plots import Limits
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import Monitor, Run
from parapod.sims.lab.runner import Live, Runner, make_viewer, stay_live, write_graphviz
from parapod.sims.output.drawn import DrawnLog, LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.logs.files import check_log, write_experiment_log
from parapod.sims.output.logs.mcap import Message, Picture
from parapod.sims.output.logs.scene_messages import scene_messages
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import waiting
from parapod.sims.output.results import Metric, Result
from parapod.sims.output.scene_page import write_page
from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError, WiringError

# Options that show or write something, and the hook that each of them needs.
_HOOKS = {"meshcat": "scene", "html": "scene", "log": "logged", "graphviz": "loop"}

type Logged = tuple[ArrayLike, Mapping[str, tuple[ArrayLike, str]]]


class Experiment[S, D]:
    """A question put to a machine, answered with metrics and their bounds.

    Optional hooks beside those below: `scene(scenario)` makes a Meshcat scene (`--html`, and
    `--meshcat` with `afterwards`), `loop(scenario)` a diagram (`--graphviz`), `logged(scenario,
    data)` times and signals with their units (`--log`). An option without its hook is refused.

    Attributes:
        name: the name of its entry point.
        schema: class of its scenarios, with `backend` and `seed`; of a machine's experiment, by
            default, the machine's.
        backends: backends on which it runs; by default the machine's simulated ones.
        switches: options of its own without a value: name -> override that it is short for, and
            its help.
        takes: usual duration of a run, in words.
        takes_controller: true if it runs the controller that a scenario names.
        on_devices: settings, as for `--set`, with which devices keep up.
        drawing: drawing of a log in a replay; None: the machine's, where it has one.
    """

    schema: ClassVar[type]
    backends: ClassVar[tuple[str, ...]] = ()
    switches: ClassVar[Mapping[str, tuple[str, str]]] = {}
    takes: ClassVar[str] = "seconds"
    takes_controller: ClassVar[bool] = False
    on_devices: ClassVar[Sequence[str]] = ()
    drawing: ClassVar[LogDrawing | None] = None

    def __init__(self, name: str):
        """Names the experiment as its entry point does."""
        self.name = name

    def __repr__(self) -> str:
        return f"<experiment {self.name}>"

    # Hooks.

    def check(self, scenario: S) -> None:
        """Refuses a scenario before anything moves.

        Raises:
            ScenarioError: parts that do not fit together.
        """

    def run(self, scenario: S, runner: Runner) -> D:
        """Carries out the experiment; the same scenario gives the same data."""
        raise NotImplementedError(f"{type(self).__name__} does not define run")

    def measure(self, scenario: S, data: D) -> Iterable[Metric]:
        """Metrics, with their bounds."""
        return ()

    def note(self, scenario: S, data: D) -> Iterable[str]:
        """Sentences below the metrics."""
        return ()

    def details(self, scenario: S, data: D) -> Mapping[str, Any]:
        """Further content of `--json`."""
        return {}

    def identified(self, scenario: S, data: D) -> Mapping[str, Any]:
        """Properties of its machine that the run has found out.

        Values in YAML's types, by dotted keys of the machine's scenario; `parapod adopt` puts
        them into a scenario file.
        """
        return {}

    def draw(self, scenario: S, data: D) -> Iterable[Figure]:
        """Figures, drawn when they are wanted."""
        return ()

    def limits(self, scenario: S) -> Limits:
        """Smallest and largest admissible value of signals; drawn in plots.

        Those of the machine that draws its log, also of signals that take the place of others.
        """
        if self.drawing is None:
            return {}
        of_machine = self.machine_scenario(scenario)
        limits = self.drawing.machine.for_scenario(of_machine).all_limits(of_machine)
        pairs = self.drawing.stand_ins.items()
        return {**limits, **{other: limits[name] for name, other in pairs if name in limits}}

    def machine_scenario(self, scenario: S) -> Any:
        """The machine's scenario, where the experiment has one of its own."""
        return scenario

    def afterwards(self, scenario: S, data: D, options: RunOptions) -> Callable[[], None] | None:
        """Work that goes on once the result has been shown, or None."""
        return None

    # The framework.

    def execute(self, scenario: S, options: RunOptions) -> Result:
        """Runs a scenario.

        Args:
            scenario: values that its schema admits, as `schema.check` and the loaders see to.
            options: ways to watch and record.

        Raises:
            ScenarioError: values that do not fit together.
            OutputError: a file cannot be written, or an option has nothing to show.
            ParapodError: the experiment refuses.
        """
        settings: Any = scenario
        machine = getattr(settings, "machine", None)
        if machine is not None:
            check_design(machine)
        if own_name(scenario) and not self.takes_controller:
            raise ScenarioError(
                f"{OWN} must be empty: '{self.name}' leads its machine by itself",
                OWN,
            )
        self.check_backend(settings.backend)
        self._check_options(options)
        if options.log is not None and settings.backend != "hardware":
            check_log(options.log)
        with waiting(options.console, f"{self.name}: planning"):
            self.check(scenario)
        self._before(scenario, options)
        data = self.run(scenario, Runner(self.name, options))
        self._after(scenario, options)
        if options.log is not None and settings.backend != "hardware":
            self.write_log(options.log, scenario, *self.logged(scenario, data))  # type: ignore[attr-defined]
        metrics = tuple(self.measure(scenario, data))
        if machine is not None and not is_published(machine):
            metrics = tuple(replace(metric, paper=None) for metric in metrics)
        return Result(
            self.name,
            settings.backend,
            settings.seed,
            metrics,
            tuple(self.note(scenario, data)),
            tuple(self.draw(scenario, data)),
            self.afterwards(scenario, data, options),
            self.details(scenario, data),
            scenario,
            self.identified(scenario, data),
        )

    @property
    def _title(self) -> str:
        """Experiment and machine, where it has one."""
        try:
            return f"{self.name}: {self.drawn_machine().title}"
        except ParapodError:
            return self.name

    def drawn_machine(self) -> Machine[Any]:
        """The machine whose motion its log shows.

        Raises:
            ParapodError: its signals are not the motion of a machine.
        """
        machine: Machine[Any] | None = getattr(self, "machine", None)
        if self.drawing is not None:
            machine = self.drawing.machine
        if machine is None:
            raise ParapodError(f"the signals of '{self.name}' are not the motion of a machine")
        return machine

    def write_log(
        self,
        path: Path,
        scenario: S,
        time: ArrayLike,
        signals: Mapping[str, tuple[ArrayLike, str]],
    ) -> None:
        """Writes a log of the experiment; its machine is drawn in one for Foxglove.

        Args:
            path: the file; its suffix says the format.
            scenario: the scenario.
            time: (n) [s].
            signals: samples (n, ...) and their unit, by port.

        Raises:
            OutputError: the file cannot be written, or its suffix says no format.
            MissingExtra: for an MCAP log, mcap is not installed.
        """
        draw = partial(self._draw_log, scenario)
        write_experiment_log(path, self.name, scenario, time, signals, draw)

    def _draw_log(
        self, scenario: S, shapes: Mapping[str, tuple[int, ...]], pictures: Sequence[Picture]
    ) -> Iterator[Message]:
        """Draws the machine.

        Raises:
            ParapodError: why it is not drawn.
        """
        machine = self.drawn_machine()
        settings = self.machine_scenario(scenario)
        drawing = DrawnLog.from_shapes(
            machine.for_scenario(settings), settings, self.drawing, shapes
        )
        return scene_messages(drawing, pictures)

    def _before(self, scenario: S, options: RunOptions) -> None:
        """Writes the diagram, before a run is spent on a file that cannot be written."""
        if options.graphviz is not None:
            drawing = BlockDiagram(self.loop(scenario))  # type: ignore[attr-defined]
            write_graphviz(options.graphviz, drawing)

    def _after(self, scenario: S, options: RunOptions) -> None:
        """Writes the scene."""
        if options.html is not None:
            settings: Any = scenario
            scene = self.scene(scenario)  # type: ignore[attr-defined]
            facts = [f"backend {settings.backend}", f"seed {settings.seed}"]
            write_page(options.html, scene.StaticHtml(), self._title, facts)

    def check_backend(self, backend: str) -> None:
        """Refuses a backend on which the experiment does not run.

        Raises:
            ScenarioError: names those on which it does.
        """
        if backend not in self.backends:
            raise ScenarioError(
                f"backend = '{backend}' is not one on which '{self.name}' runs; "
                f"there are: {', '.join(self.backends)}",
                "backend",
            )

    def _check_options(self, options: RunOptions) -> None:
        """Refuses an option that the experiment has no hook for, before a run is spent on it."""
        answered = ["json", "figures", *(o for o, hook in _HOOKS.items() if hasattr(self, hook))]
        for option in _HOOKS:
            option_value = getattr(options, option)
            if option_value and option not in answered:
                option_names = ", ".join(f"--{name}" for name in answered)
                raise OutputError(
                    f"--{option} has nothing to show of '{self.name}'; there are: {option_names}",
                    None if option_value is True else option_value,
                )


class LoopExperiment[S, D](Experiment[S, D]):
    """An experiment that runs the closed loop of a machine.

    Its data are the `Run`; one that runs several loops overrides `run` and returns data with the
    watched one as their attribute `run`.

    Attributes:
        machine: the machine.
        signals: ports whose signals are measured and drawn; all are recorded for a log. Truth is
            left out where the machine is not simulated.
        advice: purpose of the controls after the run, a sentence or two.
    """

    takes_controller = True
    advice: ClassVar[str] = ""
    machine: ClassVar[Machine[Any]]
    signals: ClassVar[Sequence[str]] = ()

    def __init_subclass__(cls) -> None:
        """Takes schema and simulated backends of the machine where none are given."""
        super().__init_subclass__()
        machine = getattr(cls, "machine", None)
        if machine is not None:
            cls.schema = getattr(cls, "schema", machine.scenario)
            cls.backends = cls.backends or tuple(machine.plants)

    def check(self, scenario: S) -> None:
        """Refuses a controller that is faster than the plant; one that refuses more calls this.

        Raises:
            ScenarioError: parts that do not fit together.
        """
        settings = self.machine_scenario(scenario)
        period, plant = settings.control.period, getattr(settings, "plant", None)
        # A kinematic plant takes no steps.
        is_stepped = settings.backend in self.machine.plants and settings.backend != "kinematic"
        step = getattr(plant, "time_step", 0.0) if is_stepped else 0.0
        if period < step:
            raise ScenarioError(
                f"control.period = {period:g} s is below plant.time_step = {step:g} s",
                "control.period",
            )

    def duration(self, scenario: S) -> float:
        """End of the run [s]."""
        raise NotImplementedError(f"{type(self).__name__} does not define duration")

    def loop(self, scenario: S, **options: Any) -> ClosedLoop[Any]:
        """Builds the closed loop; options as those of `ClosedLoop`."""
        return ClosedLoop(self.machine, scenario, **options)

    def structure(self, scenario: S) -> str | None:
        """The part of a scenario that is built in, as a text; None: its loop serves no other one.

        One with a loop of its own says what that is built from, if `reset` serves the rest.
        """
        if type(self).loop is not LoopExperiment.loop:
            return None
        return self.machine.structure(self.machine_scenario(scenario))

    def most_rows(self, scenario: S) -> int:
        """Number of runs to be simulated together, as rows; 0: each is simulated alone."""
        settings: Any = scenario
        is_alone = settings.backend not in self.machine.plants or not self.structure(scenario)
        return 0 if is_alone else self.machine.over_rows.get(settings.backend, 0)

    def operated(
        self, scenario: S, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[Any] | None:
        """Builds the loop that a person operates, or None.

        Args:
            scenario: the scenario.
            controls: the person's sliders and buttons: a `Panel`, or one with its methods.
                Sources of commands with `shown()` add theirs when that is entered.
            meshcat: scene in which a simulated machine is drawn; None: none.
        """
        return None

    def scene(self, scenario: S) -> Meshcat:
        """Makes the scene around the machine for the browser."""
        return make_viewer(camera=(3.0, 3.0, 1.5), target=(0.0, 0.0, 0.5))

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Numbers beside the scene while the loop runs."""
        return Readout(rows=(Row("time", measured=root_context.get_time(), unit="s"),))

    def live(
        self, scenario: S, panel: Panel, run: Run, console: Console
    ) -> Callable[[], str] | None:
        """Work that lets the viewer move the machine after the run, or None.

        It goes on until a button is clicked, and returns which; that of `operated` by default.
        """
        loop = self.operated(scenario, panel, panel.meshcat)
        return None if loop is None else Live(panel, loop, self.read_out).obey

    def run(self, scenario: S, runner: Runner) -> D:
        """Runs the closed loop, watched and recorded as the options ask."""
        data: Any = self.run_loop(scenario, runner)
        return data

    def run_loop(
        self,
        scenario: S,
        runner: Runner,
        *,
        watched: bool = True,
        monitor: Callable[[ClosedLoop[Any], Meshcat | None], Monitor] | None = None,
    ) -> Run:
        """Runs the closed loop of a scenario once.

        Args:
            scenario: the scenario.
            runner: runs it.
            watched: true for the run that the options show and write.
            monitor: makes the simulator's monitor, which may end the run.

        Raises:
            ScenarioError: a scenario whose parts do not fit together.
            OutputError: a file cannot be written.
        """
        settings: Any = scenario
        structure = None if runner.options.loops is None else self.structure(scenario)
        return runner.run(
            partial(self.loop, scenario),
            self.duration(scenario),
            self.read_out,
            title=self.machine.title,
            backend=settings.backend,
            seed=settings.seed,
            is_simulated=settings.backend in self.machine.plants,
            scene=partial(self.scene, scenario),
            signals_needed=self.needed(scenario),
            structure=None if structure is None else (type(self), structure),
            begin=None if structure is None else self.machine_scenario(scenario),
            watched=watched,
            monitor=monitor,
        )

    def _before(self, scenario: S, options: RunOptions) -> None:
        """The runner draws the loop that it runs."""

    def _after(self, scenario: S, options: RunOptions) -> None:
        """The runner records the scene of the run."""

    def limits(self, scenario: S) -> Limits:
        """Those that the machine declares."""
        of_machine = self.machine_scenario(scenario)
        return self.machine.for_scenario(of_machine).all_limits(of_machine)

    def watched(self, data: D) -> Run:
        """The run that the options show and write."""
        run: Any = getattr(data, "run", data)
        return run

    def logged(self, scenario: S, data: D) -> Logged:
        """All signals of the run, with their units."""
        run = self.watched(data)
        return run.time, {name: (run[name], run.units[name]) for name in run}

    def afterwards(self, scenario: S, data: D, options: RunOptions) -> Callable[[], None] | None:
        """Lets the viewer move the machine, where the run was shown."""
        run = self.watched(data)
        if run.panel is None:
            return None
        try:
            live = self.live(scenario, run.panel, run, options.console) if options.live else None
        except WiringError as error:  # a controller of one's own that takes no commands
            options.console.print(str(error), markup=False, highlight=False, soft_wrap=True)
            live = None
        if live is None:
            run.panel.close()
            return None
        return partial(stay_live, run.panel, live, options.console, self.advice)

    def needed(self, scenario: S) -> tuple[str, ...]:
        """Names of the signals to record: `signals`, without truth that is not there."""
        settings: Any = scenario
        is_simulated = settings.backend in self.machine.plants
        return tuple(n for n in self.signals if is_simulated or not n.startswith("truth."))


def largest(values: ArrayLike) -> float:
    """Largest absolute value."""
    return float(np.abs(np.asarray(values)).max())
