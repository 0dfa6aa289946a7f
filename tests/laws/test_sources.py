"""Texts of the sources, and places of tests."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MARK = "mark." + "real_time"
ROOMS = ("systems", "diagrams", "sims", "urdf", "benchmarks", "examples")


def first_words(path):
    """First words of a file's docstrings, each with the name of what it is of."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            text = ast.get_docstring(node, clean=False) or "None"
            yield getattr(node, "name", "the module"), text.split()[0]


def test_docstrings_begin_with_an_imperative_or_a_noun():
    for path in (p for room in ROOMS for p in (ROOT / room).rglob("*.py")):
        for name, first in first_words(path):
            assert first not in ("What", "How", "Of", "As", "With", "Where", "When", "Why"), (
                f"{path.name}: {name} begins with '{first}'"
            )


@pytest.mark.parametrize(
    ("named", "places", "folder"),
    [("REAL_TIME", ("REAL_TIME",), "tests/"), ("WHOLE_RUNS", ("SHARED_RUNS", "LONG_RUNS"), "")],
)
def test_tests_that_are_run_by_themselves_are_those_that_are_marked(named, places, folder):
    """One that is marked elsewhere would be run by nobody."""
    (line,) = [
        line
        for line in (ROOT / "Makefile").read_text().splitlines()
        if line.startswith(f"{named} :=")
    ]
    conftest = ast.parse((ROOT / "tests" / "conftest.py").read_text())
    found = [
        name
        for node in conftest.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in places
        for name in ast.literal_eval(node.value)
    ]
    assert set(line.split()[2:]) == {f"{folder}{name}" for name in found}
    marked = {path for path in (ROOT / "tests").rglob("*.py") if MARK in path.read_text()}
    assert marked == {ROOT / "tests" / "conftest.py"}
