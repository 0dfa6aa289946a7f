"""`python -m benchmarks mutants`: do the tests notice single changes of the code?

Draws a sample of the changes of `mutations.py`, makes each of them in a copy of the tree, and runs
there the tests that execute the changed line, those that import the changed file first, up to the
first that fails.

The copy's packages stand before the installed ones on PYTHONPATH. The lines that each test
executes are recorded once, by `sys.monitoring`, and kept in build/ for as long as the tree is the
same. A line that is executed only once, at import or in a cached function, is seen by the tests
that execute a line with a name that it defines. What a fixture or the tests of one file share is
attributed to all of these tests.
"""

import argparse
import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from benchmarks.executed_lines import PLAN, Tests
from benchmarks.mutations import Mutant, draw, list_mutants

_ROOT = Path(__file__).resolve().parents[1]
_LIMIT = 60.0  # for the tests of one mutant, three times what is chosen; beyond, it hangs [s]
# Files on which it depends what tests execute.
_SEEN = {".jinja", ".obj", ".py", ".sdf", ".toml", ".urdf", ".xml", ".yaml"}
_KILLED = ("killed", "timeout")


class _Copy:
    """A copy of the tree, whose packages are imported in place of the installed ones."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.packages = folder / "tree", folder / "packages"
        for name in _files():
            target = self.tree / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(_ROOT / name, target)
        settings = tomllib.loads((_ROOT / "pyproject.toml").read_text())
        rooms = settings["tool"]["setuptools"]["package-dir"]
        for package, room in sorted(rooms.items()):
            link = self.packages / package.replace(".", "/")
            if any(other.startswith(f"{package}.") for other in rooms):
                # Its rooms follow, and may lie in the same folder.
                link.mkdir(parents=True)
                for file in (self.tree / room).glob("*.py"):
                    (link / file.name).symlink_to(file)
            else:
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(self.tree / room)
        self._plan, self._out = folder / "plan.json", folder / "out"

    def pytest(
        self, plan: dict[str, Any], arguments: Sequence[str], limit: float | None
    ) -> tuple[int | None, str]:
        """Runs pytest in the copy: its exit code, None after a time limit, and what it left."""
        self._out.unlink(missing_ok=True)
        self._plan.write_text(json.dumps(plan | {"out": str(self._out)}))
        environment = os.environ | {
            "PYTHONPATH": str(self.packages),
            "PYTHONDONTWRITEBYTECODE": "1" if "tests" in plan else "",
            PLAN: str(self._plan),
        }
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "benchmarks.executed_lines",
            "-q",
            "--no-header",
        ]
        process = subprocess.Popen(
            [*command, "-p", "no:cacheprovider", "--tb=no", *arguments],
            cwd=self.tree,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            code: int | None = process.wait(limit)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            self._end_all(process.pid)
            process.wait()
        return code, self._out.read_text() if self._out.exists() else ""

    def run_tests(self, tests: Sequence[str]) -> tuple[int | None, str]:
        """Runs some tests up to the first that fails: the exit code, and that test."""
        files = dict.fromkeys(name.partition("::")[0] for name in tests)
        return self.pytest({"tests": list(tests)}, ["-x", *files], _LIMIT)

    def _end_all(self, group: int) -> None:
        """Kills a test run and whatever it has left, in sessions of their own too.

        Those are known by the plan in their environment, where there is a /proc.
        """
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)
        mark = f"{PLAN}={self._plan}".encode()
        for environment in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                if mark in environment.read_bytes().split(b"\0"):
                    os.kill(int(environment.parent.name), signal.SIGKILL)

    @contextlib.contextmanager
    def changed(self, mutant: Mutant) -> Iterator[None]:
        """Makes a change while it is used; no byte code of the file as it was is left."""
        path = self.tree / mutant.path
        source = path.read_text(encoding="utf-8")
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()
        path.write_text(mutant.applied(source), encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(source, encoding="utf-8")


def _files() -> list[str]:
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, check=True)
    return sorted(name for name in listed.stdout.split("\0") if name and (_ROOT / name).is_file())


@dataclass(frozen=True)
class Outcome:
    """Fate of a mutant.

    Attributes:
        mutant: the change.
        verdict: killed; timeout, which is killed too; survived; not covered; too slow, where the
            tests hang without the change as well.
        by: the test that failed.
        tests: number of tests that were chosen.
        of: number of tests that execute the line.
        seconds: duration of the run [s].
    """

    mutant: Mutant
    verdict: str
    by: str = ""
    tests: int = 0
    of: int = 0
    seconds: float = 0.0


def _record(copy: _Copy, console: Console) -> dict[str, Any]:
    """Which test executes which lines: as kept, or recorded by a run of all tests."""
    digest = hashlib.sha256()
    for name in _files():
        if PurePosixPath(name).suffix in _SEEN and not name.startswith("benchmarks/"):
            digest.update(name.encode() + (_ROOT / name).read_bytes())
    record_path = _ROOT / "build" / "mutants" / f"{digest.hexdigest()[:16]}.json"
    if not record_path.exists():
        console.print("recording the lines that each test executes: one run of all tests")
        began = time.monotonic()
        code, text = copy.pytest({"root": str(copy.packages / "parapod")}, (), None)
        if not text:
            raise SystemExit(f"the tests cannot be recorded: pytest ended with {code}")
        console.print(f"recorded in {time.monotonic() - began:.0f} s")
        record_path.parent.mkdir(parents=True, exist_ok=True)
        record_path.write_text(text)
    record: dict[str, Any] = json.loads(record_path.read_text())
    return record


def _try(mutant: Mutant, tests: Tests, copy: _Copy) -> Outcome:
    """Runs the tests of a mutant.

    A test that fails alone without the change is left out for good. Where the tests take too long
    without it as well, a quarter of them has to do.
    """
    began, part = time.monotonic(), 1.0
    while True:
        chosen, count = tests.tests_for(mutant)
        if not chosen:
            return Outcome(mutant, "not covered")
        chosen = chosen[: max(1, int(part * len(chosen)))]
        with copy.changed(mutant):
            code, by = copy.run_tests(chosen)
        is_slow = code is None and copy.run_tests(chosen)[0] is None
        if is_slow and len(chosen) > 1:
            part /= 4.0
        elif not by or tests.is_trusted(by, lambda test: copy.run_tests([test])[0] == 0):
            break
    verdict = {None: "timeout", 0: "survived"}.get(code, "killed")
    if is_slow:
        verdict = "too slow"
    if verdict == "killed" and not by:
        by = f"pytest ended with {code}"
    return Outcome(mutant, verdict, by, len(chosen), count, time.monotonic() - began)


def shares(outcomes: Sequence[Outcome]) -> dict[str, tuple[int, int]]:
    """Killed and all mutants by folder, and in total."""
    tallies: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for outcome in outcomes:
        for key in (str(PurePosixPath(outcome.mutant.path).parent), "total"):
            tallies[key][0] += outcome.verdict in _KILLED
            tallies[key][1] += 1
    return {key: (killed, count) for key, (killed, count) in sorted(tallies.items())}


def _print(outcomes: Sequence[Outcome], console: Console) -> None:
    table = Table(title="mutants", title_justify="left", title_style="bold")
    for heading in ("mutant", "verdict", "by, or tests that were run"):
        table.add_column(heading, overflow="fold")
    for outcome in outcomes:
        by = outcome.by or f"{outcome.tests} of {outcome.of}"
        style = "" if outcome.verdict in _KILLED else "bold red"
        table.add_row(escape(str(outcome.mutant)), Text(outcome.verdict, style), escape(by))
    console.print(table)
    table = Table(title="killed", title_justify="left", title_style="bold")
    table.add_column("folder")
    for heading in ("killed", "of", "share"):
        table.add_column(heading, justify="right")
    for folder, (killed, count) in shares(outcomes).items():
        table.add_row(folder, str(killed), str(count), f"{100.0 * killed / count:.0f} %")
    console.print(table)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks mutants")
    parser.add_argument("paths", nargs="*", default=["systems", "diagrams"])
    parser.add_argument("--count", type=int, default=150, help="mutants that are drawn")
    parser.add_argument("--seed", type=int, default=0, help="the same seed draws the same ones")
    parser.add_argument("--list", action="store_true", help="show them and end")
    parser.add_argument("--json", type=Path, help="file for the outcomes")
    return parser


def main(arguments: Sequence[str]) -> int:
    options = _parser().parse_args(arguments)
    missing = [path for path in options.paths if not (_ROOT / path).exists()]
    if missing:
        print(f"there is no '{missing[0]}' in {_ROOT}")
        return 2
    console = Console()
    mutants = draw(list_mutants(_ROOT, options.paths), options.count, options.seed, _ROOT)
    if options.list:
        for mutant in mutants:
            print(f"{mutant.kind:18} {mutant}")
        return 0
    # What is begun is ended and removed in both cases, and what is known is shown.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    outcomes: list[Outcome] = []
    with contextlib.suppress(KeyboardInterrupt):
        _run(mutants, outcomes, options.json, console)
    _print(outcomes, console)
    return 0 if len(outcomes) == len(mutants) else 130


def _run(
    mutants: Sequence[Mutant], outcomes: list[Outcome], report: Path | None, console: Console
) -> None:
    """Tries mutants one by one, and adds what became of them."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = _Copy(Path(folder))
        tests = Tests(_record(copy, console), copy.tree)
        for number, mutant in enumerate(mutants, 1):
            outcome = _try(mutant, tests, copy)
            outcomes.append(outcome)
            line = (
                f"{number}/{len(mutants)} {outcome.verdict:11} {outcome.seconds:5.1f} s  {mutant}"
            )
            console.print(line, highlight=False, markup=False, soft_wrap=True)
            if report:
                _write(outcomes, report)


def _write(outcomes: Sequence[Outcome], path: Path) -> None:
    report = {"mutants": [asdict(outcome) for outcome in outcomes], "killed": shares(outcomes)}
    path.write_text(json.dumps(report, indent=1), encoding="utf-8")
