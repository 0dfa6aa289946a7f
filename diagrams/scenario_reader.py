"""Checks plain data against a schema of dataclasses; says in one line what is wrong."""

import math
import numbers
import typing
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from parapod.diagrams.scenario_tree import (
    TAG,
    Variant,
    defaults,
    fields_of,
    is_family,
    is_schema,
    overlay,
    split_optional,
    variant_of,
)
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Options, Range, Rule, did_you_mean, show


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
        kind, is_optional = split_optional(kind)
        if value is None and is_optional:
            return None
        if is_family(kind):
            return self._read_variant(kind, value, key)
        if is_schema(kind):
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
            hint = did_you_mean(str(value), [str(option) for option in rule.options])
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
        kind, _ = split_optional(kind)
        if is_family(kind):
            if node is None:
                self._refuse(key, f"is null; give it whole, with one of the tags {_tags(kind)}")
            kind = variant_of(kind, node)
        head, rest = keys[0], keys[1:]
        inner = _join(key, head)
        if is_schema(kind):
            fields = fields_of(kind)
            if head not in fields:
                self._refuse_key(kind, head, key)
            node = defaults(kind) if node is None else node
            inner_kind, inner_rule = fields[head]
            child = self.assign(inner_kind, node[head], rest, value, inner, inner_rule)
            return node | {head: child}
        if typing.get_origin(kind) is list:
            inner_kind = typing.get_args(kind)[0]
            if node is None:
                self._refuse(key, f"is null; give it whole, {_list_of(inner_kind, rule)}")
            count = len(node)
            if not head.isdecimal() or int(head) >= count:
                elements = f"has elements 0..{count - 1}" if count else "is empty"
                self._fail(inner, f"unknown key '{inner}'; '{key}' {elements}")
            child = self.assign(inner_kind, node[int(head)], rest, value, inner, rule)
            return [child if i == int(head) else node[i] for i in range(count)]
        self._fail(inner, f"unknown key '{inner}'; '{key}' is {_noun(kind)}, not a mapping")

    def _read_variant(self, family: type[Variant], value: Any, key: str) -> dict[str, Any]:
        known = family.variants()
        tag = value.get(TAG) if isinstance(value, dict) else None
        name = str(tag).removeprefix("!")
        if name not in known:
            hint = did_you_mean(name, list(known))
            given = show(value) if tag is None else tag
            self._refuse(
                key, f"must begin with one of the tags {_tags(family)}, not {given}{hint}"
            )
        fields = {k: item for k, item in value.items() if k != TAG}
        return {TAG: f"!{name}"} | self._read_mapping(known[name], fields, key)

    def _read_mapping(self, kind: type, value: Any, key: str) -> dict[str, Any]:
        fields = fields_of(kind)
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
            self._refuse(key, f"must be {_list_of(kind, rule)}, not {show(value)}")
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
        allowed = sorted(fields_of(kind))
        hint = did_you_mean(name, allowed)
        if not hint:
            elsewhere = [k for k in _dotted(self._schema) if k.split(".")[-1] == name]
            hint = f" (did you mean {elsewhere[0]}?)" if elsewhere else ""
        under = f" under '{parent}'" if parent else ""
        self._fail(key, f"unknown key '{key}'; allowed{under}: {', '.join(allowed)}{hint}")

    def _refuse(self, key: str, reason: str) -> NoReturn:
        self._fail(key, f"{key} {reason}")

    def _fail(self, key: str, message: str) -> NoReturn:
        raise ScenarioError(f"{self._source}: {message}" if self._source else message, key)


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


def _dotted(kind: Any, key: str = "") -> Iterator[str]:
    """Every key below a dataclass, outer ones first; elements of lists are left out."""
    for name, (inner, _) in fields_of(kind).items():
        yield _join(key, name)
        inner, _ = split_optional(inner)
        if is_schema(inner):
            yield from _dotted(inner, _join(key, name))


def _tags(family: type[Variant]) -> str:
    return ", ".join(f"!{name}" for name in family.variants())


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


def _list_of(kind: Any, rule: Rule) -> str:
    length = rule.length if isinstance(rule, Range) else None
    count = "" if length is None else f"{length} "
    return f"a list of {count}{_plural(kind)}"


def _plural(kind: Any) -> str:
    return _NOUNS.get(split_optional(kind)[0], ("", "mappings"))[1]
