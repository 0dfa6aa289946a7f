"""Parts of a real machine beside its drivers, its emulation, and how a machine is looked at."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import NDArray

from parapod.diagrams.guard import Guard
from parapod.diagrams.homing import Homing
from parapod.diagrams.twin import Twin


@dataclass(frozen=True)
class SelfTest:
    """Small move of one part, for the self-test of its devices.

    Attributes:
        command: signal of the part that is commanded.
        usual: command of a self-test for which nothing else is asked [unit of the command].
        largest: command that a self-test may give [unit of the command].
        measures: signal of the part that is the command's integral, or follows it.
        gain: rate of the measured signal by command.
        rest: further commands of the part's devices, for which it moves.
        is_position: true if the measured signal follows the command, which begins where it is;
            `usual` and `largest` are then rates of the command.
    """

    command: str
    usual: float
    largest: float
    measures: str
    gain: float = 1.0
    rest: Mapping[str, float] = field(default_factory=dict)
    is_position: bool = False


@dataclass(frozen=True)
class RealMachine[S]:
    """Parts of a real machine beside its drivers, and settings of its emulation.

    Attributes:
        self_tests: moves of a part for the self-test of its devices, by part.
        homings: rules by which the axes of a part find their reference, by part.
        fittings: settings of a part's drivers that follow from the machine's design, by part and
            name; see `Driver.fitted`.
        exchange: simulated backend -> period of the exchange with emulated devices [s]; empty:
            the machine is not emulated.
        by_devices: settings, by their dotted keys, of a plant behind emulated devices: what these
            simulate themselves is left out of it.
        cut: values of commands while the emergency stop is pressed, whatever is commanded: what
            it does to the drives' supply.
        drives: commands that reach motors through drives which are not devices of their own; the
            emulator has them misbehave as `drives`.
        switches: measurements of switches, which the emulator breaks both ways as `switches`.
        guard: makes what watches every job on the real machine; None: only devices are watched.
        instrument: formats the true signals, by name, as an instrument would show them
            beside the emulated machine; None: there is none.
    """

    self_tests: Mapping[str, SelfTest] = field(default_factory=dict)
    homings: Mapping[str, Homing] = field(default_factory=dict)
    fittings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    exchange: Mapping[str, float] = field(default_factory=dict)
    by_devices: Mapping[str, Any] = field(default_factory=dict)
    cut: Mapping[str, float] = field(default_factory=dict)
    drives: tuple[str, ...] = ()
    switches: tuple[str, ...] = ()
    guard: Callable[[S], Guard] | None = None
    instrument: Callable[[Mapping[str, NDArray[Any]]], str] | None = None

    def emulated(self, scenario: S, period: float) -> S:
        """The scenario of a plant behind emulated devices.

        Args:
            scenario: scenario of the machine; it stays as it is.
            period: time between two exchanges of the plant with them [s].
        """
        for key, value in {**self.by_devices, "control.period": period}.items():
            scenario = _replaced(scenario, key.split("."), value)
        return scenario


def _replaced(node: Any, keys: Sequence[str], value: Any) -> Any:
    """A part of a scenario with another value at a key."""
    name, *more = keys
    inner = _replaced(getattr(node, name), more, value) if more else value
    return replace(node, **{name: inner})


@dataclass(frozen=True)
class MachineView:
    """Drawing and plots by which a machine is looked at.

    Attributes:
        twin: draws the machine from its signals; None: it is not drawn.
        plots: usual plots of a recording, one above the other: `signal`, `signal[0]` or
            `signal[0:3]`, several joined by + in one plot; those that are not there are left out.
        log_every: periods of the controller between two samples of a recording.
    """

    twin: type[Twin] | None = None
    plots: tuple[str, ...] = ()
    log_every: int = 1
