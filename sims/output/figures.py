"""Figures of experiments: drawn when somebody wants them, as SVG or PNG."""

import io
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.diagrams.style import style
from parapod.sims.output.atomic import atomic_output, check_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

FORMATS = ("svg", "png", "pdf")
# Size of a caption's letters [point], their mean width and the distance of lines by that size.
_CAPTION_SIZE, _LETTER, _LINE = 8.0, 0.58, 1.3
_POINTS = 72.0  # to an inch


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

    def _repr_svg_(self) -> str:
        """The drawing, for notebooks."""
        text = render(self).decode()
        return text[text.index("<svg") :]


def draw(figure: Figure) -> "Canvas":
    """The figure on a canvas of Matplotlib, in parapod's style."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context(style()):
        canvas = Canvas(figsize=figure.size, layout="constrained")
        figure.draw(canvas)
    return canvas


def render(figure: Figure, suffix: str = "svg", with_caption: bool = False) -> bytes:
    """The figure as a file's content.

    Args:
        figure: figure to draw.
        suffix: one of `FORMATS`.
        with_caption: whether title and caption are written below the drawing, for a file that
            stands alone.
    """
    from matplotlib import rc_context
    from matplotlib.transforms import Bbox

    canvas = draw(figure)
    below = _add_caption(canvas, figure) if with_caption else 0.0
    box = Bbox.from_extents(0.0, -below, *figure.size)
    buffer = io.BytesIO()
    # No date: the same figure gives the same file.
    metadata = {"Date": None} if suffix == "svg" else None
    with rc_context(style()):
        canvas.savefig(buffer, format=suffix, metadata=metadata, dpi=150, bbox_inches=box)
    return buffer.getvalue()


def _add_caption(canvas: "Canvas", figure: Figure) -> float:
    """Writes title and caption below the drawing; the height that they take [inch]."""
    width, height = figure.size
    size = _CAPTION_SIZE / _POINTS
    words = ". ".join(text for text in (figure.title, figure.caption) if text)
    lines = textwrap.wrap(words, int((width - 2.0 * size) / (_LETTER * size)))
    canvas.text(
        size / width,
        -0.5 * size / height,
        "\n".join(lines),
        verticalalignment="top",
        fontsize=_CAPTION_SIZE,
        linespacing=_LINE,
        color="0.25",
        parse_math=False,
    )
    return size * (1.0 + _LINE * len(lines))


def write_figures(folder: Path, figures: Sequence[Figure], suffix: str = "svg") -> list[Path]:
    """Writes each figure, with its caption, to `<folder>/<name>.<suffix>`; returns the files.

    Raises:
        OutputError: a file or the folder cannot be written.
    """
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        path = folder / f"{figure.name}.{suffix}"
        with atomic_output(path) as temporary:
            temporary.write_bytes(render(figure, suffix, with_caption=True))
        paths.append(path)
    return paths
