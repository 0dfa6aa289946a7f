"""The paper's schemes, drawn from the dimensions that everything else is computed with."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.style import COLOURS
from parapod.sims.output.figures import Figure
from parapod.systems.levelling_platform.geometry import LegGeometry, PlatformGeometry
from parapod.systems.levelling_platform.leg import diagonal_angle, foot_to_centre, swing_angle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_PLATFORM = PlatformGeometry()
_STROKE = (_PLATFORM.extension_min, _PLATFORM.extension_max)
_MIDDLE = 0.405  # middle of the stroke [m]
_BLUE, _ORANGE, _GREEN = COLOURS[:3]
_GREY = "0.65"


def _linkage(leg: LegGeometry, d: float) -> dict[str, NDArray[np.float64]]:
    """Joints of a leg in its plane, x inwards and z up from the hip [m]."""
    e_a, psi, z = np.array(leg.e_a), swing_angle(leg, d), diagonal_angle(leg, d)
    hip, top = np.zeros(2), leg.l_3 * e_a
    knee = leg.l_4 * np.array([math.cos(psi), math.sin(psi)])
    pivot = d * np.array([math.cos(z), math.sin(z)])
    elbow = pivot - (leg.l_6 + leg.l_3) * e_a
    foot = elbow - np.array([0.0, leg.l_7])
    return {"E": hip, "top": top, "M": knee, "K": pivot, "elbow": elbow, "D": foot}


def _draw_leg(
    axes: "Axes", joints: dict[str, NDArray[np.float64]], colour: str, width: float
) -> None:
    p = joints
    for names in (("E", "M"), ("top", "K"), ("E", "top"), ("K", "elbow", "D")):
        points = np.array([p[name] for name in names])
        axes.plot(1e3 * points[:, 0], 1e3 * points[:, 1], color=colour, lw=width, zorder=2)
    actuator = np.array([p["E"], p["K"]])
    axes.plot(
        1e3 * actuator[:, 0], 1e3 * actuator[:, 1], color=colour, lw=1.4 * width, ls="--", zorder=1
    )


def _label(axes: "Axes", text: str, at: Any, shift: tuple[float, float], **style: Any) -> None:
    x, y = 1e3 * np.asarray(at)
    axes.annotate(
        text, (x, y), shift, textcoords="offset points", ha="center", va="center", **style
    )


def _draw_one_leg(canvas: "Canvas") -> None:
    """Figs. 1c and 4."""
    axes, leg = canvas.subplots(), _PLATFORM.legs[0]
    for d in _STROKE:
        _draw_leg(axes, _linkage(leg, d), "0.8", 1.0)
    p = _linkage(leg, _MIDDLE)
    _draw_leg(axes, p, _BLUE, 2.0)
    for name in ("E", "top", "M", "K"):
        axes.plot(*(1e3 * p[name]), "o", color="white", mec=_BLUE, ms=5, zorder=3)
    for text, at, shift in (
        ("$P_E$", p["E"], (10, -8)),
        ("$P_D$", p["D"], (-14, 0)),
        ("$l_4$", (p["E"] + p["M"]) / 2, (0, -10)),
        ("$l_5$", (p["top"] + p["K"]) / 2, (0, 10)),
        ("$l_2$", (p["E"] + p["top"]) / 2, (10, 2)),
        ("$l_3$", (p["M"] + p["K"]) / 2, (-9, 3)),
        ("$l_6$", (p["M"] + p["elbow"]) / 2, (-9, 3)),
        ("$l_7$", (p["elbow"] + p["D"]) / 2, (-9, 0)),
        ("$d$", (p["E"] + p["K"]) / 2, (0, 8)),
    ):
        _label(axes, text, at, shift)
    _arc(axes, "$\\alpha$", 0.045, 0.0, leg.alpha)
    _arc(axes, "$\\gamma$", 0.03, leg.alpha, diagonal_angle(leg, _MIDDLE))
    _arc(axes, "$\\varphi$", 0.07, diagonal_angle(leg, _MIDDLE), math.pi)
    axes.plot([0, -150], [0, 0], color=_GREY, lw=0.8)
    axes.plot([0, 90], [0, 0], color=_GREY, lw=0.8)
    axes.set(xlabel="x of frame {D} [mm]", ylabel="z [mm]", aspect="equal")
    axes.set_xlim(-600, 130)


def _arc(axes: "Axes", text: str, radius: float, begin: float, end: float) -> None:
    angle = np.linspace(begin, end, 40)
    points = 1e3 * radius * np.array([np.cos(angle), np.sin(angle)])
    axes.plot(*points, color=_ORANGE, lw=1.0, zorder=4)
    middle = 0.5 * (begin + end)
    at = radius * np.array([math.cos(middle), math.sin(middle)])
    shift = (9.0 * math.cos(middle), 9.0 * math.sin(middle))
    _label(axes, text, at, shift, color=_ORANGE, fontsize=9)


def _draw_views(canvas: "Canvas") -> None:
    """Figs. 5, 7b and 17."""
    top, front = canvas.subplots(1, 2, width_ratios=(1, 1))
    _draw_top(top)
    leg = _PLATFORM.legs[0]
    z = foot_to_centre(leg, _MIDDLE)[2]
    for side in (-1.0, 1.0):
        # What is inwards in the leg's plane is seen at the angle beta.
        axis_seen = np.array([-side * math.cos(leg.beta), 1.0])
        hip = np.array([side * leg.l_x, -leg.l_z])
        joints = {name: hip + axis_seen * at for name, at in _linkage(leg, _MIDDLE).items()}
        _draw_leg(front, joints, _BLUE, 1.4)
        front.plot(*(1e3 * joints["D"]), "o", color=_ORANGE)
        _label(front, "$P_E$", hip, (-side * 10, -9))
        _label(front, "$P_D$", joints["D"], (-side * 14, 7))
    body = 1e3 * np.array([(-leg.l_x, -leg.l_z), (-leg.l_x, 0), (leg.l_x, 0), (leg.l_x, -leg.l_z)])
    front.fill(*body.T, fc="0.93", ec="0.3", zorder=0)
    front.plot(0, 0, "s", color="0.2")
    _label(front, "{F}", (0, 0), (0, 9))
    front.axhline(-1e3 * z, color=_GREY, lw=1.0)
    front.annotate("", (0, -1e3 * z), (0, 0), arrowprops={"arrowstyle": "<->", "color": "0.4"})
    _label(front, "$h$", (0, -0.6 * z), (9, 0))
    front.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", xlim=(-900, 900), ylim=(-600, 150))
    front.set_title("front, level, d = 405 mm", fontsize=9)


def _draw_top(axes: "Axes") -> None:
    corners = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)])
    box = corners * [1e3 * _PLATFORM.l_c1, 1e3 * _PLATFORM.l_c2]
    axes.plot(box[:, 0], box[:, 1], color="0.3")
    for i, leg in enumerate(_PLATFORM.legs, start=1):
        hip = -np.array([leg.l_x, leg.l_y])
        foot = -np.array(foot_to_centre(leg, _MIDDLE)[:2])
        axes.plot(*(1e3 * np.array([hip, foot]).T), color=_BLUE, lw=2.0)
        rolls = 0.07 * np.array(leg.e_b)
        ends = 1e3 * np.array([foot - rolls, foot + rolls])
        axes.annotate("", ends[0], ends[1], arrowprops={"arrowstyle": "<->", "color": _ORANGE})
        _label(axes, f"leg {i}", foot, (0, 16 if foot[1] > 0 else -16))
    axes.plot(0, 0, "s", color="0.2")
    _label(axes, "{F}", (0, 0), (-12, -9))
    for dx, dy, name in ((150, 0, "x"), (0, 150, "y")):
        axes.annotate("", (dx, dy), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.4"})
        _label(axes, name, (1.15e-3 * dx, 1.15e-3 * dy), (0, 0), color="0.4")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(-900, 900), ylim=(-760, 760))
    axes.set_title("top, and how the feet roll", fontsize=9)


def _draw_path(canvas: "Canvas") -> None:
    """Fig. 6."""
    path, parts = canvas.subplots(1, 2)
    leg, extension = _PLATFORM.legs[0], np.linspace(*_STROKE, 121)
    feet = np.array([_linkage(leg, d)["D"] for d in np.linspace(0.375, 0.5, 200)])
    couplers = np.array([_linkage(leg, d)["D"] for d in extension])
    path.plot(1e3 * feet[:, 0], 1e3 * feet[:, 1], color=_GREY, lw=1.0, label="375 to 500 mm")
    path.plot(
        1e3 * couplers[:, 0], 1e3 * couplers[:, 1], color=_BLUE, lw=2.5, label="390 to 420 mm"
    )
    path.plot(0, 0, "o", color=_ORANGE)
    _label(path, "$P_E$", (0, 0), (-14, 0))
    path.set(xlabel="x of $P_D$ from $P_E$ [mm]", ylabel="z [mm]", aspect="equal")
    path.legend(fontsize=8, loc="upper center")
    displacement = -1e3 * (couplers - couplers[0])
    parts.plot(1e3 * extension, displacement[:, 0], label="$p_x$")
    parts.plot(1e3 * extension, displacement[:, 1], label="$p_z$")
    parts.set(xlabel="extension d [mm]", ylabel="change since 390 mm [mm]")
    parts.legend(fontsize=8)


def _draw_actuator_loop(canvas: "Canvas") -> None:
    """Fig. 16."""
    axes = _plain(canvas, 10.0, 2.6)
    _box(axes, 1.0, 1.6, 0.7, "+ -")
    _box(axes, 3.6, 1.6, 2.6, "PI controller\n$(K_p + K_v s)/s$")
    _box(axes, 7.2, 1.6, 2.2, "actuator\n$K/s$")
    _arrow(axes, (-0.4, 1.6), (0.65, 1.6), "$d^*$")
    _arrow(axes, (1.35, 1.6), (2.3, 1.6), "$e$")
    _arrow(axes, (4.9, 1.6), (6.1, 1.6), "$V$")
    _arrow(axes, (8.3, 1.6), (9.9, 1.6), "$d$")
    _path(axes, [(9.1, 1.6), (9.1, 0.4), (1.0, 0.4), (1.0, 1.15)])
    _box(axes, 5.2, 0.4, 1.6, "encoder", 0.6)


def _draw_control_scheme(canvas: "Canvas") -> None:
    """Fig. 18, with the names of the systems."""
    axes = _plain(canvas, 15.5, 5.0)
    for x, y, width, text in (
        (2.0, 3.4, 2.4, "PostureReference"),
        (5.4, 3.4, 2.9, "KinematicFeedforward\nEq. (26)"),
        (8.8, 3.4, 2.5, "PassiveLegSolver\nEq. (31)"),
        (11.7, 3.4, 1.9, "PiController\nEq. (19)"),
        (14.2, 3.4, 1.8, "platform"),
        (9.4, 0.9, 2.5, "AttitudeEstimator"),
        (5.4, 0.9, 2.9, "GroundEstimator\nEqs. (10), (11)"),
    ):
        _box(axes, x, y, width, text)
    _arrow(axes, (-0.6, 3.4), (0.8, 3.4), "$\\phi^*, \\theta^*, h^*$")
    _arrow(axes, (3.2, 3.4), (3.95, 3.4))
    _arrow(axes, (6.85, 3.4), (7.55, 3.4), "$d_{1..3}^*$")
    _arrow(axes, (10.05, 3.4), (10.75, 3.4), "$d_{1..4}^*$")
    _arrow(axes, (12.65, 3.4), (13.3, 3.4), "$V$")
    _path(axes, [(14.6, 2.85), (14.6, 0.9), (10.65, 0.9)])
    axes.text(14.5, 0.55, "gyro, accelerometer", ha="right", va="top", fontsize=8)
    _path(axes, [(13.8, 2.85), (13.8, 2.1), (11.7, 2.1), (11.7, 2.85)])
    _path(axes, [(11.7, 2.1), (6.2, 2.1), (6.2, 1.45)])
    axes.text(12.7, 2.18, "encoders", ha="center", va="bottom", fontsize=8)
    _arrow(axes, (8.15, 0.9), (6.85, 0.9), "$\\phi, \\theta$")
    _path(axes, [(3.95, 0.9), (2.0, 0.9), (2.0, 2.85)])
    _path(axes, [(4.6, 1.45), (4.6, 2.85)])
    axes.text(3.0, 1.0, "$\\phi_0, \\theta_0$, feet", ha="center", va="bottom", fontsize=8)


def _plain(canvas: "Canvas", width: float, height: float) -> "Axes":
    axes = canvas.subplots()
    axes.set(xlim=(-0.8, width), ylim=(-0.2, height), aspect="equal")
    axes.axis("off")
    return axes


def _box(axes: "Axes", x: float, y: float, width: float, text: str, height: float = 1.1) -> None:
    from matplotlib.patches import FancyBboxPatch

    corner = (x - width / 2, y - height / 2)
    axes.add_patch(
        FancyBboxPatch(
            corner,
            width,
            height,
            "round,pad=0,rounding_size=0.12",
            fc="#eef4f9",
            ec=_BLUE,
            zorder=2,
        )
    )
    axes.text(x, y, text, ha="center", va="center", fontsize=8, zorder=3)


def _arrow(
    axes: "Axes", begin: tuple[float, float], end: tuple[float, float], text: str = ""
) -> None:
    _path(axes, [begin, end])
    middle = np.mean([begin, end], axis=0)
    axes.text(middle[0], middle[1] + 0.12, text, ha="center", va="bottom", fontsize=8)


def _path(axes: "Axes", points: list[tuple[float, float]]) -> None:
    """A line with an arrow at its end."""
    xs, ys = zip(*points[:-1], strict=True)
    axes.plot(xs, ys, color="0.3", lw=1.0, zorder=1)
    axes.annotate(
        "",
        points[-1],
        points[-2],
        arrowprops={"arrowstyle": "-|>", "color": "0.3", "shrinkA": 0, "shrinkB": 0},
        zorder=1,
    )


DRAWINGS = (
    Figure(
        "fig01c_04_leg",
        "A leg",
        "Four bars and the linear actuator (dashed) on their diagonal, at 405 mm; grey: at both "
        "ends of the stroke (Figs. 1c and 4).",
        _draw_one_leg,
        (6.0, 3.8),
    ),
    Figure(
        "fig05_07_17_views",
        "Legs on the platform",
        "Numbers of the legs, frames, and the directions in which the feet's rollers roll "
        "(Figs. 5, 7b and 17).",
        _draw_views,
        (9.0, 3.8),
    ),
    Figure(
        "fig06_path",
        "Path of the support point",
        "Left as seen from the hip; right its two parts over the stroke (Fig. 6).",
        _draw_path,
        (8.0, 3.4),
    ),
    Figure(
        "fig16_actuator_loop",
        "Control of an actuator",
        "PI control of the extension (Fig. 16).",
        _draw_actuator_loop,
        (6.5, 1.9),
    ),
    Figure(
        "fig18_control_scheme",
        "Control of the platform",
        "The same scheme with the names of the systems here; reference and ground estimate are "
        "part of the diagram (Fig. 18).",
        _draw_control_scheme,
        (9.0, 3.0),
    ),
)
