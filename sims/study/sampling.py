"""Samplings of a study: which values the variables take in which run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc  # type: ignore[import-untyped]

from parapod.sims.study.variables import Variable
from parapod.systems.core.errors import ScenarioError

type Array = NDArray[np.float64]

SAMPLINGS = ("grid", "latin", "sobol")
_MOST_RUNS = 10_000_000


@dataclass(frozen=True)
class Sampling:
    """The runs of a study.

    * "grid": every combination of the values; the last variable changes first.
    * "latin": a Latin hypercube, which covers the range of each variable evenly.
    * "sobol": the design of Saltelli for Sobol indices, out of a scrambled Sobol sequence: base
      points by powers of 2, each with two independent points A and B, and with as many mixtures
      of both as there are variables. What is left of the runs are further points of the sequence.

    Attributes:
        is_searched: true if the values of a run are known once it has been asked for.
        kind: one of `SAMPLINGS`.
        variables: the variables.
        runs: number of runs.
        seed: seed of the random samplings.
    """

    is_searched: ClassVar[bool] = False
    kind: str
    variables: tuple[Variable, ...]
    runs: int
    seed: int = 0

    @classmethod
    def make(
        cls, kind: str, variables: Sequence[Variable], runs: int | None = None, seed: int = 0
    ) -> "Sampling":
        """A sampling, checked.

        Args:
            kind: one of `SAMPLINGS`.
            variables: the variables.
            runs: number of runs; None for a grid, which has its own.
            seed: seed of the random samplings.

        Raises:
            ScenarioError: an unknown kind, a grid of a distribution, or runs that do not fit.
        """
        if kind not in SAMPLINGS:
            raise ScenarioError(f"sampling '{kind}' is not one of {', '.join(SAMPLINGS)}")
        if kind != "grid":
            if runs is None:
                raise ScenarioError(f"the sampling {kind} needs a number of runs")
        else:
            for variable in variables:
                if variable.quantile is not None:
                    raise ScenarioError(
                        f"{variable}: a grid needs single values, as in FIRST:LAST:NUMBER; a "
                        "distribution needs the sampling latin or sobol",
                        variable.key,
                    )
            own = math.prod(len(variable.values) for variable in variables)
            if runs not in (None, own):
                raise ScenarioError(f"the grid has {own} runs, not {runs}")
            runs = own
        if not 1 <= runs <= _MOST_RUNS:
            raise ScenarioError(f"{runs} runs are outside 1..{_MOST_RUNS}")
        return cls(kind, tuple(variables), runs, seed)

    def values(self, run: int) -> tuple[Any, ...]:
        """Values of the variables in a run."""
        if self.kind == "grid":
            places = np.unravel_index(run, self.shape)
            return tuple(v.values[int(i)] for v, i in zip(self.variables, places, strict=True))
        return tuple(column[run] for column in self._columns)

    def take(self, run: int, values: Sequence[Any]) -> None:
        """Notes the values of a run that a file has; those of a sampling follow from itself."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of values of a grid's variables."""
        return tuple(len(variable.values) for variable in self.variables)

    @property
    def base(self) -> int:
        """Number of base points of the design for Sobol indices; 0 where there is none."""
        fitting = self.runs // (len(self.variables) + 2)
        if self.kind != "sobol" or fitting < 2:
            return 0
        return int(2 ** math.floor(math.log2(fitting)))

    @cached_property
    def _columns(self) -> list[list[Any]]:
        """By variable, its values in all runs."""
        shares = self._latin() if self.kind == "latin" else self._saltelli()
        return [v.at(column) for v, column in zip(self.variables, shares.T, strict=True)]

    def _latin(self) -> Array:
        shares: Array = qmc.LatinHypercube(len(self.variables), rng=self.seed).random(self.runs)
        return shares

    def _saltelli(self) -> Array:
        """Shares (runs, variables): A, B and the mixtures of each base point, then the rest."""
        count, base = len(self.variables), self.base
        rest = self.runs - base * (count + 2)
        sequence = qmc.Sobol(2 * count, rng=self.seed)
        # As many as a power of 2, which the sequence is balanced for.
        points = sequence.random_base2(math.ceil(math.log2(max(base + rest, 1))))
        a, b = points[:base, :count], points[:base, count:]
        design = np.empty((base, count + 2, count))
        design[:, 0], design[:, 1] = a, b
        for i in range(count):
            design[:, 2 + i] = a
            design[:, 2 + i, i] = b[:, i]
        return np.concatenate((design.reshape(-1, count), points[base : base + rest, :count]))

    def split(self, values: Array) -> tuple[Array, Array, Array]:
        """Numbers (runs) of a study by the point that they are of.

        Returns:
            Those of A (base), of B (base) and of the mixtures (variables, base).
        """
        count, base = len(self.variables), self.base
        design = values[: base * (count + 2)].reshape(base, count + 2)
        return design[:, 0], design[:, 1], design[:, 2:].T
