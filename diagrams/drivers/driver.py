"""The root of all drivers, and the refusals that they share.

A driver's device and emulator are imported when they are made: a scenario that names drivers
needs none of their libraries, and loads none of their code.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import escaped, quoted_path
from parapod.systems.core.schema import Variant
from parapod.systems.hardware.addresses import (
    emulator_directory,
    emulator_lock,
    resolved,
)

if TYPE_CHECKING:
    from parapod.systems.hardware.clock import EmulatedClock
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass(frozen=True)
class PartPorts:
    """The signals of one part of a station, with their sizes.

    A device may have signals of other parts besides, by the whole names of their ports, such as
    "locks.closed" of a device of the legs.

    Attributes:
        measures: signals that the station shows.
        commands: signals that the station takes.
        switches: those of the commands that are switches; 1 is the safe side of each.
        units: units of signals, as the ports declare them.
    """

    measures: Mapping[str, int]
    commands: Mapping[str, int]
    switches: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Driver(Variant):
    """Root of the drivers; a dataclass derived from it can be named in any scenario.

    Its fields are the keys of the scenario, with `parapod.systems.core.schema.quantity` and
    `choice` for what is admissible, in the units in which people give them. Nothing is opened and
    no library imported before the device is configured.

    Attributes:
        part: part of the machine, as in the names of its ports.
        is_timeless: true if the device has no time of its own, as one that is not fitted.
        is_program: true if a program has the place of the device, which serves all such parts.
    """

    is_timeless: ClassVar[bool] = False
    is_program: ClassVar[bool] = False

    others = "those of your own come with --drivers FILE, or with a package's parapod.drivers"

    part: str = ""

    @property
    def is_emulated(self) -> bool:
        """Whether its address is one at which an emulator of this computer answers."""
        return bool(_emulated_addresses(self))

    def fitted(self, usual: Mapping[str, Any]) -> Self:
        """The driver with settings of its machine where it leaves them out.

        Args:
            usual: settings by the names of fields; each takes the place of null and of an empty
                list.
        """
        fields = vars(self)
        own = {name: v for name, v in usual.items() if fields.get(name, v) in _OPEN}
        return replace(self, **own) if own else self

    def make(self, ports: PartPorts) -> "Device":
        """The device, not configured yet.

        Args:
            ports: ports of the part; the device may stand behind all of them or some, and behind
                those of other parts.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define make")

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """Emulate the device at the same address while the context lasts.

        Args:
            harness: wires to the simulated machine.
            misbehaviour: faults of the emulated device.

        Raises:
            ScenarioError: there is no emulator of this device, or its address is a real one.
        """
        raise ScenarioError(
            f"hardware.drivers: !{type(self).__name__} has no emulator", "hardware.drivers"
        )


# Values that stand for a setting that follows from the machine.
_OPEN: tuple[Any, ...] = (None, [])


def emulated(address: str, key: str) -> str:
    """The resolved address of a device that is to be emulated.

    Args:
        address: address in the scenario.
        key: tag and field of the driver.

    Raises:
        ScenarioError: it is not in the emulator's directory.
    """
    path = resolved(address)
    if path == address:
        raise ScenarioError(
            f"{key} = {escaped(address)} is not an address of the emulator, which begin with "
            "emulator/",
            key,
        )
    return path


@contextmanager
def time_of(drivers: Sequence[Driver], experiment: str) -> Iterator["EmulatedClock | None"]:
    """Go by the time of the drivers' devices: the emulator's, where it keeps one.

    Args:
        drivers: drivers of the machine, or of a part of it.
        experiment: experiment that names the machine to `parapod emulate`.

    Yields the emulator's clock; None: the devices go by the computer's.

    Raises:
        ScenarioError: see `refuse_without_emulator`; or real devices beside emulated ones whose
            time is not the computer's.
    """
    from parapod.systems.hardware.clock import CLOCK, following

    refuse_without_emulator(drivers, experiment)
    own = [driver for driver in drivers if not driver.is_timeless]
    real = [driver for driver in own if not driver.is_emulated]
    if len(real) == len(own):
        yield None
        return
    with following(emulator_directory() / CLOCK) as clock, ExitStack() as stack:
        if clock is None:
            yield None
            return
        stack.callback(clock.release)
        if real:
            tag = f"!{type(real[0]).__name__} of {escaped(real[0].part)}"
            raise ScenarioError(
                f"hardware.drivers: {tag} is a real device beside emulated ones, which go by a "
                f"time of their own: begin `parapod emulate {experiment} --rate 1`",
                "hardware.drivers",
            )
        yield clock


def _emulated_addresses(driver: Driver) -> dict[str, str]:
    """Fields of a driver that are addresses of the emulator, by their names."""
    fields = vars(driver).items()
    return {
        key: value for key, value in fields if isinstance(value, str) and resolved(value) != value
    }


@contextmanager
def named(driver: Driver) -> Iterator[None]:
    """Name the driver whose settings do not fit together.

    Raises:
        ScenarioError: in place of a ValueError.
    """
    try:
        yield
    except ValueError as error:
        text = f"hardware.drivers: !{type(driver).__name__} of {escaped(driver.part)}: {error}"
        raise ScenarioError(text, "hardware.drivers") from None


def refuse_without_emulator(drivers: Sequence[Driver], experiment: str) -> None:
    """Refuse addresses of the emulator while none runs.

    Args:
        drivers: drivers of the machine.
        experiment: experiment that names the machine to `parapod emulate`.

    Raises:
        ScenarioError: a driver has such an address, and no emulator runs.
    """
    from parapod.systems.hardware.exclusive import is_kept

    if is_kept(emulator_lock()):
        return
    directory = emulator_directory()
    for driver in drivers:
        for key, value in _emulated_addresses(driver).items():
            raise ScenarioError(
                f"!{type(driver).__name__}.{key} = {escaped(value)}, but no emulator runs in "
                f"{quoted_path(directory)}: begin `parapod emulate {experiment}` in another "
                "terminal, or name your own devices under hardware.drivers",
                "hardware.drivers",
            )
