"""The workspace of the levelling platform with its arm: section 4 and Fig. 12, exact.

Nothing is simulated: every point is a closed form. `--html` and `--meshcat` show the workspace
above the machine as a picture that can be turned.
"""

from functools import partial

from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.outputs import atomic_output
from parapod.sims.results import Result
from parapod.sims.unsupported_options import refuse_options
from parapod.sims.workspace_figures import figures
from parapod.sims.workspace_metrics import (
    Finding,
    check_inclined_ground,
    compare_surfaces,
    measure_turntable,
    measure_volume,
)
from parapod.sims.workspace_scenario import BACKENDS, WorkspaceScenario

_STEPS = {
    "measuring the volume": measure_volume,
    "comparing the printed surfaces": compare_surfaces,
    "inclining the ground": check_inclined_ground,
    "turning the turntable": measure_turntable,
}


def run(scenario: WorkspaceScenario, options: RunOptions) -> Result:
    """Measures the workspace.

    Raises:
        OutputError: a file cannot be written, or there is nothing to write to it.
    """
    why = "has nothing to write: the workspace is not simulated"
    refuse_options(options, ("log", "graphviz"), why)
    findings: list[Finding] = []
    with options.console.status("") as status:
        for what, measure in _STEPS.items():
            if measure is not measure_turntable or scenario.turntable:
                status.update(what)
                findings.append(measure(scenario))
    afterwards = _show(scenario, options) if options.meshcat or options.html else None
    return Result(
        "workspace",
        scenario.backend,
        scenario.seed,
        tuple(metric for finding in findings for metric in finding.metrics),
        tuple(note for finding in findings for note in finding.notes),
        figures(scenario),
        afterwards,
    )


def _show(scenario: WorkspaceScenario, options: RunOptions) -> "partial[None] | None":
    """Draws the workspace for the browser; what is left to do is to wait for its viewers."""
    from parapod.sims.workspace_view import draw, wait

    meshcat = draw(scenario)
    if options.html is not None:
        with atomic_output(options.html) as temporary:
            temporary.write_text(meshcat.StaticHtml(), encoding="utf-8")
    if not options.meshcat:
        return None
    where = f"The workspace is shown at {meshcat.web_url()}"
    options.console.print(where, markup=False, highlight=False, soft_wrap=True)
    return partial(wait, meshcat, options.console) if options.live else None


EXPERIMENT = Experiment(
    name="workspace",
    summary="Where the platform can bring the tip of its arm, beside the paper's eight surfaces.",
    scenario=WorkspaceScenario,
    backends=BACKENDS,
    run=run,
)
