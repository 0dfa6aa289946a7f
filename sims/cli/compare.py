"""`parapod compare`: two results of an experiment side by side, and what led to the difference."""

import argparse
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from parapod.sims.cli.arguments import BROKEN, HELD, UsageError
from parapod.systems.core.quoting import printable, quoted_path

HELP = "compare two results"
DESCRIPTION = (
    "Shows the metrics of two results that `run --json` wrote side by side, then the settings in "
    "which their scenarios differ. The exit code is 1 if a bound that the first result held is "
    "broken in the second."
)
EXAMPLES = (
    "parapod run level --json a.json; parapod run level --seed 7 --json b.json",
    "parapod compare a.json b.json",
)

# Facts of a result about its run, beside metrics and scenario.
_OF_THE_RUN = ("experiment", "backend", "seed", "parapod")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("first", type=Path, metavar="A.json", help="a result, such as before")
    parser.add_argument("second", type=Path, metavar="B.json", help="another one, such as after")


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    first, second = read_result(arguments.first), read_result(arguments.second)

    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    metrics = list(dict.fromkeys([*first["bounds"], *second["bounds"]]))
    table = Table(box=SIMPLE_HEAD)
    table.add_column(
        "metric", overflow="fold", min_width=min(40, max(map(len, metrics), default=0))
    )
    for head in ("A", "B", "change"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("verdict", overflow="fold", min_width=7)
    for key in metrics:
        table.add_row(
            Text(key),
            *(Text(_shown(document, key)) for document in (first, second)),
            Text(_change(first.get(key), second.get(key))),
            Text(_verdicts(first, second, key)),
        )
    console.print(table)

    settings = dict(_leaves(first.get("scenario", {}))), dict(_leaves(second.get("scenario", {})))
    different = [
        *((name, first.get(name), second.get(name)) for name in _OF_THE_RUN),
        *(
            (name, settings[0].get(name), settings[1].get(name))
            for name in dict.fromkeys([*settings[0], *settings[1]])
            if name not in _OF_THE_RUN
        ),
    ]
    rows = [(name, a, b) for name, a, b in different if a != b]
    for name, a, b in rows:
        console.print(Text(f"{name}: {printable(_plain(a))} -> {printable(_plain(b))}"))
    if not rows:
        console.print(Text("the same experiment, backend, seed, version and scenario"))

    worse = [
        key
        for key in metrics
        if _verdict(first, key) == "held" and _verdict(second, key) == "BROKEN"
    ]
    for key in worse:
        console.print(Text(f"held in A, broken in B: {key}", style="bold red"))
    return BROKEN if worse else HELD


def read_result(path: Path) -> dict[str, Any]:
    """A result that `run --json` wrote.

    Raises:
        UsageError: the file cannot be read, or is something else.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read {quoted_path(path)}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise UsageError(
            f"{quoted_path(path)} is not JSON; allowed: what `run --json` wrote"
        ) from None
    bounds = document.get("bounds") if isinstance(document, dict) else None
    if not isinstance(bounds, dict) or not all(
        isinstance(bound, dict) and "verdict" in bound and key in document
        for key, bound in bounds.items()
    ):
        raise UsageError(
            f"{quoted_path(path)} is not the result of one run; allowed: what `run --json` wrote"
        )
    return document


def _leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Settings by dotted name, in the order of the document; lists are settings as a whole."""
    if not isinstance(tree, dict):
        yield path, tree
        return
    for key, value in tree.items():
        yield from _leaves(value, f"{path}.{key}" if path else key)


def _verdict(document: dict[str, Any], key: str) -> str:
    return str(document["bounds"][key]["verdict"]) if key in document["bounds"] else "absent"


def _verdicts(first: dict[str, Any], second: dict[str, Any], key: str) -> str:
    before, after = _verdict(first, key), _verdict(second, key)
    return after if before == after else f"{before} -> {after}"


def _shown(document: dict[str, Any], key: str) -> str:
    value = document.get(key)
    return f"{value:.6g}" if isinstance(value, int | float) else "-"


def _change(before: Any, after: Any) -> str:
    """Relative change in per cent, or the second value's excess where the first one is zero."""
    if not isinstance(before, int | float) or not isinstance(after, int | float):
        return ""
    if before == after:
        return "="
    if before == 0:
        return f"{after:+.3g}"
    change = 100.0 * (after - before) / abs(before)
    return f"{change:+.3g} %" if math.isfinite(change) else ""


def _plain(value: Any) -> str:
    return "absent" if value is None else str(value)
