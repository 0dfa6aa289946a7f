"""The table of what can be found."""

import pytest

from parapod.systems.levelling_platform.fault_detection import RULES, Finding, Rule, as_markdown
from parapod.systems.safety.faults import Severity

EACH_RULE = pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.finding.name.lower())


def test_there_is_one_line_for_each_finding_in_the_order_of_the_numbers():
    assert [rule.finding for rule in RULES] == list(Finding)
    assert [int(rule.finding) for rule in RULES] == list(range(len(RULES)))


@EACH_RULE
def test_a_sign_is_believed_before_its_deadline(rule: Rule):
    assert 0.0 <= rule.persists < rule.deadline


@EACH_RULE
def test_what_is_found_is_told_at_least_and_never_waits_for_a_person(rule: Rule):
    assert Severity.WARN <= rule.severity <= Severity.BRAKE


@EACH_RULE
def test_each_line_says_what_may_have_failed_and_what_shows_it(rule: Rule):
    assert rule.device
    assert rule.sign
    assert "|" not in rule.device + rule.sign


def test_what_moves_the_legs_wrongly_takes_their_drives_out_of_control():
    """A position controller cannot be trusted with an extension that is wrong."""
    trusted = {rule.finding for rule in RULES if rule.severity < Severity.BRAKE}
    assert not trusted & {
        Finding.ENCODER_INVALID,
        Finding.ENCODER_JUMP,
        Finding.LEGS_STALE,
        Finding.LEG_RESPONSE,
        Finding.SUPPLY,
    }


def test_the_table_for_people_names_all_of_them_with_severity_and_deadline():
    head, rule_off, *lines = as_markdown().splitlines()
    assert head.count("|") == rule_off.count("|") == 6
    assert len(lines) == len(RULES)
    for line, rule in zip(lines, RULES, strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert cells[:2] == [rule.finding.name.lower(), rule.severity.name.lower()]
        assert float(cells[2]) == rule.deadline
        assert cells[3:] == [rule.device, rule.sign]
