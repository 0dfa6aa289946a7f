"""Pictures of the reach of a rod on a turntable: its sag, a section, and a scene to be turned."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.geometry import Meshcat, Rgba

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.sims.lab.runner import make_viewer
from parapod.sims.levelling_platform.solid import draw_machine, draw_patch
from parapod.sims.output.figures import Figure
from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.carried_arm import CarriedArm
from parapod.systems.levelling_platform.tip_columns import TipColumns, largest_swing

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Steps of attitudes, angles of the sag's map in each direction and its levels, and columns.
_STEPS, _MAP, _LEVELS, _COLUMNS = 6, 91, 14, 161
# Inner end of the rim that is drawn larger, by the largest radius, and room below it, by the
# height of the arm's joint [-].
_RIM, _BELOW = 0.84, 0.1
_COLOURS = {
    "all postures": "#F6D3B8",
    "height of the level platform": "#9FB8CE",
    "all postures, turntable locked": "#D98F6B",
}
# Directions that the scene shows, the others being left open [deg], columns in each direction.
_SHOWN, _AROUND = (-15.0, 235.0), 37
# Places of camera and of what it looks at, by the machine's size [m], and look of the ends.
_CAMERA, _TARGET = (1.4, -6.6, 3.2), (0.0, 0.0, 1.2)
_END = Rgba(0.96, 0.83, 0.72, 0.5)


def figures(carried: CarriedArm) -> Iterator[Figure]:
    """Figures of the reach; that of the sag if the rod bends.

    Args:
        carried: platform and arm.
    """
    if carried.rod is not None:
        yield Figure(
            "arm_sag",
            "Sag of the arm's tip",
            "How far the tip is from where a rigid rod has it: from above, round the turntable's "
            "angle, from the middle the arm's lean up to "
            f"{math.degrees(largest_swing(carried)):.0f} deg; and on the level platform.",
            partial(_draw_sag, carried),
            (9.0, 4.9),
        )
    lines = "" if carried.rod is None else " Lines are outlines for a rigid rod."
    yield Figure(
        "arm_reach",
        "Reach of the arm's tip",
        f"Vertical section across the platform, through the arm's joint; its rim larger.{lines}",
        partial(_draw_section, carried),
        (9.4, 4.8),
    )


def draw(machine: PlatformDesign, carried: CarriedArm) -> Meshcat:
    """The platform in the middle of its stroke in the tip's reach, which is cut open.

    A surface with the colours of the sag is what the level platform reaches at that height;
    translucent ones are the ends of all postures' reach.

    Args:
        machine: the platform.
        carried: platform and arm.
    """
    from matplotlib import colormaps

    meshcat = make_viewer(*((machine.size * np.array(p)).tolist() for p in (_CAMERA, _TARGET)))
    draw_machine(meshcat, machine, 0.0)
    columns = TipColumns(carried, _STEPS // 2)
    azimuth = np.radians(np.linspace(*_SHOWN, _AROUND))[:, np.newaxis]
    swings = np.linspace(0.0, largest_swing(carried), _AROUND)
    joints = np.stack(np.broadcast_arrays(azimuth, swings), axis=-1)
    tips = carried.tip_position((0.0, 0.0, columns.height), joints)
    deflection = carried.deflection((0.0, 0.0, columns.height), joints)
    sags = np.linalg.norm(deflection, axis=-1)
    colours = colormaps["viridis"](sags / max(1e-9, float(sags.max())))[..., :3]
    draw_patch(meshcat, "/reach/sag", tips, colours)
    r = columns.radius(azimuth) * np.sin(np.linspace(0.0, 0.5 * math.pi, _AROUND))
    places = columns.joint[:2] + np.stack([r * np.cos(azimuth), r * np.sin(azimuth)], axis=-1)
    ends = columns.intervals(places.reshape(-1, 2))
    for side, where in enumerate(("above", "below")):
        for end, z in zip(("lowest", "highest"), ends[..., side], strict=True):
            points = np.dstack([places, z.reshape(places.shape[:-1])])
            draw_patch(meshcat, f"/reach/{end} {where}", points, _END)
    return meshcat


def _draw_sag(carried: CarriedArm, canvas: "Canvas") -> None:
    pitch = float(TipColumns(carried, 1).attitudes[:, 1].max())
    turns = np.linspace(0.0, 2.0 * math.pi, _MAP)
    leans = np.linspace(0.0, largest_swing(carried), _MAP)
    turn, lean = np.meshgrid(turns, leans)
    posture, joints = (0.0, pitch, carried.postures[0, 2]), np.stack([turn, lean], axis=-1)
    sags = 1e3 * np.linalg.norm(carried.deflection(posture, joints), axis=-1)
    above: Any = canvas.add_subplot(1, 2, 1, projection="polar")
    levels = np.linspace(0.0, float(sags.max()), _LEVELS)
    colours = above.contourf(turn, np.degrees(lean), sags, levels, cmap="viridis")
    lines = above.contour(turn, np.degrees(lean), sags, levels[3::3], colors="white")
    above.clabel(lines, fmt="%.0f mm", fontsize=8)
    above.set_title(f"platform pitched by {math.degrees(pitch):.1f} deg")
    above.set_rticks([])
    canvas.colorbar(colours, ax=above, label="sag of the tip [mm]", format="%.0f", shrink=0.8)
    curves = canvas.add_subplot(1, 2, 2)
    outwards, _, upwards = 1e3 * carried.deflection(carried.postures[0], joints[:, 0]).T
    distance = np.hypot(outwards, upwards)
    for name, values in (("distance", distance), ("down", -upwards), ("outwards", outwards)):
        curves.plot(np.degrees(leans), values, label=name)
    curves.set(
        xlabel="lean of the arm [deg]", ylabel="sag of the tip [mm]", title="level platform"
    )
    curves.legend()


def _draw_section(carried: CarriedArm, canvas: "Canvas") -> None:
    from matplotlib.patches import Patch

    whole, rim = canvas.subplots(1, 2, width_ratios=(2.0, 1.0))
    joint, largest, bottom = TipColumns(carried, 0).joint, 0.0, math.inf
    for colour, columns in zip(_COLOURS.values(), _families(carried), strict=True):
        for y, low, high in _section(columns):
            largest, bottom = max(largest, float(y.max())), min(bottom, float(low.min()))
            for axes in (whole, rim):
                axes.fill_between(y, low, high, color=colour, linewidth=0.0)
    if carried.rod is not None:
        for columns in _families(replace(carried, rod=None)):
            for y, low, high in _section(columns):
                around = np.concatenate([y, y[::-1], y[:1]])
                ends = np.concatenate([low, high[::-1], low[:1]])
                for axes in (whole, rim):
                    axes.plot(around, ends, color="black", linewidth=0.8)
    whole.set_aspect("equal")
    rim.set_xlim(_RIM * largest, 1.01 * largest)
    rim.set_ylim(bottom - _BELOW * joint[2], 2.0 * joint[2] - bottom)
    for axes in (whole, rim):
        axes.set(xlabel="y [m]", ylabel="z [m]")
    handles = [Patch(color=colour, label=name) for name, colour in _COLOURS.items()]
    canvas.legend(handles=handles, loc="outside upper center", ncols=3)


def _families(carried: CarriedArm) -> tuple[TipColumns, ...]:
    """Columns by all postures, by the level platform, and without the turntable."""
    return (
        TipColumns(carried, _STEPS),
        TipColumns(carried, 0),
        TipColumns(carried, _STEPS, is_locked=True),
    )


def _section(columns: TipColumns) -> Iterator[tuple[Array, Array, Array]]:
    """Parts of a section across the platform: places y, lowest and highest z (n) there [m].

    Above and below the joint, and on both sides of what the tip does not reach.
    """
    x, middle = columns.joint[:2]
    left, right = columns.radius((-0.5 * math.pi, 0.5 * math.pi))
    sines = np.sin(np.linspace(-0.5 * math.pi, 0.5 * math.pi, _COLUMNS))
    y = middle + np.where(sines < 0.0, left, right) * sines
    ends = columns.intervals(np.column_stack([np.full_like(y, x), y]))
    for low, high in np.moveaxis(ends, -1, 0):
        rows = np.flatnonzero(np.isfinite(low))
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if part.size:
                yield y[part], low[part], high[part]
