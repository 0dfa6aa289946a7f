"""Which tests execute which lines: recorded in a run of all tests, and read to choose some.

As a plugin of pytest this records, or runs what was chosen. Lines are told by `sys.monitoring`,
which reports each once a test: a run of all tests takes an eighth longer, with the contexts of
`coverage` two thirds.
"""

import ast
import json
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

from benchmarks.mutations import Mutant, name_of, targets_of

PLAN = "MUTANTS_PLAN"  # environment variable: the file that tells a test run what to do
_CHOSEN = 20.0  # duration of the tests of one mutant, as recorded [s]
_COLLECTED = 0.1  # to collect the tests of one file [s]
_LONGEST = 20.0  # tests that take longer are left out [s]

# In the test run


def pytest_configure(config: pytest.Config) -> None:
    if PLAN in os.environ:
        plan = json.loads(Path(os.environ[PLAN]).read_text())
        config.pluginmanager.register(_Choice(plan) if "tests" in plan else _Record(plan))


class _Record:
    """Records the lines that each test executes, and how long it takes."""

    def __init__(self, plan: dict[str, Any]) -> None:
        self._root, self._out = plan["root"] + os.sep, Path(plan["out"])
        self._seen: set[tuple[str, int]] = set()
        self._lines: dict[tuple[str, int], list[int]] = defaultdict(list)
        self._tests: list[str] = []
        self._duration: dict[str, float] = defaultdict(float)
        self._passed: set[str] = set()
        self._scopes: dict[str, str] = {}
        self._shared: list[list[tuple[str, str]]] = []
        self._open: list[tuple[pytest.FixtureDef[Any], Any]] = []
        watch = sys.monitoring
        watch.use_tool_id(watch.COVERAGE_ID, "mutants")
        watch.register_callback(watch.COVERAGE_ID, watch.events.LINE, self._line)
        watch.set_events(watch.COVERAGE_ID, watch.events.LINE)

    def _line(self, code: CodeType, line: int) -> object:
        if code.co_filename and code.co_filename.startswith(self._root):
            self._seen.add((code.co_filename, line))
        return sys.monitoring.DISABLE  # until events are restarted

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: Any
    ) -> Iterator[None]:
        if fixturedef.scope != "function" and fixturedef.baseid:
            self._scopes[fixturedef.argname] = fixturedef.scope
            if fixturedef.scope == "session":
                self._open.append((fixturedef, request))
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Iterator[None]:
        self._seen.clear()
        sys.monitoring.restart_events()
        result = yield
        for line in self._seen:
            self._lines[line].append(len(self._tests))
        self._tests.append(item.nodeid)
        names = set(getattr(item, "fixturenames", ())) & self._scopes.keys()
        self._shared.append([(name, self._scopes[name]) for name in sorted(names)])
        if nextitem is None or nextitem.path != item.path:
            # So that what a session shares is executed once for each file of tests.
            for fixturedef, request in self._open:
                fixturedef.finish(request)
            self._open.clear()
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._duration[report.nodeid] += report.duration
        if report.when == "call" and report.passed:
            self._passed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        lines: dict[str, dict[int, list[int]]] = defaultdict(dict)
        for (path, line), tests in self._lines.items():
            lines[path.removeprefix(self._root)][line] = tests
        contexts = [
            (name, self._duration[name], name in self._passed, shared)
            for name, shared in zip(self._tests, self._shared, strict=True)
        ]
        self._out.write_text(json.dumps({"tests": contexts, "lines": lines}))


class _Choice:
    """Keeps the tests that a plan names, in its order, and notes the first that fails."""

    def __init__(self, plan: dict[str, Any]) -> None:
        self._order = {test: i for i, test in enumerate(plan["tests"])}
        self._out = Path(plan["out"])

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = [item for item in items if item.nodeid in self._order]
        items[:] = sorted(chosen, key=lambda item: self._order[item.nodeid])

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._note(f"{report.nodeid} (collection)")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._note(report.nodeid)

    def _note(self, name: str) -> None:
        if not self._out.exists():
            self._out.write_text(name)


# After it


class Tests:
    """The tests, and which of them see a mutant."""

    def __init__(self, record: dict[str, Any], root: Path) -> None:
        self._names = [name for name, *_ in record["tests"]]
        self._numbers = {name: i for i, name in enumerate(self._names)}
        self._trusted: set[str] = set()
        self._duration = [duration for _, duration, *_ in record["tests"]]
        self._is_used = [ok and took <= _LONGEST for _, took, ok, _ in record["tests"]]
        lines = record["lines"]
        # Templates have lines too, and the package's own module lies elsewhere.
        self._lines = {
            path: lines[path] for path in lines if path.endswith(".py") and (root / path).is_file()
        }
        self._shared = [
            {_sharing_key(name, *fixture) for fixture in shared}
            for name, _, _, shared in record["tests"]
        ]
        self._sharing: dict[tuple[str, ...], set[int]] = defaultdict(set)
        for i, shared in enumerate(self._shared):
            for key in shared:
                self._sharing[key].add(i)
        self._largest = {
            key: max(self._duration[i] for i in tests) for key, tests in self._sharing.items()
        }
        self._imports = {
            file: _imported(root / file) for file in {n.partition("::")[0] for n in self._names}
        }
        self._mentions: dict[str, list[tuple[str, int]]] = defaultdict(list)
        self._passed_on: dict[str, set[str]] = defaultdict(set)
        for path in self._lines:
            self._index(path, ast.parse((root / path).read_text(encoding="utf-8")), False)

    def _index(self, path: str, node: ast.AST, is_called: bool) -> None:
        """Notes the lines that mention a name, or at import the names that depend on it."""
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt) and not is_called:
                targets = set(targets_of(child))
                if isinstance(child, ast.FunctionDef):
                    targets = {child.name}
                if not isinstance(child, ast.ClassDef):
                    for name in filter(None, map(name_of, _outside(child))):
                        self._passed_on[name] |= targets
            if is_called and (name := name_of(child)) and hasattr(child, "lineno"):
                self._mentions[name].append((path, child.lineno))
            if isinstance(child, ast.FunctionDef):
                first, last = child.body[0].lineno, child.body[-1].end_lineno or 0
                self._mentions[child.name] += [(path, n) for n in range(first, last + 1)]
            is_body = isinstance(child, ast.FunctionDef | ast.Lambda)
            self._index(path, child, is_called or is_body)

    def _at(self, path: str, lines: Sequence[int]) -> set[int]:
        contexts = self._lines.get(path, {})
        return {test for line in lines for test in contexts.get(str(line), ())}

    def _is_near(self, test: str, module: str) -> bool:
        """Whether a test's file imports a module."""
        return module in self._imports[test.partition("::")[0]]

    def is_trusted(self, test: str, passes: Callable[[str], bool]) -> bool:
        """Whether a test that failed passes alone without a change; if not it is used no more.

        Args:
            test: its name, or what else a run says that failed.
            passes: runs one test without a change.
        """
        if test in self._trusted or test not in self._numbers:
            return True
        if passes(test):
            self._trusted.add(test)
            return True
        self._is_used[self._numbers[test]] = False
        return False

    def tests_for(self, mutant: Mutant) -> tuple[list[str], int]:
        """Tests that may see a mutant, as many as there is time for, and how many there are.

        First those of files that import the changed one, each kind by duration. What stands
        outside of functions, such a file may use without executing a line.
        """
        module = "parapod." + mutant.path.removesuffix(".py").replace("/", ".")
        near = {i for i, name in enumerate(self._names) if self._is_near(name, module)}
        if mutant.names is None:
            covering = self._at(mutant.path, [mutant.line])
            covering = covering or self._at(
                mutant.path, range(mutant.block[0], mutant.block[1] + 1)
            )
        else:
            names, new = set(mutant.names), set(mutant.names)
            while new:
                new = set().union(*(self._passed_on[name] for name in new)) - names
                names |= new
            places = [place for name in names for place in self._mentions[name]]
            covering = near.union(*(self._at(path, [line]) for path, line in places))
        covering |= {
            t for i in set(covering) for key in self._shared[i] for t in self._sharing[key]
        }
        used = [i for i in covering if self._is_used[i]]
        used.sort(key=lambda i: (i not in near, self._duration[i], i))
        chosen, total = [], 0.0
        files, starting = set[str](), set[tuple[str, ...]]()
        for i in used:
            file = self._names[i].partition("::")[0]
            # Who begins what is shared pays for it.
            shared = [self._largest[key] for key in self._shared[i] - starting]
            cost = self._duration[i] + sum(shared) + (0.0 if file in files else _COLLECTED)
            if total + cost <= _CHOSEN:
                total += cost
                files.add(file)
                starting |= self._shared[i]
                chosen.append(self._names[i])
        return chosen or [self._names[i] for i in used[:1]], len(used)


def _sharing_key(test: str, fixture: str, scope: str) -> tuple[str, ...]:
    """Lines that tests share through a fixture's work.

    A fixture of the session may do it when a test calls it, for that test's parameters.
    """
    file = test.partition("::")[0]
    return (file, fixture) if scope != "session" else (file, fixture, test.partition("[")[2])


def _outside(node: ast.stmt) -> Iterator[ast.AST]:
    """Lines that a statement executes itself: of a function only its decorators and defaults."""
    if not isinstance(node, ast.FunctionDef):
        yield from ast.walk(node)
        return
    for child in (*node.decorator_list, *node.args.defaults, *node.args.kw_defaults):
        if child is not None:
            yield from ast.walk(child)


def _imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names
