"""Checks plain data against a schema of dataclasses; says in one line what is wrong."""

import dataclasses
import difflib
import functools
import math
import numbers
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from parapod.systems.errors import ScenarioError

RULE = "parapod.rule"
# Key under which Drake's YAML reader keeps a mapping's tag.
TAG = "_tag"
# Longest value that an error message repeats.
_LONGEST_SHOWN = 60


@dataclass(frozen=True)
class Range:
    """Admissible range of a number, or of every number of a list with `length` elements."""

    low: float
    high: float
    length: int | None = None

    def __str__(self) -> str:
        return f"{show(self.low)}..{show(self.high)}"


@dataclass(frozen=True)
class Options:
    """Admissible values of a choice."""

    options: tuple[Any, ...]


type Rule = Range | Options | None


class Variant:
    """Base of dataclasses between which a scenario chooses with a YAML tag, as in `!Name {...}`.

    A direct subclass is the root of one such family. Every dataclass derived from the root, in
    whatever package, can be chosen by its name as soon as it is defined.
    """

    @classmethod
    def variants(cls) -> dict[str, type]:
        """The dataclasses of a family by their names, in the order of their definition."""
        found: dict[str, type] = {}
        for variant in cls.__subclasses__():
            if not variant.__name__.startswith("_"):
                found[variant.__name__] = variant
            found |= variant.variants()
        return found


class Reader:
    """Checks plain data against a schema and converts it to the schema's types.

    Args:
        schema: the root, which knows every key.
        source: where the data come from, for messages; "" if the user sees that anyhow.
        is_text: the data were parsed from YAML, which leaves numbers such as 1e-3 as text.
    """

    def __init__(self, schema: type, source: str = "", is_text: bool = True):
        self._schema = schema
        self._source = source
        self._is_text = is_text

    def read(self, kind: Any, value: Any, key: str = "", rule: Rule = None) -> Any:
        """The value as plain data of a kind; a mapping keeps only the keys it has."""
        kind, is_optional = _split_optional(kind)
        if value is None and is_optional:
            return None
        if _is_family(kind):
            return self._read_variant(kind, value, key)
        if _is_schema(kind):
            return self._read_mapping(kind, value, key)
        if typing.get_origin(kind) is list:
            return self._read_list(typing.get_args(kind)[0], value, key, rule)
        if kind in (float, int):
            value = self._read_number(kind, value, key, rule)
        elif kind is bool:
            if self._is_text and value in ("true", "false"):
                value = value == "true"
            if not isinstance(value, bool):
                self._refuse(key, f"must be true or false, not {show(value)}")
        elif kind is str:
            if self._is_text and value is False and isinstance(rule, Options):
                # YAML 1.1 reads an unquoted off as false.
                value = "off" if "off" in rule.options else value
            if not isinstance(value, str):
                options = f", one of {_listing(rule)}" if isinstance(rule, Options) else ""
                self._refuse(key, f"must be text{options}, not {show(value)}")
        else:
            raise TypeError(f"scenarios do not support the type {kind} of '{key}'")
        if isinstance(rule, Options) and value not in rule.options:
            hint = _did_you_mean(str(value), [str(option) for option in rule.options])
            self._refuse(key, f"= {show(value)} is not one of {_listing(rule)}{hint}")
        return value

    def assign(
        self,
        kind: Any,
        node: Any,
        keys: Sequence[str],
        value: Any,
        key: str = "",
        rule: Rule = None,
    ) -> Any:
        """A copy of a complete tree in which the value that `keys` lead to is replaced."""
        if not keys:
            return overlay(kind, node, self.read(kind, value, key, rule))
        kind, _ = _split_optional(kind)
        if _is_family(kind):
            kind = _variant_of(kind, node)
        head, rest = keys[0], keys[1:]
        inner = _join(key, head)
        if _is_schema(kind):
            fields = _fields(kind)
            if head not in fields:
                self._refuse_key(kind, head, key)
            node = defaults(kind) if node is None else node
            inner_kind, inner_rule = fields[head]
            child = self.assign(inner_kind, node[head], rest, value, inner, inner_rule)
            return node | {head: child}
        if typing.get_origin(kind) is list:
            count = 0 if node is None else len(node)
            if not head.isdecimal() or int(head) >= count:
                elements = f"has elements 0..{count - 1}" if count else "is empty"
                self._fail(inner, f"unknown key '{inner}'; '{key}' {elements}")
            inner_kind = typing.get_args(kind)[0]
            child = self.assign(inner_kind, node[int(head)], rest, value, inner, rule)
            return [child if i == int(head) else node[i] for i in range(count)]
        self._fail(inner, f"unknown key '{inner}'; '{key}' is {_noun(kind)}, not a mapping")

    def _read_variant(self, family: type[Variant], value: Any, key: str) -> dict[str, Any]:
        known = family.variants()
        tag = value.get(TAG) if isinstance(value, dict) else None
        name = str(tag).removeprefix("!")
        if name not in known:
            tags = ", ".join(f"!{name}" for name in known)
            hint = _did_you_mean(name, list(known))
            given = show(value) if tag is None else tag
            self._refuse(key, f"must begin with one of the tags {tags}, not {given}{hint}")
        fields = {k: item for k, item in value.items() if k != TAG}
        return {TAG: f"!{name}"} | self._read_mapping(known[name], fields, key)

    def _read_mapping(self, kind: type, value: Any, key: str) -> dict[str, Any]:
        fields = _fields(kind)
        if not isinstance(value, dict):
            what = f"'{key}'" if key else "a scenario"
            allowed = ", ".join(sorted(fields))
            self._fail(key, f"{what} must be a mapping with keys {allowed}, not {show(value)}")
        if TAG in value:
            self._refuse(key, f"must not have a tag, not {show(value[TAG])}")
        for name in value:
            if name not in fields:
                self._refuse_key(kind, str(name), key)
        return {
            name: self.read(fields[name][0], item, _join(key, name), fields[name][1])
            for name, item in value.items()
        }

    def _read_list(self, kind: Any, value: Any, key: str, rule: Rule) -> list[Any]:
        length = rule.length if isinstance(rule, Range) else None
        if not isinstance(value, list) or length not in (None, len(value)):
            count = "" if length is None else f"{length} "
            self._refuse(key, f"must be a list of {count}{_plural(kind)}, not {show(value)}")
        return [self.read(kind, item, _join(key, str(i)), rule) for i, item in enumerate(value)]

    def _read_number(self, kind: type, value: Any, key: str, rule: Rule) -> float | int:
        number = _number(value, self._is_text)
        if number is None:
            self._refuse(key, f"must be {_noun(kind)}, not {show(value)}")
        if not math.isfinite(number):
            allowed = f" in {rule}" if isinstance(rule, Range) else ""
            self._refuse(key, f"must be a finite number{allowed}, not {show(number)}")
        if kind is int and number != int(number):
            self._refuse(key, f"must be {_noun(kind)}, not {show(number)}")
        if isinstance(rule, Range) and not rule.low <= number <= rule.high:
            self._refuse(key, f"= {show(number)} is outside {rule}")
        return int(number) if kind is int else float(number)

    def _refuse_key(self, kind: type, name: str, parent: str) -> NoReturn:
        key = _join(parent, name)
        allowed = sorted(_fields(kind))
        hint = _did_you_mean(name, allowed)
        if not hint:
            elsewhere = [k for k in _dotted(self._schema) if k.split(".")[-1] == name]
            hint = f" (did you mean {elsewhere[0]}?)" if elsewhere else ""
        under = f" under '{parent}'" if parent else ""
        self._fail(key, f"unknown key '{key}'; allowed{under}: {', '.join(allowed)}{hint}")

    def _refuse(self, key: str, reason: str) -> NoReturn:
        self._fail(key, f"{key} {reason}")

    def _fail(self, key: str, message: str) -> NoReturn:
        raise ScenarioError(f"{self._source}: {message}" if self._source else message, key)


def overlay(kind: Any, base: Any, layer: Any) -> Any:
    """Checked data laid over a complete tree; what is new is completed with defaults."""
    kind, _ = _split_optional(kind)
    if layer is None:
        return None
    if typing.get_origin(kind) is list:
        return [overlay(typing.get_args(kind)[0], None, item) for item in layer]
    if _is_family(kind):
        kind = _variant_of(kind, layer if base is None else base)
        layer = {k: item for k, item in layer.items() if k != TAG}
    if not _is_schema(kind):
        return layer
    base = defaults(kind) if base is None else base
    fields = _fields(kind)
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
    kind, _ = _split_optional(kind)
    if typing.get_origin(kind) is list:
        return None if tree is None else [build(typing.get_args(kind)[0], item) for item in tree]
    if _is_family(kind):
        kind = _variant_of(kind, tree)
    if tree is None or not _is_schema(kind):
        return tree
    return kind(**{name: build(inner, tree[name]) for name, (inner, _) in _fields(kind).items()})


@functools.cache
def _fields(kind: type) -> dict[str, tuple[Any, Rule]]:
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {field.name: (hints[field.name], field.metadata.get(RULE)) for field in fields}


def _dotted(kind: Any, key: str = "") -> Iterator[str]:
    """Every key below a dataclass, outer ones first; elements of lists are left out."""
    for name, (inner, _) in _fields(kind).items():
        yield _join(key, name)
        inner, _ = _split_optional(inner)
        if _is_schema(inner):
            yield from _dotted(inner, _join(key, name))


def _is_family(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Variant)


def _variant_of(family: type[Variant], node: Any) -> type:
    """The dataclass that a checked mapping's tag names."""
    return family.variants()[node[TAG].removeprefix("!")]


def _is_schema(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind)


def _split_optional(kind: Any) -> tuple[Any, bool]:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        inner = [item for item in typing.get_args(kind) if item is not types.NoneType]
        if len(inner) == 1:
            return inner[0], True
    return kind, False


def _number(value: Any, is_text: bool) -> float | int | None:
    """The number that a value is, or None; text such as 1e-3 is a number only in YAML."""
    if isinstance(value, str) and is_text:
        try:
            return float(value)
        except ValueError:
            return None
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    if isinstance(value, numbers.Integral):
        # Beyond the range of float, which math.isfinite could not take.
        return int(value) if abs(int(value)) < 10**300 else math.inf
    return float(value)


def _did_you_mean(name: str, allowed: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, allowed, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def show(value: Any) -> str:
    """A value as the user would write it, in one line, not too long."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return repr(float(value)).removesuffix(".0")
    text = one_line(repr(value))
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 3]}..."


def one_line(text: object) -> str:
    """Text without line breaks."""
    return " ".join(str(text).split())


def _listing(rule: Options) -> str:
    return ", ".join(str(option) for option in rule.options)


def _join(parent: str, name: str) -> str:
    return f"{parent}.{name}" if parent else name


_NOUNS: dict[Any, tuple[str, str]] = {
    float: ("a number", "numbers"),
    int: ("a whole number", "whole numbers"),
    bool: ("true or false", "booleans"),
    str: ("text", "texts"),
}


def _noun(kind: Any) -> str:
    return _NOUNS.get(kind, ("a value", ""))[0]


def _plural(kind: Any) -> str:
    return _NOUNS.get(_split_optional(kind)[0], ("", "mappings"))[1]
