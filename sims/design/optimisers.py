"""Algorithms of a search: differential evolution for one objective, NSGA-II for several.

Both ask for whole generations, so that all cores work on one.
"""

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution  # type: ignore[import-untyped]

from parapod.systems.core.extras import need

type Array = NDArray[np.float64]

# Scores of a design that breaks a constraint, and of one that is refused; the largest number that
# NSGA-II is told: above those of all that hold.
_BROKEN, _REFUSED, _LARGEST = 1e100, 1e300, 1e30


def minimise(
    work_out: Callable[[Array], tuple[Array, Array]],
    start: Array,
    goals: int,
    designs: int,
    seed: int,
) -> None:
    """Asks for generation after generation; what comes out is up to the one who works it out.

    Args:
        work_out: takes designs (n, k) by shares 0..1 of their variables' ranges; returns their
            objectives (n, goals), which are to be small, and violations (n) of constraints, both
            infinite where a design is refused.
        start: the first generation (population, k).
        goals: number of objectives.
        designs: largest number of designs.
        seed: seed of the algorithm.

    Raises:
        MissingExtra: several objectives need pymoo, which is not installed.
    """
    if goals == 1:
        _evolve(work_out, start, designs, seed)
    else:
        _sort(work_out, start, goals, designs, seed)


def _evolve(
    work_out: Callable[[Array], tuple[Array, Array]], start: Array, designs: int, seed: int
) -> None:
    """Storn and Price's differential evolution; a design that holds beats one that does not."""

    def score(shares: Array) -> Array:
        objectives, violations = work_out(np.clip(shares.T, 0.0, 1.0))
        scores = objectives[:, 0]
        broken = violations > 0.0
        scores[broken] = _BROKEN * (1.0 + violations[broken])
        # SciPy works out a first generation anew while all of it is infinite.
        return np.nan_to_num(scores, posinf=_REFUSED)

    with warnings.catch_warnings():
        # Of designs that are all refused.
        warnings.simplefilter("ignore")
        differential_evolution(
            score,
            [(0.0, 1.0)] * start.shape[1],
            init=start,
            maxiter=max(1, designs // len(start) - 1),
            vectorized=True,
            updating="deferred",
            polish=False,
            tol=-1.0,  # to the last generation
            rng=seed,
        )


def _sort(
    work_out: Callable[[Array], tuple[Array, Array]],
    start: Array,
    goals: int,
    designs: int,
    seed: int,
) -> None:
    """Deb's NSGA-II, by pymoo."""
    nsga2 = need("pymoo.algorithms.moo.nsga2")
    problem = need("pymoo.core.problem").Problem(
        n_var=start.shape[1], n_obj=goals, n_ieq_constr=1, xl=0.0, xu=1.0
    )
    evaluator, static = need("pymoo.core.evaluator"), need("pymoo.problems.static")
    algorithm = nsga2.NSGA2(pop_size=len(start), sampling=start)
    algorithm.setup(
        problem, termination=("n_gen", designs // len(start)), seed=seed, verbose=False
    )
    count = 0
    while algorithm.has_next() and count + len(start) <= designs:
        population = algorithm.ask()
        shares = population.get("X")
        count += len(shares)
        objectives, violations = work_out(shares)
        # Infinite objectives would make distances in a crowd NaN.
        objectives = np.clip(np.nan_to_num(objectives, posinf=_LARGEST), -_LARGEST, _LARGEST)
        violations = np.nan_to_num(violations, posinf=_LARGEST)[:, np.newaxis]
        evaluator.Evaluator().eval(
            static.StaticProblem(problem, F=objectives, G=violations), population
        )
        algorithm.tell(infills=population)
