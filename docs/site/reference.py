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
from collections.abc import Iterable, Iterator, Sequence
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
from parapod.systems.levelling_platform.fault_detection import as_markdown as findings_as_list

type Pages = Iterator[tuple[str, str | bytes]]

_SECTION = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):$")
# Size of a picture, which instead is as wide as its page.
_SIZE = re.compile(rb'width="\d+pt" height="\d+pt"')
_ENTRY = re.compile(r"^    (\*{0,2}\w[\w., ]*): (.*)$")


_INDICES = ("diagrams/index", "systems/index", "scenarios/index")


def all_pages() -> Pages:
    """Every page of the reference, and its beginning."""
    yield "index.md", index()
    yield from systems()
    yield from scenarios()
    yield from commands()
    yield from errors()
    yield from findings()
    yield from diagrams()


def index() -> str:
    """The beginning: every page with its description, by part of the project and by machine."""
    machines = _own_machines()
    shared, own = [], []
    for package in dict.fromkeys(map(_package, _sorted_systems())):
        is_own = package in (machine.name for machine in machines)
        (own if is_own else shared).append(_package_line(package, "systems/"))
    parts = [
        "# Reference\n\nMade from the code at every build.",
        f"## Diagrams\n\n{_DIAGRAMS}",
        *_items(_diagram_line(machine, "diagrams/") for machine in machines),
        f"## Systems\n\n{_SYSTEMS} [All by name](systems/index.md).",
        "### Shared by the machines",
        *_items(shared),
        "### Particular to one machine",
        *_items(own),
        "## Scenarios\n\nEvery key of every experiment, by machine.",
        *_scenario_lists("scenarios/", 3),
        "## Commands",
    ]
    for title, group in GROUPS.items():
        lines = (
            f"[`parapod {name}`](commands.md#parapod-{name}): {_sentence(command.HELP)}"
            for name, command in group.items()
        )
        parts += [f"### {title.capitalize()}", *_items(lines)]
    parts += [
        "## Errors\n\n[Every error that parapod raises on purpose](errors.md) and its attributes.",
        f"## Findings\n\n[{_FINDINGS.removesuffix('.')}](findings.md).",
        _toctree([*_INDICES, "commands", "errors", "findings"], depth=2),
    ]
    return "\n\n".join(parts) + "\n"


# --- systems


def systems() -> Pages:
    """A page for each package of systems: symbol, port table and arguments of each."""
    kinds = _sorted_systems()
    settings = sorted({one for kind in kinds for one in _settings(kind)}, key=class_name)
    parts = [f"# Systems\n\n{_SYSTEMS}"]
    names = []
    for package, grouped in groupby(kinds, _package):
        names.append(package)
        members = list(grouped)
        parts += [f"## {_titled(package)}", _sentence(_first_line(_package_module(package)))]
        parts += _items(_system_line(kind) for kind in members)
        says = (inspect.getdoc(_package_module(package)) or "").split("\n\n")[0]
        described = [_described(one) for one in settings if _package(one) == package]
        if described:
            described.insert(0, "## Classes of arguments\n")
        yield (
            f"systems/{package}.md",
            "\n".join((f"# {_titled(package)}\n\n{says}\n", *map(_system, members), *described)),
        )
    yield "systems/index.md", "\n\n".join([*parts, _toctree(names)]) + "\n"


_SYSTEMS = (
    "Each is a Drake LeafSystem (or a Diagram of a few), to be used alone or in a diagram of your "
    "own. Sizes that are letters follow from the arguments."
)


def _sorted_systems() -> list[type]:
    return sorted(_systems(), key=lambda kind: (_package(kind), class_name(kind)))


def _system_line(kind: type) -> str:
    name = class_name(kind)
    page = f"{_package(kind)}.md#{name.lower()}"
    return f"[{name}]({page}): {_sentence(_first_line(kind))}"


def _package_line(package: str, folder: str) -> str:
    says = _sentence(_first_line(_package_module(package)))
    return f"[{_titled(package)}]({folder}{package}.md): {says}"


def _package_module(package: str) -> ModuleType:
    return importlib.import_module(f"parapod.systems.{package}")


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
    scalars = "Converts to AutoDiffXd." if "_construct" in vars(kind) else "Floats only."
    return "\n\n".join((f"## {class_name(kind)}", symbol, scalars, *_made(kind)))


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
    names = []
    for entry in _own_entries():
        names.append(entry.name)
        yield f"scenarios/{entry.name}.md", _scenario(entry)
    text = (
        "Every key of every experiment, as for `--set key=value` and scenario files. A file of "
        "your own needs only the keys that differ; `parapod scenario NAME` prints a whole one."
    )
    parts = [f"# Scenarios\n\n{text}", *_scenario_lists("", 2), _toctree(names)]
    yield "scenarios/index.md", "\n\n".join(parts) + "\n"


def _scenario_lists(folder: str, level: int) -> Iterator[str]:
    """Experiments under the headings of their machines."""
    for title, entries in groupby(_own_entries(), lambda entry: entry.group):
        yield f"{'#' * level} {title}"
        yield from _items(
            f"[{entry.name}]({folder}{entry.name}.md): {_sentence(entry.summary)}"
            for entry in entries
        )


def _own_entries() -> list[Entry]:
    return [entry for entry in list_entries() if entry.package == "parapod"]


def _scenario(entry: Entry) -> str:
    experiment = entry.load()
    scenario = load_scenario(experiment.schema, entry.default_scenario)
    rows = "\n".join(_keys(experiment.schema, scenario, ""))
    families = "\n\n".join(_family(kind) for kind in _families(experiment.schema))
    document = as_markdown(inspect.getdoc(importlib.import_module(entry.point.module)) or "")
    return (
        f"# {entry.name}\n\n{document}\n\nBackends: "
        f"{', '.join(f'`{backend}`' for backend in experiment.backends)}.\n\n"
        f"{_key_table(rows)}\n\n{families}\n"
    )


def _key_table(rows: str) -> str:
    """A table of keys, whose rows become blocks on narrow screens."""
    head = "| key | default | admissible | meaning |\n|---|---|---|---|"
    return f":::{{div}} keys\n{head}\n{rows}\n:::"


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
            parts.append(_key_table(rows))
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


def findings() -> Pages:
    """Every finding of the levelling platform's fault detector."""
    yield "findings.md", f"# Findings\n\n{_FINDINGS}\n\n{findings_as_list()}\n"


_FINDINGS = "What the levelling platform's fault detector finds, how severe it is, and how soon."


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
    machines = _own_machines()
    for machine in machines:
        entry = find_entry(machine.experiment)
        scenario = load_scenario(entry.load().schema, entry.default_scenario)
        loop = loop_of(entry.load(), scenario)
        overview = draw(loop, 2, ports=False, fits_page=True).render()
        yield f"diagrams/{machine.name}.svg", _SIZE.sub(b'width="100%"', overview, count=1)
        yield f"diagrams/{machine.name}_ports.svg", draw(loop, 2).render()
        yield f"diagrams/{machine.name}.md", _diagram(machine, entry.name)
    parts = [
        f"# Diagrams\n\n{_DIAGRAMS}",
        *_items(_diagram_line(machine, "") for machine in machines),
        _toctree([machine.name for machine in machines]),
    ]
    yield "diagrams/index.md", "\n\n".join(parts) + "\n"


_DIAGRAMS = "The closed loop of each machine as a picture, and the ports of its station."


def _own_machines() -> list[Any]:
    return [
        machine
        for machine in list_machines()
        if find_entry(machine.experiment).package == "parapod"
    ]


def _diagram_line(machine: Any, folder: str) -> str:
    summary = _sentence(find_entry(machine.experiment).summary)
    title = _titled(machine.name)
    return f"[{title}]({folder}{machine.name}.md): loop of `{machine.experiment}`. {summary}"


def _diagram(machine: Any, experiment: str) -> str:
    rows = "\n".join(
        f"| {direction} `{port.name}` | {port.size} | {_cell(port.unit)} | {_cell(port.meaning)} |"
        for direction, ports in (("in", machine.inputs), ("out", machine.outputs))
        for port in ports
    )
    name = machine.name
    return f"""# {_titled(name)}

The loop of `{experiment}`: station and controller, and what is in them. `parapod draw
{experiment} --out loop.svg` draws it with your scenario. One wire stands for all from one block to
another; the pointer shows their ports. <a href="{name}.svg">This picture alone</a>;
<a href="{name}_ports.svg">with every port and wire</a>.

<div class="fitted">
<object type="image/svg+xml" data="{name}.svg" aria-label="diagram"></object>
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


def _toctree(names: Sequence[str], depth: int = 1) -> str:
    """Pages for the navigation; what a reader sees of them is listed with descriptions."""
    listed = "\n".join(names)
    return f"```{{toctree}}\n:hidden:\n:maxdepth: {depth}\n{listed}\n```"


def _items(lines: Iterable[str]) -> list[str]:
    """Lines as one list."""
    return ["\n".join(f"* {line}" for line in lines)]


def _titled(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _first_line(documented: Any) -> str:
    return " ".join((inspect.getdoc(documented) or "").split("\n\n")[0].split())


def _sentence(text: str) -> str:
    """A description with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def _modules(package: ModuleType) -> Iterator[ModuleType]:
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        yield importlib.import_module(info.name)
