"""Scenarios, closed loops and runs by the names of experiments, for scripts and notebooks."""

import os
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.drivers.external import load_installed_drivers
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.lab.discovery import find_entry, list_entries
from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Result
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import check

if TYPE_CHECKING:
    from parapod.sims.study.result import StudyResult


def experiments() -> dict[str, str]:
    """Names of all experiments that are installed, with their summaries."""
    return {entry.name: entry.summary for entry in list_entries()}


def scenario(experiment: str, *overrides: str, **values: Any) -> Any:
    """The scenario of an experiment: a dataclass whose values are checked whenever they change.

    Args:
        experiment: its name, as in `parapod list`.
        overrides: changes as for `parapod run --set`, such as "ground.pitch_deg=4".
        values: values of its own keys, such as `seed=3` or `backend="kinematic"`.

    Raises:
        UnknownExperiment: there is no such experiment; names those that there are.
        ScenarioError: a key or a value that is not admissible; names those that are.
    """
    entry = find_entry(experiment)
    schema = entry.load().schema
    for problem in load_installed_drivers():
        warnings.warn(problem, stacklevel=2)
    scenario: Any = load_scenario(schema, entry.default_scenario, None, overrides)
    for key, value in values.items():
        setattr(scenario, key, value)
    object.__setattr__(scenario, "_experiment", experiment)
    return scenario


def closed_loop(
    scenario: Any,
    *,
    meshcat: Meshcat | None = None,
    plant: System | None = None,
    controller: System | None = None,
) -> ClosedLoop[Any]:
    """The closed loop of a scenario, a Diagram: `closed_loop(scenario).simulator()`.

    Args:
        scenario: from `scenario`, or a machine's own.
        meshcat: scene in which the machine is drawn; None for no drawing.
        plant: a LeafSystem or Diagram of your own in the station's place, with those of its ports
            that controller and commands need.
        controller: a system of your own in place of the controller.

    Raises:
        ScenarioError: a scenario that is not admissible.
        WiringError: a system whose ports do not fit; names them.
        ParapodError: an experiment without a closed loop.
    """
    experiment = _experiment_of(scenario)
    check(scenario)
    parts = {"meshcat": meshcat, "plant": plant, "controller": controller}
    options = {name: part for name, part in parts.items() if part is not None}
    return loop_of(experiment, scenario, **options)


def loop_of(experiment: Any, scenario: Any, **options: Any) -> ClosedLoop[Any]:
    """The closed loop of an experiment's scenario.

    Args:
        experiment: the experiment.
        scenario: scenario of the experiment's schema.
        options: options of `closed_loop`.

    Raises:
        ScenarioError: a scenario that the experiment refuses.
        ParapodError: an experiment without a closed loop.
    """
    experiment.check(scenario)
    loop = getattr(experiment, "loop", None)
    closed_loop = loop(scenario, **options) if loop else None
    if not isinstance(closed_loop, ClosedLoop):
        raise ParapodError(f"the experiment '{experiment.name}' has no closed loop of a machine")
    return closed_loop


def rows(loop: ClosedLoop[Any] | Any, scenarios: Sequence[Any]) -> LoopRows[Any]:
    """Closed loops of many scenarios, to be simulated side by side.

        rows = parapod.rows(scenarios[0], scenarios)
        rows.advance_to(30.0)
        rows.recording(17)["truth.posture"]  # that of the 18th scenario, as Drake has it

    Args:
        loop: a scenario: each row has a loop of its own, and all loops are wired alike. Or the
            loop of one of the scenarios, which serves all: they then differ only in what a loop
            is reset to, such as seed, ground and errors of sensors.
        scenarios: a scenario for each row.

    Raises:
        ScenarioError: a scenario that is not admissible, or of another structure; names the key.
        ParapodError: a system that rows cannot have, or more rows than memory.
    """
    for one in scenarios:
        check(one)
    if isinstance(loop, ClosedLoop):
        return LoopRows(loop, _begun(loop, scenarios))
    first = closed_loop(loop)
    begins = _begun(first, scenarios)
    loops = {first.machine.structure(first.scenario): first}
    chosen = []
    for one, begin in zip(scenarios, begins, strict=True):
        structure = first.machine.structure(begin)
        if structure not in loops:
            loops[structure] = closed_loop(one)
        chosen.append(loops[structure])
    return LoopRows(chosen, begins)


def _begun(loop: ClosedLoop[Any], scenarios: Sequence[Any]) -> list[Any]:
    """Scenarios of a loop's machine in those of experiments.

    Raises:
        ScenarioError: one of another machine.
    """
    kind = type(loop.scenario)
    begins = [
        one if isinstance(one, kind) else _experiment_of(one).machine_scenario(one)
        for one in scenarios
    ]
    for row, begin in enumerate(begins):
        if not isinstance(begin, kind):
            raise ScenarioError(f"row {row} is a scenario of another machine than the loop's")
    return begins


def viewer(scenario: Any, record: bool = False) -> Meshcat:
    """The scene of a scenario's experiment, in which a closed loop can be drawn.

    Its camera shows the whole machine; `Scene.from_meshcat(viewer)` shows it in a notebook.

    Args:
        scenario: from `scenario`, or a machine's own.
        record: true if motions are recorded from now on, so that `Scene.from_meshcat` plays them.

    Raises:
        ScenarioError: a scenario that is not admissible.
        ParapodError: an experiment that shows nothing.
    """
    experiment = _experiment_of(scenario)
    check(scenario)
    meshcat: Meshcat | None = experiment.scene(scenario) if hasattr(experiment, "scene") else None
    if meshcat is None:
        raise ParapodError(f"the experiment '{experiment.name}' has no scene")
    if record:
        meshcat.StartRecording()
    return meshcat


def run(experiment: Any, *overrides: str, quiet: bool = False, **values: Any) -> Result:
    """Runs an experiment; the result shows its table and figures in a notebook.

    Args:
        experiment: its name, or a scenario from `scenario`.
        overrides: changes as for `parapod run --set`.
        quiet: true if no progress is shown.
        values: values of the scenario's own keys, such as `seed=3`.

    Raises:
        UnknownExperiment: there is no such experiment.
        ScenarioError: a scenario that is not admissible.
        ParapodError: the experiment refuses.
    """
    if isinstance(experiment, str):
        settings = scenario(experiment, *overrides, **values)
    elif overrides or values:
        raise ScenarioError("change the scenario itself; it comes with its values")
    else:
        settings = experiment
        check(settings)
    console = Console(stderr=True, quiet=quiet)
    return _experiment_of(settings).execute(settings, RunOptions(console=console))


def study(
    experiment: Any,
    vary: Mapping[str, str | Sequence[Any]],
    *,
    sampling: str = "grid",
    runs: int | None = None,
    sampling_seed: int = 0,
    workers: int | None = None,
    executor: Executor | None = None,
    cluster: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    quiet: bool = False,
) -> "StudyResult":
    """Runs an experiment over the values of some keys of its scenario.

    A script that calls this needs `if __name__ == "__main__":`, as for any pool of processes.

    Args:
        experiment: its name, or a scenario from `scenario`, which the variables change.
        vary: values by dotted key: a sequence, or a text as for `parapod study --vary`, such
            as "-5:5:11", "0:200" or "normal(0, 0.3)".
        sampling: "grid", "latin" or "sobol".
        runs: number of runs; a grid has its own.
        sampling_seed: seed of the random samplings.
        workers: processes on this computer; None: all cores, or as many as the executor has.
        executor: any other executor, such as mpi4py's or Ray's, which stays open.
        cluster: address of a Dask scheduler in place of both.
        out: Parquet table to which each run is appended; None: the result is only returned.
        resume: true to go on with an existing table.
        quiet: true if no progress is shown.

    Raises:
        UnknownExperiment: there is no such experiment.
        ScenarioError: variables or a sampling that are not admissible.
        OutputError: the table cannot be written, or is not to be gone on with.
        NoWorkers: nothing carries out the runs.
        AnotherVersion: a worker has other software.
    """
    from parapod.sims.lab.work import Crew, LocalCrew
    from parapod.sims.study.cluster import ClusterCrew
    from parapod.sims.study.records import Records
    from parapod.sims.study.result import StudyResult
    from parapod.sims.study.study import Study

    if executor is not None and cluster is not None:
        raise ParapodError("either an executor or a cluster does the work, not both")
    settings = scenario(experiment) if isinstance(experiment, str) else experiment
    name = _experiment_of(settings).name
    study = Study.make(name, settings, vary, sampling, runs, sampling_seed)
    records = Records(study.sampling)
    if executor is not None:
        size = workers or getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        crew = Crew(executor, size)
    else:
        crew = LocalCrew(workers) if cluster is None else ClusterCrew(cluster)
    with crew:
        path = None if out is None else Path(out)
        study.carry_out(crew, records, Console(stderr=True, quiet=quiet), path, resume)
    return StudyResult(study, records)


def _experiment_of(scenario: Any) -> Experiment[Any, Any]:
    """The experiment that a scenario was made for, or the usual one of its machine."""
    name = getattr(scenario, "_experiment", "")
    if not name:
        from parapod.diagrams.machine import list_machines

        usual = [m.experiment for m in list_machines() if isinstance(scenario, m.scenario)]
        if not usual:
            names = ", ".join(entry.name for entry in list_entries())
            raise ScenarioError(
                f"a {type(scenario).__name__} is not the scenario of an experiment; make one with "
                f"parapod.scenario(NAME), where NAME is one of {names}"
            )
        name = usual[0]
    return find_entry(name).load()
