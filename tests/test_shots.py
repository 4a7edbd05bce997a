"""`rtdenoise clips SHOT …`: training clips from frames on disk."""

import json
import os
from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, with_bad_pixels, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.training.batches import TrainingSet
from rtdenoise.training.config import TrainConfig

SMALL = ["--size", "12", "--frames", "4"]


def cut(out, *shots, options=()):
    main(["clips", *map(str, shots), "--out", str(out), *SMALL, *options])
    return ClipDataset(out)


def error_of(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["clips", *map(str, arguments)])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


@pytest.fixture
def shot(tmp_path):
    return write_sequence(tmp_path / "shot", make_frames(9, H=26, W=36))


def test_clips_are_windows_of_the_frames(tmp_path, shot):
    data = cut(tmp_path / "clips", shot)
    assert len(data) == 2 * 2 * 3  # twice four frames, two rows and three columns of windows
    for index in (0, 11):
        top, left = (facts := data.facts(index))["window"]
        for signal in ("color", "indirect"):
            sequence = open_sequence(shot, signal=signal, layers=("reference", "reference_half"))
            for i, found in enumerate(data.load(index, signal=signal)):
                expected = sequence[facts["first"] + i].crop(top, left, 12, 12)
                for layer in ("radiance", "albedo", "normal", "depth", "motion", "motion_next", "reference"):
                    a, b = getattr(found, layer), getattr(expected, layer)
                    assert torch.allclose(a, b, rtol=2**-10, atol=1e-6), (index, layer)
    assert data.facts(0)["halves"] and data.scenes() == {str(shot.resolve())}
    card = json.loads((tmp_path / "clips" / "dataset.json").read_text())
    assert card["clips"] == 12 and card["sources"] == {str(shot): 12}


def test_an_interrupted_cut_goes_on(tmp_path, shot):
    paths = cut(tmp_path / "clips", shot).paths
    whole = [path.read_bytes() for path in paths]
    paths[3].unlink()
    before = paths[4].stat().st_mtime_ns
    again = cut(tmp_path / "clips", shot).paths
    assert paths[4].stat().st_mtime_ns == before
    assert len(again[3].read_bytes()) == pytest.approx(len(whole[3]), abs=64)  # the header holds the seconds it took


def test_clips_of_frames_that_were_rendered_anew_are_not_mixed_with_older_ones(tmp_path, shot, capsys):
    paths = cut(tmp_path / "clips", shot).paths
    write_sequence(shot, [replace(frame, number=9 + frame.number) for frame in make_frames(1, H=26, W=36)])
    assert cut(tmp_path / "clips", shot).paths == paths  # one more frame, in no clip
    paths[0].unlink()
    write_sequence(shot, make_frames(9, H=26, W=36, seed=1)[4:5])
    told = error_of(capsys, shot, "--out", tmp_path / "clips", *SMALL)
    assert told.endswith("its frames were changed since it was cut; remove the clips, or choose another --out")
    assert not paths[0].exists()


def test_count_chooses_by_the_seed(tmp_path, shot):
    chosen = [
        [data.facts(i)["window"] for i in range(len(data))]
        for seed in ("0", "0", "1")
        for data in [
            cut(tmp_path / f"{seed}{len(list(tmp_path.iterdir()))}", shot, options=["--count", "5", "--seed", seed])
        ]
    ]
    assert len(chosen[0]) == 5 and chosen[0] == chosen[1] != chosen[2]


def test_references_in_other_files_and_one_signal(tmp_path, capsys):
    frames = make_frames(4, H=26, W=36)
    for folder, image in (("noisy", "radiance"), ("converged", "reference")):
        (tmp_path / folder).mkdir()
        for frame in frames:
            names = ("albedo", "normal", "depth", "motion", "motion_next")
            layers = {name: getattr(frame, name)[0].permute(1, 2, 0).numpy() for name in names}
            layers["color"] = getattr(frame, image)[0].permute(1, 2, 0).numpy()
            write_layers(tmp_path / folder / f"f.{frame.number}.exr", layers)
    data = cut(tmp_path / "clips", tmp_path / "noisy", options=["--reference", str(tmp_path / "converged")])
    (first, *_) = data.load(0, signal="color")
    top, left = data.facts(0)["window"]
    assert torch.allclose(first.reference, frames[0].reference[..., top : top + 12, left : left + 12], rtol=2**-10)
    assert torch.equal(first.reference, first.reference_half) and not data.facts(0)["halves"]
    with pytest.raises(InputError, match="has no signal 'indirect'; give --signal color"):
        data.load(0, signal="indirect")
    again = tmp_path / "noisy", "--out", tmp_path / "clips", *SMALL, "--reference"
    (tmp_path / "converged").rename(tmp_path / "better")
    assert "is another clip" in error_of(capsys, *again, tmp_path / "better")  # two renders would be mixed
    (tmp_path / "better").rename(tmp_path / "converged")
    assert "is another clip" in error_of(capsys, *again, tmp_path / "converged", "--preset", "native")
    assert "expected a folder for each of 1 shots, got 2" in error_of(
        capsys, tmp_path / "noisy", "--out", tmp_path / "c", "--reference", tmp_path / "a", tmp_path / "b"
    )
    noisy = tmp_path / "noisy"
    assert "is the same picture as" in error_of(capsys, noisy, "--out", tmp_path / "c", "--reference", noisy)


def test_clips_tell_their_samples_a_pixel(tmp_path, shot, capsys):
    told = write_sequence(tmp_path / "told", [frame.with_samples(4) for frame in make_frames(4, H=26, W=36)])
    noted = write_sequence(tmp_path / "noted", make_frames(4, H=26, W=36))
    (noted / "samples.json").write_text('{"spp": 2}')
    out = tmp_path / "clips"
    data = cut(out / "a", shot, told, noted)
    spp = {data.facts(i)["source"]: data.facts(i)["spp"] for i in range(len(data))}
    assert spp == {str(shot): 1, str(told): 4, str(noted): 2}
    data = cut(out / "b", shot, told, options=["--spp", "8"])
    assert {data.facts(i)["spp"] for i in range(len(data))} == {8, 4}
    config = TrainConfig(data=(out / "b",), out=tmp_path, least_spp=5)
    assert len(TrainingSet.open(config).clips) == 12  # those of `shot`
    again = error_of(capsys, shot, told, "--out", out / "b", *SMALL, "--spp", "9")
    assert "is another clip; choose another --out" in again


def test_bad_pixels_do_not_get_into_clips(tmp_path):
    frames = [with_bad_pixels(frame) for frame in make_frames(4, H=26, W=36)]
    data = cut(tmp_path / "clips", write_sequence(tmp_path / "bad", frames))
    assert all(t.isfinite().all() for i in range(len(data)) for f in data.load(i) for _, t in f.layers())


def test_the_card_has_the_command_as_one_types_it(tmp_path, shot, monkeypatch):
    monkeypatch.setattr("sys.argv", ["/somewhere/rtdenoise/__main__.py", "clips", "shot", "--size", "16"])
    cut(tmp_path / "clips", shot)
    card = (tmp_path / "clips" / "DATA.md").read_text()
    assert "12 clips of 4 frames, 12×12, cut from 1 shot by `rtdenoise clips shot --size 16`." in card


def test_names_that_are_no_text(tmp_path, shot):
    strange = tmp_path / os.fsdecode(b"shot\xff")
    shot.rename(strange)
    cut(tmp_path / "clips", strange)
    assert r"shot\udcff" in (tmp_path / "clips" / "DATA.md").read_text()


def test_what_cannot_be_cut_is_one_line(tmp_path, shot, capsys):
    out = tmp_path / "clips"
    assert "frames are 36×26, clips 128×128; take a smaller --size" in error_of(capsys, shot, "--out", out)
    many = (shot, "--out", out, "--size", "8", "--frames", "10")
    assert "has 9 frames, clips 10; take fewer --frames" in error_of(capsys, *many)
    assert "--max-depth: is for rendering" in error_of(capsys, shot, "--out", out, "--max-depth", "4")
    assert "--preset: goes with SHOT" in error_of(capsys, "--out", out, "--preset", "native")
    for layer in ("reference", "motion_next"):
        without = ("indirect_reference", layer) if layer == "reference" else (layer,)
        frames = [replace(frame, **{layer: None}) for frame in make_frames(4, H=26, W=36)]
        lacking = write_sequence(tmp_path / layer, frames, without)
        assert f"no layer '{layer}'" in error_of(capsys, lacking, "--out", out, *SMALL)
    cut(out, shot)
    other = error_of(capsys, shot, "--out", out, "--size", "13", "--frames", "4")
    assert "is another clip; choose another --out" in other


def test_a_shot_that_is_named_twice_is_refused(tmp_path, shot, capsys):
    """Its clips would be in the set twice."""
    again = shot / ".." / shot.name
    assert "shot: is named twice" in error_of(capsys, shot, again, "--out", tmp_path / "clips", *SMALL)
    assert not (tmp_path / "clips").exists()


def test_a_set_does_not_become_smaller(tmp_path, shot, capsys):
    """Training would take the clips of the shot that is left out, too."""
    out, second = tmp_path / "clips", write_sequence(tmp_path / "second", make_frames(9, H=26, W=36, seed=1))
    assert len(cut(out, shot, second)) == 24
    assert "clip_000012.safetensors: is of a set of more clips" in error_of(capsys, shot, "--out", out, *SMALL)
    assert len(cut(out, shot, second)) == 24
