"""Ports of a machine, and what stands behind them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Context, InputPort, OutputPort

from parapod.systems.core.errors import WiringError
from parapod.systems.core.units import units_of


@dataclass(frozen=True)
class Span:
    """Plausible values of a signal, and the faults that it can have.

    Attributes:
        low: smallest plausible value, of garbage; one for all elements or one for each.
        high: largest plausible value; one for all elements or one for each.
        wrong: factor [-] and offset (in the port's unit) of a wrong value when a fault names none.
        off_value: value shown of a device that does not publish.
        is_binary: true if its values are 0 and 1.
        target: name of the signal in scenarios; "" for the port's own.
        only_whole: true if all elements fail together.
        ages: true if a late signal makes its part older in `status.age`.
    """

    low: float | tuple[float, ...]
    high: float | tuple[float, ...]
    wrong: tuple[float, float] = (1.0, 0.0)
    off_value: float = 0.0
    is_binary: bool = False
    target: str = ""
    only_whole: bool = False
    ages: bool = False


@dataclass(frozen=True)
class Port:
    """One signal of a machine.

    Attributes:
        name: `<part>.<signal>` at the station; any name elsewhere.
        size: number of elements; 0 for a signal whose size the declaration leaves open.
        unit: unit of all elements, or of each separated by commas, as `units_of` has it.
        meaning: one line.
        direction: "in" and "out" as the station has it; "truth" for what only a simulation
            knows; "inner" for signals of controller and commands.
        idle: value of an input that nothing drives.
        default: value of an output that may be missing, shown where it is; None: it must be there.
        faults: plausible values and faults; empty where faults are not injected.
        is_sampled: true if an input follows from the measurements of the controllers' instant at
            once, so that it counts at that instant alone. A simulated plant samples it; for
            devices, which take commands a moment later, the loop holds it. Other inputs are held
            by the controller.
        names: names of the values 0, 1, 2, ... of a signal that shows a phase.
        elements: names of the elements for people, such as ("roll", "pitch", "height"); of a
            state, whose further elements are rates, those of the first ones.
        twist: values by forward speed [m/s] and yaw rate [rad/s] of the machine, (size, 2), of
            what it drives on; empty: it does not follow from them.
    """

    name: str
    size: int
    unit: str
    meaning: str
    direction: Literal["in", "out", "truth", "inner"]
    idle: float = 0.0
    default: float | None = None
    faults: tuple[Span, ...] = ()
    is_sampled: bool = False
    names: tuple[str, ...] = ()
    elements: tuple[str, ...] = ()
    twist: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for what in ("name", "unit", "meaning"):
            if not getattr(self, what).strip():
                raise WiringError(f"port {self.name!r} of size {self.size} has no {what}")
        if self.size:
            try:
                units_of(self.unit, self.size)
            except ValueError as error:
                raise WiringError(f"port {self.name!r}: {error}") from None
            if self.elements and self.size % len(self.elements):
                count = len(self.elements)
                raise WiringError(f"port {self.name!r} has {self.size} elements and {count} names")
        if self.twist and len(self.twist) != self.size:
            count = len(self.twist)
            raise WiringError(f"port {self.name!r} has {self.size} elements and {count} by twist")

    @property
    def part(self) -> str:
        """Part that the signal belongs to: the name before the dot."""
        return self.name.partition(".")[0]

    @property
    def is_switch(self) -> bool:
        """Whether an input switches something; 1 is the safe side, as of a brake or a stop."""
        return self.direction == "in" and self.unit == "-"

    @property
    def neutral(self) -> float:
        """Value of an input while its part is neutral: a switch is on its safe side."""
        return 1.0 if self.is_switch else self.idle

    def element_name(self, element: int) -> str:
        """Name of an element for people; "" where the declaration has none."""
        count = len(self.elements)
        if element < count:
            return self.elements[element]
        return f"rate of {self.elements[element - count]}" if element < 2 * count else ""

    @property
    def limits(self) -> tuple[float, float] | None:
        """Smallest and largest plausible value, where it has some that hold for all elements."""
        for span in self.faults:
            ends = span.low, span.high
            if not span.is_binary and not any(isinstance(end, tuple) for end in ends):
                return float(np.min(span.low)), float(np.max(span.high))
        return None


def In(
    name: str,
    size: int,
    unit: str,
    meaning: str,
    *,
    idle: float = 0.0,
    faults: Sequence[Span] = (),
    is_sampled: bool = False,
    elements: Sequence[str] = (),
    twist: Sequence[tuple[float, float]] = (),
) -> Port:
    """Command to the machine, an input of its station."""
    return Port(
        *(name, size, unit, meaning, "in", idle, None, tuple(faults), is_sampled),
        elements=tuple(elements),
        twist=tuple(twist),
    )


def Out(
    name: str,
    size: int,
    unit: str,
    meaning: str,
    *,
    default: float | None = None,
    faults: Sequence[Span] = (),
    elements: Sequence[str] = (),
    twist: Sequence[tuple[float, float]] = (),
) -> Port:
    """Measurement, an output of the station."""
    return Port(
        *(name, size, unit, meaning, "out"),
        default=default,
        faults=tuple(faults),
        elements=tuple(elements),
        twist=tuple(twist),
    )


def Truth(name: str, size: int, unit: str, meaning: str, *, elements: Sequence[str] = ()) -> Port:
    """Output `truth.<name>` of a simulated station; controllers cannot see it."""
    return Port(f"truth.{name}", size, unit, meaning, "truth", elements=tuple(elements))


def Inner(
    name: str,
    unit: str,
    meaning: str,
    *,
    size: int = 0,
    faults: Sequence[Span] = (),
    names: Sequence[str] = (),
    elements: Sequence[str] = (),
) -> Port:
    """Signal of the controller or of a source of commands, named for logs and faults."""
    return Port(
        *(name, size, unit, meaning, "inner"),
        faults=tuple(faults),
        names=tuple(names),
        elements=tuple(elements),
    )


def _nothing(root_context: Context, scenario: Any) -> None:
    """The default context is the beginning already."""


@dataclass(frozen=True)
class Behind:
    """Part of a station behind its ports: a simulated plant, a mock or devices.

    Attributes:
        inputs: ports that take the commands, by the names of the machine's table.
        outputs: ports that give the measurements and, where simulated, `truth.*`; those that have
            a default may be left out.
        reset: puts it at the beginning of a scenario, in a root context at its defaults, which
            are the beginning of the scenario that it was built from.
        active: entered while the machine is to obey; simulated ones always do.
        between_steps: does what Drake lets no system do while it steps, such as locking a joint;
            to be called with the root context after each step of a simulation; None: nothing.
        handle: objects that experiments need to reach beside the ports; see `handle_as`.
    """

    inputs: Mapping[str, InputPort]
    outputs: Mapping[str, OutputPort]
    reset: Callable[[Context, Any], None] = _nothing
    active: Callable[[], AbstractContextManager[object]] = field(default=nullcontext)
    between_steps: Callable[[Context], None] | None = None
    handle: object = None

    def handle_as[H](self, kind: type[H]) -> H:
        """The handle, where it is of a kind.

        Raises:
            WiringError: the backend has a handle of another kind, or none.
        """
        if not isinstance(self.handle, kind):
            kind_found = type(self.handle).__name__ if self.handle is not None else "no handle"
            raise WiringError(
                f"this backend has {kind_found}, not {kind.__name__}, behind its ports"
            )
        return self.handle
