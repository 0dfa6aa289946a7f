"""`parapod adopt`: puts what an experiment has identified into a scenario file."""

import argparse
from pathlib import Path
from typing import Any

from parapod.sims.cli.arguments import HELD, UsageError
from parapod.systems.core.quoting import printable, quoted, quoted_path

HELP = "put identified values into a scenario file"
DESCRIPTION = (
    "Takes what an experiment has identified of its machine, from a result that `run --json` "
    "wrote, and puts it into a scenario file: each key with its old and its new value is shown. "
    "Other keys of the file and its comments stay; a file that does not exist is begun."
)
EXAMPLES = ("parapod run calibrate --json found.json; parapod adopt found.json --into lab.yaml",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "result", type=Path, metavar="RESULT.json", help="a result with identified values"
    )
    parser.add_argument(
        "--into", type=Path, required=True, metavar="FILE", help="the scenario file, YAML"
    )
    parser.add_argument(
        "--broken-bounds",
        action="store_true",
        help="take over a result whose bounds are broken as well",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.sims.cli.compare import read_result

    result = read_result(arguments.result)
    values = _values(arguments.result, result, arguments.broken_bounds)

    from parapod.sims.output.atomic import atomic_output
    from parapod.systems.core.scenario_file import parse, read_text
    from parapod.systems.core.yaml_edit import value_at, with_values

    schema = _schema(arguments.result, result)
    values, usual = _checked(schema, values, quoted_path(arguments.result))
    source = f"scenario file {quoted_path(arguments.into)}"
    text = read_text(arguments.into) if arguments.into.exists() else ""
    before = parse(text, source)
    changed = with_values(text, values, source)
    with atomic_output(arguments.into) as temporary:
        temporary.write_text(changed, encoding="utf-8")
    for key, value in values.items():
        old = value_at(before, key)
        usual_value = f"{_shown(usual[key])} (default)" if old is None else _shown(old)
        print(f"{key}: {usual_value} -> {_shown(value)}")
    print(f"wrote {arguments.into}")
    return HELD


def _values(path: Path, result: dict[str, Any], with_broken: bool) -> dict[str, Any]:
    """Identified values by key.

    Raises:
        UsageError: there are none, or bounds are broken.
    """
    values = result.get("identified")
    if not isinstance(values, dict) or not values:
        name = printable(result.get("experiment", ""))
        raise UsageError(
            f"{quoted_path(path)} holds no identified values; allowed: results of experiments "
            f"that identify their machine, such as 'calibrate', not of '{name}'"
        )
    broken = [key for key, bound in result["bounds"].items() if bound["verdict"] == "BROKEN"]
    if broken and not with_broken:
        raise UsageError(
            f"in {quoted_path(path)} bounds are broken: {', '.join(map(printable, broken))}; "
            "take it over all the same with --broken-bounds"
        )
    return values


def _schema(path: Path, result: dict[str, Any]) -> type:
    """Schema of the scenarios of the machine that a result is of.

    Raises:
        UnknownExperiment: no such experiment is installed.
        UsageError: it has no machine.
    """
    from parapod.sims.lab.discovery import find_experiment

    name = str(result.get("experiment"))
    machine = getattr(find_experiment(name), "machine", None)
    if machine is None:
        raise UsageError(f"{quoted_path(path)}: the experiment {quoted(name)} has no machine")
    schema: type = machine.scenario
    return schema


def _checked(
    schema: type, values: dict[str, Any], source: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values in the schema's types, and the defaults in their place.

    Raises:
        ScenarioError: a key that the schema does not have, or a value that is not admissible.
    """
    from parapod.systems.core.schema import Reader, defaults
    from parapod.systems.core.yaml_edit import value_at

    usual = defaults(schema)
    tree, reader = usual, Reader(schema, source)
    for key, value in values.items():
        tree = reader.assign(schema, tree, key.split("."), value)
    return (
        {key: value_at(tree, key) for key in values},
        {key: value_at(usual, key) for key in values},
    )


def _shown(value: Any) -> str:
    from parapod.systems.core.scenario_file import inline

    return printable(inline(value))
