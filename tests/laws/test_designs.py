"""Laws of the designs of all machines: similarity, and the words for what cannot be built."""

import copy
from collections.abc import Iterator
from dataclasses import astuple, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from parapod.diagrams.bodies import BodyScenario
from parapod.diagrams.designs import check_design, is_published
from parapod.diagrams.machine import list_machines
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import check

MACHINES = list_machines()
each_machine = pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
each_scale = pytest.mark.parametrize("scale", [0.6, 1.9])
# Powers of the scale with which fields of masses grow; others are masses, and grow with its cube.
POWERS = {
    "arm_base": 1,
    "arm_centre": 1,
    "body_height": 1,
    "centre": 1,
    "centre_of_mass": 1,
    "arm_inertia": 5,
    "inertia": 5,
    "foot_stiffness": 0,
    "wheel_stiffness": 0,
    "gravity": 0,
}


def parts(part: Any, key: str = "machine") -> Iterator[tuple[str, Any]]:
    if isinstance(part, list):
        for number, item in enumerate(part):
            yield from parts(item, f"{key}.{number}")
    elif is_dataclass(part):
        yield key, part
        for each in fields(part):
            yield from parts(getattr(part, each.name), f"{key}.{each.name}")


def settled(design: Any) -> Any:
    """The design with what follows from the rest, to a millimetre or from a preset, as numbers."""
    design = copy.deepcopy(design)
    if hasattr(design, "wheels"):
        design.wheels.depth_mm = -1e3 * design.wheel_geometry.height
    for name in ("link", "strut", "lever", "plate"):
        if hasattr(design, f"{name}_mm"):
            setattr(design, f"{name}_mm", 1e3 * getattr(design.geometry, name))
    for name in ("plate", "tread"):
        if hasattr(design, name):
            setattr(design, name, BodyScenario(design.bodies[name].mass))
    return design


def similar(design: Any, scale: float) -> Any:
    """A design of other lengths, and of masses that go with their cube."""
    design = settled(design)
    for _, part in parts(design):
        for each in fields(part):
            value = getattr(part, each.name)
            if value is None:
                continue
            if each.name.endswith("_mm"):
                lengths = (scale * np.array(value)).tolist()
                setattr(part, each.name, lengths)
            elif each.name == "mass_kg":
                part.mass_kg = scale**3 * value
            elif each.name == "inertia_kg_m2":
                part.inertia_kg_m2 = [scale**5 * moment for moment in value]
    return design


def scaled(masses: Any, scale: float) -> Any:
    if not is_dataclass(masses):
        raise TypeError(masses)
    grown = {}
    for each in fields(masses):
        value = getattr(masses, each.name)
        if is_dataclass(value):
            grown[each.name] = scaled(value, scale)
        else:
            factor = scale ** POWERS.get(each.name, 3)
            grown[each.name] = (
                tuple((factor * np.array(value)).tolist()) if np.ndim(value) else (factor * value)
            )
    return replace(masses, **grown)


def numbers(data: Any) -> list[float]:
    return [x for item in data for x in (numbers(item) if isinstance(item, tuple) else [item])]


@each_machine
@each_scale
def test_a_machine_of_another_size_has_the_masses_of_a_similar_one(machine, scale):
    design = machine.scenario().machine
    other = similar(design, scale)
    check_design(other)
    found, wanted = numbers(astuple(other.masses)), numbers(astuple(scaled(design.masses, scale)))
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


@each_machine
def test_only_the_papers_machine_is_published(machine):
    design = machine.scenario().machine
    assert is_published(design)
    assert not is_published(similar(design, 1.1))
    heavier = copy.deepcopy(design)
    body = next(part for _, part in parts(heavier) if isinstance(part, BodyScenario))
    body.mass_kg *= 1.1
    assert not is_published(heavier)


@each_machine
def test_a_body_that_cannot_be_is_named(machine):
    bodies = [key for key, part in parts(machine.scenario().machine) if type(part) is BodyScenario]
    assert bodies
    for wrong in bodies:
        design = machine.scenario().machine
        dict(parts(design))[wrong].inertia_kg_m2 = [1.0, 1.0, 3.0, 0.0, 0.0, 0.0]
        with pytest.raises(ScenarioError, match="is of no body") as caught:
            check_design(design)
        assert caught.value.key == f"{wrong}.inertia_kg_m2"


def read_in_metres(scenario: Any, key: str, name: str) -> None:
    part = dict(parts(scenario.machine))[key]
    setattr(part, name, 1e-3 * getattr(part, name))
    check(scenario)  # a range may refuse it before
    check_design(scenario.machine)


@each_machine
def test_a_length_in_metres_is_told(machine):
    lengths = [
        (key, each.name)
        for key, part in parts(machine.scenario().machine)
        for each in fields(part)
        if each.name.endswith("_mm")
        and isinstance(value := getattr(part, each.name), float)
        and value >= 200.0
        and ".each_leg." not in key
        and ".placements." not in key
    ]
    assert lengths
    for key, name in lengths:
        scenario = machine.scenario()
        with pytest.raises(ScenarioError, match=r"another unit than mm|is outside") as caught:
            read_in_metres(scenario, key, name)
        assert caught.value.key.endswith(name)
