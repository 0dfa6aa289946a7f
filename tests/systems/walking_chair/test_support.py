import math

import numpy as np
import pytest

from parapod.systems.walking_chair.support import support_polygon

SQUARE = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]


@pytest.mark.parametrize(
    ("point", "margin"),
    [
        ((0.0, 0.0), 1.0),
        ((0.7, 0.2), 0.3),
        ((-0.2, -0.9), 0.1),
        ((1.0, 0.0), 0.0),
        ((1.25, 0.0), -0.25),
        ((0.0, -3.0), -2.0),
    ],
)
def test_margin_is_the_distance_to_the_nearest_edge(point, margin):
    assert support_polygon(SQUARE).margin(point) == pytest.approx(margin, abs=1e-15)


def test_points_inside_and_on_edges_do_not_matter():
    polygon = support_polygon([*SQUARE, (0.0, 0.0), (0.3, -0.2), (1.0, 0.0), (0.9, 0.9)])
    assert len(polygon.corners) == 4
    assert polygon.margin((0.5, 0.0)) == pytest.approx(0.5)


def test_corners_go_round_anticlockwise_and_normals_outwards():
    random = np.random.default_rng(0)
    polygon = support_polygon(random.normal(size=(20, 2)))
    a, b = polygon.corners, np.roll(polygon.corners, -1, axis=0)
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    assert area > 0.0
    np.testing.assert_allclose(np.linalg.norm(polygon.normals, axis=1), 1.0)
    inside = polygon.corners.mean(axis=0)
    assert (polygon.normals @ inside < polygon.offsets).all()


def test_margin_turns_and_moves_with_the_contacts():
    random = np.random.default_rng(1)
    contacts, point = random.normal(size=(8, 2)), random.normal(size=2)
    angle = 0.7
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    moved = support_polygon(contacts @ turn.T + (3.0, -2.0)).margin(turn @ point + (3.0, -2.0))
    assert moved == pytest.approx(support_polygon(contacts).margin(point), abs=1e-14)


@pytest.mark.parametrize(
    "contacts",
    [
        [],
        [(0.0, 0.0)],
        [(0.0, 0.0), (1.0, 0.0)],
        [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)],
        [(0.0, 0.0), (1.0, 0.0), (math.nan, 1.0)],
    ],
)
def test_without_a_polygon_nothing_is_supported(contacts):
    assert support_polygon(contacts).margin((0.0, 0.0)) == -math.inf


@pytest.mark.parametrize("point", [(math.nan, 0.0), (math.inf, 0.0)])
def test_a_point_that_is_not_finite_is_not_supported(point):
    assert support_polygon(SQUARE).margin(point) == -math.inf
