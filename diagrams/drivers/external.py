"""Drivers that are not parapod's own: from installed packages and from files."""

import importlib
import importlib.util
import os
import sys
from pathlib import Path

from parapod.diagrams.drivers.driver import Driver
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.installed import installed
from parapod.systems.core.quoting import quoted_path

GROUP = "parapod.drivers"


def load_installed_drivers() -> tuple[str, ...]:
    """Import the modules that installed packages name under the entry point `parapod.drivers`.

    A package that cannot be imported, or whose driver has the name of another one, leaves the
    others usable. A scenario that names one of its drivers is refused with the reason.

    Returns:
        A sentence for each package that cannot be imported and each name that is taken twice.
    """
    problems = []
    for entry in installed(GROUP):
        try:
            entry.load()
        except (Exception, SystemExit) as error:  # nor may a program that is named by mistake end
            package = entry.dist.name if entry.dist is not None else entry.module
            what = f"the drivers '{entry.name}' of the package '{package}'"
            problems.append(str(_failed(what, error)))
    Driver.not_imported = tuple(problems)
    return (*problems, *Driver.clashes())


def load_drivers(path: Path) -> None:
    """Import a Python file that defines drivers, by its name.

    Its folder comes last on the path: other modules in it replace no installed ones.

    Raises:
        ScenarioError: it is not there, has the name of another module, cannot be imported, or
            defines a driver whose name another one has.
    """
    if not os.path.isfile(path) or path.suffix != ".py":
        raise ScenarioError(f"drivers {quoted_path(path)}: there is no such Python file")
    # By name and through the path, so that processes that are started from here find it too.
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    spec = importlib.util.find_spec(path.stem)
    origin = spec.origin if spec is not None else None
    if origin is None or not os.path.isfile(origin) or not os.path.samefile(origin, path):
        raise ScenarioError(
            f"drivers {quoted_path(path)}: there is another module of that name, "
            f"{quoted_path(Path(str(origin)))}; rename the file"
        )
    before = Driver.clashes()
    try:
        importlib.import_module(path.stem)
    except Exception as error:
        raise _failed(f"the drivers {quoted_path(path)}", error) from error
    for clash in Driver.clashes():
        if clash not in before:
            raise ScenarioError(f"drivers {quoted_path(path)}: {clash}")


def _failed(what: str, error: BaseException) -> ScenarioError:
    return ScenarioError(f"{what} cannot be imported: {type(error).__name__}: {error}")
