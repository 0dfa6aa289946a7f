"""Pages of Meshcat that stand alone: with a player, without what is for pages with a server."""

import re
from collections.abc import Iterable
from html import escape
from importlib.metadata import version
from pathlib import Path

from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.moment import moment

# The black bar above the tree of the scene, the message of a page without a server, and the
# statistics of frames. Meshcat has no option for them, and its own style comes after its scripts:
# until then all of them would be seen.
_HIDDEN = (
    "<style>body { margin: 0; } "
    ".dg.main, #status-message, #stats-plot { display: none !important; }</style>"
)
_TITLE = re.compile("<title>.*?</title>")


def bare_page(html: str) -> str:
    """Meshcat's page with nothing but the scene, for a page that frames and leads it.

    Args:
        html: page that `Meshcat.StaticHtml` gives.
    """
    return _TITLE.sub(lambda title: title[0] + _HIDDEN, html, count=1)


def scene_page(html: str, title: str = "", facts: Iterable[str] = ()) -> str:
    """Meshcat's page with a player below the scene, which is there if a recording is.

    Args:
        html: page that `Meshcat.StaticHtml` gives.
        title: title above the scene and of the page; empty: it has none.
        facts: origin of the scene, in a few words each, which stand below the title.
    """
    from jinja2 import Environment, PackageLoader  # for a page only: most programs write none

    loader = PackageLoader("parapod.sims.output", ".")
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = environment.get_template("scene_page.html.jinja")
    around = template.render(title=title, facts=list(facts))
    if title:
        named = f"<title>{escape(title)} - parapod</title>"
        html = _TITLE.sub(lambda _: named, html, count=1)
    before, end, after = bare_page(html).rpartition("</body>")
    return f"{before}{around}{end}{after}"


def write_page(
    path: Path,
    html: str,
    title: str,
    facts: Iterable[str] = (),
    written: float | None = None,
) -> None:
    """Writes a page of Meshcat under a title of its own.

    Args:
        path: the file.
        html: page that `Meshcat.StaticHtml` gives.
        title: title above the scene, in tabs and in bookmarks.
        facts: origin of the scene, in a few words each.
        written: time at which the scene was made, since 1970 [s]; None: now.

    Raises:
        OutputError: the file cannot be written.
    """
    facts = [*facts, f"parapod {version('parapod')}", moment(written)]
    with atomic_output(path) as temporary:
        temporary.write_text(scene_page(html, title, facts), encoding="utf-8")
