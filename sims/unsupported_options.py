"""Options of a run that an experiment has nothing to answer with."""

from collections.abc import Iterable

from parapod.sims.experiment import RunOptions
from parapod.systems.core.errors import OutputError


def refuse_options(options: RunOptions, names: Iterable[str], why: str) -> None:
    """Refuses options before a run is spent on them.

    Args:
        options: as they were asked for.
        names: of the options that are refused.
        why: what follows the option's name.

    Raises:
        OutputError: one of them was asked for.
    """
    for name in names:
        if asked := getattr(options, name):
            # A switch names no file.
            raise OutputError(f"--{name} {why}", None if asked is True else asked)
