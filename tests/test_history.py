"""The life of a history: usable where the surface is, over at a cut, kept on disk, carried to another size."""

from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file
from synthetic import TINY, make_frames, thin

from rtdenoise import glsl, models
from rtdenoise.constants import SHIFT_CELL
from rtdenoise.errors import InputError
from rtdenoise.frame import MAX_CUT_MISMATCH, History, Known, geometry
from rtdenoise.history import advance, going_ahead, load_history, mismatch, resize, save_history, usable
from rtdenoise.models import TemporalKPN
from rtdenoise.motion import on_screen
from rtdenoise.run.torch_backend import TorchBackend


@pytest.fixture(scope="module")
def denoiser():
    torch.manual_seed(0)
    return TemporalKPN(TINY).eval().requires_grad_(False)


def test_history_is_usable_but_where_something_was_uncovered_or_off_screen():
    before, now = make_frames(2)
    uncovered = (now.depth == 8) & (before.depth == 3)  # the wall, where the square was
    assert torch.equal(usable(now, geometry(before)), ~uncovered)
    away = replace(now, motion=torch.full_like(now.motion, 1e3))
    assert not usable(away, geometry(before)).any()
    assert usable(now, replace(geometry(before), depth=None)).all()


def test_a_cut_is_seen_whatever_the_motion_says():
    before, now = make_frames(2)
    assert mismatch(now, geometry(before)) < 0.1
    elsewhere = replace(before, depth=before.depth * 3)
    assert mismatch(now, geometry(elsewhere)) > MAX_CUT_MISMATCH
    turned = replace(now, normal=torch.tensor([0.0, 1.0, 0.0]).reshape(1, 3, 1, 1).expand_as(now.normal))
    looking_up = replace(before, normal=-turned.normal)
    assert mismatch(turned, geometry(looking_up)) > MAX_CUT_MISMATCH
    nothing = replace(now, motion=torch.full_like(now.motion, 1e3))
    assert mismatch(nothing, geometry(elsewhere)) == 0


def test_depth_that_is_noise_is_no_cut_unless_it_moves():
    """Fog: one sample a pixel stops anywhere. Before a moving camera its motion is noise, too."""
    torch.manual_seed(0)
    fog = [replace(frame, depth=1 + 9 * torch.rand_like(frame.depth)) for frame in make_frames(2, H=72, W=96)]
    moving = replace(fog[1], motion=fog[1].motion + 9 * torch.randn_like(fog[1].motion))
    assert mismatch(moving, geometry(fog[0])) > MAX_CUT_MISMATCH
    assert not usable(fog[1], geometry(fog[0])).float().mean() > 0.6
    assert mismatch(fog[1], geometry(fog[0])) < 0.2 * MAX_CUT_MISMATCH
    half = [replace(frame, depth=torch.where(torch.arange(96) < 30, other.depth, frame.depth))
            for frame, other in zip(make_frames(2, H=72, W=96), fog, strict=True)]  # fmt: skip
    assert mismatch(half[1], geometry(half[0])) < 0.2 * MAX_CUT_MISMATCH
    assert mismatch(half[1], geometry(replace(half[0], depth=3 * half[0].depth))) > MAX_CUT_MISMATCH


def test_a_veil_is_no_cut():
    """One sample a pixel shows the veil or what is behind it, which moves otherwise. Another shot shows neither."""
    before, now = veiled(make_frames(2, H=72, W=96))
    seen = on_screen(now.motion)
    assert (seen & ~usable(now, geometry(before))).sum() > 0.35 * seen.sum(), "pixel by pixel it looks like a cut"
    assert mismatch(now, geometry(before)) < 0.5 * MAX_CUT_MISMATCH
    for factor in (0.6, 2.5):
        assert mismatch(now, geometry(replace(before, depth=factor * before.depth))) > MAX_CUT_MISMATCH


def test_a_camera_that_goes_ahead_is_no_cut():
    g = torch.Generator().manual_seed(0)
    depth = (2 + 3 * torch.rand(1, 1, 6, 8, generator=g)).repeat_interleave(12, 2).repeat_interleave(12, 3)
    before, now = (replace(frame, depth=depth, motion=0 * frame.motion + 0.1) for frame in make_frames(2, H=72, W=96))
    there, up = (torch.tensor(x).reshape(1, 3, 1, 1).expand_as(now.normal) for x in ([0.0, 0, 1], [0.0, 1, 0]))
    before, now = (replace(frame, normal=there) for frame in (before, now))
    further = replace(before, depth=depth + 0.8)
    assert usable(now, geometry(further)).float().mean() < 0.1, "every depth is another"
    assert mismatch(now, geometry(further)) < 0.1 * MAX_CUT_MISMATCH
    for other in (depth + 2, depth.flip(3) + 0.8, (depth + 0.8).roll(6, 3)):
        assert mismatch(now, geometry(replace(before, depth=other))) > MAX_CUT_MISMATCH
    assert mismatch(now, geometry(replace(further, normal=up))) > MAX_CUT_MISMATCH
    assert mismatch(replace(now, depth=0 * depth), geometry(further)) > MAX_CUT_MISMATCH, "the sky is nothing nearer"


def dolly(count, by=0.5, **others):
    """Frames of boxes that come nearer by so much a frame, and stay where they are in the picture."""
    g = torch.Generator().manual_seed(0)
    depth = (2 + 6 * torch.rand(1, 1, 6, 8, generator=g)).repeat_interleave(12, 2).repeat_interleave(12, 3)
    up = torch.tensor([0.0, 1.0, 0.0]).reshape(1, 3, 1, 1)
    return [
        replace(frame, depth=depth + by * (count - 1 - i), motion=0 * frame.motion, motion_next=0 * frame.motion,
                normal=up.expand_as(frame.normal).contiguous(), **others)
        for i, frame in enumerate(make_frames(count, H=72, W=96))
    ]  # fmt: skip


@pytest.mark.parametrize("by", [0.5, -0.4])
def test_how_far_a_camera_goes_ahead_is_measured(by):
    before, now = dolly(2, by)
    assert advance(now, before.depth, before.normal).item() == pytest.approx(by, rel=1e-3)
    assert advance(now, now.depth, now.normal) == 0, "it stands still"
    assert advance(now, 10 * before.depth, before.normal) == 0, "that is another place"
    small = dolly(2, 0.01)
    assert advance(small[1], small[0].depth, small[0].normal) == 0, "all surfaces are found anyway"
    assert advance(replace(now, normal=None), before.depth, before.normal) == 0
    assert advance(now, before.depth[..., :-1], before.normal) == 0, "the step says that the size does not fit"
    moves = torch.arange(96) < 60  # a large thing that comes nearer, before what stands still
    assert advance(now, torch.where(moves, before.depth, now.depth), before.normal) != 0
    alone = torch.where(moves, now.depth + 0.1, now.depth)  # still its surface: nothing is gained
    assert advance(now, alone, now.normal) == 0


@pytest.mark.parametrize("ahead", [0, 2])
def test_history_goes_ahead_with_the_camera(ahead):
    """As much of it counts as where the camera stands still, step by step and in frames ahead."""
    lengths = {}
    for by in (0.0, 0.5):
        network, frames, history = models.read("default"), dolly(6, by, radiance=torch.ones(1, 3, 72, 96)), None
        for i in range(4):
            known = Known(ahead=tuple(frames[i + 1 : i + 1 + ahead]), waits=ahead > 0)
            _, history = going_ahead(network.step)(frames[i], history, known)
            assert torch.equal(history.depth, frames[i].depth), "what is stored is as it was seen"
        lengths[by] = history.length
    assert lengths[0.0].mean() > 3 + ahead / 2
    torch.testing.assert_close(lengths[0.5].mean(), lengths[0.0].mean(), rtol=0.01, atol=0)


def test_recent_frames_go_ahead_when_they_are_read_anew():
    backend, frames, history = TorchBackend("default", "cpu", "fp32"), dolly(5), None
    frames = [backend.prepare(frame) for frame in frames]
    for frame in frames:
        _, history = backend.denoise(frame, history)
    restored = backend.restore(backend.save(history))
    restored = backend.remember(restored, frames[::-1])
    for found, wanted in zip(restored.recent, history.recent, strict=True):
        assert torch.equal(found, wanted)


@pytest.mark.parametrize("name", ["default", "paper", "hybrid-fast"])
def test_a_camera_that_goes_ahead_does_so_in_the_shaders(name, gl, weights, assert_images_close):
    path = weights(thin(name))
    network, pipeline = models.read(path), glsl.Pipeline.load(path)
    frames, history, resident = [frame.map(lambda t: t[..., :37, :50].contiguous()) for frame in dolly(4)], None, None
    for frame in frames:
        arrays = frame.map(lambda t: t.numpy())
        if history is not None:
            assert pipeline.mismatch(arrays, resident) == pytest.approx(mismatch(frame, history).item(), abs=1e-6)
        image, history = going_ahead(network.step)(frame, history)
        found, resident = pipeline.step(arrays, resident)
        assert_images_close(found, image, "frame")
    for kept, wanted in zip(resident.recent, history.recent, strict=True):
        assert torch.equal(torch.from_numpy(kept.read().view("int32"))[1], wanted[0, 1]), "depth, and blue light"
    if resident.recent:
        again = pipeline.remember(resident, [frame.map(lambda t: t.numpy()) for frame in frames[::-1]])
        for kept, wanted in zip(again.recent, resident.recent, strict=True):
            assert (kept.read() == wanted.read()).all()


def test_a_picture_that_moves_though_its_vectors_are_zero_is_a_cut():
    """As after a render with motion blur. A small thing without vectors is none, nor what has any."""
    g = torch.Generator().manual_seed(0)
    depth = (2 + 3 * torch.rand(1, 1, 6, 8, generator=g)).repeat_interleave(12, 2).repeat_interleave(12, 3)
    still = [replace(frame, depth=depth, motion=0 * frame.motion) for frame in make_frames(2, H=72, W=96)]
    still = [replace(frame, normal=still[0].normal * 0 + 0.6) for frame in still]
    assert mismatch(still[1], geometry(still[0])) == 0
    panned = replace(still[1], depth=depth.roll(3, -1))
    assert mismatch(panned, geometry(still[0])) > MAX_CUT_MISMATCH
    moving = panned.motion.clone()
    moving[..., 0, 0] = 0.5
    assert mismatch(replace(panned, motion=moving), geometry(still[0])) < 0.9 * MAX_CUT_MISMATCH
    ball = depth.clone()
    ball[..., 20:38, 30:48] = 1
    assert mismatch(replace(still[1], depth=ball), geometry(still[0])) < 0.6 * MAX_CUT_MISMATCH


def veiled(frames):
    """Frames behind a veil at depth 1.5 that moves by three pixels more a frame, and hides half of the pixels."""
    g, drawn = torch.Generator().manual_seed(0), []
    for frame in frames:
        veil = torch.rand(frame.depth.shape, generator=g) < 0.5
        still = torch.tensor([3.0, 0.0]).view(1, 2, 1, 1)
        drawn.append(replace(frame, depth=torch.where(veil, 1.5, 3 + 0 * frame.depth),
                             motion=torch.where(veil, still, 0 * frame.motion)))  # fmt: skip
    return drawn


def test_two_halves_are_one_pass_to_the_bit(tmp_path, denoiser):
    frames, history, whole = make_frames(6), None, []
    for frame in frames:
        image, history = denoiser.step(frame, history)
        whole.append(image)

    history = None
    for frame in frames[:3]:
        _, history = denoiser.step(frame, history)
    path = str(tmp_path / "state.safetensors")  # or a Path, as in run/state.py
    save_history(path, history, shot="7")
    history, metadata = load_history(path)
    assert metadata == {"shot": "7"}
    for frame, expected in zip(frames[3:], whole[3:], strict=True):
        image, history = denoiser.step(frame, history)
        assert torch.equal(image, expected)


def test_what_is_no_history_is_named(tmp_path):
    path = tmp_path / "state.safetensors"
    path.write_bytes(b"\x80\x04 pickles are not opened")
    with pytest.raises(InputError, match="not a readable history"):
        load_history(path)
    save_file({"weight": torch.zeros(1)}, path)
    with pytest.raises(InputError, match="holds weight"):
        load_history(path)


@pytest.mark.parametrize("size", [(8, 64), (64, 8), (8, 8), (8, 128), (128, 8)], ids=str)
def test_a_smaller_history_is_a_mean_of_its_pixels(size):
    """Whichever side shrinks: without a filter noise would stay as it is, and most pixels count for nothing."""
    torch.manual_seed(0)
    noise = torch.rand(1, 3, 64, 64)
    radiance = resize(History(noise, motion_next=None, depth=None, normal=None), size).radiance
    assert radiance.shape[2:] == size
    assert radiance.var() < noise.var() / 4


@pytest.mark.parametrize("before", [(1, 1), (7, 5), (16, 16), (40, 17)], ids=str)
def test_shifts_keep_their_cells_however_small_the_picture_was(before):
    image, cells = torch.zeros(1, 3, *before), [-(-n // SHIFT_CELL) for n in before]
    shift = torch.ones(1, 2, *cells)
    history = History(image, motion_next=None, depth=None, normal=None, found=shift, shifts=(shift,))
    carried = resize(history, (33, 97))
    for found in (carried.found, *carried.shifts):
        assert found.shape[2:] == (3, 7)
        torch.testing.assert_close(found[0, :, 1, 1], torch.tensor([97 / before[1], 33 / before[0]]))


@pytest.mark.parametrize("size", [(48, 64), (12, 16), (31, 40)])
def test_history_goes_with_a_change_of_resolution(denoiser, size):
    (before,) = make_frames(1, noise=0.0)
    _, history = denoiser.step(before)
    carried = resize(replace(history, length=torch.full_like(before.depth, 3.0)), size)
    assert all(tuple(tensor.shape[2:]) == size for tensor in carried.layers().values())
    assert carried.radiance.mean().item() == pytest.approx(history.radiance.mean().item(), rel=0.05)
    assert carried.depth.unique().tolist() == [3, 8] and carried.length.unique().tolist() == [3]
    speed = carried.motion_next[:, 0].max().item()
    assert speed == pytest.approx(2 * size[1] / 32)
    (H, W), still = size, torch.zeros(1, 2, *size)
    frame = make_frames(1, H=H, W=W)[0]
    assert denoiser.step(replace(frame, motion=still), carried)[0].isfinite().all()
