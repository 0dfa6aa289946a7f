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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from parapod.systems.core.errors import ParapodError

# Where programs of all users find each other's locks.
_SHARED = Path("/run/lock")
_FLAGS = os.O_NOFOLLOW | os.O_CLOEXEC
# Of this program: file and number of users of each place.
_held: dict[str, tuple[int, int]] = {}
_guard = threading.Lock()


class InUse(ParapodError):
    """Another program has opened the same place; the text names it."""


@contextmanager
def only_program(place: str) -> Iterator[None]:
    """Keeps other programs of this computer from a place; within this one it is shared.

    Args:
        place: address of a device or of its bus, as this computer names it; "": nothing is kept.

    Raises:
        InUse: another program keeps it.
    """
    if not place:
        yield
        return
    with _guard:
        file, users = _held.get(place, (-1, 0))
        _held[place] = (file if users else _locked(place), users + 1)
    try:
        yield
    finally:
        with _guard:
            file, users = _held.pop(place)
            if users > 1:
                _held[place] = (file, users - 1)
            else:
                os.close(file)


def lock_path(place: str) -> Path:
    """The file that is locked for a place."""
    folder = _SHARED if os.access(_SHARED, os.W_OK) else Path(tempfile.gettempdir())
    return folder / f"parapod-{hashlib.sha256(place.encode()).hexdigest()[:16]}"


def _locked(place: str) -> int:
    path = lock_path(place)
    file = _opened(path)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        owner = os.pread(file, 32, 0).decode(errors="replace").strip()
        os.close(file)
        who = f"process {owner}" if owner.isdigit() else "another program"
        raise InUse(f"{who} has it open; end that program first") from None
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    except OSError:
        pass  # another user's file: the lock holds all the same
    return file


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
