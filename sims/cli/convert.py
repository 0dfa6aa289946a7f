"""`parapod convert`: writes a closed-loop mechanism in another format, with its loops."""

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from parapod.sims.cli.arguments import HELD, check_outputs
from parapod.sims.cli.pose import add_model_arguments
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path

HELP = "write a mechanism as URDF, SDFormat or MJCF, loops kept"
DESCRIPTION = (
    "Reads a model of a closed-loop mechanism as 'parapod pose' does, and writes it in another "
    "format: links with inertias and shapes, joints with limits and motors, loops. Welds, which "
    "URDF and SDFormat do not have, are in a YAML beside the file. Universal and ball joints "
    "become hinges. What has been written is read back and compared: freedoms, masses, and where "
    "every link is in poses of all loops closed."
)
EXAMPLES = (
    "parapod convert examples/mechanisms/hexapod/hexapod.urdf --to mjcf",
    "parapod convert examples/mechanisms/delta/delta.xml --to urdf --out delta.urdf",
    "parapod convert stewart.sdf --motors 'piston?_prismatic_joint' --to mjcf",
)
_SUFFIXES = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_model_arguments(parser)
    parser.add_argument("--to", choices=tuple(_SUFFIXES), required=True, help="format")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="file; default: the model's name with the format's suffix, in this folder",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.sims.lab.converted import convert, files_of
    from parapod.sims.output.model_file import format_of
    from parapod.systems.mechanism.model import add_model, loops_beside

    name = arguments.file.name.removesuffix(".dmd.yaml").removesuffix(arguments.file.suffix)
    out = arguments.out or Path(f"{name}{_SUFFIXES[arguments.to]}")
    format_of(out, arguments.to)
    check_outputs({"out": out})
    sources = {"the model": arguments.file}
    if loops := arguments.loops or loops_beside(arguments.file):
        sources["the file of its loops"] = loops
    _keep(sources, files_of(out, arguments.to))

    def read(plant: Any) -> Any:
        options = arguments.loops, arguments.motors, arguments.free
        return add_model(plant, arguments.file, *options, is_plain=True)

    result = convert(read, name, arguments.to, out)
    for note in result.notes:
        print(note)
    for path in result.files[:-1]:
        print(f"wrote {path}")
    print(
        f"wrote {result.files[-1]}: {result.freedoms} freedoms, {result.loops} loops; read back, "
        f"links are where they were within {1e9 * result.largest_gap:.2g} nm"
    )
    return HELD


def _keep(sources: Mapping[str, Path], files: Iterable[Path]) -> None:
    """Refuses to write over what is read.

    Args:
        sources: files that are read, by words for them.
        files: files that are written.

    Raises:
        OutputError: names the file and the option.
    """
    for file in files:
        for what, source in sources.items():
            if file.exists() and source.exists() and file.samefile(source):
                words = f"cannot write {quoted_path(file)}: it is {what} that is read"
                raise OutputError(f"{words}; name another file with --out", file)
