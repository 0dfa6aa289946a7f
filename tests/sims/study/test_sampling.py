"""Samplings of studies, and what the variables contribute."""

import numpy as np
import pytest

from parapod.sims.study.records import Column
from parapod.sims.study.sampling import Sampling
from parapod.sims.study.sensitivity import contributions
from parapod.sims.study.variables import Variable, read_variables
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import checked


@pytest.fixture
def sampled(trial):
    def make(kind, runs=None, seed=0, **given):
        return Sampling.make(kind, read_variables(trial, checked(trial()), given), runs, seed)

    return make


def table(sampling):
    return np.array([sampling.values(run) for run in range(sampling.runs)])


def metric(sampling, values):
    """A column that all runs have measured."""
    everywhere, nowhere = np.ones(sampling.runs, bool), np.full(sampling.runs, np.nan)
    return Column("sum", "", "", values, nowhere, nowhere, everywhere, (0, 0))


def test_a_grid_has_every_combination_once_the_last_variable_first(sampled):
    grid = sampled("grid", x="0:1:2", y="0:2:3")
    assert grid.runs == 6
    assert table(grid).tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]


def test_a_latin_hypercube_has_each_share_of_each_variable_once(sampled):
    found = table(sampled("latin", 40, x="0:10", y="-10:0"))
    for column, low in ((found[:, 0], 0.0), (found[:, 1], -10.0)):
        assert sorted(np.floor(4.0 * (column - low)).astype(int)) == list(range(40))


def test_a_design_mixes_two_independent_points(sampled):
    design = sampled("sobol", 70, x="0:1", y="0:1", wait="0:1")
    assert design.base == 8  # of 5 runs each; 16 would take 80
    rows = table(design)
    for i in range(3):
        of_a, of_b, of_mixed = design.split(rows[:, i])
        for j in range(3):
            assert np.array_equal(of_mixed[j], of_b if i == j else of_a)
        assert not np.array_equal(of_a, of_b)
    assert len(np.unique(rows[40:], axis=0)) == 30


@pytest.mark.parametrize("kind", ["latin", "sobol"])
def test_the_seed_decides_a_random_sampling(sampled, kind):
    one, same, other = (table(sampled(kind, 32, seed, x="0:1", y="0:1")) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.isclose(one, other).any()


@pytest.mark.parametrize(
    ("kind", "runs", "x", "words"),
    [
        ("spiral", 3, "0:1:2", "'spiral' is not one of grid, latin, sobol"),
        ("grid", None, "0:1", "a grid needs single values"),
        ("grid", 3, "0:1:2", "the grid has 2 runs, not 3"),
        ("latin", None, "0:1:2", "the sampling latin needs a number of runs"),
        ("latin", 0, "0:1:2", "0 runs are outside 1.."),
        ("sobol", 10**9, "0:1:2", "runs are outside"),
    ],
)
def test_a_sampling_that_does_not_fit_is_refused(sampled, kind, runs, x, words):
    with pytest.raises(ScenarioError) as caught:
        sampled(kind, runs, x=x)
    assert words in str(caught.value)


def test_indices_of_a_grid_are_exact(sampled):
    grid = sampled("grid", x="-1:1:3", y="-1:1:3")
    x, y = table(grid).T
    (found,) = contributions(grid, [metric(grid, x + 3.0 * y)])
    assert found.first == pytest.approx([0.1, 0.9])
    assert found.total == pytest.approx([0.1, 0.9])
    (found,) = contributions(grid, [metric(grid, x * y)])
    assert found.first == pytest.approx([0.0, 0.0], abs=1e-15)
    assert found.total == pytest.approx([1.0, 1.0])


def test_indices_of_a_design_are_those_of_ishigami(sampled):
    # Closed form: Saltelli et al., Global Sensitivity Analysis, 2008, section 4.6, a = 7, b = .1.
    turn = f"{-np.pi}:{np.pi}"
    design = sampled("sobol", 5 * 1024, x=turn, y=turn, wait=f"0:{2.0 * np.pi}")
    x, y, z = table(design).T
    z -= np.pi
    values = np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    (found,) = contributions(design, [metric(design, values)])
    assert found.first == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    assert found.total == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)
    assert (found.low <= found.total).all()
    assert (found.total <= found.high).all()


def test_there_are_no_indices_where_a_run_is_missing_or_nothing_varies(sampled):
    grid = sampled("grid", x="0:1:2", y="0:1:2")
    constant = metric(grid, np.full(4, 3.0))
    infinite = metric(grid, np.array([0.0, 1.0, np.inf, 2.0]))
    unmeasured = metric(grid, np.arange(4.0))
    unmeasured.is_there[1] = False
    assert contributions(grid, [constant, infinite, unmeasured]) == []
    latin = sampled("latin", 8, x="0:1")
    assert contributions(latin, [metric(latin, np.arange(8.0))]) == []


def test_a_distribution_is_sampled_by_its_quantiles():
    squares = Variable("x", "squares", quantile=np.square)
    (column,) = table(Sampling("latin", (squares,), 1000)).T[None][0]
    assert np.mean(column) == pytest.approx(1.0 / 3.0, abs=1e-3)
