"""Ways to watch and record a run."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.sims.output.together import Together


class Loops:
    """Closed loops that have been built, each for all scenarios of its structure."""

    _MOST = 8  # loops that are kept: those of a machine's multibody plant take some 10 MB each

    def __init__(self) -> None:
        self._loops: dict[Hashable, ClosedLoop[Any]] = {}

    def loop(self, structure: Hashable, build: Callable[[], ClosedLoop[Any]]) -> ClosedLoop[Any]:
        """The loop of a structure, to be reset to a scenario.

        Args:
            structure: all that the loop is built from.
            build: builds it, if it is not there.
        """
        # The one that was used last comes last.
        loop = self._loops.pop(structure, None) or build()
        self._loops[structure] = loop
        if len(self._loops) > self._MOST:
            del self._loops[next(iter(self._loops))]
        return loop


@dataclass(frozen=True)
class RunOptions:
    """Ways to watch and record a run; none of them changes its numbers.

    Attributes:
        meshcat: true to show the machine in a browser.
        live: true to stay, with `meshcat`, after the run and let the viewer move the machine.
        html: file for a recording that plays in a browser, or None.
        log: file for the signals, or None.
        graphviz: file for the diagram in Graphviz's language, or None.
        console: console for progress and remarks.
        loops: closed loops of earlier runs, which serve scenarios of the same structure; None:
            each run builds its own.
        together: runs with which it may be simulated; None: it is simulated alone.
    """

    meshcat: bool = False
    live: bool = True
    html: Path | None = None
    log: Path | None = None
    graphviz: Path | None = None
    console: Console = field(default_factory=partial(Console, stderr=True))
    loops: Loops | None = None
    together: Together | None = None
