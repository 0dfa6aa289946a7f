"""`parapod design`: searches for dimensions of a machine that do best what is asked for."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.sims.cli.arguments import (
    BROKEN,
    HELD,
    add_scenario_arguments,
    check_outputs,
    count,
    load,
    print_of,
)
from parapod.sims.cli.crew import add_crew_options, carry_out, check_crew_options

if TYPE_CHECKING:
    from parapod.sims.design.result import Design, SearchResult

HELP = "search for dimensions of a machine that do best what is asked for"
DESCRIPTION = (
    "Searches for values of keys below machine that make entries of the data sheet (`parapod "
    "sheet`) or metrics of experiments (EXPERIMENT:METRIC) large or small, while constraints "
    "hold. "
    "One objective: differential evolution; several: NSGA-II, and a front of designs that no "
    "other one beats. Designs that cannot be built, or do not stand, are refused with their "
    "reason.\n\n"
    "Values are those of `parapod study`: LOW:HIGH, VALUE,VALUE,..., 'loguniform(LOW, HIGH)'."
)
EXAMPLES = (
    "parapod design level --vary machine.legs.l_4_mm=300:600 machine.legs.l_3_mm=50:120 "
    "--maximise level_range_deg --minimise footprint_m2 --out design.parquet --html design.html",
    "parapod design level --vary machine.legs.l_4_mm=300:600 --maximise level_range_deg "
    "--hold 'actuator_load_N<=2000' --pick 1 --into mine.yaml --simulate",
)
_OUTPUTS = {"html": "a page with front, sensitivities and figures", "json": "the same in JSON"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    for option, what, metavar in (
        ("vary", "vary keys below machine, as in machine.legs.l_4_mm=300:600", "KEY=VALUES"),
        ("maximise", "make these numbers large", "NAME"),
        ("minimise", "make these numbers small", "NAME"),
        ("hold", "keep constraints, as in 'mass_kg<=60'", "NAME<=VALUE"),
    ):
        parser.add_argument(
            f"--{option}", nargs="+", action="extend", default=[], metavar=metavar,
            help=f"{what}; may be repeated",
        )  # fmt: skip
    parser.add_argument(
        "--designs", type=count, default=2000, metavar="N", help="largest number; default 2000"
    )
    parser.add_argument(
        "--population",
        type=count,
        metavar="N",
        help="designs of a generation; default ten for each variable, 20 to 200",
    )
    parser.add_argument(
        "--search-seed", type=int, default=0, metavar="N", help="seed of the search; default 0"
    )
    add_crew_options(parser, "designs")
    parser.add_argument(
        "--pick", type=count, metavar="N", help="design of the front for --into; default its "
        "compromise"
    )  # fmt: skip
    parser.add_argument(
        "--into", type=Path, metavar="FILE", help="write that machine to FILE, for --machine"
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="run that machine with rigid bodies, and show it beside what was predicted",
    )
    for option, what in _OUTPUTS.items():
        parser.add_argument(f"--{option}", type=Path, metavar="FILE", help=f"write {what} to FILE")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    files = {option: getattr(arguments, option) for option in (*_OUTPUTS, "out", "into")}
    check_outputs(files, {"figures": arguments.figures})
    print_of(arguments, arguments.figure_format)  # refused before the search
    check_crew_options(arguments)
    experiment, scenario = load(arguments)

    from parapod.sims.design.goals import Goal, Hold
    from parapod.sims.design.result import SearchResult
    from parapod.sims.design.search import Search
    from parapod.sims.study.records import Records
    from parapod.sims.study.variables import split_variable

    goals = [Goal(name, -1.0) for name in arguments.maximise]
    goals += [Goal(name, 1.0) for name in arguments.minimise]
    search = Search.make(
        arguments.name,
        scenario,
        dict(split_variable(text) for text in arguments.vary),
        goals,
        [Hold.from_text(text) for text in arguments.hold],
        arguments.designs,
        arguments.population,
        arguments.search_seed,
    )
    records = Records(search.sampling)
    carry_out(search, arguments, "designs", records)
    result = SearchResult(search, records)
    _show(result, arguments)
    if not result.front:
        return BROKEN
    design = result.compromise if arguments.pick is None else result.pick(arguments.pick)
    assert design is not None
    if arguments.into is not None:
        _write_machine(result, design, arguments.into)
    if arguments.simulate:
        return _simulate(experiment, result, design)
    return HELD


def _show(result: "SearchResult", arguments: argparse.Namespace) -> None:
    """Prints and writes what came out."""
    from rich.console import Console

    from parapod.sims.design.page import figures_of, make_page
    from parapod.sims.design.result import print_result
    from parapod.sims.output.atomic import atomic_output, write_json
    from parapod.sims.output.figures import write_figures

    written = [] if arguments.out is None else [arguments.out]
    try:
        if arguments.json is not None:
            write_json(arguments.json, result.as_json())
            written.append(arguments.json)
        if arguments.html is not None:
            with atomic_output(arguments.html) as temporary:
                temporary.write_text(make_page(result), encoding="utf-8")
            written.append(arguments.html)
        if arguments.figures is not None:
            form = print_of(arguments, arguments.figure_format)
            written += write_figures(arguments.figures, list(figures_of(result)), form)
    finally:
        print_result(result, Console())
        for path in written:
            print(f"wrote {path}")
        sys.stdout.flush()


def _write_machine(result: "SearchResult", design: "Design", path: Path) -> None:
    """Writes a design as a file for --machine, with what is predicted of it above."""
    import yaml  # type: ignore[import-untyped]

    from parapod.sims.output.atomic import atomic_output

    predicted = ", ".join(f"{name} {value:.5g}" for name, value in design.values.items())
    text = yaml.safe_dump(result.machine(design), sort_keys=False, default_flow_style=None)
    with atomic_output(path) as temporary:
        temporary.write_text(f"# Design {design.number}: {predicted}\n{text}", encoding="utf-8")
    print(f"wrote {path}")


def _simulate(experiment: Any, result: "SearchResult", design: "Design") -> int:
    """Runs a design where its sheet says how, or at its usual job; with rigid bodies if it can."""
    from rich.console import Console
    from rich.text import Text

    from parapod.sims.output.options import RunOptions
    from parapod.sims.output.results import print_table

    sheet = result.sheet(design)
    demonstrations = [each for each in sheet.demonstrations() if each.entry in result.search.names]
    has_bodies = "multibody" in experiment.machine.plants
    settings = {"backend": "multibody"} if has_bodies else {}
    for each in demonstrations:
        settings |= each.settings
    console = Console()
    scenario = result.scenario(design, settings)
    outcome = experiment.execute(scenario, RunOptions(console=Console(stderr=True)))
    print_table(outcome, console)
    words = "all bounds held" if outcome.passed else "bounds broken"
    how = "rigid bodies" if has_bodies else "simulated"
    for each in demonstrations:
        predicted = sheet.value(each.entry)
        console.print(
            Text(f"{each.entry}: predicted {predicted:.4g}; {how} {each.words}: {words}")
        )
    return HELD if outcome.passed else BROKEN
