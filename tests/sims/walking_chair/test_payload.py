"""The experiment `chair-payload`: its numbers, and what each of its bounds is about."""

import io

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.output.figures import render
from parapod.sims.walking_chair.payload import (
    ChairPayloadScenario,
    check_stance,
    paper_share,
    payload_metrics,
    stand_at,
    survey,
)
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.walking_chair.support import SupportLost

QUICK = "instants=2"


def scenario_with(*overrides):
    return load_scenario(ChairPayloadScenario, overrides=overrides)


@pytest.fixture(scope="module")
def logged(finished):
    return finished("chair-payload")


@pytest.fixture(scope="module")
def values(logged):
    return logged.values


def test_the_numbers_of_the_papers_step(values):
    assert values["payload_frictionless_kg"] == pytest.approx(168.588, abs=0.1)
    assert values["payload_friction_kg"] == pytest.approx(210.963, abs=0.1)
    assert values["branch_force_frictionless_n"] == pytest.approx(208.4, abs=0.1)
    assert values["branch_force_friction_n"] == pytest.approx(174.4, abs=0.1)
    assert values["support_margin_mm"] == pytest.approx(57.05, abs=0.05)
    assert values["support_margin_with_feet_mm"] == pytest.approx(54.47, abs=0.05)
    assert values["payload_on_up_branches_kg"] == pytest.approx(37.92, abs=0.1)
    assert values["up_share"] == pytest.approx(0.8203, abs=1e-4)
    assert values["ups_stiffness"] == pytest.approx(0.111, abs=1e-3)
    assert values["up_force_n"] == pytest.approx(427.3, abs=0.1)


def test_the_papers_payload_is_between_the_extremes(values):
    assert values["payload_on_up_branches_kg"] < 57.0 < values["payload_frictionless_kg"]


def test_two_legs_limit_the_payload(logged):
    log = logged.log
    swings = ((log.time > 5.0) & (log.time < 10.0)) | ((log.time > 15.0) & (log.time < 20.0))
    for name in ("frictionless", "friction"):
        payload = log.signals[f"largest_payload_{name}"]
        assert np.ptp(payload[swings]) < 1e-6
        assert payload[~swings].min() > payload[swings].max()


def test_branches_that_do_not_carry_are_those_of_the_legs_that_swing(logged):
    log = logged.log
    swings = (log.time > 5.0) & (log.time < 10.0)
    for name in ("least_frictionless", "least_friction", "equal", "soft"):
        forces = log.signals[f"branch_force_{name}"].reshape(-1, 4, 3)
        assert not forces[swings][:, (0, 2)].any()
        assert forces[swings][:, (1, 3)].max() > 100.0
    touching = log.signals["touching"].reshape(-1, 4, 3)
    assert touching[swings][:, (1, 3)].all()
    assert not touching[swings][:, (0, 2)].any()


def test_the_two_ups_branches_of_a_leg_bear_nearly_the_same(logged):
    log = logged.log
    for name in ("equal", "soft"):
        forces = log.signals[f"branch_force_{name}"].reshape(-1, 4, 3)
        assert np.abs(forces[..., 1] - forces[..., 2]).max() < 2.0
    # The UP branch of every leg is the one whose current the paper found the largest.
    soft = log.signals["branch_force_soft"].reshape(-1, 4, 3)
    carries = soft[..., 0] > 1.0
    assert (soft[..., 0] > soft[..., 1])[carries].all()
    assert soft.max() == pytest.approx(427.3, abs=0.1)


def test_a_payload_aside_has_less_margin_and_is_smaller(execute, values):
    aside = execute("chair-payload", QUICK, "payload.x_mm=40", "payload.y_mm=10")
    cost = 57.0 / 106.2 * (0.7437 * 40.0 + 0.6685 * 10.0)
    for key in ("support_margin_mm", "support_margin_with_feet_mm"):
        assert values[key] - aside[key] == pytest.approx(cost, abs=0.1)
    for key in ("payload_frictionless_kg", "payload_friction_kg"):
        assert aside[key] < values[key]
    # What explains the paper's number is about a payload in the middle.
    for key in ("payload_on_up_branches_kg", "up_force_n", "closed_form_error_kg"):
        assert aside[key] == pytest.approx(values[key], abs=1e-6)


def test_less_friction_carries_less(execute, values):
    results = [execute("chair-payload", QUICK, f"friction={mu}") for mu in (0.0, 0.02)]
    none, little = (result["payload_friction_kg"] for result in results)
    assert none == pytest.approx(168.588, abs=0.1)
    assert none < little < values["payload_friction_kg"]


@pytest.mark.parametrize(
    ("override", "broken"),
    [
        (
            "machine.drives.max_force_N=200",
            {"payload_frictionless_kg", "branch_force_frictionless_n"},
        ),
        (
            "machine.drives.max_force_N=150",
            {
                "payload_frictionless_kg",
                "payload_friction_kg",
                "branch_force_frictionless_n",
                "branch_force_friction_n",
            },
        ),
        ("payload.mass_kg=200", {"branch_force_frictionless_n"}),
        (
            "payload.mass_kg=240",
            {"branch_force_frictionless_n", "branch_force_friction_n"},
        ),
    ],
)
def test_bounds_are_broken_by_what_they_are_about(execute, override, broken):
    found = execute("chair-payload", QUICK, override)
    assert {metric.key for metric in found.broken} == broken
    # With weaker actuators the paper's payload is not explained.
    assert (found.notes == ()) == override.startswith("machine")


def test_forces_that_do_not_balance_the_weight_break_their_bound():
    scenario = scenario_with(QUICK)
    instants = survey(scenario, Console(quiet=True))
    (clean,) = [m for m in payload_metrics(scenario, instants) if m.key == "balance_error_n"]
    assert clean.passed
    for name in instants[3]._fields[3:]:
        found = getattr(instants[3], name)
        wrong = instants[3]._replace(**{name: found._replace(forces=1.001 * found.forces)})
        tampered = [*instants[:3], wrong, *instants[4:]]
        (metric,) = [m for m in payload_metrics(scenario, tampered) if m.key == "balance_error_n"]
        assert not metric.passed


def test_feet_that_are_about_to_swing_do_not_carry():
    feet = stand_at(scenario_with(), 5.0).touching.reshape(4, 3)
    assert feet.tolist() == [[False] * 3, [True] * 3] * 2
    assert stand_at(scenario_with(), 4.999).touching.all()


def test_the_share_is_that_of_the_closed_form():
    # 2 F_N = s g (49.2 kg + 57 kg)
    assert paper_share(scenario_with()) * 9.81 * 106.2 == pytest.approx(2.0 * 427.3)


@pytest.mark.parametrize(("order", "way"), [("13-24", "back"), ("24-13", "forward and back")])
def test_every_order_and_way_holds_the_bounds(execute, order, way):
    result = execute("chair-payload", QUICK, f"gait.order={order}", f"gait.way={way}")
    assert result.broken == ()
    assert result.metrics[0].value == pytest.approx(168.588, abs=0.1)


def test_of_cycles_that_are_all_alike_one_is_looked_at():
    found = survey(scenario_with("instants=1", "gait.cycles=3"), Console(quiet=True))
    assert [instant.phase for instant in found] == [
        "lift", "first swing", "shift", "second swing", "lower",
    ]  # fmt: skip
    assert [instant.time for instant in found] == [2.5, 7.5, 12.5, 17.5, 22.5]


def test_a_payload_that_tips_the_chair_over_is_refused_before_anything_runs(execute):
    console = Console(file=io.StringIO(), force_terminal=True)
    with pytest.raises(SupportLost) as caught:
        execute("chair-payload", "payload.x_mm=100", "payload.y_mm=50", console=console)
    assert caught.value.phase == "first swing"
    assert "first swing that begins 5 s after the start" in str(caught.value)
    assert " mm, less than the 10.0 mm that are required" in str(caught.value)
    assert console.file.getvalue() == ""


def test_the_required_margin_is_the_scenario_s():
    check_stance(scenario_with("support_margin_mm=54"))
    with pytest.raises(SupportLost, match=r"54\.5 mm, less than the 55\.0 mm"):
        check_stance(scenario_with("support_margin_mm=55"))


def test_the_notes_explain_the_papers_payload(logged):
    text = " ".join(logged.result.notes)
    for part in ("57 kg are not what the best", "169 kg", "37.9 kg", "82 %", "0.11 times", "fit"):
        assert part in text


def test_the_support_is_drawn_where_it_is_smallest(logged):
    figures = logged.result.figures
    names = ["payload_over_time", "payload_support", "fig17_branch_forces"]
    assert [figure.name for figure in figures] == names
    assert b"first swing, 9." in render(figures[1])


def test_progress_is_shown():
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    survey(scenario_with(QUICK), console)
    assert "spreading forces" in console.file.getvalue()
