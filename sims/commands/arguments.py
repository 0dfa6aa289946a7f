"""Common parts of several commands: exit codes, usage errors, scenarios, files."""

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError
from parapod.systems.core.quoting import did_you_mean, escaped, quoted, quoted_path

if TYPE_CHECKING:  # Help and errors must not wait for Drake.
    from parapod.sims.experiment import Entry, Experiment

HELD, BROKEN, MISTAKE, INTERRUPTED = 0, 1, 2, 130
# The experiment whose machine is meant unless another one is named.
_USUAL = "level"
# Longest text of argparse, which repeats what was typed [characters].
_LONGEST = 300

EPILOG = """\
examples:
  parapod list
  parapod run level --meshcat
  parapod run level --set ground.pitch_deg=4 seed=3 --json level.json
  parapod scenario level > mine.yaml; parapod run level --scenario mine.yaml
  parapod run chair-walk --set passenger.mass_kg=70 --html walk.html
  parapod emulate level, and in another terminal: parapod run level --backend hardware
  parapod report --out report.html

exit codes: 0 all bounds held, 1 a bound is broken, 2 a mistake in the command, a scenario or
a path, 130 interrupted
"""


class UsageError(ParapodError):
    """A command line that says nothing parapod understands."""


class Parser(argparse.ArgumentParser):
    """Parser that reports a mistake like every other mistake, in one line."""

    def __init__(self, **options: Any):
        super().__init__(
            epilog=EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
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


def check_outputs(paths: Mapping[str, Path | None]) -> None:
    """Refuse, before anything slow, files that could not be written after it.

    Args:
        paths: option -> file, or None if it was not given.

    Raises:
        OutputError: names the file, or the two options that would write the same.
    """
    from parapod.sims.outputs import check_writable

    taken: dict[str, str] = {}
    for option, path in paths.items():
        if path is None:
            continue
        check_writable(path)
        other = taken.setdefault(os.path.realpath(path), option)
        if other != option:
            raise OutputError(
                f"--{other} and --{option} would both write {quoted_path(path)}", path
            )


def add_scenario_arguments(parser: argparse.ArgumentParser, entries: "Sequence[Entry]") -> None:
    """Add the arguments that say what is to be run; see `load`."""
    parser.add_argument("name", metavar="NAME", help="an experiment; see `parapod list`")
    add_scenario_options(parser, entries)


def add_machine_option(parser: argparse.ArgumentParser) -> None:
    """Add the choice of a machine, for commands that run no experiment."""
    parser.add_argument(
        "--of",
        dest="name",
        default=_USUAL,
        metavar="NAME",
        help=f"an experiment of the machine that is meant; default {_USUAL}",
    )


def add_scenario_options(parser: argparse.ArgumentParser, entries: "Sequence[Entry]") -> None:
    """Add the options of a scenario, without the experiment's name."""
    parser.add_argument(
        "--scenario", type=Path, metavar="FILE", help="YAML with the keys to change"
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
    switches: dict[str, list[str]] = {}
    for entry in entries:
        for name, (override, what) in entry.switches.items():
            text = f"{entry.name}: {what}; short for --set {override}"
            switches.setdefault(name, []).append(text)
    for name, texts in switches.items():
        parser.add_argument(
            f"--{name}", dest="switches", action="append_const", const=name, help=". ".join(texts)
        )
    parser.set_defaults(switches=[])


def load(arguments: argparse.Namespace, entries: "Sequence[Entry]") -> "tuple[Experiment, Any]":
    """The experiment and the scenario that the arguments ask for.

    Raises:
        UsageError: there is no such experiment, or it has no such option.
        ScenarioError: a key, a value, a file or a backend that there is not.
    """
    entry = find(arguments.name, entries)

    from parapod.diagrams.drivers.external import load_drivers, load_installed_drivers
    from parapod.systems.core.scenario_file import load_scenario

    load_installed_drivers()
    if arguments.drivers is not None:
        load_drivers(arguments.drivers)
    experiment = entry.load()
    overrides = [*arguments.overrides, *_switched(entry, arguments.switches)]
    for key in ("backend", "seed"):
        value = getattr(arguments, key)
        if value is not None:
            overrides.append(f"{key}={value}")
    scenario: Any = load_scenario(
        experiment.scenario, entry.default_scenario, arguments.scenario, overrides
    )
    if scenario.backend not in experiment.backends:
        allowed = ", ".join(experiment.backends)
        raise ScenarioError(
            f"backend = '{scenario.backend}' is not one on which '{experiment.name}' runs; "
            f"there are: {allowed}",
            "backend",
        )
    return experiment, scenario


def find(name: str, entries: "Sequence[Entry]") -> "Entry":
    """The experiment of a name.

    Raises:
        UsageError: there is none.
    """
    by_name = {entry.name: entry for entry in entries}
    if name not in by_name:
        known, hint = ", ".join(by_name), did_you_mean(name, by_name)
        raise UsageError(f"there is no experiment {quoted(name)}; there are: {known}{hint}")
    return by_name[name]


def _switched(entry: "Entry", switches: Sequence[str]) -> list[str]:
    """The overrides that the given switches are short for."""
    for name in switches:
        if name not in entry.switches:
            raise UsageError(f"the experiment '{entry.name}' has no option --{name}")
    return [entry.switches[name][0] for name in switches]
