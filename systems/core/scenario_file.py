"""Scenario files: YAML read into schemas in layers, and written with the schemas' explanations.

Layers are merged in the order schema, default file, user's file, overrides. A mapping is merged
key by key; a list replaces the list below it. Root keys that begin with an underscore are free
for YAML anchors. Whatever is wrong with a scenario is a `ScenarioError` of one line.

The meaning of a key stands once, under `Attributes:` in the docstring of its schema;
`dump_scenario` repeats it as comments.
"""

import inspect
import re
import textwrap
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import escaped, printable, quoted, quoted_path, show
from parapod.systems.core.schema import (
    TAG,
    Options,
    Range,
    Reader,
    Rule,
    build,
    checked,
    defaults,
    fields_of,
    is_family,
    is_schema,
    overlay,
    plural,
    split_optional,
    variant_of,
)

# More than any scenario needs; PyYAML reads as much in half a second.
_MOST_BYTES = 200_000
_MOST_NODES = 10_000
_DEEPEST = 50
# Longest line of a written scenario, and longest value that has its comment behind it.
_WIDTH = 99
_LONGEST_BEFORE_COMMENT = 44
_PARAGRAPH = "\n\n"  # between two paragraphs of a docstring
FILE = "!File"  # tag of the name of a file whose data are to stand in its place
# Texts that name models and functions of one's own; in a file they are beside it.
_BESIDE = re.compile(r"([^:]+\.(?:urdf|sdf|xml|mjcf|yaml|py))(:\w+)?")


def load_scenario[T](
    schema: type[T],
    default_file: Path | None = None,
    file: Path | None = None,
    overrides: Sequence[str] = (),
    machine: Path | None = None,
) -> T:
    """Scenario made of the schema's defaults, the default file, the user's files and overrides.

    Args:
        schema: the dataclass to fill in.
        default_file: the experiment's own scenario, with the keys that differ from the schema's
            defaults; None if there are none.
        file: the user's scenario; only the keys it names change.
        overrides: `dotted.key=value` with the value in YAML; elements of a list are named by
            their number, as in `waypoints.0.roll_deg=1`.
        machine: file with the keys below `machine`; only those that it names change.

    Raises:
        ScenarioError: anything wrong with a file or an override.
    """
    tree = _schema_defaults(schema)
    for path, what in ((default_file, "scenario"), (file, "scenario"), (machine, "machine")):
        if path is not None:
            source = f"{what} {escaped(path, 240)}"
            data = parse(read_text(path), source, folder=path.parent)
            data = {} if data is None else _located(data, path.parent)
            if path is machine:
                data = {"machine": data}
            tree = overlay(schema, tree, Reader(schema, source).read(schema, data))
    for override in overrides:
        key, equals, value = override.partition("=")
        key = key.strip()
        if not equals or not key:
            raise ScenarioError(f"override {show(override)} is not of the form key=value", key)
        data = parse(value, f"override {show(override)}", private=True, folder=Path())
        reader, keys = Reader(schema), key.split(".")
        if not value.strip() and reader.locate(schema, tree, keys)[0] is str:
            data = ""
        tree = reader.assign(schema, tree, keys, data)
    scenario: T = build(schema, tree)
    return scenario


def read_scenario[T](schema: type[T], data: Mapping[str, Any], source: str) -> T:
    """Scenario made of the schema's defaults and a document.

    Args:
        schema: the dataclass to fill in.
        data: the document, as `parse` gives it.
        source: its origin, for errors.

    Raises:
        ScenarioError: anything wrong with it.
    """
    tree = overlay(schema, _schema_defaults(schema), Reader(schema, source).read(schema, data))
    scenario: T = build(schema, tree)
    return scenario


def dump_scenario(scenario: object, comments: bool = False) -> str:
    """The whole scenario as YAML text from which `load_scenario` makes an equal one.

    None is written as null: left out, an optional value would come back as whatever the default
    file says.

    Args:
        scenario: an instance of a schema.
        comments: explain every key with its unit and what is admissible.

    Raises:
        ScenarioError: as `check`.
    """
    tree, kind = checked(scenario), type(scenario)
    lines = _mapping(kind, tree, 0, set() if comments else None)
    if comments:
        lines = [*_comment(_prose(kind), 0), "", *lines]
    return "".join(f"{line}\n" for line in lines)


def describe(kind: type) -> dict[str, str]:
    """Descriptions of a schema's fields: `Attributes:` of its docstring and of its bases'."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        section = re.search(r"^Attributes:\n((?: .*\n?|\n)+)", _doc(base), re.MULTILINE)
        for entry in re.split(r"\n(?=    \w)", section[1] if section else ""):
            name, _, text = entry.strip().partition(":")
            texts[name] = " ".join(text.split())
    return {name: texts.get(name, "") for name in fields_of(kind)}


# Reading


def _schema_defaults(schema: type) -> dict[str, Any]:
    try:
        tree = defaults(schema)
        Reader(schema, is_text=False).read(schema, tree)
    except ScenarioError as error:
        raise ScenarioError(f"schema {schema.__name__}: {error}", error.key) from None
    return tree


def read_text(path: Path) -> str:
    """Text of a scenario file.

    Raises:
        ScenarioError: it cannot be read, or is too long for a scenario.
    """
    name = f"scenario file {quoted_path(path)}"
    try:
        with open(path, "rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise ScenarioError(f"{name} is larger than {_MOST_BYTES // 1000} kB")
        return data.decode()
    except FileNotFoundError:
        raise ScenarioError(f"{name} does not exist") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{name} is not text in UTF-8") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"{name} cannot be read: {reason}") from None


class _Loader(yaml.SafeLoader):
    """Plain data; a tag of a mapping that is not YAML's own becomes its key `TAG`.

    `!File NAME` stands for the data of another file. The name of a model, such as arm.urdf, or of
    a function, such as mine.py:make, is looked for beside the file that has it.
    """

    def __init__(self, text: str, folder: Path | None):
        super().__init__(text)
        self._count = self._depth = 0
        self._folder = folder

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._count += 1
        self._depth += 1
        if self._count > _MOST_NODES or self._depth > _DEEPEST:
            raise ValueError(
                f"it has more than {_MOST_NODES} values, or more than {_DEEPEST} within each other"
            )
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_tagged(self, tag: str, node: Any) -> Any:
        if tag == FILE:
            return self._data_of_file(node)
        if isinstance(node, yaml.ScalarNode) and not node.value:
            return {TAG: tag}
        return self.construct_mapping(node, deep=True) | {TAG: tag}

    def _data_of_file(self, node: Any) -> Any:
        if self._folder is None:
            raise ValueError(f"{FILE} is for scenarios of one's own, and not for what they name")
        name = node.value if isinstance(node, yaml.ScalarNode) else ""
        if not name:
            raise ValueError(f"{FILE} must be followed by the name of a file")
        path = self._folder / name
        data = parse(read_text(path), f"file {escaped(path, 240)}")
        return {} if data is None else _located(data, path.parent)


_Loader.add_multi_constructor("", _Loader.construct_tagged)


def _located(data: Any, folder: Path) -> Any:
    """The data with names of files that are in a folder leading there."""
    if isinstance(data, dict):
        return {key: _located(item, folder) for key, item in data.items()}
    if isinstance(data, list):
        return [_located(item, folder) for item in data]
    name = _BESIDE.fullmatch(data) if isinstance(data, str) else None
    if name is None or not (folder / name[1]).is_file():
        return data
    return f"{folder / name[1]}{name[2] or ''}"


def parse(text: str, source: str, private: bool = False, folder: Path | None = None) -> Any:
    """Plain data of a YAML text; unless private, without root keys that begin with an underscore.

    Args:
        text: the text.
        source: its origin, for messages.
        private: keep root keys that begin with an underscore.
        folder: folder from which `!File NAME` reads other files, which name no further ones; None:
            the text may not name any.

    Raises:
        ScenarioError: it is not YAML; says where.
    """
    if len(text) > _MOST_BYTES:
        raise ScenarioError(f"{source} is longer than {_MOST_BYTES // 1000} kB")
    try:
        loader = _Loader(text, folder)
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_multiplied(node, source, {})
        _refuse_duplicates(node, source, set())
        data = loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark else ""
        raise ScenarioError(f"{source}{line}: {printable(error.problem)}") from None
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        raise ScenarioError(f"{source} is not YAML: {printable(error)}") from None
    except (KeyError, AttributeError, TypeError, IndexError):  # PyYAML's, of !!bool 1
        raise ScenarioError(f"{source} is not YAML: a value does not fit its tag") from None
    if private or not isinstance(data, dict):
        return data
    return {k: item for k, item in data.items() if not str(k).startswith("_")}


def _children(node: Any) -> Iterator[Any]:
    if isinstance(node, yaml.SequenceNode):
        yield from node.value
    elif isinstance(node, yaml.MappingNode):
        for pair in node.value:
            yield from pair


def _refuse_multiplied(node: Any, source: str, counts: dict[int, int]) -> int:
    """Number of nodes below a node, each as often as aliases repeat it; refuses too many.

    Args:
        node: composed node; an alias is the very node that it names.
        source: origin of the text, for messages.
        counts: numbers of the nodes that were counted, by their id; 0 while one is counted.
    """
    if id(node) not in counts:
        counts[id(node)] = 0
        count = 1 + sum(_refuse_multiplied(child, source, counts) for child in _children(node))
        counts[id(node)] = count
        if count > _MOST_NODES:
            text = f"aliases multiply it to more than {_MOST_NODES} values"
            raise ScenarioError(f"{source}: {text}")
    if counts[id(node)] == 0:
        line = node.start_mark.line + 1
        raise ScenarioError(f"{source}, line {line}: an alias stands within what it names")
    return counts[id(node)]


def _refuse_duplicates(node: Any, source: str, ancestors: set[int]) -> None:
    """Refuse a key that is given twice, of which YAML would silently drop the first."""
    if id(node) in ancestors:
        return
    ancestors.add(id(node))
    lines: dict[str, int] = {}
    for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
        line = key.start_mark.line + 1
        if isinstance(key, yaml.ScalarNode):
            if key.value in lines:
                first = lines[key.value]
                message = f"key {quoted(key.value)} is already given in line {first}"
                raise ScenarioError(f"{source}, line {line}: {message}", key.value)
            lines[key.value] = line
    for child in _children(node):
        _refuse_duplicates(child, source, ancestors)


# Writing


def _mapping(
    kind: type, tree: dict[str, Any], indent: int, explained: set[type] | None
) -> list[str]:
    """Lines of a mapping.

    Args:
        kind: schema of the mapping.
        tree: checked plain data.
        indent: number of blanks before the keys.
        explained: schemas whose keys have been explained already; None: without comments.
    """
    texts: dict[str, str] = {}
    if explained is not None and kind not in explained:
        explained.add(kind)
        texts = _explanations(kind)
    pad = " " * indent
    entries = [(name, item) for name, item in tree.items() if name != TAG]
    nested = {name for name, item in entries if _is_block(item)}
    flat = {name: f"{pad}{name}: {inline(item)}" for name, item in entries if name not in nested}
    short = [len(line) for line in flat.values() if len(line) <= _LONGEST_BEFORE_COMMENT]
    column = max(short, default=0) + 2
    lines: list[str] = []
    was_nested = False
    for name, item in entries:
        inner, _ = split_optional(fields_of(kind)[name][0])
        if explained is not None and lines and (was_nested or (indent == 0 and name in nested)):
            lines.append("")
        was_nested = indent == 0 and name in nested
        text = texts.get(name, "")
        if name not in nested:
            line = flat[name]
            behind = f"{line:<{column}}# {text}"
            if text and len(line) + 2 <= column and len(behind) <= _WIDTH:
                lines.append(behind)
            else:
                lines += [*_comment(text, indent), *_folded(line, item, pad, name)]
            if item == [] and texts and is_schema(_element(inner)):
                lines += _example(_element(inner), pad, explained)
                was_nested = True
            continue
        lines += _comment(text, indent)
        if isinstance(item, dict):
            inner = variant_of(inner, item) if is_family(inner) else inner
            tag = f" {item[TAG]}" if TAG in item else ""
            lines += [f"{pad}{name}:{tag}", *_mapping(inner, item, indent + 2, explained)]
        else:
            lines += [f"{pad}{name}:", *_items(_element(inner), item, indent, explained)]
    return lines


def _items(
    kind: Any, items: Sequence[Any], indent: int, explained: set[type] | None
) -> Iterator[str]:
    """Lines of a list of mappings, or of other lists."""
    pad = " " * indent
    for item in items:
        if not isinstance(item, dict):
            yield f"{pad}- {inline(item)}"
            continue
        inner = variant_of(kind, item) if is_family(kind) else kind
        if is_family(kind) and explained is not None and inner not in explained:
            yield from _comment(_title(inner), indent)
        flat = f"{pad}- {inline(item)}"
        if explained and inner in explained and len(flat) <= _WIDTH:
            yield flat  # like the one before
            continue
        lines = _mapping(inner, item, indent + 2, explained)
        if TAG in item:
            yield f"{pad}- {item[TAG]}{'' if lines else ' {}'}"
            yield from lines
        else:
            yield from _dashed(lines, indent)


def _dashed(lines: list[str], indent: int) -> Iterator[str]:
    """Lines of a mapping with a dash before its first key; comments may stand above it."""
    first = next(i for i, line in enumerate(lines) if not line.lstrip().startswith("#"))
    for i, line in enumerate(lines):
        yield f"{line[:indent]}- {line[indent + 2 :]}" if i == first else line


def _example(kind: Any, pad: str, explained: set[type] | None) -> Iterator[str]:
    """An element of an empty list, as a comment."""
    if is_family(kind):
        return
    yield f"{pad}# An element, with its defaults:"
    # Indented by as much as "# " takes, so that no line becomes too long.
    indent = len(pad) + 2
    for line in _dashed(_mapping(kind, defaults(kind), indent + 2, explained), indent):
        yield f"{pad}# {line[indent:]}"


def _explanations(kind: type) -> dict[str, str]:
    """Comment of each key: its description, and what is admissible."""
    texts = describe(kind)
    for name, (inner, rule) in fields_of(kind).items():
        text = _without_references(texts[name])
        bare = split_optional(inner)[0]
        if is_schema(bare) and not is_family(bare):
            more = f"{text[:1].upper()}{text[1:]}." if text else ""
            text = f"{_title(bare)} {more}".strip()
        allowed = _allowed(inner, rule)
        if isinstance(rule, Options) and all(f'"{x}"' in text for x in rule.options):
            allowed = ""  # the text explains each of them
        texts[name] = (f"{text} ({allowed})" if allowed else text).replace("`", "").strip()
    return texts


def _without_references(text: str) -> str:
    """A text without the names of classes, which are for readers of the code."""
    return re.sub(r"[;,:]?\s*\(?\b[Ss]ee `\w+`\)?", "", text).strip(" ;,").removesuffix(".")


def _title(kind: type) -> str:
    """First paragraph of a schema's docstring."""
    text = _without_references(_prose(kind).partition(_PARAGRAPH)[0])
    return f"{text}." if text else ""


def _allowed(kind: Any, rule: Rule) -> str:
    """The admissible values in a few words; empty if the value itself says enough."""
    bare, is_optional = split_optional(kind)
    words = str(rule) if rule is not None else ""
    if isinstance(rule, Options) and len(rule.options) == 1:
        words = f"only {words}"
    if is_family(_element(bare)):
        words = "one of " if bare is _element(bare) else "any of "
        words += ", ".join(f"!{name}" for name in _element(bare).variants())
    elif bare is not _element(bare) and isinstance(rule, Range):
        each = f"each {rule}"
        words = each if rule.length is None else f"{rule.length} {plural(_element(bare))}, {each}"
    return f"{words} or null".strip() if is_optional else words


def _element(kind: Any) -> Any:
    """Kind of the elements if a kind is a list, else the kind itself."""
    return typing.get_args(kind)[0] if typing.get_origin(kind) is list else kind


def _doc(kind: type) -> str:
    """Docstring of a class, unless it has the one that `dataclass` makes."""
    text = inspect.cleandoc(kind.__doc__ or "")
    return "" if text.startswith(f"{kind.__name__}(") else text


def _prose(kind: type) -> str:
    """The docstring of a schema without its sections."""
    return re.split(r"^\w+:$", _doc(kind), maxsplit=1, flags=re.MULTILINE)[0].strip()


def _comment(text: str, indent: int) -> Iterator[str]:
    """Paragraphs as comments; those that are indented keep their lines."""
    start = f"{' ' * indent}# "
    for i, paragraph in enumerate(text.split(_PARAGRAPH) if text else ()):
        if i > 0:
            yield start.rstrip()
        if paragraph.startswith(" "):
            yield from (f"{start}{line}" for line in paragraph.splitlines())
            continue
        unbroken = re.sub(r"\b((?:Eq|Fig)s?\.) ", "\\1\u00a0", paragraph)
        for line in textwrap.wrap(
            unbroken, _WIDTH - len(start), break_long_words=False, break_on_hyphens=False
        ):
            yield start + line.replace("\u00a0", " ")


def _is_block(value: Any) -> bool:
    """Whether a value is written over several lines."""
    if isinstance(value, dict):
        return value.keys() - {TAG} != set()
    return isinstance(value, list) and any(isinstance(item, dict | list) for item in value)


def inline(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, dict):
        names = [name for name in value if name != TAG]
        items = _flow_items([value[name] for name in names])
        text = ", ".join(f"{name}: {item}" for name, item in zip(names, items, strict=True))
        return f"{value[TAG]} {{{text}}}" if TAG in value else f"{{{text}}}"
    if isinstance(value, list):
        return f"[{', '.join(_flow_items(value))}]"
    return _scalar(value)


def _flow_items(values: list[Any]) -> list[str]:
    """Elements as they stand within brackets, where text needs more quotes than elsewhere."""
    return [inline(x) if isinstance(x, dict | list) else _scalar(x, True) for x in values]


def _scalar(value: Any, within_brackets: bool = False) -> str:
    text: str = yaml.dump(
        [value] if within_brackets else value,
        Dumper=yaml.SafeDumper,
        default_flow_style=True,
        default_style='"' if isinstance(value, str) and not value.isprintable() else None,
        allow_unicode=True,
        width=float("inf"),
    )
    text = text.removesuffix("\n").removesuffix("\n...")
    return text[1:-1] if within_brackets else text


def _folded(line: str, value: Any, pad: str, name: str) -> list[str]:
    """A line, or several if it is too long and a list."""
    if len(line) <= _WIDTH or not isinstance(value, list):
        return [line]
    folded = [f"{pad}{name}: ["]
    items = _flow_items(value)
    for i, item in enumerate(items):
        text = item + ("," if i + 1 < len(items) else "]")
        if len(folded[-1]) + 1 + len(text) > _WIDTH:
            folded.append(f"{pad}  {text}")
        else:
            folded[-1] += text if folded[-1].endswith("[") else f" {text}"
    return folded
