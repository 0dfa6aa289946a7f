"""Typed scenarios: dataclasses that YAML files and `key=value` overrides fill in, checked.

A schema is a dataclass whose fields all have defaults:

    @dataclass
    class Ground:
        pitch_deg: float = quantity(5.0, -15.0, 15.0)

    @dataclass
    class Scenario:
        backend: str = choice("kinematic", ("kinematic", "multibody"))
        seed: int = quantity(0, 0, 2**31 - 1)
        ground: Ground = field(default_factory=Ground)

Fields may be float, int, bool, str, another such dataclass, a family of them between which a
YAML tag chooses (`Variant`), a list of any of these, or any of these or None. For one of a few
values use `choice`.

Layers are merged in the order schema, default file, user's file, overrides. A mapping is merged
key by key; a list replaces the list below it. Root keys that begin with an underscore are free
for YAML anchors. Whatever is wrong with a scenario is a `ScenarioError` of one line.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]
from pydrake.common.yaml import yaml_load_data

from parapod.diagrams.scenario_reader import Reader
from parapod.diagrams.scenario_tree import (
    TAG,
    build,
    defaults,
    overlay,
    plain,
)
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import choice as choice
from parapod.systems.core.schema import one_line, show
from parapod.systems.core.schema import quantity as quantity


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
    tree = defaults(schema)
    Reader(schema, f"schema {schema.__name__}", is_text=False).read(schema, tree)
    for path in (default_file, file):
        if path is not None:
            source = f"scenario {path}"
            data = _parse(_read_text(path), source)
            layer = Reader(schema, source).read(schema, {} if data is None else data)
            tree = overlay(schema, tree, layer)
    for override in overrides:
        key, equals, value = override.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ScenarioError(f"override {show(override)} is not of the form key=value", key)
        data = _parse(value, f"override {show(override)}", private=True)
        tree = Reader(schema).assign(schema, tree, key.split("."), data)
    made: T = build(schema, tree)
    return made


def check(scenario: object) -> None:
    """Refuses a scenario made in Python for the reasons that `load_scenario` has.

    Raises:
        ScenarioError: an attribute that the schema does not have, or a value not allowed.
    """
    Reader(type(scenario), is_text=False).read(type(scenario), plain(scenario))


def dump_scenario(scenario: object) -> str:
    """The whole scenario as YAML text from which `load_scenario` makes an equal one.

    Unlike Drake's `yaml_dump_typed` it writes None as null: left out, an optional value would
    come back as whatever the default file says.

    Raises:
        ScenarioError: as `check`.
    """
    reader = Reader(type(scenario), is_text=False)
    return _dump(reader.read(type(scenario), plain(scenario)))


class _Dumper(yaml.SafeDumper):
    """Mappings over several lines, lists of scalars on one, no aliases, tags as they were."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_sequence(self, tag: str, sequence: Any, flow_style: Any = None) -> Any:
        is_flat = not any(isinstance(item, dict | list) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=is_flat)

    def represent_mapping(self, tag: str, mapping: Any, flow_style: Any = None) -> Any:
        if TAG in mapping:
            tag = mapping[TAG]
            mapping = {key: value for key, value in mapping.items() if key != TAG}
        return super().represent_mapping(tag, mapping, flow_style=flow_style)


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
        raise ScenarioError(f"{source}{line}: {one_line(error.problem)}") from None
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        raise ScenarioError(f"{source} is not YAML: {one_line(error)}") from None


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
