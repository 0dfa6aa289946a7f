"""Parts that commands share: exit codes, usage errors, scenarios, files."""

import argparse
import math
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from parapod.sims.lab.discovery import Entry, find_entry, list_entries
from parapod.systems.core.errors import OutputError, ParapodError
from parapod.systems.core.quoting import escaped, quoted, quoted_path

if TYPE_CHECKING:
    from parapod.diagrams.machine import Machine
    from parapod.sims.lab.experiment import Experiment
    from parapod.sims.output.figures import Print

# Longest text of argparse, which repeats what was typed [characters].
_LONGEST = 300
HELD, BROKEN, MISTAKE, INTERRUPTED = 0, 1, 2, 130
# The experiment whose machine is meant unless another one is named.
_USUAL = "level"

# Suffixes of what options write; what else there is, its writer refuses.
_SUFFIXES = {"html": (".html", ".htm"), "json": (".json",), "video": (".mp4", ".webm", ".gif")}

# Suffixes that no folder of figures has by intention.
_FILES = (".svg", ".png", ".pdf", ".html", ".json")

_NARROWEST, _WIDEST = 40.0, 1000.0  # of figures [mm]

_EXIT_CODES = (
    "exit codes: 0 all bounds held, 1 a bound is broken, 2 a mistake in the command, a scenario "
    "or a path, 130 interrupted"
)


class UsageError(ParapodError):
    """A command line that says nothing parapod understands."""


class _Formatter(argparse.HelpFormatter):
    """Fills paragraphs, and leaves those of several lines as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        fill = super()._fill_text
        parts = text.strip().split("\n\n")
        return "\n\n".join(part if "\n" in part else fill(part, width, indent) for part in parts)


class Parser(argparse.ArgumentParser):
    """Parser that reports a mistake like every other mistake, in one line.

    Its help ends with commands and examples, if it is given any, and the exit codes.

    Args:
        commands: names and texts of commands by the title of their group.
        examples: command lines.
        options: see `argparse.ArgumentParser`.
    """

    def __init__(
        self,
        commands: Mapping[str, Sequence[tuple[str, str]]] | None = None,
        examples: Sequence[str] = (),
        **options: Any,
    ):
        parts = [
            "\n".join([f"{title}:", *(f"  {name:<9} {text}" for name, text in group)])
            for title, group in (commands or {}).items()
        ]
        if examples:
            parts.append("\n".join(["examples:", *(f"  {example}" for example in examples)]))
        super().__init__(
            epilog="\n\n".join([*parts, _EXIT_CODES]),
            formatter_class=_Formatter,
            allow_abbrev=False,
            **options,
        )

    def error(self, message: str) -> NoReturn:
        """Instead of printing the usage and ending the process."""
        raise UsageError(f"{escaped(message, _LONGEST)} (see {self.prog} --help)")


def count(text: str) -> int:
    """A whole number of 1 or more, for `type=`."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"must be a whole number of 1 or more, not {quoted(text)}"
        )
    return int(text)


def rows(text: str) -> int | None:
    """A number of runs that are simulated together, or None for auto, for `type=`."""
    if text == "auto":
        return None
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(
            f"must be auto, or a whole number of 0 or more, not {quoted(text)}"
        )
    return int(text)


def finite(text: str) -> float:
    """A number that is finite, for `type=`."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"must be a finite number, not {quoted(text)}")
    return number


def width(text: str) -> float:
    """A width of figures [mm], for `type=`."""
    number = finite(text)
    if not _NARROWEST <= number <= _WIDEST:
        raise argparse.ArgumentTypeError(
            f"must be from {_NARROWEST:g} to {_WIDEST:g} mm, not {quoted(text)}"
        )
    return number


def add_print_options(parser: argparse.ArgumentParser, has_format: bool = False) -> None:
    """Add options for figures in print; see `print_of`.

    Args:
        parser: parser of a command that writes figures.
        has_format: true where the files' names do not tell their format.
    """
    if has_format:
        parser.add_argument(
            "--figure-format",
            choices=("svg", "png", "pdf"),
            default="svg",
            help="format of --figures; default svg",
        )
    parser.add_argument(
        "--width-mm",
        type=width,
        metavar="W",
        help="width of figures in print, such as 84 for a column; letters keep their size",
    )
    parser.add_argument(
        "--no-caption",
        dest="caption",
        action="store_false",
        help="leave out title and caption below a figure",
    )
    parser.add_argument(
        "--style", type=Path, metavar="FILE", help="Matplotlib's settings of your own (.mplstyle)"
    )


def print_of(arguments: argparse.Namespace, suffix: str) -> "Print":
    """Format of figures.

    Args:
        arguments: arguments of a command with `add_print_options`.
        suffix: format of the files.

    Raises:
        OutputError: the file of settings cannot be read.
    """
    from parapod.sims.output.figures import Print

    form = Print(suffix, arguments.caption, arguments.width_mm, arguments.style)
    if arguments.style is not None:
        form.settings()
    return form


def check_outputs(
    paths: Mapping[str, Path | None], folders: Mapping[str, Path | None] | None = None
) -> None:
    """Refuse, before anything slow, files that could not be written after it.

    Args:
        paths: option -> file, or None if it was not given.
        folders: option -> folder in which files are written, or None.

    Raises:
        OutputError: a wrong suffix, or two options that would write the same; names them.
    """
    from parapod.sims.output.atomic import check_folder, check_writable

    paths_in_use: dict[str, str] = {}
    folders = folders or {}
    for option, path in (*paths.items(), *folders.items()):
        if path is None:
            continue
        suffix, admissible = path.suffix.lower(), _SUFFIXES.get(option)
        name = quoted_path(path.name)
        if suffix and admissible and suffix not in admissible:
            raise OutputError(f"--{option} writes {' or '.join(admissible)}, not {name}", path)
        if option in folders and suffix in _FILES and not path.is_dir():
            raise OutputError(f"--{option} names a folder, not a file like {name}", path)
        check = check_folder if option in folders else check_writable
        check(path)
        other = paths_in_use.setdefault(os.path.realpath(path), option)
        if other != option:
            raise OutputError(
                f"--{other} and --{option} would both write {quoted_path(path)}", path
            )


def add_scenario_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say what is to be run; see `load`."""
    parser.add_argument("name", metavar="NAME", help="an experiment; see `parapod list`")
    add_scenario_options(parser)
    switches: dict[str, list[str]] = {}
    for entry in list_entries():
        for name, (override, what) in _switches(entry).items():
            text = f"{entry.name}: {what}; short for --set {override}"
            switches.setdefault(name, []).append(text)
    for name, texts in switches.items():
        parser.add_argument(
            f"--{name}", dest="switches", action="append_const", const=name, help=". ".join(texts)
        )
    parser.set_defaults(switches=[])


def add_machine_option(parser: argparse.ArgumentParser) -> None:
    """Add the choice of a machine, for commands that run no experiment."""
    parser.add_argument(
        "--of",
        dest="name",
        default=_USUAL,
        metavar="NAME",
        help=f"an experiment of the machine that is meant; default {_USUAL}",
    )


def add_bus_options(parser: argparse.ArgumentParser, use: str) -> None:
    """Adds the choice of a bus for all parts of a machine.

    Args:
        parser: parser of the command.
        use: words before the name of the bus, for the help.
    """
    for kind, bus in (("lcm", "LCM"), ("ros2", "ROS 2")):
        parser.add_argument(
            f"--{kind}",
            dest="bus",
            action="store_const",
            const=kind,
            help=f"{use} {bus}, in place of the scenario's devices",
        )


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a scenario, without the experiment's name."""
    parser.add_argument(
        "--scenario", type=Path, metavar="FILE", help="YAML with the keys to change"
    )
    parser.add_argument(
        "--machine", type=Path, metavar="FILE", help="YAML with the keys below machine to change"
    )
    parser.add_argument(
        "--set",
        dest="overrides",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="change keys, as in ground.pitch_deg=4 or job.waypoints.0.time=8; may be repeated",
    )
    parser.add_argument("--backend", metavar="B", help="short for --set backend=B")
    parser.add_argument(
        "--drivers",
        type=Path,
        metavar="FILE",
        help="Python file with drivers of your own, for the backend hardware",
    )
    parser.add_argument("--seed", metavar="N", help="short for --set seed=N")
    parser.add_argument(
        "--controller",
        metavar="C",
        help="short for --set control.controller=C: my_file.py:make, or a bus: lcm:// or ros2://",
    )
    parser.set_defaults(switches=[])


def load(arguments: argparse.Namespace) -> "tuple[Experiment[Any, Any], Any]":
    """The experiment and the scenario that the arguments ask for.

    Raises:
        UnknownExperiment: there is no such experiment.
        UsageError: the experiment has no such option.
        ScenarioError: a key, a value, a file or a backend that is not admissible.
    """
    entry = find_entry(arguments.name)

    from parapod.diagrams.drivers.external import load_drivers, load_installed_drivers
    from parapod.systems.core.scenario_file import load_scenario

    experiment = entry.load()
    for problem in load_installed_drivers():
        print(f"parapod: warning: {problem}", file=sys.stderr)
    if arguments.drivers is not None:
        load_drivers(arguments.drivers)
    overrides = [*arguments.overrides, *_switched(entry, arguments.switches)]
    for option, key in (("backend",) * 2, ("seed",) * 2, ("controller", "control.controller")):
        value = getattr(arguments, option)
        if value is not None:
            overrides.append(f"{key}={value}")
    scenario: Any = load_scenario(
        experiment.schema,
        entry.default_scenario,
        arguments.scenario,
        overrides,
        arguments.machine,
    )
    experiment.check_backend(scenario.backend)
    return experiment, scenario


def machine_of(experiment: "Experiment[Any, Any]", scenario: Any) -> "tuple[Machine[Any], Any]":
    """The machine of an experiment and its scenario, for commands that work with its devices.

    Raises:
        UsageError: the experiment runs no machine that has devices.
    """
    machine: Machine[Any] | None = getattr(experiment, "machine", None)
    adapt = getattr(experiment, "machine_scenario", lambda scenario: scenario)
    of_machine = adapt(scenario)
    if machine is None or not isinstance(of_machine, machine.scenario):
        from parapod.diagrams.machine import list_machines

        text = f"'{experiment.name}' has no machine that can be emulated"
        with suppress(ParapodError):  # of another package, which has nothing to do with this
            able = [m.experiment for m in list_machines() if m.experiment and m.real.exchange]
            text += f"; these have: {', '.join(able)}"
        raise UsageError(text)
    return machine, of_machine


def agreed(question: str, what: str) -> bool:
    """Whether the person at the terminal says yes.

    Args:
        question: question without "[yes/no]".
        what: name of the command that asks, for a message where there is no terminal.

    Raises:
        UsageError: there is no terminal.
    """
    if not sys.stdin.isatty():
        raise UsageError(f"{what} asks before anything moves; without a terminal add --yes")
    return input(f"{question} [yes/no] ").strip().lower() == "yes"


def _switches(entry: Entry) -> Mapping[str, tuple[str, str]]:
    """Options of an experiment; none of a package that cannot be read, which `list` names."""
    try:
        return entry.switches
    except ParapodError:
        return {}


def _switched(entry: Entry, switches: Sequence[str]) -> list[str]:
    """The overrides that the given switches are short for."""
    for name in switches:
        if name not in entry.switches:
            raise UsageError(f"the experiment '{entry.name}' has no option --{name}")
    return [entry.switches[name][0] for name in switches]
