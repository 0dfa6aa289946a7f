"""Source of Gaussian noise that a seed determines, in any context and on any computer."""

import functools
import math
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.rows import Rows, array_of, by_library

# Numbers that are computed at once: of fewer the calls take longer than the numbers.
_BLOCK = 6144
_KEPT_BLOCKS = 8  # for contexts of one seed that are at different times
_KEPT_STREAMS = 16
_KEPT_MANY = 2  # sets of seeds, one a machine
_SAME_INSTANT = 1e-6  # [periods]
_BELOW_ONE = math.nextafter(1.0, 0.0)


class NoiseSource(LeafSystem):
    """Source of unit Gaussian white noise, a pure function of its seed and of time.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `noise` | n | - | the last sample |

    The numbers are those of Drake's `RandomSource` after `SetRandomContext` with a
    `RandomGenerator` of this seed, to the last bit where the logarithm of the C library is the
    same. Unlike that, the default context has a seed, which is the constructor's, and a sample
    needs no unrestricted update, for which Drake would copy the state of the whole diagram.

    Sample 0 is shown until initialization, sample 1 from there to the first instant, at zero, and
    sample k + 2 after k periods: a discrete system that updates at an initialization and once a
    period sees each sample once.

    State: discrete, the last sample (n), updated at initialization and every period.

    Parameters (Context): the seed (1), see `set_seed`.
    """

    def __init__(self, size: int = 1, period: float = 0.01, seed: int = 0) -> None:
        """Creates the source.

        Args:
            size: number of elements n.
            period: time between two samples [s].
            seed: seed in a default context, in 0..2^32 - 1.

        Raises:
            ValueError: a period that is not above zero, or a seed that is out of range.
        """
        super().__init__()
        if not 0.0 < period < math.inf:
            raise ValueError(f"period must be above 0, not {period}")
        self.set_name("noise_source")
        self._size, self._period = size, period
        self._seed = self.DeclareNumericParameter(BasicVector(np.array([_checked(seed)])))
        self.DeclareStateOutputPort(
            "noise", self.DeclareDiscreteState(noise_sample(seed, 0, size))
        )
        self.DeclareInitializationDiscreteUpdateEvent(self._update_first_sample)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_sample)

    def set_seed(self, context: Context, seed: int) -> None:
        """Begins the sequence of a seed, in 0..2^32 - 1, in this context of the source.

        Raises:
            ValueError: a seed that is out of range.
        """
        parameter = context.get_mutable_numeric_parameter(self._seed)
        parameter.SetFromVector(np.array([_checked(seed)]))
        context.SetDiscreteState(noise_sample(seed, 0, self._size))

    def _update_first_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        # The one that the next periodic update takes the place of.
        self._show(context, discrete_state, 1 + math.ceil(self._periods(context) - _SAME_INSTANT))

    def _update_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._show(context, discrete_state, 2 + round(self._periods(context)))

    def _periods(self, context: Context) -> float:
        return context.get_time() / self._period

    def _show(self, context: Context, discrete_state: DiscreteValues, number: int) -> None:
        seed = context.get_numeric_parameter(self._seed)[0]
        if type(seed) is Rows:
            samples = _streams(seed.values.tobytes(), self._size).samples(number)
            discrete_state.set_value(array_of(list(map(Rows, samples))))
        else:
            discrete_state.set_value(noise_sample(int(seed), number, self._size))


def noise_sample(seed: int, number: int, size: int) -> NDArray[np.float64]:
    """Sample (size) of a number, counted from 0, of the sequence of a seed; not to be changed."""
    return _stream(seed, size).sample(number)


class _Stream:
    """The samples of one seed: the newest blocks are kept, those that are gone computed anew.

    C++ leaves the algorithm of its normal distribution open; this is libstdc++'s, the polar
    method on two 53-bit fractions, each made of two words of the Mersenne Twister.
    """

    def __init__(self, seed: int, size: int):
        self._seed, self._size = seed, size
        self._length = _length_of_block(size)
        self._lock = Lock()
        self._restart()

    def sample(self, number: int) -> NDArray[np.float64]:
        place, row = divmod(number, self._length)
        if (kept := self._blocks.get(place)) is not None:
            return kept[row]
        with self._lock:
            if place < self._next and place not in self._blocks:
                self._restart()
            while place >= self._next:
                block = self._following()
                block.setflags(write=False)
                self._blocks[self._next - 1] = block
                self._blocks.pop(self._next - 1 - _KEPT_BLOCKS, None)
            return self._blocks[place][row]

    def block(self, place: int) -> NDArray[np.float64]:
        """A block (samples, size), which is not kept."""
        if place < self._next:
            self._restart()
        while place > self._next:
            self._following()
        return self._following()

    def _restart(self) -> None:
        # A source of Drake draws the seed of its own generator from the one that it is given.
        own = int(_words(np.random.RandomState(self._seed), 1)[0])
        self._generator = np.random.RandomState(own)
        self._rest: NDArray[np.float64] = np.empty(0)
        self._blocks: dict[int, NDArray[np.float64]] = {}
        self._next = 0

    def _following(self) -> NDArray[np.float64]:
        """Computes the next block."""
        count = self._length * self._size
        parts, missing = [self._rest], count - self._rest.size
        while missing > 0:
            parts.append(_normals(self._generator, missing))
            missing -= parts[-1].size
        numbers = np.concatenate(parts)
        self._rest = numbers[count:]
        self._next += 1
        return numbers[:count].reshape(self._length, self._size)


class _Streams:
    """The samples of many seeds, of which the newest block is kept."""

    def __init__(self, seeds: NDArray[np.float64], size: int):
        self._streams = [_Stream(int(seed), size) for seed in seeds]
        self._length = _length_of_block(size)
        self._place, self._block = -1, np.empty((self._length, size, len(seeds)))

    def samples(self, number: int) -> NDArray[np.float64]:
        """The sample (size, seeds) of a number; not to be changed."""
        place, row = divmod(number, self._length)
        if place != self._place:
            blocks = [stream.block(place) for stream in self._streams]
            self._place, self._block = place, np.stack(blocks, axis=-1)
        sample: NDArray[np.float64] = self._block[row]
        return sample


def _length_of_block(size: int) -> int:
    return max(1, _BLOCK // size)


@functools.lru_cache(maxsize=_KEPT_MANY)
def _streams(seeds: bytes, size: int) -> _Streams:
    return _Streams(np.frombuffer(seeds), size)


@functools.lru_cache(maxsize=_KEPT_STREAMS)
def _stream(seed: int, size: int) -> _Stream:
    return _Stream(seed, size)


def _normals(generator: np.random.RandomState, count: int) -> NDArray[np.float64]:
    """Further normal numbers, about as many as wanted."""
    # Every pair of fractions gives two of them, or with a probability of 1 - pi / 4 none.
    words = _words(generator, 4 * (count * 2 // 3 + 8)).astype("<u4", copy=False)
    points = words.view("<u8").astype(np.float64)
    points *= 2.0**-64
    np.minimum(points, _BELOW_ONE, out=points)
    points *= 2.0
    points -= 1.0
    x, y = points[::2], points[1::2]
    squares = x * x + y * y
    inside = np.flatnonzero((squares <= 1.0) & (squares != 0.0))
    squares = squares[inside]
    logarithms = by_library(math.log, squares)
    factors = np.sqrt(-2.0 * logarithms / squares)
    numbers = np.empty(2 * inside.size)
    np.multiply(y[inside], factors, out=numbers[::2])
    np.multiply(x[inside], factors, out=numbers[1::2])
    return numbers


def _words(generator: np.random.RandomState, count: int) -> NDArray[np.uint32]:
    """The next 32-bit words of a Mersenne Twister."""
    return generator.randint(0, 2**32, size=count, dtype=np.uint32)


def _checked(seed: int) -> float:
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed must be in 0..{2**32 - 1}, not {seed}")
    return float(seed)
