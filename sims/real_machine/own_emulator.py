"""An emulated machine in a process and a folder of its own, for a program that drives it."""

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from parapod.systems.core.errors import OutputError
from parapod.systems.hardware.addresses import VARIABLE

_PARAPOD = (sys.executable, "-m", "parapod.sims")
# How long it may take until its devices answer, and to end [s].
_BEGINNING, _ENDING = 90.0, 10.0


class OwnEmulator:
    """A running `parapod emulate`.

    Attributes:
        folder: folder of its sockets.
        process: the program.
        said: lines that it has printed on its standard error.
    """

    def __init__(self, name: str, folder: Path, options: Sequence[str]):
        """Begins the program; see `own_emulator`."""
        self.folder, self.said = folder, list[str]()
        self.process = subprocess.Popen(
            [*_PARAPOD, "emulate", name, *options],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {VARIABLE: str(folder)},
            start_new_session=True,  # Ctrl-C ends it after the program that drives its devices
        )
        self._ready = threading.Event()
        threading.Thread(target=self._listen, name="emulator", daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.strip())
            if line.startswith("ready"):
                self._ready.set()
        self._ready.set()

    def wait(self) -> None:
        """Waits until its devices answer.

        Raises:
            OutputError: it does not begin; has its words.
        """
        self._ready.wait(_BEGINNING)
        if not any(line.startswith("ready") for line in self.said):
            words = self.said[-1].removeprefix("parapod: error: ") if self.said else "no answer"
            raise OutputError(f"the emulator does not begin: {words}", None)

    def tell(self, part: str, kind: str) -> None:
        """Tells it what is to happen to a part."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{part} {kind}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        """Ends it."""
        self.process.terminate()
        try:
            self.process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@contextmanager
def own_emulator(name: str, *options: str) -> Iterator[OwnEmulator]:
    """An emulated machine while it lasts, and no longer than this program.

    Programs that this one starts, and this one, find it: its folder is in the environment.

    Args:
        name: experiment of the machine.
        options: further arguments of `parapod emulate`.

    Raises:
        OutputError: it does not begin, say because a driver's address is not the emulator's.
    """
    before = os.environ.get(VARIABLE)
    # A socket's path is short.
    with tempfile.TemporaryDirectory(prefix="pp", ignore_cleanup_errors=True) as folder:
        emulator = OwnEmulator(name, Path(folder), options)
        os.environ[VARIABLE] = folder
        try:
            emulator.wait()
            yield emulator
        finally:
            emulator.end()
            if before is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = before
