"""`rtdenoise export`: a player that knows nothing but the exported files reproduces the frames."""

import importlib
import json
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scripts import imported
from synthetic import thin

from rtdenoise.cli.main import main
from rtdenoise.errors import InputError
from rtdenoise.files import LOCK, lock
from rtdenoise.frame import CHANNELS
from rtdenoise.glsl import Pipeline
from rtdenoise.glsl.export import export
from rtdenoise.glsl.record import with_empty_frames
from rtdenoise.glsl.sample import sample_frames
from rtdenoise.models import CombinerConfig, create, save

PLAYER = Path(__file__).parent.parent / "examples" / "engines" / "player.py"
SIZE = (19, 34)
pytestmark = pytest.mark.usefixtures("thin_filters")


@pytest.fixture(scope="module")
def player():
    return imported(PLAYER)


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    """Exports share most of their shaders: glslang, half of the time, compiles each text once."""
    kept = {}

    def run(command, **options):
        compiler, *_, target, source = command
        key = compiler, source.read_bytes()
        if key not in kept:
            done = subprocess.run(command, **options)
            if done.returncode or not target.is_file():
                return done
            kept[key] = done, target.read_bytes()
        target.write_bytes(kept[key][1])
        return kept[key][0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importlib.import_module("rtdenoise.glsl.export"), "subprocess", SimpleNamespace(run=run))
        yield


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    out = tmp_path_factory.mktemp("export") / "out"
    export(out, "default", SIZE)
    return out


def document(folder):
    return json.loads((folder / "export.json").read_text())


def test_the_player_needs_no_rtdenoise_and_finds_every_pass_the_same(exported):
    code = f"import sys, runpy; sys.modules['rtdenoise'] = None; sys.argv = ['player', {str(exported)!r}]"
    code += f"; runpy.run_path({str(PLAYER)!r}, run_name='__main__')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    passes = sum(len(frame) for frame in document(exported)["frames"].values())
    assert run.returncode == 0, run.stdout + run.stderr
    assert f"{passes} passes same" in run.stdout


@pytest.mark.parametrize(
    "model, half, recent",
    [("paper", False, None), ("fast", True, 2), ("hybrid-fast", False, 0), ("hybrid-large", True, 1)],
)
def test_other_networks_and_float16(tmp_path, gl, player, weights, model, half, recent):
    export(out := tmp_path / "out", weights(thin(model)), SIZE, half, recent)
    assert player.check(player.Player(out, gl))
    kept = [name for name in document(out)["buffers"] if name.startswith("recent.")]
    assert len(kept) == (recent + 1 if recent else 0)  # the frames before, and this one


@pytest.mark.parametrize("model", ["default", "hybrid-fast"])
def test_the_player_denoises_other_frames_as_the_pipeline_does(gl, player, weights, tmp_path, model):
    """Ten of them: more than are kept; then a cut, and frames from before it must not be looked up. The disc stays on
    the screen and moves by parts of a pixel, so that paths along its edge (`ops.over`) find the wall, too. The pipeline
    looks up empty frames as well where there are fewer, as what is recorded does."""
    export(out := tmp_path / "out", model := weights(thin(model)), SIZE)
    played, history, pipeline = player.Player(out, gl), None, Pipeline.load(model)
    for number, frame in enumerate(sample_frames(SIZE, 15, speed=(1.3, 0.3))[2:]):
        history = history if number != 10 else None
        layers = {name: array.tobytes() for name, array in frame.layers()}
        found = played.play("following" if history else "first", layers)
        if history:
            history = with_empty_frames(history, pipeline.config.recent)
        else:
            frame = replace(frame, motion=None)  # paths end there
        expected, history = pipeline.step(frame, history)
        assert np.array_equal(found, expected[0]), number


def test_the_player_sees_what_differs(exported, gl, player, tmp_path):
    broken = shutil.copytree(exported, tmp_path / "broken")
    weights = bytearray((broken / "weights.bin").read_bytes())
    offset = document(broken)["buffers"]["unet.encoder.1.0.bias"]["offset"]
    weights[offset : offset + 16] = struct.pack("4f", 9, 9, 9, 9)
    (broken / "weights.bin").write_bytes(weights)
    assert not player.check(player.Player(broken, gl))


def test_another_rounding_is_close(exported, gl, player, tmp_path, capsys):
    rounded = shutil.copytree(exported, tmp_path / "rounded")
    weights = np.fromfile(rounded / "weights.bin", np.float32) * np.float32(1 + 1e-6)
    weights.tofile(rounded / "weights.bin")
    assert player.check(player.Player(rounded, gl))
    same, close = (int(number) for number in re.findall(r"(\d+) passes (?:same|close)", capsys.readouterr().out))
    assert same > 10 and close > 10


def test_everything_named_is_there(exported):
    found = document(exported)
    weights = (exported / "weights.bin").stat().st_size
    for shader in found["shaders"].values():
        assert (exported / shader["glsl"]).is_file()
        assert shader["push_constant_bytes"] <= 128  # which Vulkan guarantees
    for buffer in found["buffers"].values():
        assert buffer["kind"] != "weights" or buffer["offset"] + buffer["bytes"] <= weights
    assert {n for n, b in found["buffers"].items() if b["kind"] == "input"} < set(CHANNELS)
    for steps in found["frames"].values():
        for step in steps:
            slots = found["shaders"][step["shader"]]["buffers"]
            assert [slot["name"] for slot in slots] == list(step["buffers"])
            assert set(step["buffers"].values()) <= found["buffers"].keys()


def test_offsets_are_those_of_push_constants(exported):
    """std430: an ivec3 starts at a multiple of 16 bytes."""
    shader = document(exported)["shaders"]["network-conv3x3-1"]["parameters"]
    types = {name: (parameter["type"], parameter["offset"]) for name, parameter in shader.items()}
    assert types == {"groups": ("ivec3", 0), "size": ("ivec2", 16)}


def test_every_pass_compiles_to_spirv(exported):
    files = [*exported.glob("spirv/*.spv")]
    assert files, "glslang is missing: apt install glslang-tools"
    assert {path.stem for path in files} == {path.stem for path in exported.glob("glsl/*.comp")}
    assert all(path.read_bytes()[:4] == struct.pack("<I", 0x07230203) for path in files)


def test_without_glslang_glsl_alone_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    main(["export", "--out", str(tmp_path / "out"), "--size", "9x5", "--model", "fast"])
    assert not (tmp_path / "out" / "spirv").exists()
    assert all("spirv" not in shader for shader in document(tmp_path / "out")["shaders"].values())
    assert "apt install glslang-tools" in capsys.readouterr().out


@pytest.mark.parametrize("options, told", [
    (["--size", "1280"], "expected WIDTHxHEIGHT such as 1280x720, of 99999 at most each, got '1280'"),
    (["--model", "fats"], "no model 'fats'"),
    (["--recent", "99"], "recent: expected a whole number of frames below 16, got 99"),
    (["--out", "{used}"], "is not an empty folder"),
    (["--out", "{used}/file/out"], "used/file is not a folder"),
])  # fmt: skip
def test_wrong_options_are_one_line(tmp_path, capsys, options, told):
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    options = [word.format(used=tmp_path / "used") for word in options]
    with pytest.raises(SystemExit) as stop:
        main(["export", "--out", str(tmp_path / "out"), *options])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and told in error and error.count("\n") == 1


def test_a_combiner_is_one_line(tmp_path):
    save(create(CombinerConfig(widths=(4, 4, 4), scales=2, kernel=3)), tmp_path / "combiner.safetensors")
    with pytest.raises(InputError, match=r"is a combiner, .* expected a denoiser"):
        export(tmp_path / "out", str(tmp_path / "combiner.safetensors"), (16, 16))


@pytest.mark.parametrize("does", [r"printf 'bad \\377 line\\nmore\\n'; exit 3", "exit 0"])
def test_a_broken_compiler_is_one_line(tmp_path, monkeypatch, does):
    """It complains in bytes that are no text, or writes no file. Once it is mended the same folder is
    completed."""
    compiler = tmp_path / "glslangValidator"
    compiler.write_text(f"#!/bin/sh\n{does}\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(InputError, match=r"\.comp: .*glslangValidator rejects it: (bad|exit code 0)") as caught:
        export(tmp_path / "out", "fast", (9, 5))
    assert "\n" not in str(caught.value)
    compiler.unlink()
    monkeypatch.undo()
    assert export(tmp_path / "out", "fast", (9, 5)).spirv and (tmp_path / "out" / "export.json").exists()
    with pytest.raises(InputError, match="is not an empty folder"):
        export(tmp_path / "out", "fast", (9, 5))


def test_two_exports_do_not_write_into_one_folder(tmp_path, monkeypatch):
    """Neither while the other writes, nor where it has ended since the folder was found empty."""
    out = tmp_path / "out"
    out.mkdir()
    with lock(out), pytest.raises(InputError, match="another run is writing there"):
        export(out, "fast", (9, 5))
    assert [path.name for path in out.iterdir()] == [LOCK]
    module = importlib.import_module("rtdenoise.glsl.export")

    def ends_first(*given):
        (out / "export.json").touch()
        return record(*given)

    record = module.record
    monkeypatch.setattr(module, "record", ends_first)
    with pytest.raises(InputError, match="is not an empty folder"):
        export(out, "fast", (9, 5))
    (out / "export.json").unlink()
    monkeypatch.undo()
    assert export(out, "fast", (9, 5)).dispatches and not (out / LOCK).exists()
