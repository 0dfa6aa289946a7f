"""Requests to an emulated machine: what is to misbehave, how, and when."""

import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console

from parapod.diagrams.machine import Machine
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.emulation.harness import KINDS, SUPPLY, Misbehaviour

# The word that ends a device's misbehaviour.
WELL = "well"
# The word that has an instrument beside the machine read.
MEASURE = "measure"
# Drives between a card's outputs and the motors, which answer no program.
DRIVES = "drives"
# Circuits beside the devices, and what may happen to each; the last word ends it.
EMERGENCY_STOP, SWITCHES = "emergency_stop", "switches"
CLOSED = "closed"
CIRCUITS: Mapping[str, tuple[str, ...]] = {
    EMERGENCY_STOP: ("pressed", "released"),
    SUPPLY: ("lost", "back"),
    SWITCHES: (CLOSED, "open", WELL),
}


class Circuit:
    """A button, the drives' supply, or switches: no device detects that they break.

    Attributes:
        state: kind of its fault; "" if it has none.
    """

    def __init__(self) -> None:
        self.state = ""

    @property
    def is_broken(self) -> bool:
        """Whether anything has."""
        return bool(self.state)

    def begin(self, kind: str, now: float) -> None:
        """Breaks it, in one of its ways."""
        self.state = kind

    def end(self) -> None:
        """Makes it whole."""
        self.state = ""


def disturbable(machine: Machine[Any], parts: Sequence[str]) -> tuple[str, ...]:
    """Names of everything that an emulated machine can be asked to disturb.

    Args:
        machine: the machine.
        parts: parts with a driver.
    """
    more = [DRIVES] if machine.real.drives else []
    more += [EMERGENCY_STOP, *([SUPPLY] if machine.real.cut else [])]
    return (*parts, *more, *([SWITCHES] if machine.real.switches else []))


def kinds_of(part: str) -> tuple[str, ...]:
    """Words for what may happen to a part, the last of which ends it."""
    return CIRCUITS.get(part, (*KINDS, WELL))


@dataclass(frozen=True)
class DeviceFaultRequest:
    """Fault that an emulated device is asked for.

    Attributes:
        at: from when on, since the emulator began [s].
        part: one of `disturbable`.
        kind: one of `kinds_of` the part.
    """

    at: float
    part: str
    kind: str


def parsed_fault(text: str, parts: Sequence[str], at: float | None = None) -> DeviceFaultRequest:
    """A request such as "12 imu garbage", or "imu well" when the time is known.

    Args:
        text: text that was written.
        parts: names of what can be disturbed, see `disturbable`.
        at: the time, if the text does not begin with it [s].

    Raises:
        ScenarioError: it is not such a request.
    """
    words = text.split()
    if at is None and words:
        try:
            at = float(words.pop(0))
        except ValueError:
            raise ScenarioError(f"{quoted(text)} does not begin with a time in seconds") from None
    if at is None or len(words) != 2 or words[0] not in parts:
        raise ScenarioError(f"{quoted(text)} is not PART KIND, with a part of {', '.join(parts)}")
    if words[1] not in (kinds := kinds_of(words[0])):
        raise ScenarioError(
            f"{quoted(text)} is not PART KIND, with a kind of {', '.join(kinds)} for {words[0]}"
        )
    return DeviceFaultRequest(at, words[0], words[1])


class Schedule:
    """Faults and their times, asked for before and meanwhile."""

    def __init__(
        self,
        misbehaviours: Mapping[str, Misbehaviour | Circuit],
        requests: Sequence[DeviceFaultRequest],
        console: Console,
    ):
        """Prepares it.

        Args:
            misbehaviours: misbehaviours, by the names of what can be disturbed.
            requests: faults that are asked for in advance.
            console: console for the faults.
        """
        self._misbehaviours, self._console = misbehaviours, console
        self._parts = tuple(misbehaviours)
        self._waiting = sorted(requests, key=lambda request: request.at)
        self._now = 0.0
        self._measuring = threading.Event()

    def advance(self, now: float) -> None:
        """Begins and ends what is due; `now` is the time since the beginning [s]."""
        self._now = now
        while self._waiting and self._waiting[0].at <= now:
            self._do(self._waiting.pop(0))

    def is_measuring(self) -> bool:
        """Whether an instrument is to be read, once for each time that it was asked for."""
        is_measuring = self._measuring.is_set()
        self._measuring.clear()
        return is_measuring

    def listen(self) -> None:
        """Takes requests from standard input, if there is one, in a thread of its own."""
        threading.Thread(target=self._read, name="requests", daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            if not line.strip():
                continue
            if line.strip() == MEASURE:
                self._measuring.set()
                continue
            try:
                self._do(parsed_fault(line.strip(), self._parts, self._now))
            except ScenarioError as error:
                self.say(str(error))

    def _do(self, request: DeviceFaultRequest) -> None:
        misbehaviour = self._misbehaviours[request.part]
        if request.kind == kinds_of(request.part)[-1]:
            misbehaviour.end()
        else:
            misbehaviour.begin(request.kind, monotonic())
        self.say(f"{self._now:.2f} s: {request.part} {request.kind}")

    def say(self, text: str) -> None:
        """Prints a remark."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
