"""Pages that follow from the code: systems, scenarios, commands, errors, diagrams.

Each function yields names of files and their text, Markdown as MyST reads it, or pictures.
"""

import dataclasses
import html
import importlib
import inspect
import io
import pkgutil
import re
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout, suppress
from itertools import groupby
from types import ModuleType
from typing import Any, get_args, get_origin

from pydrake.common.cpp_template import TemplateClass
from pydrake.systems.framework import Diagram, LeafSystem

import parapod.diagrams
import parapod.sims
import parapod.systems
from parapod.diagrams.block_diagram import class_name, draw
from parapod.diagrams.machine import list_machines
from parapod.sims.api import loop_of
from parapod.sims.cli.main import GROUPS, main
from parapod.sims.lab.discovery import Entry, find_entry, list_entries
from parapod.systems.core import schema
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.port_table import PortRow, port_table
from parapod.systems.core.scenario_file import describe, load_scenario

type Pages = Iterator[tuple[str, str | bytes]]

_SECTION = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):$")
_ENTRY = re.compile(r"^    (\*{0,2}\w[\w., ]*): (.*)$")


def all_pages() -> Pages:
    """Every page of the reference, and its beginning."""
    yield "index.md", _INDEX
    yield from systems()
    yield from scenarios()
    yield from commands()
    yield from errors()
    yield from diagrams()


_INDEX = """# Reference

Made from the code at every build.

```{toctree}
:maxdepth: 2
diagrams/index
systems/index
scenarios/index
commands
errors
```
"""


# --- systems


def systems() -> Pages:
    """A page for each package of systems: symbol, port table and arguments of each."""
    kinds = sorted(_systems(), key=lambda kind: (_package(kind), class_name(kind)))
    settings = sorted({one for kind in kinds for one in _settings(kind)}, key=class_name)
    names = []
    for package, members in groupby(kinds, _package):
        names.append(package)
        module = importlib.import_module(f"parapod.systems.{package}")
        title = package.replace("_", " ").capitalize()
        says = (inspect.getdoc(module) or "").split("\n\n")[0]
        described = [_described(one) for one in settings if _package(one) == package]
        if described:
            described.insert(0, "## Classes of arguments\n")
        yield (
            f"systems/{package}.md",
            "\n".join((f"# {title}\n\n{says}\n", *map(_system, members), *described)),
        )
    yield "systems/index.md", _contents("Systems", _SYSTEMS, names)


_SYSTEMS = (
    "Each is a Drake LeafSystem (or a Diagram of a few), to be used alone or in a diagram of your "
    "own. Sizes that are letters follow from the arguments."
)


def _systems() -> set[type]:
    """Public classes with a table of ports; of a template the one for floats."""
    found = set()
    for module in _modules(parapod.systems):
        for name, value in vars(module).items():
            if isinstance(value, TemplateClass) and value.name == name:
                found.add(value[None])
            elif _is_defined(value, module) and issubclass(value, LeafSystem | Diagram):
                found.add(value)
    return {kind for kind in found if "| port |" in (inspect.getdoc(kind) or "")}


def _is_defined(value: Any, module: ModuleType) -> bool:
    """Whether a value is a public class of a module; names of templates' classes hold symbols."""
    if not inspect.isclass(value) or value.__module__ != module.__name__:
        return False
    return value.__name__.isascii() and not value.__name__.startswith("_")


def _package(kind: type) -> str:
    return kind.__module__.split(".")[2]


def _settings(kind: type) -> Iterator[type]:
    """Dataclasses of parapod's systems that a constructor takes, and those that these take."""
    for argument in inspect.signature(kind).parameters.values():
        for one in (argument.annotation, *get_args(argument.annotation)):
            is_ours = inspect.isclass(one) and one.__module__.startswith("parapod.systems.")
            if is_ours and dataclasses.is_dataclass(one):
                yield one
                yield from _settings(one)


def _system(kind: type) -> str:
    symbol = _symbol(class_name(kind), port_table(kind))
    return "\n\n".join((f"## {class_name(kind)}", symbol, *_made(kind)))


def _described(kind: type) -> str:
    return "\n\n".join((f"### {class_name(kind)}", *_made(kind)))


def _made(kind: type) -> tuple[str, ...]:
    """Module, constructor and docstrings of a class; not those that it inherits from Drake's."""
    # Scalar-convertible systems are made by `_construct`.
    maker = vars(kind).get("_construct", vars(kind).get("__init__"))
    made = inspect.cleandoc(getattr(maker, "__doc__", None) or "")
    given = inspect.signature(kind).parameters.values()
    parameters = "".join(f"\n    {_parameter(one)}," for one in given)
    return (
        f"`parapod.{kind.__module__.removeprefix('parapod.')}`",
        f"```python\n{class_name(kind)}({parameters}{chr(10) if given else ''})\n```",
        as_markdown(inspect.getdoc(kind) or ""),
        as_markdown(made),
        "",
    )


def _parameter(one: inspect.Parameter) -> str:
    """A parameter without the modules of its types, and with short defaults."""
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(?=\w)", "", str(one.replace(default=one.empty)))
    if one.default is one.empty:
        return text
    is_long = isinstance(one.default, float) and len(repr(one.default)) > 10
    shown = f"{one.default:.6g}" if is_long else repr(one.default)
    # What a dataclass holds is told where it is described.
    return f"{text} = {shown if len(shown) < 30 else type(one.default).__name__ + '(...)'}"


def _symbol(name: str, rows: Sequence[PortRow]) -> str:
    """A block with its inputs on the left and its outputs on the right."""
    sides = {
        way: "".join(f"<span>{html.escape(r.name)}</span>" for r in rows if r.direction == way)
        for way in ("in", "out")
    }
    return (
        f'<div class="block-symbol"><div class="ports in">{sides["in"]}</div>'
        f'<div class="name">{html.escape(name)}</div>'
        f'<div class="ports out">{sides["out"]}</div></div>'
    )


# --- scenarios


def scenarios() -> Pages:
    """A page for each experiment, with every key of its scenario."""
    groups: dict[str, list[str]] = {}
    for entry in _own_entries():
        groups.setdefault(entry.group, []).append(entry.name)
        yield f"scenarios/{entry.name}.md", _scenario(entry)
    yield (
        "scenarios/index.md",
        _contents(
            "Scenarios",
            "Every key of every experiment, as for `--set key=value` and scenario files. A file "
            "of your own needs only the keys that differ; `parapod scenario NAME` prints a whole "
            "one.",
            [name for names in groups.values() for name in names],
        ),
    )


def _own_entries() -> list[Entry]:
    return [entry for entry in list_entries() if entry.package == "parapod"]


def _scenario(entry: Entry) -> str:
    experiment = entry.load()
    scenario = load_scenario(experiment.schema, entry.default_scenario)
    rows = "\n".join(_keys(experiment.schema, scenario, ""))
    head = "| key | default | admissible | meaning |\n|---|---|---|---|"
    families = "\n\n".join(_family(kind) for kind in _families(experiment.schema))
    document = as_markdown(inspect.getdoc(importlib.import_module(entry.point.module)) or "")
    return (
        f"# {entry.name}\n\n{document}\n\nBackends: "
        f"{', '.join(f'`{backend}`' for backend in experiment.backends)}.\n\n"
        f"{head}\n{rows}\n\n{families}\n"
    )


def _keys(kind: Any, value: Any, prefix: str) -> Iterator[str]:
    """Rows of a table, one a key; those of a mapping follow it."""
    texts = describe(kind)
    for name, (field, rule) in schema.fields_of(kind).items():
        inner, _ = schema.split_optional(field)
        mine = getattr(value, name, None)
        key = f"{prefix}{name}"
        if schema.is_schema(inner) and not schema.is_family(inner):
            yield f"| **`{key}`** | | | {_cell(texts[name])} |"
            yield from _keys(inner, mine, f"{key}.")
        else:
            shown = "" if dataclasses.is_dataclass(mine) or _holds_many(mine) else _shown(mine)
            admissible = _cell(str(rule or _kind(field)))
            yield f"| `{key}` | {shown} | {admissible} | {_cell(texts[name])} |"


def _holds_many(value: Any) -> bool:
    return isinstance(value, list) and any(dataclasses.is_dataclass(item) for item in value)


def _shown(value: Any) -> str:
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else value
    return f"`{text}`" if f"{text}" else ""


def _kind(kind: Any) -> str:
    inner, is_optional = schema.split_optional(kind)
    if get_origin(inner) is list:
        (item,) = get_args(inner)
        text = f"list: {_kind(item)}"
    elif schema.is_family(inner):
        text = f"one of {', '.join(f'`!{name}`' for name in inner.variants())}"
    elif schema.is_schema(inner):
        text = f"mapping: {', '.join(f'`{name}`' for name in schema.fields_of(inner))}"
    else:
        text = {bool: "`true`, `false`", str: "text", float: "number", int: "whole number"}.get(
            inner, str(inner)
        )
    return f"{text}, or `null`" if is_optional else text


def _families(kind: Any) -> list[type]:
    """Families among whose members keys choose, in the order in which they are met."""
    found: dict[type, None] = {}
    for field, _ in schema.fields_of(kind).values():
        inner, _ = schema.split_optional(field)
        if get_origin(inner) is list:
            inner, _ = schema.split_optional(get_args(inner)[0])
        if schema.is_family(inner):
            found[inner] = None
            for member in inner.variants().values():
                found |= dict.fromkeys(_families(member))
        elif schema.is_schema(inner):
            found |= dict.fromkeys(_families(inner))
    return list(found)


def _family(kind: Any) -> str:
    parts = [f"## {kind.__name__}"]
    for name, member in kind.variants().items():
        rows = "\n".join(_keys(member, member(), ""))
        says = (inspect.getdoc(member) or "").split("\n\n")[0].replace("\n", " ")
        parts.append(f"### !{name}\n\n{says}")
        if rows:
            parts.append(f"| key | default | admissible | meaning |\n|---|---|---|---|\n{rows}")
    return "\n\n".join(parts)


# --- commands and errors


def commands() -> Pages:
    """Every command and option, in groups."""
    parts = ["# Commands", _help()]
    for title, group in GROUPS.items():
        parts.append(f"## {title.capitalize()}")
        parts += [f"### parapod {name}\n\n{_help(name)}" for name in group]
    yield "commands.md", "\n\n".join(parts) + "\n"


def _help(*command: str) -> str:
    said = io.StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        main([*command, "--help"])
    return f"```text\n{said.getvalue().strip()}\n```"


def errors() -> Pages:
    """Every error that parapod raises on purpose, those derived from one below it."""
    for package in (parapod.systems, parapod.diagrams, parapod.sims):
        for _ in _modules(package):
            pass
    parts = [
        "# Errors",
        "Commands print them as `parapod: error: ...`, in one line, and end with exit code 2; in "
        "Python they are exceptions with the attributes below. Exit code 1 is a broken bound, 130 "
        "an interruption.",
        *_error(ParapodError, 2),
    ]
    yield "errors.md", "\n\n".join(parts) + "\n"


def _error(kind: type, level: int) -> Iterator[str]:
    yield f"{'#' * min(level, 5)} {kind.__name__}"
    yield f"`{kind.__module__}`"
    yield as_markdown(inspect.getdoc(kind) or "")
    for inner in sorted(kind.__subclasses__(), key=lambda kind: kind.__name__):
        if inner.__module__.startswith("parapod.") and not inner.__name__.startswith("_"):
            yield from _error(inner, level + 1)


# --- diagrams


def diagrams() -> Pages:
    """The loop of each machine's experiment, as a picture."""
    names = []
    for machine in list_machines():
        entry = find_entry(machine.experiment)
        if entry.package != "parapod":
            continue
        scenario = load_scenario(entry.load().schema, entry.default_scenario)
        picture = draw(loop_of(entry.load(), scenario), 2).render()
        names.append(machine.name)
        yield f"diagrams/{machine.name}.svg", picture
        yield f"diagrams/{machine.name}.md", _diagram(machine, entry.name)
    yield "diagrams/index.md", _contents("Diagrams", "The loop of each machine.", names)


def _diagram(machine: Any, experiment: str) -> str:
    rows = "\n".join(
        f"| {direction} `{port.name}` | {port.size} | {_cell(port.unit)} | {_cell(port.meaning)} |"
        for direction, ports in (("in", machine.inputs), ("out", machine.outputs))
        for port in ports
    )
    picture = f"{machine.name}.svg"
    return f"""# {machine.name.replace("_", " ").capitalize()}

The loop of `{experiment}`: station and controller, and what is in them. `parapod draw
{experiment} --out loop.svg` draws it with your scenario. The pointer tells where a wire begins
and ends; <a href="{picture}">alone it can be enlarged</a>.

<div class="wide">
<object type="image/svg+xml" data="{picture}" aria-label="diagram"></object>
</div>

## Ports of the station

| port | size | unit | meaning |
|---|---|---|---|
{rows}
"""


# --- texts


def as_markdown(text: str) -> str:
    """A docstring as Markdown: its sections become lists, and what is indented stays code."""
    lines: list[str] = []
    in_section = False
    for line in text.splitlines():
        if match := _SECTION.match(line):
            lines += ["", f"**{match[1]}**", ""]
            in_section = True
        elif in_section and (match := _ENTRY.match(line)):
            lines.append(f"* `{match[1]}`: {match[2]}")
        elif in_section and line.startswith("    "):
            lines.append(f"  {line.strip()}")
        else:
            in_section &= not line.strip()
            lines.append(line)
    return "\n".join(lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _contents(title: str, text: str, names: Sequence[str]) -> str:
    listed = "\n".join(names)
    return f"# {title}\n\n{text}\n\n```{{toctree}}\n:maxdepth: 1\n{listed}\n```\n"


def _modules(package: ModuleType) -> Iterator[ModuleType]:
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        yield importlib.import_module(info.name)
