"""Experiments by their entry points, listed without importing them.

Name and summary exist once: the name is the entry point's, the summary the first line of the
module's docstring. A package that cannot be read or loaded is named, and the others stay usable.
"""

import ast
import gc
import importlib.util
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.installed import State, current_name, installed, state
from parapod.systems.core.quoting import did_you_mean, quoted

if TYPE_CHECKING:  # Listing must not wait for Drake.
    from parapod.sims.lab.experiment import Experiment

GROUP = "parapod.experiments"


class UnknownExperiment(ParapodError):
    """A name that no experiment has."""


@dataclass(frozen=True)
class Entry:
    """An experiment that is installed.

    Attributes:
        name: the word after `parapod run`.
        point: its entry point.
    """

    name: str
    point: EntryPoint = field(repr=False)

    @cached_property
    def package(self) -> str:
        """Name of the distribution that declares it."""
        return self.point.dist.name if self.point.dist is not None else self.point.module

    @cached_property
    def source(self) -> Path:
        """File of its module.

        Raises:
            ParapodError: the module is not there; names the package.
        """
        try:
            spec = importlib.util.find_spec(self.point.module)
        except Exception as error:
            raise self._broken(error) from error
        if spec is None or spec.origin is None:
            raise self._broken(f"there is no module {self.point.module}")
        return Path(spec.origin)

    @cached_property
    def _module(self) -> ast.Module:
        try:
            return _parsed(self.source, self.source.stat().st_mtime_ns)
        except (OSError, SyntaxError, ValueError) as error:
            raise self._broken(error) from error

    @property
    def summary(self) -> str:
        """One line: the beginning of the module's docstring."""
        text = ast.get_docstring(self._module) or ""
        return " ".join(text.split("\n\n")[0].split())

    @property
    def group(self) -> str:
        """Heading under which it is listed: the beginning of its package's docstring."""
        text = None
        init = self.source.with_name("__init__.py")
        if "." in self.point.module and init.is_file():
            text = ast.get_docstring(ast.parse(init.read_text(encoding="utf-8")))
        return (text or self.package).split("\n")[0].split(":")[0].rstrip(".")

    @property
    def takes(self) -> str:
        """Usual duration of a run, in words."""
        return str(self._constant("takes", "seconds"))

    @property
    def switches(self) -> Mapping[str, tuple[str, str]]:
        """Options of its own: name -> override that it is short for, and its help."""
        switches: Mapping[str, tuple[str, str]] = self._constant("switches", {})
        return switches

    @property
    def default_scenario(self) -> Path | None:
        """File beside its module with the values that differ from the schema's defaults."""
        path = self.source.with_name(f"{self.name}.yaml")
        return path if path.is_file() else None

    def load(self) -> "Experiment[Any, Any]":
        """Imports the experiment.

        Raises:
            ParapodError: its package cannot be loaded; names the package and the reason.
        """
        try:
            with uncollected():
                experiment: Experiment[Any, Any] = self.point.load()(self.name)
        except Exception as error:
            raise self._broken(error) from error
        return experiment

    def _constant(self, name: str, default: Any) -> Any:
        """A literal among the attributes of the experiment's class."""
        for node in self._module.body:
            if isinstance(node, ast.ClassDef) and node.name == self.point.attr:
                for line in node.body:
                    if not isinstance(line, ast.Assign | ast.AnnAssign) or line.value is None:
                        continue
                    target = line.targets[0] if isinstance(line, ast.Assign) else line.target
                    if ast.unparse(target) == name:
                        return self._literal(name, line.value)
        return default

    def _literal(self, name: str, value: ast.expr) -> Any:
        try:
            return ast.literal_eval(value)
        except (ValueError, TypeError):
            reason = f"`{name}` of {self.point.attr} must be a literal, for it is not executed"
            raise self._broken(reason) from None

    def _broken(self, why: object) -> ParapodError:
        reason = " ".join(str(why).split())
        kind = f"{type(why).__name__}: " if isinstance(why, Exception) else ""
        return ParapodError(
            f"the experiment '{self.name}' of the package '{self.package}' cannot be loaded: "
            f"{kind}{reason}"
        )


@contextmanager
def uncollected() -> Iterator[None]:
    """Keeps the garbage collector away from what is being loaded.

    Modules make a hundred thousand objects, all of which stay; looking through them again and
    again takes a sixth of a command's start.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@cache
def _parsed(source: Path, modified: int) -> ast.Module:
    """Syntax tree of a module, which every command of a process reads once."""
    return ast.parse(source.read_text(encoding="utf-8"))


def list_entries() -> tuple[Entry, ...]:
    """All experiments that are installed: parapod's own first, then by package and name."""
    return _entries(state())


@lru_cache(maxsize=1)
def _entries(_state: State) -> tuple[Entry, ...]:
    """The same, made again only where something else is installed."""
    entries = {Entry(point.name, point) for point in installed(GROUP)}
    own = "parapod"
    return tuple(
        sorted(entries, key=lambda e: (e.package != own, e.package, e.point.module, e.name))
    )


def find_entry(name: str) -> Entry:
    """The experiment of a name.

    Raises:
        UnknownExperiment: there is none; names those that there are.
    """
    name = current_name(GROUP, name)
    # The first of a name: no other package takes the place of parapod's own.
    by_name = {entry.name: entry for entry in reversed(list_entries())}
    if name not in by_name:
        names, hint = ", ".join(reversed(by_name)), did_you_mean(name, by_name)
        raise UnknownExperiment(f"there is no experiment {quoted(name)}; there are: {names}{hint}")
    return by_name[name]


def find_experiment(name: str) -> "Experiment[Any, Any]":
    """The experiment of a name, imported.

    Raises:
        UnknownExperiment: there is none.
        ParapodError: its package cannot be loaded.
    """
    return find_entry(name).load()
