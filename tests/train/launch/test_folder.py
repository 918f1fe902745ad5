"""Folders of this machine and behind URIs hold the same files by the same names."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_envs import InputError
from train.launch.folder import LocalFolder, SharedFolder, is_uri, open_folder, write_uri


@pytest.mark.parametrize(
    ("text", "uri"),
    [
        ("s3://bucket/runs", "s3://bucket/runs"),
        (str(Path("s3://bucket/runs")), "s3://bucket/runs"),
        (str(Path("file:///tmp/x")), "file:///tmp/x"),
    ],
)
def test_a_uri_survives_being_read_as_a_path(text: str, uri: str) -> None:
    assert is_uri(text)
    assert write_uri(text) == uri


@pytest.mark.parametrize("text", ["runs/a", "/tmp/x", "C:/runs", "a:b"])
def test_a_path_is_no_uri(text: str) -> None:
    assert not is_uri(text)
    assert isinstance(open_folder(text), LocalFolder)


@pytest.mark.parametrize("shared", [False, True])
def test_what_was_written_is_listed_and_read(shared: bool, tmp_path: Path) -> None:
    folder = open_folder(tmp_path.as_uri() if shared else tmp_path)
    assert isinstance(folder, SharedFolder) == shared
    assert folder.list("rows") == []
    folder.write("rows/b", b"2")
    folder.write("rows/a/c", b"1")
    folder.write("rows/b", b"3")
    (tmp_path / "rows" / ".partial-1").touch()
    assert folder.list("rows") == ["rows/a/c", "rows/b"]
    assert folder.read("rows/b") == b"3"
    assert folder.read("rows") is None if shared else True
    assert folder.read("none") is None


def test_a_place_that_is_not_there_is_one_line() -> None:
    with pytest.raises(InputError, match="gopher://x/y: cannot be reached") as caught:
        open_folder("gopher://x/y")
    assert "\n" not in str(caught.value)


def test_an_object_store_is_written_without_renaming(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = SharedFolder(tmp_path.as_uri())
    monkeypatch.setattr(folder, "_local", None)
    folder.write("rows/a", b"1")
    assert folder.read("rows/a") == b"1"
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match="taken/a: cannot be written"):
        folder.write("taken/a", b"1")
