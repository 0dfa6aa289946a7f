"""Input shaping: commands that leave flexible modes at rest.

A command that is convolved with a few impulses moves a mode in parts whose vibrations cancel. That
needs no feedback, and it delays the command by half a period of the vibration or by a whole one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, DiscreteValues
from scipy.optimize import root  # type: ignore[import-untyped]

from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.quoting import quoted

type ShaperKind = Literal["zv", "zvd", "ei"]

# Ranges of extra insensitive shapers: their impulses stay positive, and their conditions solvable.
_TOLERANCES, _LARGEST_DAMPING = (1e-3, 0.2), 0.3
_DAMPING_STEP = 0.05  # steps from the solution without damping to the one with it


@dataclass(frozen=True)
class Shaper:
    """Positive impulses, with which a command is convolved.

    Sources: Smith, "Posicast control of damped oscillatory systems", 1957 (two impulses); Singer
    and Seering, "Preshaping command inputs to reduce system vibration", 1990 (ZV, ZVD, residual);
    Singhose, Seering and Singer, "Residual vibration reduction using vector diagrams to generate
    shaped inputs", 1994 (EI).

    Attributes:
        times: times (k) of the impulses, the first at zero, ascending [s].
        amplitudes: shares (k) of the command, all positive; their sum is 1 [-].
    """

    times: tuple[float, ...] = (0.0,)
    amplitudes: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        steps = np.diff(self.times)
        if not (
            0 < len(self.times) == len(self.amplitudes)
            and self.times[0] == 0.0
            and (steps >= 0.0).all()
            and math.isfinite(self.times[-1])
        ):
            raise ValueError(
                f"times must ascend from 0 and be as many as amplitudes, not {self.times}"
            )
        if not (min(self.amplitudes) > 0.0 and abs(sum(self.amplitudes) - 1.0) < 1e-9):
            raise ValueError(f"amplitudes must be positive with sum 1, not {self.amplitudes}")

    @classmethod
    def zv(cls, frequency: float, damping_ratio: float = 0.0) -> Self:
        """Zero vibration: two impulses, half a period of the vibration apart.

        Args:
            frequency: natural frequency of the mode, undamped [rad/s].
            damping_ratio: damping ratio of the mode, below 1 [-].

        Raises:
            ValueError: a frequency or damping ratio out of range.
        """
        half, decay = _half_period(frequency, damping_ratio)
        return cls((0.0, half), (1.0 / (1.0 + decay), decay / (1.0 + decay)))

    @classmethod
    def zvd(cls, frequency: float, damping_ratio: float = 0.0) -> Self:
        """Zero vibration and derivative: the residual is flat about the modelled frequency.

        Args:
            frequency: natural frequency of the mode, undamped [rad/s].
            damping_ratio: damping ratio of the mode, below 1 [-].

        Raises:
            ValueError: a frequency or damping ratio out of range.
        """
        half, decay = _half_period(frequency, damping_ratio)
        whole = (1.0 + decay) ** 2
        return cls((0.0, half, 2.0 * half), (1.0 / whole, 2.0 * decay / whole, decay**2 / whole))

    @classmethod
    def ei(cls, frequency: float, damping_ratio: float = 0.0, tolerance: float = 0.05) -> Self:
        """Extra insensitive: some residual at the modelled frequency, none on either side of it.

        Three impulses, the last one a period of the vibration after the first. Without damping
        they have a closed form; with it, two amplitudes, the second time and both frequencies
        without residual solve five conditions: residual equal to the tolerance at the modelled
        frequency, and a complex residual of zero at both other ones. Between those the residual
        exceeds the tolerance by less than a fiftieth of it.

        Args:
            frequency: natural frequency of the mode, undamped [rad/s].
            damping_ratio: damping ratio of the mode, 0.3 at most [-].
            tolerance: residual at the modelled frequency, 0.001 to 0.2 [-].

        Raises:
            ValueError: a frequency, damping ratio or tolerance out of range.
        """
        _half_period(frequency, damping_ratio)
        low, high = _TOLERANCES
        if not (low <= tolerance <= high and damping_ratio <= _LARGEST_DAMPING):
            raise ValueError(
                f"an EI shaper needs a tolerance of {low:g} to {high:g} and a damping ratio of "
                f"{_LARGEST_DAMPING:g} at most, not {tolerance:g} and {damping_ratio:g}"
            )
        first, second = 0.25 * (1.0 + tolerance), 0.5 * (1.0 - tolerance)
        # Frequencies by the modelled one.
        clear = math.acos(-(1.0 - tolerance) / (1.0 + tolerance)) / math.pi
        solution = np.array((first, second, math.pi, clear, 2.0 - clear))
        steps = math.ceil(damping_ratio / _DAMPING_STEP)
        for damping in np.linspace(0.0, damping_ratio, steps + 1)[1:]:
            solution = root(_ei_errors, solution, (damping, tolerance), tol=1e-13).x
        times, amplitudes = _ei_impulses(solution, damping_ratio)
        return cls(tuple((times / frequency).tolist()), tuple(amplitudes.tolist()))

    @classmethod
    def by_name(
        cls,
        kind: ShaperKind,
        frequencies: Sequence[float],
        damping_ratios: Sequence[float],
        tolerance: float = 0.05,
    ) -> Self:
        """Shaper for several modes: those of the single modes, convolved.

        Args:
            kind: kind for each mode.
            frequencies: natural frequencies (m) [rad/s]; without any, commands pass unchanged.
            damping_ratios: their damping ratios (m) [-].
            tolerance: residual that an extra insensitive shaper leaves [-].

        Raises:
            ValueError: an unknown kind, or a mode that its shaper refuses.
        """
        kinds = get_args(ShaperKind.__value__)
        if kind not in kinds:
            raise ValueError(f"a shaper is one of {', '.join(kinds)}, not {quoted(kind)}")
        make = partial(cls.ei, tolerance=tolerance) if kind == "ei" else getattr(cls, kind)
        modes = zip(frequencies, damping_ratios, strict=True)
        return reduce(cls.convolved, (make(*mode) for mode in modes), cls())

    def convolved(self, other: "Shaper") -> Self:
        """Shaper that leaves at rest the modes of both."""
        pairs = sorted(
            (time + later, amplitude * share)
            for time, amplitude in zip(self.times, self.amplitudes, strict=True)
            for later, share in zip(other.times, other.amplitudes, strict=True)
        )
        return type(self)(*zip(*pairs, strict=True))

    @property
    def delay(self) -> float:
        """Time of the last impulse [s]: a shaped command ends as much later."""
        return self.times[-1]

    @property
    def lag(self) -> float:
        """Mean delay [s]: a shaped ramp is as much behind."""
        return float(np.dot(self.times, self.amplitudes))

    def residual(
        self, frequency: ArrayLike, damping_ratio: ArrayLike = 0.0
    ) -> NDArray[np.float64]:
        """Residual vibration of a mode that may be another than the modelled one.

        That is the amplitude at the last impulse, by the one that a single impulse has at its
        beginning (Singer and Seering, 1990); the same holds for the steps of a shaped step.

        Args:
            frequency: natural frequencies (...) [rad/s].
            damping_ratio: damping ratios (...) [-].

        Returns:
            (...) residual vibration [-], 0 (none) to 1 (unshaped).
        """
        times, amplitudes = np.array(self.times), np.array(self.amplitudes)
        return np.abs(_vibration(times, amplitudes, frequency, damping_ratio))


class InputShaper(LeafSystem):
    """Shapes commands so that flexible modes are at rest after each of their moves.

    Put it between the source of a command and what follows it.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `command` | n | any | commands; may jump |
    | out `shaped_command` | n | that of the command | commands, convolved with the impulses |

    The command is sampled, and taken to go straight from one sample to the next, one period
    later. All impulses act on that same motion: their times need not be multiples of the period,
    and a jump that becomes a ramp of one period leaves no vibration either. The output is exact at
    all times, not only at samples, and stays inside the range of the commands.

    So the last of a command comes later by `delay`, and a ramp lags by `lag`.

    State: discrete, the newest samples (m, n), the time of the last (1) [s] and whether there is
    one (1), updated every period. It starts at rest: all samples are the first finite command, and
    before that the command is shown as it is.

    Bad input: a command that is not finite in all elements is ignored, the last one stays; before
    the first finite one it is shown as it is.
    """

    def __init__(self, shaper: Shaper, channels: int = 1, period: float = 0.01) -> None:
        """Creates the system.

        Args:
            shaper: impulses.
            channels: number of commands n.
            period: time between two samples [s].

        Raises:
            ValueError: half a vibration of the fastest mode is shorter than the period.
        """
        # The second impulse comes half a vibration of the fastest mode after the first.
        half = next((time for time in shaper.times if time > 0.0), math.inf)
        if half < period:
            raise ValueError(
                f"a shaper with a period of {period:g} s needs modes below "
                f"{0.5 / period:.4g} Hz, not {0.5 / half:.4g} Hz"
            )
        super().__init__()
        self.set_name("input_shaper")
        self.delay, self.lag = shaper.delay + period, shaper.lag + period
        # Ages of the parts of the output in periods, at the time of the newest sample.
        ages = [time / period + 1.0 for time in shaper.times]
        self._period, self._impulses = period, [*zip(ages, shaper.amplitudes, strict=True)]
        self._shape = (int(ages[-1]) + 2, channels)
        self._command = self.DeclareVectorInputPort("command", channels)
        state = self.DeclareDiscreteState(self._shape[0] * channels + 2)
        self.DeclareVectorOutputPort(
            "shaped_command",
            channels,
            self._calc_shaped_command,
            {self.discrete_state_ticket(state), self.time_ticket(), self._command.ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_samples)

    def _calc_shaped_command(self, context: Context, output: BasicVector) -> None:
        state = context.get_discrete_state_vector().value()
        time, has_begun = state[-2:].tolist()
        if not has_begun:
            output.SetFromVector(read_array(self._command, context))
            return
        elapsed = min(max((context.get_time() - time) / self._period, 0.0), 1.0)
        weights = [0.0] * self._shape[0]
        for age, amplitude in self._impulses:
            sample = int(age - elapsed)
            older = age - elapsed - sample
            weights[sample] += amplitude * (1.0 - older)
            weights[sample + 1] += amplitude * older
        output.SetFromVector(np.array(weights) @ state[:-2].reshape(self._shape))

    def _update_samples(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = context.get_discrete_state_vector().value()
        command = read_array(self._command, context)
        has_begun, samples = state[-1], state[:-2].reshape(self._shape)
        if all_finite(command):
            newest = command
        elif has_begun:
            newest = samples[0]
        else:
            return
        older = samples[:-1] if has_begun else np.tile(newest, (self._shape[0] - 1, 1))
        now = (context.get_time(), 1.0)
        discrete_state.set_value(np.concatenate((newest, older.ravel(), now)))


def _half_period(frequency: float, damping_ratio: float) -> tuple[float, float]:
    """Half a period of a mode's vibration [s], and its decay in that time [-]."""
    if not (0.0 < frequency < math.inf and 0.0 <= damping_ratio < 1.0):
        raise ValueError(
            f"a mode needs a frequency above 0 rad/s and a damping ratio from 0 to below 1, "
            f"not {frequency:g} and {damping_ratio:g}"
        )
    damped = math.sqrt(1.0 - damping_ratio**2)
    return math.pi / (frequency * damped), math.exp(-math.pi * damping_ratio / damped)


def _vibration(
    times: NDArray[np.float64],
    amplitudes: NDArray[np.float64],
    frequency: ArrayLike,
    damping_ratio: ArrayLike,
) -> NDArray[np.complex128]:
    """Complex amplitudes (...) of modes at the last of some impulses (k) [-]."""
    omega, zeta = (np.asarray(x, dtype=float)[..., np.newaxis] for x in (frequency, damping_ratio))
    growth = zeta * (times - times[-1]) + 1j * np.sqrt(1.0 - zeta**2) * times
    vibration: NDArray[np.complex128] = (amplitudes * np.exp(omega * growth)).sum(-1)
    return vibration


def _ei_impulses(
    solution: NDArray[np.float64], damping_ratio: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times, by the modelled frequency [rad], and amplitudes of an EI shaper."""
    first, second, time = solution[:3]
    times = np.array((0.0, time, 2.0 * math.pi)) / math.sqrt(1.0 - damping_ratio**2)
    return times, np.array((first, second, 1.0 - first - second))


def _ei_errors(
    solution: NDArray[np.float64], damping_ratio: float, tolerance: float
) -> tuple[float, ...]:
    """Errors of the conditions of an EI shaper."""
    frequencies = (1.0, *solution[3:])
    modelled, below, above = _vibration(
        *_ei_impulses(solution, damping_ratio), frequencies, damping_ratio
    )
    return abs(modelled) - tolerance, below.real, below.imag, above.real, above.imag
