"""What the walking chair can carry through a step: Eqs. (50)-(54), and the 57 kg of Fig. 17.

The chair stands still at instants of a step. Forces of the ground are spread over the corners of
its feet so that no branch exceeds its actuator's thrust; the largest payload for which there is
such a way is what no control can exceed. The support polygon says how far it is from tipping.
"""

from parapod.sims.chair_payload_figures import figures
from parapod.sims.chair_payload_metrics import (
    paper_metrics,
    payload_metrics,
    support_metrics,
)
from parapod.sims.chair_payload_scenario import BACKENDS, ChairPayloadScenario
from parapod.sims.chair_payload_survey import (
    PAPER_PAYLOAD,
    check_stance,
    paper_share,
    paper_stiffness,
    survey,
    write_survey,
)
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.results import Metric, Result
from parapod.sims.unsupported_options import refuse_options


def run(scenario: ChairPayloadScenario, options: RunOptions) -> Result:
    """Finds payloads, forces and margins.

    Raises:
        StrokeExceeded: a gait that takes a branch out of its stroke.
        SpeedExceeded: a gait that is too fast for a branch.
        SupportLost: a payload that would tip the chair over, or nearly so.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    why = "has nothing to show: no diagram is simulated"
    refuse_options(options, ("html", "graphviz", "meshcat"), why)
    check_stance(scenario)
    instants = survey(scenario, options)
    write_survey(scenario, options, instants)
    metrics = (
        *payload_metrics(scenario, instants),
        *support_metrics(scenario),
        *paper_metrics(scenario, instants),
    )
    return Result(
        "chair-payload",
        scenario.backend,
        scenario.seed,
        metrics,
        _notes(scenario, metrics),
        figures(scenario, instants),
    )


def _notes(scenario: ChairPayloadScenario, metrics: tuple[Metric, ...]) -> tuple[str, ...]:
    values = {metric.key: metric.value for metric in metrics}
    best = values["payload_frictionless_kg"]
    if best < PAPER_PAYLOAD:
        return ()
    return (
        f"The paper's {PAPER_PAYLOAD:g} kg are not what the best distribution of forces carries, "
        f"{best:.0f} kg and more. They lie between that and the "
        f"{values['payload_on_up_branches_kg']:.1f} kg of feet that press on the ground under "
        f"their UP branches alone.",
        f"It is the payload at which a UP branch with {100.0 * paper_share():.0f} % of its leg's "
        f"load reaches its thrust while two legs stand. UPS branches that are "
        f"{paper_stiffness(scenario.walk):.2f} times as stiff would explain that share, and the "
        "paper's remark that branch 1 of each leg takes the largest current; that is a fit and no "
        "measurement.",
    )


EXPERIMENT = Experiment(
    name="chair-payload",
    summary="How much the walking chair carries through a step, and how near it is to tipping.",
    scenario=ChairPayloadScenario,
    backends=BACKENDS,
    run=run,
)
