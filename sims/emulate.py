"""Emulated devices run for a controller in another program, and made to misbehave."""

import itertools
import math
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.scenario import dump_scenario
from parapod.sims.emulated_machine import EmulatedMachine
from parapod.sims.mcap_log import McapLog
from parapod.sims.real_time import ended_by_signals, undisturbed
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.addresses import emulator_directory
from parapod.systems.hardware.emulation.harness import KINDS, Misbehaviour

_LOG_PERIOD = 0.01  # [s]
_FOREVER = 1e6  # [s]
# The word that ends a device's misbehaviour.
WELL = "well"


@dataclass(frozen=True)
class DeviceFaultRequest:
    """What an emulated device is to do wrong.

    Attributes:
        at: from when on, since the emulator began [s].
        part: of the machine.
        kind: one of `KINDS`, or "well".
    """

    at: float
    part: str
    kind: str


def parsed_fault(text: str, parts: Sequence[str], at: float | None = None) -> DeviceFaultRequest:
    """A request such as "12 imu garbage", or "imu well" when the time is known.

    Args:
        text: what was written.
        parts: of the machine.
        at: the time, if the text does not begin with it [s].

    Raises:
        ScenarioError: it is not such a request.
    """
    words = text.split()
    if at is None and words:
        try:
            at = float(words.pop(0))
        except ValueError:
            raise ScenarioError(f"'{text}' does not begin with a time in seconds") from None
    if at is None or len(words) != 2 or words[0] not in parts or words[1] not in (*KINDS, WELL):
        raise ScenarioError(
            f"'{text}' is not PART KIND, with a part of {', '.join(parts)} and a kind of "
            f"{', '.join((*KINDS, WELL))}"
        )
    return DeviceFaultRequest(at, words[0], words[1])


def emulate(
    scenario: Any,
    requests: Sequence[DeviceFaultRequest] = (),
    duration: float = math.inf,
    log: Path | None = None,
    console: Console | None = None,
    experiment: str | None = None,
) -> None:
    """Runs emulated devices until Ctrl-C, or for a time.

    Meanwhile each line on standard input, such as "imu garbage" or "imu well", begins or ends a
    device's misbehaviour.

    Args:
        scenario: of a machine, with the drivers whose devices are emulated.
        requests: misbehaviours at their times.
        duration: [s].
        log: file for all ports, the truth among them, in MCAP; or None.
        console: where it is said what is going on.
        experiment: that another program may run with it; None for the machine's own.

    Raises:
        ScenarioError: see `EmulatedMachine`.
        OutputError: the log cannot be written.
    """
    said = console or Console(stderr=True)
    machine = EmulatedMachine(scenario)
    schedule = Schedule(machine.misbehaviours, requests, said)
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        metadata = {"scenario": dump_scenario(scenario), "parapod": version("parapod")}
        record = McapLog(log, machine.ports(), metadata) if log is not None else None
        if record is not None:
            stack.enter_context(record)
        stack.enter_context(machine.devices())
        _introduce(scenario, experiment or machine.description.experiment, said)
        schedule.listen()
        every = max(1, round(_LOG_PERIOD / machine.period))
        ticks = itertools.count()

        def on_tick(root: Context) -> None:
            now = root.get_time()
            schedule.advance(now)
            if record is not None and next(ticks) % every == 0:
                record.write(now, machine.values(root))

        with undisturbed():
            machine.run(min(duration, _FOREVER), on_tick)


def _introduce(scenario: Any, experiment: str, console: Console) -> None:
    hardware: HardwareScenario = scenario.hardware
    tags = ", ".join(f"{type(d).__name__} ({d.part})" for d in hardware.drivers)
    for line in (
        f"emulated: {tags}",
        f"in {emulator_directory()}; physics: {scenario.backend}",
        f"ready: in another terminal, parapod run {experiment} --backend hardware",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


class Schedule:
    """What goes wrong when, asked for before and meanwhile."""

    def __init__(
        self,
        misbehaviours: Mapping[str, Misbehaviour],
        requests: Sequence[DeviceFaultRequest],
        console: Console,
    ):
        """Prepares it.

        Args:
            misbehaviours: by part of the machine.
            requests: what is asked for in advance.
            console: where it is said what goes wrong.
        """
        self._misbehaviours, self._console = misbehaviours, console
        self._waiting = sorted(requests, key=lambda request: request.at)
        self._now = 0.0

    def advance(self, now: float) -> None:
        """Begins and ends what is due; `now` is the time since the beginning [s]."""
        self._now = now
        while self._waiting and self._waiting[0].at <= now:
            self._do(self._waiting.pop(0))

    def listen(self) -> None:
        """Takes requests from standard input, if there is one, in a thread of its own."""
        threading.Thread(target=self._read, name="requests", daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                self._do(parsed_fault(line.strip(), list(self._misbehaviours), self._now))
            except ScenarioError as error:
                self._say(str(error))

    def _do(self, request: DeviceFaultRequest) -> None:
        misbehaviour = self._misbehaviours[request.part]
        if request.kind == WELL:
            misbehaviour.end()
        else:
            misbehaviour.begin(request.kind, time.monotonic())
        self._say(f"{self._now:.2f} s: {request.part} {request.kind}")

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
