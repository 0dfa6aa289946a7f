"""Designs of machines: checks that hold for all kinds of them."""

import copy
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

from parapod.diagrams.bodies import BodyScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Options, fields_of

# Ratio of a length to the usual one beyond which it is taken for one in another unit [-], and the
# shortest usual length of which that can be said [mm].
_ANOTHER_UNIT, _SHORTEST = 100.0, 5.0
# The machine that was checked last: the runs of a study mostly have one.
_sound: list[Any] = []


def check_design(machine: Any) -> None:
    """Refuses a machine of bodies that nothing can be, or of lengths in another unit.

    A design has a method `check` for what its kind of machine cannot do, such as lift itself.

    Args:
        machine: the part `machine` of a scenario.

    Raises:
        ScenarioError: names the key.
    """
    if _sound and _sound[-1] == machine:
        return
    for key, part, usual in _parts(machine, _published(machine), "machine"):
        if isinstance(part, BodyScenario):
            part.check(key)
        for each in fields(part):
            if each.name.endswith("_mm"):
                name = f"{key}.{each.name}"
                _check_unit(name, getattr(part, each.name), getattr(usual, each.name, None))
    if hasattr(type(machine), "geometry"):
        _ = machine.geometry  # which refuses what cannot be built
    if hasattr(machine, "check"):
        machine.check()
    # Files that a machine is read from may change.
    if not _is_read(machine, "urdf", "file"):
        _sound[:] = [copy.deepcopy(machine)]


def is_published(machine: Any) -> bool:
    """Whether a machine has the dimensions and the masses of its paper.

    Args:
        machine: the part `machine` of a scenario.
    """
    usual = _published(machine)
    if _is_read(machine, "urdf"):
        return False
    names = [name for name in ("geometry", "bodies") if name in dir(machine)]
    if not names:  # a kind of one's own, without the bodies of parapod's
        return bool(machine == usual)
    return all(getattr(machine, name) == getattr(usual, name) for name in names)


def _is_read(machine: Any, *names: str) -> bool:
    """Whether a part of a machine is read from a file that an attribute of these names has."""
    parts = _parts(machine, _published(machine), "machine")
    return any(getattr(part, name, "") for _, part, _ in parts for name in names)


def _published(machine: Any) -> Any:
    """The paper's machine of the same kind: what can be chosen from a list is as chosen."""
    kind: Any = type(machine)
    rules = {name: rule for name, (_, rule) in fields_of(kind).items()}
    choices = [name for name, rule in rules.items() if isinstance(rule, Options)]
    return _usual(kind, tuple((name, getattr(machine, name)) for name in choices))


@lru_cache(maxsize=16)
def _usual(kind: Any, choices: tuple[tuple[str, Any], ...]) -> Any:
    return kind(**dict(choices))


def _parts(part: Any, usual: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    """A design and all that it holds: key, the part, the same part of the paper's machine."""
    if isinstance(part, list):
        for number, item in enumerate(part):
            if is_dataclass(item):
                yield from _parts(item, None, f"{key}.{number}")
    elif is_dataclass(part):
        yield key, part, usual
        for each in fields(part):
            inner = getattr(part, each.name), getattr(usual, each.name, None)
            yield from _parts(*inner, f"{key}.{each.name}")


def _check_unit(key: str, length: Any, usual: Any) -> None:
    numbers = all(isinstance(each, int | float) for each in (length, usual))
    if not numbers or usual < _SHORTEST or not length > 0.0:
        return
    ratio = length / usual
    if not 1.0 / _ANOTHER_UNIT < ratio < _ANOTHER_UNIT:
        raise ScenarioError(
            f"{key} = {length:g} mm, where {usual:g} mm is usual: is it in another unit than mm?",
            key,
        )
