import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.printed import CUBE, CUBE_HEIGHT, REACHABLE_PERCENT
from parapod.systems.machining_centre.workspace import cell_centres, nodes, survey

# By a program of its own, cells of 12.5 mm: percentages at 0, .08, .1, .12, and the means.
CONVERGED = {
    3: ((18.62, 12.51, 3.17, 0.26), (0.0944, 0.9711, 10.407)),
    4: ((18.49, 15.83, 8.88, 1.84), (0.1033, 0.9723, 9.56)),
}


@pytest.fixture(scope="module")
def surveys():
    points = cell_centres(CUBE, CUBE_HEIGHT, 0.0125)
    return {limbs: survey(CentreGeometry(limbs), points) for limbs in (3, 4)}


def test_cells_fill_the_box_and_nodes_reach_its_faces():
    cells, grid = cell_centres(CUBE, 0.5, 0.1), nodes(CUBE, 0.5, 5)
    assert len(cells) == 10 * 10 * 5
    assert np.allclose(cells.min(axis=0), (-0.45, -0.45, 0.3))
    assert np.allclose(cells.mean(axis=0), (0.0, 0.0, 0.5))
    assert len(grid) == 5**3
    assert np.allclose(grid.min(axis=0), (-0.5, -0.5, 0.25))
    assert np.allclose(grid.max(axis=0), (0.5, 0.5, 0.75))


@pytest.mark.parametrize("limbs", [3, 4])
def test_shares_and_means_are_those_of_another_program(surveys, limbs):
    percents, means = CONVERGED[limbs]
    for threshold, percent in zip((0.0, 0.08, 0.1, 0.12), percents, strict=True):
        assert surveys[limbs].percent(threshold) == pytest.approx(percent, abs=0.1)
    assert surveys[limbs].means(0.08) == pytest.approx(means, rel=0.002)


def test_the_first_row_of_table_1_is_that_of_twenty_nodes_an_edge():
    for limbs, count in ((3, 1308), (4, 1284)):
        found = survey(CentreGeometry(limbs), nodes(CUBE, CUBE_HEIGHT, 20))
        assert len(found.reachable) == count
        assert found.percent(0.0) == pytest.approx(REACHABLE_PERCENT[limbs][0], abs=0.05)


def test_reachable_points_are_those_within_the_stroke(surveys):
    geometry = CentreGeometry(3)
    inside = np.pad(surveys[3].reachable[::500], ((0, 0), (0, 3)))
    lengths = leg_lengths(geometry, inside)
    assert lengths.min() >= geometry.stroke_min
    assert lengths.max() <= geometry.stroke_max


def test_all_legs_together_bound_what_is_resisted_in_any_direction(surveys):
    for found in surveys.values():
        assert (found.indices.w_max >= found.push - 1e-12).all()
        assert (found.indices.w_minmax <= found.push + 1e-12).all()


def test_done_points_are_told():
    told = []
    survey(CentreGeometry(3), cell_centres(CUBE, 0.5, 0.02), told.append)
    assert told == sorted(told)
    assert told[-1] == len(cell_centres(CUBE, 0.5, 0.02))


def test_a_single_point_is_surveyed():
    found = survey(CentreGeometry(3), np.array(((0.0, 0.0, 0.5),)))
    assert found.percent(0.0) == 100.0
    assert found.means(0.1)[0] == pytest.approx(0.1066456617, abs=1e-9)
