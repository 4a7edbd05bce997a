"""Files are complete or absent, locks exclude, links are not followed, and unreadable files are refused in one line."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from rtdenoise import files
from rtdenoise.errors import InputError


def message(function, *args) -> str:
    with pytest.raises(InputError) as caught:
        function(*args)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "kept").write_text("kept")
    (tmp_path / "a").symlink_to(tmp_path / "kept")
    files.write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_text() == "new" and not (tmp_path / "a").is_symlink()
    assert (tmp_path / "kept").read_text() == "kept"


def test_nothing_is_left_where_writing_fails(tmp_path):
    (tmp_path / "folder").mkdir()
    assert "folder: cannot be written: Is a directory" in message(files.write_atomically, tmp_path / "folder", b"")
    with pytest.raises(KeyError), files.replacing(tmp_path / "a") as temporary:
        temporary.write_bytes(b"half")
        raise KeyError
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_an_error_names_the_file_that_was_to_be(tmp_path):
    """Never the fresh file, and never none, as Pillow's on a full disk; that of another file stays."""
    for raised, named in (((errno.ENOSPC, "full"), tmp_path / "a"), ((errno.ENOENT, "no", "other"), "other")):
        with pytest.raises(OSError) as caught, files.replacing(tmp_path / "a"):
            raise OSError(*raised)
        assert caught.value.filename == str(named)
    with pytest.raises(OSError) as caught, files.replacing(tmp_path / "none" / "a") as temporary:
        temporary.write_bytes(b"")
    assert caught.value.filename == str(tmp_path / "none" / "a")


def test_a_name_of_the_longest_length_is_written(tmp_path):
    files.write_atomically(tmp_path / ("x" * 255), b"1")
    assert (tmp_path / ("x" * 255)).read_bytes() == b"1"


def test_only_our_own_unfinished_files_are_removed(tmp_path):
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    here, elsewhere = files._machine(), "01234567"
    ours = [f".rtdenoise-{number}-{here}89abcdef.tmp" for number in (os.getpid(), int(ended.stdout), 10**30)]
    running = [f".rtdenoise-{os.getppid()}-{here}89abcdef.tmp", f".rtdenoise-1-{elsewhere}89abcdef.tmp"]
    old = [f".rtdenoise-1-{elsewhere}{k}9abcdef.tmp" for k in range(2)]  # of machines that have long finished
    others = [".other.tmp", ".a.exr.123.tmp", ".rtdenoise-1.tmp", ".rtdenoise-state.safetensors", *running]
    (tmp_path / "inside").mkdir()
    ours.append(f"inside/{ours[0]}")
    for name in (*ours, *others, *old):
        (tmp_path / name).touch()
    for name in (*old, *others):
        os.utime(tmp_path / name, (0, 0) if name not in running else None)
    with files.replacing(tmp_path / "a") as temporary:
        assert files.UNFINISHED.fullmatch(temporary.name)[2] == here
        temporary.touch()
    files.remove_unfinished(tmp_path)
    assert any((tmp_path / "inside").iterdir())
    files.remove_unfinished(tmp_path, inside=True)
    assert {path.name for path in tmp_path.iterdir()} == {*others, "a", "inside"}
    assert not any((tmp_path / "inside").iterdir())


def test_one_lock_at_a_time(tmp_path):
    with files.lock(tmp_path), files.lock(tmp_path, "another"):
        assert message(files.lock(tmp_path).__enter__) == (
            f"{tmp_path}: another run is writing there; wait for it, or choose another --out"
        )
    with files.lock(tmp_path):
        pass


def test_a_lock_is_no_link_and_no_pipe(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    os.mkfifo(tmp_path / "pipe")
    assert "link: cannot be opened: Too many levels" in message(files.lock(tmp_path, "link").__enter__)
    assert "pipe: not a regular file; remove it" in message(files.lock(tmp_path, "pipe").__enter__)
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (os.mkfifo, "cannot be read: not a regular file"),
        (os.mkdir, "cannot be read: Is a directory"),
        (lambda path: path.symlink_to("/dev/zero"), "cannot be read: not a regular file"),
        (lambda path: None, "cannot be read: No such file or directory"),
        (lambda path: path.write_bytes(b"\xff"), "cannot be read: not a text file"),
        (lambda path: path.write_text("{"), "not valid JSON: Expecting property name enclosed in double quotes: line"),
        (lambda path: path.write_text("[NaN]"), "not valid JSON: NaN is not a JSON number"),
        (lambda path: path.write_text("[" * 100_000), "not valid JSON: nested too deeply"),
        (lambda path: path.write_text("9" * 10_000), "not valid JSON: "),
    ],
)
def test_what_is_not_json(tmp_path, make, expected):
    path = tmp_path / "a.json"
    make(path)
    assert message(files.read_json, path).startswith(f"{path}: {expected}")


def test_numbers_that_json_lacks_are_written_as_null():
    assert files.dumps({"a": [float("nan"), 1.23456, 2]}, 3) == '{"a": [null, 1.23, 2]}'
