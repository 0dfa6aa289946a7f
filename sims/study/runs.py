"""One run of a study, as a worker carries it out."""

import functools
import gc
import hashlib
import importlib
import io
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from socket import gethostname
from typing import Any

from rich.console import Console

from parapod.diagrams.drivers.external import load_installed_drivers
from parapod.sims.lab.discovery import Entry, UnknownExperiment, find_entry
from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.options import Loops, RunOptions
from parapod.sims.output.results import Metric
from parapod.sims.output.together import Together, collect_garbage
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import printable
from parapod.systems.core.schema import Reader, build

# Files of which a run's numbers are made.
_SOURCE = (".py", ".yaml", ".urdf", ".xml", ".obj")


class AnotherVersion(ParapodError):
    """A worker, or a file, of another parapod or Drake than that of this program."""


@dataclass(frozen=True)
class Software:
    """Software that the numbers of an experiment depend on.

    Attributes:
        package: distribution that declares the experiment, with its version.
        parapod: version of parapod, with a digest of its source.
        drake: version of Drake.
    """

    package: str
    parapod: str
    drake: str

    @classmethod
    def from_entry(cls, entry: Entry) -> "Software":
        """That of this process."""
        package = f"{entry.package} {version(entry.package)}"
        return cls(package, f"{version('parapod')} ({_digest()})", version("drake"))

    def __str__(self) -> str:
        package = "" if self.package.startswith("parapod ") else f"{self.package}, "
        return f"{package}parapod {self.parapod} and Drake {self.drake}"


@functools.cache
def _digest() -> str:
    digest = hashlib.sha256()
    for room in ("systems", "diagrams", "urdf", "sims"):
        (folder,) = map(Path, importlib.import_module(f"parapod.{room}").__path__)
        for path in sorted(folder.rglob("*")):
            if path.suffix in _SOURCE:
                digest.update(path.relative_to(folder).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


@dataclass(frozen=True)
class Order:
    """Common part of all runs of a study; it can be pickled.

    Attributes:
        experiment: name of the experiment.
        tree: the scenario, as plain data.
        keys: dotted keys of the variables.
        software: versions of the software that carries it out.
    """

    experiment: str
    tree: Mapping[str, Any]
    keys: tuple[str, ...]
    software: Software

    def scenario(self, schema: type, values: tuple[Any, ...]) -> Any:
        """The scenario of a run.

        Args:
            schema: the experiment's.
            values: those of the variables.

        Raises:
            ScenarioError: values that it does not admit together.
        """
        tree, reader = self.tree, Reader(schema)
        for key, value in zip(self.keys, values, strict=True):
            tree = reader.assign(schema, tree, key.split("."), value)
        return build(schema, tree)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        run: its number.
        metrics: those that the scenario decides, not the clock; empty if there was an error.
        error: reason why it was refused or failed; empty if it was not.
    """

    run: int
    metrics: tuple[Metric, ...] = ()
    error: str = ""


type Piece = tuple[int, tuple[Any, ...]]


def carry_out_runs(order: Order, rows: int | None, pieces: Sequence[Piece]) -> list[Outcome]:
    """Carries out runs; what one refuses and where it fails is its outcome too.

    Args:
        order: facts that all runs share.
        rows: largest number of runs that are simulated together; None: as many as are fast.
        pieces: number of each run, and the values of its variables.

    Raises:
        AnotherVersion: the software here is not that of the order.
    """
    shop = open_shop(order)
    together = Together(rows)
    options = replace(shop.options, together=together)
    works = [partial(_carried_out, order, shop.experiment, options, piece) for piece in pieces]
    return list(together.carry_out(works))


def _carried_out(
    order: Order, experiment: Experiment[Any, Any], options: RunOptions, piece: Piece
) -> Outcome:
    run, values = piece

    def work() -> tuple[Metric, ...]:
        scenario = order.scenario(experiment.schema, values)
        result = experiment.execute(scenario, options)
        return tuple(metric for metric in result.metrics if not metric.is_timing)

    return outcome_of(run, work)


def outcome_of(run: int, work: Callable[[], tuple[Metric, ...]]) -> Outcome:
    """Outcome of a run whose metrics some work gives, or that it refuses or fails at."""
    try:
        return Outcome(run, work())
    except ParapodError as error:
        return Outcome(run, error=str(error))
    except Exception as error:  # a solver that does not converge, a plant that blows up
        return Outcome(run, error=printable(f"{type(error).__name__}: {error}"))


@dataclass(frozen=True)
class Shop:
    """Everything that a worker's thread needs for all runs of an experiment."""

    software: Software
    experiment: Experiment[Any, Any]
    options: RunOptions


_shops = threading.local()


def open_shop(order: Order) -> Shop:
    """The shop of an order's experiment in this thread.

    Raises:
        AnotherVersion: the software here is not that of the order.
    """
    shop: Shop | None = getattr(_shops, order.experiment, None)
    if shop is None:
        try:
            entry = find_entry(order.experiment)
        except UnknownExperiment as error:
            package = order.software.package
            raise AnotherVersion(
                f"the worker on {gethostname()} lacks {package}: {error}"
            ) from None
        load_installed_drivers()
        options = RunOptions(console=Console(file=io.StringIO(), quiet=True), loops=Loops())
        shop = Shop(Software.from_entry(entry), entry.load(), options)
        # What has been imported stays: the garbage collector need not go through it each run.
        collect_garbage()
        gc.freeze()
        setattr(_shops, order.experiment, shop)
    if shop.software != order.software:
        raise AnotherVersion(
            f"the worker on {gethostname()} has {shop.software}; here is {order.software}"
        )
    return shop
