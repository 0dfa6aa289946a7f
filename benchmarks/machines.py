"""Machines with a job in which something is broken, and what is seen of them from outside."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

from benchmarks.emulated import Emulated, Program, emulated, until
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.machine import Machine
from parapod.diagrams.walking_chair.machine import CHAIR

# How long a job may take to move, and to end [s].
BEGINNING, LONGEST = 60.0, 90.0
_ATTEMPTS = 3


@dataclass(frozen=True, eq=False)
class Work:
    """A machine and its job on emulated devices.

    Attributes:
        name: machine and job, for people.
        machine: the machine.
        emulated: experiment that is emulated, and its further options.
        job: makes the arguments of `parapod` for the next job.
        power: wire that is below 0.5 while the legs have power.
        moving: wires of commands, and from which value on they move something.
        remembered: signal of which a file remembers where the machine stood.
        is_fresh: whether each job needs a machine at the beginning of its scenario.
        ends: whether a job answers a fault by taking the legs' power; else it holds them first.
    """

    name: str
    machine: Machine[Any]
    emulated: tuple[str, ...]
    job: Callable[[], tuple[str, ...]]
    power: str
    moving: Mapping[str, float]
    remembered: str
    is_fresh: bool = True
    ends: bool = True

    @property
    def experiment(self) -> str:
        return self.emulated[0]


class NotBegun(RuntimeError):
    """A job that has ended before anything was broken, as on a computer that is too busy."""


class Running:
    """An emulated machine that works."""

    def __init__(self, work: Work, machine: Emulated):
        self.work, self.machine = work, machine

    @property
    def has_power(self) -> bool:
        return self.machine.wires.get(self.work.power)[0] < 0.5

    def moves(self, wire: str) -> bool:
        """Whether a command moves something."""
        return max(map(abs, self.machine.wires.get(wire))) > self.work.moving[wire]

    @property
    def is_moving(self) -> bool:
        return any(map(self.moves, self.work.moving))

    @contextmanager
    def working(self, *options: str, on: str = "") -> Iterator[Program]:
        """A job whose legs move; ended at the end of the context, if it has not.

        Args:
            options: further arguments.
            on: wire that must move before; "": any.

        Raises:
            NotBegun: it does not begin; has its words.
        """
        program = Program(*self.work.job(), *options)
        try:
            wire = on or next(iter(self.work.moving))
            until(lambda: program.has_ended or (self.has_power and self.moves(wire)), BEGINNING)
            if program.has_ended or not self.moves(wire):
                raise NotBegun(f"the job does not begin: {program.last_words}")
            yield program
        finally:
            program.kill()

    @property
    def stays_live(self) -> bool:
        """Whether outputs are still live after a second."""
        return until(lambda: not self.has_power and not self.is_moving, 1.0) == float("inf")


@dataclass
class Place:
    """Machine for jobs of one kind; begun again when that is needed."""

    work: Work
    _running: Running | None = None
    _over: Any = field(default=None, repr=False)

    def get(self) -> Running:
        """The machine, at rest and well."""
        if self._running is not None and self.work.is_fresh:
            self.leave()
        if self._running is None:
            experiment, *options = self.work.emulated
            self._over = emulated(self.work.machine, *options, experiment=experiment)
            self._running = Running(self.work, self._over.__enter__())
        return self._running

    def leave(self) -> None:
        """Ends the emulator; what is next begins another one."""
        over, self._over, self._running = self._over, None, None
        if over is not None:
            with suppress(Exception):
                over.__exit__(None, None, None)


def begun[T](place: Place, measured: Callable[[], T]) -> T:
    """Result of a job, which is tried again when it does not begin.

    Raises:
        NotBegun: it has not begun three times.
    """
    for attempts_left in reversed(range(_ATTEMPTS)):
        try:
            return measured()
        except NotBegun:
            place.leave()
            if not attempts_left:
                raise
    raise AssertionError


_turns = itertools.count()


def _level() -> tuple[str, ...]:
    """The platform goes up and down in turns, so that its legs move in each job."""
    heights = (465.0, 490.0) if next(_turns) % 2 else (490.0, 465.0)
    waypoints = [
        f"{{time: {2.0 + 2.5 * k}, height_mm: {h - 477.0}}}" for k, h in enumerate(heights)
    ]
    return (
        *("run", "level", "--backend", "hardware", "--set", "job.estimate_at=1.5"),
        f"job.waypoints=[{', '.join(waypoints)}]",
        "job.arm={start: 0.5, duration: 0.5}",
        "job.settled_after=1.5",
        "job.end=8",
    )


LEVEL = Work(
    name="platform, level",
    machine=PLATFORM,
    emulated=("level", "--backend", "kinematic"),
    job=_level,
    power="legs.stop",
    moving={"legs.voltage": 0.3},
    remembered="extension",
    is_fresh=False,
)
DEPLOY = Work(
    name="platform, deploy",
    machine=PLATFORM,
    emulated=("deploy", "--backend", "kinematic"),
    job=lambda: ("run", "deploy", "--backend", "hardware"),
    power="legs.stop",
    moving={"legs.voltage": 0.3, "wheels.velocity_command": 0.1},
    remembered="extension",
    ends=False,
)
WALK = Work(
    name="chair, walk",
    machine=CHAIR,
    emulated=("chair-walk", "--backend", "multibody", "--set", "plant.time_step=0.002"),
    job=lambda: ("run", "chair-walk", "--backend", "hardware", "--set", "begin=0.5"),
    power="legs.brake",
    moving={"legs.velocity_command": 2e-3},
    remembered="position",
)
