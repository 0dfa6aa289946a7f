"""What every machine's station is, whatever stands behind its ports."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pydrake.systems.framework import Context, Diagram


@dataclass(frozen=True)
class Station[Scenario](ABC):
    """A machine seen through its ports.

    Attributes:
        diagram: the station; its ports are those of the machine's `ports` module.
        scenario: what it was built from.
    """

    diagram: Diagram
    scenario: Scenario

    @abstractmethod
    def reset(self, root_context: Context, scenario: Scenario | None = None) -> None:
        """Puts the station at its beginning.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: what a simulation begins with; None for what the station was built from.
        """

    @contextmanager
    def active(self) -> Iterator[None]:
        """While it lasts the machine obeys; a simulated one always does."""
        yield
