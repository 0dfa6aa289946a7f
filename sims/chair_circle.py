"""A foot of the walking chair on a circle, in three control modes: Figs. 10, 11 and 14.

The three drives of leg 1 are led from node to node as the paper's controllers do it: by positions
at full speed, by velocities, and by velocities that correct what is missing from the position
(Eqs. 46-48). What the encoders cannot tell, the foot's true place, is compared with Eq. (49).
"""

from parapod.sims.chair_circle_figures import figures
from parapod.sims.chair_circle_metrics import (
    PAPER_RADIAL_MM,
    error_metrics,
    radial_error_mm,
    sensitivities,
    sensitivity_metrics,
    velocity_metrics,
)
from parapod.sims.chair_circle_recording import Recording, check_circle, record, write_recordings
from parapod.sims.chair_circle_scenario import BACKENDS, ChairCircleScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.results import Result
from parapod.sims.unsupported_options import refuse_options


def run(scenario: ChairCircleScenario, options: RunOptions) -> Result:
    """Follows the circle in every mode.

    Raises:
        ScenarioError: parts of the circle that do not fit together.
        StrokeExceeded: a circle that takes a branch out of its stroke.
        SpeedExceeded: a circle that is too fast for a branch.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    why = "is not supported: the circle is shown by --figures"
    refuse_options(options, ("html", "meshcat"), why)
    check_circle(scenario)
    recordings = record(scenario, options)
    write_recordings(scenario, options, recordings)
    return Result(
        "chair-circle",
        scenario.backend,
        scenario.seed,
        (
            *error_metrics(scenario, recordings),
            *velocity_metrics(scenario, recordings),
            *sensitivity_metrics(scenario.circle.circle),
        ),
        _notes(recordings),
        figures(recordings),
    )


def _notes(recordings: dict[str, Recording]) -> tuple[str, ...]:
    compound = recordings["compound"]
    any_way, radially = sensitivities(compound.circle)
    return (
        f"The {PAPER_RADIAL_MM:g} mm by which the paper's radius is off are not the control's: "
        f"that leaves {radial_error_mm(compound):.2f} mm here. They are what lengths can do that "
        f"are off by {PAPER_RADIAL_MM / radially:.2f} mm (root of the sum of squares over the "
        "three branches): play in the joints, homing, the leg's dimensions. The paper puts them "
        f"down to the mechanism too. For each mm of such an error the foot moves by up to "
        f"{any_way:.2f} mm.",
        "The mode velocity keeps what it loses at the start: its sum of velocity errors is a "
        "position, without which it would drift. The mode position runs to every node at full "
        "speed and stops there.",
        "Without circle.ramp the foot is asked to move at full speed at once, and to stop at "
        "once; that is where the largest errors are.",
    )


EXPERIMENT = Experiment(
    name="chair-circle",
    summary="A foot of the walking chair follows a circle, in three modes of its drives' control.",
    scenario=ChairCircleScenario,
    backends=BACKENDS,
    run=run,
)
