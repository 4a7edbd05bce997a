"""`rtdenoise denoise` end to end, through the command line: output, resuming, and everything that can be wrong with
the input."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from synthetic import Stop, assert_goes_on, make_frames, stop_after, with_bad_pixels, write_sequence

import rtdenoise
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header
from rtdenoise.data.stored import read_history, write_history
from rtdenoise.errors import InputError
from rtdenoise.models.shrinkage import corrected
from rtdenoise.run.backends import open_backend
from rtdenoise.run.denoise import STATE, Options, denoise
from rtdenoise.run.stand_ins import COSTS, STAND_INS


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


@pytest.mark.parametrize("samples", [-1, 10**30, 10**400], ids=["negative", "large", "beyond float"])
def test_samples_beyond_all_sense_are_one_line(tmp_path, samples, capsys):
    told = refused(capsys, "denoise", tmp_path, "--out", tmp_path / "out", "--correct", "--samples", samples)
    assert "--samples: expected 1 to 1000000" in told


@pytest.mark.parametrize("more", [{}, {"correct": True, "samples": 4}])
def test_an_interrupted_run_goes_on_to_the_same_result(shot, tmp_path, model, more):
    options = Options(model=model, float32=True, **more)
    denoise(str(shot), tmp_path / "whole", options)

    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "halves", options, on_frame=stop_after(2))
    summary = denoise(str(shot), tmp_path / "halves", options)
    assert (summary.skipped, summary.written) == (2, 2)
    for i in range(4):
        name = f"frame.{i:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "whole" / name), pixels(tmp_path / "halves" / name)), name
    assert denoise(str(shot), tmp_path / "halves", options).written == 0


def test_of_large_pictures_an_interrupted_run_repeats_the_frames_since_its_state(shot, tmp_path, model, monkeypatch):
    """To the same files. A finished run has its state, whatever the time."""
    options = Options(model=model, float32=True)
    denoise(str(shot), tmp_path / "whole", options)
    monkeypatch.setattr("rtdenoise.run.state.LARGE", 0)
    monkeypatch.setattr("rtdenoise.run.state.PAUSE", 1e9)
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "halves", options, on_frame=stop_after(2))
    summary = denoise(str(shot), tmp_path / "halves", options)
    assert (summary.skipped, summary.written) == (0, 4)
    for i in range(4):
        name = f"frame.{i:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "whole" / name), pixels(tmp_path / "halves" / name)), name
    assert denoise(str(shot), tmp_path / "halves", options).written == 0


def test_appended_frames_continue_a_finished_run(tmp_path, model):
    """As if all frames had been there at once, also beside a scene.json that grows with them."""

    def scene(last):
        entry = {"world_to_pixel": np.diag([1.0, 1, 1, 1])[[0, 1, 3, 2]].tolist(), "camera_origin": [0, 0, 0]}
        frames = [{"number": n, "object_to_world": {}, **entry} for n in range(-1, last + 2)]
        return json.dumps({"format": "rtdenoise-scene-1", "width": 32, "height": 24, "objects": {}, "frames": frames})

    whole = write_sequence(tmp_path / "whole", make_frames(6))
    (whole / "scene.json").write_text(scene(5))
    growing = tmp_path / "growing"
    options = Options(model=model, float32=True)
    for count in (1, 4, 6):
        growing.mkdir(exist_ok=True)
        for path in sorted(whole.glob("*.exr"))[:count]:
            if not (growing / path.name).exists():
                shutil.copy2(path, growing)
        (growing / "scene.json").write_text(scene(count - 1))
        summary = denoise(str(growing), tmp_path / "out", options)
    assert (summary.skipped, summary.written) == (4, 2)
    denoise(str(whole), tmp_path / "once", options)
    for path in sorted(whole.glob("*.exr")):
        assert np.array_equal(pixels(tmp_path / "out" / path.name), pixels(tmp_path / "once" / path.name)), path.name

    (growing / "frame.0005.exr").unlink()  # fewer than were denoised
    with pytest.raises(rtdenoise.InputError, match="another input, layout or weights"):
        denoise(str(growing), tmp_path / "out", options)
    shutil.copy2(whole / "frame.0005.exr", growing)
    os.utime(growing / "frame.0002.exr")  # rendered anew
    with pytest.raises(rtdenoise.InputError, match="another input, layout or weights"):
        denoise(str(growing), tmp_path / "out", options)


def test_a_disk_that_fills_up_is_one_line_and_the_run_goes_on_later(shot, tmp_path, model, capsys, monkeypatch):
    """Wherever it happens: with the first frame, with the state after it, with a later one."""
    write, out = Path.write_bytes, tmp_path / "out"
    command = ["denoise", shot, "--out", out, "--model", model, "--float32"]
    for written_before in (1, 2, 4):
        room = [written_before]

        def write_while_there_is_room(path, content, room=room):
            if not room[0]:
                write(path, content[:3])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            room[0] -= 1
            return write(path, content)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", write_while_there_is_room)
            assert "cannot be written: No space left on device" in refused(capsys, *command)
        assert not list(out.glob(".*.tmp"))
    main([str(a) for a in command])
    denoise(str(shot), tmp_path / "whole", Options(model=model, float32=True))
    for path in sorted((tmp_path / "whole").glob("*.exr")):
        assert np.array_equal(pixels(path), pixels(out / path.name)), path.name


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


def test_preview_is_written(shot, tmp_path, model, capsys):
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--preview"])
    written = {path.suffix for path in (tmp_path / "out").glob("preview.*")}
    assert ".png" in written and written & {".gif", ".mp4"}
    assert ("preview.gif has 256 colours" in capsys.readouterr().out) == (".gif" in written)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_broken_pixel_of_a_reference_leaves_the_preview_its_exposure(tmp_path, model, bad):
    frames, shown = make_frames(1), []
    for name in ("whole", "broken"):
        write_sequence(tmp_path / name, frames)
        out = tmp_path / f"{name} out"
        main(["denoise", str(tmp_path / name), "--out", str(out), "--model", model, "--preview"])
        with Image.open(out / "preview.png") as picture:
            shown.append(np.asarray(picture)[:, :64].astype(float))  # noisy | denoised
        frames[0].reference[0, 1, 5, 7] = bad
    assert np.abs(shown[0] - shown[1]).max() <= 2


def test_the_input_is_not_touched(shot, tmp_path, model):
    before = {path: path.read_bytes() for path in shot.iterdir()}
    denoise(str(shot), tmp_path / "out", Options(model=model))
    assert {path: path.read_bytes() for path in shot.iterdir()} == before


@pytest.mark.parametrize("missing", [("albedo",), ("normal", "depth"), ("motion",), (*STAND_INS, "motion")])
def test_a_missing_layer_is_done_without_as_from_python(tmp_path, model, missing, capsys):
    frames = make_frames()
    shot = write_sequence(tmp_path / "shot", frames, without=missing)
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--float32"])
    told = capsys.readouterr().out.splitlines()
    for layer in (*STAND_INS, "motion"):
        lines = [line for line in told if line.startswith(f"no {layer}: {COSTS[layer]}; write it as {layer}.")]
        assert len(lines) == (layer in missing)
    denoiser = rtdenoise.Denoiser(model)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for i, frame in enumerate(rtdenoise.open_sequence(shot)):
            found = denoiser(frame.radiance, **{name: getattr(frame, name) for name in COSTS})
            assert np.array_equal(pixels(tmp_path / "out" / f"frame.{i:04d}.exr"), found[0].numpy())


@pytest.mark.parametrize("missing", ["depth", "motion"])
def test_an_interrupted_run_without_a_layer_goes_on(tmp_path, missing):
    shot = write_sequence(tmp_path / "shot", make_frames(5), without=(missing,))
    assert_goes_on(shot, tmp_path, Options(model="fast"), 2)


def test_offline_needs_motion_and_does_without_the_rest(tmp_path, capsys):
    shot = write_sequence(tmp_path / "shot", make_frames(3), without=STAND_INS)
    notes = denoise(str(shot), tmp_path / "out", Options(model="fast", offline=True)).notes
    assert [note.partition(":")[0] for note in notes if note.startswith("no ")] == [f"no {x}" for x in STAND_INS]
    shot = write_sequence(tmp_path / "still", make_frames(3), without=("motion",))
    assert "no layer 'motion'" in refused(capsys, "denoise", shot, "--out", tmp_path / "other", "--offline")


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


@pytest.mark.parametrize(
    "damage",
    [
        {"done": "x"}, {"so_far": "[]"}, {"so_far": "[" * 10_000}, {"so_far": "{}"}, {"options": "[1]"},
        {"so_far": '{"replaced": [], "passed_on": {}, "cuts": [], "left_out": {}, "exposure": []}'},
        {"so_far": '{"replaced": {"a": "b"}, "passed_on": {}, "cuts": [], "left_out": {}, "exposure": []}'},
        {"so_far": '{"replaced": {}, "passed_on": {}, "cuts": [], "left_out": {}, "exposure": [1, "a"]}'},
        {"so_far": '{"replaced": {}, "passed_on": {}, "cuts": [], "left_out": {}, "exposure": [0.0, 1.0]}'},
    ],
    ids=repr,
)  # fmt: skip
def test_damaged_metadata_of_the_state(shot, tmp_path, model, capsys, damage):
    out = tmp_path / "out"
    denoise(str(shot), out, Options(model=model))
    stored, metadata = read_history(out / STATE)
    write_history(out / STATE, stored, metadata | damage)
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
    assert "another input, layout or weights" in refused(capsys, *command)


def test_another_option_is_named(shot, tmp_path, model, capsys):
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model)
    main([str(a) for a in command])
    line = refused(capsys, *command, "--signal", "indirect", "--keep", "albedo")
    assert "other options: signal color, now indirect, keep [], now ['albedo'];" in line


def test_unknown_device(shot, tmp_path, model, capsys):
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model, "--device", "gpu")
    assert "unknown device 'gpu'" in refused(capsys, *command)


def spliced(folder, at=4):
    """Two shots as one sequence, with the motion vectors that each has of its own; the second is another scene."""
    frames = make_frames(2 * at)
    elsewhere = [replace(f, depth=f.depth * 4, albedo=f.albedo.flip(2)) for f in frames[at:]]
    return write_sequence(folder, frames[:at] + elsewhere)


def test_a_cut_that_no_layer_tells_starts_anew(tmp_path, model, capsys):
    shot = spliced(tmp_path / "shot")
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, "--float32"])
    assert "history starts anew at frame 4" in capsys.readouterr().out
    alone = rtdenoise.load(model).step(rtdenoise.open_sequence(shot)[4])[0]
    assert np.array_equal(pixels(tmp_path / "out" / "frame.0004.exr"), alone[0].numpy())
    summary = denoise(str(shot), tmp_path / "through", Options(model=model, detect_cuts=False))
    assert summary.cuts == []
    assert not np.array_equal(pixels(tmp_path / "through" / "frame.0004.exr"), alone[0].numpy())


def test_the_summary_of_a_resumed_run_is_that_of_an_undisturbed_one(tmp_path, model):
    shot = spliced(tmp_path / "shot")
    write_sequence(shot, [with_bad_pixels(make_frames(2)[1])])

    denoise(str(shot), tmp_path / "whole", Options(model=model))
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "halves", Options(model=model), on_frame=stop_after(5))
    denoise(str(shot), tmp_path / "halves", Options(model=model))
    whole, halves = (json.loads((tmp_path / name / "denoise.json").read_text()) for name in ("whole", "halves"))
    assert whole["cuts"] == [4] and whole["replaced"] == {"radiance: NaN or Inf": 2} and whole["plan"]["layers"]
    for own in ("seconds", "written", "skipped"):
        del whole[own], halves[own]
    assert whole == halves


def test_two_runs_do_not_write_to_one_folder(shot, tmp_path, model, capsys):
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model)

    def another(done, total):
        if done == 2:
            assert "another run is writing there" in refused(capsys, *command)

    assert denoise(str(shot), tmp_path / "out", Options(model=model), on_frame=another).written == 4
    assert denoise(str(shot), tmp_path / "out", Options(model=model)).skipped == 4


def in_a_process(*arguments, prefix="", **options):
    """The command line in a process of its own."""
    code = f"import sys\n{prefix}\nfrom rtdenoise.cli.main import main\nmain(sys.argv[1:])"
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stderr=subprocess.PIPE, text=True,
                            stdout=subprocess.DEVNULL, **options)  # fmt: skip


def test_a_run_killed_anywhere_is_resumed_to_the_same_files(tmp_path, model):
    """The process kills itself, with no chance to tidy up, as it is about to give a file its name: an image, then a
    history. bench/files.py does so fifty times at random moments."""
    shot = write_sequence(tmp_path / "shot", make_frames(6))
    denoise(str(shot), tmp_path / "whole", Options(model=model))
    expected = {path.name: path.read_bytes() for path in (tmp_path / "whole").glob("*.exr")}
    prefix = (
        "import os, signal; left = [int(os.environ['LEFT'])]; rename = os.replace\n"
        "def replace(*names):\n"
        "    left[0] -= 1\n"
        "    left[0] or os.kill(os.getpid(), signal.SIGKILL)\n"
        "    rename(*names)\n"
        "os.replace = replace\n"
    )
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model)
    for left in (2, 3):
        run = in_a_process(*command, prefix=prefix, env=os.environ | {"LEFT": str(left)})
        run.communicate()
        assert run.returncode == -signal.SIGKILL
    denoise(str(shot), tmp_path / "out", Options(model=model))
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.exr")} == expected
    assert not list((tmp_path / "out").glob("*.tmp"))  # files that the killed runs left are gone


def test_a_disk_that_fills_up_is_one_line_and_resumable(tmp_path, model):
    """No file may grow beyond 4 KB: the system's own refusal, not a stand-in for it."""
    shot = write_sequence(tmp_path / "shot", make_frames(2, H=64, W=64))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))"
    command = ("denoise", shot, "--out", tmp_path / "out", "--model", model)
    run = in_a_process(*command, prefix=limit)
    _, error = run.communicate()
    assert run.returncode == 2 and error.startswith("rtdenoise: ") and error.count("\n") == 1, error
    assert not list((tmp_path / "out").glob("*.exr")) and not list((tmp_path / "out").glob(".*.tmp"))
    assert denoise(str(shot), tmp_path / "out", Options(model=model)).written == 2


@pytest.mark.parametrize(
    "name", ["a b'\"$(touch x);é\n.0000.exr", "..0000.exr", "-0000.exr", "*[0]?.0000.exr", "%s{}.0000.exr"]
)
def test_hostile_names_stay_inside_out(tmp_path, model, name):
    shot = write_sequence(tmp_path / "sh*[ot]", make_frames(1))
    (shot / "frame.0000.exr").rename(shot / name)
    if name.startswith("."):  # hidden: not part of a sequence
        with pytest.raises(InputError, match=r"no \.exr file"):
            denoise(str(shot), tmp_path / "out", Options(model=model))
        return
    before = {path for path in tmp_path.rglob("*") if "out" not in path.parts}
    assert denoise(str(shot), tmp_path / "out", Options(model=model)).written == 1
    assert (tmp_path / "out" / name).exists()
    assert {path for path in tmp_path.rglob("*") if "out" not in path.relative_to(tmp_path).parts} == before


def test_a_link_out_of_the_output_folder_is_replaced_not_followed(shot, tmp_path, model):
    victim = tmp_path / "victim.exr"
    victim.write_text("precious")
    out = tmp_path / "out"
    denoise(str(shot), out, Options(model=model))
    (out / "frame.0001.exr").unlink()
    (out / "frame.0001.exr").symlink_to(victim)
    denoise(str(shot), out, Options(model=model), overwrite=True)
    assert victim.read_text() == "precious" and not (out / "frame.0001.exr").is_symlink()


def test_weights_that_are_pickles_are_not_opened(shot, tmp_path, capsys):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "owned"),))

    for name in ("weights.safetensors", "weights.pt"):
        torch.save({"state": Bomb()}, tmp_path / name)
        line = refused(capsys, "denoise", shot, "--out", tmp_path / "out", "--model", tmp_path / name)
        assert "not a readable safetensors file" in line
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("field", ["depth", "mean", "residual", "residual_length"])
def test_a_history_that_lacks_a_field_is_one_line(field):
    network, frame = rtdenoise.load("fast"), make_frames(1)[0]
    fields = corrected(network.step)(frame)[1].layers()
    backend = open_backend("torch", "fast", "cpu", "fp32", correct=True)
    assert backend.restore({name: tensor.numpy() for name, tensor in fields.items()}).residual is not None
    with pytest.raises(InputError, match=f"the history has no {field}"):
        backend.restore({name: tensor.numpy() for name, tensor in fields.items() if name != field})


@pytest.mark.parametrize("options", [(), ("--offline",)], ids=["", "offline"])
def test_a_shot_that_is_all_cuts_is_told(tmp_path, options, capsys):
    """Fog before a moving camera: depth and motion are noise."""
    torch.manual_seed(0)
    fog = [
        replace(f, depth=1 + 9 * torch.rand_like(f.depth), motion=f.motion + 9 * torch.randn_like(f.motion))
        for f in make_frames(4, H=48, W=64)
    ]
    for name, frames, told in (("fog", fog, True), ("clear", make_frames(4), False)):
        shot = write_sequence(tmp_path / name, frames)
        main(["denoise", str(shot), "--out", str(tmp_path / f"{name}-out"), "--model", "fast", *options])
        assert ("most frames find other surfaces" in capsys.readouterr().out) == told
