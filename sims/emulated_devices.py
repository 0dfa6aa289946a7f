"""Emulated devices, each in a process of its own."""

import multiprocessing
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

from parapod.diagrams.drivers.driver import Driver
from parapod.sims.real_time import SWITCH_INTERVAL, take_priority
from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError
from parapod.systems.hardware.emulation.harness import SharedHarness

# How long a process may take until its device answers: Drake is imported in each [s].
_TIMEOUT = 60.0
# How long it may take to end [s].
_ENDING = 5.0
_READY = "ready"


@contextmanager
def emulated_devices(
    drivers: Sequence[Driver], path: Path, sizes: dict[str, int], parts: Sequence[str], seed: int
) -> Iterator[None]:
    """While it lasts the drivers' devices are emulated.

    Each has a process: a real device does not wait for another one, and neither should these for
    Python's interpreter lock. They end with this process, however it ends.

    Args:
        drivers: whose devices are emulated.
        path: of the wires, see `SharedHarness`; there already.
        sizes: of the signals on them.
        parts: whose misbehaviours they have.
        seed: of garbage.

    Raises:
        ScenarioError: a driver has no emulator, or an address that is not the emulator's.
        OutputError: an emulator cannot begin.
    """
    context = multiprocessing.get_context("spawn")
    processes: list[tuple[SpawnProcess, Connection]] = []
    try:
        for driver in drivers:
            ours, theirs = context.Pipe()
            name = f"{type(driver).__name__} ({driver.part})"
            process = context.Process(
                target=_serve,
                args=(driver, path, sizes, parts, seed, theirs),
                name=name,
                daemon=True,
            )
            process.start()
            theirs.close()
            processes.append((process, ours))
        for process, connection in processes:
            _wait_for(process.name, connection)
        yield
    finally:
        for _, connection in processes:
            connection.close()
        for process, _ in processes:
            process.join(_ENDING)
            if process.is_alive():
                process.kill()


def _wait_for(name: str, connection: Connection) -> None:
    try:
        answer = connection.recv() if connection.poll(_TIMEOUT) else "does not begin"
    except EOFError:
        answer = "has ended at once"
    if isinstance(answer, ParapodError):
        raise answer
    if answer != _READY:
        raise OutputError(f"the emulator of {name}: {answer}")


def _serve(
    driver: Driver,
    path: Path,
    sizes: dict[str, int],
    parts: Sequence[str],
    seed: int,
    connection: Connection,
) -> None:
    """Emulates one device until the other end of the connection is closed."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    take_priority()  # a real device waits for no other program
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for all; the first process ends us
    try:
        harness = SharedHarness(path, sizes, parts)
        with driver.emulate(harness, harness.misbehaviour(driver.part, seed)):
            _tell(connection, _READY)
            connection.poll(None)
    except ScenarioError as error:
        _tell(connection, error)
    except (ParapodError, OSError) as error:
        _tell(connection, " ".join(str(error).split()))


def _tell(connection: Connection, answer: object) -> None:
    """Answers, unless nobody listens any more: another device has refused already."""
    with suppress(ConnectionError):
        connection.send(answer)
