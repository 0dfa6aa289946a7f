"""Slip of the feet while the legs lift the platform and while the arm swings: section 7, Fig. 23.

The legs raise the platform at level attitude; once it has settled the actuators are braked, at
0 V behind self-locking screws, and the arm swings. The solver's own creep, which the arm has no
part in, is measured apart, on an inclined ground.
"""

from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.results import Result
from parapod.sims.slip_figures import figures
from parapod.sims.slip_metrics import CREEP_STEPS, creep_metrics, lift_metrics, slip_metrics
from parapod.sims.slip_recording import creep, lift_and_swing, write_recording
from parapod.sims.slip_scenario import BACKENDS, SlipScenario
from parapod.sims.unsupported_options import refuse_options

_NOTES = (
    "The creep is the solver's: its friction is regularised, so that a foot under a tangential "
    "force never quite stands still. It carries the whole platform down the slope, not its "
    "posture. With full legs it goes with the time step from 2 ms on; at 1 ms, and with reduced "
    "legs at any step, it is at the floor that Drake's stiction tolerance of 0.1 mm/s sets for "
    "lagged and similar contact; with sap, which has no such floor, it goes with the time step "
    "throughout.",
    "Most of the arm's slip is elastic and comes back; arm_slip_left_mm is what stays.",
)


def run(scenario: SlipScenario, options: RunOptions) -> Result:
    """Lifts, swings, and measures the creep apart.

    Raises:
        UnreachablePosture: a height outside the stroke.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    why = "is not supported: the slip is shown by --figures"
    refuse_options(options, ("html", "graphviz", "meshcat"), why)
    recording = lift_and_swing(scenario, options)
    write_recording(scenario, options, recording)
    speeds = [creep(scenario, step, options) for step in CREEP_STEPS]
    metrics = (
        *slip_metrics(scenario, recording),
        *lift_metrics(scenario, recording),
        *creep_metrics(scenario, speeds),
    )
    drawn = figures(scenario, recording)
    return Result("slip", scenario.backend, scenario.seed, metrics, _NOTES, drawn)


EXPERIMENT = Experiment(
    name="slip",
    summary="How far the feet slip while the legs lift the platform and while the arm swings.",
    scenario=SlipScenario,
    backends=BACKENDS,
    run=run,
)
