"""`parapod pose`: poses any closed-loop mechanism from its file, and shows it."""

import argparse
import json
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.sims.cli.arguments import HELD, UsageError, check_outputs
from parapod.systems.core.quoting import quoted

if TYPE_CHECKING:
    from parapod.sims.lab.poser import Poser

HELP = "pose a closed-loop mechanism of your own from its file"
DESCRIPTION = (
    "Reads a URDF, SDFormat, MJCF or Drake's model directives, closes the loops, and tells what "
    "the mechanism can do: freedoms, loops that follow from others, motors, what they hold, how "
    "near singular positions are. Loops and motors that the file cannot hold are in a YAML beside "
    "it. With --meshcat a page has sliders for motors and for a frame; the mouse drags bodies "
    "with Ctrl held, and all loops stay closed."
)
EXAMPLES = (
    "parapod pose examples/mechanisms/hexapod/hexapod.urdf",
    "parapod pose examples/mechanisms/delta/delta.xml --meshcat",
    "parapod pose hexapod.urdf --set leg_1=20mm --set leg_2=20mm",
    "parapod pose hexapod.urdf --frame platform --at z=0.47 --at roll=5deg",
    "parapod pose stewart.sdf --motors 'piston?_prismatic_joint' --json pose.json",
)
_VALUE = re.compile(r"([^=]+)=([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)(mm|m|deg|rad)?")
# Force that rounding leaves [N, N m].
_UNHELD = 1e-6
_UNITS = {"": 1.0, "m": 1.0, "rad": 1.0, "mm": 1e-3, "deg": math.radians(1.0)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_model_arguments(parser)
    parser.add_argument(
        "--frame", default="", metavar="NAME", help="frame or link that is moved and measured"
    )
    parser.add_argument(
        "--set",
        dest="motors_at",
        action="append",
        default=[],
        metavar="MOTOR=VALUE",
        help="position of a motor's joint, in m or rad unless mm or deg follows; can be repeated",
    )
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="PART=VALUE",
        help="part of the frame's pose, one of x, y, z, roll, pitch, yaw; can be repeated",
    )
    parser.add_argument("--meshcat", action="store_true", help="serve a page, until Ctrl-C")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that name a mechanism."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="model (.urdf, .sdf, .xml, .mjcf or .dmd.yaml)"
    )
    parser.add_argument(
        "--loops",
        type=Path,
        metavar="FILE",
        help="YAML with the loops and motors; default: that of the model's name beside it",
    )
    parser.add_argument(
        "--motors",
        nargs="+",
        default=[],
        metavar="JOINT",
        help="joints with motors, in place of those of the files; * and ? stand for any letters",
    )
    parser.add_argument(
        "--free",
        action=argparse.BooleanOptionalAction,
        help="leave the base free, or weld it to the world; default: as an MJCF says, else welded",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    check_outputs({"json": arguments.json})
    if arguments.motors_at and arguments.at:
        raise UsageError("--set and --at cannot be combined: either motors or the frame are given")

    # Before NumPy is loaded: threads for matrices this small take ten times as long.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from parapod.sims.lab.poser import Poser
    from parapod.systems.mechanism.coordinates import PARTS
    from parapod.systems.mechanism.model import add_model

    def read(plant: Any) -> Any:
        return add_model(plant, arguments.file, arguments.loops, arguments.motors, arguments.free)

    meshcat = None
    if arguments.meshcat:
        from pydrake.geometry import Meshcat

        meshcat = Meshcat()
    poser = Poser(read, arguments.frame, meshcat)
    names = [poser.mechanism.name(joint) for joint in poser.mechanism.motors]
    if arguments.motors_at:
        values = dict(zip(names, poser.motors.tolist(), strict=True))
        poser.move_motors(list((values | _values(arguments.motors_at, "--set", names)).values()))
    elif arguments.at:
        parts = _values(arguments.at, "--at", PARTS)
        poser.move_frame({PARTS.index(part): value for part, value in parts.items()})
    if poser.remark and not arguments.meshcat:
        raise UsageError(poser.remark)
    _print(arguments.file.name, poser)
    if arguments.json is not None:
        from parapod.sims.output.atomic import atomic_output

        with atomic_output(arguments.json) as temporary:
            temporary.write_text(json.dumps(_numbers(poser), indent=2) + "\n", encoding="utf-8")
        print(f"wrote {arguments.json}")
    if meshcat is not None:
        _serve(arguments.file.name, poser, meshcat)
    return HELD


def _values(texts: Sequence[str], option: str, names: Sequence[str]) -> dict[str, float]:
    """Values by name, in m and rad.

    Raises:
        UsageError: a text of another form, or an unknown name.
    """
    values = {}
    for text in texts:
        match = _VALUE.fullmatch(text)
        if match is None:
            raise UsageError(
                f"{option} {quoted(text)} is not NAME=VALUE, with m, mm, rad or deg behind it"
            )
        name, number, unit = match.groups()
        if name not in names:
            raise UsageError(f"{option}: {quoted(name)} is not one of {', '.join(names)}")
        values[name] = float(number) * _UNITS[unit or ""]
    return values


def _print(title: str, poser: "Poser") -> None:
    mechanism = poser.mechanism
    of, near = mechanism.mobility, mechanism.dexterity(poser.q, poser.frame)
    print(
        f"{title}: {of.freedoms} freedoms, {len(mechanism.motors)} motors, "
        f"{len(mechanism.joints)} joints, {len(mechanism.loops)} loops with {of.equations} "
        f"equations, of which {of.equations - of.rank} follow from others"
    )
    for loop, count in of.redundant.items():
        print(f"  {count} of {loop} follow from those of the other loops")
    if of.freedoms > of.governed:
        idle = ", ".join(mechanism.name(mechanism.plant.get_joint(i)) for i in of.idle)
        print(f"  {of.freedoms - of.governed} freedoms without a motor, in {idle}")
    from parapod.systems.mechanism.coordinates import joint_unit
    from parapod.systems.mechanism.statics import motor_forces

    held = motor_forces(mechanism, poser.q)
    width = max(len(mechanism.name(joint)) for joint in mechanism.motors)
    for joint, value, force in zip(mechanism.motors, poser.motors, held.forces, strict=True):
        unit, factor = joint_unit(mechanism, joint)
        (low,), (high,) = joint.position_lower_limits(), joint.position_upper_limits()
        limits = f"{factor * low:.6g}..{factor * high:.6g}" if math.isfinite(high - low) else "any"
        per = "N" if unit == "mm" else "N m"
        print(
            f"  {mechanism.name(joint):<{width}} {_rounded(factor * value, 3):10.3f} {unit:<3} "
            f"of {limits}, holds {_rounded(force, 6):.4g} {per}"
        )
    x, y, z, *angles = poser.pose.tolist()
    x, y, z = (_rounded(1e3 * length, 3) for length in (x, y, z))
    roll, pitch, yaw = (_rounded(math.degrees(angle), 4) for angle in angles)
    print(
        f"  {poser.frame} at x {x:.3f}, y {y:.3f}, z {z:.3f} mm, "
        f"roll {roll:.4f}, pitch {pitch:.4f}, yaw {yaw:.4f} deg"
    )
    print(
        f"  from 0, singular, to 1: {near.loops:.4f} loops, {near.held:.4f} held by the motors, "
        f"{near.moved:.4f} moved by them"
    )
    for name, far in mechanism.beyond_limits(poser.q).items():
        print(f"  {name} is {far:.4g} beyond its limits [m, rad]")
    if held.unheld > _UNHELD:
        print(f"  up to {held.unheld:.4g} N, N m act along freedoms that no motor holds")
    if mechanism.is_rounded:
        print("  loops contradict each other by the rounding of the file's numbers, 1e-6 at most")
    for note in mechanism.notes:
        print(f"  {note}")


def _rounded(number: float, decimals: int) -> float:
    """A number rounded, without the sign of a zero."""
    return round(number, decimals) + 0.0


def _numbers(poser: "Poser") -> dict[str, Any]:
    """Numbers of the pose, in SI units."""
    from parapod.systems.mechanism.coordinates import PARTS
    from parapod.systems.mechanism.statics import motor_forces

    mechanism = poser.mechanism
    of, near = mechanism.mobility, mechanism.dexterity(poser.q, poser.frame)
    held = motor_forces(mechanism, poser.q)
    return {
        "freedoms": of.freedoms,
        "equations": of.equations,
        "independent_equations": of.rank,
        "redundant": dict(of.redundant),
        "motors": {
            mechanism.name(joint): {"position": float(value), "force": float(force)}
            for joint, value, force in zip(
                mechanism.motors, poser.motors, held.forces, strict=True
            )
        },
        "frame": poser.frame,
        "pose": dict(zip(PARTS, poser.pose.tolist(), strict=True)),
        "joints": {
            mechanism.name(joint): poser.q[
                joint.position_start() : joint.position_start() + joint.num_positions()
            ].tolist()
            for joint in mechanism.joints
        },
        "dexterity": {"loops": near.loops, "held": near.held, "moved": near.moved},
        "beyond_limits": mechanism.beyond_limits(poser.q),
        "notes": list(mechanism.notes),
    }


def _serve(name: str, poser: "Poser", meshcat: Any) -> None:
    from parapod.sims.lab.panel import Panel
    from parapod.sims.lab.poser import PosePage

    panel = Panel(meshcat, f"pose: {name}")
    try:
        page = PosePage(poser, panel)
        print(f"open {panel.web_url()}; Ctrl-C ends", flush=True)
        page.serve()
    finally:
        panel.close()
