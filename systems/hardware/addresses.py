"""Addresses of the sockets and ports that the emulator of a machine makes for its devices."""

import getpass
import os
import tempfile
from pathlib import Path

# Addresses that begin so are of devices in the emulator's directory.
PREFIX = "emulator/"
# The file of the wires between the emulated devices; there while the emulator runs.
WIRES = "wires"
_VARIABLE = "PARAPOD_EMULATOR"


def emulator_directory() -> Path:
    """The folder named by the environment's PARAPOD_EMULATOR, or the user's own.

    Short, because a socket's path has at most some 100 characters.
    """
    named = os.environ.get(_VARIABLE)
    if named:
        return Path(named)
    run = os.environ.get("XDG_RUNTIME_DIR")
    if run and Path(run).is_dir():
        return Path(run) / "parapod-emulator"
    return Path(tempfile.gettempdir()) / f"parapod-emulator-{getpass.getuser()}"


def resolved(address: str) -> str:
    """An address with the emulator's directory in place of `emulator/`, also after `unix:`."""
    scheme = "unix:" if address.startswith("unix:") else ""
    path = address.removeprefix(scheme)
    if not path.startswith(PREFIX):
        return address
    return f"{scheme}{emulator_directory() / path.removeprefix(PREFIX)}"
