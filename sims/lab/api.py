"""Scenarios, closed loops and runs by the names of experiments, for scripts and notebooks."""

import warnings
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.drivers.external import load_installed_drivers
from parapod.sims.lab.discovery import find_entry, list_entries
from parapod.sims.lab.experiment import Experiment, RunOptions
from parapod.sims.lab.results import Result
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import check


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
    made: Any = load_scenario(schema, entry.default_scenario, None, overrides)
    for key, value in values.items():
        setattr(made, key, value)
    object.__setattr__(made, "_experiment", experiment)
    return made


def closed_loop(
    scenario: Any,
    *,
    meshcat: Meshcat | None = None,
    plant: System | None = None,
    controller: System | None = None,
) -> ClosedLoop[Any]:
    """The closed loop of a scenario, a Diagram: `Simulator(closed_loop(scenario))`.

    Args:
        scenario: from `scenario`, or a machine's own.
        meshcat: scene in which the machine is drawn; None for no drawing.
        plant: a LeafSystem or Diagram of your own with the station's ports, in its place.
        controller: a system of your own in place of the controller.

    Raises:
        ScenarioError: a scenario that is not admissible.
        WiringError: a system whose ports do not fit; names them.
        ParapodError: an experiment without a closed loop.
    """
    experiment = _experiment_of(scenario)
    check(scenario)
    experiment.check(scenario)
    loop = getattr(experiment, "loop", None)
    built = loop(scenario, meshcat=meshcat, plant=plant, controller=controller) if loop else None
    if not isinstance(built, ClosedLoop):
        raise ParapodError(f"the experiment '{experiment.name}' has no closed loop of a machine")
    return built


def run(experiment: Any, *overrides: str, quiet: bool = False, **values: Any) -> Result:
    """Runs an experiment; the result shows its table and figures in a notebook.

    Args:
        experiment: its name, or a scenario from `scenario`.
        overrides: changes as for `parapod run --set`.
        quiet: whether no progress is shown.
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
    console = Console(stderr=True, quiet=quiet)
    return _experiment_of(settings).execute(settings, RunOptions(console=console))


def _experiment_of(scenario: Any) -> Experiment[Any, Any]:
    """The experiment that a scenario was made for, or the usual one of its machine."""
    name = getattr(scenario, "_experiment", "")
    if not name:
        from parapod.diagrams.machine import list_machines

        usual = [m.experiment for m in list_machines() if isinstance(scenario, m.scenario)]
        if not usual:
            known = ", ".join(entry.name for entry in list_entries())
            raise ScenarioError(
                f"a {type(scenario).__name__} is not the scenario of an experiment; make one with "
                f"parapod.scenario(NAME), where NAME is one of {known}"
            )
        name = usual[0]
    return find_entry(name).load()
