"""Which network denoises frames whose number of samples a pixel is known."""

import json
import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from synthetic import make_frames, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.errors import InputError
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import AHEAD, MANY_AHEAD, Options

SAMPLE = Path(__file__).parents[1] / "samples" / "mural"
CYCLES = Path(__file__).parent / "data" / "cycles"


@pytest.fixture
def shot(tmp_path):
    """Two frames of the sample."""
    folder = tmp_path / "shot"
    folder.mkdir()
    for file in sorted(SAMPLE.glob("*.exr"))[:2]:
        shutil.copy(file, folder)
    return folder


def noted(tmp_path, **attributes):
    """A file with these header attributes; _ stands for a point."""
    attributes = {name.replace("_", "."): value for name, value in attributes.items()}
    write_layers(tmp_path / "noted.exr", {"color": np.ones((4, 4, 3), np.float32)}, attributes=attributes)
    return read_header(tmp_path / "noted.exr").samples


def chosen(shot, options):
    """The options with a network, and what is told; opening reads no layer but those of every run."""
    sequence, options, notes = open_chosen(str(shot), options)
    assert "samples" not in sequence.rules
    return options, notes


def write_again(file, more, **attributes):
    """Write a file anew with more channels and attributes."""
    copy = OpenEXR.File(str(file), separate_channels=True)
    channels = {name: channel.pixels for name, channel in copy.channels().items()} | more
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header | attributes, channels).write(str(file))


def test_the_samples_that_cycles_notes_are_read(tmp_path):
    assert read_header(next(CYCLES.glob("*.exr"))).samples == 1  # a file that Blender wrote
    assert noted(tmp_path, cycles_ViewLayer_samples="64") == 64
    assert noted(tmp_path, cycles_A_samples="64", cycles_B_samples="16") == 16
    assert noted(tmp_path, samples="64", cycles_A_samples="many", cycles_B_samples="9" * 40) == 0


def test_the_network_is_that_of_the_samples(shot, tmp_path):
    assert chosen(shot, Options()) == (Options(model="hybrid", lookahead=AHEAD), [])
    for samples, model in ((3, "hybrid"), (4, "hybrid-large-many"), (16, "hybrid-large-many")):
        assert chosen(shot, Options(samples=samples))[0].model == model
    for real_time in ({"lookahead": 0}, {"offline": True}):
        assert chosen(shot, Options(samples=16, **real_time))[0].model == "hybrid-many"
    assert chosen(CYCLES, Options(samples=16, offline=True))[0].model == "hybrid-large-many"
    assert chosen(shot, Options(model="fast"))[0].model == "fast"
    assert chosen(shot, Options(offline=True))[0].model == "hybrid"
    for file in shot.glob("*.exr"):
        write_again(file, {}, **{"cycles.ViewLayer.samples": "8"})
    eight = "model: hybrid-large-many, for 8 samples a pixel"
    assert chosen(shot, Options()) == (Options(model="hybrid-large-many", lookahead=MANY_AHEAD), [eight])
    assert chosen(shot, Options(samples=8)) == chosen(shot, Options()), "the same run, which continues"
    assert chosen(shot, Options(samples=2))[0].model == "hybrid"  # what the user says counts


def test_how_many_frames_ahead(shot):
    """Some where the network, chosen or named, writes pixels and has time; else as many as the user says."""
    for options, ahead in (
        ({}, 6), ({"samples": 16}, 3), ({"lookahead": 0}, 0), ({"lookahead": 4}, 4), ({"model": "hybrid"}, 6),
        ({"model": "hybrid-large"}, 6), ({"model": "hybrid", "lookahead": 0}, 0), ({"model": "default"}, 0),
        ({"model": "hybrid-many"}, 3), ({"lights": True}, 2), ({"also": ("AO",)}, 2),
        ({"model": "fast", "lookahead": 1}, 1), ({"backend": "glsl"}, 0), ({"correct": True}, 0),
        ({"model": "hybrid", "backend": "glsl"}, 0), ({"model": "hybrid", "offline": True}, 0), ({"offline": True}, 0),
    ):  # fmt: skip
        assert chosen(shot, Options(**options))[0].lookahead == ahead, options


def test_noise_tells_where_nothing_else_does(shot):
    """The sample has one sample a pixel; albedo has no noise."""
    albedo = {file: read_channels(file, [f"albedo.{c}" for c in "RGB"]) for file in shot.glob("*.exr")}
    for file, planes in albedo.items():
        write_again(file, {c: planes[f"albedo.{c}"] for c in "RGB"})
    assert chosen(shot, Options()) == (
        Options(model="hybrid-large-many", lookahead=MANY_AHEAD),
        ["model: hybrid-large-many, for frames of little noise; --samples 1 says otherwise"],
    )  # fmt: skip
    assert chosen(shot, Options(samples=1))[0].model == "hybrid"
    for file, planes in albedo.items():  # black: unknown
        write_again(file, {c: 0 * planes[f"albedo.{c}"] for c in "RGB"})
    assert chosen(shot, Options())[0].model == "hybrid"


@pytest.mark.parametrize("options", [{"backend": "glsl"}, {"correct": True}])
def test_what_goes_with_kernels_alone_gets_kernels_alone(shot, options):
    (option,) = options
    because = "because of " + ("--backend glsl" if option == "backend" else f"--{option}")
    for samples, told in ((1, "model: default, "), (16, "model: many, for 16 samples a pixel, ")):
        found, notes = chosen(shot, Options(samples=samples, **options))
        assert (found.model in told, notes) == (True, [told + because])


def test_without_torch_there_are_kernels(shot, monkeypatch):
    monkeypatch.setattr("rtdenoise.run.choice.find_spec", lambda name: None)
    options, notes = chosen(shot, Options())
    assert options.model == "default" and "PyTorch is not installed" in notes[0]


def test_a_layer_of_samples_counts_most(shot):
    for file in shot.glob("*.exr"):
        header = read_header(file)
        write_again(file, {"samples.V": np.full((header.height, header.width), 32, np.float32)})
    assert chosen(shot, Options(samples=1))[1] == ["model: hybrid-large-many, for 32 samples a pixel"]


@pytest.mark.parametrize("command", ["denoise", "denoise --offline", "combine"])
def test_samples_that_contradict_the_headers_are_told(tmp_path, command, capsys):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    for file in shot.glob("*.exr"):
        write_again(file, {}, **{"cycles.ViewLayer.samples": "8"})
    clean = [str(tmp_path / "clean")] if command == "combine" else []
    if clean:
        denoise(str(shot), clean[0], Options(model="fast"))
    verb, *options = command.split()
    for given, says in (((), False), (("--samples", "8"), False), (("--samples", "64"), True)):
        out = ("--out", str(tmp_path / f"out{len(list(tmp_path.iterdir()))}"))
        main([verb, str(shot), *clean, *out, *options, *given, *(["--model", "shrinkage"] if clean else [])])
        assert ("--samples 64: counts, though the files say 8;" in capsys.readouterr().out) == says


def test_a_run_with_many_samples_is_that_of_its_network(shot, tmp_path, capsys):
    main(["denoise", str(shot), "--out", str(tmp_path / "auto"), "--samples", "16", "--float32"])
    assert "model: hybrid-large-many, for 16 samples a pixel" in capsys.readouterr().out
    denoise(str(shot), tmp_path / "named", Options(model="hybrid-large-many", lookahead=MANY_AHEAD, float32=True))
    for file in (tmp_path / "named").glob("*.exr"):
        for name, plane in read_channels(file, ["R", "G", "B"]).items():
            assert np.array_equal(read_channels(tmp_path / "auto" / file.name, [name])[name], plane)
    document = json.loads((tmp_path / "auto" / "denoise.json").read_text())
    assert document["options"]["model"] == "hybrid-large-many" and document["ran"]["device"] in ("cpu", "cuda")
    assert document["ran"]["backend"] == "torch" and document["ran"]["precision"] in ("fp32", "bf16", "int8")
    with pytest.raises(InputError, match="goes with --correct, or without --model"):
        denoise(str(shot), tmp_path / "no", Options(model="fast", samples=16))
