"""Who may import whom: arrows between the rooms point one way."""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MARK = "mark." + "real_time"
ROOMS = ("systems", "diagrams", "sims", "urdf", "benchmarks", "examples")
# By rooms, what their modules import neither as a whole nor in part.
FORBIDDEN = {
    ("systems",): ("parapod.diagrams", "parapod.sims"),
    ("diagrams", "urdf"): ("parapod.sims",),
    ("systems", "diagrams", "sims", "urdf", "benchmarks", "tests"): (
        *("pydrake.all", "systems", "diagrams", "sims", "urdf"),
    ),
}


@cache
def told(path):
    """Names that a module imports, and first words of docstrings by what they are of."""
    names, words = set(), []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            text = ast.get_docstring(node, clean=False) or "None"
            words.append((getattr(node, "name", "the module"), text.split()[0]))
    return names, words


@pytest.mark.parametrize(("rooms", "forbidden"), FORBIDDEN.items())
def test_rooms_import_what_is_below_them(rooms, forbidden):
    sources = [path for room in rooms for path in sorted((ROOT / room).rglob("*.py"))]
    assert len(sources) > 5 * len(rooms)
    for path in sources:
        for name in told(path)[0]:
            assert not f"{name}.".startswith(tuple(f"{prefix}." for prefix in forbidden)), path


def test_docstrings_begin_with_an_imperative_or_a_noun():
    for path in (p for room in ROOMS for p in (ROOT / room).rglob("*.py")):
        for name, first in told(path)[1]:
            assert first not in ("What", "How", "Of", "As", "With", "Where", "When", "Why"), (
                f"{path.name}: {name} begins with '{first}'"
            )


@pytest.mark.parametrize(
    ("named", "places", "folder"),
    [("REAL_TIME", "REAL_TIME", "tests/"), ("WHOLE_RUNS", "SHARED_RUNS", "")],
)
def test_tests_that_are_run_by_themselves_are_those_that_are_marked(named, places, folder):
    """One that is marked elsewhere would be run by nobody."""
    (line,) = [
        line
        for line in (ROOT / "Makefile").read_text().splitlines()
        if line.startswith(f"{named} :=")
    ]
    conftest = ast.parse((ROOT / "tests" / "conftest.py").read_text())
    (found,) = [
        ast.literal_eval(node.value)
        for node in conftest.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == places
    ]
    assert set(line.split()[2:]) == {f"{folder}{name}" for name in found}
    marked = {path for path in (ROOT / "tests").rglob("*.py") if MARK in path.read_text()}
    assert marked == {ROOT / "tests" / "conftest.py"}
