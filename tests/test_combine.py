"""`rtdenoise combine`: any denoiser's files corrected by the noisy ones; resuming; everything that can be wrong."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import Stop, make_frames, stop_after, write_sequence
from test_denoise import pixels, refused
from test_sequences import write_cycles

import rtdenoise
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.models import CombinerConfig, Window, create, save
from rtdenoise.run.combine import combine
from rtdenoise.run.correcting import Run
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import CombineOptions, Options
from rtdenoise.run.pairs import both, check_signal, open_denoised, open_second, read_estimate

TINY = CombinerConfig(widths=(4, 4, 4), scales=2, kernel=3)
COUNT = 6


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return saved(TINY, tmp_path_factory)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A network that corrects without evidence from other frames, too."""
    return saved(replace(TINY, evidence=False), tmp_path_factory)


def saved(config, tmp_path_factory):
    torch.manual_seed(0)
    combiner = create(config)
    for parameter in combiner.parameters():
        parameter.data.normal_(std=0.2)
    path = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    save(combiner, path)
    return str(path)


@pytest.fixture
def options(model):
    return CombineOptions(model=model, float32=True)


def estimate(frame):
    """A denoiser that blurs."""
    return torch.nn.functional.avg_pool2d(frame.radiance, 5, 1, 2, count_include_pad=False)


def write_images(folder, images, first=0):
    folder.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images, first):
        layers = {"color": image[0].permute(1, 2, 0).numpy()}
        write_layers(folder / f"frame.{number:04d}.exr", layers, dtypes={"color": "float"})
    return folder


@pytest.fixture
def frames():
    return make_frames(COUNT)


@pytest.fixture
def shot(tmp_path, frames):
    return write_sequence(tmp_path / "shot", frames)


@pytest.fixture
def clean(tmp_path, frames):
    return write_images(tmp_path / "clean", [estimate(frame) for frame in frames])


def run(*paths, **more):
    return combine(*(str(path) for path in paths[:2]), paths[2], **more)


def assert_same(one, other, numbers=range(COUNT)):
    for number in numbers:
        name = f"frame.{number:04d}.exr"
        assert np.array_equal(pixels(one / name), pixels(other / name)), name


def test_it_writes_what_the_combiner_returns(shot, clean, tmp_path, options, model):
    run(shot, clean, tmp_path / "out", options=options)
    combiner, frames = rtdenoise.models.load_combiner(model), list(rtdenoise.open_sequence(shot))
    for i in range(COUNT):
        places = [j if 0 <= j < COUNT else None for j in range(i - 2, i + 3)]
        window = Window(
            tuple(None if j is None else frames[j] for j in places),
            tuple(None if j is None else estimate(frames[j]) for j in places),
        )
        expected = combiner.combine(window).image[0].numpy()
        assert np.allclose(pixels(tmp_path / "out" / f"frame.{i:04d}.exr"), expected, atol=1e-6)


@pytest.mark.parametrize("two", [False, True])
def test_without_a_model_it_needs_no_training(shot, clean, frames, tmp_path, two):
    torch.manual_seed(1)
    others = [frame.radiance * (0.5 + torch.rand_like(frame.radiance)) for frame in frames]
    second = str(write_images(tmp_path / "second", others)) if two else ""
    options = CombineOptions(model="shrinkage", second=second, samples=8, float32=True)
    run(shot, clean, tmp_path / "out", options=options)
    read = list(rtdenoise.open_sequence(shot))
    noisy = [(frame.radiance + other) / 2 if two else frame.radiance for frame, other in zip(read, others, strict=True)]
    samples = torch.full_like(read[0].depth, 16 if two else 8)
    window = Window(
        tuple(replace(frame, radiance=y, samples=samples) for frame, y in zip(read[:5], noisy, strict=False)),
        tuple(estimate(frame) for frame in read[:5]),
        tuple(frame.radiance for frame in read[:5]) if two else (),
    )
    expected = rtdenoise.models.Shrinkage().combine(window).image[0].numpy()
    assert np.allclose(pixels(tmp_path / "out" / "frame.0002.exr"), expected, atol=1e-6)
    assert not np.allclose(expected, estimate(read[2])[0], atol=1e-3)


def test_a_second_render_must_differ(shot, clean, tmp_path, capsys):
    assert "another seed" in refused(capsys, "combine", shot, clean, "--out", tmp_path / "out", "--second", shot)
    error = refused(capsys, "combine", shot, clean, "--out", tmp_path / "out", "--second", clean)
    assert error.endswith(", which is denoised; --second is a noisy render\n")


def test_a_second_render_counts_by_its_files_whatever_it_is_called(shot, clean, frames, tmp_path, monkeypatch, capsys):
    others = [frame.radiance * (0.5 + torch.rand_like(frame.radiance)) for frame in frames]
    options = CombineOptions(model="shrinkage", second=str(write_images(tmp_path / "second", others)), samples=8)
    run(shot, clean, tmp_path / "out", options=options)
    monkeypatch.chdir(tmp_path)
    assert run(shot, clean, tmp_path / "out", options=replace(options, second="second")).written == 0
    error = refused(capsys, "combine", shot, clean, "--out", tmp_path / "out", "--model", "shrinkage", "--samples", 8)
    assert "other options: second another render, now none;" in error


def test_a_second_render_is_told_by_its_noise_also_where_pixels_are_broken_or_black(tmp_path, frames, capsys):
    broken = [frame.radiance.clone() for frame in frames]
    for image in broken:
        image[..., 3, 3] = torch.nan
    shot = write_sequence(tmp_path / "broken", [replace(f, radiance=y) for f, y in zip(frames, broken, strict=True)])
    again = write_images(tmp_path / "again", broken)
    clean = write_images(tmp_path / "clean", [estimate(frame) for frame in frames])
    assert "another seed" in refused(capsys, "combine", shot, clean, "--out", tmp_path / "out", "--second", again)
    night = [torch.zeros_like(frames[0].radiance), *(frame.radiance for frame in frames[1:])]
    shot = write_sequence(tmp_path / "dawn", [replace(f, radiance=y) for f, y in zip(frames, night, strict=True)])
    second = write_images(tmp_path / "second", [y * (0.5 + torch.rand_like(y)) for y in night])
    assert run(shot, clean, tmp_path / "out", options=CombineOptions(second=str(second))).written == COUNT


def test_pixels_that_one_render_lacks_are_as_without_a_second(shot, clean, frames, tmp_path):
    """One noisy value alone does not agree with itself."""
    lost = [torch.full_like(frame.radiance, torch.nan) for frame in frames]
    lost[0][..., :1, :1] = 0.3  # so that there is something to compare
    options = CombineOptions(model="shrinkage", samples=8, float32=True)
    run(shot, clean, tmp_path / "one", options=options)
    source = rtdenoise.open_sequence(shot)
    assert torch.isnan(both(source[1], lost[1])[1]).all() and both(source[1], lost[1])[0].samples is None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rtdenoise.run.pairs.check_pairs", lambda *_: None)
        second = str(write_images(tmp_path / "lost", lost))
        run(shot, clean, tmp_path / "two", options=replace(options, second=second))
    assert_same(tmp_path / "one", tmp_path / "two", range(3, COUNT))


def test_a_second_render_of_cycles_is_read_where_the_first_is(tmp_path, frames):
    """`Combined` may be denoised already; `Noisy Image` is the noise."""
    shots = [tmp_path / "first", tmp_path / "second"]
    noisy = [2 * torch.rand_like(frame.radiance) for frame in frames]
    for folder in shots:
        folder.mkdir()
        for i, y in enumerate(noisy):
            planes = dict.fromkeys((f"ViewLayer.Combined.{c}" for c in "RGB"), np.full(y.shape[2:], 1.0, np.float32))
            planes |= zip((f"ViewLayer.Noisy Image.{c}" for c in "RGB"), y[0].numpy(), strict=True)
            write_layers(folder / f"frame.{i:04d}.exr", planes, dtypes=dict.fromkeys(planes, "float"))
    source = rtdenoise.open_sequence(shots[0])
    assert torch.equal(read_estimate(open_second(str(shots[1]), source, "auto", False), 1), noisy[1])
    assert (read_estimate(open_denoised(str(shots[1]), source, "auto", False), 1) == 1).all()


def test_the_samples_that_files_tell_count(clean, frames, tmp_path):
    frames = [replace(frame, radiance=frame.reference) for frame in frames]  # all residuals agree, at edges too
    told = [replace(frame, samples=torch.full_like(frame.depth, 16)) for frame in frames]
    plain, counted = (write_sequence(tmp_path / name, shot) for name, shot in (("plain", frames), ("told", told)))
    for name, shot, samples in (("unknown", plain, 0), ("given", plain, 16), ("read", counted, 0)):
        run(shot, clean, tmp_path / name, options=CombineOptions(model="shrinkage", samples=samples, float32=True))
        denoise(str(shot), tmp_path / f"{name}-on", Options(model="fast", correct=True, samples=samples, float32=True))
    for more in ("", "-on"):
        assert_same(tmp_path / f"given{more}", tmp_path / f"read{more}")
        images = [pixels(tmp_path / f"{name}{more}" / "frame.0003.exr") for name in ("unknown", "read")]
        assert not np.array_equal(*images), more


def test_options_that_change_nothing_are_named(shot, clean, frames, tmp_path, options, free):
    second = str(write_images(tmp_path / "second", [frame.radiance * 1.1 for frame in frames]))
    assert not run(shot, clean, tmp_path / "net", options=replace(options, second=second, samples=4)).notes
    notes = run(shot, clean, tmp_path / "out", options=replace(options, model=free, second=second, samples=4)).notes
    assert "takes the mean of both renders" in notes[0] and "reads no --samples" in notes[1]
    still = write_sequence(tmp_path / "still", [replace(frame, motion=None, motion_next=None) for frame in frames])
    (note,) = run(still, clean, tmp_path / "still-out", options=CombineOptions()).notes
    assert note == "the files have no motion: nothing is corrected; a second render (--second) would be needed"
    one, its = write_sequence(tmp_path / "one", frames[:1]), write_images(tmp_path / "its", [estimate(frames[0])])
    (note,) = run(one, its, tmp_path / "one-out", options=CombineOptions()).notes
    assert note.startswith("there is one frame: nothing is corrected")


def test_frames_without_error_stay_as_they_are(shot, frames, tmp_path, options):
    """y = z: nothing to correct, to the bit, which is told."""
    same = write_images(tmp_path / "same", [frame.radiance for frame in frames])
    summary = run(shot, same, tmp_path / "out", options=options)
    noisy, denoised = (folder / "frame.0000.exr" for folder in (shot, same))
    assert summary.notes == [f"{denoised} is the same picture as {noisy}: name the denoised frames"]
    assert_same(tmp_path / "out", shot)


@pytest.mark.parametrize("killed", [(0,), (1,), (3,), (1, 4)])
def test_an_interrupted_run_goes_on_to_the_same_result(shot, clean, tmp_path, options, killed):
    run(shot, clean, tmp_path / "whole", options=options)
    for count in killed:
        with pytest.raises(Stop):
            run(shot, clean, tmp_path / "out", options=options, on_frame=stop_after(count))
    summary = run(shot, clean, tmp_path / "out", options=options)
    assert (summary.skipped, summary.written) == (killed[-1], COUNT - killed[-1])
    assert_same(tmp_path / "out", tmp_path / "whole")
    assert run(shot, clean, tmp_path / "out", options=options).written == 0


def test_appended_frames_are_neighbours_of_those_before(shot, clean, tmp_path, options, frames):
    write_sequence(tmp_path / "growing", frames[:4])
    grown = write_images(tmp_path / "grown", [estimate(frame) for frame in frames[:4]])
    run(tmp_path / "growing", grown, tmp_path / "out", options=options)
    write_images(grown, [estimate(frame) for frame in frames[4:]], first=4)
    write_sequence(tmp_path / "growing", frames[4:])
    summary = run(tmp_path / "growing", grown, tmp_path / "out", options=options)
    assert (summary.skipped, summary.written) == (2, 4)
    run(shot, clean, tmp_path / "once", options=options)
    assert_same(tmp_path / "out", tmp_path / "once")


def test_killed_right_after_a_frame_was_written_anew(shot, clean, tmp_path, frames, monkeypatch):
    """As frames were appended, and before the state told of it."""
    options = CombineOptions(confidence=True)  # so that frames that are written anew have another size
    write_sequence(tmp_path / "growing", frames[:4])
    grown = write_images(tmp_path / "grown", [estimate(frame) for frame in frames[:4]])
    run(tmp_path / "growing", grown, tmp_path / "out", options=options)
    write_images(grown, [estimate(frame) for frame in frames[4:]], first=4)
    write_sequence(tmp_path / "growing", frames[4:])
    write = Run._write

    def killed(self, *arguments):
        write(self, *arguments)
        raise Stop

    with monkeypatch.context() as patch, pytest.raises(Stop):
        patch.setattr(Run, "_write", killed)
        run(tmp_path / "growing", grown, tmp_path / "out", options=options)
    assert run(tmp_path / "growing", grown, tmp_path / "out", options=options).written == 4
    run(shot, clean, tmp_path / "once", options=options)
    assert_same(tmp_path / "out", tmp_path / "once")


@pytest.mark.parametrize("killed", [None, 2, 3], ids=["whole", "before any frame", "after one"])
def test_bad_pixels_are_counted_once(tmp_path, frames, options, killed):
    """Also where the run that writes frames anew is killed."""

    def growing(first, last):
        noisy, denoised = [frame.radiance.clone() for frame in frames], [estimate(frame) for frame in frames]
        noisy[2][..., 3, 3], denoised[3][..., :2, 0] = torch.nan, torch.inf
        spoiled = [replace(frame, radiance=y) for frame, y in zip(frames, noisy, strict=True)]
        write_images(tmp_path / "clean", denoised[first:last], first)
        return write_sequence(tmp_path / "shot", spoiled[first:last]), tmp_path / "clean"

    run(*growing(0, 4), tmp_path / "out", options=options)
    grown = growing(4, COUNT)
    if killed:
        with pytest.raises(Stop):
            run(*grown, tmp_path / "out", options=options, on_frame=stop_after(killed))
    summary = run(*grown, tmp_path / "out", options=options)  # writes two frames anew
    assert summary.replaced == {"radiance: NaN or Inf": 1, "denoised: NaN or Inf": 2}
    assert np.isfinite(pixels(tmp_path / "out" / "frame.0003.exr")).all()


def test_no_window_looks_across_a_cut(tmp_path, options):
    first = make_frames(3)
    second = [replace(f, depth=f.depth * 5, normal=-f.normal) for f in make_frames(3, seed=1)]
    joined = [replace(frame, number=i) for i, frame in enumerate([*first, *second])]
    shot = write_sequence(tmp_path / "shot", joined)
    clean = write_images(tmp_path / "clean", [estimate(frame) for frame in joined])
    assert run(shot, clean, tmp_path / "both", options=options).cuts == [3]
    for name, part in (("first", first), ("second", second)):
        alone = write_images(tmp_path / f"{name} clean", [estimate(frame) for frame in part])
        run(write_sequence(tmp_path / name, part), alone, tmp_path / f"{name} out", options=options)
    for i in range(6):
        expected = tmp_path / ("first out" if i < 3 else "second out") / f"frame.{i % 3:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "both" / f"frame.{i:04d}.exr"), pixels(expected)), i


def test_no_window_looks_across_a_gap(shot, clean, tmp_path, options, frames):
    for folder in (shot, clean):
        (folder / "frame.0002.exr").unlink()
    assert run(shot, clean, tmp_path / "out", options=replace(options, allow_gaps=True)).gaps == [(2, 2)]
    before = write_sequence(tmp_path / "before", frames[:2])
    run(before, write_images(tmp_path / "z", [estimate(f) for f in frames[:2]]), tmp_path / "two", options=options)
    assert_same(tmp_path / "out", tmp_path / "two", range(2))


def test_one_frame(tmp_path, options, frames):
    shot = write_sequence(tmp_path / "shot", frames[:1])
    run(shot, write_images(tmp_path / "clean", [estimate(frames[0])]), tmp_path / "out", options=options)
    assert np.isfinite(pixels(tmp_path / "out" / "frame.0000.exr")).all()


def test_without_motion_every_frame_is_corrected_alone_and_it_says_so(clean, tmp_path, options, frames, free):
    options = replace(options, model=free)
    still = write_sequence(tmp_path / "still", frames, without=("motion", "motion_next"))
    notes = run(still, clean, tmp_path / "out", options=options).notes
    assert notes == ["the noisy files have no motion: every frame is corrected by itself alone"]
    for i in (0, 3):
        one = write_sequence(tmp_path / f"one {i}", [replace(frames[i], number=0)])
        z = write_images(tmp_path / f"z {i}", [estimate(frames[i])])
        run(one, z, tmp_path / f"out {i}", options=options)
        alone = pixels(tmp_path / f"out {i}" / "frame.0000.exr")
        assert np.array_equal(pixels(tmp_path / "out" / f"frame.{i:04d}.exr"), alone)


def test_missing_layers_are_named(clean, tmp_path, options, frames, capsys):
    bare = write_sequence(tmp_path / "bare", frames, without=("albedo", "normal", "motion_next"))
    main(["combine", str(bare), str(clean), "--out", str(tmp_path / "out"), "--model", options.model])
    told = capsys.readouterr().out
    assert "no albedo, normal: corrected without" in told
    assert "no motion_next: it is approximated from motion and depth" in told


def test_layouts_of_the_denoised_frames(shot, clean, tmp_path, options):
    """The signal indirect in R,G,B of plain files, and in its own channels of copies of the input."""
    indirect = replace(options, signal="indirect")
    run(shot, clean, tmp_path / "plain", options=indirect)
    run(shot, clean, tmp_path / "source", options=replace(indirect, layout="source"))
    header = read_header(tmp_path / "source" / "frame.0000.exr")
    assert {"albedo.R", "indirect.R", "motion.X"} <= set(header.channels)
    run(shot, tmp_path / "source", tmp_path / "again", options=indirect)
    run(shot, tmp_path / "plain", tmp_path / "twice", options=indirect)
    assert_same(tmp_path / "again", tmp_path / "twice")


@pytest.mark.parametrize(
    ("written", "asked", "held"),
    [({"signal": "indirect"}, "color", "indirect"), ({"signal": "indirect", "recombine": True}, "indirect", "color"),
     ({"signal": "indirect", "recombine": True}, "color", ""), ({"signal": "indirect"}, "indirect", ""),
     ({"signal": "indirect", "recombine": True, "layout": "source"}, "indirect", ""), ({"signal": ["?"]}, "color", "")],
    ids=str,
)  # fmt: skip
def test_another_signal_than_that_of_the_denoised_frames_is_refused(shot, clean, tmp_path, written, asked, held):
    """By what `denoise` leaves beside them."""
    other = tmp_path / "denoised"
    shutil.copytree(clean, other)
    (other / "denoise.json").write_text(json.dumps({"options": {"layout": "plain"} | written}))
    source = open_sequence(shot, signal=asked)
    estimates = open_denoised(str(other), source, "auto", False)
    if not held:
        check_signal(source, estimates)
        return
    with pytest.raises(InputError, match=f"are of the signal {held}, expected {asked}; .* or pass --signal {held}"):
        check_signal(source, estimates)


def test_one_folder_of_cycles_holds_noisy_and_denoised_frames(tmp_path, options, capsys):
    """`Noisy Image` is the noisy picture, `Combined` the denoised one; without the former there is one picture only."""
    passes = {"Combined": "RGBA", "Noisy Image": "RGB"}
    for folder in ("both", "alone"):
        (tmp_path / folder).mkdir()
        write_cycles(tmp_path / folder / "frame.0001.exr", passes=passes)
        passes.pop("Noisy Image", None)
    assert run(tmp_path / "both", tmp_path / "both", tmp_path / "out", options=options).written == 1
    told = refused(capsys, "combine", tmp_path / "alone", tmp_path / "alone", "--out", tmp_path / "none")
    assert "ViewLayer.Combined.B was named as noisy and as denoised frame" in told


def test_confidence_is_a_layer_of_its_own(shot, clean, tmp_path, options):
    run(shot, clean, tmp_path / "out", options=replace(options, confidence=True))
    assert "confidence.V" in read_header(tmp_path / "out" / "frame.0000.exr").channels


def test_pixels_that_are_not_finite_do_not_count_as_dark(clean, frames, tmp_path, options):
    bad = [replace(frame, radiance=frame.radiance.clone()) for frame in frames]
    for frame in bad:
        frame.radiance[..., ::2] = torch.nan
    noisy = write_sequence(tmp_path / "noisy", bad)
    run(noisy, clean, tmp_path / "out", options=options)
    assert np.isfinite(pixels(tmp_path / "out" / "frame.0002.exr")).all()


def test_frames_that_do_not_belong_together_are_refused(shot, clean, tmp_path, model, frames, capsys):
    def line(denoised, *more):
        return refused(capsys, "combine", shot, denoised, "--out", tmp_path / "out", "--model", model, *more)

    images = [estimate(frame) for frame in frames]
    small = write_images(tmp_path / "small", [image[..., :16, :16] for image in images])
    assert "is 16×16, the noisy frames are 32×24" in line(small)
    few = write_images(tmp_path / "few", images[:4])
    assert "frame 4 has no denoised frame: 6 noisy frames, 4 denoised ones" in line(few)
    later = write_images(tmp_path / "later", images, first=1)
    assert "frame 0 has no denoised frame" in line(later)
    assert "frame 4 has no second frame: 6 noisy frames, 4 second ones" in line(clean, "--second", few)
    bright = write_images(tmp_path / "bright", [4 * image for image in images])
    assert "times as bright as the noisy ones" in line(bright)
    mapped = write_images(tmp_path / "mapped", [(3 * image).clamp(max=1) for image in images])
    loud = write_sequence(tmp_path / "loud", [replace(frame, radiance=3 * frame.radiance) for frame in frames])
    told = refused(capsys, "combine", loud, mapped, "--out", tmp_path / "out", "--model", model)
    assert "the denoised light ends at 1.00" in told and "it looks tone-mapped, or is another signal" in told
    assert "does not exist" in line(tmp_path / "nowhere")
    assert "R, G, B was named as noisy and as denoised frame" in line(shot)
    assert "--layout plain" in line(clean, "--confidence", "--layout", "source")
    assert "no model 'nosuch'" in refused(
        capsys, "combine", shot, clean, "--out", tmp_path / "out", "--model", "nosuch"
    )
    assert "expected a combiner" in refused(
        capsys, "combine", shot, clean, "--out", tmp_path / "out", "--model", "default"
    )
    for folder in (shot, clean):
        assert "holds the input" in refused(capsys, "combine", shot, clean, "--out", folder, "--model", model)
    assert not list((tmp_path / "out").glob("*.exr"))


def test_progress_in_lines_and_a_preview(shot, clean, tmp_path, capsys):
    out = tmp_path / "out"
    more = ["--model", "shrinkage", "--progress", "lines", "--preview"]
    main(["combine", str(shot), str(clean), "--out", str(out), *more])
    assert "6/6\n" in capsys.readouterr().out and (out / "preview.png").exists()


@pytest.mark.parametrize("samples", [-1, 1_000_001, 10**30])
def test_samples_beyond_all_sense_are_one_line(shot, clean, tmp_path, samples, capsys):
    command = ("combine", shot, clean, "--out", tmp_path / "out", "--samples", samples)
    assert f"--samples: expected 1 to 1000000, or 0 for unknown, got {samples}" in refused(capsys, *command)


def test_other_options_are_not_mixed(shot, clean, tmp_path, model, options, capsys):
    run(shot, clean, tmp_path / "out", options=options)
    command = ("combine", shot, clean, "--out", tmp_path / "out", "--model", model)
    assert "float32 True, now False" in refused(capsys, *command)
    main([str(word) for word in (*command, "--overwrite")])
