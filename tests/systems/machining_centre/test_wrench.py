import math
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian, moved
from parapod.systems.machining_centre.wrench import wrench_indices

# By a program of its own: limbs, pose [m, rad], w_minmax, w_max, ratio.
GOLDEN = [
    (3, (0, 0, 0.5, 0, 0, 0), 0.1066456617, 0.9677424585, 9.07437249),
    (3, (0.1, 0.05, 0.45, 0, 0, 0), 0.1097660968, 0.9636451930, 8.77907861),
    (3, (-0.15, 0.08, 0.4, 0, 0, 0), 0.1106065183, 0.9604840855, 8.68379278),
    (3, (0.04, -0.03, 0.48, 0.1, -0.05, 0.2), 0.1076564610, 0.9659993332, 8.97298057),
    (4, (0, 0, 0.5, 0, 0, 0), 0.1192002314, 0.9677424585, 8.11862903),
    (4, (0.1, 0.05, 0.45, 0, 0, 0), 0.1243497618, 0.9636448450, 7.74947078),
    (4, (-0.15, 0.08, 0.4, 0, 0, 0), 0.1261009484, 0.9604817295, 7.61676849),
    (4, (0.04, -0.03, 0.48, 0.1, -0.05, 0.2), 0.1222760263, 0.9660071948, 7.90021743),
]


def wrenches(geometry, pose, standing=None):
    """H of Eq. (25), (6, m), moments by r_c."""
    H = jacobian(geometry, pose).T / np.repeat((geometry.platform_radius, 1.0), 3)[:, None]
    return H if standing is None else H[:, [2 * i - 2 + k for i in standing for k in (0, 1)]]


def facets(H):
    """Distances of all facets from the origin for forces up to 1, and their normals."""
    found = []
    for five in combinations(range(H.shape[1]), 5):
        _, values, rows = np.linalg.svd(H[:, five].T)
        if values[4] > 1e-9:
            found.append((np.abs(rows[5] @ H).sum(), rows[5]))
    return found


@pytest.mark.parametrize(("limbs", "pose", "w_minmax", "w_max", "ratio"), GOLDEN)
def test_indices_are_those_computed_by_another_program(limbs, pose, w_minmax, w_max, ratio):
    found = wrench_indices(CentreGeometry(limbs), pose)
    assert found.w_minmax == pytest.approx(w_minmax, abs=1e-9)
    assert found.w_max == pytest.approx(w_max, abs=1e-9)
    assert found.ratio == pytest.approx(ratio, abs=1e-8)


def test_indices_are_those_of_all_facets_and_all_corners(geometry, poses):
    for pose in poses(20):
        H = wrenches(geometry, pose)
        found = wrench_indices(geometry, pose)
        nearest = min(distance for distance, _ in facets(H))
        assert found.w_minmax == pytest.approx(nearest / geometry.legs, abs=1e-13)
        signs = 2.0 * np.array(list(np.ndindex((2,) * geometry.legs))) - 1.0
        farthest = np.linalg.norm(signs @ H.T, axis=1).max()
        assert found.w_max == pytest.approx(farthest / geometry.legs, abs=1e-13)


def test_a_linear_programme_resists_as_much_in_the_worst_direction(geometry, poses):
    for pose in poses(5):
        H, m = wrenches(geometry, pose), geometry.legs
        _, normal = min(facets(H), key=lambda facet: facet[0])
        # Most kappa with H f = kappa u and |f| <= f_max.
        resisted = linprog(
            (*(0.0,) * m, -1.0),
            A_eq=np.hstack((H, -normal[:, None])),
            b_eq=np.zeros(6),
            bounds=[(-1.0 / m, 1.0 / m)] * m + [(0.0, None)],
        )
        assert wrench_indices(geometry, pose).w_minmax == pytest.approx(-resisted.fun, abs=1e-12)


def test_sampled_directions_overestimate(geometry):
    pose = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    directions = np.random.default_rng(0).normal(size=(200, 6))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    sampled = np.abs(directions @ wrenches(geometry, pose)).sum(axis=1).min() / geometry.legs
    excess = sampled / wrench_indices(geometry, pose).w_minmax - 1.0
    assert 0.01 < excess < 1.0


def test_indices_do_not_change_with_the_world(geometry, poses):
    # Everything turned about the vertical: poses and feet alike.
    pose = poses(1)[0]
    turn = np.array((0.0, 0.0, 0.7, 0.0, 0.0, 0.0))
    about_origin = np.array((*moved(np.zeros(6), turn)[:3], 0.0, 0.0, 0.7))
    c, s = math.cos(0.7), math.sin(0.7)
    R = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    turned = np.array((*(R @ pose[:3]), *pose[3:])) + about_origin
    feet = geometry.footholds.copy()
    feet[:, :3] = feet[:, :3] @ R.T
    feet[:, 5] += 0.7
    assert np.allclose(
        np.stack(wrench_indices(geometry, turned, feet)),
        np.stack(wrench_indices(geometry, pose)),
        rtol=1e-12,
    )


def test_a_batch_is_as_many_single_poses(geometry, poses, uneven):
    batch, feet = poses(1100), uneven(1100)  # more than one chunk
    found = wrench_indices(geometry, batch, feet)
    for i in (0, 1023, 1024, 1099):
        assert np.allclose(
            np.stack(wrench_indices(geometry, batch[i], feet[i])),
            np.stack(found)[:, i],
            rtol=1e-12,
        )


def test_three_limbs_of_four_resist_as_a_tripod_of_them(poses):
    geometry, pose = CentreGeometry(4), poses(1)[0]
    found = wrench_indices(geometry, pose, standing=(1, 2, 4))
    nearest = min(distance for distance, _ in facets(wrenches(geometry, pose, (1, 2, 4))))
    assert found.w_minmax == pytest.approx(nearest / 8, abs=1e-13)
    assert found.w_minmax < wrench_indices(geometry, pose).w_minmax


def test_a_platform_that_its_legs_do_not_hold_resists_nothing():
    # Pivots turned by a quarter against the feet: the known singularity of such platforms.
    geometry = CentreGeometry(3)
    found = wrench_indices(geometry, [(0, 0, 0.48, 0, 0, a) for a in (0.0, math.pi / 2)])
    assert found.w_minmax[0] > 0.1
    assert found.w_minmax[1] == pytest.approx(0.0, abs=1e-12)
    assert found.ratio[1] > 1e10


@pytest.mark.parametrize("standing", [(1, 2), (1, 2, 5), (0, 1, 2)])
def test_limbs_that_do_not_stand_are_refused(standing):
    with pytest.raises(ValueError, match="standing limbs must be at least three"):
        wrench_indices(CentreGeometry(4), np.zeros(6), standing=standing)
