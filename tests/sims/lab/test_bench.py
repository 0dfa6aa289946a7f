"""Diagrams as Graphviz text and pictures."""

import shutil

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.sims.lab.bench import write_graphviz
from parapod.systems.core.errors import OutputError


@pytest.fixture
def diagram():
    builder = DiagramBuilder()
    builder.AddNamedSystem("bob", ConstantVectorSource([0.0]))
    return builder.Build()


@pytest.mark.parametrize("suffix", [".dot", ".gv", ".DOT"])
def test_a_diagram_is_written_as_graphviz_text(diagram, tmp_path, suffix):
    path = tmp_path / f"loop{suffix}"
    write_graphviz(path, diagram)
    assert path.read_text().startswith("digraph")
    assert "bob" in path.read_text()


def test_a_picture_of_a_diagram_needs_graphviz(diagram, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda program: None)
    with pytest.raises(OutputError, match=r"'dot' of Graphviz .*; a \.dot file needs nothing"):
        write_graphviz(tmp_path / "loop.svg", diagram)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_is_drawn_by_graphviz_and_its_complaint_is_told(diagram, tmp_path, monkeypatch):
    dot = tmp_path / "dot"
    draws = 'case "$1" in -Tsvg) cat > /dev/null; echo drawn;; *) echo no font >&2; false;; esac'
    dot.write_text(f"#!/bin/sh\n{draws}\n")
    dot.chmod(0o755)
    monkeypatch.setattr(shutil, "which", lambda program: str(dot))
    write_graphviz(tmp_path / "loop.svg", diagram)
    assert (tmp_path / "loop.svg").read_text() == "drawn\n"
    with pytest.raises(OutputError, match="dot: no font"):
        write_graphviz(tmp_path / "loop.png", diagram)
    assert not (tmp_path / "loop.png").exists()


def test_a_format_that_is_none_is_refused_with_those_that_are(diagram, tmp_path):
    with pytest.raises(OutputError, match=r"one of \.dot, \.gv, \.svg, \.png, \.pdf$"):
        write_graphviz(tmp_path / "loop.xyz", diagram)
