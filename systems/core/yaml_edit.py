"""Changes to the text of a scenario file that keep its other keys, its order and its comments.

The places of keys and values are those that PyYAML's nodes tell; only the text of a value is
replaced, or a line added. A library that reads and writes the whole file, such as ruamel.yaml,
would also change what is not asked for: indentation, the breaks of long lines, and small numbers
to 1e-05, which is a text in the YAML 1.1 of scenario files. A file in which this is not enough, as
with aliases, is refused.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import yaml  # type: ignore[import-untyped]

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import inline, parse
from parapod.systems.core.schema import plain

_INDENT = 2  # indentation of keys below a new one


def with_values(text: str, values: Mapping[str, Any], source: str = "the file") -> str:
    """The text of a scenario file with some values replaced or added.

    Args:
        text: YAML; a mapping, or nothing.
        values: plain data, by dotted keys of mappings.
        source: origin of the text, for messages.

    Raises:
        ScenarioError: text that is not a mapping, or a key that cannot be changed in its place.
    """
    expected = parse(text, source, private=True)
    expected = {} if expected is None else expected
    if not isinstance(expected, dict):
        raise ScenarioError(f"{source} is not a mapping of keys")
    for key, value in values.items():
        path = key.split(".")
        expected = _assigned(expected, path, value, source)
        text = _with_value(text, path, value)
    if _or_none(text, source) != expected:
        keys = ", ".join(values)
        raise ScenarioError(
            f"{source} cannot be changed in its place; give it plain mappings, without anchors, "
            f"where {keys} are to stand"
        )
    return text


def value_at(tree: Any, key: str) -> Any:
    """Value of a dotted key in plain data; None if there is none."""
    for name in key.split("."):
        if not isinstance(tree, dict) or name not in tree:
            return None
        tree = tree[name]
    return tree


def _or_none(text: str, source: str) -> Any:
    try:
        return parse(text, source, private=True)
    except ScenarioError:
        return None


def _assigned(tree: dict[str, Any], path: Sequence[str], value: Any, source: str) -> Any:
    head, *rest = path
    if not rest:
        return tree | {head: plain(value)}
    below = tree.get(head)
    below = {} if below is None else below
    if not isinstance(below, dict):
        raise ScenarioError(f"{source}: '{head}' is not a mapping of keys", head)
    return tree | {head: _assigned(below, rest, value, source)}


def _with_value(text: str, path: Sequence[str], value: Any) -> str:
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(node, yaml.MappingNode):  # nothing but comments
        return _with_lines(text, len(text), _lines(path, value, 0))
    for depth, name in enumerate(path):
        entry = next((pair for pair in node.value if pair[0].value == name), None)
        if entry is None:
            return _added(text, node, path[depth:], value)
        key, below = entry
        rest = path[depth + 1 :]
        if not rest or not isinstance(below, yaml.MappingNode):
            return _replaced(text, key, below, rest, value, node.flow_style)
        node = below
    raise AssertionError("a path has at least one name")


def _replaced(
    text: str, key: Any, old: Any, rest: Sequence[str], value: Any, is_flow: bool
) -> str:
    """The text with another value behind a key."""
    begin, end = key.end_mark.index, _end(old)
    colon = text.index(":", begin) + 1
    if is_flow or (not rest and not _is_block(value)):
        for name in reversed(rest):
            value = {name: value}
        # An empty value stands at the colon.
        start = max(colon, old.start_mark.index)
        if old.start_mark.line != key.end_mark.line or end <= colon:
            start = colon
        gap = " " if start == colon else ""
        return f"{text[:start]}{gap}{inline(value)}{text[max(end, start) :]}"
    column = key.start_mark.column
    head, *lines = _lines([key.value, *rest], value, column)
    del head  # the key stands there already
    behind = text[max(end, colon) :]
    comment, newline, after = behind.partition("\n")
    body = "\n".join(lines)
    return f"{text[:colon]}{comment.rstrip()}\n{body}{newline or chr(10)}{after}"


def _added(text: str, node: Any, path: Sequence[str], value: Any) -> str:
    """The text with a further key in a mapping."""
    if node.flow_style:
        at = node.end_mark.index - 1
        before = text[:at].rstrip()
        comma = ", " if node.value else ""
        tree = value
        for name in reversed(path[1:]):
            tree = {name: tree}
        return f"{before}{comma}{path[0]}: {inline(tree)}{text[at:]}"
    column = node.value[0][0].start_mark.column
    end = text.find("\n", _end(node.value[-1][1], node.value[-1][0].end_mark.index + 1))
    return _with_lines(text, len(text) if end < 0 else end + 1, _lines(path, value, column))


def _with_lines(text: str, at: int, lines: Sequence[str]) -> str:
    before = text[:at]
    if before and not before.endswith("\n"):
        before += "\n"
    return before + "".join(f"{line}\n" for line in lines) + text[at:]


def _lines(path: Sequence[str], value: Any, column: int) -> list[str]:
    """Lines of a value below its keys."""
    *above, last = path
    lines = [f"{' ' * (column + _INDENT * i)}{name}:" for i, name in enumerate(above)]
    pad = " " * (column + _INDENT * len(above))
    if not _is_block(value):
        return [*lines, f"{pad}{last}: {inline(value)}"]
    return [*lines, f"{pad}{last}:", *(f"{pad}  - {inline(item)}" for item in value)]


def _is_block(value: Any) -> bool:
    """Whether it takes a line for each of its elements."""
    return isinstance(value, list) and any(isinstance(item, dict) for item in value)


def _end(node: Any, least: int = 0) -> int:
    """Index behind the last character of a node; blocks end with their last leaf."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last, least)
    return max(least, int(node.end_mark.index))
