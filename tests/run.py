"""Run all phases of the tests, whatever one of them finds, and show one summary at the end.

`make test` calls `python tests/run.py lint together clocked,whole-runs,types`: targets of the
Makefile, one stage after the other, those of a stage beside each other. Each phase with tests
leaves its report in `build/tests/PHASE.xml`; the durations of all tests, the longest first, come
to `build/tests/durations.tsv`. The exit code is 1 if a phase failed, else 0.
"""

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

REPORTS = Path("build/tests")
LONGEST = 20  # tests that are told with their durations
OUTCOMES = ("failed", "passed", "skipped")
_KINDS = {"failure": "failed", "error": "failed", "skipped": "skipped"}


@dataclass(frozen=True)
class Phase:
    """One target of the Makefile, as it ended.

    Attributes:
        name: the target.
        code: its exit code.
        took: duration [s].
        tests: outcome and duration [s] of each test by its node id; None without a report.
    """

    name: str
    code: int
    took: float
    tests: dict[str, tuple[str, float]] | None

    @property
    def counts(self):
        """Number of tests by outcome."""
        return Counter(outcome for outcome, _ in (self.tests or {}).values())

    @property
    def repeats(self):
        """What failed, each with the command that repeats it alone."""
        outcomes = sorted((self.tests or {}).items())
        failed = [name for name, (outcome, _) in outcomes if outcome == "failed"]
        slow = " -m slow" if self.name == "slow" else ""
        found = [(name, f".venv/bin/pytest{slow} {shlex.quote(name)}") for name in failed]
        if not found and self.code:
            found = [(f"{self.name} (exit code {self.code})", f"make {self.name}")]
        return found


def _node_id(case):
    """The name by which pytest selects a test of a report."""
    file, place, name = case.get("file"), case.get("classname"), case.get("name")
    if not file or not place:  # a process of the tests that died, or a file that is none in Python
        return file or name
    classes = place.removeprefix(file.removesuffix(".py").replace("/", ".")).strip(".")
    return "::".join((file, *filter(None, classes.split(".")), name))


def read_report(path):
    """Outcome and duration [s] of each test of a report by its node id; None if there is none."""
    if not path.is_file():
        return None
    tests = {}
    for case in ElementTree.parse(path).iter("testcase"):
        name = _node_id(case)
        outcome = next((_KINDS[part.tag] for part in case if part.tag in _KINDS), "passed")
        before, took = tests.get(name, (outcome, 0.0))
        worst = min(before, outcome, key=OUTCOMES.index)  # it may fail, and its end once more
        tests[name] = (worst, took + float(case.get("time", 0.0)))
    return tests


def _run_stage(names):
    """Run phases beside each other: the first one is shown at once, the others as they ended."""
    running, ended, begun = {}, {}, time.monotonic()
    with ExitStack() as stack:
        for name in names:
            (REPORTS / f"{name}.xml").unlink(missing_ok=True)
            said = stack.enter_context(tempfile.TemporaryFile("w+")) if running else None
            command = [os.environ.get("MAKE", "make"), "--no-print-directory", name]
            process = subprocess.Popen(command, stdout=said, stderr=said and subprocess.STDOUT)
            running[name] = process, said
        while len(ended) < len(running):
            for name in running.keys() - ended.keys():
                if running[name][0].poll() is not None:
                    ended[name] = time.monotonic() - begun
            time.sleep(0.05)
        for name, (process, said) in running.items():
            if said is not None:
                said.seek(0)
                print(f"\n== {name}\n{said.read()}", end="", flush=True)
            tests = read_report(REPORTS / f"{name}.xml")
            yield Phase(name, process.returncode, ended[name], tests)


def summarize(phases, took):
    """Lines of the summary; the last ones name what failed, and how to repeat it.

    Args:
        phases: the phases, as they ended.
        took: duration of all of them [s].
    """
    tests = {name: test[1] for phase in phases for name, test in (phase.tests or {}).items()}
    longest = sorted(tests.items(), key=lambda pair: -pair[1])[:LONGEST]
    if longest:
        yield "The longest tests [s]:"
        yield from (f"{duration:>8.1f}  {name}" for name, duration in longest)
        yield ""
    yield f"{'phase':<12}{'':>8}{'failed':>8}{'passed':>8}{'skipped':>8}{'time':>8}"
    for phase in phases:
        counts = phase.counts
        numbers = [counts[name] if phase.tests is not None else "" for name in OUTCOMES]
        state = "FAILED" if phase.code else "ok"
        columns = "".join(f"{number:>8}" for number in numbers)
        yield f"{phase.name:<12}{state:>8}{columns}{phase.took:>6.0f} s"
    total = sum((phase.counts for phase in phases), Counter())
    told = ", ".join(f"{total[name]} {name}" for name in OUTCOMES if total[name])
    minutes = f"{took // 60:.0f} min {took % 60:.0f} s"
    yield f"{told or 'no tests'} in {minutes}; durations are in {REPORTS / 'durations.tsv'}"
    for what, command in dict(pair for phase in phases for pair in phase.repeats).items():
        yield f"FAILED {what}"
        yield f"  {command}"


def main(stages):
    """Run stages of phases, each a text with commas; returns the exit code."""
    REPORTS.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    phases = [phase for stage in stages for phase in _run_stage(stage.split(","))]
    durations = {name: test[1] for phase in phases for name, test in (phase.tests or {}).items()}
    longest = sorted(durations.items(), key=lambda pair: -pair[1])
    lines = [f"{took:.3f}\t{name}\n" for name, took in longest]
    (REPORTS / "durations.tsv").write_text("".join(lines), encoding="utf-8")
    print("\n" + "\n".join(summarize(phases, time.monotonic() - begun)), flush=True)
    return int(any(phase.code for phase in phases))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
