"""Functions that are not called again with the arguments of the call before."""

from collections.abc import Callable
from typing import Any

from parapod.systems.core import rows


class Remembered[R]:
    """A pure function of lists of floats that keeps its last arguments with their result.

    Use it in a system that is evaluated anew at every step although its inputs often stay: Drake's
    cache goes by what may have changed, not by values. A machine that stands then costs a
    comparison. Nothing but the time that it takes depends on what was evaluated before.

    Arguments may also be what is frozen. Not for AutoDiffXd, whose comparison ignores
    derivatives. NaN is never what it was before.

    Args:
        function: called with the arguments; neither they nor the result may be changed afterwards.
            It must not know the system that holds it, which would never be freed.
    """

    def __init__(self, function: Callable[..., R]):
        self._function = function
        # In one piece, so that threads never see arguments with another result.
        self._last: tuple[tuple[Any, ...], R] | None = None

    def __call__(self, *arguments: Any) -> R:
        """The function's result."""
        if rows.at_work:  # numbers of rows cannot be compared as a whole
            return self._function(*arguments)
        if (last := self._last) is not None and last[0] == arguments:
            return last[1]
        result = self._function(*arguments)
        self._last = arguments, result
        return result
