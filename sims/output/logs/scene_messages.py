"""Drawing of a machine in its log, as messages that RViz and Foxglove know."""

import time
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from parapod.sims.output.drawn import DrawnLog
from parapod.sims.output.drawn_bodies import DrawnBodies
from parapod.sims.output.logs.mcap import Message, Picture, Schema
from parapod.sims.output.logs.part_messages import SCHEMA_ENCODING, definition_of, types
from parapod.systems.hardware.buses.ros2.scene import MARKERS, TRANSFORMS, markers, transforms

FRAMES, SCENE, DESCRIPTION = "/tf", "/scene", "/robot_description"
KINDS = {FRAMES: TRANSFORMS, SCENE: MARKERS, DESCRIPTION: "std_msgs/msg/String"}
# Somebody waits for the log: drawings whose poses take longer are made with fewer pictures [s].
_PATIENCE, _TRIED = 8.0, 10


def scene_messages(drawing: DrawnLog, pictures: Sequence[Picture]) -> Iterator[Message]:
    """The bodies, once as a URDF and once as markers, and their poses in each picture.

    Args:
        drawing: the machine and its signals.
        pictures: stamp [ns], time [s] and samples of the log's signals.

    Raises:
        MissingExtra: rosbags is not installed.
        ParapodError: the drawing is refused.
    """
    if not pictures:
        return
    twin, first = drawing.make(), pictures[0][0]
    bodies = DrawnBodies(twin)
    yield _message(DESCRIPTION, first, data=bodies.description("parapod"))
    yield _message(SCENE, first, markers=markers(_made, bodies.visuals(), first))
    began, step = time.monotonic(), 1
    for number, (stamp, t, row) in enumerate(pictures):
        if number == _TRIED:
            duration = (time.monotonic() - began) / _TRIED * len(pictures)
            step = max(1, round(duration / _PATIENCE + 0.5))
        if number % step == 0:
            twin.show(drawing.values(row), t)
            yield _message(FRAMES, stamp, transforms=transforms(_made, bodies.poses(), stamp))


@cache
def _schema(topic: str) -> Schema:
    return Schema(KINDS[topic], SCHEMA_ENCODING, definition_of(KINDS[topic]).encode())


def _message(topic: str, stamp: int, **fields: Any) -> Message:
    kind = KINDS[topic]
    data = bytes(types().serialize_cdr(_made(kind, **fields), kind))
    return Message(topic, _schema(topic), stamp, data)


def _made(kind: str, **fields: Any) -> Any:
    """A message of rosbags, of which fields that are not given are zero or empty."""
    _, definitions = types().fielddefs[kind]
    others = {name: _empty(*node) for name, node in definitions if name not in fields}
    return types().types[kind](**fields, **others)


def _empty(node: Any, what: Any) -> Any:
    """Zero or empty value of a field, by the node of its type."""
    if node.name == "NAME":
        return _made(what)
    if node.name == "BASE":
        return "" if what[0] == "string" else np.zeros(1, what[0]).item()
    (inner, kind), _ = what
    return np.zeros(0, kind[0]) if inner.name == "BASE" else []
