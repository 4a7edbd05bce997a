"""`rtdenoise denoise --offline`: both passes, interrupted in each, cuts, gaps, what is told and refused."""

import gc
import shutil
import sys
import weakref
from dataclasses import fields, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from synthetic import Stop, make_frames, save_tiny, stop_after, write_sequence
from test_denoise import pixels, refused

import rtdenoise
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.stored import read_history, write_history
from rtdenoise.errors import InputError
from rtdenoise.evaluate import evaluate, outputs
from rtdenoise.evaluate.registry import choose
from rtdenoise.frame import Frame, reverse
from rtdenoise.models import AccumulatedKPNConfig, HybridConfig, load, read, save
from rtdenoise.models.accumulated_kpn import AccumulatedKPN
from rtdenoise.models.weights import find
from rtdenoise.run.combination import WEIGHTS, Candidates, combine
from rtdenoise.run.combined import Beside, Combined, read_combined, write_combined
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.offline import ESTIMATES
from rtdenoise.run.passes import InMemory, Passes
from rtdenoise.run.sides import Estimate, seen_on_both_sides
from rtdenoise.run.stored_estimate import BYTES_PER_PIXEL, read_estimate, write_estimate
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import completed

TINY = AccumulatedKPNConfig(widths=(4, 4, 4), scales=2, kernel=3, recent=2)
PIXELS = HybridConfig(widths=(4, 4, 4), scales=2, kernel=3, recent=2, down=(4, 4, 4), up=(4, 4), out=(4, 4))
NAMES = [f"frame.{i:04d}.exr" for i in range(4)]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return str(save_tiny(tmp_path_factory.mktemp("model"), TINY))


@pytest.fixture
def shot(tmp_path):
    return write_sequence(tmp_path / "shot", make_frames())


@pytest.fixture
def options(model):
    return Options(model=model, float32=True, offline=True)


def assert_same(one, other, names=NAMES):
    for name in names:
        assert np.array_equal(pixels(one / name), pixels(other / name)), name


@pytest.mark.parametrize("killed", [(0,), (2,), (4,), (5,), (7,), (1, 3, 4, 6)])
def test_an_interrupted_run_goes_on_to_the_same_result(shot, tmp_path, options, killed):
    """Killed in the first pass, between both, and in the second one."""
    denoise(str(shot), tmp_path / "whole", options)
    out = tmp_path / "out"
    for count in killed:
        with pytest.raises(Stop):
            denoise(str(shot), out, options, on_frame=stop_after(count))
    counted = []
    denoise(str(shot), out, options, on_frame=lambda *progress: counted.append(progress))
    assert counted[0] == (killed[-1], 8) and counted[-1] == (8, 8)
    assert_same(out, tmp_path / "whole")
    assert not (out / ESTIMATES).exists()
    assert denoise(str(shot), out, options).written == 0


def test_with_a_network_that_writes_pixels(shot, tmp_path, options):
    """It goes on to the same result, too, and what both sides have seen is what kernels alone saw."""
    options = replace(options, model=str(save_tiny(tmp_path, PIXELS)))
    denoise(str(shot), tmp_path / "whole", options)
    for count in (3, 6):
        with pytest.raises(Stop):
            denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(count))
    counted = []
    denoise(str(shot), tmp_path / "out", options, on_frame=lambda *progress: counted.append(progress))
    assert counted[0] == (6, 8)
    assert_same(tmp_path / "out", tmp_path / "whole")

    passes, history = Passes(options.model, "cpu"), None
    step = partial(AccumulatedKPN.step_and_kernels, passes.backend.network)
    for frame in map(sanitise, make_frames(3)):
        with torch.inference_mode():
            _, kernels, _ = step(frame, history)
        estimate, history = passes.step(frame, history)
        assert torch.equal(estimate.footprint_count, kernels.footprint_count)
    assert estimate.footprint_count.mean() > 2


def test_kernels_count_more_than_in_real_time():
    """What `hybrid` shows is nearer to its kernels' image, since the filter writes pixels, too; in float32."""
    passes, frame = Passes("hybrid", "cpu"), sanitise(make_frames(1)[0])
    assert passes.backend.ran["precision"] == "fp32"
    network = load("hybrid", "cpu", "fp32")
    with torch.inference_mode():
        kernels, _, _ = AccumulatedKPN.step_and_kernels(network, frame)
        images = network.step(frame)[0], passes.step(frame, None)[0].image
    in_real_time, offline = ((image - kernels).abs().mean() for image in images)
    assert offline < 0.8 * in_real_time


def test_a_run_killed_before_it_could_note_a_frame(shot, tmp_path, options, monkeypatch):
    """The frame is there, its state is not: it is written again, and alike."""
    denoise(str(shot), tmp_path / "whole", options)
    out, real = tmp_path / "out", rtdenoise.run.state.write_history

    def dies(path, fields, metadata):
        if metadata.get("done") == "6":
            raise Stop
        real(path, fields, metadata)

    with monkeypatch.context() as patch:
        patch.setattr("rtdenoise.run.state.write_history", dies)
        with pytest.raises(Stop):
            denoise(str(shot), out, options)
    assert (out / NAMES[3]).exists()
    denoise(str(shot), out, options)
    assert_same(out, tmp_path / "whole")


def test_lost_estimates_start_the_run_anew(shot, tmp_path, options):
    denoise(str(shot), tmp_path / "whole", options)
    out = tmp_path / "out"
    with pytest.raises(Stop):
        denoise(str(shot), out, options, on_frame=stop_after(5))
    for path in (out / ESTIMATES).iterdir():
        path.unlink()
    assert denoise(str(shot), out, options).skipped == 0
    assert_same(out, tmp_path / "whole")


DAMAGE = {  # what -> fields and metadata of a stored estimate, changed
    "another size": lambda fields, facts: ({name: a[..., :5] for name, a in fields.items()}, facts),
    "no footprint": lambda fields, facts: ({n: a for n, a in fields.items() if not n.startswith("footprint")}, facts),
    "nothing": lambda fields, facts: ({}, facts),
    "no scales": lambda fields, facts: (fields, {"first": "1"}),
    "scales that are no JSON": lambda fields, facts: (fields, facts | {"scales": "{"}),
    "a list of scales": lambda fields, facts: (fields, facts | {"scales": "[1]"}),
    "scales that are no numbers": lambda fields, facts: (fields, facts | {"scales": '{"radiance": [1]}'}),
    "scales beyond all numbers": lambda fields, facts: (fields, facts | {"scales": '{"radiance": 1e300}'}),
    "not a word of the shot's start": lambda fields, facts: (fields, {"scales": facts["scales"]}),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_estimate_is_one_line(shot, tmp_path, options, damage, capsys):
    out = tmp_path / "out"
    with pytest.raises(Stop):
        denoise(str(shot), out, options, on_frame=stop_after(4))
    path = out / ESTIMATES / "000003.safetensors"
    write_history(path, *DAMAGE[damage](*read_history(path)))
    command = ("denoise", shot, "--out", out, "--model", options.model, "--offline", "--float32")
    line = refused(capsys, *command)
    assert str(path.with_suffix("")) in line or "not finite" in line
    assert not list(out.glob("*.exr"))


def test_the_folder_of_estimates_is_never_a_link(shot, tmp_path, options):
    """Estimates would be written beside --out."""
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.mkdir(), out.mkdir()
    (out / ESTIMATES).symlink_to(elsewhere)
    for kind in ("link", "file"):
        with pytest.raises(InputError, match="not a folder of this program; remove it"):
            denoise(str(shot), out, options)
        assert not list(elsewhere.iterdir())
        (out / ESTIMATES).unlink()
        if kind == "link":
            (out / ESTIMATES).touch()
    denoise(str(shot), out, options)


def test_other_files_among_the_estimates_stay(shot, tmp_path, options):
    foreign = tmp_path / "out" / ESTIMATES / "mine.txt"
    foreign.parent.mkdir(parents=True)
    foreign.write_text("mine")
    denoise(str(shot), tmp_path / "out", options)
    assert [path.name for path in foreign.parent.iterdir()] == ["mine.txt"]


def test_frames_in_memory_and_on_disk_agree(shot, tmp_path, options, model):
    """What `evaluate` measures is what the command writes, but for the half floats of stored estimates."""
    denoise(str(shot), tmp_path / "out", options)
    method = InMemory(Passes(model, "cpu"))
    for output in outputs(method.step, rtdenoise.open_sequence(shot), method.delay):
        written = pixels(tmp_path / "out" / f"frame.{output.frame.number:04d}.exr")
        assert np.allclose(written, output.image[0].numpy(), rtol=5e-3, atol=5e-3)


def joined(tmp_path, *parts):
    """A sequence of several, numbered on."""
    frames = [frame for part in parts for frame in part]
    folder = write_sequence(tmp_path / "joined", [replace(frame, number=i) for i, frame in enumerate(frames)])
    return folder, len(frames)


def test_no_pass_looks_across_a_cut(tmp_path, options):
    """Two shots in one sequence give the pictures of each alone."""
    first = make_frames(3)
    second = [replace(f, depth=f.depth * 5, normal=-f.normal) for f in make_frames(3, seed=1)]
    folder, count = joined(tmp_path, first, second)
    summary = denoise(str(folder), tmp_path / "both", options)
    assert summary.cuts == [3]
    for name, frames in (("first", first), ("second", second)):
        denoise(str(write_sequence(tmp_path / name, frames)), tmp_path / f"{name} out", options)
    for i in range(count):
        alone = tmp_path / ("first out" if i < 3 else "second out") / f"frame.{i % 3:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "both" / f"frame.{i:04d}.exr"), pixels(alone)), i


def test_no_pass_looks_across_a_gap(tmp_path, options):
    frames = make_frames(5)
    gappy = write_sequence(tmp_path / "gappy", [*frames[:2], *frames[3:]])
    summary = denoise(str(gappy), tmp_path / "out", replace(options, allow_gaps=True))
    assert summary.gaps == [(2, 2)]
    for name, part in (("before", frames[:2]), ("after", frames[3:])):
        denoise(str(write_sequence(tmp_path / name, part)), tmp_path / f"{name} out", options)
        assert_same(tmp_path / "out", tmp_path / f"{name} out", [f"frame.{f.number:04d}.exr" for f in part])


def test_a_window_of_frames_is_in_memory_at_a_time(tmp_path, options, monkeypatch):
    shot, alive, most = write_sequence(tmp_path / "shot", make_frames(6, H=16, W=16)), [], []
    real = rtdenoise.data.sequences.Sequence.read

    def read(self, i):
        frame = real(self, i)
        alive.append(weakref.ref(frame.radiance))
        return frame

    monkeypatch.setattr("rtdenoise.data.sequences.Sequence.read", read)

    def count(done, total):
        gc.collect()
        most.append(sum(array() is not None for array in alive))

    denoise(str(shot), tmp_path / "out", replace(options, plan=False), on_frame=count)
    assert max(most) <= 2 and len(most) == 13


def test_one_frame(tmp_path, options, model):
    """Without past and future all three images of the network are one."""
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    denoise(str(shot), tmp_path / "out", options)
    assert np.isfinite(pixels(tmp_path / "out" / NAMES[0])).all()


def test_motion_next_is_approximated_where_it_is_missing(tmp_path, options, capsys):
    frames = make_frames()
    write_sequence(tmp_path / "shot", frames, without=("motion_next",))
    main(["denoise", str(tmp_path / "shot"), "--out", str(tmp_path / "out"), "--offline", "--model", options.model])
    assert "the files have no motion_next: the backward pass approximates it" in capsys.readouterr().out
    lacking = replace(frames[1], motion_next=None)
    found = reverse(completed(lacking, frames[2])).motion
    hidden = found.abs().amax(1, keepdim=True) > 100  # wall that the square covers in the next frame
    covered = (frames[1].depth > 5) & hidden
    exact = torch.where(covered, found, frames[1].motion_next)
    assert torch.allclose(found, exact) and covered.float().mean() < 0.05
    assert reverse(completed(lacking)).motion is None
    assert reverse(completed(frames[1], frames[2])).motion is frames[1].motion_next


def test_without_oidn_it_says_so_and_filters_by_itself(shot, tmp_path, options, monkeypatch):
    """Its picture is near that with OIDN."""
    denoise(str(shot), tmp_path / "with", options)
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    summary = denoise(str(shot), tmp_path / "out", options)
    assert len(summary.notes) == 1 and "OIDN is not installed" in summary.notes[0]
    for name in NAMES:
        alone, both = pixels(tmp_path / "out" / name), pixels(tmp_path / "with" / name)
        assert np.isfinite(alone).all()
        assert np.abs(np.log1p(alone) - np.log1p(both)).mean() < 0.03


def test_frames_with_and_without_oidn_are_not_mixed(shot, tmp_path, options, monkeypatch):
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(6))
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(rtdenoise.InputError, match="another input, layout or weights"):
        denoise(str(shot), tmp_path / "out", options)


def test_frames_of_other_weights_of_the_filter_are_not_mixed(shot, tmp_path, options, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    path = shutil.copy(find("hybrid-large"), tmp_path / "mine.safetensors")
    monkeypatch.setattr("rtdenoise.run.pixel_filter.MODEL", path)
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(6))
    network = read(path)
    network.pixels.last.bias += 0.1
    save(network, path)
    with pytest.raises(rtdenoise.InputError, match="another input, layout or weights"):
        denoise(str(shot), tmp_path / "out", options)


def test_confidence_is_a_layer_of_its_own(shot, tmp_path, options):
    denoise(str(shot), tmp_path / "out", replace(options, confidence=True))
    header = read_header(tmp_path / "out" / NAMES[1])
    assert set(header.channels) == {"R", "G", "B", "confidence.V"}
    spread = read_channels(tmp_path / "out" / NAMES[1], ["confidence.V"])["confidence.V"]
    assert (spread >= 0).all() and spread.max() > 0


def test_the_confidence_of_an_earlier_run_is_not_kept_in_the_place_of_the_new_one(shot, tmp_path, options):
    for name in NAMES:
        types = read_header(shot / name).channels
        layers = read_channels(shot / name, list(types), as_stored=True)
        layers["confidence.V"] = np.full(layers["R"].shape, -1, np.float16)
        write_layers(shot / name, layers, dtypes=types)
    denoise(str(shot), tmp_path / "out", replace(options, confidence=True, keep=("all",)))
    assert "depth.Z" in read_header(tmp_path / "out" / NAMES[1]).channels
    assert read_channels(tmp_path / "out" / NAMES[1], ["confidence.V"])["confidence.V"].max() > 0


def test_what_does_not_go_together_is_refused(shot, tmp_path, model, capsys):
    common = ("denoise", shot, "--out", tmp_path / "out", "--model", model)
    assert "--confidence: goes with --offline" in refused(capsys, *common, "--confidence")
    assert "goes with --backend torch" in refused(capsys, *common, "--offline", "--backend", "glsl")
    assert "--lookahead: goes without --offline" in refused(capsys, *common, "--offline", "--lookahead", "0")
    assert "--layout plain" in refused(capsys, *common, "--offline", "--confidence", "--layout", "source")
    told = refused(capsys, *common[:4], "--model", "paper", "--offline")
    assert "does not average light" in told and "choose hybrid, default, many or fast" in told
    main([str(word) for word in common])
    assert "offline False, now True" in refused(capsys, *common, "--offline")


def test_a_full_disk_is_found_before_the_first_frame(shot, tmp_path, options, monkeypatch):
    usage = type("Usage", (), {"free": 1e5})
    monkeypatch.setattr("rtdenoise.run.stored_estimate.shutil.disk_usage", lambda path: usage)
    with pytest.raises(rtdenoise.InputError, match=r"keeps 0\.\d MB there while it runs, 0\.1 MB are free; choose"):
        denoise(str(shot), tmp_path / "out", options)
    assert not list((tmp_path / "out").glob("*.exr"))


# --- the combination --------------------------------------------------------------------------------------------------


def test_weights_sum_to_one():
    assert sum(WEIGHTS.values()) == pytest.approx(1)


def test_equal_candidates_come_out_to_the_bit():
    image = torch.rand(1, 3, 9, 11) * 50
    found = combine(Candidates(*[image] * 4))
    assert torch.equal(found.image, image) and not found.spread.any()


def test_it_scales_with_the_light_and_stays_near_the_candidates():
    candidates = [torch.rand(1, 3, 16, 16) for _ in range(4)]
    plain = combine(Candidates(*candidates))
    for scale in (1e-4, 1e4):
        scaled = combine(Candidates(*(scale * c for c in candidates)))
        assert torch.allclose(scaled.image / scale, plain.image, rtol=1e-3, atol=1e-5)
    assert plain.image.min() >= 0 and plain.image.max() < 4


def estimate(image, length, first=False, surfaces=None):
    ones = torch.ones_like(image[:, :1])
    seen = torch.cat([image, torch.full_like(image, 0.5), torch.full_like(image, -0.6)], dim=1)
    counts = length * ones, (length if surfaces is None else surfaces) * ones
    return Estimate(image, first, seen, *counts, ones)


def grey(radiance):
    """A frame of a grey wall."""
    surface = torch.full_like(radiance, 0.5)
    return Frame(radiance, surface, torch.zeros_like(radiance), torch.ones_like(radiance[:, :1]))


def test_the_frame_itself_counts_once_in_what_both_sides_have_seen():
    """Forward mean of (1, y), backward mean of (y, 4): the mean of 1, y and 4."""
    y = torch.full((1, 3, 4, 4), 2.5)
    frame = grey(y)
    seen, *counts = seen_on_both_sides(frame, estimate((1 + y) / 2, 2.0), estimate((y + 4) / 2, 2.0))
    torch.testing.assert_close(seen[:, :3], (1 + y + 4) / 3)
    torch.testing.assert_close(seen[:, 3:6], frame.albedo)
    assert all((count == 3).all() for count in counts)


def test_light_and_surfaces_have_counts_of_their_own():
    """Two frames and the frame's own have seen the light, four and the frame's own albedo (0.5) and normal (-0.6)."""
    y = torch.full((1, 3, 4, 4), 2.5)
    forward, backward = (estimate((x + y) / 2, 2.0, surfaces=3.0) for x in (1, 4))
    seen, light, surfaces = seen_on_both_sides(replace(grey(y), albedo=y), forward, backward)
    assert (light == 3).all() and (surfaces == 5).all()
    torch.testing.assert_close(seen[:, :3], (1 + y + 4) / 3)
    torch.testing.assert_close(seen[:, 3:6], (6 * 0.5 - y).clamp(min=0) / 5)
    torch.testing.assert_close(seen[:, 6:], torch.full_like(y, 6 * -0.6 / 5))


def test_where_one_frame_was_seen_oidn_filters_its_own_picture_of_that_frame(monkeypatch, model):
    """On the left both passes have seen four frames, on the right none but this one. OIDN adds 10 here."""
    passes, frame, inputs = Passes(model, "cpu"), grey(torch.ones(1, 3, 4, 8)), []

    def filtered(self, frame):
        inputs.append(frame)
        return frame.radiance + 10, None

    monkeypatch.setattr("rtdenoise.baselines.oidn.Oidn.prefiltered", lambda self, frame: frame)
    monkeypatch.setattr("rtdenoise.baselines.oidn.Oidn.step", filtered)
    left = torch.arange(8) < 4
    side = estimate(torch.where(left, 3.0, 1.0).expand(1, 3, 4, 8), torch.where(left, 4.0, 1.0))
    found = passes.candidates(frame, side, side).opinion

    alone, even = inputs
    radiance, normal = (2 * 4 * 3 - 1) / 7, 2 * 4 * -0.6 / 7
    assert torch.equal(alone.radiance, frame.radiance)
    assert torch.equal(alone.normal, frame.normal)
    torch.testing.assert_close(even.radiance, torch.where(left, radiance, 11.0).expand(1, 3, 4, 8))
    torch.testing.assert_close(even.normal, torch.where(left, normal, 0.0).expand(1, 3, 4, 8))
    assert torch.equal(found, even.radiance + 10)


def test_noise_is_evened_as_far_as_pixels_around_have_seen_more(monkeypatch, model):
    """One frame has seen the pixel in the middle, and so many those around it; evened is as 11 stands in for 1."""

    def evened(around):
        frame, inputs = grey(torch.ones(1, 3, 15, 15)), []
        passes = Passes(model, "cpu")
        monkeypatch.setattr("rtdenoise.baselines.oidn.Oidn.prefiltered", lambda self, frame: frame)
        monkeypatch.setattr(
            "rtdenoise.baselines.oidn.Oidn.step",
            lambda self, frame: (inputs.append(frame), (frame.radiance + 10, None))[1],
        )
        counts = torch.full((1, 1, 15, 15), around)
        counts[..., 7, 7] = 1.0
        side = estimate(frame.radiance, counts)
        passes.candidates(frame, side, side)
        return inputs[-1].radiance[0, 0, 7, 7].item(), len(inputs)

    assert evened(1.0) == (1.0, 1), "nothing is to be evened, so the frame is not filtered by itself"
    assert evened(2.0)[0] == pytest.approx(11 - 10 / 225, abs=1e-4), "two frames beside this one in all the others"
    assert evened(1.5)[0] == pytest.approx(6 - 5 / 225, abs=1e-4)
    assert evened(8.0)[0] == 11.0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_estimates_survive_the_disk(tmp_path, scale):
    stored = estimate(scale * torch.rand(1, 3, 8, 8), 3.0, first=True, surfaces=4.5)
    write_estimate(tmp_path / "e.safetensors", stored)
    found = read_estimate(tmp_path / "e.safetensors", "cpu", (8, 8))
    assert found.first and torch.allclose(found.image, stored.image, rtol=1e-3)
    assert torch.allclose(found.footprint, stored.footprint, rtol=1e-3)
    for name in ("footprint_count", "surface_count", "trusted"):
        assert torch.equal(getattr(found, name), getattr(stored, name)), name
    halves = sum(array.shape[1] for array in read_history(tmp_path / "e.safetensors")[0].values())
    assert 2 * halves == BYTES_PER_PIXEL


def test_a_black_estimate_survives_too(tmp_path):
    write_estimate(tmp_path / "e.safetensors", estimate(torch.zeros(1, 3, 8, 8), 1.0))
    assert not read_estimate(tmp_path / "e.safetensors", "cpu", (8, 8)).image.any()


# --- the pictures beside ----------------------------------------------------------------------------------------------


def test_a_picture_takes_those_beside_as_far_as_its_passes_trust_them(model):
    frames, passes = [completed(*pair) for pair in pairwise(map(sanitise, make_frames(4)))], Passes(model, "cpu")
    one = torch.ones(1, 1, *frames[1].size)
    images = [1 + 0.1 * torch.rand_like(frame.radiance) for frame in frames]
    sides = [Beside(frame, image) for frame, image in zip(frames, images, strict=True)]

    def settled(before, after, sides=(sides[0], sides[2])):
        return passes.settle(frames[1], Combined(images[1], one, before * one, after * one), *sides)

    alone = images[1]
    assert torch.equal(settled(1, 1, (None, None)), alone) and torch.equal(settled(0, 0), alone)
    back, onward, both = settled(1, 0), settled(0, 1), settled(1, 1)
    assert not torch.equal(back, alone) and not torch.equal(onward, alone)
    still = (frames[1].motion == 0).all(1, keepdim=True) & (frames[1].motion_next == 0).all(1, keepdim=True)
    wall = still.expand_as(alone)
    near = [(image - other)[wall].square().mean() for image in (alone, both) for other in (images[0], images[2])]
    assert near[2] < 0.8 * near[0] and near[3] < 0.8 * near[1]


@pytest.mark.parametrize("name", ["000002", "000003"])
def test_a_lost_picture_that_waits_starts_the_run_anew(shot, tmp_path, options, name):
    denoise(str(shot), tmp_path / "whole", options)
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(6))
    (tmp_path / "out" / ESTIMATES / f"{name}-combined.safetensors").unlink()
    counted = []
    denoise(str(shot), tmp_path / "out", options, on_frame=lambda *progress: counted.append(progress))
    assert counted[0] == (0, 8)
    assert_same(tmp_path / "out", tmp_path / "whole")


@pytest.mark.parametrize("side", [0, 2])
def test_pictures_beside_are_found_from_a_camera_that_goes_ahead(model, side):
    """By surfaces that are nearer by a fifth in each frame."""
    radiance = torch.rand(1, 3, 24, 32)
    frames = [replace(grey(radiance), depth=torch.full((1, 1, 24, 32), 9.0 - 1.5 * i)) for i in range(3)]
    normal, zero = torch.tensor([0.0, 0, -1]).view(1, 3, 1, 1).expand_as(radiance), torch.zeros(1, 2, 24, 32)
    frames = [replace(frame, normal=normal, motion=zero, motion_next=zero) for frame in frames]
    sides = [Beside(frames[side], radiance + 0.1) if i == side else None for i in (0, 2)]
    one = torch.ones(1, 1, 24, 32)
    found = Passes(model, "cpu").settle(frames[1], Combined(radiance + 0.2, one, one, one), *sides)
    assert (found < radiance + 0.2).all()


@pytest.mark.parametrize("side", [0, 2])
def test_what_comes_before_a_surface_leaves_no_outline(model, side):
    """In the picture beside, its edge is read with what is behind it."""
    torch.manual_seed(0)
    radiance = torch.distributions.Exponential(1.0).sample((1, 3, 24, 32))
    one, motion = torch.ones(1, 1, 24, 32), torch.zeros(1, 2, 24, 32)
    motion[:, 0] = -3.3
    wall = {"normal": torch.cat([0 * one, 0 * one, -one], dim=1), "motion": motion, "motion_next": motion}
    depth = torch.where(torch.arange(32) < 18, 9 * one, 4 * one)
    frames = [replace(grey(radiance), depth=depth if i == side else 9 * one, **wall) for i in range(3)]
    beside = Beside(frames[side], torch.where(depth < 9, 3.0, torch.ones_like(radiance)))
    sides = [beside if i == side else None for i in (0, 2)]
    found = Passes(model, "cpu").settle(frames[1], Combined(torch.ones_like(radiance), one, one, one), *sides)
    torch.testing.assert_close(found, torch.ones_like(radiance), atol=1e-3, rtol=0)


def test_what_waits_survives_the_disk(tmp_path):
    given = Combined(*(torch.rand(1, channels, 4, 6) for channels in (3, 1, 1, 1)))
    write_combined(tmp_path / "c.safetensors", given)
    found = read_combined(tmp_path / "c.safetensors", "cpu", (4, 6))
    assert all(torch.equal(getattr(found, field.name), getattr(given, field.name)) for field in fields(Combined))
    write_history(tmp_path / "c.safetensors", {"radiance": given.image.numpy()}, {})
    with pytest.raises(InputError, match="damaged, spread is not as it was written"):
        read_combined(tmp_path / "c.safetensors", "cpu", (4, 6))
    write_combined(tmp_path / "c.safetensors", given)
    with pytest.raises(InputError, match="damaged, radiance is not as it was written"):
        read_combined(tmp_path / "c.safetensors", "cpu", (4, 5))


# --- evaluate ---------------------------------------------------------------------------------------------------------


def test_evaluate_has_it_as_a_method():
    for method in choose(["offline", "offline-without-oidn"]):
        assert method.delay >= 2000 and method.weights == ("hybrid", "hybrid-large")
    (result,) = evaluate(make_frames(3), ["offline"], metrics=("psnr",))
    assert len(result.images) == 3 and min(result.times) > 0
