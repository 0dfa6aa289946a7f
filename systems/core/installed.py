"""Entry points of the packages that are installed, read again only where something has changed."""

import sys
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from pathlib import Path

type State = tuple[tuple[str, int], ...]


def installed(group: str) -> tuple[EntryPoint, ...]:
    """Entry points of a group.

    Each command asks for three or four groups, and each time a hundred files would be read.

    Args:
        group: name of the group, as `parapod.machines`.
    """
    return tuple(_all(state()).select(group=group))


def state() -> State:
    """Folders of modules, and when something last came to them or left them [ns]."""
    return tuple((folder, _modified(folder)) for folder in sys.path)


def _modified(folder: str) -> int:
    """Time of a folder's last change [ns]; 0 if there is none."""
    try:
        return Path(folder or ".").stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=1)
def _all(_state: State) -> EntryPoints:
    return entry_points()
