"""Schemas: dataclasses that say which scenarios there are, and refuse all others.

    @dataclass
    class Ground(Schema):
        pitch_deg: float = quantity(5.0, -15.0, 15.0)

    @dataclass
    class Scenario(Schema):
        backend: str = choice("kinematic", ("kinematic", "multibody"))
        seed: int = quantity(0, 0, 2**31 - 1)
        ground: Ground = field(default_factory=Ground)

Every field has a default. It may be float, int, bool, str, another schema, a family of schemas
between which a YAML tag chooses (`Variant`), a list of any of these, or any of these or None. For
one of a few values use `choice`.

A schema checks in Python what it checks in YAML (`scenario_file`): an attribute that it does not
have and a value that is not admissible are a `ScenarioError` of one line, as soon as they are
given. Only a list that is changed in place is not seen; `check` sees that too.
"""

import dataclasses
import functools
import math
import numbers
import types
import typing
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import did_you_mean, printable, quoted, show

# Key under which the plain data of a variant keep its YAML tag.
TAG = "_tag"
_RULE = "parapod.rule"
# Longest dotted key that a message repeats [characters].
_LONGEST_KEY = 120


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

    def __str__(self) -> str:
        return ", ".join(str(option) for option in self.options)


type Rule = Range | Options | None


def quantity(default: Any, low: float, high: float, *, length: int | None = None) -> Any:
    """Field of a schema: a number, or a list of numbers, with an admissible range.

    Args:
        default: the default; a list is copied; None for an optional number or list.
        low: smallest admissible value, of every element if it is a list.
        high: largest admissible value.
        length: number of elements that a list must have; None for any.
    """
    metadata = {_RULE: Range(low, high, length)}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def choice(default: Any, options: Sequence[Any]) -> Any:
    """Field of a schema: one of a few admissible values."""
    return dataclasses.field(default=default, metadata={_RULE: Options(tuple(options))})


class Schema:
    """Base of the dataclasses of a scenario; refuses what they do not admit when it is assigned.

    Numbers take the type of their field, and lists are copied. Variants whose names begin with an
    underscore, which YAML cannot name, are admitted in Python.

    Raises:
        ScenarioError: an attribute that the dataclass does not have, or an inadmissible value;
            names the key within this dataclass.
    """

    # Name of the experiment that a scenario was made for; no key of its own.
    _experiment: ClassVar[str] = ""
    # Dotted keys of today by their former names, which are read with a warning.
    moved: ClassVar[Mapping[str, str]] = {}

    if not TYPE_CHECKING:  # for which any attribute would exist then

        def __getattr__(self, name: str) -> Any:
            if name not in type(self).moved:
                raise AttributeError(
                    f"{type(self).__name__!r} has no attribute {name!r}", name=name, obj=self
                )
            return functools.reduce(getattr, _current(type(self), (name,)), self)

        def __setattr__(self, name: str, value: Any) -> None:
            kind = type(self)
            fields = fields_of(kind)
            if name in kind.moved:
                *way, name = _current(kind, (name,))
                return setattr(functools.reduce(getattr, way, self), name, value)
            if name in fields:
                inner, rule = fields[name]
                value = Reader(kind, is_text=False).admit(inner, value, name, rule)
            elif not hasattr(getattr(kind, name, None), "__set__"):  # a property sets itself
                Reader(kind).refuse_key(kind, name)
            object.__setattr__(self, name, value)


class Variant(Schema):
    """Base of schemas between which a scenario chooses with a YAML tag, as in `!Name {...}`.

    A direct subclass is the root of one such family. Every dataclass derived from the root, in
    whatever package, can be chosen by its name as soon as it is defined.
    """

    # Reasons for which variants of a family may be missing, and where further ones come from; said
    # where a tag is not known.
    not_imported: ClassVar[tuple[str, ...]] = ()
    others: ClassVar[str] = ""
    # Former names of a variant, which are read with a warning.
    former: ClassVar[tuple[str, ...]] = ()
    # Tag of a variant where it is not the name of its class, which no word of Python's can be; and
    # tag of a family that a mapping without one has.
    tag_name: ClassVar[str] = ""
    usual_tag: ClassVar[str] = ""

    @classmethod
    def tag(cls) -> str:
        """Name of the variant, as its tag has it."""
        return vars(cls).get("tag_name") or cls.__name__

    @classmethod
    def variants(cls) -> dict[str, type]:
        """The dataclasses of a family by their names, in the order of their definition.

        Where several packages have one of the same name, that of the family's own package counts,
        or none: see `clashes`.
        """
        return {name: kinds[0] for name, kinds in cls._by_name().items() if len(kinds) == 1}

    @classmethod
    def clashes(cls) -> tuple[str, ...]:
        """A sentence for each name that was taken already, or that two others both define."""
        chosen, messages = cls._by_name(), []
        for variant in cls._descendants():
            name, module = variant.tag(), variant.__module__
            modules = [kind.__module__ for kind in chosen[name]]
            if module not in modules:
                messages.append(
                    f"!{name} of {module} is not used: {modules[0]} has one of that name"
                )
            elif len(modules) > 1:
                messages.append(f"!{name} is defined by {' and by '.join(modules)}: none is used")
        return tuple(dict.fromkeys(messages))

    @classmethod
    def _by_name(cls) -> dict[str, list[type["Variant"]]]:
        """Those of the own package, if it has any of that name, or else all others."""
        home = cls.__module__.partition(".")[0]
        families: dict[str, dict[str, type[Variant]]] = {}
        for variant in cls._descendants():
            # In the same module the later one takes the place of the earlier.
            families.setdefault(variant.tag(), {})[variant.__module__] = variant
        return {
            name: [kind for module, kind in kinds.items() if module.partition(".")[0] == home]
            or [*kinds.values()]
            for name, kinds in families.items()
        }

    @classmethod
    def _descendants(cls) -> Iterator[type["Variant"]]:
        for variant in cls.__subclasses__():
            if not variant.__name__.startswith("_"):
                yield variant
            yield from variant._descendants()


def check(scenario: object) -> None:
    """Refuse a scenario made in Python, with all that it holds, if YAML could not say it.

    Raises:
        ScenarioError: an attribute that the schema does not have, or an inadmissible value; names
            the whole key, as in "job.waypoints.0.time".
    """
    checked(scenario)


def checked(scenario: object) -> dict[str, Any]:
    """A scenario as plain data.

    Raises:
        ScenarioError: as `check`.
    """
    kind = type(scenario)
    tree: dict[str, Any] = Reader(kind, is_text=False).read(kind, plain(scenario))
    return tree


# Scenarios as plain data: completed, overlaid, made dataclasses again.


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
    """Plain data of a schema of which nothing is said."""
    return plain(kind())


def plain(value: Any) -> Any:
    """Dataclasses as dicts, with attributes that a typo has added, and tuples as lists."""
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if not dataclasses.is_dataclass(value):
        return value
    names = [field.name for field in dataclasses.fields(value)]
    added = [n for n in getattr(value, "__dict__", {}) if not hasattr(type(value), n)]
    tag: dict[str, Any] = {TAG: f"!{type(value).tag()}"} if isinstance(value, Variant) else {}
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
    values = {name: build(inner, tree[name]) for name, (inner, _) in fields_of(kind).items()}
    if not issubclass(kind, Schema) or hasattr(kind, "__post_init__"):
        return kind(**values)
    # Without its `__setattr__`, which would check once more what is checked.
    whole = object.__new__(kind)
    vars(whole).update(values)
    return whole


def differing(default: Any, tree: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values in which a scenario is not another one.

    Args:
        default: the other one, as plain data.
        tree: the scenario, as plain data.
        key: key of both.
    """
    are_alike = (
        isinstance(default, dict) and isinstance(tree, dict) and default.keys() == tree.keys()
    )
    if are_alike and default.get(TAG) == tree.get(TAG):
        for name, value in tree.items():
            yield from differing(default[name], value, f"{key}.{name}" if key else name)
    elif default != tree:
        yield key, tree


@functools.cache
def fields_of(kind: type) -> dict[str, tuple[Any, Rule]]:
    """Kind and rule of each field of a dataclass, by its name."""
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {field.name: (hints[field.name], field.metadata.get(_RULE)) for field in fields}


def is_family(kind: Any) -> bool:
    """Whether it is a family of dataclasses between which a tag chooses."""
    return isinstance(kind, type) and issubclass(kind, Variant)


def variant_of(family: type[Variant], node: Any) -> type:
    """The dataclass that a checked mapping's tag names."""
    return family.variants()[node[TAG].removeprefix("!")]


def is_schema(kind: Any) -> bool:
    """Whether it is a dataclass."""
    return dataclasses.is_dataclass(kind)


@functools.cache
def split_optional(kind: Any) -> tuple[Any, bool]:
    """A kind without its None, and whether it had one."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        inner = [item for item in typing.get_args(kind) if item is not types.NoneType]
        if len(inner) == 1:
            return inner[0], True
    return kind, False


class Reader:
    """Check of plain data against a schema, and conversion to the schema's types.

    Args:
        schema: the root, which knows every key.
        source: origin of the data, for messages; "" if the user sees that anyhow.
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
            inner, items = typing.get_args(kind)[0], self._read_list(kind, value, key, rule)
            return [self.read(inner, x, _join(key, str(i)), rule) for i, x in enumerate(items)]
        if kind in (float, int):
            value = self._read_number(kind, value, key, rule)
        elif kind is bool:
            if self._is_text and value in ("true", "false"):
                value = value == "true"
            if not isinstance(value, bool):
                self._refuse(key, f"must be true or false, not {show(value)}")
        elif kind is str:
            value = self._read_text(value, key, rule)
        else:
            raise TypeError(f"scenarios do not support the type {kind} of '{key}'")
        if isinstance(rule, Options) and value not in rule.options:
            hint = did_you_mean(str(value), map(str, rule.options))
            self._refuse(key, f"= {show(value)} is not one of {rule}{hint}")
        return value

    def admit(self, kind: Any, value: Any, key: str, rule: Rule = None) -> Any:
        """A value that was assigned in Python, in the schema's types.

        Dataclasses that fit stay themselves, mappings become dataclasses.
        """
        kind, is_optional = split_optional(kind)
        if value is None and is_optional:
            return None
        if typing.get_origin(kind) is list:
            inner = typing.get_args(kind)[0]
            value = list(value) if isinstance(value, tuple) else value
            items = self._read_list(kind, value, key, rule)
            return [self.admit(inner, x, _join(key, str(i)), rule) for i, x in enumerate(items)]
        if not is_schema(kind):
            # Settings of other types are for Python alone; they can be neither read nor written.
            return self.read(kind, value, key, rule) if kind in _NOUNS else value
        if isinstance(value, kind) and not (is_family(kind) and type(value) is kind):
            return value
        return build(kind, overlay(kind, None, self.read(kind, plain(value), key)))

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
        keys = _current(kind, keys)
        head, rest = keys[0], keys[1:]
        node, at, kind, rule = self._step(kind, node, head, key, rule)
        child = self.assign(kind, node[at], rest, value, _join(key, head), rule)
        if isinstance(node, dict):
            return node | {at: child}
        return [child if i == at else item for i, item in enumerate(node)]

    def locate(self, kind: Any, node: Any, keys: Sequence[str]) -> tuple[Any, Rule]:
        """Kind and rule of the value in a complete tree that `keys` lead to."""
        key, rule = "", None
        for head in _current(kind, keys):
            node, at, kind, rule = self._step(kind, node, head, key, rule)
            node, key = node[at], _join(key, head)
        return split_optional(kind)[0], rule

    def _step(
        self, kind: Any, node: Any, head: str, key: str, rule: Rule
    ) -> tuple[Any, Any, Any, Rule]:
        """One key down: the node with all its keys, and place, kind and rule of the one below."""
        kind, _ = split_optional(kind)
        if is_family(kind):
            if node is None:
                self._refuse(key, f"is null; give it whole, with one of the tags {_tags(kind)}")
            kind = variant_of(kind, node)
        inner = _join(key, head)
        if is_schema(kind):
            fields = fields_of(kind)
            if head not in fields:
                self.refuse_key(kind, head, key)
            return defaults(kind) if node is None else node, head, *fields[head]
        if typing.get_origin(kind) is list:
            inner_kind = typing.get_args(kind)[0]
            if node is None:
                self._refuse(key, f"is null; give it whole, {_list_of(inner_kind, rule)}")
            count = len(node)
            if head not in map(str, range(count)):
                elements = f"has elements 0..{count - 1}" if count else "is empty"
                self._refuse_path(inner, f"'{key}' {elements}")
            return node, int(head), inner_kind, rule
        self._refuse_path(inner, f"'{key}' is {_noun(kind)}, not a mapping")

    def refuse_key(self, kind: type, name: str, parent: str = "") -> NoReturn:
        """Refuse a key that a schema does not have, with those that it has."""
        key = _join(parent, name)
        allowed = sorted(fields_of(kind))
        hint = did_you_mean(name, allowed)
        if not hint:
            elsewhere = [k for k in _dotted(self._schema) if k.split(".")[-1] == name]
            hint = f" (did you mean {elsewhere[0]}?)" if elsewhere else ""
        under = f" under '{parent}'" if parent else ""
        self._refuse_path(key, f"allowed{under}: {', '.join(allowed)}{hint}")

    def _read_variant(self, family: type[Variant], value: Any, key: str) -> dict[str, Any]:
        variants = family.variants()
        tag = value.get(TAG, family.usual_tag or None) if isinstance(value, dict) else None
        name = str(tag).removeprefix("!")
        if name not in variants:
            name = _renamed(variants, name)
        if name not in variants:
            hint = did_you_mean(name, variants)
            given_name = show(value) if tag is None else printable(tag, _LONGEST_KEY)
            reasons = (*family.not_imported, *family.clashes(), family.others)
            missing = "".join(f"; {why}" for why in reasons if why)
            known_tags = _tags(family)
            self._refuse(
                key,
                f"must begin with one of the tags {known_tags}, not {given_name}{hint}{missing}",
            )
        fields = {k: item for k, item in value.items() if k != TAG}
        return {TAG: f"!{name}"} | self._read_mapping(variants[name], fields, key)

    def _read_mapping(self, kind: type, value: Any, key: str) -> dict[str, Any]:
        fields = fields_of(kind)
        if not isinstance(value, dict):
            what = f"'{key}'" if key else "a scenario"
            allowed = ", ".join(sorted(fields))
            self._fail(key, f"{what} must be a mapping with keys {allowed}, not {show(value)}")
        if TAG in value:
            self._refuse(key, f"must not have a tag, not {show(value[TAG])}")
        value = self._relocated(kind, value)
        for name in value:
            if name not in fields:
                self.refuse_key(kind, str(name), key)
        return {
            name: self.read(fields[name][0], item, _join(key, name), fields[name][1])
            for name, item in value.items()
        }

    def _relocated(self, kind: type, value: dict[str, Any]) -> dict[str, Any]:
        """A mapping whose former keys are where they belong today."""
        for former in getattr(kind, "moved", {}):
            if former not in value:
                continue
            *way, last = _current(kind, (former,))
            value = dict(value)
            item, node = value.pop(former), value
            for name in way:
                inner = node.get(name)
                node[name] = dict(inner) if isinstance(inner, dict) else {}
                node = node[name]
            if last in node:
                self._fail(former, f"{former} and {_join('.'.join(way), last)} are the same key")
            node[last] = item
        return value

    def _read_list(self, kind: Any, value: Any, key: str, rule: Rule) -> list[Any]:
        """The list, whose elements are not checked yet."""
        length = rule.length if isinstance(rule, Range) else None
        if not isinstance(value, list) or length not in (None, len(value)):
            list_kind = _list_of(typing.get_args(kind)[0], rule)
            self._refuse(key, f"must be {list_kind}, not {show(value)}")
        return value

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

    def _read_text(self, value: Any, key: str, rule: Rule) -> str:
        if self._is_text and value is False and isinstance(rule, Options):
            # YAML 1.1 reads an unquoted off as false.
            value = "off" if "off" in rule.options else value
        if not isinstance(value, str):
            options = f", one of {rule}" if isinstance(rule, Options) else ""
            self._refuse(key, f"must be text{options}, not {show(value)}")
        return str.__str__(value)  # of an enumeration YAML knows nothing

    def _refuse_path(self, key: str, why: str) -> NoReturn:
        self._fail(key, f"unknown key {quoted(key, _LONGEST_KEY)}; {why}")

    def _refuse(self, key: str, reason: str) -> NoReturn:
        self._fail(key, f"{key} {reason}")

    def _fail(self, key: str, message: str) -> NoReturn:
        raise ScenarioError(f"{self._source}: {message}" if self._source else message, key)


def _number(value: Any, is_text: bool) -> float | int | None:
    """The number that a value is, or None; text such as 1e-3 is a number only in YAML."""
    if type(value) is float:
        return value
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


def _current(kind: Any, keys: Sequence[str]) -> Sequence[str]:
    """Keys of today that lead where keys lead, of which the first one may be a former one."""
    moved = getattr(split_optional(kind)[0], "moved", {})
    if not keys or keys[0] not in moved:
        return keys
    new = moved[keys[0]]
    warnings.warn(f"the key {keys[0]} is now {new}", DeprecationWarning, stacklevel=2)
    return (*new.split("."), *keys[1:])


def _dotted(kind: Any, key: str = "") -> Iterator[str]:
    """Every key below a dataclass, outer ones first; elements of lists are left out."""
    for name, (inner, _) in fields_of(kind).items():
        yield _join(key, name)
        inner, _ = split_optional(inner)
        if is_schema(inner):
            yield from _dotted(inner, _join(key, name))


def _renamed(variants: Mapping[str, type], name: str) -> str:
    """Name of today of a variant, if a name is a former one."""
    for current, variant in variants.items():
        if name in vars(variant).get("former", ()):
            text = f"the tag !{name} is now !{current}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return current
    return name


def _tags(family: type[Variant]) -> str:
    return ", ".join(f"!{name}" for name in family.variants())


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
    return f"a list of {count}{plural(kind)}"


def plural(kind: Any) -> str:
    """A word for several values of a kind, for messages and comments."""
    return _NOUNS.get(split_optional(kind)[0], ("", "mappings"))[1]
