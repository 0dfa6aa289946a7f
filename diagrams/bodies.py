"""Links of a model as a machine of one's own has them: stretched, and of other masses.

A model's file has links of one size. A machine of another size has the same links stretched along
their axes: visuals, collision shapes, centres of mass and second moments follow. Mass, and where
they are known better than by stretching, centre and moments of inertia, are settings.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import cache, lru_cache
from typing import Any, cast
from xml.etree.ElementTree import Element, fromstring, tostring

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RollPitchYaw
from pydrake.multibody.tree import UnitInertia

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, quantity
from parapod.urdf import MODELS_DIR

# Heaviest body [kg], largest moment of inertia [kg m^2], and farthest centre of mass [mm].
_HEAVIEST, _BULKIEST, _FARTHEST = 1e5, 1e6, 1e5
# Numbers of a file whose difference is rounding [m].
_SAME = 1e-12
# SI value of a key, by the end of its name; a quotient keeps what decimals say.
_UNITS: dict[str, Callable[[Any], Any]] = {
    "": lambda value: value,
    "_mm": lambda value: value / 1e3,
    "_deg": math.radians,
}
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


# Factors along the axes of a link, and a point of it.
type Stretch = tuple[float, float, float]
type Place = tuple[float, float, float]
_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Body:
    """Mass of a link, and what is known of how it is spread.

    Attributes:
        mass: [kg].
        centre: centre of mass in the link's frame [m]; None: that of the stretched link.
        inertia: moments ixx, iyy, izz and products ixy, ixz, iyz about the centre of mass, along
            the link's axes [kg m^2]; None: those of the stretched link.
    """

    mass: float
    centre: tuple[float, ...] | None = None
    inertia: tuple[float, ...] | None = None


@dataclass
class BodyScenario(Schema):
    """A rigid body.

    Attributes:
        mass_kg: mass [kg].
        centre_mm: centre of mass in the frame of its link [mm]; null: that of the drawn link,
            stretched to size.
        inertia_kg_m2: moments ixx, iyy, izz and products ixy, ixz, iyz about the centre of mass
            [kg m^2]; null: those of the drawn link, stretched to size.
    """

    mass_kg: float = quantity(1.0, 1e-6, _HEAVIEST)
    centre_mm: list[float] | None = quantity(None, -_FARTHEST, _FARTHEST, length=3)
    inertia_kg_m2: list[float] | None = quantity(None, -_BULKIEST, _BULKIEST, length=6)

    @property
    def body(self) -> Body:
        """The body in SI units."""
        centre = None if self.centre_mm is None else tuple(x / 1e3 for x in self.centre_mm)
        inertia = None if self.inertia_kg_m2 is None else tuple(self.inertia_kg_m2)
        return Body(self.mass_kg, centre, inertia)

    def check(self, key: str) -> None:
        """Refuses moments of inertia that no body has.

        Args:
            key: key of this body in the scenario.

        Raises:
            ScenarioError: names the key.
        """
        if self.inertia_kg_m2 is None:
            return
        unit = UnitInertia(*(x / self.mass_kg for x in self.inertia_kg_m2))
        if not unit.CouldBePhysicallyValid():
            moments = ", ".join(f"{x:g}" for x in self.inertia_kg_m2)
            raise ScenarioError(
                f"{key}.inertia_kg_m2 = [{moments}] is of no body: principal moments must be "
                "positive, and none larger than the sum of the others",
                f"{key}.inertia_kg_m2",
            )


def body_of(mass: float) -> Any:
    """Field of a schema: a body with a usual mass [kg]."""
    return field(default_factory=lambda: BodyScenario(mass))


def in_si[T](
    design: Schema, kind: type[T], key: str = "machine", usual: T | None = None, **others: Any
) -> T:
    """Dimensions of a scenario as the dataclass that systems take.

    Args:
        design: schema with a key of the name of each field: as it is, or with `_mm` or `_deg`.
        kind: the dataclass; a key of None is left to it, and so is a field without a key.
        key: key of these dimensions in the scenario.
        usual: values for keys of None; None: the dataclass's own.
        others: further fields, and their values.

    Raises:
        ScenarioError: dimensions that the dataclass refuses; names the key.
    """
    values, keys = dict(others), {}
    own: Any = type(design)
    for field_name, name, convert in _conversions(own, cast(Any, kind)):
        if field_name in others:
            continue
        if (value := getattr(design, name)) is not None:
            values[field_name], keys[field_name] = convert(value), name
        elif usual is not None:
            values[field_name] = getattr(usual, field_name)
    try:
        dimensions: T = _build(cast(Any, kind), tuple(values.items()))
        return dimensions
    except ValueError as error:
        named = (f"{key}.{keys[name]}" for name in keys if name in str(error))
        raise ScenarioError(f"{key}: {error}", next(named, key)) from None


@cache
def _conversions(design: Any, kind: Any) -> list[tuple[str, str, Callable[[Any], Any]]]:
    """Fields of a dataclass for which a schema has a key, that key, and its conversion."""
    return [
        (each.name, f"{each.name}{suffix}", convert)
        for each in fields(kind)
        for suffix, convert in _UNITS.items()
        if hasattr(design, f"{each.name}{suffix}")
        or f"{each.name}{suffix}" in design.__dataclass_fields__
    ]


@lru_cache(maxsize=64)
def _build(kind: Any, values: tuple[tuple[str, Any], ...]) -> Any:
    return kind(**dict(values))


def fit_link(
    root: Element,
    name: str,
    stretch: Stretch,
    body: Body | None,
    shapes: Mapping[str, Stretch] | None = None,
    about: tuple[Place, Place] = (_ORIGIN, _ORIGIN),
) -> None:
    """Stretches a link of a URDF model, and gives it a mass.

    Args:
        root: the file's `robot` element.
        name: name of the link.
        stretch: factors along the axes of the link's frame; 1 leaves the file's numbers as they
            are.
        body: mass, and what is known of how it is spread; None: what the file has, by volume.
        shapes: factors of single shapes, by their names in the file; they are stretched from the
            link's origin.
        about: point of the drawn link that is stretched about, and where it goes [m].
    """
    link = root.find(f"link[@name='{name}']")
    assert link is not None, name
    factors, (point, place), others = np.array(stretch), np.array(about), shapes or {}
    shift = place - factors * point
    for shape in (*link.findall("visual"), *link.findall("collision")):
        name = shape.get("name", "")
        if name in others:
            _stretch_shape(shape, np.array(others[name]), np.zeros(3))
        else:
            _stretch_shape(shape, factors, shift)
    _stretch_inertia(link, factors, shift, body)


def link_bodies(url: str, adapt: Callable[[Element], None]) -> dict[str, Body]:
    """Bodies of the links of a URDF model that is not as its file has it, by their names.

    Args:
        url: file of `parapod.urdf`, as `package://parapod/...`.
        adapt: changes the file's `robot` element in place, from which the shapes are gone.
    """
    root = fromstring(_bare_model(url))
    adapt(root)
    bodies = {}
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            mass, moments = inertial.find("mass"), inertial.find("inertia")
            assert mass is not None
            assert moments is not None
            bodies[link.get("name", "")] = Body(
                float(mass.get("value", "0")),
                tuple(_read(inertial.find("origin"), "xyz").tolist()),
                tuple(float(moments.get(name, "0")) for name in _MOMENTS),
            )
    return bodies


@lru_cache(maxsize=16)
def _bare_model(url: str) -> bytes:
    """A file without its shapes."""
    path = MODELS_DIR / url.removeprefix("package://parapod/")
    root = fromstring(path.read_text(encoding="utf-8"))
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    return tostring(root)


def place_joints(root: Element, origins: Mapping[str, ArrayLike]) -> None:
    """Puts the origins of joints of a URDF model elsewhere in their parents' frames.

    Args:
        root: the file's `robot` element.
        origins: (3) of each joint [m], by its name; what rounds to the file's number stays.
    """
    for name, place in origins.items():
        origin = root.find(f"joint[@name='{name}']/origin")
        assert origin is not None, name
        place_element(origin, "xyz", place)


def limit_joints(root: Element, limits: Mapping[str, Mapping[str, float]]) -> None:
    """Gives joints of a URDF model other limits.

    Args:
        root: the file's `robot` element.
        limits: values of the attributes of each joint's `limit`, by its name.
    """
    for name, values in limits.items():
        limit = root.find(f"joint[@name='{name}']/limit")
        assert limit is not None, name
        for attribute, value in values.items():
            if not math.isclose(float(limit.get(attribute, "nan")), value, abs_tol=_SAME):
                limit.set(attribute, repr(float(value)))


def place_element(element: Element, attribute: str, values: ArrayLike) -> None:
    """Gives an attribute other numbers, unless the file's are these but for rounding."""
    numbers = np.asarray(values, dtype=float)
    if not (np.abs(_read(element, attribute) - numbers) <= _SAME).all():
        _write(element, attribute, numbers)


def set_attribute(root: Element, path: str, attribute: str, value: float) -> None:
    """Gives an attribute of an element of a URDF model another number.

    Args:
        root: the file's `robot` element.
        path: path of the element.
        attribute: name of the attribute.
        value: the number; one that rounds to the file's leaves it.
    """
    element = root.find(path)
    assert element is not None, path
    if not math.isclose(float(element.get(attribute, "nan")), value, rel_tol=_SAME):
        element.set(attribute, repr(float(value)))


def _read(element: Element | None, name: str) -> NDArray[np.float64]:
    text = "" if element is None else element.get(name, "")
    return np.array(text.split() or (0.0, 0.0, 0.0), dtype=float)


def _write(element: Element, name: str, values: NDArray[np.float64]) -> None:
    element.set(name, " ".join(map(repr, values.tolist())))


def _stretch_shape(
    shape: Element, factors: NDArray[np.float64], shift: NDArray[np.float64]
) -> None:
    origin, (form,) = shape.find("origin"), tuple(_geometry(shape))
    if origin is not None:
        place_element(origin, "xyz", factors * _read(origin, "xyz") + shift)
    if (factors == 1.0).all():
        return
    rotation = RollPitchYaw(_read(origin, "rpy")).ToRotationMatrix().matrix()
    # Stretch along the shape's own axes; exact where these are along the link's.
    own = np.abs(rotation.T @ np.diag(factors) @ rotation).diagonal()
    kind = form.tag.partition("}")[2] or form.tag
    if kind == "box":
        _write(form, "size", own * _read(form, "size"))
    elif kind == "mesh":
        scale = _read(form, "scale") if form.get("scale") else np.ones(3)
        _write(form, "scale", own * scale)
    else:
        across = math.sqrt(own[0] * own[1]) if kind != "sphere" else float(np.cbrt(own.prod()))
        a, b, along = own.tolist()
        for name, factor in {
            "a": a,
            "b": b,
            "c": along,
            "radius": across,
            "length": along,
        }.items():
            if (size := form.get(name)) is not None:
                form.set(name, repr(factor * float(size)))


def _geometry(shape: Element) -> Iterator[Element]:
    geometry = shape.find("geometry")
    assert geometry is not None
    yield from geometry


def _stretch_inertia(
    link: Element, factors: NDArray[np.float64], shift: NDArray[np.float64], body: Body | None
) -> None:
    """Second moments of mass, by which moments of inertia follow, are stretched twice."""
    inertial = link.find("inertial")
    assert inertial is not None
    mass_element, inertia_element = inertial.find("mass"), inertial.find("inertia")
    assert mass_element is not None
    assert inertia_element is not None
    origin = inertial.find("origin")
    drawn_mass = float(mass_element.get("value", "0"))
    mass = drawn_mass * float(factors.prod()) if body is None else body.mass
    if mass != drawn_mass:
        mass_element.set("value", repr(mass))
    if body is not None and body.centre is not None:
        if origin is None:
            origin = Element("origin")
            inertial.insert(0, origin)
        _write(origin, "xyz", np.array(body.centre))
    elif origin is not None:
        place_element(origin, "xyz", factors * _read(origin, "xyz") + shift)
    if body is not None and body.inertia is not None:
        moments = dict(zip(_MOMENTS, body.inertia, strict=True))
    elif mass != drawn_mass or (factors != 1.0).any():
        xx, yy, zz, xy, xz, yz = (float(inertia_element.get(name, "0")) for name in _MOMENTS)
        tensor = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        second = 0.5 * np.trace(tensor) * np.eye(3) - tensor
        second *= mass / drawn_mass * np.outer(factors, factors)
        inertia = np.trace(second) * np.eye(3) - second
        rows = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        moments = dict(zip(_MOMENTS, inertia[rows].tolist(), strict=True))
    else:
        return
    for name, value in moments.items():
        inertia_element.set(name, repr(value))
