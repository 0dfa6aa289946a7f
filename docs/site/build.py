"""Build the site: `python docs/site/build.py [FOLDER]`, by default build/site.

The pages are those of docs/, the notebooks of examples/notebooks and the reference that follows
from the code; all are put together in FOLDER/source, of which Sphinx makes FOLDER/html. What it
makes needs no server and no network. A warning, such as a link that leads nowhere, is an error.
"""

import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

from reference import all_pages

from parapod.diagrams.block_diagram import render

_HERE = Path(__file__).parent
_DOCS, _ROOT = _HERE.parent, _HERE.parents[1]
# Examples that are packages.
_PACKAGES = [path.parent for path in sorted((_ROOT / "examples").glob("*/pyproject.toml"))]
_MERMAID = re.compile(r"```mermaid\n(.*?)```", re.DOTALL)
_STATES = """digraph {
nodesep=0.25; ranksep=0.45; bgcolor="white";
node [shape=box, style="rounded,filled", fillcolor="#DDEBF7", fontname="Helvetica", fontsize=11];
edge [fontname="Helvetica", fontsize=9, color="#44546A", arrowsize=0.7];
"""
# Lines about the notebooks' kernels, which are on this computer only.
_OF_KERNELS = re.compile(
    r"\[IPKernelApp\] WARNING \| Kernel is running over TCP|# .* traitlets |$"
)
_ARROW = re.compile(r"^\s*(\S+) --> (\S+?)(?:: (.*))?$", re.MULTILINE)


def assemble(source: Path) -> None:
    """Puts all pages into a folder, which is emptied first."""
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(_DOCS, source, ignore=shutil.ignore_patterns("site"))
    shutil.copytree(_HERE / "static", source / "static")
    shutil.copy(_HERE / "conf.py", source)
    notebooks = sorted((_ROOT / "examples" / "notebooks").glob("*.ipynb"))
    for notebook in notebooks:
        target = source / "tutorials" / notebook.name
        target.parent.mkdir(exist_ok=True)
        target.write_text(notebook.read_text().replace("](../../docs/", "](../"))
    listed = "\n".join(f"tutorials/{notebook.stem}" for notebook in notebooks)
    (source / "tutorials.md").write_text(
        f"# Tutorials\n\n```{{toctree}}\n:maxdepth: 1\n{listed}\n```\n"
    )
    for page in source.rglob("*.md"):
        page.write_text(_adapted(page))
    for name, content in all_pages():
        path = source / "reference" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    for package in _PACKAGES:
        _write_example(source, package)
    for folder in ("machines", "mechanisms"):
        shutil.copytree(_ROOT / "examples" / folder, source / "examples" / folder)


def _adapted(page: Path) -> str:
    """A page whose state diagrams are pictures, and whose links stay inside the site."""
    text = page.read_text().replace("](../examples/notebooks/README.md)", "](tutorials.md)")
    for package in _PACKAGES:
        link = rf"\]\(\.\./\.\./examples/{package.name}[^)]*\)"
        text = re.sub(link, f"](../{package.name}.md)", text)
    # Other examples are to be downloaded.
    text = text.replace("](../../examples/", "](../examples/")

    def drawn(match: re.Match[str]) -> str:
        name = f"images/{page.stem}_states.svg"
        (page.parent / name).write_bytes(render(_as_graphviz(match[1])))
        return f"![states and what leads from one to the next]({name})"

    return _MERMAID.sub(drawn, text)


def _as_graphviz(states: str) -> str:
    arrows = []
    for begin, end, when in _ARROW.findall(states):
        ends = ("start" if node == "[*]" else node for node in (begin, end))
        arrows.append(" -> ".join(ends) + f' [label="{textwrap.fill(when, 22)}"];')
    return _STATES + "\n".join(arrows) + "}"


def _write_example(source: Path, folder: Path) -> None:
    """A page with all files of a package of examples."""
    parts = [f"---\norphan: true\n---\n\n# The package {folder.name}"]
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".toml", ".yaml", ".urdf") and "egg-info" not in str(path):
            language = {".py": "python", ".urdf": "xml"}.get(path.suffix, path.suffix[1:])
            parts.append(
                f"## {path.relative_to(folder)}\n\n````{language}\n{path.read_text()}````"
            )
    (source / f"{folder.name}.md").write_text("\n\n".join(parts) + "\n")


def main() -> int:
    """Builds it; returns Sphinx's exit code."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else _ROOT / "build" / "site"
    assemble(folder / "source")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-j", "auto"]
    command += [str(folder / "source"), str(folder / "html")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as sphinx:
        assert sphinx.stderr is not None
        for line in sphinx.stderr:
            if not _OF_KERNELS.match(line):
                sys.stderr.write(line)
        code = sphinx.wait()
    # Pictures that pages hold as objects, of which Sphinx knows nothing.
    for picture in (folder / "source" / "reference").rglob("*.svg"):
        shutil.copy(picture, folder / "html" / picture.relative_to(folder / "source"))
    if code == 0:
        print(f"wrote {folder / 'html' / 'index.html'}")
    return code


if __name__ == "__main__":
    sys.exit(main())
