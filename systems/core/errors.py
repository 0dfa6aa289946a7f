"""The one exception tree of parapod. Every error carries the data a caller needs to react."""

from collections.abc import Sequence
from typing import Any

from parapod.systems.core.quoting import printable


class ParapodError(Exception):
    """Base of every error that parapod raises on purpose; its text is one readable line."""

    def __init__(self, message: object = ""):
        super().__init__(printable(message))

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors cross from one process to another, whatever their constructors take.
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type, args: tuple[Any, ...], attributes: dict[str, Any]) -> Exception:
    error: Exception = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error


class UnreachablePosture(ParapodError):
    """A posture that the legs cannot take.

    Attributes:
        leg: number of the offending leg, counted from 1 as on the machine.
        extension: the extension that leg would need [m]; NaN if no extension would do.
        admissible: (smallest, largest) extension of that leg [m].
        missing: distance of the needed extension from the admissible range [m].
        index: index of the first offending posture in a batch, or None for a single one.
    """

    def __init__(
        self,
        leg: int,
        extension: float,
        admissible: tuple[float, float],
        index: tuple[int, ...] | None = None,
        hint: str = "",
    ):
        self.leg = leg
        self.extension = extension
        self.admissible = admissible
        self.index = index
        low, high = admissible
        self.missing = max(low - extension, extension - high)
        where = "" if index is None else f"posture {list(index)}: "
        stroke = f"{1e3 * low:.1f}..{1e3 * high:.1f} mm"
        if extension == extension:
            text = (
                f"leg {leg} would need an extension of {1e3 * extension:.2f} mm, "
                f"{1e3 * self.missing:.2f} mm outside its stroke {stroke}"
            )
        else:
            text = f"leg {leg} cannot reach the ground with any extension (its stroke is {stroke})"
        super().__init__(where + text + hint)


class RefusedRequest(ParapodError):
    """Something asked of a machine that it does not do; it stays as it is.

    Attributes:
        phase: phase in which the machine was, and still is.
    """

    def __init__(self, message: str, phase: str):
        self.phase = phase
        super().__init__(f"{message}; the machine stays in {phase}")


class UndeterminedCalibration(ParapodError):
    """A recording that leaves open what a calibration asks.

    Attributes:
        directions: parameters that are not determined, each one or a few that change together.
        advice: poses that would determine it.
    """

    # More than these make no line that anybody reads; the attributes have them all.
    _SHOWN = 5

    def __init__(self, directions: Sequence[str], advice: Sequence[str]):
        self.directions = tuple(directions)
        self.advice = tuple(advice)
        listed_directions = list(self.directions[: self._SHOWN])
        more = len(self.directions) - len(listed_directions)
        if more:
            listed_directions.append(f"and {more} more")
        super().__init__(
            f"the recording does not determine {'; '.join(listed_directions)} "
            f"(what helps: {'; '.join(self.advice)})"
        )


class ScenarioError(ParapodError):
    """A scenario that cannot be used: unknown key, value that is not allowed, unreadable file.

    Attributes:
        key: dotted name of the offending key, as in "ground.pitch_deg"; "" if there is none.
    """

    def __init__(self, message: str, key: str = ""):
        self.key = key
        super().__init__(message)


class OutputError(ParapodError):
    """A file of results that cannot be written, or that cannot be read back.

    Attributes:
        path: the file, or None.
    """

    def __init__(self, message: str, path: object = None):
        self.path = path
        super().__init__(message)


class WiringError(ParapodError):
    """Ports that cannot be connected; the text names both."""


class MissingExtra(ParapodError):
    """A library that is needed for a part, and that is not installed.

    Attributes:
        module: module that cannot be imported.
        extra: the extra of parapod that brings it.
    """

    def __init__(self, module: str, extra: str, reason: str):
        self.module, self.extra = module, extra
        super().__init__(
            f"{module} is needed and cannot be imported: {' '.join(reason.split())}; "
            f'install it with: pip install "parapod[{extra}]"'
        )
