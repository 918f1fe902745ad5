"""One writer at a time in a folder: a lock that ends with the process that holds it, however it ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from impact_envs.errors import InputError

NAME = ".lock"


@contextmanager
def lock_folder(folder: str | Path) -> Iterator[None]:
    """Keep other evaluations and trainings out of a folder.

    Args:
        folder: made if missing. Its file ``.lock`` stays, for only the operating system's lock on it counts; but a
            folder made here goes again where what was to be written in it fails before anything is.

    Raises:
        InputError: another process, or another call in this one, writes there; or the folder cannot be written.
    """
    path = Path(folder) / NAME
    is_new = not path.parent.exists()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        try:
            _lock(file)
        except OSError:
            holder = os.pread(file, 20, 1).decode(errors="replace") if hasattr(os, "pread") else ""
            process = f" (process {holder})" if holder.isdigit() else ""
            raise InputError(
                f"{folder}: another evaluation or training{process} writes here; wait for it or choose another folder"
            ) from None
        with suppress(OSError):  # a full disk; the lock holds without the number
            # The first byte is what Windows locks; the number behind it can be read meanwhile.
            os.ftruncate(file, 0)
            os.write(file, f" {os.getpid()}".encode())
        yield
    except BaseException:
        if is_new and os.listdir(path.parent) == [NAME]:
            path.unlink()
            path.parent.rmdir()
        raise
    finally:
        os.close(file)


def _lock(file: int) -> None:
    """Lock the first byte of an open file, or raise OSError if it is locked."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
