"""The operator's page in a process of its own, for machines that must not wait for it.

Serving pages and drawing in three dimensions would keep Python's lock from the threads that talk
to devices. Whoever drives the machine writes what is to be shown into a pipe, and reads from
another one what the operator does; neither ever blocks. A page or a process that falls silent is
reported as silence, which the machine takes for a person who has let go.

The program at this end has `Desk`, with the methods of `Panel`; the process has the `Panel`.
"""

import base64
import json
import math
import os
import pickle
import select
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from types import TracebackType
from typing import Any, Self

import numpy as np

from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.output.companion import PIECE, Companion, read_beginning
from parapod.systems.core.errors import OutputError

# Between two messages about what the operator does [s].
_PERIOD = 0.02
# Older ones are not believed: a button is not held any more [s].
_STALE = 0.3
# How long the process may take to begin, in which Drake is imported, and to end [s].
_BEGINNING, _ENDING = 60.0, 5.0
# Not yet written lines of what is only shown; further ones are left out [bytes].
_WAITING = 1 << 15


class Desk:
    """Sliders, buttons and numbers on a page that another process serves; entered to begin.

    Attributes:
        process: number of the process; None before the beginning.
        wrong: reason why the process has ended; empty while it serves.
    """

    def __init__(self, experiment: str, scenario: Any, title: str, host: str = "localhost"):
        """Describes the page.

        Args:
            experiment: name of the experiment whose scene and machine are drawn.
            scenario: its scenario.
            title: title of the page.
            host: see `Panel`.
        """
        self.process: int | None = None
        self.wrong = ""
        self._beginning = {
            "experiment": experiment,
            "scenario": _packed(scenario),
            "title": title,
            "host": host,
        }
        self._sliders: dict[str, float] = {}
        self._clicks: dict[str, int] = {}
        self._holds: set[str] = set()
        self._held: set[str] = set()
        # When the process has spoken, and for how long the page had been silent then.
        self._heard = -math.inf, 0.0
        self._out = b""
        self._url = ""

    def __enter__(self) -> Self:
        self._companion = Companion("parapod.sims.lab.desk", json.dumps(self._beginning))
        self.process, self._pipe = self._companion.pid, self._companion.sink
        answer = json.loads(self._companion.answer(_BEGINNING) or b"{}")
        if "url" not in answer:
            self._companion.end(_ENDING)
            raise OutputError(
                f"the operator's page: {answer.get('error', 'does not begin')}", None
            )
        self._url = answer["url"]
        os.set_blocking(self._pipe, False)
        threading.Thread(target=self._listen, name="desk", daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._companion.end(_ENDING)

    def __repr__(self) -> str:
        return f"<operator's page at {self.web_url()}>"

    def web_url(self) -> str:
        """The address of the page."""
        return self._url

    def silence(self) -> float:
        """Time since something was heard of the page that operates [s]; infinite: never."""
        at, silence = self._heard
        return time.monotonic() - at + silence

    def show(self, readout: Readout, signals: Mapping[str, Any] | None = None) -> None:
        """Shows what the machine does from now on; left out while the process is busy.

        Args:
            readout: state and numbers.
            signals: signals by which the machine is drawn, by name.
        """
        if len(self._out) > _WAITING:
            self._write()
            return
        values = {name: np.asarray(value).tolist() for name, value in (signals or {}).items()}
        self._tell({"readout": asdict(readout), "signals": values})

    @property
    def controls(self) -> tuple[str, ...]:
        """Names of all sliders and buttons."""
        return (*self._sliders, *self._clicks, *sorted(self._holds))

    # Panel's names.

    def AddSlider(
        self,
        name: str,
        min: float,  # noqa: A002
        max: float,  # noqa: A002
        step: float,
        value: float,
    ) -> None:
        """See `Panel`."""
        self._sliders[name] = value
        self._call("AddSlider", name, min, max, step, value)

    def DeleteSlider(self, name: str, strict: bool = True) -> None:
        """See `Panel`."""
        if self._sliders.pop(name, None) is None and strict:
            raise KeyError(name)
        self._call("DeleteSlider", name, False)

    def GetSliderNames(self) -> list[str]:
        """See `Panel`."""
        return list(self._sliders)

    def GetSliderValue(self, name: str) -> float:
        """See `Panel`."""
        return self._sliders[name]

    def SetSliderRange(self, name: str, min: float, max: float) -> None:  # noqa: A002
        """See `Panel`."""
        self._call("SetSliderRange", name, min, max)

    def AddButton(self, name: str) -> None:
        """See `Panel`."""
        self._clicks[name] = 0
        self._call("AddButton", name)

    def DeleteButton(self, name: str, strict: bool = True) -> None:
        """See `Panel`."""
        if self._clicks.pop(name, None) is None and strict:
            raise KeyError(name)
        self._call("DeleteButton", name, False)

    def GetButtonClicks(self, name: str) -> int:
        """See `Panel`."""
        return self._clicks[name]

    def AddHold(self, name: str, key: str = "") -> None:
        """See `Panel`."""
        self._holds.add(name)
        self._call("AddHold", name, key)

    def DeleteHold(self, name: str, strict: bool = True) -> None:
        """See `Panel`."""
        if strict and name not in self._holds:
            raise KeyError(name)
        self._holds.discard(name)
        self._call("DeleteHold", name, False)

    def GetHoldNames(self) -> list[str]:
        """See `Panel`."""
        return sorted(self._holds)

    def IsHeld(self, name: str) -> bool:
        """See `Panel`; never while the page is silent, nor once its process has ended."""
        if name not in self._holds:
            raise KeyError(name)
        return not self.wrong and self.silence() < _STALE and name in self._held

    # The pipes.

    def _call(self, method: str, *arguments: Any) -> None:
        self._tell({"call": method, "with": arguments})

    def _tell(self, message: Mapping[str, Any]) -> None:
        self._out += _line(message)
        self._write()

    def _write(self) -> None:
        with suppress(BlockingIOError, BrokenPipeError):
            self._out = self._out[os.write(self._pipe, self._out) :]

    def _listen(self) -> None:
        """Takes over what the operator does, as long as the process serves."""
        for line in self._companion.lines():
            message = json.loads(line)
            if "error" in message:
                self.wrong = message["error"]
                return
            for mine, theirs in (
                (self._sliders, message["sliders"]),
                (self._clicks, message["clicks"]),
            ):
                mine.update((name, value) for name, value in theirs.items() if name in mine)
            self._held = set(message["held"])
            # The clock is the computer's, and the same in all its processes.
            self._heard = message["at"], message["silence"]
        self.wrong = "its process has ended"


def _packed(scenario: Any) -> str:
    """A scenario as text, with the usual drivers: others need not be known where pages are."""
    if hasattr(scenario, "hardware"):
        scenario = replace(scenario, hardware=type(scenario)().hardware)
    return base64.b64encode(pickle.dumps(scenario)).decode()


def _line(message: Mapping[str, Any]) -> bytes:
    return f"{json.dumps(message)}\n".encode()


# The other end.


def _serve(sink: int) -> None:
    """Serves the page until the pipe ends."""
    source, beginning, rest = read_beginning()
    panel, twin = _open(json.loads(beginning))
    os.write(sink, _line({"url": panel.web_url()}))
    spoken, is_over = time.monotonic(), False
    while not is_over:
        if select.select([source], [], [], max(0.0, spoken + _PERIOD - time.monotonic()))[0]:
            piece = os.read(source, PIECE)
            is_over = not piece
            *lines, rest = (rest + piece).split(b"\n")
            _obey(panel, twin, [json.loads(line) for line in lines])
        if time.monotonic() >= spoken + _PERIOD:
            spoken = time.monotonic()
            os.write(sink, _line(_operated(panel)))
    panel.close()


def _open(described: Mapping[str, str]) -> tuple[Panel, Any]:
    """The page, and what draws the machine."""
    from parapod.sims.lab.discovery import find_entry
    from parapod.sims.lab.runner import served_at

    experiment: Any = find_entry(described["experiment"]).load()
    scenario = pickle.loads(base64.b64decode(described["scenario"]))
    served_at.set(described["host"])
    meshcat = experiment.scene(scenario)
    machine = experiment.machine
    twin = machine.view.twin and machine.view.twin(meshcat, experiment.machine_scenario(scenario))
    return Panel(meshcat, described["title"], described["host"]), twin


def _obey(panel: Panel, twin: Any, messages: Sequence[Mapping[str, Any]]) -> None:
    visible = None
    for message in messages:
        if "call" in message:
            getattr(panel, message["call"])(*message["with"])
        else:
            visible = message
    if visible is None:
        return
    readout = visible["readout"]
    panel.show(Readout(**readout | {"rows": [Row(**row) for row in readout["rows"]]}))
    if twin is not None and visible["signals"]:
        twin.show({name: np.array(value) for name, value in visible["signals"].items()})


def _operated(panel: Panel) -> Mapping[str, Any]:
    """Everything that the operator does at this moment."""
    return {
        "at": time.monotonic(),
        "silence": panel.silence(),
        "sliders": {name: panel.GetSliderValue(name) for name in panel.GetSliderNames()},
        "clicks": {name: panel.GetButtonClicks(name) for name in panel.GetButtonNames()},
        "held": [name for name in panel.GetHoldNames() if panel.IsHeld(name)],
    }


def main() -> int:
    """Serves a page in a process of its own; its exit code."""
    sink = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # keeps stray prints out of the messages
    try:
        _serve(sink)
    except BrokenPipeError:
        return 0
    except Exception as error:
        with suppress(OSError):
            os.write(sink, _line({"error": " ".join(str(error).split()) or type(error).__name__}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
