"""Folders where results go: of this machine, or shared between machines by what pyarrow's file systems reach."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Protocol

from impact_envs.errors import InputError
from impact_envs.file import write_atomically


class Folder(Protocol):
    """Files by their names, with / between folders."""

    def read(self, name: str) -> bytes | None:
        """Return a file's content, None if there is none."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file, all or nothing."""

    def list(self, below: str) -> list[str]:
        """Return the sorted names of all files in a folder and its folders."""


def is_uri(folder: str | Path) -> bool:
    """Return whether a folder is named by a URI, such as ``s3://bucket/runs``."""
    return re.match(r"[a-z][a-z0-9+.-]+:/", str(folder)) is not None


def write_uri(folder: str | Path) -> str:
    """Return a folder's URI as the user wrote it: a Path has lost one slash of the two."""
    return re.sub(r"^([a-z][a-z0-9+.-]+):/+", lambda m: f"{m[1]}://{'/' if m[1] == 'file' else ''}", str(folder))


def open_folder(folder: str | Path) -> Folder:
    """Return a folder of this machine, or one behind a URI.

    Args:
        folder: path or URI.

    Raises:
        InputError: pyarrow reaches no such place.
    """
    return SharedFolder(write_uri(folder)) if is_uri(folder) else LocalFolder(Path(folder))


class LocalFolder:
    """A folder of this machine, or one that all machines have mounted at the same place.

    Args:
        path: made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __str__(self) -> str:
        """Return the path."""
        return str(self.path)

    def read(self, name: str) -> bytes | None:
        """Return a file's content, None if there is none."""
        path = self.path / name
        try:
            return path.read_bytes() if path.exists() else None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None

    def write(self, name: str, data: bytes) -> None:
        """Write a file, all or nothing."""
        write_atomically(self.path / name, data)

    def list(self, below: str) -> list[str]:
        """Return the sorted names of all files in a folder and its folders, partial files left out."""
        files = (self.path / below).rglob("*")
        return sorted(
            file.relative_to(self.path).as_posix()
            for file in files
            if file.is_file() and not any(part.startswith(".") for part in file.relative_to(self.path).parts)
        )


class SharedFolder:
    """A folder behind a URI.

    Args:
        uri: as pyarrow.fs.FileSystem.from_uri takes it.

    Raises:
        InputError: there is no such file system, or it cannot be reached.
    """

    def __init__(self, uri: str) -> None:
        from pyarrow import ArrowException, fs  # imported here: local folders need no pyarrow

        self._uri, self._fs, self._faults = uri, fs, (OSError, ArrowException)
        try:
            self._system, path = fs.FileSystem.from_uri(uri)
        except self._faults as error:
            raise InputError(f"{uri}: cannot be reached: {_first_line(error)}") from None
        self._path = path.rstrip("/")
        self._local = LocalFolder(Path(self._path)) if isinstance(self._system, fs.LocalFileSystem) else None

    def __str__(self) -> str:
        """Return the URI."""
        return self._uri

    def read(self, name: str) -> bytes | None:
        """Return a file's content, None if there is none."""
        path = f"{self._path}/{name}"
        try:
            if self._system.get_file_info(path).type != self._fs.FileType.File:
                return None
            with self._system.open_input_stream(path) as stream:
                data: bytes = stream.read()
                return data
        except self._faults as error:
            raise InputError(f"{self._uri}/{name}: cannot be read: {_first_line(error)}") from None

    def write(self, name: str, data: bytes) -> None:
        """Write a file, all or nothing: object stores show one when it is closed, folders when it is renamed."""
        if self._local is not None:
            self._local.write(name, data)
            return
        path = f"{self._path}/{name}"
        try:
            self._system.create_dir(path.rpartition("/")[0], recursive=True)
            with self._system.open_output_stream(path) as stream:
                stream.write(data)
        except self._faults as error:
            raise InputError(f"{self._uri}/{name}: cannot be written: {_first_line(error)}") from None

    def list(self, below: str) -> list[str]:
        """Return the sorted names of all files in a folder and its folders."""
        selector = self._fs.FileSelector(f"{self._path}/{below}".rstrip("/"), allow_not_found=True, recursive=True)
        try:
            found: Any = self._system.get_file_info(selector)
        except self._faults as error:
            raise InputError(f"{self._uri}/{below}: cannot be listed: {_first_line(error)}") from None
        names = (info.path[len(self._path) + 1 :] for info in found if info.type == self._fs.FileType.File)
        return sorted(name for name in names if not any(part.startswith(".") for part in name.split("/")))


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
