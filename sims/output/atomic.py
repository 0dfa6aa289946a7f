"""Files that a run leaves behind: complete or not there at all."""

import json
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path


def check_writable(path: Path) -> None:
    """Refuses a path that could not be written, before a long run is spent on it.

    Raises:
        OutputError: the folder is missing, there is no permission, or something is in the way.
    """
    # Functions of os.path, because those of pathlib raise where a folder may not be searched.
    target = os.path.realpath(path) if os.path.islink(path) else os.fspath(path)
    folder = os.path.dirname(target) or "."
    if os.path.isdir(target):
        raise _cannot_write(path, "it is a directory")
    if os.path.isfile(folder):
        raise _cannot_write(path, f"{quoted_path(folder)} is not a directory")
    try:
        os.stat(target)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from None
    if os.path.exists(target) and not os.path.isfile(target):
        raise _cannot_write(path, "it is not a regular file")
    if not os.path.isdir(folder):
        raise _cannot_write(path, f"the folder {quoted_path(folder)} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _cannot_write(path, f"no permission to write in {quoted_path(folder)}")
    if os.path.exists(target) and not os.access(target, os.W_OK):
        raise _cannot_write(path, "no permission to replace it")
    try:
        _probe(folder)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from None


def check_folder(path: Path) -> None:
    """Refuses a folder that could not be made or written in, before a long run is spent on it.

    Raises:
        OutputError: there is no permission, or something is in the way.
    """
    # The folder itself, or the one in which the missing ones would be made.
    there = os.path.realpath(path)
    while not os.path.lexists(there) and there != os.path.dirname(there):
        there = os.path.dirname(there)
    if os.path.islink(path) and not os.path.exists(path):
        raise _cannot_make(path, "it is a link to nothing")
    if not os.path.isdir(there):
        raise _cannot_make(path, f"{quoted_path(there)} is not a directory")
    if not os.access(there, os.W_OK | os.X_OK):
        raise _cannot_make(path, f"no permission to write in {quoted_path(there)}")
    try:
        with suppress(FileNotFoundError):
            os.stat(path)  # a name may be too long
        _probe(there)
    except OSError as error:
        raise _cannot_make(path, error.strerror or str(error)) from None


def _probe(folder: str) -> None:
    """Writes a file there: what permissions promise, some file systems do not keep."""
    probe = os.path.join(folder, f".parapod-{secrets.token_hex(6)}")
    with open(probe, "xb"):
        pass
    os.unlink(probe)


@contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """A temporary path beside the target, which takes the target's place on success.

    After an exception, Ctrl-C included, the target is as it was and nothing else is left.

    Raises:
        OutputError: the target cannot be written, or nothing was written to the temporary path.
    """
    check_writable(path)
    # Through symbolic links, so that the link stays and the file that it names is replaced.
    target = Path(os.path.realpath(path))
    # The suffix stays last because writers choose a format by it. mkstemp would make the file
    # unreadable to others; a name of our own leaves the permissions to the user's umask.
    temporary = target.with_name(f".parapod-{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        if not temporary.exists():
            raise _cannot_write(path, "nothing was written")
        os.replace(temporary, target)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Writes a JSON document.

    Raises:
        OutputError: the file cannot be written.
        ValueError: a number is not finite, which JSON cannot say; use None.
    """
    text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_output(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _cannot_write(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot write {quoted_path(path)}: {reason}", path)


def _cannot_make(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot make the folder {quoted_path(path)}: {reason}", path)
