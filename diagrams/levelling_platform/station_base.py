"""What every station of the levelling platform is, whatever stands behind its ports."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pydrake.systems.framework import Context, Diagram

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.platform_model import PlatformModel


@dataclass(frozen=True)
class Station(ABC):
    """The machine seen through its ports.

    Attributes:
        diagram: the station; its ports are those of `parapod.diagrams.levelling_platform.ports`.
        scenario: what it was built from.
    """

    diagram: Diagram
    scenario: LevellingScenario

    @property
    def model(self) -> PlatformModel | None:
        """Bodies and joints of the plant; None where none are simulated."""
        return None

    @abstractmethod
    def reset(self, root_context: Context, scenario: LevellingScenario | None = None) -> None:
        """Puts the station at its beginning.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: what a simulation begins with; None for what the station was built from.
        """

    @contextmanager
    def active(self) -> Iterator[None]:
        """While it lasts the machine obeys; a simulated one always does."""
        yield
