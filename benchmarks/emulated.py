"""The emulated machine in a process of its own, for benchmarks that drive it."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from parapod.diagrams.machine import Machine
from parapod.systems.hardware.emulation.harness import SharedHarness
from parapod.systems.hardware.position_memory import PositionMemory

_PARAPOD = (sys.executable, "-m", "parapod.sims")


class Emulated:
    """An emulated machine that runs.

    Attributes:
        folder: of its sockets, in the environment's PARAPOD_EMULATOR.
        wires: signals between its devices and its physics.
    """

    def __init__(self, machine: Machine[Any], folder: Path, process: "subprocess.Popen[str]"):
        self.folder, self._process = folder, process
        specs = (*machine.inputs, *machine.outputs)
        parts = sorted({d.part for d in machine.scenario().hardware.drivers})
        self.wires = SharedHarness(folder / "wires", {s.name: s.size for s in specs}, parts)
        self._said: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stderr is not None
        self._said += [line.strip() for line in iter(self._process.stderr.readline, "")]

    def misbehave(self, part: str, kind: str) -> None:
        """Tells the emulator what is to happen to a part."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{part} {kind}\n")
        self._process.stdin.flush()

    def parapod(self, *arguments: str) -> "subprocess.Popen[str]":
        """Begins `parapod` with these arguments."""
        pipe = subprocess.PIPE
        return subprocess.Popen([*_PARAPOD, *arguments], stdout=pipe, stderr=pipe, text=True)

    def remember(self, signal: str) -> None:
        """Measures the positions for the next program, as an operator does."""
        positions = self.wires.get(f"legs.{signal}")
        memory = PositionMemory(self.folder / f"{signal}s.json", len(positions), signal)
        memory.save(positions, are_measured=True)


@contextmanager
def emulated(machine: Machine[Any], *options: str) -> Iterator[Emulated]:
    """The emulated machine, in a folder of its own, while it lasts."""
    with tempfile.TemporaryDirectory(prefix="parapod") as folder:
        os.environ["PARAPOD_EMULATOR"] = folder
        pipe = subprocess.PIPE
        process = subprocess.Popen(
            [*_PARAPOD, "emulate", machine.experiment, *options],
            stdin=pipe,
            stderr=pipe,
            text=True,
        )
        assert process.stderr is not None
        try:
            if not any(line.startswith("ready") for line in iter(process.stderr.readline, "")):
                raise RuntimeError("the emulator does not begin")
            yield Emulated(machine, Path(folder), process)
        finally:
            process.terminate()
            process.wait()
            del os.environ["PARAPOD_EMULATOR"]


def until(condition: Callable[[], bool], longest: float) -> float:
    """Time until something holds [s]; infinite if it does not in time."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() > begun + longest:
            return float("inf")
        time.sleep(1e-3)
    return time.monotonic() - begun
