"""What the experiment `chair-payload` measures."""

from dataclasses import replace

import numpy as np

from parapod.sims.chair_payload_scenario import ChairPayloadScenario
from parapod.sims.chair_payload_survey import (
    GEOMETRY,
    MASSES,
    PAPER_PAYLOAD,
    Instant,
    paper_share,
    paper_stiffness,
    stand_at,
)
from parapod.sims.results import Metric
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.masses import GRAVITY
from parapod.systems.walking_chair.payload import (
    FORCE_LIMIT,
    Payload,
    Stand,
    elastic_forces,
    largest_payload,
)
from parapod.systems.walking_chair.support import GaitSupport

# Two ways to the same number [kg].
_SAME_PAYLOAD = 0.01
# Between a payload's weight and the forces that carry it [N].
_BALANCE = 0.01
# Share of the limit.
_SAME_FORCE = 1e-3
_CORNER_E1 = np.arange(3 * LEG_COUNT) % 3 == 0


def payload_metrics(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Metric, ...]:
    """The largest payloads through the step, and the forces under the scenario's."""
    mass, limit = scenario.payload.mass_kg, scenario.force_limit
    return (
        *(
            Metric(
                f"payload_{name}_kg",
                min(getattr(instant, name).mass for instant in instants),
                "kg",
                at_least=PAPER_PAYLOAD,
                paper=PAPER_PAYLOAD,
                meaning=f"largest throughout the step, forces spread at their best, {words}",
            )
            for name, words in _friction_words(scenario)
        ),
        *(
            Metric(
                f"branch_force_{name}_n",
                max(_largest(getattr(instant, f"least_{name}")) for instant in instants),
                "N",
                limit,
                meaning=f"smallest that the largest can be under {mass:g} kg, {words}",
            )
            for name, words in _friction_words(scenario)
        ),
        Metric(
            "balance_error_n",
            max(_balance_error(instant) for instant in instants),
            "N",
            _BALANCE,
            meaning="largest of forces and moments [N m] that the found forces leave open",
        ),
    )


def support_metrics(scenario: ChairPayloadScenario) -> tuple[Metric, ...]:
    """How far the chair is from tipping over."""
    at_s = replace(MASSES, body=MASSES.body + LEG_COUNT * MASSES.foot_end, foot=0.0, rod=0.0)
    passenger = scenario.payload.passenger
    return tuple(
        Metric(
            key,
            1e3 * float(GaitSupport(GEOMETRY, scenario.walk, masses).margins(passenger).min()),
            "mm",
            at_least=scenario.support_margin_mm,
            meaning=f"smallest distance of the centre of mass from the polygon's edge, {words}",
        )
        for key, masses, words in (
            ("support_margin_mm", at_s, "the chair's mass at S"),
            ("support_margin_with_feet_mm", MASSES, "feet with masses of their own"),
        )
    )


def paper_metrics(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Metric, ...]:
    """What explains the paper's 57 kg: a payload in the middle, F_N of Eq. (53), two legs."""
    (time, *_) = [instant.time for instant in instants if instant.swings]
    stand = stand_at(scenario.walk, time)
    on_corner = stand._replace(touching=stand.touching & _CORNER_E1)
    on_up = largest_payload(on_corner, 0.0, FORCE_LIMIT).mass
    closed_form = 2.0 * FORCE_LIMIT / GRAVITY - MASSES.total
    softness = paper_stiffness(scenario.walk)
    return (
        Metric(
            "payload_on_up_branches_kg",
            on_up,
            "kg",
            PAPER_PAYLOAD,
            paper=PAPER_PAYLOAD,
            meaning="largest with feet that stand on E1, so that two UP branches carry it all",
        ),
        Metric(
            "closed_form_error_kg",
            abs(on_up - closed_form),
            "kg",
            _SAME_PAYLOAD,
            meaning="of that, against 2 F_N / g less the chair's mass",
        ),
        Metric(
            "up_share",
            paper_share(),
            "",
            1.0,
            at_least=1.0 / 3.0,
            meaning=f"of a leg's load on its UP branch with which {PAPER_PAYLOAD:g} kg reach F_N",
        ),
        Metric(
            "ups_stiffness",
            softness,
            meaning="of a UPS branch, by that of a UP branch, which gives that share",
        ),
        _paper_force(stand, softness),
    )


def _paper_force(stand: Stand, softness: float) -> Metric:
    carried = elastic_forces(stand, PAPER_PAYLOAD, ups_stiffness=softness)
    return Metric(
        "up_force_n",
        float(carried.branch_forces.max()),
        "N",
        (1.0 + _SAME_FORCE) * FORCE_LIMIT,
        at_least=(1.0 - _SAME_FORCE) * FORCE_LIMIT,
        paper=FORCE_LIMIT,
        meaning=f"of a UP branch under {PAPER_PAYLOAD:g} kg with UPS branches that soft",
    )


def _friction_words(scenario: ChairPayloadScenario) -> tuple[tuple[str, str], ...]:
    return ("frictionless", "no friction"), ("friction", f"friction {scenario.friction:g}")


def _largest(payload: Payload) -> float:
    return float(np.abs(payload.branch_forces).max())


def _balance_error(instant: Instant) -> float:
    """Largest of the six equations, over all that was found."""
    stand, errors = instant.stand, []
    for payload in instant[3:]:
        moment = np.cross(stand.corners, payload.forces).sum(axis=0)
        wrench = np.concatenate((payload.forces.sum(axis=0), moment))
        errors.append(np.abs(wrench - stand.wrench(payload.mass)).max())
    return float(max(errors))
