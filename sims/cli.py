"""The `parapod` command: list, show and run experiments.

Exit codes: 0 all bounds held, 1 a bound is broken, 2 the user's mistake, 130 interrupted.
"""

import argparse
import difflib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from parapod.systems.errors import OutputError, ParapodError, ScenarioError

if TYPE_CHECKING:  # Imported where they are needed: help and errors must not wait for Drake.
    from parapod.sims.experiment import Entry, Experiment

_HELD, _BROKEN, _MISTAKE, _INTERRUPTED = 0, 1, 2, 130

_EPILOG = """\
examples:
  parapod list
  parapod run level --meshcat
  parapod run level --set ground.pitch_deg=4 seed=3 --json level.json
  parapod scenario level > mine.yaml; parapod run level --scenario mine.yaml

exit codes: 0 all bounds held, 1 a bound is broken, 2 a mistake in the command, a scenario or
a path, 130 interrupted
"""


class _UsageError(ParapodError):
    """A command line that says nothing parapod understands."""


class _Parser(argparse.ArgumentParser):
    """Reports a mistake as every other mistake is reported, in one line."""

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message} (see {self.prog} --help)")


def main(argv: Sequence[str] | None = None, entries: "Sequence[Entry] | None" = None) -> int:
    """Runs the command.

    Args:
        argv: the arguments; None for those of the process.
        entries: the experiments there are; None for parapod's own.

    Returns:
        The exit code.
    """
    from parapod.sims.experiment import ENTRIES

    listed = ENTRIES if entries is None else entries
    try:
        code = _dispatch(_parser(listed).parse_args(argv), listed)
        sys.stdout.flush()
    except ParapodError as error:
        print(f"parapod: error: {error}", file=sys.stderr)
        return _MISTAKE
    except KeyboardInterrupt:
        print("parapod: interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # The reader, such as head, has seen enough. Python must not try to flush again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _HELD
    except OSError as error:
        # Standard output cannot be written: a full disk, say.
        print(f"parapod: error: {error.strerror or error}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _MISTAKE
    return code


def _parser(entries: "Sequence[Entry]") -> argparse.ArgumentParser:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = _Parser(
        prog="parapod",
        description="Leg-supported parallel machines as Drake system diagrams.",
        epilog=_EPILOG,
        formatter_class=formatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    commands.add_parser("list", help="list the experiments")
    run = commands.add_parser(
        "run",
        help="run an experiment and check its bounds",
        description="Runs an experiment, prints what it measured, and checks the bounds.",
        epilog=_EPILOG,
        formatter_class=formatter,
        allow_abbrev=False,
    )
    _add_scenario_arguments(run, entries)
    run.add_argument(
        "--meshcat", action="store_true", help="show the machine in a browser, at real time"
    )
    run.add_argument(
        "--no-live",
        dest="live",
        action="store_false",
        help="with --meshcat: end with the scripted job instead of staying for the sliders",
    )
    run.add_argument(
        "--figures", type=Path, metavar="DIR", help="draw the figures into DIR, as SVG"
    )
    run.add_argument(
        "--seeds",
        type=_count,
        metavar="N",
        help="run N seeds, from the scenario's on, and show smallest, middle and largest values",
    )
    for option, what in _OUTPUTS.items():
        run.add_argument(f"--{option}", type=Path, metavar="FILE", help=f"write {what} to FILE")
    scenario = commands.add_parser(
        "scenario",
        help="print the scenario of an experiment as YAML",
        description="Prints the scenario that `parapod run` would use with the same arguments.",
        epilog=_EPILOG,
        formatter_class=formatter,
        allow_abbrev=False,
    )
    _add_scenario_arguments(scenario, entries)
    return parser


_OUTPUTS = {
    "html": "a recording that plays in a browser",
    "json": "the metrics in JSON",
    "log": "the signals in numpy's .npz format",
    "graphviz": "the system diagram (.dot, .svg, .png or .pdf)",
}


def _add_scenario_arguments(parser: argparse.ArgumentParser, entries: "Sequence[Entry]") -> None:
    parser.add_argument("name", metavar="NAME", help="an experiment; see `parapod list`")
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


def _dispatch(arguments: argparse.Namespace, entries: "Sequence[Entry]") -> int:
    if arguments.version:
        from importlib.metadata import version

        print(f"parapod {version('parapod')}")
        return _HELD
    if arguments.command is None:
        _parser(entries).print_help()
        return _HELD
    if arguments.command == "list":
        _list(entries)
        return _HELD
    entry = _find(arguments.name, entries)
    if arguments.command == "scenario":
        return _scenario(entry, arguments)
    return _run(entry, arguments)


def _list(entries: "Sequence[Entry]") -> None:
    width = max((len(entry.name) for entry in entries), default=0)
    for entry in entries:
        print(f"{entry.name:<{width}}  {entry.summary}")


def _find(name: str, entries: "Sequence[Entry]") -> "Entry":
    by_name = {entry.name: entry for entry in entries}
    if name not in by_name:
        close = difflib.get_close_matches(name, by_name, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        known = ", ".join(by_name)
        raise _UsageError(f"there is no experiment '{name}'; there are: {known}{hint}")
    return by_name[name]


def _scenario(entry: "Entry", arguments: argparse.Namespace) -> int:
    from parapod.diagrams.scenario import dump_scenario

    print(dump_scenario(_load(entry, entry.load(), arguments)), end="")
    return _HELD


def _run(entry: "Entry", arguments: argparse.Namespace) -> int:
    _check_outputs(arguments)

    from rich.console import Console

    from parapod.sims.experiment import RunOptions
    from parapod.sims.outputs import write_json
    from parapod.sims.results import print_table

    experiment = entry.load()
    scenario = _load(entry, experiment, arguments)
    if arguments.seeds is not None:
        return _sweep(experiment, scenario, arguments)
    options = RunOptions(
        meshcat=arguments.meshcat,
        live=arguments.live,
        html=arguments.html,
        log=arguments.log,
        graphviz=arguments.graphviz,
        console=Console(stderr=True),
    )
    result = experiment.run(scenario, options)
    drawn: list[Path] = []
    try:
        if arguments.json is not None:
            write_json(arguments.json, result.as_json())
        if arguments.figures is not None:
            from parapod.sims.figures import write_figures

            drawn = write_figures(arguments.figures, result.figures)
    finally:
        # Even if the disk is full by now: the run may have been long.
        print_table(result, Console())
        for path in (arguments.html, arguments.json, arguments.log, arguments.graphviz, *drawn):
            if path is not None and path.is_file():
                print(f"wrote {path}")
        sys.stdout.flush()
    if result.afterwards is not None:
        result.afterwards()
    return _HELD if result.passed else _BROKEN


def _sweep(experiment: "Experiment", scenario: Any, arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from parapod.sims.outputs import write_json
    from parapod.sims.sweep import as_json, print_spread, run_seeds

    alone = ("meshcat", "html", "log", "graphviz", "figures")
    for option in alone:
        if getattr(arguments, option):
            raise _UsageError(f"--{option} shows a single run and does not go with --seeds")
    results = run_seeds(experiment, scenario, arguments.seeds, Console(stderr=True))
    print_spread(results, Console())
    if arguments.json is not None:
        write_json(arguments.json, as_json(results))
        print(f"wrote {arguments.json}")
    return _HELD if all(result.passed for result in results) else _BROKEN


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of 1 or more, not '{text}'")
    return int(text)


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Refuses, before anything slow, files that could not be written after the run."""
    from parapod.sims.outputs import check_writable

    taken: dict[str, str] = {}
    for option in _OUTPUTS:
        path = getattr(arguments, option)
        if path is None:
            continue
        check_writable(path)
        other = taken.setdefault(os.path.realpath(path), option)
        if other != option:
            raise OutputError(f"--{other} and --{option} would both write '{path}'", path)


def _switched(entry: "Entry", switches: Sequence[str]) -> list[str]:
    """The overrides that the given switches are short for."""
    for name in switches:
        if name not in entry.switches:
            raise _UsageError(f"the experiment '{entry.name}' has no option --{name}")
    return [entry.switches[name][0] for name in switches]


def _load(entry: "Entry", experiment: "Experiment", arguments: argparse.Namespace) -> Any:
    from parapod.diagrams.scenario import load_scenario

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
    return scenario
