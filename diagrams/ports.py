"""What is known of a port of a station."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PortSpec:
    """One port of a station.

    Attributes:
        name: `<part>.<signal>`.
        size: number of elements.
        unit: unit of each element.
        meaning: one line.
    """

    name: str
    size: int
    unit: str
    meaning: str
