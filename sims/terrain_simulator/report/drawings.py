"""The paper's schemes, drawn from the dimensions that everything else is computed with."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.style import COLOURS
from parapod.sims.output.figures import Figure
from parapod.sims.terrain_simulator.workspace import BENCHES
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import slider_places

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

type Pose = tuple[float, float, float]

_PEDAL, _TREADMILL = (geometry for geometry, _ in BENCHES.values())


def _points(geometry: BenchGeometry, pose: Pose) -> Mapping[str, tuple[float, float]]:
    """Pivots and ends of the plate by their letters [mm]."""
    x, z, phi = pose
    c, s = math.cos(phi), math.sin(phi)

    def seen(point: tuple[float, float]) -> tuple[float, float]:
        return 1e3 * (x + c * point[0] + s * point[1]), 1e3 * (z - s * point[0] + c * point[1])

    sliders = slider_places(geometry, pose)
    return {
        "P": seen(geometry.p_OP),
        "T": seen(geometry.p_OT),
        "Q": seen((-0.5 * geometry.plate, 0.0)),
        "O'": seen((0.0, 0.0)),
        **{f"A_{k + 1}": (1e3 * float(a), 0.0) for k, a in enumerate(sliders)},
    }


def _draw_bench(axes: "Axes", geometry: BenchGeometry, pose: Pose, title: str) -> None:
    at = _points(geometry, pose)
    axes.plot(1e3 * np.array((geometry.slider_min, geometry.slider_max)), (0.0, 0.0), "0.7")
    for ends, colour in (("A_1 P", 0), ("A_2 P", 0), ("A_3 T", 1)):
        line = np.array([at[name] for name in ends.split()])
        axes.plot(line[:, 0], line[:, 1], color=COLOURS[colour], linewidth=2.0)
    body = np.array([at[name] for name in ("P", "Q", "T", "P")])
    axes.fill(body[:, 0], body[:, 1], color="0.85")
    axes.plot(body[:, 0], body[:, 1], color="0.4", linewidth=1.0)
    axes.plot(body[1:3, 0], body[1:3, 1], color="black", linewidth=3.0)
    for name, point in at.items():
        axes.plot(*point, "ks" if name.startswith("A") else "ko", markersize=4)
        below = name.startswith("A") or name == "P"
        axes.annotate(
            name if "'" in name else f"${name}$",
            point,
            (0, -13 if below else 6),
            textcoords="offset points",
            ha="center",
        )
    axes.set(title=title, aspect="equal", xlabel="x [mm]")
    axes.set_ylim(-75.0, 420.0)


def _draw_schemes(canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, 2, sharey=True)
    _draw_bench(panels[0], _PEDAL, (0.5, 0.30, 0.0), "pedal")
    _draw_bench(panels[1], _TREADMILL, (0.80, 0.27, 0.0), "treadmill")
    for axes, ends in zip(panels, ((250.0, 950.0), (250.0, 1150.0)), strict=True):
        axes.set_xlim(*ends)
    panels[0].set_ylabel("z [mm]")


def _draw_singular(canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, 2, sharey=True)
    _draw_bench(panels[0], _PEDAL, (0.5, _PEDAL.link - _PEDAL.p_OP[1], 0.0), "$a_1 = a_2$")
    _draw_bench(panels[1], _PEDAL, (0.5, 0.28, math.radians(65.46)), "P, T, $A_3$ in line")
    for axes in panels:
        axes.set_xlim(250.0, 950.0)
    panels[0].set_ylabel("z [mm]")


DRAWINGS = (
    Figure(
        "bench_schemes",
        "Pedal and treadmill",
        "Sliders on their rail, links to P, strut to T, and the plate Q T (Figs. 3 and 4).",
        _draw_schemes,
        (7.0, 3.4),
    ),
    Figure(
        "bench_singular",
        "Singular poses",
        "Left: nothing holds P along the rail; a stop keeps A_1 and A_2 apart. Right: the plate "
        "turns under the least load (Fig. 5).",
        _draw_singular,
        (7.0, 3.4),
    ),
)
