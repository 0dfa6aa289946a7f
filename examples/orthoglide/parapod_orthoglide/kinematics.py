"""Kinematics of the Orthoglide: each drive holds one end of a leg, the tool all others.

Wenger and Chablat, "Design of a three-axis isotropic parallel manipulator for machining
applications: the Orthoglide", Quebec, 2002 (arXiv 0705.1282). Where the legs are along the axes
the tool is at the origin, and moves as its drives do.
"""

import numpy as np


def inverse(leg, place):
    """Positions (..., 3) of the drives [m], NaN where a leg is too short.

    Args:
        leg: length of the legs [m].
        place: place (..., 3) of the tool [m].
    """
    aside = np.sum(place**2, axis=-1, keepdims=True) - place**2
    with np.errstate(invalid="ignore"):
        return place + np.sqrt(leg**2 - aside)


def forward(leg, position):
    """Place (3) of the tool [m], by the positions (3) of the drives [m].

    What three spheres have in common: with t = |p|^2 - leg^2 each coordinate is
    position / 2 + t / (2 position), and t follows from the sum of their squares.
    """
    a, c = np.sum(0.25 / position**2), np.sum(0.25 * position**2) - leg**2
    t = (-0.5 - np.sqrt(0.25 - 4.0 * a * c)) / (2.0 * a)
    return 0.5 * position + 0.5 * t / position


def inverse_jacobian(leg, place):
    """Velocities of the drives (..., 3, 3) by those of the tool."""
    along = inverse(leg, place) - place
    ratio = -place[..., None, :] / along[..., :, None]
    return np.where(np.eye(3, dtype=bool), 1.0, ratio)
