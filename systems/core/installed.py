"""Entry points of the packages that are installed, read again only where something has changed."""

import sys
import warnings
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from pathlib import Path

type State = tuple[tuple[str, int], ...]

# Former names of experiments and of a machine, which logs and scripts still hold; until 0.2.
_FORMER = {
    "center-locks": "centre-locks",
    "center-machining": "centre-machining",
    "center-walk": "centre-walk",
    "center-workspace": "centre-workspace",
    "machining_center": "machining_centre",
}


def current_name(name: str) -> str:
    """Present name of an experiment or a machine; warns of a former one (`FutureWarning`)."""
    if name not in _FORMER:
        return name
    warnings.warn(f"'{name}' is now called '{_FORMER[name]}'", FutureWarning, stacklevel=3)
    return _FORMER[name]


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
