"""Programs of a real machine that are killed at random instants, and what is left then."""

import math
import os
import random
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.emulated import Program, until, until_for_good
from benchmarks.machines import (
    BEGINNING,
    DEPLOY,
    LEVEL,
    LONGEST,
    WALK,
    NotBegun,
    Place,
    Running,
    Work,
    begun,
)
from benchmarks.matrix import Row
from benchmarks.page import Page
from parapod.sims.output.logs.files import read_log
from parapod.systems.core.errors import OutputError

# Time after which a moving machine's program is killed, at random [s].
_INSTANTS = 4.0
# In which the log's process ends a log [s].
_FINISHING = 1.0
# A machine that does not move for so long stands [s].
_STANDING = 0.1
# Largest change of a position while it stands [m].
_STILL = 5e-5


class Kill(NamedTuple):
    """Outcome of a kill.

    Attributes:
        after: time until the machine had answered [s].
        code: exit code of the program that controls the machine.
        is_live: whether outputs were live in the end; None: the machine is gone.
        found: last words of that program; of a controller that is killed, those of the next one.
        is_readable: whether the log can be read up to the kill.
        is_next_safe: whether the next program is refused, or begins and ends with a machine that
            is neutral.
    """

    after: float
    code: int
    is_live: bool | None
    found: str
    is_readable: bool
    is_next_safe: bool


class Victim(NamedTuple):
    """A program that is killed.

    Attributes:
        name: its name.
        kill: kills it once.
        bound: longest time for the answer [s].
    """

    name: str
    kill: Callable[[Place, Running, Path], Kill]
    bound: float


def killed(place: Place, victim: Victim, times: int, name: str) -> Row:
    """Kills one program again and again; the worst of it in a row."""
    kills = []
    for k in range(times):
        kills.append(begun(place, partial(_kill, place, victim, k)))
    readable = sum(kill.is_readable for kill in kills)
    safe = sum(kill.is_next_safe for kill in kills)
    remark = f"logs readable: {readable} of {times}; next start refused or safe: {safe} of {times}"
    after = max(kill.after for kill in kills)
    return Row(
        place.work.name,
        name,
        found=next((kill.found for kill in kills if kill.code == 0), kills[-1].found),
        after=after if math.isfinite(after) else None,
        bound=victim.bound,
        code=min((kill.code for kill in kills), key=abs),
        is_live=None if kills[0].is_live is None else any(kill.is_live for kill in kills),
        remark=remark,
        is_broken=readable < times or safe < times,
    )


def _kill(place: Place, victim: Victim, k: int) -> Kill:
    running = place.get()
    log = running.machine.folder / f"killed{k}.mcap"
    try:
        return victim.kill(place, running, log)
    finally:
        log.unlink(missing_ok=True)


def _wait_at_random(program: Program) -> None:
    """Until an instant of the job."""
    until(lambda: program.has_ended, random.uniform(0.0, _INSTANTS))
    if program.has_ended:
        raise NotBegun(f"the job has ended before the kill: {program.last_words}")


def _is_readable(log: Path) -> bool:
    """Whether a log has samples."""
    try:
        return len(read_log(log).time) > 0
    except OutputError:
        return False


def _next(running: Running) -> tuple[bool, str]:
    """Whether the next program is refused or leaves a neutral machine; its last words."""
    program = Program("check", "legs", "--of", running.work.experiment, "--seconds", "0.1")
    code = program.wait(LONGEST)
    is_neutral = until(lambda: not running.has_power and not running.is_moving, 1.0)
    return code in (0, 1, 2) and math.isfinite(is_neutral), program.last_words


def _controller(place: Place, running: Running, log: Path) -> Kill:
    with running.working("--log", str(log)) as program:
        _wait_at_random(program)
        os.kill(program.process.pid, signal.SIGKILL)
        after = until(lambda: not running.has_power, 5.0)
        code = program.wait(LONGEST)
    until(lambda: False, _FINISHING)
    is_safe, words = _next(running)
    is_live = running.stays_live
    running.machine.remember(running.work.remembered)
    return Kill(after, code, is_live, words, _is_readable(log), is_safe)


def _logger(place: Place, running: Running, log: Path) -> Kill:
    with running.working("--log", str(log)) as program:
        writer = program.companion("parapod.sims.output.logs.live")
        _wait_at_random(program)
        os.kill(writer, signal.SIGKILL)
        after = until(lambda: bool(program.word("cannot write")), 5.0)
        code = program.wait(LONGEST)
    is_readable = _is_readable(log)
    is_live, (is_safe, _) = running.stays_live, _next(running)
    running.machine.remember(running.work.remembered)
    return Kill(after, code, is_live, program.word("cannot write"), is_readable, is_safe)


def _emulator(place: Place, running: Running, log: Path) -> Kill:
    """The machine itself is gone; its controller must end, and another machine must begin."""
    with running.working("--log", str(log)) as program:
        _wait_at_random(program)
        running.machine.process.kill()
        begun = until(lambda: program.has_ended, LONGEST)
        code = program.wait(LONGEST)
    is_readable, words = _is_readable(log), program.last_words
    place.leave()
    is_safe, _ = _next(place.get())
    return Kill(begun, code, None, words, is_readable, is_safe)


def _panel(place: Place, running: Running, log: Path) -> Kill:
    """The process of the operator's page, while a leg or the chair is moved by hand."""
    is_chair = place.work is WALK
    first = next(iter(place.work.moving))
    more = ("--set", "begin=0.5") if is_chair else ()
    program = Program(
        *("operate", place.work.experiment, "--backend", "hardware", "--log", str(log), *more)
    )
    page: Page | None = None
    try:
        until(lambda: program.has_ended or any("open http" in s for s in program.said), BEGINNING)
        lines = [line for line in program.said if line.startswith("open http")]
        if not lines:
            raise NotBegun(f"the page does not begin: {program.last_words}")
        page = Page(lines[0].split()[1])
        desk = program.companion("parapod.sims.lab.desk")
        if is_chair:
            until(lambda: running.has_power, BEGINNING)
            page.held = "walk"
        else:
            page.wait("transport")
            page.click("Go")
            page.wait("lower")
        if until(lambda: running.has_power and running.moves(first), BEGINNING) == float("inf"):
            raise NotBegun(f"the operator moves nothing: {page.state()}")
        _wait_at_random(program)
        os.kill(desk, signal.SIGKILL)
        after = until_for_good(_stands(running), _STANDING, 5.0)
        code = program.wait(LONGEST)
    finally:
        program.kill()
        if page is not None:
            page.close()
    is_live, (is_safe, _) = running.stays_live, _next(running)
    running.machine.remember(running.work.remembered)
    return Kill(after, code, is_live, program.last_words, _is_readable(log), is_safe)


def _stands(running: Running) -> Callable[[], bool]:
    """Says whether no leg has moved since it was asked before."""
    wire = f"legs.{running.work.remembered}"
    last = np.array(running.machine.wires.get(wire))

    def stands() -> bool:
        nonlocal last
        now = np.array(running.machine.wires.get(wire))
        if np.abs(now - last).max() > _STILL:
            last = now
            return False
        return True

    return stands


_USUAL = (
    Victim("controller", _controller, 0.25),
    # Asked for two seconds more at the end, and found before.
    Victim("emulator", _emulator, 4.0),
    Victim("logger", _logger, 1.0),
)
_PANEL = Victim("panel", _panel, 0.5)
VICTIMS: dict[Work, tuple[Victim, ...]] = {
    LEVEL: _USUAL,
    DEPLOY: (_PANEL,),
    WALK: (*_USUAL, _PANEL),
}
