"""`make test` and `make test-hard` in a small tree: what runs, and what the last lines say."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FIRST = """
import os  # which ruff refuses
import pytest

@pytest.mark.parametrize("said", ["it's so", "no"])
def test_one_of_two(said):
    assert said == "no"

class TestTogether:
    def test_inside(self):
        pytest.skip("here")

@pytest.fixture
def broken_in_the_end():
    yield
    raise ValueError("too late")

def test_end(broken_in_the_end):
    pass
"""
LAST = """
import pytest

@getattr(pytest.mark, "real_time")
def test_later():
    pass
"""


@pytest.fixture
def run(tmp_path):
    """run(*settings, **files): exit code and lines of `make test` in a tree with some tests."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "tests").mkdir()
    for name in ("run.py", "hard.py"):
        shutil.copy(ROOT / "tests" / name, tmp_path / "tests")
    (tmp_path / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['real_time', 'slow', 'whole_run']\n"
        "addopts = ['--import-mode=importlib', '-q', '-m', 'not slow']\ntestpaths = ['tests']\n"
    )
    # As where `make setup` was called: with the programs of this environment.
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    os.utime(tmp_path / "pyproject.toml", (0, 0))
    (tmp_path / ".venv" / ".installed").touch()
    ours = ("MAKE", "MFLAGS", "PYTEST", "ARGS")
    environment = {key: value for key, value in os.environ.items() if not key.startswith(ours)}

    def make(*settings, phases="lint together,clocked", target="test", **files):
        for name, text in files.items():
            (tmp_path / "tests" / f"test_{name}.py").write_text(text)
        ours = "REAL_TIME=tests", "BESIDE=", "TOGETHER=$(PYTEST) -n 1"
        command = ["make", target, f"PHASES={phases}", *ours, *settings]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        return done.returncode, done.stdout.splitlines()

    return make


def test_later_phases_run_and_the_last_lines_repeat_what_failed(run, tmp_path):
    code, lines = run(first=FIRST, last=LAST)
    assert code != 0
    longest = lines.index("The longest tests [s]:")
    assert (
        len([line for line in lines[longest + 1 :] if re.match(r" +\d+\.\d  tests/", line)]) == 5
    )
    start = next(i for i, line in enumerate(lines) if line.startswith("phase "))
    lint, together, clocked, total = (line.split() for line in lines[start + 1 : start + 5])
    assert lint[:2] == ["lint", "FAILED"]
    assert together[:5] == ["together", "FAILED", "2", "1", "1"]
    assert clocked[:5] == ["clocked", "ok", "0", "1", "0"]
    assert total[:7] == ["2", "failed,", "2", "passed,", "1", "skipped", "in"]
    lint, command, *others = lines[start + 5 :]
    assert lint.startswith("FAILED lint (exit code ")
    assert command == "  make lint"
    one_of_two = """.venv/bin/pytest 'tests/test_first.py::test_one_of_two[it'"'"'s so]'"""
    assert others == [
        "FAILED tests/test_first.py::test_end",
        "  .venv/bin/pytest tests/test_first.py::test_end",
        "FAILED tests/test_first.py::test_one_of_two[it's so]",
        f"  {one_of_two}",
    ]
    assert any(re.match(r"1 failed, 2 passed, 1 skipped, .*1 error in", line) for line in lines)
    told = (tmp_path / "build" / "tests" / "durations.tsv").read_text().splitlines()
    assert len(told) == 5
    assert {line.split("\t")[1] for line in told} >= {
        "tests/test_first.py::TestTogether::test_inside",
        "tests/test_last.py::test_later",
    }
    # The command that is shown runs that test, and only that one.
    again = subprocess.run(
        one_of_two, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert again.stdout.splitlines()[-1].startswith("1 failed in ")


def test_a_file_that_cannot_be_imported_is_one_failure_of_its_phase(run):
    code, lines = run(phases="together clocked", broken="import no_such_module\n", last=LAST)
    assert code != 0
    assert lines[-2:] == ["FAILED tests/test_broken.py", "  .venv/bin/pytest tests/test_broken.py"]
    assert sum(line.split()[:2] == ["clocked", "FAILED"] for line in lines) == 1


def test_arguments_select_tests_and_phases_without_any_are_no_failure(run):
    settings = "ARGS=tests/test_first.py -k no"
    code, lines = run(settings, phases="together clocked", first=FIRST, last=LAST)
    assert code == 0, lines
    assert lines[-1].startswith("1 passed in 0 min ")


ORDERED = """
import os

def test_order():
    assert "random" not in os.environ.get("PYTEST_ADDOPTS", "")
"""


def test_each_condition_has_its_row_and_what_failed_is_named(run, tmp_path):
    settings = "CONDITIONS=background random-1", "ARGS=tests/test_order.py"
    code, lines = run(*settings, target="test-hard", order=ORDERED)
    assert code != 0
    rows = {line.split()[0]: line.split()[1:] for line in lines[-4:-2]}
    assert rows["background"][:3] == ["0", "1", "0"]
    assert rows["background"][-1] == "ok"
    assert rows["random-1"][:3] == ["1", "0", "0"]
    assert rows["random-1"][-1] == "FAILED"
    assert lines[-2:] == [
        "FAILED random-1: see build/hard/random-1.txt",
        "  tests/test_order.py::test_order",
    ]
    assert "1 failed in" in (tmp_path / "build" / "hard" / "random-1.txt").read_text()


def test_a_condition_that_is_not_permitted_is_skipped_with_its_reason(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path / "none"))  # without taskset
    command = [sys.executable, str(ROOT / "tests" / "hard.py"), "one-core"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    name, reason = done.stdout.splitlines()[-1].split(maxsplit=1)
    assert (name, reason) == ("one-core", "skipped: there is no taskset")
