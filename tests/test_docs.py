"""What the documents take from the code is what the code says."""

from pathlib import Path

from parapod.systems.levelling_platform.findings import as_markdown
from parapod.systems.levelling_platform.phases import as_mermaid

_OPERATION = (Path(__file__).parents[1] / "docs" / "operation.md").read_text()


def test_the_phases_are_drawn_from_the_table_of_transitions():
    assert f"```mermaid\n{as_mermaid()}\n```" in _OPERATION


def test_the_findings_are_those_of_the_detector():
    assert as_markdown() in _OPERATION
