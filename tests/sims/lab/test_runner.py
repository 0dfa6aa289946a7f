"""Diagrams as Graphviz text and pictures."""

import sys

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams import block_diagram
from parapod.diagrams.block_diagram import BlockDiagram
from parapod.sims.lab.runner import write_graphviz
from parapod.systems.core.errors import OutputError


@pytest.fixture
def diagram():
    builder = DiagramBuilder()
    builder.AddNamedSystem("bob", ConstantVectorSource([0.0]))
    return builder.Build()


@pytest.mark.parametrize("suffix", [".dot", ".gv", ".DOT"])
def test_a_diagram_is_written_as_graphviz_text(diagram, tmp_path, suffix):
    path = tmp_path / f"loop{suffix}"
    write_graphviz(path, BlockDiagram(diagram))
    assert path.read_text().startswith("digraph")
    assert "bob" in path.read_text()


def test_a_picture_of_a_diagram_needs_pygraphviz(diagram, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    with pytest.raises(OutputError, match=r"parapod\[draw\].*; a \.dot file needs nothing"):
        write_graphviz(tmp_path / "loop.svg", BlockDiagram(diagram))
    assert list(tmp_path.iterdir()) == []


def test_a_complaint_of_graphviz_is_told_and_nothing_is_left(diagram, tmp_path, monkeypatch):
    pytest.importorskip("pygraphviz")
    monkeypatch.setattr(block_diagram, "_HEAD", "digraf {\n")
    with pytest.raises(OutputError, match=r"Graphviz: .*digraf"):
        write_graphviz(tmp_path / "loop.png", BlockDiagram(diagram))
    assert list(tmp_path.iterdir()) == []


def test_a_format_that_is_none_is_refused_with_those_that_are(diagram, tmp_path):
    with pytest.raises(OutputError, match=r"one of \.dot, \.gv, \.svg, \.png, \.pdf$"):
        write_graphviz(tmp_path / "loop.xyz", BlockDiagram(diagram))
