"""Video of a machine as its log shows it, by Drake's renderer: no browser, no screen."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import (
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    PerceptionProperties,
    Rgba,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from rich.console import Console

from parapod.diagrams.drawing import View, add_renderer, take
from parapod.diagrams.twin import MEASURED
from parapod.diagrams.wiring import add
from parapod.sims.lab.stage import Stage, absolute
from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.progress import counted
from parapod.sims.output.rendered import rendered
from parapod.sims.replay.digest import Picture
from parapod.sims.replay.drawing import scene_of
from parapod.sims.replay.replay import Replay, open_replays
from parapod.systems.core.errors import OutputError, ParapodError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path

# Codec and pixels of each kind of file, and its pictures a second; players of GIF are slow.
_CODECS = {".mp4": ("libx264", "yuv420p"), ".webm": ("libvpx-vp9", "yuv420p")}
_RATE, _GIF_RATE = 25.0, 12.5
FORMATS = (*_CODECS, ".gif")
_SIZE, _GIF_SIZE = (1280, 720), (640, 400)  # even, as codecs want it [pixel]
_ANGLE = math.radians(36.0)  # angle of view from top to bottom, that of the browser's camera
_DEPTH = 12.0  # distance from the target to the edge of the widest floor [m]
_SKY = (0.90, 0.93, 0.96)
_GREY = Rgba(0.8, 0.8, 0.8, 1.0)
_AWAY = RigidTransform(np.array((0.0, 0.0, -1e4)))  # place of what is hidden


def check_video(path: Path | None) -> None:
    """Refuse a file that cannot be a video, before anything slow.

    Raises:
        OutputError: its suffix is none of `FORMATS`.
        MissingExtra: the library that encodes it is not installed.
    """
    if path is None:
        return
    if path.suffix.lower() not in FORMATS:
        name = quoted_path(path.name)
        raise OutputError(f"--video writes {' or '.join(FORMATS)}, not {name}", path)
    if path.suffix.lower() in _CODECS:
        need("av")


def write_video(
    log: Path, path: Path, console: Console, between: tuple[float, float] | None = None
) -> None:
    """Writes a video of the machine of a log, in real time.

    Args:
        log: the log.
        path: the video; its suffix is one of `FORMATS`.
        console: console for progress.
        between: first and last time in the video [s]; None: all.

    Raises:
        OutputError: the log cannot be read, or the video not be written.
        ParapodError: the machine of the log cannot be drawn, or there is no renderer.
    """
    check_video(path)
    progress = console.is_terminal
    try:
        refusal = rendered(partial(_write, log, path, progress, between))
    except RuntimeError as error:
        raise ParapodError(f"no video: {error}") from None
    if refusal:
        raise ParapodError(refusal)


def _write(
    log: Path, path: Path, progress: bool, between: tuple[float, float] | None
) -> str | None:
    """Writes a video; returns why it cannot be written, for exceptions do not cross processes."""
    console = Console(stderr=True, quiet=not progress)
    try:
        replay, _ = open_replays(log, None, (), console, between=between)
        if replay.subject.drawn is None:
            return f"no video of {quoted_path(log)}: {replay.subject.undrawn}"
        is_gif = path.suffix.lower() == ".gif"
        rate = _GIF_RATE if is_gif else _RATE
        frames = _frames(replay, _GIF_SIZE if is_gif else _SIZE, rate, console)
        with atomic_output(path) as temporary:
            if is_gif:
                _write_gif(temporary, frames)
            else:
                _encode(temporary, frames, path.suffix.lower())
    except ParapodError as error:
        return str(error)
    return None


def _frames(
    replay: Replay, size: tuple[int, int], rate: float, console: Console
) -> Iterator[NDArray[np.uint8]]:
    """Pictures (height, width, 3) at a fixed rate."""
    drawing, pictures = replay.subject.drawn, replay.digest.pictures
    assert drawing is not None
    stage: Any = scene_of(replay.subject)
    twin = drawing.make(stage)
    film: Film | None = None
    view = View(tuple(stage.camera), tuple(stage.target), _ANGLE, size, depth=_DEPTH)
    chosen = _at_rate(pictures, rate)
    with counted(console, f"filming {replay.subject.label}", len(chosen)) as report:
        for count, number in enumerate(chosen):
            time, row = pictures[number]
            twin.show(drawing.values(row), time)
            graph, context = twin.scene_graphs()[MEASURED]
            film = film or Film(stage, graph, twin.path(MEASURED))
            yield film.picture(context, view)
            report(count)


def _at_rate(pictures: Sequence[Picture], rate: float) -> list[int]:
    """Numbers of the pictures that are the newest at each instant of a video."""
    times = np.array([time for time, _ in pictures])
    count = math.floor((times[-1] - times[0]) * rate + 1e-6) + 1
    instants = times[0] + np.arange(count) / rate
    newest = np.searchsorted(times, instants + 1e-6, side="right") - 1
    return [int(number) for number in newest]


class Film:
    """Scene graph with everything that a stage and the drawing of a machine show.

    Args:
        stage: surroundings of the machine.
        graph: scene graph of the drawing.
        prefix: path of the drawing on the stage.
    """

    def __init__(self, stage: Stage, graph: SceneGraph, prefix: str):
        self._stage, self._drawing = stage, graph
        builder = DiagramBuilder()
        self._graph = add(builder, SceneGraph())
        add_renderer(self._graph, _SKY)
        self._source = self._graph.RegisterSource("film")
        self._bodies: dict[FrameId, tuple[str, FrameId]] = {}
        inspector = graph.model_inspector()
        for body in inspector.GetAllFrameIds():
            shapes = inspector.GetGeometries(body, Role.kIllustration)
            if body == graph.world_frame_id() or not shapes:
                continue
            name = inspector.GetName(body).replace("::", "/")
            frame = self._add_frame(name)
            self._bodies[body] = (absolute(f"{prefix}/{name}"), frame)
            for shape in shapes:
                properties = inspector.GetIllustrationProperties(shape)
                colour: Any = properties.GetPropertyOrDefault("phong", "diffuse", _GREY)
                X_FG = inspector.GetPoseInFrame(shape)
                self._add_shape(frame, inspector.GetShape(shape), X_FG, colour)
        self._props = {}
        for path, prop in stage.props.items():
            self._props[path] = self._add_frame(path)
            self._add_shape(self._props[path], prop.shape, RigidTransform(), prop.colour)
        diagram = builder.Build()
        self._root = diagram.CreateDefaultContext()

    def picture(self, context: Any, view: View) -> NDArray[np.uint8]:
        """Picture (height, width, 3) of the scene as it is now.

        Args:
            context: context of the drawing's scene graph.
            view: position of the camera.
        """
        drawing: Any = self._drawing.get_query_output_port().Eval(context)
        poses, bodies = FramePoseVector(), {}
        for body, (path, frame) in self._bodies.items():
            bodies[path] = drawing.GetPoseInWorld(body)
            poses.set_value(frame, self._visible(path, bodies[path]))
        for path, frame in self._props.items():
            poses.set_value(frame, self._visible(path, self._pose(path, bodies)))
        port = self._graph.get_source_pose_port(self._source)
        port.FixValue(self._graph.GetMyContextFromRoot(self._root), Value(poses))
        (picture,) = take(self._graph, self._root, [view])
        return picture

    def _add_frame(self, name: str) -> FrameId:
        return self._graph.RegisterFrame(self._source, GeometryFrame(name))

    def _add_shape(self, frame: FrameId, shape: Shape, X_FG: RigidTransform, colour: Rgba) -> None:
        number = self._graph.model_inspector().num_geometries()
        instance = GeometryInstance(X_FG, shape, f"shape_{number}")
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", colour)
        instance.set_perception_properties(properties)
        self._graph.RegisterGeometry(self._source, frame, instance)

    def _pose(self, path: str, bodies: dict[str, RigidTransform]) -> RigidTransform:
        """Pose of an object in the world: that of a body above it, and of the paths below that."""
        if path in bodies:
            return bodies[path]
        parent = path.rpartition("/")[0]
        X_WP = self._pose(parent, bodies) if parent else RigidTransform()
        return X_WP @ self._stage.poses.get(path, RigidTransform())

    def _visible(self, path: str, pose: RigidTransform) -> RigidTransform:
        """A pose in the world; far below the scene if the object or a path above it is hidden."""
        is_hidden = any(f"{path}/".startswith(f"{each}/") for each in self._stage.hidden)
        return _AWAY if is_hidden else pose


def _encode(path: Path, frames: Iterator[NDArray[np.uint8]], suffix: str) -> None:
    av = need("av")
    codec, pixels = _CODECS[suffix]
    with av.open(str(path), "w", format=suffix.removeprefix(".")) as container:
        stream = None
        for frame in frames:
            if stream is None:
                stream = container.add_stream(codec, rate=round(_RATE))
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt, stream.options = pixels, {"crf": "22", "b:v": "0"}
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]]) -> None:
    from PIL import Image

    first, *others = [
        Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE) for frame in frames
    ]
    duration = round(1e3 / _GIF_RATE)
    first.save(
        path, "GIF", save_all=True, append_images=others, duration=duration, loop=0, optimize=True
    )
