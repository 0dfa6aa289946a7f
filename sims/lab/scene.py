"""Scenes of Meshcat in a notebook or a page, which need no server and no network."""

import warnings
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from pydrake.geometry import Meshcat

from parapod.sims.output.scene_page import scene_page, write_page


@dataclass(frozen=True)
class Scene:
    """A page that stands alone: the content of a Meshcat, with its recording.

    It displays itself in a notebook. The page goes on playing when the program has ended; it can
    be turned with the mouse.

    Attributes:
        html: the page as Meshcat gives it.
        height: height in a notebook [pixel].
    """

    html: str = field(repr=False)
    height: int = 420

    @classmethod
    def from_meshcat(cls, meshcat: Meshcat, height: int = 420) -> "Scene":
        """The scene as it is now; a recording that has been begun ends, and is in it.

        Args:
            meshcat: the scene; `meshcat.StartRecording()` before a simulation records that.
            height: height in a notebook [pixel].
        """
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return cls(meshcat.StaticHtml(), height)

    @classmethod
    def of(cls, meshcat: Meshcat, height: int = 420) -> "Scene":
        """Former name of `from_meshcat`."""
        warnings.warn("Scene.of is now Scene.from_meshcat", DeprecationWarning, stacklevel=2)
        return cls.from_meshcat(meshcat, height)

    def write(self, path: Path | str, title: str = "Scene") -> None:
        """Writes the page to a file.

        Raises:
            OutputError: the file cannot be written.
        """
        write_page(Path(path), self.html, title)

    def _repr_html_(self) -> str:
        page = escape(scene_page(self.html))
        return (
            f'<iframe srcdoc="{page}" width="100%" height="{self.height}" '
            'style="border: 1px solid #ccc" title="scene"></iframe>'
        )
