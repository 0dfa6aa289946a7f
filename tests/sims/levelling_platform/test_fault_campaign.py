"""Cells of the campaign of faults, and what is counted of them."""

import math
from dataclasses import replace

import pytest

from parapod.diagrams.levelling_platform.scenario import ControlScenario
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.levelling_platform.deploy import DeployScenario
from parapod.sims.levelling_platform.fault_campaign import (
    DEVICES,
    STRAY_DEG,
    STRAY_MM,
    Campaign,
    Cell,
    FaultCampaignScenario,
)
from parapod.systems.levelling_platform.fault_detection import RULES, Finding
from parapod.systems.levelling_platform.supervisor import Phase
from parapod.systems.safety.faults import FaultKind

WINDOW = 2.0


@pytest.fixture(scope="module")
def campaign():
    return Campaign(DeployScenario(backend="kinematic"), Phase.POSTURE, WINDOW)


# Cells


@pytest.mark.parametrize(
    ("device", "kind", "finding", "reaction"),
    [
        ("encoder", FaultKind.STUCK, Finding.LEG_RESPONSE, "brake"),
        ("encoder", FaultKind.OFF, Finding.ENCODER_INVALID, "brake"),
        ("gyro", FaultKind.OFF, Finding.IMU_STALE, "hold"),
        ("accelerometer", FaultKind.WRONG, Finding.ACCEL_MISMATCH, "hold"),
        ("drive", FaultKind.WRONG, Finding.LEG_RESPONSE, "brake"),
        ("command", FaultKind.OFF, Finding.COMMAND_INVALID, "warn"),
    ],
)
def test_a_fault_is_found_in_time_and_does_no_harm(campaign, device, kind, finding, reaction):
    cell = campaign.run(device, kind)
    assert (cell.device, cell.kind, cell.phase) == (device, kind.value, "posture")
    assert cell.injected
    assert cell.findings[0] == finding.name.lower()
    assert cell.reaction == reaction
    assert 0.0 <= cell.delay <= RULES[finding].deadline
    assert cell.bounded
    assert not any((cell.is_late, cell.is_misnamed, cell.is_harmful))


@pytest.mark.parametrize(
    ("device", "kind"),
    [("end switch", FaultKind.OFF), ("command", FaultKind.STUCK)],
)
def test_a_signal_that_shows_what_it_would_have_anyway_is_not_injected(campaign, device, kind):
    cell = campaign.run(device, kind)
    assert not cell.injected
    assert cell.findings == ()
    assert cell.reaction == "none"
    assert math.isnan(cell.delay)
    assert cell.stray_deg == cell.stray_mm == 0.0
    assert cell.bounded


def test_a_cell_leaves_no_trace_in_the_next_one(campaign):
    first = campaign.run("encoder", FaultKind.GARBAGE)
    campaign.run("supply", FaultKind.OFF)
    again = campaign.run("encoder", FaultKind.GARBAGE)
    assert again == first
    assert first.injected


# What is said about them

CELL = Cell("encoder", "stuck", "posture", True, (), math.nan, "none", 0.0, 0.0, True)
FAR = 1.01 * STRAY_DEG


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.finding.name.lower())
def test_a_cell_is_late_if_the_platform_moved_and_the_deadline_is_over(rule):
    found = replace(CELL, findings=(rule.finding.name.lower(), "imu_stale"))
    assert not replace(found, delay=rule.deadline, stray_deg=FAR).is_late
    assert replace(found, delay=1.01 * rule.deadline, stray_deg=FAR).is_late
    assert not replace(found, delay=1.01 * rule.deadline, stray_deg=STRAY_DEG).is_late
    assert replace(found, delay=math.nan, stray_deg=FAR).is_late


def test_what_is_not_found_is_not_late():
    assert not replace(CELL, stray_deg=FAR, delay=100.0).is_late


@pytest.mark.parametrize(
    ("device", "right", "wrong"),
    [
        ("encoder", "leg_response", "imu_stale"),
        ("gyro", "posture_mismatch", "leg_response"),
        ("gyro", "imu_stale", "accel_invalid"),
        ("accelerometer", "accel_mismatch", "gyro_invalid"),
        ("contact switch", "foot_lost", "switch_end"),
        ("end switch", "switch_end", "switch_contact"),
        ("drive", "supply", "encoder_jump"),
        ("supply", "leg_response", "feet_mismatch"),
        ("command", "command_invalid", "leg_response"),
    ],
)
def test_a_cell_is_misnamed_if_its_first_finding_names_other_devices_only(device, right, wrong):
    cell = replace(CELL, device=device)
    assert not cell.is_misnamed
    assert not replace(cell, findings=(right,)).is_misnamed
    assert not replace(cell, findings=(right, wrong)).is_misnamed
    assert replace(cell, findings=(wrong,)).is_misnamed
    assert replace(cell, findings=(wrong, right)).is_misnamed


@pytest.mark.parametrize("device", DEVICES)
def test_some_finding_names_each_device(device):
    cell = replace(CELL, device=device)
    names = [finding.name.lower() for finding in Finding]
    assert not all(replace(cell, findings=(name,)).is_misnamed for name in names)


def test_a_cell_is_harmful_if_the_platform_left_its_path_unnoticed():
    assert not CELL.is_harmful
    assert not replace(CELL, stray_deg=STRAY_DEG, stray_mm=STRAY_MM).is_harmful
    for stray in ({"stray_deg": FAR}, {"stray_mm": 1.01 * STRAY_MM}):
        away = replace(CELL, **stray)
        assert away.is_harmful
        assert not replace(away, findings=("leg_response",)).is_harmful
        # What the operator asks for is obeyed, wherever it leads.
        assert not replace(away, device="command").is_harmful


# The campaign


def test_a_campaign_of_one_device_in_one_phase_has_a_cell_for_each_kind(finished):
    run = finished("fault-campaign")
    kinds = len(FaultKind)
    assert run.values["cells"] == run.values["cells_injected"] == kinds
    matrix = run.result.details["matrix"]
    assert [(cell["device"], cell["kind"]) for cell in matrix] == [
        ("encoder", kind.value) for kind in FaultKind
    ]
    assert run.values["cells_found"] == sum(bool(cell["findings"]) for cell in matrix)
    # The matrix has a line for each kind; phases are cut short above it.
    assert "posture".startswith(run.result.notes[1].strip())
    for kind, note in zip(FaultKind, run.result.notes[2 : 2 + kinds], strict=True):
        assert note.split()[:2] == ["encoder", kind.value]


def test_a_campaign_is_broken_by_a_fault_that_does_harm_unnoticed():
    experiment = find_experiment("fault-campaign")

    def broken(*cells):
        metrics = experiment.measure(FaultCampaignScenario(), list(cells))
        return {metric.key for metric in metrics if not metric.passed}

    found = replace(CELL, findings=("leg_response",), delay=0.1, reaction="brake")
    assert broken(found) == set()
    for spoilt in ({"stray_deg": FAR}, {"bounded": False}):
        assert broken(found, replace(CELL, **spoilt))


def test_a_campaign_disturbs_the_controller_of_its_scenario():
    scenario = FaultCampaignScenario(control=ControlScenario(period=0.02))
    assert scenario.operation.control.period == 0.02
