"""Entry points of the packages that are installed, read again only where something has changed."""

import sys
import warnings
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from pathlib import Path

type State = tuple[tuple[str, int], ...]

# Former and present spelling in names, which logs and scripts still hold; until 0.2.
_SPELLINGS = ("center", "centre")


def current_name(group: str, name: str) -> str:
    """Present name of what may be asked for by a former one, of which it warns (`FutureWarning`).

    Args:
        group: name of a group of entry points.
        name: name of one of them.
    """
    names, present = {point.name for point in installed(group)}, name.replace(*_SPELLINGS)
    if name in names or present not in names:
        return name
    warnings.warn(f"'{name}' is now called '{present}'", FutureWarning, stacklevel=3)
    return present


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
