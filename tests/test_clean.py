"""References denoised for training."""

import importlib.metadata
import sys

import numpy as np
import pytest
import torch
from synthetic import make_frames, write_clips

from rtdenoise.baselines.oidn import _device
from rtdenoise.cli.main import main
from rtdenoise.data.clip_file import clip_path
from rtdenoise.data.clips import ClipDataset
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Clips whose references are half as noisy as they are bright."""
    return write_clips(tmp_path_factory.mktemp("noisy"), range(2), size=64, reference_noise=0.5)


@pytest.fixture(scope="module")
def cleaned(noisy, tmp_path_factory):
    (noisy / "DATA.md").write_text("# Training clips\n\nA wall by Nobody, CC0.\n")
    out = tmp_path_factory.mktemp("cleaned")
    main(["clean", str(noisy), "--out", str(out)])
    return out


@pytest.mark.parametrize("signal", ["color", "indirect"])
def test_references_lose_their_noise_and_nothing_else_changes(noisy, cleaned, signal):
    for index in range(2):
        truth = [frame.reference for frame in make_frames(4, H=64, W=64, seed=index)]
        before, after = (ClipDataset(folder).load(index, signal=signal) for folder in (noisy, cleaned))
        for a, b, converged in zip(before, after, truth, strict=True):
            error = [(x.reference - converged).square().mean().item() for x in (a, b)]
            assert error[1] < 0.35 * error[0]
            assert b.reference.mean().item() == pytest.approx(a.reference.mean().item(), rel=0.03)
            assert torch.equal(b.reference, b.reference_half)  # no two estimates, so none of its error
            for name, layer in a.layers():
                assert name.startswith("reference") or torch.equal(layer, getattr(b, name)), name


def test_a_lead_in_stays_without_references(tmp_path):
    noisy = write_clips(tmp_path / "noisy", range(1), lead_in=2, reference_noise=0.5)
    main(["clean", str(noisy), "--out", str(tmp_path / "clean")])
    before, after = (ClipDataset(tmp_path / name).load(0, lead_in=2) for name in ("noisy", "clean"))
    changed = [not torch.equal(a.reference, b.reference) for a, b in zip(before, after, strict=True)]
    assert changed == [False] * 2 + [True] * 4


def test_what_is_there_is_kept_and_the_card_says_what_it_is(noisy, cleaned, capsys):
    clip_path(cleaned, 1).unlink()
    written = clip_path(cleaned, 0).stat().st_mtime_ns
    main(["clean", str(noisy), "--out", str(cleaned)])
    assert "1 clip written" in capsys.readouterr().out
    assert clip_path(cleaned, 0).stat().st_mtime_ns == written
    assert ClipDataset(cleaned).facts(1)["references"].startswith("denoised by pyoidn")
    card = (cleaned / "DATA.md").read_text()
    assert "not for validation" in card and "A wall by Nobody, CC0." in card


def test_other_clips_are_not_taken_for_the_cleaned_ones(noisy, cleaned, tmp_path, capsys):
    for out in (tmp_path / "others", tmp_path / "rendered"):
        write_clips(out, range(5, 6) if out.name == "others" else range(1), size=64)
        with pytest.raises(SystemExit, match="2"):
            main(["clean", str(noisy), "--out", str(out)])
        assert "is not the cleaned clip of" in capsys.readouterr().err


def test_clips_that_the_folder_lacks_are_not_left_among_the_cleaned_ones(tmp_path, capsys):
    noisy, out = write_clips(tmp_path / "noisy", range(2), size=16), tmp_path / "clean"
    main(["clean", str(noisy), "--out", str(out)])
    clip_path(noisy, 1).unlink()
    with pytest.raises(SystemExit, match="2"):
        main(["clean", str(noisy), "--out", str(out)])
    assert f"{clip_path(out, 1)}: is not the cleaned clip of one in {noisy}" in capsys.readouterr().err


@pytest.mark.parametrize("what, message", [("itself", "is where the clips are"), ("twice", "denoised already")])
def test_clips_are_neither_cleaned_in_place_nor_twice(noisy, cleaned, tmp_path, capsys, what, message):
    source, out = (noisy, noisy) if what == "itself" else (cleaned, tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(["clean", str(source), "--out", str(out)])
    assert message in capsys.readouterr().err


def test_a_folder_without_clips_leaves_nothing_behind(tmp_path):
    with pytest.raises(SystemExit, match="2"):
        main(["clean", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_without_oidn_it_is_one_line(noisy, tmp_path, monkeypatch, capsys):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setitem(sys.modules, "pyoidn", None)
    monkeypatch.setattr(importlib.metadata, "version", missing)
    _device.cache_clear()
    with pytest.raises(SystemExit, match="2"):
        main(["clean", str(noisy), "--out", str(tmp_path)])
    assert "pip install 'rtdenoise[bench]'" in capsys.readouterr().err


def test_validation_is_refused(noisy, cleaned, tmp_path):
    others = write_clips(tmp_path / "others", range(5, 7), size=64)
    with pytest.raises(ValueError, match="validate on clips as they were rendered"):
        train(TrainConfig(data=(others,), val=cleaned, out=tmp_path / "run", steps=1, frames=2, size=16))
    assert np.array_equal(sorted(tmp_path.iterdir()), [others])
