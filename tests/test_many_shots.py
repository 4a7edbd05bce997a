"""`rtdenoise denoise` with several shots: each by a process, into a folder of its own, resumable."""

import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from synthetic import make_frames, write_sequence

from rtdenoise.cli.denoise import Denoise, _try, find_shots
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels
from rtdenoise.errors import InputError, NotFused
from rtdenoise.run.denoise import Options, denoise


def test_shots_go_on_where_one_fails_and_where_they_stopped(tmp_path, capsys):
    for name, count in (("a", 2), ("b", 3)):
        write_sequence(tmp_path / "shots" / name, make_frames(count))
    (tmp_path / "shots" / "empty").mkdir()
    command = ["denoise", str(tmp_path / "shots" / "*"), "--out", str(tmp_path / "out"), "--model", "fast"]
    denoise(str(tmp_path / "shots" / "a"), tmp_path / "out" / "a", Options(model="fast"))
    with pytest.raises(SystemExit) as stop:
        main([*command, "--workers", "1"])
    said = capsys.readouterr()
    assert stop.value.code == 2
    assert "1 of 3 shots failed, as told above" in said.err
    assert "a: 0 frames written, 2 were there" in said.out and "b: 3 frames written" in said.out
    assert "empty: failed:" in said.out and "no .exr file in this folder" in said.out
    alone = tmp_path / "alone"
    denoise(str(tmp_path / "shots" / "b"), alone, Options(model="fast"))
    for path in alone.glob("*.exr"):
        found, expected = (read_channels(file, "RGB") for file in (tmp_path / "out" / "b" / path.name, path))
        for name in "RGB":  # another number of threads sums in another order, and half floats round
            assert np.allclose(found[name], expected[name], rtol=2**-9, atol=1e-4)


def test_a_shot_whose_preview_cannot_be_written_stops_no_other(tmp_path, capsys):
    for name in ("a", "b"):
        write_sequence(tmp_path / "shots" / name, make_frames(2))
        (tmp_path / "out" / name / "preview.png").mkdir(parents=True)
    with pytest.raises(SystemExit):
        main(["denoise", str(tmp_path / "shots" / "*"), "--out", str(tmp_path / "out"), "--model", "fast",
              "--workers", "1", "--preview"])  # fmt: skip
    said = capsys.readouterr()
    assert said.out.count("failed:") == said.out.count("Is a directory") == 2
    assert said.err.strip().endswith("2 of 2 shots failed, as told above")


def test_a_shot_that_lacks_memory_stops_no_other(tmp_path, monkeypatch):
    def lacks(*arguments):
        raise MemoryError("Unable to allocate 64 GiB")

    monkeypatch.setattr("rtdenoise.run.denoise.denoise", lacks)
    found = _try(Denoise(("shot",), out=tmp_path), "shot", tmp_path)
    assert isinstance(found, InputError) and str(found) == "out of memory (Unable to allocate 64 GiB)"


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (RuntimeError("CUDA out of memory. Tried to allocate 64 GiB"), r"out of memory \(CUDA out of memory"),
        (NotFused("no fused op here"), "no fused op here"),
        (OSError(28, "No space left on device"), "a file: No space left on device"),
    ],
)
def test_what_a_user_can_cause_stops_no_other_shot(tmp_path, monkeypatch, error, told):
    monkeypatch.setattr("rtdenoise.run.denoise.denoise", Mock(side_effect=error))
    found = _try(Denoise(("shot",), out=tmp_path), "shot", tmp_path)
    assert isinstance(found, InputError) and re.match(told, str(found))


def test_a_fault_of_the_program_is_no_line(tmp_path, monkeypatch):
    monkeypatch.setattr("rtdenoise.run.denoise.denoise", Mock(side_effect=RuntimeError("shapes differ")))
    with pytest.raises(RuntimeError, match="shapes differ"):
        _try(Denoise(("shot",), out=tmp_path), "shot", tmp_path)


def test_names_of_shots(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("shots/a/beauty", "shots/b/beauty", "shots/clean"):
        (tmp_path / folder).mkdir(parents=True)
    out = tmp_path / "shots" / "clean"
    assert find_shots(("shots/a",), out) is None
    assert find_shots(("shots/a/*.exr",), out) is None  # a glob of files
    assert find_shots(("shots/*",), out) == {"a": "shots/a", "b": "shots/b"}  # without the output
    (out / "b").mkdir()
    both = {"a/beauty": "shots/a/beauty", "b/beauty": "shots/b/beauty"}
    assert find_shots(("shots/*/*",), out) == both  # without what is in the output
    assert find_shots(("shots/*/beauty",), Path()) == find_shots(("shots/*/beauty",), Path("shots")) == both
    assert find_shots(("shots/[a]",), out) == {"a": "shots/a"}  # one shot today, more tomorrow
    assert find_shots(("shots/*/beauty",), out) == find_shots(("shots/a/beauty", "shots/b/beauty"), out) == both
    assert find_shots(("shots/a/*.exr", "shots/b"), out) == {"a": "shots/a/*.exr", "b": "shots/b"}
    globs = {"a": "shots/a/frame.000[1-4].exr", "b": "shots/b/frame.*.exr"}
    assert find_shots(tuple(globs.values()), out) == globs
    views = {"L": "shots/a/*_L.exr", "R": "shots/a/*_R.exr"}
    assert find_shots(tuple(views.values()), out) == views
    with pytest.raises(InputError, match="is named twice"):
        find_shots(("shots/a", "shots/a/"), out)
    with pytest.raises(InputError, match="no sequence: name a folder"):
        find_shots((), out)


def test_frames_that_a_shell_put_for_a_glob_are_no_shots(tmp_path, capsys):
    """`denoise shot/*.exr`, without quotes: history would be lost, and nothing be said of it."""
    for name in ("a/frame.0001.exr", "a/frame.0002.exr", "b/frame.0001.exr", "a/still.exr"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    frames = [str(path) for path in sorted((tmp_path / "a").glob("frame.*.exr"))]
    with pytest.raises(SystemExit):
        main(["denoise", *frames, "--out", str(tmp_path / "out")])
    told = capsys.readouterr().err
    assert "frame.0001.exr and frame.0002.exr: frames of one shot" in told and "or put the glob in quotes" in told
    assert not (tmp_path / "out").exists()
    for others in ((frames[0], str(tmp_path / "b" / "frame.0001.exr")), (frames[0], str(tmp_path / "a" / "still.exr"))):
        assert list(find_shots(others, tmp_path / "out").values()) == list(others)
    for others in (("shots/010", "shots/020"), ("scene0012.zip", "scene0013.zip")):  # one file holds a sequence
        assert list(find_shots(others, tmp_path / "out").values()) == list(others)


@pytest.mark.parametrize("command", [["denoise", "still.exr"], ["combine", "still.exr", "clean.exr"]])
def test_out_that_is_called_like_a_picture(tmp_path, capsys, command):
    with pytest.raises(SystemExit):
        main([*command, "--out", str(tmp_path / "new.exr")])
    assert "--out: expected a folder, in which a file has its name in the input" in capsys.readouterr().err
    assert not (tmp_path / "new.exr").exists()


@pytest.mark.parametrize("command", ["inspect {}", "inspect --signal color {}", "combine {} --out out"])
def test_other_commands_ask_for_quotes_too(command, tmp_path, capsys):
    frames = sorted(map(str, write_sequence(tmp_path, make_frames(3)).glob("*.exr")))
    with pytest.raises(SystemExit, match="2"):
        main(command.format(" ".join(frames)).split())
    told = capsys.readouterr().err
    assert "put the glob in quotes, or name the folder, " in told and told.count("\n") == 1


def test_more_workers_than_cores_have_a_thread_each(tmp_path, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    place = Denoise((), tmp_path, workers=5)._place(shots=8)
    assert (place.count, place.threads) == (5, 1)


def test_programs_are_told_how_many_shots_are_done(tmp_path, capfd):
    for name in ("a", "b"):
        write_sequence(tmp_path / name, make_frames(1))
    main(["denoise", str(tmp_path / "*"), "--out", str(tmp_path / "out"), "--model", "fast", "--progress", "lines"])
    assert [line for line in capfd.readouterr().out.splitlines() if "/2" in line] == ["1/2", "2/2"]


def test_workers_for_one_sequence_are_told(tmp_path, capsys):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    for workers in ([], ["--workers", "3"]):
        main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", *workers])
        assert ("--workers: shares out shots, and a sequence is one" in capsys.readouterr().out) == bool(workers)


def test_workers_below_one(capsys):
    with pytest.raises(SystemExit):
        main(["denoise", "shot", "--out", "out", "--workers", "0"])
    assert "--workers: expected 1 or more, got 0" in capsys.readouterr().err
