"""One program for a device: two that command it in turns would each believe to be in control.

Serial ports can be locked, but a CAN interface, an SPI bus and an NI card take the commands of
several programs. Locks are files that the kernel unlocks when a program ends, however it ends.
Another computer that talks to the same gRPC server is not seen.
"""

import fcntl
import hashlib
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.places import normal_form

# Folder in which programs of all users find each other's locks.
_SHARED = Path("/run/lock")
# How long [s] and how often one waits for a program that only looks whether there is a lock.
_LOOK, _LOOKS = 5e-3, 10
_FLAGS = os.O_NOFOLLOW | os.O_CLOEXEC
# Of this program: file and number of users of each place, by its lock.
_held: dict[Path, tuple[int, int]] = {}
_guard = threading.Lock()


class InUse(ParapodError):
    """Another program has opened the same place; the text names it."""


@contextmanager
def only_program(place: str) -> Iterator[None]:
    """Keeps other programs of this computer from a place; within this one it is shared.

    Args:
        place: address of a device or of its bus, by any of its names, see `normal_form`; "":
            nothing is kept.

    Raises:
        InUse: another program keeps it.
    """
    if not place:
        yield
        return
    path = lock_path(place)  # now: a link may lead elsewhere in the end
    with _guard:
        file, users = _held.get(path, (-1, 0))
        _held[path] = (file if users else _locked(path), users + 1)
    try:
        yield
    finally:
        with _guard:
            file, users = _held.pop(path)
            if users > 1:
                _held[path] = (file, users - 1)
            else:
                with suppress(OSError):  # another user's file stays
                    path.unlink()
                os.close(file)


def is_kept(place: str) -> bool:
    """Whether a program keeps others from a place now."""
    try:
        file = os.open(lock_path(place), os.O_RDONLY | _FLAGS)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def lock_path(place: str) -> Path:
    """The file that is locked for a place, whatever its name; there while a program holds it."""
    folder = _SHARED if os.access(_SHARED, os.W_OK) else Path(tempfile.gettempdir())
    return folder / f"parapod-{hashlib.sha256(normal_form(place).encode()).hexdigest()[:16]}"


def _locked(path: Path) -> int:
    for _ in range(_LOOKS):
        file = _opened(path)
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_there(path, file):
                with suppress(OSError):  # another user's file: the lock holds all the same
                    os.ftruncate(file, 0)
                    os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
                return file
        owner = os.pread(file, 32, 0).decode(errors="replace").strip()
        os.close(file)
        time.sleep(_LOOK)
    who = f"process {owner}" if owner.isdigit() else "another program"
    raise InUse(f"{who} has it open; end that program first")


def _is_there(path: Path, file: int) -> bool:
    """Whether a file is still what its path leads to: who had it before may have removed it."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.stat(path), os.fstat(file))
    return False


def _opened(path: Path) -> int:
    """The file, opened however far it can be; never what a link leads to."""
    try:
        # Not with O_CREAT, which the kernel refuses for others' files in a folder that all share.
        return os.open(path, os.O_RDWR | _FLAGS)
    except FileNotFoundError:
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, 0o644)
        except FileExistsError:
            return _opened(path)
        os.fchmod(file, 0o644)  # whatever the umask is: others must see it
        return file
    except PermissionError:
        return os.open(path, os.O_RDONLY | _FLAGS)
