"""Addresses of the sockets and ports that the emulator of a machine makes for its devices."""

import getpass
import os
import stat
import tempfile
from pathlib import Path

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted_path

# Addresses that begin so are of devices in the emulator's directory.
PREFIX = "emulator/"
# The file of the wires between the emulated devices; there while the emulator runs.
WIRES = "wires"
VARIABLE = "PARAPOD_EMULATOR"


def emulator_directory() -> Path:
    """The folder named by the environment's PARAPOD_EMULATOR, or the user's own.

    Short, because a socket's path has at most some 100 characters.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named)
    run = os.environ.get("XDG_RUNTIME_DIR")
    if run and Path(run).is_dir():
        return Path(run) / "parapod-emulator"
    return Path(tempfile.gettempdir()) / f"parapod-emulator-{getpass.getuser()}"


def make_emulator_directory() -> Path:
    """The emulator's directory, made if it is not there: a real one, of this user alone.

    Raises:
        ScenarioError: another user may have made it, or may change it.
    """
    directory = emulator_directory()
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = os.lstat(directory)
    why = ""
    if stat.S_ISLNK(status.st_mode):
        why = "is a symbolic link"
    elif status.st_uid != os.geteuid():
        why = "belongs to another user"
    elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        why = "can be written by other users"
    if why:
        raise ScenarioError(
            f"the emulator's folder {quoted_path(directory)} {why}; remove it, or name another "
            f"one in the environment's {VARIABLE}"
        )
    return directory


def emulator_lock() -> str:
    """Name of the place that a running emulator keeps, see `only_program`."""
    return f"emulator in {os.path.realpath(emulator_directory())}"


def resolved(address: str) -> str:
    """An address with the emulator's directory in place of `emulator/`, also after `unix:`."""
    scheme = "unix:" if address.startswith("unix:") else ""
    path = address.removeprefix(scheme)
    if not path.startswith(PREFIX):
        return address
    return f"{scheme}{emulator_directory() / path.removeprefix(PREFIX)}"
