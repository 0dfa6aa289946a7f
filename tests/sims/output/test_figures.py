"""Figures as files."""

import re
import xml.etree.ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from parapod.sims.output.figures import FORMATS, Figure, Print, draw_bound, render, write_figures
from parapod.sims.output.figures import draw as draw_figure
from parapod.systems.core.errors import OutputError


def draw(canvas):
    axes = canvas.subplots()
    axes.plot([0.0, 1.0, 2.0], [0, 1, 0], label="roll")
    axes.set_ylabel("deg")
    axes.legend()


SVG = "{http://www.w3.org/2000/svg}"
TILT = Figure("tilt", "Tilt", "What is to be seen.", draw)
OTHER = Figure("other", "Other", "Nothing.", lambda canvas: canvas.text(0.5, 0.5, "nothing"))


def test_figures_are_written_as_svg_under_their_names(tmp_path):
    folder = tmp_path / "deep" / "figures"
    paths = write_figures(folder, [TILT, OTHER])
    assert paths == [folder / "tilt.svg", folder / "other.svg"]
    assert sorted(folder.iterdir()) == sorted(paths)
    for path in paths:
        root = xml.etree.ElementTree.parse(path).getroot()
        assert root.tag == f"{SVG}svg"


def test_text_in_a_figure_stays_text():
    text = render(TILT).decode()
    for word in ("roll", "deg"):
        assert re.search(rf">{re.escape(word)}<", text)


LONG = Figure("long", "Long", "A price of $5 < $6, & more. " * 20, draw)


def shown(svg):
    """Width and height [pt] and all text of an SVG file."""
    root = xml.etree.ElementTree.fromstring(svg)
    size = [float(root.get(name).removesuffix("pt")) for name in ("width", "height")]
    words = [" ".join(element.itertext()) for element in root.iter(f"{SVG}text")]
    return *size, " ".join(" ".join(words).split())


@pytest.mark.parametrize("figure", [TILT, LONG])
def test_a_figure_that_is_written_has_its_caption_below_the_drawing(figure, tmp_path):
    (path,) = write_figures(tmp_path, [figure])
    width, height, words = shown(path.read_bytes())
    alone = shown(render(figure))
    assert " ".join(f"{figure.title}. {figure.caption}".split()) in words
    assert figure.title not in alone[2]
    assert width == pytest.approx(72.0 * figure.size[0])
    assert alone[:2] == pytest.approx([72.0 * length for length in figure.size])
    assert height > alone[1] + 8.0  # a line of eight points at least


def test_the_caption_is_as_wide_as_the_drawing_and_all_in_the_file(tmp_path):
    (path,) = write_figures(tmp_path, [LONG], Print("png", has_caption=True))
    pixels = imread(path)[..., :3].min(axis=2)
    height, width = pixels.shape
    above = round(150 * LONG.size[1])
    assert width == round(150 * LONG.size[0])
    rows, columns = np.nonzero(pixels[above:] < 0.6)
    assert columns.min() > 5
    assert columns.max() < width - 5
    assert columns.max() - columns.min() > 0.7 * width
    assert 2 < rows.min() < 30
    assert rows.max() < height - above - 5


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_figure_is_the_same_file(suffix):
    assert render(TILT, Print(suffix)) == render(TILT, Print(suffix))
    assert render(TILT, Print(suffix)) != render(OTHER, Print(suffix))


@pytest.mark.parametrize(
    ("suffix", "start"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")]
)
def test_every_format_is_what_its_suffix_says(tmp_path, suffix, start):
    assert suffix in FORMATS
    (path,) = write_figures(tmp_path, [TILT], Print(suffix))
    assert path.name == f"tilt.{suffix}"
    assert path.read_bytes().startswith(start)


def test_a_figure_replaces_an_older_one(tmp_path):
    (path,) = write_figures(tmp_path, [TILT])
    write_figures(tmp_path, [Figure("tilt", "Tilt", "", OTHER.draw)])
    assert b"nothing" in path.read_bytes()
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_refused_by_name(tmp_path):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    for folder in (in_the_way, in_the_way / "figures"):
        with pytest.raises(OutputError, match="cannot make the folder") as refused:
            write_figures(folder, [TILT])
        assert str(folder) in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_file_that_cannot_be_written_is_refused_and_leaves_nothing(tmp_path):
    (tmp_path / "tilt.svg").mkdir()
    with pytest.raises(OutputError, match=r"tilt\.svg"):
        write_figures(tmp_path, [TILT])
    assert [path.name for path in tmp_path.iterdir()] == ["tilt.svg"]


def test_a_drawing_that_fails_leaves_nothing(tmp_path):
    def fail(canvas):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_figures(tmp_path, [Figure("tilt", "Tilt", "", fail)])
    assert list(tmp_path.iterdir()) == []


def test_a_figure_in_print_has_its_width_and_letters_of_their_size():
    alone, narrow = render(TILT), render(TILT, Print(width_mm=84.0))
    width, height, _ = shown(narrow)
    assert width == pytest.approx(84.0 / 25.4 * 72.0)
    assert height == pytest.approx(72.0 * TILT.size[1] * np.sqrt(84.0 / 25.4 / TILT.size[0]))
    sizes = [set(re.findall(rb"font-size: ([\d.]+)px", text)) for text in (alone, narrow)]
    assert sizes[0] == sizes[1]
    assert sizes[0]


def test_letters_in_a_pdf_are_a_font_that_publishers_take():
    content = render(TILT, Print("pdf"))
    assert b"/FontFile2" in content  # TrueType
    assert b"/Type3" not in content


def test_settings_of_ones_own_go_before_parapods(tmp_path):
    own = tmp_path / "thesis.mplstyle"
    own.write_text("font.size: 13\n")
    assert b"font-size: 13px" in render(TILT, Print(style=own))
    assert Print(style=own).settings()["axes.grid"] is True
    own.write_text("font.sise: 13\n")
    with pytest.raises(OutputError, match=r"cannot read the style .*thesis\.mplstyle"):
        render(TILT, Print(style=own))


def test_a_legend_that_is_wider_than_a_narrow_figure_gets_fewer_columns():
    def draw_wide(canvas):
        axes = canvas.subplots()
        for k in range(6):
            axes.plot([0.0, 1.0], [0.0, k], label=f"a curve with a long name, {k}")
        canvas.legend(loc="outside upper center", ncols=6)

    wide = Figure("wide", "Wide", "", draw_wide)
    _, _, words = shown(render(wide, Print(width_mm=84.0)))
    canvas = draw_figure(wide, Print(width_mm=84.0))
    canvas.draw_without_rendering()
    (legend,) = canvas.legends
    assert legend.get_window_extent().width <= canvas.bbox.width
    assert "long name, 5" in words


@pytest.mark.parametrize(
    ("errors", "bound", "sides", "words"),
    [
        ((-0.1, 0.05), 0.2, [-0.2, 0.2], []),
        ((0.0, 0.1), 0.2, [0.2], []),
        ((-0.1, 0.3), 0.2, [-0.2, 0.2], []),
        ((0.0, 0.001), 0.2, [], ["bound 0.2"]),
        ((0.0, 0.1), None, [], []),
    ],
)
def test_a_bound_is_drawn_where_it_is_near_and_written_where_it_is_far(
    errors, bound, sides, words
):
    def with_bound(canvas):
        axes = canvas.subplots()
        axes.plot([0.0, 1.0], errors)
        draw_bound(axes, bound)

    (axes,) = draw_figure(Figure("error", "Error", "Below its bound.", with_bound)).axes
    dashed = [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "--"]
    assert dashed == sides
    assert [text.get_text() for text in axes.texts] == words
    low, high = axes.get_ylim()
    assert all(low < side < high for side in sides)
