"""Typed scenarios: dataclasses that YAML files and `key=value` overrides fill in, checked.

A schema is a dataclass (not frozen: Drake's loader assigns to it) whose fields all have defaults:

    @dataclass
    class Ground:
        pitch_deg: float = quantity(5.0, -15.0, 15.0)

    @dataclass
    class Scenario:
        backend: str = choice("kinematic", ("kinematic", "multibody"))
        seed: int = quantity(0, 0, 2**31 - 1)
        ground: Ground = field(default_factory=Ground)

Fields may be float, int, bool, str, another such dataclass, a list of any of these, or any of
these or None. `Literal` is not supported by Drake's loader: use `choice`.

Layers are merged in the order schema, default file, user's file, overrides. A mapping is merged
key by key; a list replaces the list below it. Root keys that begin with an underscore are free
for YAML anchors. Whatever is wrong with a scenario is a `ScenarioError` of one line.
"""

import dataclasses
import difflib
import functools
import math
import numbers
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml  # type: ignore[import-untyped]
from pydrake.common.yaml import yaml_load_data, yaml_load_typed

from parapod.systems.errors import ScenarioError

_RULE = "parapod.rule"
# Longest value that an error message repeats.
_LONGEST_SHOWN = 60


@dataclass(frozen=True)
class _Range:
    """Admissible range of a number, or of every number of a list with `length` elements."""

    low: float
    high: float
    length: int | None = None

    def __str__(self) -> str:
        return f"{_show(self.low)}..{_show(self.high)}"


@dataclass(frozen=True)
class _Options:
    """Admissible values of a choice."""

    options: tuple[Any, ...]


type _Rule = _Range | _Options | None


def quantity(default: Any, low: float, high: float, *, length: int | None = None) -> Any:
    """Field of a schema: a number, or a list of numbers, with an admissible range.

    Args:
        default: the default; a list is copied; None for an optional number.
        low: smallest admissible value, of every element if it is a list.
        high: largest admissible value.
        length: how many elements a list must have; None for any number of them.
    """
    metadata = {_RULE: _Range(low, high, length)}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def choice(default: Any, options: Sequence[Any]) -> Any:
    """Field of a schema: one of a few admissible values."""
    return dataclasses.field(default=default, metadata={_RULE: _Options(tuple(options))})


def load_scenario[T](
    schema: type[T],
    default_file: Path,
    file: Path | None = None,
    overrides: Sequence[str] = (),
) -> T:
    """Scenario made of the schema's defaults, the default file, the user's file and overrides.

    Args:
        schema: the dataclass to fill in.
        default_file: the experiment's own scenario; may name all keys or only some.
        file: the user's scenario; only the keys it names change.
        overrides: `dotted.key=value` with the value in YAML; elements of a list are named by
            their number, as in `waypoints.0.roll_deg=1`.

    Raises:
        ScenarioError: anything wrong with a file or an override.
    """
    tree = _defaults(schema)
    _Reader(schema, f"schema {schema.__name__}", is_text=False).read(schema, tree)
    for path in (default_file, file):
        if path is not None:
            source = f"scenario {path}"
            data = _parse(_read_text(path), source)
            layer = _Reader(schema, source).read(schema, {} if data is None else data)
            tree = _overlay(schema, tree, layer)
    for override in overrides:
        key, equals, value = override.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ScenarioError(f"override {_show(override)} is not of the form key=value", key)
        data = _parse(value, f"override {_show(override)}", private=True)
        tree = _Reader(schema).assign(schema, tree, key.split("."), data)
    return yaml_load_typed(schema=schema, data=_dump(tree))


def check(scenario: object) -> None:
    """Refuses a scenario made in Python for the reasons that `load_scenario` has.

    Raises:
        ScenarioError: an attribute that the schema does not have, or a value not allowed.
    """
    _Reader(type(scenario), is_text=False).read(type(scenario), _plain(scenario))


def dump_scenario(scenario: object) -> str:
    """The whole scenario as YAML text from which `load_scenario` makes an equal one.

    Unlike Drake's `yaml_dump_typed` it writes None as null: left out, an optional value would
    come back as whatever the default file says.

    Raises:
        ScenarioError: as `check`.
    """
    reader = _Reader(type(scenario), is_text=False)
    return _dump(reader.read(type(scenario), _plain(scenario)))


class _Reader:
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

    def read(self, kind: Any, value: Any, key: str = "", rule: _Rule = None) -> Any:
        """The value as plain data of a kind; a mapping keeps only the keys it has."""
        kind, is_optional = _split_optional(kind)
        if value is None and is_optional:
            return None
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
                self._refuse(key, f"must be true or false, not {_show(value)}")
        elif kind is str:
            if not isinstance(value, str):
                options = f", one of {_listing(rule)}" if isinstance(rule, _Options) else ""
                self._refuse(key, f"must be text{options}, not {_show(value)}")
        else:
            raise TypeError(f"scenarios do not support the type {kind} of '{key}'")
        if isinstance(rule, _Options) and value not in rule.options:
            hint = _did_you_mean(str(value), [str(option) for option in rule.options])
            self._refuse(key, f"= {_show(value)} is not one of {_listing(rule)}{hint}")
        return value

    def assign(
        self,
        kind: Any,
        node: Any,
        keys: Sequence[str],
        value: Any,
        key: str = "",
        rule: _Rule = None,
    ) -> Any:
        """A copy of a complete tree in which the value that `keys` lead to is replaced."""
        if not keys:
            return _overlay(kind, node, self.read(kind, value, key, rule))
        kind, _ = _split_optional(kind)
        head, rest = keys[0], keys[1:]
        inner = _join(key, head)
        if _is_schema(kind):
            fields = _fields(kind)
            if head not in fields:
                self._refuse_key(kind, head, key)
            node = _defaults(kind) if node is None else node
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

    def _read_mapping(self, kind: type, value: Any, key: str) -> dict[str, Any]:
        fields = _fields(kind)
        if not isinstance(value, dict):
            what = f"'{key}'" if key else "a scenario"
            allowed = ", ".join(sorted(fields))
            self._fail(key, f"{what} must be a mapping with keys {allowed}, not {_show(value)}")
        if "_tag" in value:
            self._refuse(key, f"must not have a tag, not {_show(value['_tag'])}")
        for name in value:
            if name not in fields:
                self._refuse_key(kind, str(name), key)
        return {
            name: self.read(fields[name][0], item, _join(key, name), fields[name][1])
            for name, item in value.items()
        }

    def _read_list(self, kind: Any, value: Any, key: str, rule: _Rule) -> list[Any]:
        length = rule.length if isinstance(rule, _Range) else None
        if not isinstance(value, list) or length not in (None, len(value)):
            count = "" if length is None else f"{length} "
            self._refuse(key, f"must be a list of {count}{_plural(kind)}, not {_show(value)}")
        return [self.read(kind, item, _join(key, str(i)), rule) for i, item in enumerate(value)]

    def _read_number(self, kind: type, value: Any, key: str, rule: _Rule) -> float | int:
        number = _number(value, self._is_text)
        if number is None:
            self._refuse(key, f"must be {_noun(kind)}, not {_show(value)}")
        if not math.isfinite(number):
            allowed = f" in {rule}" if isinstance(rule, _Range) else ""
            self._refuse(key, f"must be a finite number{allowed}, not {_show(number)}")
        if kind is int and number != int(number):
            self._refuse(key, f"must be {_noun(kind)}, not {_show(number)}")
        if isinstance(rule, _Range) and not rule.low <= number <= rule.high:
            self._refuse(key, f"= {_show(number)} is outside {rule}")
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


class _Dumper(yaml.SafeDumper):
    """Mappings over several lines, lists of scalars on one, no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: Any = None) -> Any:
        is_flat = not any(isinstance(item, dict | list) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=is_flat)


def _dump(tree: dict[str, Any]) -> str:
    options: dict[str, Any] = {"default_flow_style": False, "sort_keys": False}
    return yaml.dump(tree, Dumper=_Dumper, allow_unicode=True, **options)


def _read_text(path: Path) -> str:
    try:
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ScenarioError(f"scenario file '{path}' does not exist") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"scenario file '{path}' is not text in UTF-8") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"scenario file '{path}' cannot be read: {reason}") from None


def _parse(text: str, source: str, private: bool = False) -> Any:
    """Plain data; unless private, without root keys that begin with an underscore."""
    try:
        _refuse_duplicates(yaml.compose(text, Loader=yaml.SafeLoader), source, set())
        return yaml_load_data(text, private=private)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark else ""
        raise ScenarioError(f"{source}{line}: {_one_line(error.problem)}") from None
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        raise ScenarioError(f"{source} is not YAML: {_one_line(error)}") from None


def _refuse_duplicates(node: Any, source: str, seen: set[int]) -> None:
    """Refuses a key that is given twice, of which YAML would silently drop the first."""
    if not isinstance(node, yaml.CollectionNode) or id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_duplicates(item, source, seen)
        return
    lines: dict[str, int] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if isinstance(key, yaml.ScalarNode):
            if key.value in lines:
                first = lines[key.value]
                message = f"key '{key.value}' is already given in line {first}"
                raise ScenarioError(f"{source}, line {line}: {message}", key.value)
            lines[key.value] = line
        _refuse_duplicates(value, source, seen)


def _overlay(kind: Any, base: Any, layer: Any) -> Any:
    """Checked data laid over a complete tree; what is new is completed with defaults."""
    kind, _ = _split_optional(kind)
    if layer is None:
        return None
    if typing.get_origin(kind) is list:
        return [_overlay(typing.get_args(kind)[0], None, item) for item in layer]
    if not _is_schema(kind):
        return layer
    base = _defaults(kind) if base is None else base
    fields = _fields(kind)
    return base | {k: _overlay(fields[k][0], base[k], item) for k, item in layer.items()}


def _defaults(kind: Any) -> dict[str, Any]:
    return _plain(kind())


def _plain(value: Any) -> Any:
    """Dataclasses as dicts, with attributes that a typo has added, and tuples as lists."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if not dataclasses.is_dataclass(value):
        return value
    names = [field.name for field in dataclasses.fields(value)]
    added = [n for n in getattr(value, "__dict__", {}) if not hasattr(type(value), n)]
    return {n: _plain(getattr(value, n)) for n in dict.fromkeys(names + added)}


@functools.cache
def _fields(kind: type) -> dict[str, tuple[Any, _Rule]]:
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {field.name: (hints[field.name], field.metadata.get(_RULE)) for field in fields}


def _dotted(kind: Any, key: str = "") -> Iterator[str]:
    """Every key below a dataclass, outer ones first; elements of lists are left out."""
    for name, (inner, _) in _fields(kind).items():
        yield _join(key, name)
        inner, _ = _split_optional(inner)
        if _is_schema(inner):
            yield from _dotted(inner, _join(key, name))


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


def _show(value: Any) -> str:
    """A value as the user would write it, in one line, not too long."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return repr(float(value)).removesuffix(".0")
    text = _one_line(repr(value))
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 3]}..."


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def _listing(rule: _Options) -> str:
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
