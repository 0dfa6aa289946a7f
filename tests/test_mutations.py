"""The single changes of the code with which `python -m benchmarks mutants` asks the tests."""

import ast
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[1]
_SOURCE = '''
"""A docstring with 3 numbers."""

LENGTH: float = 2.5


def value(a, b, scale=0.0):
    if not a < b and scale == 1.0:
        raise ValueError("more than 3", 7)
    total = -a + b * scale
    for i in range(3):
        total += table[i][1] - other(a, b)
    return value(total[1:], b, scale=4.0), f"{3}"


def __repr__(self):
    return 5 * "x"
'''


@pytest.fixture(scope="module")
def mutations():
    path = _ROOT / "benchmarks" / "mutations.py"
    spec = importlib.util.spec_from_file_location("mutations_of_the_benchmarks", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    yield spec.loader.exec_module(module) or module
    del sys.modules[spec.name]


@pytest.fixture
def changes(mutations, tmp_path):
    """Lines that a small file admits instead of its own, by the kind of change."""
    (tmp_path / "small.py").write_text(_SOURCE)
    found = {}
    for mutant in mutations.list_mutants(tmp_path, ["small.py"]):
        line = mutant.applied(_SOURCE).splitlines()[mutant.line - 1].strip()
        found.setdefault(mutant.kind, set()).add(line)
    return found


def test_every_kind_of_change_is_found_where_it_can_be_made(changes):
    assert changes == {
        "sign": {
            "total = a + b * scale",
            "total = -a - b * scale",
            "total -= table[i][1] - other(a, b)",
            "total += table[i][1] + other(a, b)",
        },
        "factor": {
            "LENGTH: float = 5.0",
            "def value(a, b, scale=1):",
            "if not a < b and scale == 2.0:",
            "total = -a + b / scale",
            'return value(total[1:], b, scale=8.0), f"{3}"',
        },
        "index": {"total += table[i][2] - other(a, b)"},
        "off by one": {"for i in range(4):", 'return value(total[2:], b, scale=4.0), f"{3}"'},
        "comparison": {
            "if not a <= b and scale == 1.0:",
            "if not a > b and scale == 1.0:",
            "if not a < b and scale != 1.0:",
        },
        "boolean": {"if a < b and scale == 1.0:", "if not a < b or scale == 1.0:"},
        "dropped argument": {'return value(total[1:], b), f"{3}"'},
        "swapped arguments": {"total += table[i][1] - other(b, a)"},
    }


def test_a_seed_draws_the_same_changes_of_every_folder_and_all_are_programs(mutations):
    mutants = mutations.list_mutants(
        _ROOT, ["systems/core", "systems/sensors", "diagrams/drivers"]
    )
    drawn, again, other = (mutations.draw(mutants, 40, seed, _ROOT) for seed in (3, 3, 4))
    assert drawn == again != other
    assert {Path(m.path).parent for m in drawn} == {Path(m.path).parent for m in mutants}
    for mutant in drawn:
        source = (_ROOT / mutant.path).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(mutant.applied(source))) != ast.dump(ast.parse(source))


_TRIED_IN_A_COPY = """
import sys
from pathlib import Path

from benchmarks.mutants import _Copy
from benchmarks.mutations import list_mutants

test = "tests/systems/core/test_units.py::test_people_read_millimetres_and_degrees"
mutants = list_mutants(Path.cwd(), ["systems/core/units.py"])
mutant = next(mutant for mutant in mutants if mutant.before.startswith('"rad": ("deg"'))
copy = _Copy(Path(sys.argv[1]))
with copy.changed(mutant):
    print(*copy.run_tests([test]))
print(*copy.run_tests([test]))
"""


def test_tests_of_a_copy_see_what_is_changed_there_and_nothing_once_it_is_taken_back(tmp_path):
    if not (_ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("which files are the tree's is asked of git, and here is no repository")
    program = [sys.executable, "-c", _TRIED_IN_A_COPY, tmp_path]
    done = subprocess.run(program, cwd=_ROOT, capture_output=True, text=True, check=True)
    failed = "tests/systems/core/test_units.py::test_people_read_millimetres_and_degrees"
    assert done.stdout.splitlines() == [f"1 {failed}", "0 "]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["packages", "plan.json", "tree"]
