"""Vectors as tuples of three components, for elementwise functions."""

from collections.abc import Sequence

from parapod.systems.core.elementwise import Elementwise

type Vector3 = tuple[Elementwise, Elementwise, Elementwise]


def dot(a: Sequence[Elementwise], b: Sequence[Elementwise]) -> Elementwise:
    """Scalar product of two vectors (of three components)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def minus(a: Vector3, b: Vector3) -> Vector3:
    """Difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def plus(a: Vector3, b: Vector3) -> Vector3:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def scaled(a: Vector3, factor: Elementwise) -> Vector3:
    """A vector times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor
