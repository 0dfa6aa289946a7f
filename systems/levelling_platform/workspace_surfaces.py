"""The eight surfaces that the paper prints for its workspace (section 4, Fig. 12)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# (x_c, y_c, z_c) in frame {B} [m].
CENTRE = np.array([0.736, 0.567, 0.386])

# Coefficients of z^2, x^2, y^2, z, x, y and 1 about the centre, and the sign that the sum has
# inside, in the order of print. (The first one's y_o is taken for y_c.)
_TABLE = np.array(
    [
        (1.0, -0.11, -0.10, -5.02, 0.17, 0.13, 6.18, -1.0),
        (1.0, 0.85, 0.80, 0.00, -1.22, 0.94, -4.70, 1.0),
        (1.0, 0.87, 0.96, 0.00, 1.25, -1.00, -4.70, 1.0),
        (1.0, 1.00, 1.00, 0.77, 1.13, 1.47, -6.37, 1.0),
        (1.0, 0.49, 0.49, -1.89, 0.74, 0.57, -1.07, -1.0),
        (1.0, 0.85, 1.01, 0.00, 1.26, -0.96, -5.50, -1.0),
        (1.0, 0.37, 0.32, -2.63, -0.56, 0.43, 0.66, -1.0),
        (1.0, 0.80, 0.88, 0.00, -1.31, -0.99, -5.50, -1.0),
    ]
)
COEFFICIENTS, SIGNS = _TABLE[:, :-1], _TABLE[:, -1]
# Corners of a box that holds the region that they enclose [m].
BOX = np.array([(0.40, 0.13, 2.50), (1.10, 1.03, 2.78)])
SURFACE_COUNT = len(SIGNS)


def surface_terms(point: ArrayLike) -> NDArray[np.float64]:
    """z^2, x^2, y^2, z, x, y and 1 about the surfaces' centre.

    Args:
        point: (..., 3) in frame {B} [m].

    Returns:
        (..., 7).
    """
    x, y, z = np.moveaxis(np.asarray(point, dtype=float) - CENTRE, -1, 0)
    return np.stack([z * z, x * x, y * y, z, x, y, np.ones_like(x)], axis=-1)


def surface_margins(
    point: ArrayLike, coefficients: NDArray[np.float64] = COEFFICIENTS
) -> NDArray[np.float64]:
    """How far inside each printed surface a point is, by the value of its equation.

    Args:
        point: (..., 3) in frame {B} [m].
        coefficients: (8, 7) of the terms of `surface_terms`; others than the printed ones tell
            what their rounding does.

    Returns:
        (..., 8) [m^2]; positive inside.
    """
    return surface_terms(point) @ (coefficients * SIGNS[:, np.newaxis]).T


def inside_surfaces(point: ArrayLike) -> NDArray[np.bool_]:
    """Which of the eight printed conditions a point fulfils.

    Args:
        point: (..., 3) in frame {B} [m].

    Returns:
        (..., 8); False for NaN.
    """
    return surface_margins(point) > 0.0


def enclosed_points(resolution: int) -> tuple[NDArray[np.float64], float]:
    """Midpoints of the cells that the eight surfaces enclose, and a cell's volume.

    Args:
        resolution: cells along each side of a box that holds what they enclose.

    Returns:
        (n, 3) in frame {B} [m] and the volume [m^3].
    """
    share = (np.arange(resolution) + 0.5) / resolution
    low, high = BOX
    axes = [a + share * (b - a) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    is_inside = inside_surfaces(points).all(axis=-1)
    return points[is_inside], float(np.prod((high - low) / resolution))
