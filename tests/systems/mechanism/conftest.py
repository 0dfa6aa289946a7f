"""Models of mechanisms that tests read, and the closed form of one."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

MODELS = Path(__file__).parent / "models"
EXAMPLES = Path(__file__).parents[3] / "examples"
MECHANISMS = EXAMPLES / "mechanisms"


def example_module(path: str) -> ModuleType:
    """A module of an example that is not installed."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, EXAMPLES / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
