import os

# One thread each: the linear algebra of a test is small, and waits for its turn on other cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# What programs print must not depend on how long they take.
os.environ["PARAPOD_PROGRESS"] = "off"

import gc
import importlib
import io
import itertools
import re
import signal
import sys
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from rich.console import Console

from tests.network import enter_own_network

# Where programs beside each other are judged by the clock; elsewhere single tests are, by `judge`.
REAL_TIME = ("diagrams/test_hardware_station.py", "sims/real_machine")
# Where tests share whole runs of experiments, which one process a machine therefore makes; and
# where alone the Makefile seeks them.
SHARED_RUNS = (
    "tests/laws/test_chapters.py",
    "tests/laws/test_experiments.py",
    "tests/sims/levelling_platform",
    "tests/sims/machining_centre",
    "tests/sims/terrain_simulator",
    "tests/sims/walking_chair",
)
# Where tests compute for seconds each: they fill the cores while others wait for a clock.
LONG_RUNS = ("tests/sims/study", "tests/test_notebooks.py", "tests/your_own")


_REAL_TIME = tuple(f"tests/{name}{'::' if name.endswith('.py') else '/'}" for name in REAL_TIME)
# Machines beside the platform, by what the names of their tests hold.
OTHERS = {"the chair": "chair", "the centres": "centre|centres", "the bench": "bench-|terrain"}


def pytest_configure(config):
    """Has this process, and those that it begins, in a network of their own where it may."""
    if not hasattr(config, "workerinput"):
        config.own_network_refused = enter_own_network()


def pytest_report_header(config):
    """Says in which network messages to groups go."""
    why = config.own_network_refused
    return f"network: {why or 'a loopback of their own'}"


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keeps the garbage collector away while modules are imported and tests are made."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_itemcollected(item):
    """Marks tests by what they need."""
    # Names are compared as texts: paths of seven thousand tests would take half a second.
    if item.nodeid.startswith(_REAL_TIME) or "judge" in item.fixturenames:
        item.add_marker(pytest.mark.real_time)
    if {"execute", "finished"} & set(item.fixturenames):
        if not item.nodeid.startswith(SHARED_RUNS):
            raise pytest.UsageError(f"{item.nodeid}: whole runs are sought in SHARED_RUNS only")
        item.add_marker(pytest.mark.whole_run)
    elif item.nodeid.startswith(LONG_RUNS):
        item.add_marker(pytest.mark.whole_run)


def pytest_collection_finish():
    """Keeps what all tests need, modules and the tests themselves, from the garbage collector.

    A process holds half a million objects by now, through which it would go a hundred times. What
    the tests make it looks through less often than usual.
    """
    gc.set_threshold(20_000, 20, 50)
    gc.collect()
    gc.freeze()


_FILES = itertools.count(1)  # of which all tests have been run
_FREEZE_EVERY = 10  # files; what they leave is what they have imported, caches and reports


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    """Keeps from the garbage collector what some files' tests have left for good."""
    result = yield
    is_last = nextitem is None or nextitem.path != item.path
    if is_last and next(_FILES) % _FREEZE_EVERY == 0:
        gc.collect()
        gc.freeze()
    return result


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Gives each process files, and all that share a machine's runs to the same one.

    The groups of xdist itself would stand in the names of the tests.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            if nodeid.startswith(SHARED_RUNS):
                found = [machine for machine, words in OTHERS.items() if re.search(words, nodeid)]
                return f"runs of {found[0] if found else 'the platform'}"
            return nodeid.split("::")[0]

    return Scheduling(config, log)


@dataclass(frozen=True)
class Finished:
    """A run of an experiment, and the files that it left.

    Attributes:
        experiment: the experiment.
        scenario: what it ran.
        result: what came out.
        log: its log; None if it has none.
        log_file: file of the log, or None.
        diagram: its diagram in Graphviz's language; None if it has none.
        said: what it printed on its console.
        elapsed: wall-clock time [s].
    """

    experiment: Any
    scenario: Any
    result: Any
    log: Any
    log_file: Path | None
    diagram: str | None
    said: str
    elapsed: float

    @property
    def values(self):
        """Metrics by key."""
        return {metric.key: metric.value for metric in self.result.metrics}


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """finished(part): a part of the report with its quick overrides, run once for all tests."""
    from parapod.sims.lab.discovery import find_entry
    from parapod.sims.output.logs.files import read_log
    from parapod.sims.output.options import RunOptions
    from parapod.sims.report.run import list_chapters
    from parapod.systems.core.scenario_file import load_scenario

    parts = {part.name: part for chapter in list_chapters() for part in chapter.parts}
    folder = tmp_path_factory.mktemp("finished")

    @cache
    def run(name):
        part = parts[name]
        entry = find_entry(part.experiment)
        experiment = entry.load()
        overrides = [*part.overrides, *part.quick]
        scenario = load_scenario(experiment.schema, entry.default_scenario, None, overrides)
        log = folder / f"{name}.npz" if hasattr(experiment, "logged") else None
        graphviz = folder / f"{name}.dot" if hasattr(experiment, "loop") else None
        # As wide as a terminal, but none: progress is no bar.
        console = Console(file=io.StringIO(), width=100)
        began = time.monotonic()
        result = experiment.execute(
            scenario, RunOptions(log=log, graphviz=graphviz, console=console)
        )
        return Finished(
            experiment,
            scenario,
            result,
            read_log(log) if log is not None else None,
            log,
            graphviz.read_text() if graphviz is not None else None,
            console.file.getvalue(),
            time.monotonic() - began,
        )

    return run


@pytest.fixture(scope="session")
def finished_chapter(finished):
    """finished_chapter(chapter): a quick report of it, made of the runs that all tests share."""
    from parapod.sims.report import run as report

    @cache
    def run(chapter):
        def shared(part, *options):
            result = finished(part.name)
            return report.PartRun(part, result.result, (), result.elapsed)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(report, "_run_part", shared)
            return report.run_chapter(chapter, True, 0, Console(quiet=True))

    return lambda chapter: run(chapter)


@pytest.fixture(scope="session")
def execute():
    """execute(name, *overrides, **options): result of an experiment; options of `RunOptions`."""
    from parapod.sims.lab.discovery import find_entry
    from parapod.sims.output.options import RunOptions
    from parapod.systems.core.scenario_file import load_scenario

    def run(name, *overrides, **options):
        entry = find_entry(name)
        experiment = entry.load()
        scenario = load_scenario(experiment.schema, entry.default_scenario, None, overrides)
        quiet = {"console": Console(file=io.StringIO())}
        return experiment.execute(scenario, RunOptions(**(quiet | options)))

    return run


@pytest.fixture
def install(tmp_path, monkeypatch):
    """install(package, points, files): as `pip` would, in a folder on sys.path."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    before = set(sys.modules)

    def add(package, points, files):
        for name, text in files.items():
            path = site / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        info = site / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(points)

    yield add
    for name in set(sys.modules) - before:
        if str(site) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture
def pendula(install):
    """A package with one experiment, `swing`, and its default scenario; the class."""
    folder = Path(__file__).with_name("pendula")
    files = {
        f"pendula/{path.name}": path.read_text() for path in folder.iterdir() if path.is_file()
    }
    install("pendula", "[parapod.experiments]\nswing = pendula.swing:Swing\n", files)
    return importlib.import_module("pendula.swing").Swing


@pytest.fixture
def work(tmp_path, monkeypatch):
    """An empty folder, in which one works."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@contextmanager
def standing_still(pid):
    """A child process does nothing meanwhile; a signal alone would let it go on for a moment."""
    os.kill(pid, signal.SIGSTOP)
    try:
        os.waitpid(pid, os.WUNTRACED)
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


@pytest.fixture
def click_after(monkeypatch):
    """click_after(live, button, seconds): once it has gone on for so long, in its own time."""

    def prepare(live, button, seconds):
        advance, end = live.advance, live.simulator.get_context().get_time() + seconds

        def advance_and_click():
            advance()
            if live.simulator.get_context().get_time() >= end - 1e-9:
                live.panel._obey({"button": button})

        monkeypatch.setattr(live, "advance", advance_and_click)

    return prepare


class Stand:
    """A system alone: a test sets its inputs, steps its updates and reads its outputs.

    Attributes:
        system: the system.
        context: its context.
        period: of its updates [s]; 0 without any.
    """

    def __init__(self, system, **inputs):
        self.system, self.context = system, system.CreateDefaultContext()
        event = system.GetUniquePeriodicDiscreteUpdateAttribute()
        self.period, self._updates = event.period_sec() if event else 0.0, 0
        assert event is None or event.offset_sec() == 0.0
        self.set(**inputs)

    def set(self, **inputs):
        """Fixes inputs by name, a number where one is enough."""
        for name, value in inputs.items():
            value = value if np.ndim(value) else (float(value),)
            self.system.GetInputPort(name).FixValue(self.context, value)
        return self

    def tick(self, times=1, **inputs):
        """Sets inputs, updates the state and lets a period pass, as often as told."""
        self.set(**inputs)
        for _ in range(times):
            self._update()
        return self

    def wait(self, seconds, **inputs):
        """Ticks as often as there are periods in a time."""
        return self.tick(round(seconds / self.period), **inputs)

    def run(self, until):
        """Goes to a time with all updates before it; one at that time is still to come."""
        while self.period and self._updates * self.period < until - 1e-12:
            self._update()
        self.context.SetTime(until)
        return self

    def _update(self):
        self.context.SetTime(self._updates * self.period)
        self.context.SetDiscreteState(self.system.EvalUniquePeriodicDiscreteUpdate(self.context))
        self._updates += 1
        self.context.SetTime(self._updates * self.period)

    def __getitem__(self, name):
        """The value of an output now."""
        return self.system.GetOutputPort(name).Eval(self.context).copy()


@pytest.fixture(scope="session")
def stand():
    """stand(system, **inputs): see `Stand`; tests with more words derive their own class."""
    return Stand


def _fix(system, context, **inputs):
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)


def _read(system, context):
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return {port.get_name(): np.array(port.Eval(context)) for port in ports}


@pytest.fixture
def fix():
    """fix(system, context, **inputs) sets input ports by name."""
    return _fix


@pytest.fixture
def read():
    """read(system, context) gives the values of all output ports by name."""
    return _read


@pytest.fixture
def moved():
    """moved(system, context, change) names the outputs that calling `change` moves."""

    def names(system, context, change):
        before = _read(system, context)
        change()
        after = _read(system, context)
        return {name for name in before if not np.array_equal(before[name], after[name])}

    return names


@pytest.fixture
def assert_gradient_agrees():
    """Compares AutoDiffXd of `evaluate(system, x)` at x with central differences of floats."""

    def check(system, evaluate, x, step=1e-6, tolerance=1e-6):
        x = np.asarray(x, dtype=float)
        converted = system.ToAutoDiffXd()
        exact = ExtractGradient(evaluate(converted, InitializeAutoDiff(x).flatten()))
        columns = []
        for i in range(x.size):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += step
            behind[i] -= step
            columns.append((evaluate(system, ahead) - evaluate(system, behind)) / (2.0 * step))
        differences = np.stack(columns, axis=-1)
        scale = max(1.0, np.abs(differences).max())
        np.testing.assert_allclose(exact, differences, rtol=0.0, atol=tolerance * scale)
        assert np.abs(exact).max() > 0.0

    return check


def _waits():
    """Time for which each thread of this program has waited for a processor [s], by its name.

    Empty where the computer does not say it.
    """
    waits = {}
    for path in Path("/proc/self/task").glob("*/schedstat"):
        with suppress(OSError):  # the thread has ended
            waits[path.parent.name] = 1e-9 * int(path.read_text().split()[1])
    return waits


class Judge:
    """Measures how long something takes, and by how much the machine was late meanwhile.

    Late is a thread that wakes up later than it asked for, or waits for a processor.
    """

    TICK = 5e-3

    def __enter__(self):
        self._ended, self.late, self._waits = threading.Event(), 0.0, _waits()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        self._began = time.monotonic()
        return self

    def _watch(self):
        while not self._ended.is_set():
            before = time.monotonic()
            time.sleep(self.TICK)
            self.late += max(0.0, time.monotonic() - before - 2.0 * self.TICK)

    def __exit__(self, *_):
        self.took = time.monotonic() - self._began
        self._ended.set()
        self._thread.join()
        waited = (now - self._waits.get(name, 0.0) for name, now in _waits().items())
        self.late = max(self.late, sum(waited))

    def check(self, limit):
        """Proves that it took no longer [s], or skips with what the machine managed."""
        if self.took > limit and self.took - self.late <= limit:
            pytest.skip(f"took {self.took:.3f} s; the machine was late by {self.late:.3f} s")
        assert self.took <= limit

    def check_at_least(self, value, least):
        """Proves that a value is large enough, or skips where the machine was often late."""
        if value < least and self.late > 0.1 * self.took:
            pytest.skip(f"{value:.3g} < {least:.3g}; the machine was late by {self.late:.3f} s")
        assert value >= least


@pytest.fixture
def judge():
    """`with judge() as judged: ...` and then `judged.check(limit)`: see `Judge`."""
    return Judge


class Work:
    """Counts the functions that the thread calls: what is cheap is so on every computer.

    Attributes:
        calls: number of calls, of Python's functions and of others.
    """

    def __enter__(self):
        self.calls, self._before = 0, sys.getprofile()
        sys.setprofile(self._count)
        return self

    def _count(self, frame, event, argument):
        self.calls += event in ("call", "c_call")

    def __exit__(self, *_):
        sys.setprofile(self._before)


@pytest.fixture
def work_of():
    """`with work_of() as work: ...` and then `work.calls`: see `Work`."""
    return Work


_SUFFIXES = {"```python": ".py", "```xml": ".urdf", "```yaml": ".yaml"}


def named_blocks(text):
    """Files that a page shows: names, each named last before a block of its kind, and contents."""
    name, block = "", None
    for line in text.splitlines():
        if block is None and not line.startswith("```"):
            name = ([name, *re.findall(r"`(\w+\.(?:py|urdf|yaml))`", line)])[-1]
        elif block is None:
            block = [line]
        elif line != "```":
            block.append(line)
        else:
            kind, *content = block
            if name.endswith(_SUFFIXES.get(kind, "none")):
                yield name, "\n".join(content) + "\n"
            name, block = "", None


_ENTRY_POINTS = re.compile(r'\[project\.entry-points\."([\w.]+)"\]\n((?:[\w-]+ = .*\n)+)')


@pytest.fixture
def reader_of(tmp_path, monkeypatch):
    """reader_of(page): works in a folder with the files that a page of the documents shows.

    A block of code is the file that is named last before it. A module whose entry points the page
    shows is installed there. Returns the folder.
    """
    modules = []

    def place(page):
        text = page.read_text(encoding="utf-8")
        for name, content in named_blocks(text):
            (tmp_path / name).write_text(content, encoding="utf-8")
        points = _ENTRY_POINTS.findall(text)
        modules.extend(path.stem for path in tmp_path.glob("*.py"))
        if modules:
            info = tmp_path / "of_a_page-0.1.dist-info"
            info.mkdir()
            (info / "METADATA").write_text(
                "Metadata-Version: 2.1\nName: of-a-page\nVersion: 0.1\n"
            )
            points = _ENTRY_POINTS.findall(text)
            groups = (f"[{group}]\n{entries.replace(chr(34), '')}" for group, entries in points)
            (info / "entry_points.txt").write_text("\n".join(groups))
            monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.chdir(tmp_path)
        return tmp_path

    yield place
    for module in modules:
        sys.modules.pop(module, None)
