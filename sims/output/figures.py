"""Figures of experiments: drawn on demand, as SVG or PNG."""

import io
import logging
import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.diagrams.style import BOUND, style
from parapod.sims.output.atomic import atomic_output, check_folder
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import printable, quoted_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas
    from matplotlib.legend import Legend
    from numpy.typing import ArrayLike

FORMATS = ("svg", "png", "pdf")
# Size of a caption's letters [point], their mean width and the distance of lines by that size.
_CAPTION_SIZE, _LETTER, _LINE = 8.0, 0.58, 1.3
_POINTS, _MM = 72.0, 25.4  # to an inch
# A bound up to this many times as large as the curves is drawn, a larger one is written.
_NEAR = 4.0


def draw_bound(axes: "Axes", bound: float | None, of: str = "bound") -> None:
    """Draw a bound of errors, on both sides of zero if they have signs; one far off is written.

    Args:
        axes: axes of the errors, whose curves are drawn already.
        bound: largest admissible size, in the axes' unit; None draws nothing.
        of: name of the bound.
    """
    if bound is None:
        return
    low, high = axes.get_ylim()
    if bound > _NEAR * max(-low, high):
        place: dict[str, Any] = {
            "transform": axes.transAxes,
            "ha": "right",
            "va": "bottom",
            "fontsize": "small",
        }
        axes.text(1.0, 1.01, f"{of} {bound:g}", color=BOUND["color"], **place)
        return
    values: Any = (line.get_ydata() for line in axes.lines)
    is_signed = any(value < 0.0 for curve in values for value in curve)
    margin = 1.05 * bound
    axes.set_ylim(min(low, -margin) if is_signed else low, max(high, margin))
    for side in (-bound, bound) if is_signed else (bound,):
        axes.axhline(side, **BOUND)


def shade(axes: "Axes", time: "ArrayLike", flags: "ArrayLike", **look: Any) -> None:
    """Shades the times at which flags are up, behind the curves.

    Args:
        axes: axes over time.
        time: (n) times of the samples, in the axes' unit.
        flags: (n) flags.
        look: look of the shades, as Matplotlib's `axvspan` has it.
    """
    import numpy as np

    from parapod.diagrams.recording import spans

    times = np.asarray(time)
    for begin, end in spans(flags):
        axes.axvspan(times[begin], times[min(end, len(times) - 1)], zorder=0, **look)


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


@dataclass(frozen=True)
class Print:
    """Format of a figure in a file.

    Attributes:
        suffix: one of `FORMATS`.
        has_caption: true if title and caption are written below the drawing, for a file that
            stands alone.
        width_mm: width of the drawing; None: the figure's own. Letters keep their size, and the
            height follows with the root of the width, so that a narrow drawing stays readable.
        style: file with settings of Matplotlib that go before parapod's (`.mplstyle`), or None.
    """

    suffix: str = "svg"
    has_caption: bool = False
    width_mm: float | None = None
    style: Path | None = None

    @property
    def dpi(self) -> float:
        """Pixels an inch: of print where the width is given, else of a page in a browser."""
        return 150.0 if self.width_mm is None else 300.0

    def size_of(self, figure: Figure) -> tuple[float, float]:
        """Width and height of a figure's drawing [inch]."""
        width, height = figure.size
        if self.width_mm is None:
            return width, height
        scale = self.width_mm / _MM / width
        return scale * width, math.sqrt(scale) * height

    def settings(self) -> dict[Any, Any]:
        """Settings of Matplotlib.

        Raises:
            OutputError: the file of settings cannot be read, or has an unknown setting.
        """
        if self.style is None:
            return style()
        from matplotlib import rc_params_from_file

        # Matplotlib only logs a setting that it does not know.
        complaints: list[str] = []
        log = logging.getLogger("matplotlib")

        def keep(record: logging.LogRecord) -> bool:
            complaints.append(record.getMessage())
            return False

        log.addFilter(keep)
        try:
            if not self.style.is_file():
                raise OSError("no such file")
            own = rc_params_from_file(self.style, fail_on_error=True, use_default_template=False)
            if complaints:
                raise ValueError(complaints[0])
        except (OSError, ValueError) as error:
            reason = printable(error)
            raise OutputError(
                f"cannot read the style {quoted_path(self.style)}: {reason}", self.style
            ) from None
        finally:
            log.removeFilter(keep)
        return {**style(), **own}


def draw(figure: Figure, form: Print = Print()) -> "Canvas":
    """The figure on a canvas of Matplotlib, in parapod's style or in one's own."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context(form.settings()):
        canvas = Canvas(figsize=form.size_of(figure), layout="constrained")
        if form.width_mm is not None:
            canvas.legend = partial(_fitting_legend, canvas, canvas.legend)  # type: ignore[method-assign]
        figure.draw(canvas)
    return canvas


def _fitting_legend(
    canvas: "Canvas", add: Callable[..., "Legend"], *items: Any, ncols: int = 1, **options: Any
) -> "Legend":
    """Adds a legend with as many columns, up to those that are asked for, as fit the canvas."""
    for columns in range(ncols, 1, -1):
        legend = add(*items, ncols=columns, **options)
        if legend.get_window_extent().width <= canvas.bbox.width:
            return legend
        legend.remove()
    return add(*items, ncols=1, **options)


def render(figure: Figure, form: Print = Print()) -> bytes:
    """The figure as a file's content.

    Raises:
        OutputError: the file of settings cannot be read.
    """
    from matplotlib import rc_context
    from matplotlib.transforms import Bbox

    canvas = draw(figure, form)
    size = form.size_of(figure)
    below = _add_caption(canvas, figure, size) if form.has_caption else 0.0
    box = Bbox.from_extents(0.0, -below, *size)
    buffer = io.BytesIO()
    # No date: the same figure gives the same file.
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form.suffix)
    with rc_context(form.settings()):
        canvas.savefig(
            buffer, format=form.suffix, metadata=metadata, dpi=form.dpi, bbox_inches=box
        )
    return buffer.getvalue()


def _add_caption(canvas: "Canvas", figure: Figure, inches: tuple[float, float]) -> float:
    """Writes title and caption below the drawing; the height that they take [inch]."""
    width, height = inches
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


def write_figures(
    folder: Path,
    figures: Sequence[Figure],
    form: Print = Print(has_caption=True),
) -> list[Path]:
    """Writes each figure to `<folder>/<name>.<suffix>`; returns the files.

    Raises:
        OutputError: a file or the folder cannot be written.
    """
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        path = folder / f"{figure.name}.{form.suffix}"
        with atomic_output(path) as temporary:
            temporary.write_bytes(render(figure, form))
        paths.append(path)
    return paths
