"""Scenarios as plain data, described by dataclasses: completed, overlaid, made objects again."""

import dataclasses
import functools
import types
import typing
from collections.abc import Iterator
from typing import Any

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import RULE, Rule

# Key under which Drake's YAML reader keeps a mapping's tag.
TAG = "_tag"


class Variant:
    """Base of dataclasses between which a scenario chooses with a YAML tag, as in `!Name {...}`.

    A direct subclass is the root of one such family. Every dataclass derived from the root, in
    whatever package, can be chosen by its name as soon as it is defined.
    """

    @classmethod
    def variants(cls) -> dict[str, type]:
        """The dataclasses of a family by their names, in the order of their definition.

        Raises:
            ScenarioError: two have the same name.
        """
        found: dict[str, type] = {}
        for variant in cls._descendants():
            other = found.get(variant.__name__)
            # In the same module the later one takes the place of the earlier.
            if other is not None and other.__module__ != variant.__module__:
                raise ScenarioError(
                    f"!{variant.__name__} is defined twice, in {other.__module__} and in "
                    f"{variant.__module__}"
                )
            found[variant.__name__] = variant
        return found

    @classmethod
    def _descendants(cls) -> Iterator[type["Variant"]]:
        for variant in cls.__subclasses__():
            if not variant.__name__.startswith("_"):
                yield variant
            yield from variant._descendants()


def overlay(kind: Any, base: Any, layer: Any) -> Any:
    """Checked data laid over a complete tree; what is new is completed with defaults.

    Another variant of a family than the one below is new.
    """
    kind, _ = split_optional(kind)
    if layer is None:
        return None
    if typing.get_origin(kind) is list:
        return [overlay(typing.get_args(kind)[0], None, item) for item in layer]
    if is_family(kind):
        base = None if base is None or base[TAG] != layer[TAG] else base
        kind = variant_of(kind, layer)
        layer = {k: item for k, item in layer.items() if k != TAG}
    if not is_schema(kind):
        return layer
    base = defaults(kind) if base is None else base
    fields = fields_of(kind)
    return base | {k: overlay(fields[k][0], base[k], item) for k, item in layer.items()}


def defaults(kind: Any) -> dict[str, Any]:
    """What a schema holds when nothing is said, as plain data."""
    return plain(kind())


def plain(value: Any) -> Any:
    """Dataclasses as dicts, with attributes that a typo has added, and tuples as lists."""
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if not dataclasses.is_dataclass(value):
        return value
    names = [field.name for field in dataclasses.fields(value)]
    added = [n for n in getattr(value, "__dict__", {}) if not hasattr(type(value), n)]
    tag: dict[str, Any] = {TAG: f"!{type(value).__name__}"} if isinstance(value, Variant) else {}
    return tag | {n: plain(getattr(value, n)) for n in dict.fromkeys(names + added)}


def build(kind: Any, tree: Any) -> Any:
    """The dataclasses that a complete, checked tree describes."""
    kind, _ = split_optional(kind)
    if tree is None:
        return None
    if typing.get_origin(kind) is list:
        return [build(typing.get_args(kind)[0], item) for item in tree]
    if is_family(kind):
        kind = variant_of(kind, tree)
    if not is_schema(kind):
        return tree
    return kind(**{name: build(inner, tree[name]) for name, (inner, _) in fields_of(kind).items()})


@functools.cache
def fields_of(kind: type) -> dict[str, tuple[Any, Rule]]:
    """Kind and rule of each field of a dataclass, by its name."""
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {field.name: (hints[field.name], field.metadata.get(RULE)) for field in fields}


def is_family(kind: Any) -> bool:
    """Whether it is a family of dataclasses between which a tag chooses."""
    return isinstance(kind, type) and issubclass(kind, Variant)


def variant_of(family: type[Variant], node: Any) -> type:
    """The dataclass that a checked mapping's tag names."""
    return family.variants()[node[TAG].removeprefix("!")]


def is_schema(kind: Any) -> bool:
    """Whether it is a dataclass."""
    return dataclasses.is_dataclass(kind)


def split_optional(kind: Any) -> tuple[Any, bool]:
    """A kind without its None, and whether it had one."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        inner = [item for item in typing.get_args(kind) if item is not types.NoneType]
        if len(inner) == 1:
            return inner[0], True
    return kind, False
