"""Experiments: what one is, how it is asked to run, and which ones there are."""

import importlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from parapod.sims.results import Result

# Wall-clock time between two redraws of a bar and between two lines in a file [s].
_REDRAW_PERIOD = 0.1
_LINE_PERIOD = 5.0


@dataclass(frozen=True)
class RunOptions:
    """Options for watching and recording a run; none of them changes its numbers.

    Attributes:
        meshcat: show the machine in a browser.
        live: with `meshcat`, stay after the scripted job and let the viewer move the machine.
        html: file for a recording that plays in a browser, or None.
        log: file for the signals (`outputs.write_log`), or None.
        graphviz: file for the diagram in Graphviz's language, or None.
        console: where progress and remarks go.
    """

    meshcat: bool = False
    live: bool = True
    html: Path | None = None
    log: Path | None = None
    graphviz: Path | None = None
    console: Console = field(default_factory=partial(Console, stderr=True))


@dataclass(frozen=True)
class Experiment:
    """A question put to a machine, answered with metrics and their bounds.

    Attributes:
        name: the word after `parapod run`.
        summary: one line.
        scenario: the schema: a dataclass with at least `backend: str` and `seed: int`.
        backends: backends on which the experiment runs.
        run: runs a scenario; the same scenario gives the same result.
    """

    name: str
    summary: str
    scenario: type
    backends: tuple[str, ...]
    run: Callable[[Any, RunOptions], Result]


@dataclass(frozen=True)
class Entry:
    """An experiment as it is listed, without importing it.

    Attributes:
        name: the experiment's name.
        summary: the experiment's summary.
        load: imports the experiment.
        scenarios: folder of its default scenario `<name>.yaml`; None for parapod's own, which is
            there only where it differs from the schema's defaults.
        switches: options of its own, which need no value: name -> the override of the scenario
            that it is short for, and its help.
    """

    name: str
    summary: str
    load: Callable[[], Experiment]
    scenarios: Path | None = None
    switches: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def default_scenario(self) -> Path | None:
        """File with what differs from the defaults of the schema, if anything does."""
        if self.scenarios is not None:
            return self.scenarios / f"{self.name}.yaml"
        from importlib.resources import files

        path = Path(str(files("parapod.sims.scenarios"))) / f"{self.name}.yaml"
        return path if path.is_file() else None


def _module(name: str) -> Callable[[], Experiment]:
    def load() -> Experiment:
        return importlib.import_module(name).EXPERIMENT

    return load


ENTRIES: tuple[Entry, ...] = (
    Entry(
        "level",
        "The platform finds out how the ground slopes, levels itself and follows posture "
        "commands.",
        _module("parapod.sims.level"),
    ),
    Entry(
        "validate-kinematics",
        "The kinematic model beside the multibody plant, with legs as drawn and as built.",
        _module("parapod.sims.validate_kinematics"),
    ),
    Entry(
        "track-posture",
        "Postures followed with legs as drawn, as built, and with the outer inclination loop.",
        _module("parapod.sims.track_posture"),
    ),
    Entry(
        "uneven-ground",
        "The platform levels itself where its feet stand at different heights.",
        _module("parapod.sims.uneven_ground"),
    ),
    Entry(
        "workspace",
        "Where the platform can bring the tip of its arm, beside the paper's eight surfaces.",
        _module("parapod.sims.workspace"),
        switches={"turntable": ("turntable=true", "let the motor in the arm's base turn it")},
    ),
    Entry(
        "calibrate",
        "Leg geometry, encoder offsets and accelerometer bias are identified from recorded poses.",
        _module("parapod.sims.calibrate"),
    ),
    Entry(
        "identify-actuators",
        "Voltage steps with and without the platform's weight give the actuators' gain K.",
        _module("parapod.sims.identify_actuators"),
    ),
    Entry(
        "deploy",
        "The whole operation: the platform drives there, stands up, works and leaves.",
        _module("parapod.sims.deploy"),
    ),
    Entry(
        "fault-campaign",
        "Every kind of fault of every device in every phase of the operation.",
        _module("parapod.sims.fault_campaign"),
    ),
    Entry(
        "slip",
        "How far the feet slip while the legs lift the platform and while the arm swings.",
        _module("parapod.sims.slip"),
    ),
    Entry(
        "chair-walk",
        "The walking chair carries a passenger a few steps forward and back.",
        _module("parapod.sims.chair_walk"),
    ),
    Entry(
        "chair-gait",
        "What a step of the walking chair asks of its branches, with and without jerks.",
        _module("parapod.sims.chair_gait"),
    ),
    Entry(
        "chair-circle",
        "A foot of the walking chair follows a circle, in three modes of its drives' control.",
        _module("parapod.sims.chair_circle"),
    ),
    Entry(
        "chair-payload",
        "How much the walking chair carries through a step, and how near it is to tipping.",
        _module("parapod.sims.chair_payload"),
    ),
)


def experiments(entries: Sequence[Entry] = ENTRIES) -> dict[str, Experiment]:
    """Every experiment by its name; imports them all."""
    return {entry.name: entry.load() for entry in entries}


@contextmanager
def progress(
    console: Console, what: str, total_seconds: float, line_period: float = _LINE_PERIOD
) -> Iterator[Callable[[float], None]]:
    """Show the progress of a simulation; yields the function that takes the simulated time.

    A terminal gets a bar. A file or pipe gets a line from time to time, and nothing at all from
    a run that is over before the first.

    Args:
        console: where to show it.
        what: what is going on, in a word or two.
        total_seconds: simulated time at the end [s].
        line_period: wall-clock time between two lines in a file or pipe [s].
    """
    if console.is_terminal:
        with _bar(console, what, total_seconds) as update:
            yield update
    else:
        yield _lines(console, what, total_seconds, line_period)


@contextmanager
def _bar(console: Console, what: str, total: float) -> Iterator[Callable[[float], None]]:
    from rich.progress import BarColumn, Progress, TextColumn

    started = time.monotonic()
    drawn = -math.inf
    reached = 0.0
    # Markup is off because `what` is any text.
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[pace]}", markup=False),
    )
    with Progress(*columns, console=console, auto_refresh=False) as bar:
        task = bar.add_task(what, total=total, pace="")

        def draw(now: float) -> None:
            pace = _pace(reached, total, now - started)
            bar.update(task, completed=reached, pace=pace, refresh=True)

        def update(simulated: float) -> None:
            nonlocal drawn, reached
            reached = simulated
            now = time.monotonic()
            if now - drawn >= _REDRAW_PERIOD:
                drawn = now
                draw(now)

        try:
            yield update
        finally:
            draw(time.monotonic())


def _lines(console: Console, what: str, total: float, period: float) -> Callable[[float], None]:
    started = printed = time.monotonic()

    def update(simulated: float) -> None:
        nonlocal printed
        now = time.monotonic()
        if now - printed >= period:
            printed = now
            line = f"{what}: {_pace(simulated, total, now - started)}"
            console.print(line, markup=False, highlight=False, soft_wrap=True)

    return update


def _pace(simulated: float, total: float, elapsed: float) -> str:
    factor = simulated / elapsed if elapsed > 0.0 else 0.0
    return f"{simulated:.1f} of {total:.1f} s, {factor:.3g} x real time"
