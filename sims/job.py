"""A machine's job, run once: watched, recorded and logged as the options ask."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machines import machine_of
from parapod.sims.experiment import RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.hardware_job import run_on_hardware, show_timing
from parapod.sims.signal_units import with_units
from parapod.sims.simulate import in_real_time, recording, simulate, write_graphviz
from parapod.sims.unsupported_options import refuse_options

type Signals = dict[str, NDArray[Any]]


class LoopMaker(Protocol):
    """Builds a machine's closed loop."""

    def __call__(self, meshcat: Meshcat | None, log: tuple[str, ...] | None) -> ClosedLoop[Any]:
        """The loop, drawn in `meshcat`, with the ports `log` recorded; None for all of them."""


@dataclass(frozen=True)
class Task:
    """What is to be run.

    Attributes:
        what: in a word or two, for progress and logs.
        machine: what is shown, as in "The platform".
        scenario: of the machine; its backend decides what is simulated.
        until: when it ends [s].
        needed: ports whose signals are wanted; all of them are recorded for a log.
        make_loop: builds the closed loop.
        make_scene: builds what a browser shows around the machine.
    """

    what: str
    machine: str
    scenario: Any
    until: float
    needed: tuple[str, ...]
    make_loop: LoopMaker
    make_scene: Callable[[], Meshcat]


@dataclass(frozen=True)
class Run:
    """A task that has been carried out.

    Attributes:
        loop: that was built for it.
        simulator: at the end of the task.
        time: (n) times of the samples [s].
        signals: port name -> (n, size) samples.
        elapsed: wall-clock time [s].
        meshcat: where it was shown, or None.
        again: carries it out once more.
    """

    loop: ClosedLoop[Any]
    simulator: Simulator
    time: NDArray[Any]
    signals: Signals
    elapsed: float
    meshcat: Meshcat | None
    again: Callable[[], float]


def run_task(task: Task, options: RunOptions, simulated: tuple[str, ...]) -> Run:
    """Carries out a task.

    Args:
        task: what is to be run.
        options: how it is watched and recorded.
        simulated: backends of which there is something to show.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        OutputError: a file cannot be written.
    """
    backend = task.scenario.backend
    if backend not in simulated:
        why = f"shows a simulated machine; the backend is {backend}"
        refuse_options(options, ("meshcat", "html"), why)
    meshcat = task.make_scene() if options.meshcat or options.html else None
    loop = task.make_loop(meshcat, task.needed if options.log is None else None)
    if options.graphviz is not None:
        write_graphviz(options.graphviz, loop.diagram)
    simulator = Simulator(loop.diagram)

    def job() -> float:
        if backend == "hardware":
            timing = run_on_hardware(loop, simulator, task.until, options, task.what)
            show_timing(timing, loop.station, options.console)
            return task.until
        loop.reset(simulator.get_mutable_context())
        simulator.Initialize()
        with in_real_time(simulator) if options.meshcat else nullcontext():
            return simulate(simulator, task.until, options.console, task.what)

    elapsed = _watched(task, options, meshcat, job)
    time, signals = loop.recorded(simulator.get_context())
    if options.log is not None and backend != "hardware":
        samples = with_units(signals, machine_of(task.scenario))
        write_experiment_log(options.log, task.what, task.scenario, time, samples)
    return Run(loop, simulator, time, signals, elapsed, meshcat, job)


def _watched(
    task: Task, options: RunOptions, meshcat: Meshcat | None, job: Callable[[], float]
) -> float:
    """Runs the job where people see it."""
    if meshcat is not None and options.meshcat:
        where = f"{task.machine} is shown at {meshcat.web_url()}"
        options.console.print(where, markup=False, highlight=False, soft_wrap=True)
    if meshcat is None or options.html is None:
        return job()
    with recording(meshcat, options.html):
        return job()
