"""Clear the notebooks of this folder of what running them leaves; `python clear.py`."""

import json
from pathlib import Path
from typing import Any

_METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def cleared(notebook: dict[str, Any]) -> str:
    """Text of a notebook without outputs, counts and traces of a computer.

    Args:
        notebook: its content, in the format 4.5.
    """
    cells = [dict(cell, metadata={}) for cell in notebook["cells"]]
    for cell in cells:
        if cell["cell_type"] == "code":
            cell |= {"execution_count": None, "outputs": []}
    plain = notebook | {"cells": cells, "metadata": _METADATA}
    return json.dumps(plain, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


if __name__ == "__main__":
    for path in sorted(Path(__file__).parent.glob("*.ipynb")):
        path.write_text(cleared(json.loads(path.read_text())))
