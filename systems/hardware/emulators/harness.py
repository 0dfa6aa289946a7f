"""The wires between emulated devices and the machine that is simulated behind them."""

from collections.abc import Mapping, Sequence


class Harness:
    """The newest value of every signal, by its port's name, shared between threads.

    Values are tuples that are swapped whole, so a reader never sees half of one.
    """

    def __init__(self, sizes: Mapping[str, int]):
        """Creates wires at zero.

        Args:
            sizes: the number of elements of each signal, by its port's name.
        """
        self._values: dict[str, tuple[float, ...]] = {
            name: (0.0,) * size for name, size in sizes.items()
        }

    def get(self, name: str) -> tuple[float, ...]:
        """The newest value of a signal."""
        return self._values[name]

    def set(self, name: str, values: Sequence[float]) -> None:
        """Puts a value on the wires.

        Raises:
            ValueError: another number of elements than the signal has.
        """
        size = len(self._values[name])
        if len(values) != size:
            raise ValueError(f"{name} has {size} elements, not {len(values)}")
        self._values[name] = tuple(float(value) for value in values)


class MutedHarness(Harness):
    """Wires of which a device is cut off from some: what it sets on them is lost."""

    def __init__(self, harness: Harness, muted: Sequence[str]):
        """Cuts wires.

        Args:
            harness: the wires.
            muted: the signals that are not to be set.
        """
        self._harness, self._muted = harness, frozenset(muted)

    def get(self, name: str) -> tuple[float, ...]:
        """See `Harness`."""
        return self._harness.get(name)

    def set(self, name: str, values: Sequence[float]) -> None:
        """See `Harness`."""
        if name not in self._muted:
            self._harness.set(name, values)
