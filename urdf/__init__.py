"""The machines' models: URDF parts, and model directives that compose them."""

from importlib.resources import files
from pathlib import Path

from pydrake.multibody.parsing import Parser

MODELS_DIR = Path(str(files(__name__)))


def configure_parser(parser: Parser) -> None:
    """Lets a parser resolve `package://parapod/...` to the models of this package."""
    parser.package_map().AddPackageXml(str(MODELS_DIR / "package.xml"))
