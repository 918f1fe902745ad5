"""Files made for a user: names stay in their folder and apart; content is whole or absent."""

from __future__ import annotations

import errno
from itertools import product
from pathlib import Path

import pytest

from impact_envs import InputError
from impact_envs.file import make_file_name, replace_file, write_atomically

WORDS = (
    "corridor", "Corridor", "a", "a_", "_a", "a__b", "b", "a-b", "a b", "a/b", "a\\b", "../../x", "/x", "..", ".", "",
    "\0", "\n", "con", "NUL", "com1", "é", "e\u0301", "\ud800", "x" * 300, "x" * 299, "~", "a.b", "a:b", "*", " ",
)  # fmt: skip


def test_names_stay_in_their_folder_and_apart() -> None:
    cases = [(word,) for word in WORDS] + list(product(WORDS, repeat=2))
    names = [make_file_name(*case, suffix=".json") for case in cases]
    assert len({name.lower() for name in names}) == len(cases)
    for name in names:
        assert name == Path(name).name and name.isascii() and name.isprintable() and len(name) <= 200
        assert not set(name) & set('<>:"/\\|?*') and name[0] != "."
        assert name.split(".")[0].lower() not in ("con", "nul", "com1")


def test_plain_names_stay_as_they_are() -> None:
    assert (
        make_file_name("throw_and_catch", "all", "expert", 7, suffix=".json") == "throw_and_catch__all__expert__7.json"
    )


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_what_was_there(tmp_path: Path, failure: BaseException) -> None:
    path = tmp_path / "x.csv"
    path.write_text("old")

    def fail() -> None:
        with replace_file(path) as partial:
            assert partial.suffix == ".csv"
            partial.write_text("ne")
            raise failure

    with pytest.raises(InputError if isinstance(failure, OSError) else KeyboardInterrupt):
        fail()
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


def test_links_and_devices_stay(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_atomically(tmp_path / "link", b"content")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "file").read_bytes() == b"content"
    with pytest.raises(InputError, match="/dev/full: cannot be written: No space left on device"):
        write_atomically("/dev/full", b"content")
    assert not Path("/dev/full").is_file()
    longest = tmp_path / ("x" * 255)
    write_atomically(longest, b"content")
    assert longest.read_bytes() == b"content"
