"""The bundled sequence and the shipped weights: the claims of `make demo`."""

import json
from pathlib import Path

import pytest
import torch
from synthetic import make_frames, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate import uncovered
from rtdenoise.evaluate.demo import SAMPLE, demo
from rtdenoise.files import lock
from rtdenoise.models import available
from rtdenoise.run.inspect import inspect

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """(folder, {method: errors}) of the demo."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, {result.method: result.errors for result in demo(folder)}


def test_the_sample_is_what_its_readme_says():
    sequence = open_sequence(SAMPLE, signal="indirect", layers=("reference", "reference_half"))
    assert len(sequence) == 9 and sequence.size == (180, 320)
    frames = list(sequence)
    assert all(frame.reference is not None and frame.reference_half is not None for frame in frames)
    assert sum(mask.float().mean().item() for mask in uncovered(frames)[1:]) / 8 > 0.01
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*")) < 8e6


def test_its_motion_follows_the_convention():
    assert inspect(SAMPLE).convention.status == "ok"


def test_the_packaged_part_is_a_window_of_the_same_frames():
    part = ROOT / "samples" / "mural-window"
    assert sum(path.stat().st_size for path in part.iterdir()) < 2e6
    both = (open_sequence(folder, signal="indirect", layers=("reference",)) for folder in (SAMPLE, part))
    for whole, cut in zip(*both, strict=True):
        for name in ("radiance", "albedo", "normal", "depth", "motion", "motion_next"):
            assert torch.equal(getattr(whole, name)[..., 26:138, 20:204], getattr(cut, name)), name
        error = (whole.reference[..., 26:138, 20:204] - cut.reference).square().mean()
        assert 10 * torch.log10(cut.reference.max().square() / error) > 38  # dB; denoisers reach 25


def test_the_packaged_part_is_taken_where_the_whole_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr("rtdenoise.evaluate.demo.SAMPLE", tmp_path / "none")
    monkeypatch.setattr("rtdenoise.evaluate.demo.WINDOW", ROOT / "samples" / "mural-window")
    demo(tmp_path / "out", methods=("noisy", "accumulate"))
    assert (tmp_path / "out" / "strip.png").is_file()
    with pytest.raises(InputError, match="--signal color: the packaged sample has indirect light alone"):
        demo(tmp_path / "out", signal="color")


def test_two_demos_do_not_write_into_one_folder(tmp_path):
    with lock(tmp_path), pytest.raises(InputError, match="another run is writing there"):
        demo(tmp_path, methods=("noisy", "accumulate"))
    assert not (tmp_path / "demo.json").exists()


@pytest.mark.parametrize("model", ["paper", "default"])
def test_denoising_gains_8_db_and_beats_accumulation_in_both_regions(shown, model):
    _, errors = shown
    assert errors[model]["frame"]["psnr"] > errors["noisy"]["frame"]["psnr"] + 8
    for region in ("frame", "uncovered"):
        assert errors[model][region]["psnr"] > errors["accumulate"][region]["psnr"]
        assert errors[model][region]["ssim"] > errors["accumulate"][region]["ssim"]
        assert errors[model][region]["relmse"] < errors["accumulate"][region]["relmse"]


def test_default_is_better_than_the_papers_network(shown):
    _, errors = shown
    for region in ("frame", "uncovered"):
        assert errors["default"][region]["psnr"] > errors["paper"][region]["psnr"]
        assert errors["default"][region]["ssim"] > errors["paper"][region]["ssim"]


def test_dual_motion_beats_traditional_where_something_was_uncovered(shown):
    _, errors = shown
    assert errors["paper"]["uncovered"]["psnr"] > errors["paper-traditional"]["uncovered"]["psnr"]
    assert errors["paper"]["uncovered"]["relmse"] < errors["paper-traditional"]["uncovered"]["relmse"]


def test_the_demo_leaves_pictures_and_numbers(shown):
    folder, errors = shown
    written = json.loads((folder / "demo.json").read_text())
    assert [row["method"] for row in written["results"]] == list(errors)
    assert {path.suffix for path in folder.iterdir()} >= {".png", ".json"}


def test_numbers_that_there_are_not_are_null(tmp_path, capsys):
    shot = write_sequence(tmp_path / "[a] shot", make_frames(2), without=("motion_next",))  # so nothing is uncovered
    (shot / "samples.json").write_text('{"spp": 4}')
    demo(tmp_path / "[final]", shot, "color", ("noisy", "accumulate", "paper"))
    told = capsys.readouterr().out
    assert "[a] shot: 2 frames, 4 spp" in told and f"pictures: {tmp_path / '[final]' / 'strip.png'}" in told
    text = (tmp_path / "[final]" / "demo.json").read_text()
    assert "NaN" not in text
    assert json.loads(text)["results"][0]["errors"]["uncovered"]["psnr"] is None


def test_denoise_from_the_command_line(tmp_path, capsys):
    main(["denoise", str(SAMPLE), "--out", str(tmp_path / "clean"), "--signal", "indirect", "--preview"])
    assert len(list((tmp_path / "clean").glob("frame.*.exr"))) == 9
    assert (tmp_path / "clean" / "preview.png").exists()
    assert "9 frames written" in capsys.readouterr().out


def test_shipped_weights_are_small_and_have_a_card():
    for name in available():
        assert (ROOT / "rtdenoise" / "weights" / f"{name}.safetensors").stat().st_size < 7e6
        assert (ROOT / "docs" / "reference" / "models" / f"{name}.md").is_file()
