"""`rtdenoise denoise` end to end, through the command line: output, resuming, and everything that can be wrong with
the input."""

import os
import shutil
import sys

import numpy as np
import pytest
import torch
from synthetic import TINY, make_frames, with_bad_pixels, write_sequence

import rtdenoise
from rtdenoise.cli import main
from rtdenoise.data.exr import read_channels, read_header
from rtdenoise.denoise import STATE, Options, denoise
from rtdenoise.models import TemporalKPN, save


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    save(TemporalKPN(TINY), path)
    return str(path)


@pytest.fixture
def shot(tmp_path):
    return write_sequence(tmp_path / "shot", make_frames())


def pixels(path):
    return np.stack(list(read_channels(path, ("R", "G", "B")).values()))


def refused(capsys, *arguments):
    """Run the command line, expect exit 2 and one line on stderr; returns the line."""
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("rtdenoise: ") and error.count("\n") == 1, error
    return error


def test_it_writes_what_step_returns(shot, tmp_path, model):
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--float32", "--signal", "indirect"])
    denoiser, history = rtdenoise.load(model), None
    for i, frame in enumerate(rtdenoise.open_sequence(shot, signal="indirect")):
        image, history = denoiser.step(frame, history)
        path = tmp_path / "out" / f"frame.{i:04d}.exr"
        assert np.array_equal(pixels(path), image[0].numpy())
        assert read_header(path).channels == {"R": "float", "G": "float", "B": "float"}


def test_layers_are_passed_on_when_asked_and_half_is_the_default(shot, tmp_path, model):
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--keep", "albedo", "depth"])
    header = read_header(tmp_path / "out" / "frame.0001.exr")
    assert set(header.channels) == {"R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "depth.Z"}
    assert header.channels["R"] == "half" and header.channels["depth.Z"] == "float"
    before, after = (read_channels(d / "frame.0001.exr", ["albedo.G"])["albedo.G"] for d in (shot, tmp_path / "out"))
    assert np.array_equal(before, after)


def test_an_interrupted_run_goes_on_to_the_same_result(shot, tmp_path, model):
    options = Options(model=model, float32=True)
    denoise(str(shot), tmp_path / "whole", options)

    class Stop(Exception):
        pass

    def stop_after_two(done, total):
        if done == 2:
            raise Stop

    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "halves", options, on_frame=stop_after_two)
    summary = denoise(str(shot), tmp_path / "halves", options)
    assert (summary.skipped, summary.written) == (2, 2)
    for i in range(4):
        name = f"frame.{i:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "whole" / name), pixels(tmp_path / "halves" / name)), name
    assert denoise(str(shot), tmp_path / "halves", options).written == 0


def test_gaps_reset_history(shot, tmp_path, model):
    (shot / "frame.0002.exr").unlink()
    denoise(str(shot), tmp_path / "out", Options(model=model, float32=True, allow_gaps=True))
    alone = rtdenoise.load(model).step(rtdenoise.open_sequence(shot / "frame.0003.exr")[0])[0]
    assert np.array_equal(pixels(tmp_path / "out" / "frame.0003.exr"), alone[0].numpy())


def test_bad_pixels_are_replaced_and_counted(tmp_path, model, capsys):
    frames = make_frames()
    frames[1] = with_bad_pixels(frames[1])
    write_sequence(tmp_path / "shot", frames)
    main(["denoise", str(tmp_path / "shot"), "--out", str(tmp_path / "out"), "--model", model])
    assert "replaced: radiance: NaN or Inf in 2 pixels" in capsys.readouterr().out
    for i in range(4):
        assert np.isfinite(pixels(tmp_path / "out" / f"frame.{i:04d}.exr")).all()


def test_preview_is_written(shot, tmp_path, model):
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--preview"])
    written = {path.suffix for path in (tmp_path / "out").glob("preview.*")}
    assert ".png" in written and written & {".gif", ".mp4"}


def test_the_input_is_not_touched(shot, tmp_path, model):
    before = {path: path.read_bytes() for path in shot.iterdir()}
    denoise(str(shot), tmp_path / "out", Options(model=model))
    assert {path: path.read_bytes() for path in shot.iterdir()} == before


def test_missing_layer(tmp_path, model, capsys):
    write_sequence(tmp_path / "shot", make_frames(), without=("albedo",))
    assert "albedo" in refused(capsys, "denoise", tmp_path / "shot", "--out", tmp_path / "out", "--model", model)


def test_missing_motion(tmp_path, model, capsys):
    write_sequence(tmp_path / "shot", make_frames(), without=("motion",))
    assert "motion" in refused(capsys, "denoise", tmp_path / "shot", "--out", tmp_path / "out", "--model", model)


def test_missing_frame(shot, tmp_path, model, capsys):
    (shot / "frame.0001.exr").unlink()
    assert "missing: 1" in refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", model)


def test_size_changes_in_mid_sequence(shot, tmp_path, model, capsys):
    write_sequence(shot, make_frames(3, H=16, W=16)[2:])
    assert "16×16" in refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", model)


def test_truncated_file(shot, tmp_path, model, capsys):
    path = shot / "frame.0002.exr"
    path.write_bytes(path.read_bytes()[:-200])
    assert "frame.0002.exr" in refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", model)


def test_file_that_is_no_exr(shot, tmp_path, model, capsys):
    (shot / "frame.0001.exr").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert "not an OpenEXR file" in refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", model)


def test_empty_and_absent_folders(tmp_path, model, capsys):
    (tmp_path / "empty").mkdir()
    assert "is empty" in refused(capsys, "denoise", tmp_path / "empty", "--out", tmp_path / "out", "--model", model)
    assert "does not exist" in refused(
        capsys, "denoise", tmp_path / "nowhere", "--out", tmp_path / "out", "--model", model
    )


def test_unknown_preset_signal_and_model(shot, tmp_path, capsys):
    common = ("denoise", shot, "--out", tmp_path / "out")
    assert "native" in refused(capsys, *common, "--preset", "nativ")
    assert "'glossy'" in refused(capsys, *common, "--signal", "glossy")
    assert "no model 'nosuch'" in refused(capsys, *common, "--model", "nosuch")


def test_unwritable_output(shot, tmp_path, model, capsys):
    (tmp_path / "file").write_text("in the way")
    assert "cannot write" in refused(capsys, "denoise", shot, "--out", tmp_path / "file" / "out", "--model", model)
    assert "holds the input" in refused(capsys, "denoise", shot, "--out", shot, "--model", model)


def test_other_peoples_files_and_other_options_are_not_overwritten(shot, tmp_path, model, capsys):
    out = tmp_path / "out"
    denoise(str(shot), out, Options(model=model))
    assert "other options" in refused(capsys, "denoise", shot, "--out", out, "--model", model, "--float32")
    (out / STATE).unlink()
    assert "--overwrite" in refused(capsys, "denoise", shot, "--out", out, "--model", model)
    main(["denoise", str(shot), "--out", str(out), "--model", model, "--overwrite"])


def test_damaged_state(shot, tmp_path, model, capsys):
    out = tmp_path / "out"
    denoise(str(shot), out, Options(model=model))
    (out / STATE).write_bytes(b"not safetensors at all")
    assert "not readable" in refused(capsys, "denoise", shot, "--out", out, "--model", model)


def test_disk_full_is_one_line(shot, tmp_path, model, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "replace", full)
    assert "No space left" in refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", model)
    assert not list((tmp_path / "out").glob("*.exr"))


def test_inspect_prints_the_layers(shot, capsys):
    main(["inspect", str(shot)])
    out = capsys.readouterr().out
    assert "albedo" in out and "native" in out and "motion" in out


def test_help_of_every_command(capsys):
    for command in ("denoise", "inspect", "demo", "render", "train"):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0
    assert shutil.which("rtdenoise", path=os.path.dirname(sys.executable)), (
        "the console script is installed beside Python"
    )


def test_a_mended_preset_is_another_run(shot, tmp_path, model, capsys):
    layers = {"color": "R G B", "albedo": "albedo.R albedo.G albedo.B", "normal": "normal.X normal.Y normal.Z",
              "depth": "depth.Z", "motion": "motion.X motion.Y"}  # fmt: skip
    text = "".join(f"[{layer}]\nchannels = {names.split()}\n" for layer, names in layers.items())
    preset = tmp_path / "mine.toml"
    preset.write_text(text)
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model, "--preset", preset)
    main([str(a) for a in command])
    preset.write_text(text + "signs = [-1, 1]\n")
    assert "other options" in refused(capsys, *command)


def test_unknown_device(shot, tmp_path, model, capsys):
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model, "--device", "gpu")
    assert "unknown device 'gpu'" in refused(capsys, *command)
