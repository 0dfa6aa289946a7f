"""The emulated machine in a process of its own, for benchmarks that drive it."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from parapod.diagrams.machine import Machine
from parapod.sims.real_machine.own_emulator import OwnEmulator, own_emulator
from parapod.systems.hardware.addresses import WIRES
from parapod.systems.hardware.emulation.harness import SharedHarness
from parapod.systems.hardware.position_memory import PositionMemory

_PARAPOD = (sys.executable, "-m", "parapod.sims")


class Program:
    """A running `parapod`.

    Attributes:
        process: the program.
        said: lines that it has printed on its standard error.
    """

    def __init__(self, *arguments: str):
        pipe = subprocess.PIPE
        self.said: list[str] = []
        self.process = subprocess.Popen(
            [*_PARAPOD, *arguments], stdout=subprocess.DEVNULL, stderr=pipe, text=True
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        self.said += (line.strip() for line in self.process.stderr if line.strip())

    @property
    def has_ended(self) -> bool:
        return self.process.poll() is not None

    def wait(self, longest: float) -> int:
        """Exit code; what does not end in time is killed and has none."""
        try:
            code = self.process.wait(longest)
        except subprocess.TimeoutExpired:
            self.kill()
            raise TimeoutError(f"the program does not end within {longest:g} s") from None
        self._thread.join(1.0)
        return code

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    @property
    def last_words(self) -> str:
        return self.said[-1].removeprefix("parapod: error: ") if self.said else ""

    def word(self, words: str) -> str:
        """First line with these words; "" if there is none."""
        return next((line for line in self.said if words in line), "")

    def companion(self, module: str) -> int:
        """Number of the process of its own in which it runs a module.

        Raises:
            LookupError: there is none.
        """
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        for pid in map(int, children.read_text().split()):
            with suppress(OSError):
                if module in Path(f"/proc/{pid}/cmdline").read_text().split("\0"):
                    return pid
        raise LookupError(f"the program has no process for {module}")


class Emulated:
    """An emulated machine that runs.

    Attributes:
        folder: of its sockets, in the environment's PARAPOD_EMULATOR.
        wires: signals between its devices and its physics.
        process: the emulator.
    """

    def __init__(self, machine: Machine[Any], emulator: OwnEmulator):
        self.folder, self.process, self._emulator = emulator.folder, emulator.process, emulator
        specs = (*machine.inputs, *machine.outputs)
        self.wires = SharedHarness(self.folder / WIRES, {s.name: s.size for s in specs}, ())

    def misbehave(self, part: str, kind: str) -> None:
        """Tells the emulator what is to happen to a part; returns when it does."""
        count, line = len(self._emulator.said), f"{part} {kind}"
        self._emulator.tell(part, kind)
        said = self._emulator.said
        if until(lambda: any(text.endswith(line) for text in said[count:]), 5.0) == float("inf"):
            raise RuntimeError(f"the emulator does not do '{line}': {said[count:]}")

    def remember(self, signal: str) -> None:
        """Measures the positions for the next program, as an operator does."""
        positions = self.wires.get(f"legs.{signal}")
        memory = PositionMemory(self.folder / f"{signal}s.json", len(positions), signal)
        memory.save(positions, "measured by hand")


@contextmanager
def emulated(machine: Machine[Any], *options: str, experiment: str = "") -> Iterator[Emulated]:
    """The emulated machine, in a folder of its own, while it lasts."""
    # In the computer's own time, by which benchmarks judge.
    with own_emulator(experiment or machine.experiment, "--rate=1", *options) as emulator:
        yield Emulated(machine, emulator)


def until(condition: Callable[[], bool], longest: float) -> float:
    """Time until something holds [s]; infinite if it does not in time."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() > begun + longest:
            return float("inf")
        time.sleep(1e-3)
    return time.monotonic() - begun


def until_for_good(condition: Callable[[], bool], lasting: float, longest: float) -> float:
    """Time until something begins to hold for a while [s]; infinite if it does not in time."""
    begun = time.monotonic()
    since: float | None = None
    while (now := time.monotonic()) < begun + longest:
        if not condition():
            since = None
        elif since is None:
            since = now
        elif now > since + lasting:
            return since - begun
        time.sleep(1e-3)
    return float("inf")
