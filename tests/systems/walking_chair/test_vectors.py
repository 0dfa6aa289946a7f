import numpy as np

from parapod.systems.core.vectors import cross, inverse, times

RNG = np.random.default_rng(0)


def test_cross_products_broadcast_as_numpys():
    a, b = RNG.normal(size=(5, 1, 3)), RNG.normal(size=(4, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=1e-14)


def test_inverses_are_inverses():
    matrices = RNG.normal(size=(20, 3, 3))
    products = inverse(matrices) @ matrices
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)


def test_a_singular_matrix_in_a_batch_leaves_the_others_alone():
    matrices = RNG.normal(size=(3, 3, 3))
    matrices[1] = 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        found = inverse(matrices)
    assert np.isfinite(found).all(axis=(1, 2)).tolist() == [True, False, True]


def test_matrices_times_vectors_broadcast():
    matrix, vectors = RNG.normal(size=(3, 3)), RNG.normal(size=(2, 5, 3))
    np.testing.assert_allclose(times(matrix, vectors), vectors @ matrix.T, rtol=1e-14)
