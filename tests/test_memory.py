"""Too little memory ends in one line, whatever runs out of it first. `make fuzz` tries more limits."""

import resource

import pytest
from attack_memory import attack
from synthetic import make_frames, write_sequence

from rtdenoise.cli import commands
from rtdenoise.cli.main import main


@pytest.mark.parametrize("megabytes, H, W", [(400, 24, 32), (1000, 1500, 2000)])
def test_little_address_space_is_one_line(megabytes, H, W, tmp_path):
    """400 MB: the libraries do not load. 1000 MB: the frame does not fit."""
    shot = write_sequence(tmp_path / "shot", make_frames(1, H, W))
    found = attack(megabytes, shot, tmp_path / "out")
    assert found["code"] == 2 and found["held"] and "out of memory" in found["line"], found


@pytest.mark.parametrize(
    "said", ["libtorch_cpu.so: failed to map segment from shared object", "x.so: cannot allocate memory"]
)
def test_a_library_that_does_not_fit_is_one_line(said, monkeypatch, capsys):
    def parse(arguments):
        raise ImportError(said)

    monkeypatch.setattr(commands, "parse", parse)
    with pytest.raises(SystemExit, match="2"):
        main(["inspect", "x"])
    assert capsys.readouterr().err.startswith(f"rtdenoise: out of memory ({said})")


def test_a_limit_below_what_libraries_need_is_told_before_they_load(monkeypatch, capsys):
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (123_000_000, -1))
    with pytest.raises(SystemExit, match="2"):
        main(["inspect", "x"])
    assert "limited to 123 MB (ulimit -v), it needs at least 700 MB" in capsys.readouterr().err
