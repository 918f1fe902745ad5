"""Files made for a user: names that stay in their folder, and content that is whole or absent."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from impact_envs.errors import InputError

_PLAIN = re.compile(r"[a-z0-9]+([-_][a-z0-9]+)*")
_RESERVED = re.compile(r"con|prn|aux|nul|(com|lpt)[0-9]")  # names of devices on Windows, with any suffix
LONGEST_PLAIN, KEPT = 150, 60  # characters of a name without its suffix; file systems take 255 bytes


def make_file_name(*words: object, suffix: str) -> str:
    """Return a file name made from a user's words: in no other folder, and of no other words.

    Plain words (lower case letters and digits, joined by single - or _) are kept: ``corridor__all__expert__7.json``.
    From others comes what is plain of them, a ``~`` and a digest of the exact words: upper case too, because some file
    systems do not tell it from lower case.

    Args:
        words: parts of the name, in order.
        suffix: with its dot.
    """
    texts = [str(word) for word in words]
    name = "__".join(texts)
    plain = all(_PLAIN.fullmatch(text) for text in texts) and len(name) <= LONGEST_PLAIN
    if plain and not _RESERVED.fullmatch(name):
        return name + suffix
    kept = re.sub(r"[^A-Za-z0-9]+", "_", name)[:KEPT].strip("_")
    digest = hashlib.sha256(json.dumps(texts).encode()).hexdigest()[:16]
    return f"{kept}~{digest}{suffix}"


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Write a file so that a reader sees the old content or the new content, never a part.

    Args:
        path: file to write; its folder is made if missing. What is no regular file, such as /dev/stdout, is written
            directly; a link stays a link.

    Yields:
        Where to write: a file of the same suffix in the same folder. It becomes the file at the end, and is removed if
        anything fails.

    Raises:
        InputError: the file cannot be written.
    """
    final = Path(path)
    try:
        if final.exists() and not final.is_file():
            yield final
            return
        final = Path(os.path.realpath(final))
        final.parent.mkdir(parents=True, exist_ok=True)
        # A short name: the longest name that is allowed must not become too long.
        partial = final.with_name(f".partial-{secrets.token_hex(6)}{final.suffix if len(final.suffix) < 20 else ''}")
        try:
            yield partial
            partial.replace(final)
        finally:
            with suppress(OSError):
                partial.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {_first_line(error)}") from None


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write the whole content of a file, all or nothing; see replace_file.

    Args:
        path: file to write; its folder is made if missing.
        data: the whole content.

    Raises:
        InputError: the file cannot be written.
    """
    with replace_file(path) as partial:
        partial.write_bytes(data)


def write_table(path: str | Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write a table, all or nothing: CSV, or Parquet where the path ends so.

    Args:
        path: file to write.
        columns: name to values, as many in each; in CSV floats keep all their digits, and NaN is an empty cell.

    Raises:
        InputError: the file cannot be written.
    """
    plain = {name: getattr(values, "tolist", lambda values=values: list(values))() for name, values in columns.items()}
    if Path(path).suffix.lower() == ".parquet":
        import pyarrow
        from pyarrow import parquet

        with replace_file(path) as partial:
            parquet.write_table(pyarrow.table(plain), partial)
        return
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(plain)
    for row in zip(*plain.values(), strict=True):
        writer.writerow("" if value != value else value for value in row)
    write_atomically(path, text.getvalue().encode())


def _first_line(error: OSError) -> str:
    return error.strerror or next(iter(str(error).splitlines()), "") or type(error).__name__
