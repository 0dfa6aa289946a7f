"""`parapod export`: writes a machine as it is built for other programs."""

import argparse
from pathlib import Path

from parapod.sims.cli.arguments import (
    HELD,
    UsageError,
    add_scenario_arguments,
    check_outputs,
    load,
)
from parapod.sims.lab.discovery import find_entry

HELP = "write a machine as URDF, SDFormat or MJCF"
DESCRIPTION = (
    "Writes the bodies of an experiment's machine as they are simulated, with all dimensions and "
    "masses of the scenario, so that another program can load them: links with their inertias, "
    "joints with limits and drives, shapes, contacts, frames and closed loops. A line tells what "
    "the format cannot hold. Meshes are copied into a folder beside the file. Loaded, a URDF or "
    "SDFormat has its joints at zero; positions in which the machine stands are in a comment, and "
    "in MJCF in the key frame 'standing'."
)
EXAMPLES = (
    "parapod export level --out platform.urdf",
    "parapod export level --machine examples/machines/large_platform.yaml --out large.sdf",
    "parapod export chair-walk --set passenger.mass_kg=70 --to mjcf --out chair.xml",
)
# Backend with bodies unless another one is named.
_BODIES = "multibody"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--to", choices=("urdf", "sdf", "mjcf"), help="format; default: by the suffix of --out"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        required=True,
        help="file (.urdf, .sdf; .mjcf or .xml for MuJoCo)",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Runs the command; returns the exit code."""
    from parapod.sims.output.model_file import format_of, notes, write_model

    form = format_of(arguments.out, arguments.to)
    check_outputs({"out": arguments.out})
    if arguments.backend is None:
        _check_bodies(arguments.name)
        arguments.backend = _BODIES
    experiment, scenario = load(arguments)

    from parapod.diagrams.built import bodies_of_loop
    from parapod.diagrams.drawing import visuals_kept
    from parapod.sims.api import loop_of
    from parapod.systems.physics.description import Description

    with visuals_kept():
        loop = loop_of(experiment, scenario)
    bodies = bodies_of_loop(loop)
    name = loop.machine.name
    tree = Description(bodies.plant, bodies.context, bodies.scene_graph, name)
    files = write_model(arguments.out, form, tree)
    for note in notes(tree, form):
        print(note)
    for path in files[:-1]:
        print(f"wrote {path}")
    plant, context = bodies.plant, bodies.context
    mass = sum(body.get_mass(context) for body in tree.bodies[1:] if not plant.IsAnchored(body))
    count = sum(joint.num_velocities() == 1 for joint in tree.joints)
    print(
        f"wrote {files[-1]}: {len(tree.links) - 1} links, {mass:.6g} kg of which can move, "
        f"{count} hinges and slides, {len(tree.closures)} loops"
    )
    return HELD


def _check_bodies(name: str) -> None:
    """Refuses an experiment whose machine has no bodies.

    Raises:
        UsageError: names experiments whose machines have some.
    """
    if _BODIES not in find_entry(name).load().backends:
        from parapod.diagrams.machine import list_machines

        able = [machine.experiment for machine in list_machines() if _BODIES in machine.plants]
        raise UsageError(
            f"the experiment '{name}' simulates no bodies; these do: {', '.join(able)}"
        )
