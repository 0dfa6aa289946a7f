"""Figures of experiments: drawn when somebody wants them, as SVG or PNG."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.sims.lab.files import atomic_output, check_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Colours that stay apart in print and for the colour-blind (Okabe and Ito), in order of use.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
FORMATS = ("svg", "png", "pdf")
_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "parapod",  # the same figure gives the same file
}


@dataclass(frozen=True)
class Figure:
    """Something to be drawn.

    Attributes:
        name: stem of its file.
        title: a few words.
        caption: a sentence or two on what is to be seen, and which figure of a paper it is.
        draw: draws on an empty Matplotlib figure.
        size: width and height [inch].
    """

    name: str
    title: str
    caption: str
    draw: Callable[["Canvas"], None]
    size: tuple[float, float] = (7.0, 3.2)


def render(figure: Figure, suffix: str = "svg") -> bytes:
    """The figure as a file's content.

    Args:
        figure: what to draw.
        suffix: one of `FORMATS`.
    """
    from cycler import cycler
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context({**_STYLE, "axes.prop_cycle": cycler(color=COLOURS)}):
        canvas = Canvas(figsize=figure.size, layout="constrained")
        figure.draw(canvas)
        buffer = io.BytesIO()
        # No date: the same figure gives the same file.
        metadata = {"Date": None} if suffix == "svg" else None
        canvas.savefig(buffer, format=suffix, metadata=metadata, dpi=150)
    return buffer.getvalue()


def write_figures(folder: Path, figures: Sequence[Figure], suffix: str = "svg") -> list[Path]:
    """Writes each figure to `<folder>/<name>.<suffix>`; returns the files.

    Raises:
        OutputError: a file or the folder cannot be written.
    """
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        path = folder / f"{figure.name}.{suffix}"
        with atomic_output(path) as temporary:
            temporary.write_bytes(render(figure, suffix))
        paths.append(path)
    return paths
