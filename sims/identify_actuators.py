"""Identification of the linear actuators from voltage steps: section 5.2, Figs. 13 to 15.

Ten steps of different voltage, with the legs lifted and under the platform's weight. The gain K
of Eq. (17) is estimated from what a log of the real machine would have, voltages and encoders:
for each step as in the paper, and for all steps together with friction separated from it.
"""

import numpy as np

from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.identify_actuators_estimate import Separated, find_steps, separate_friction
from parapod.sims.identify_actuators_figures import figures
from parapod.sims.identify_actuators_metrics import (
    gain_metrics,
    separated_metrics,
    stroke_metrics,
)
from parapod.sims.identify_actuators_recording import CASES, record, write_recordings
from parapod.sims.identify_actuators_scenario import (
    BACKENDS,
    IdentifyActuatorsScenario,
    check_steps,
)
from parapod.sims.results import Result
from parapod.sims.unsupported_options import refuse_options


def run(scenario: IdentifyActuatorsScenario, options: RunOptions) -> Result:
    """Identifies the actuators without and with load.

    Raises:
        ScenarioError: steps that leave the stroke, have no ramp, or leave friction and K together.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    why = "is not supported: the steps are shown by --figures"
    refuse_options(options, ("html", "graphviz", "meshcat"), why)
    check_steps(scenario)
    recordings = record(scenario, options)
    write_recordings(scenario, options, recordings)
    transient = scenario.steps.transient_s
    steps = tuple(find_steps(r, transient) for r in (recordings.unloaded, recordings.loaded))
    separated = tuple(separate_friction(case) for case in steps)
    return Result(
        "identify-actuators",
        scenario.backend,
        scenario.seed,
        (
            *gain_metrics(*steps),
            *separated_metrics(separated, recordings.gain),
            *stroke_metrics(recordings),
        ),
        _notes(scenario, separated),
        figures(recordings, steps),
    )


def _notes(
    scenario: IdentifyActuatorsScenario, separated: tuple[Separated, ...]
) -> tuple[str, ...]:
    taken = [
        f"{np.mean(found.extending):.3f} V extending and {np.mean(found.retracting):.3f} V "
        f"retracting {case}"
        for case, found in zip(CASES, separated, strict=True)
    ]
    return (
        "K of a step falls short of the true one by friction and load, which take the same "
        "voltage from every step: small steps lose the largest share, and most when they lift "
        f"the platform. Separated from K they are {', '.join(taken)}.",
        f"Gains are off by up to {100 * scenario.actuators.gain_error:g} %, drawn from the seed; "
        "from 4 % on, K of the smallest steps may miss the paper's 15 %, of which friction and "
        "load take most.",
    )


EXPERIMENT = Experiment(
    name="identify-actuators",
    summary="Voltage steps with and without the platform's weight give the actuators' gain K.",
    scenario=IdentifyActuatorsScenario,
    backends=BACKENDS,
    run=run,
)
