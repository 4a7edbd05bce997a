"""The combiner: exact where there is nothing to correct, bounded where something is broken, the same in strips."""

import math
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import load_file, save_file
from synthetic import make_frames, write_clips

from rtdenoise.baselines import DeepCombiner
from rtdenoise.data.clips import ClipDataset, estimate_path
from rtdenoise.errors import InputError
from rtdenoise.evaluate.estimates import write_all
from rtdenoise.evaluate.registry import choose
from rtdenoise.evaluate.sequence import outputs
from rtdenoise.files import _machine
from rtdenoise.frame import Frame
from rtdenoise.models import (
    COMBINERS,
    Combiner,
    CombinerConfig,
    Shrinkage,
    Window,
    create,
    evidence,
    load,
    load_combiner,
    losses,
    save,
)
from rtdenoise.models import combiner as module
from rtdenoise.models.presets import PRESETS
from rtdenoise.models.window import comparable, two_step
from rtdenoise.training.batches import windows
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.trainer import Trainer
from rtdenoise.training.validate import open_validation

SMALL = {
    "ours": CombinerConfig(widths=(6, 8, 8)),
    "causal": CombinerConfig(widths=(6, 8, 8), frames=3, causal=True),
    "drc": replace(COMBINERS["drc"], widths=(4, 6, 6, 8)),
    "no residual as input": CombinerConfig(widths=(6, 8, 8), residual_input=False, statistics=False),
}
configs = pytest.mark.parametrize("config", SMALL.values(), ids=SMALL.keys())


def make(config, seed=0):
    torch.manual_seed(seed)
    return Combiner(config).eval().requires_grad_(False)


def window_of(config, estimate="reference", H=27, W=34, **kwargs):
    """A window of the synthetic sequence; `estimate` names the layer that is taken for z."""
    frames = make_frames(config.frames, H=H, W=W, **kwargs)
    return Window(tuple(frames), tuple(getattr(frame, estimate) for frame in frames))


def select(model, place, tap=None):
    """Make the model give all weight to one tap of the frame at `place` at full size, and none to coarser scales."""
    offset, middle = model.config.offsets[place], model.config.kernel**2 // 2
    for scale in model.heads:
        for head in scale.values():
            head.weight.zero_()
            head.bias.zero_()
    full = model.heads[0]
    full["shares"].bias.unflatten(0, (-1, model.config.frames))[:, place] = 1e4
    full[f"taps{offset:+d}"].bias.unflatten(0, (-1, model.config.kernel**2))[:, middle if tap is None else tap] = 1e4
    if "pick_share" in full:
        full["pick_share"].bias.fill_(-1e4)
    return model


@pytest.mark.parametrize("name", COMBINERS)
def test_weights_have_the_shapes_that_the_configuration_says(name):
    found = {key: tuple(value.shape) for key, value in Combiner(COMBINERS[name]).state_dict().items()}
    assert found == COMBINERS[name].shapes


@configs
def test_nothing_to_correct_returns_the_estimate_to_the_bit(config):
    window = window_of(config, "radiance")
    combined = make(config).combine(window)
    assert torch.equal(combined.image, window.frames[config.current].radiance)
    assert (combined.confidence == 0).all()


@configs
def test_all_weight_on_the_own_tap_returns_the_noisy_frame(config):
    config = replace(config, evidence=False)
    window = window_of(config)
    model = select(make(config), config.current)
    expected, _ = comparable(window.frames[config.current].radiance, window.estimates[config.current])
    torch.testing.assert_close(model.combine(window).image, expected, rtol=1e-5, atol=1e-5)


@configs
def test_residuals_of_another_frame_arrive_along_its_motion(config):
    """One residual pixel on the square of the frame two before moves four pixels to the right with it."""
    config = replace(config, relative=False, evidence=False)
    window = window_of(config)
    place = config.current - 2
    frames = [replace(frame, radiance=frame.reference) for frame in window.frames]
    lit = frames[place].radiance.clone()
    column = 6 + 2 * place + 3
    lit[0, :, 9, column] += 0.5
    frames[place] = replace(frames[place], radiance=lit)
    window = Window(tuple(frames), window.estimates)
    change = select(make(config), place).combine(window).image - window.estimates[config.current]
    assert change[0, :, 9, column + 4].allclose(torch.tensor(0.5), atol=1e-5)
    change[0, :, 9, column + 4] = 0
    assert change.abs().max() < 1e-5


@configs
def test_constant_residuals_are_added_whole_or_not_at_all(config):
    """The frame's own share times a constant residual, whatever the kernels; neighbours agree where they are seen.
    Scales with shares of their own overshoot a little when they are composed."""
    config = replace(config, relative=False)
    flat = [replace(frame, radiance=torch.full_like(frame.radiance, 2.0)) for frame in window_of(config).frames]
    window = Window(tuple(flat), tuple(torch.full_like(frame.radiance, 1.5) for frame in flat))
    for frame in flat:
        for layer in ("motion", "motion_next"):
            getattr(frame, layer).zero_()
        frame.depth.fill_(4.0)
    correction = make(config).combine(window).image - 1.5
    overshoot = 0.02 if config.evidence else 1e-5
    assert correction.min() >= -overshoot and correction.max() <= 0.5 + overshoot
    if not config.evidence:
        torch.testing.assert_close(correction, torch.full_like(correction, 0.5), rtol=0, atol=1e-5)


@configs
@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_scales_with_the_light(config, scale):
    model, window = make(config), window_of(config)
    scaled = Window(
        tuple(replace(frame, radiance=frame.radiance * scale) for frame in window.frames),
        tuple(estimate * scale for estimate in window.estimates),
    )
    torch.testing.assert_close(
        model.combine(scaled).image / scale, model.combine(window).image, rtol=2e-3, atol=2e-3
    )  # fmt: skip


@configs
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_a_bad_pixel_counts_as_no_residual(config, bad):
    """The output is the one for y = z at that pixel, so nothing spreads from it."""
    model, window = make(config), window_of(config)
    place = config.current
    for layer in ("noisy", "estimate"):
        broken, mended = window, window
        for value in ("bad", "good"):
            frames, estimates = [*window.frames], [*window.estimates]
            y, z = frames[place].radiance.clone(), estimates[place].clone()
            target, other = (y, z) if layer == "noisy" else (z, y)
            target[0, :, 8, 9] = bad if value == "bad" else other[0, :, 8, 9]
            frames[place], estimates[place] = replace(frames[place], radiance=y), z
            made = Window(tuple(frames), tuple(estimates))
            broken, mended = (made, mended) if value == "bad" else (broken, made)
        image = model.combine(broken).image
        assert image.isfinite().all()
        torch.testing.assert_close(image, model.combine(mended).image, rtol=1e-5, atol=1e-5)


@configs
@pytest.mark.parametrize("layer", ["noisy", "estimate", "both"])
def test_a_pixel_as_bright_as_float32_allows_breaks_no_picture(config, layer):
    model, window = make(config), window_of(config)
    for place in range(config.frames):
        frames, estimates = [*window.frames], [*window.estimates]
        y, z = frames[place].radiance.clone(), estimates[place].clone()
        for image in {"noisy": (y,), "estimate": (z,), "both": (y, z)}[layer]:
            image[0, 1, 8, 9] = 3e38
        frames[place], estimates[place] = replace(frames[place], radiance=y), z
        for combiner in (model, Shrinkage()) if config.frames == 5 else (model,):
            combined = combiner.combine(Window(tuple(frames), tuple(estimates)))
            assert combined.image.isfinite().all() and combined.confidence.isfinite().all()


@configs
def test_a_bad_pixel_of_the_estimate_leaves_the_others_to_the_bit(config):
    window = window_of(config, "radiance")
    place = config.current
    estimate = window.estimates[place] - 0.1  # a denoiser may have made light that is negative
    estimate[0, 1, 8, 9] = float("nan")
    frames, estimates = [*window.frames], [*window.estimates]
    frames[place], estimates[place] = replace(frames[place], radiance=estimate.clone()), estimate
    image = make(config).combine(Window(tuple(frames), tuple(estimates))).image
    estimate[0, :, 8, 9] = image[0, :, 8, 9]
    assert torch.equal(image, estimate)


@configs
def test_a_neighbour_of_another_surface_leaves_no_trace(config):
    model, window = make(config), window_of(config)
    far = [
        frame if i == config.current else replace(frame, depth=frame.depth * 100)
        for i, frame in enumerate(window.frames)
    ]
    bright = [
        frame if i == config.current else replace(frame, radiance=frame.radiance * 50) for i, frame in enumerate(far)
    ]
    images = [model.combine(Window(tuple(frames), window.estimates)).image for frames in (far, bright)]
    assert torch.equal(*images)


@configs
def test_frames_beyond_a_missing_one_are_not_used(config):
    model, window = make(config), window_of(config)
    missing = config.current - 1

    def without(*places):
        return Window(
            *(
                tuple(None if i in places else x for i, x in enumerate(part))
                for part in (window.frames, window.estimates)
            )
        )

    beyond = range(missing + 1)
    assert torch.equal(model.combine(without(missing)).image, model.combine(without(*beyond)).image)
    assert not torch.equal(model.combine(without(missing)).image, model.combine(window).image)


@configs
def test_without_motion_the_current_frame_alone_is_used(config):
    model, window = make(config), window_of(config)
    still = tuple(replace(frame, motion=None, motion_next=None) for frame in window.frames)
    alone = tuple(frame if i == config.current else None for i, frame in enumerate(still))
    image = model.combine(Window(still, window.estimates)).image
    assert torch.equal(image, model.combine(Window(alone, window.estimates)).image)


@configs
def test_missing_features_are_those_of_a_white_wall(config):
    model, window = make(config), window_of(config)
    bare = tuple(replace(frame, albedo=None, normal=None, depth=None) for frame in window.frames)
    white = tuple(
        replace(frame, albedo=torch.ones_like(frame.radiance), normal=torch.zeros_like(frame.radiance),
                depth=torch.ones_like(frame.depth)) for frame in window.frames
    )  # fmt: skip
    images = [model.combine(Window(frames, window.estimates)).image for frames in (bare, white)]
    assert torch.equal(*images)


@pytest.mark.parametrize("half_size", [True, False])
@pytest.mark.parametrize("size", [(40, 34), (37, 33)])
def test_strips_are_the_whole(half_size, size, monkeypatch):
    config = CombinerConfig(widths=(6, 8, 8, 8), half_size=half_size, kernel=7, scales=3)
    model, window = make(config), window_of(config, H=size[0], W=size[1])
    whole = model.combine(window).image
    monkeypatch.setattr(module, "MAX_LOGITS", 49 * size[1] * 8)
    torch.testing.assert_close(model.combine(window).image, whole, rtol=1e-5, atol=1e-5)


def test_gradients_of_strips_are_those_of_the_whole(monkeypatch):
    config, gradients = CombinerConfig(widths=(4, 6), scales=2, kernel=7), []
    window = window_of(config, H=24, W=16)
    for limit in (1 << 25, 49 * 16 * 8):
        monkeypatch.setattr(module, "MAX_LOGITS", limit)
        model = make(config).requires_grad_(True)
        model.loss(model.combine(window), window.frames[2], window.estimates[2]).backward()
        gradients.append(torch.cat([p.grad.flatten() for p in model.parameters()]))
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("H, W", [(1, 1), (1, 7), (5, 2), (16, 16)])
def test_any_size(H, W):
    config = SMALL["ours"]
    frames = [frame.crop(0, 0, H, W) for frame in make_frames(5)]
    image = make(config).combine(Window(tuple(frames), tuple(frame.reference for frame in frames))).image
    assert image.shape == (1, 3, H, W) and image.isfinite().all()


def test_a_window_of_another_length_is_refused():
    window = window_of(SMALL["ours"])
    with pytest.raises(ValueError, match="window of 5 frames"):
        make(SMALL["ours"]).combine(Window(window.frames[:3], window.estimates[:3]))


@pytest.mark.parametrize("estimate", [None, torch.rand(1, 3, 27, 35), torch.rand(1, 3, 27, 34).numpy()[0]])
def test_an_estimate_that_is_none_of_the_frame_is_refused(estimate):
    window = window_of(SMALL["ours"])
    estimates = (*window.estimates[:4], estimate)
    for combiner in (make(SMALL["ours"]), Shrinkage()):
        with pytest.raises(ValueError, match="as the estimate of a frame"):
            combiner.combine(replace(window, estimates=estimates))


def test_two_steps_fetch_the_second_motion_where_the_first_leads():
    first, second = torch.zeros(1, 2, 4, 6), torch.zeros(1, 2, 4, 6)
    first[0, 0, 1, 2] = 2.0  # pixel (2, 1) goes to (4, 1)
    second[0, :, 1, 4] = torch.tensor([-1.0, 2.0])
    assert two_step(first, second)[0, :, 1, 2].tolist() == [1.0, 2.0]
    first[0, 0, 1, 2] = 9.0
    assert two_step(first, second)[0, 0, 1, 2] > 1000


def test_fireflies_that_the_estimate_has_too_stay():
    y = torch.ones(1, 3, 32, 32)
    y[0, :, 10, 10] = 1000.0
    noisy, estimate = comparable(y, torch.ones_like(y))
    assert noisy[0, 0, 10, 10] < 100
    noisy, estimate = comparable(y, y)
    assert torch.equal(noisy, y) and torch.equal(estimate, y)


def test_smape_by_hand():
    image, reference = torch.tensor([1.0, 2.0, 0.0]), torch.tensor([1.0, 1.0, 1.0])
    image, reference = (x.reshape(1, 3, 1, 1) for x in (image, reference))
    assert losses.smape(image, reference).item() == pytest.approx(2 / 6.01)
    assert losses.smape_ratio(image, image, reference).item() == pytest.approx(1)


def test_a_denoiser_is_no_combiner_and_the_reverse(tmp_path):
    save(create(SMALL["ours"]), tmp_path / "combiner.safetensors")
    assert load_combiner(tmp_path / "combiner.safetensors").config == SMALL["ours"]
    with pytest.raises(InputError, match="is a combiner"):
        load(tmp_path / "combiner.safetensors")
    with pytest.raises(InputError, match="is a denoiser"):
        load_combiner("fast")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = write_clips(tmp_path_factory.mktemp("clips"), range(4), size=16)
    assert write_all([folder], ["svgf", "fast"], ["color"]) == 8
    return folder


def test_estimates_are_of_the_clips_own_frames_and_kept(clips):
    both = ClipDataset(clips).load(1, signal="color", estimates="svgf")
    assert len(both) == 8 and torch.equal(both[0].reference, both[4].reference)
    assert not torch.equal(both[0].radiance, both[4].radiance)
    assert write_all([clips], ["svgf"], ["color"]) == 0
    assert write_all([clips], ["svgf"], ["color", "indirect"]) == 4
    with pytest.raises(InputError, match="rtdenoise estimates"):
        ClipDataset(clips).load(1, signal="indirect", estimates="fast")


def test_clips_with_a_lead_in_have_estimates_of_it_too(tmp_path):
    folder = write_clips(tmp_path, range(1), size=16, lead_in=2)
    assert write_all([folder], ["accumulate"], ["color"]) == 1
    path = estimate_path(ClipDataset(folder).paths[0], "accumulate")
    assert load_file(path)["color"].shape == (6, 3, 16, 16)
    both = ClipDataset(folder).load(0, signal="color", estimates="accumulate")
    assert [frame.number for frame in both] == 2 * [2, 3, 4, 5]
    assert not torch.equal(both[4].radiance, both[0].radiance)  # history of the lead-in is in it
    assert both[4].reference.any()


def test_estimates_of_other_weights_or_of_another_clip_are_made_anew(clips, tmp_path):
    folder, weights = shutil.copytree(clips, tmp_path / "clips"), tmp_path / "mine.safetensors"
    for seed in (0, 1):
        torch.manual_seed(seed)
        save(create(PRESETS["fast"]), weights)
        assert write_all([folder], [f"mine={weights}"], ["color"]) == 4
    assert write_all([folder], [f"mine={weights}"], ["color"]) == 0
    first, second = ClipDataset(folder).paths[:2]
    shutil.copyfile(second, first)
    assert write_all([folder], [f"mine={weights}"], ["color"]) == 1


@pytest.mark.parametrize("damage", ["another size", "not finite", "integers", "junk"])
def test_a_damaged_estimate_is_one_line(clips, tmp_path, damage):
    folder = shutil.copytree(clips, tmp_path / "clips")
    path = estimate_path(ClipDataset(folder).paths[0], "fast")
    light = load_file(path)["color"]
    changed = {"another size": light[..., :8], "not finite": light * math.nan, "integers": light.int()}.get(damage)
    path.unlink()
    path.write_bytes(b"junk") if changed is None else save_file({"color": changed.contiguous()}, path)
    with pytest.raises(InputError, match=re.escape(str(path))):
        ClipDataset(folder).load(0, signal="color", size=4, estimates="fast")


def test_what_killed_runs_left_among_the_estimates_is_removed(clips):
    left = clips / "svgf" / f".rtdenoise-999999999-{_machine()}00000000.tmp"
    left.touch()
    assert write_all([clips], ["svgf"], ["color"]) == 0 and not left.exists()


def test_training_corrects_the_estimate(clips, tmp_path, monkeypatch):
    monkeypatch.setitem(COMBINERS, "tiny", SMALL["causal"])
    config = TrainConfig(
        data=(clips,), out=tmp_path / "run", model="tiny", estimates=("svgf", "fast"), signal="color", frames=3,
        size=16, batch=4, steps=60, lr=0.1, amp=False,
    )  # fmt: skip
    trainer, data = Trainer(config), ClipDataset(clips)
    rows = [trainer.train_step(trainer.task.batch(data, config, step % 10)) for step in range(60)]
    assert sum(row["loss"] for row in rows[-10:]) < 0.995 * sum(row["loss"] for row in rows[:10])
    found = trainer.task.validate(trainer.average, data, config)
    assert found.keys() == {"estimate", "denoised"}


def test_of_both_signals_combiners_are_validated_on_beauty(clips, tmp_path, monkeypatch):
    """As docs/use/training.md says, other networks on indirect light."""
    load, asked = ClipDataset.load, []
    monkeypatch.setattr(ClipDataset, "load", lambda *a, **kw: asked.append(kw["signal"]) or load(*a, **kw))
    for model, estimates in (("combiner", ("fast",)), ("default", ())):
        config = TrainConfig((clips,), tmp_path, val=clips, model=model, signal="both", estimates=estimates)
        open_validation(config, SimpleNamespace(scenes=set))
    assert asked == ["color"] * 4 + ["indirect"] * 4


def test_windows_of_any_length_keep_their_current_frame(clips):
    for settings, count, current in (((), 5, 2), (("frames=1",), 1, 0), (("frames=3",), 3, 1)):
        config = TrainConfig(
            data=(clips,), out=clips, model="combiner", set=settings, estimates=("svgf",), signal="color",
            frames=count, size=16, batch=1, amp=False,
        )  # fmt: skip
        if count <= len(ClipDataset(clips).load(0)):
            found = [windows(ClipDataset(clips), config, step) for step in range(40)]
            assert all(window.frames[current] is not None for window in found)
            assert count == 1 or any(None in window.frames for window in found)


def test_a_run_with_another_number_of_frames_is_refused(tmp_path):
    from rtdenoise.training.trainer import check

    with pytest.raises(InputError, match="5 frames, got 9"):
        check(TrainConfig(data=(tmp_path,), out=tmp_path, model="combiner", frames=9))


# --- baselines and evaluation -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("combiner", [Shrinkage(), DeepCombiner(), DeepCombiner(softmax=True)])
def test_baselines_leave_what_agrees(combiner):
    window = window_of(SMALL["ours"], "radiance")
    with torch.no_grad():
        torch.testing.assert_close(combiner.combine(window).image, window.frames[2].radiance, rtol=0, atol=0)


def halves(noise, bias, size=64):
    """Two noisy pictures of 1, and a denoised one that is wrong by `bias`."""
    first, second = (1 + noise * torch.randn(1, 3, size, size) for _ in range(2))
    return first.clamp(min=0), second.clamp(min=0), torch.full_like(first, 1 + bias)


def window_of_pictures(pictures, z, samples=None, motion=True):
    """Five noisy pictures of a flat white wall that stands still, and its estimates."""

    def frame(y):
        B, _, H, W = y.shape
        still = torch.zeros(B, 2, H, W) if motion else None
        wall = torch.ones(B, 1, H, W)
        return Frame(y, torch.ones_like(y), torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1).expand_as(y), wall, still,
                     still, samples=None if samples is None else samples * wall)  # fmt: skip

    return Window(tuple(map(frame, pictures)), (z,) * len(pictures))


def errors_of(*images):
    return [(image - 1).square().mean().item() for image in images]


@pytest.mark.parametrize("with_halves", [True, False])
@pytest.mark.parametrize(("noise", "bias"), [(0.02, 0.3), (0.3, 0.0), (0.15, 0.2), (0.3, 0.02)])
def test_shrinkage_takes_the_better_of_both(with_halves, noise, bias):
    """Little noise and a large bias: about the noisy pictures; the reverse: the denoised one; else better than it."""
    first, second = ([(1 + noise * torch.randn(1, 3, 64, 64)).clamp(min=0) for _ in range(5)] for _ in range(2))
    z = torch.full_like(first[0], 1 + bias)
    window = window_of_pictures([(a + b) / 2 for a, b in zip(first, second, strict=True)], z)
    if with_halves:
        window = replace(window, halves=tuple(first))
    error, of_y, of_z = errors_of(Shrinkage().combine(window).image, window.frames[2].radiance, z)
    assert error < 1.05 * of_z + 1e-9 and error < 1.2 * max(min(of_y, of_z), 0.1 * of_y)


def test_shrinkage_leaves_a_frame_that_nothing_speaks_against():
    y = torch.rand(1, 3, 16, 16)
    alone = Window((None, None, Frame(y), None, None), (None, None, y + 0.1, None, None))
    assert torch.equal(Shrinkage().combine(alone).image, y + 0.1)
    still = window_of_pictures([y] * 5, y + 0.1, motion=False)
    assert torch.equal(Shrinkage().combine(still).image, y + 0.1)


def test_the_same_share_of_error_is_found_in_any_light_without_albedo():
    """Every frame has light of its own; z is 1.3 times as bright as each."""
    torch.manual_seed(0)
    pictures = [0.5 + torch.rand(1, 3, 32, 32).square() * 4 for _ in range(5)]
    window = window_of_pictures(pictures, pictures[0], samples=4)
    window = replace(window, estimates=tuple(1.3 * picture for picture in pictures))
    image = Shrinkage().combine(window).image
    torch.testing.assert_close(image, pictures[2], rtol=0.05, atol=0)
    textured = tuple(replace(f, albedo=torch.rand_like(f.radiance)) for f in window.frames)
    assert torch.equal(Shrinkage().combine(replace(window, frames=textured)).image, image)


def test_shrinkage_corrects_edges_of_frames_with_samples_enough():
    """One sample of an edge pixel shows one surface: its residual repeats though z is right."""
    z, y = torch.full((1, 3, 32, 32), 1.5), torch.full((1, 3, 32, 32), 1.0)
    for samples, corrected in ((None, False), (1, False), (torch.nan, False), (4, True)):
        window = window_of_pictures([y + 0.01 * torch.randn_like(y) for _ in range(5)], z, samples)
        stepped = tuple(replace(f, depth=f.depth + 9 * (torch.arange(32) >= 16)) for f in window.frames)
        image = Shrinkage().combine(replace(window, frames=stepped)).image
        assert (image[..., 15:17].mean() < 1.1) == corrected and image[..., :12].mean() < 1.1


def test_the_recurrent_form_finds_a_lasting_error_and_forgets_it_at_cuts():
    from rtdenoise.frame import History
    from rtdenoise.models.shrinkage import MAX_LENGTH, correct

    torch.manual_seed(3)
    window = window_of_pictures([(1 + 0.2 * torch.randn(1, 3, 48, 48)).clamp(min=0) for _ in range(12)], torch.ones(1))
    z, history, errors = torch.full((1, 3, 48, 48), 1.3), None, []
    for frame in window.frames:
        onward = History(z, frame.motion_next, frame.depth, frame.normal)
        image, history = correct(frame, z, history, onward)
        errors += errors_of(image)
    assert errors[0] == pytest.approx(0.09) and errors[1] < 0.05 and errors[-1] < 0.01
    assert history.residual_length.max() == MAX_LENGTH
    image, _ = correct(window.frames[0], z, None, onward)
    assert torch.equal(image, z)


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
def test_the_recurrent_form_counts_every_frame_wherever_motion_leads(frames):
    from rtdenoise.frame import History
    from rtdenoise.models.shrinkage import correct

    (frame,) = window_of_pictures([torch.ones(1, 3, 96, 96)], torch.ones(1)).frames
    frame = replace(frame, motion=torch.rand(1, 2, 96, 96) - 0.5)
    onward = History(frame.radiance, frame.motion_next, frame.depth, frame.normal)
    lengths = torch.full_like(frame.depth, float(frames))
    history = replace(onward, residual=torch.zeros_like(frame.radiance), residual_length=lengths)
    _, after = correct(frame, frame.radiance, history, onward)
    assert (after.residual_length == frames + 1).all()


def test_an_untrained_network_corrects_as_far_as_the_frames_agree():
    torch.manual_seed(1)
    pictures = [(1 + 0.1 * torch.randn(1, 3, 48, 48)).clamp(min=0) for _ in range(5)]
    for bias, better in ((0.3, 0.1), (0.0, 1.3)):
        z = torch.full((1, 3, 48, 48), 1 + bias) + 0.05 * torch.randn(1, 3, 48, 48)
        window = window_of_pictures(pictures, z, samples=16)
        error, of_z = errors_of(make(COMBINERS["combiner"]).combine(window).image, z)
        assert error < better * of_z


def test_the_share_of_a_correction_stays_within_its_bounds():
    change = evidence.bounded(torch.tensor([-1e4, -0.01, 0.0, 0.01, 1e4]))
    torch.testing.assert_close(change, torch.tensor([-evidence.MAX_LESS, -0.01, 0.0, 0.01, evidence.MAX_MORE]))
    residual = torch.ones(1, 3, 8, 8)
    alone = evidence.evidence([None, residual, None], [None, residual[:, :1], None], 1, residual[:, :1])
    agreed = evidence.evidence([residual] * 3, [residual[:, :1]] * 3, 1, residual[:, :1])
    unbelieved = evidence.evidence([residual] * 3, [residual[:, :1]] * 3, 1, 0 * residual[:, :1])
    assert (alone.sigmoid() == 0).all()
    assert (agreed.sigmoid() > 0.979).all() and (unbelieved.sigmoid() < 0.021).all()


def test_a_network_reads_two_halves_first():
    torch.manual_seed(1)
    first, second = ([(1 + 0.02 * torch.randn(1, 3, 32, 32)) for _ in range(5)] for _ in range(2))
    z = torch.full((1, 3, 32, 32), 1.3)
    window = window_of_pictures([(a + b) / 2 for a, b in zip(first, second, strict=True)], z)
    still = replace(window, frames=tuple(replace(f, motion=None, motion_next=None) for f in window.frames))
    model = make(SMALL["ours"])
    without, combined = (model.combine(replace(still, halves=h)) for h in ((), tuple(first)))
    assert errors_of(combined.image)[0] < 0.2 * errors_of(without.image)[0]
    torch.testing.assert_close(combined.confidence, (combined.image - z).abs().mean(1, keepdim=True))


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_shrinkage_scales_with_the_light(scale):
    pictures = [(1 + 0.1 * torch.randn(1, 3, 32, 32)).clamp(min=0) for _ in range(5)]
    window, scaled = (window_of_pictures([s * y for y in pictures], torch.full_like(pictures[0], 1.2 * s)) for s in
                      (1.0, scale))  # fmt: skip
    images = [Shrinkage().combine(one).image for one in (window, scaled)]
    torch.testing.assert_close(images[1] / scale, images[0], rtol=1e-4, atol=1e-5)


def test_shrinkage_is_finite_whatever_comes():
    window = window_of_pictures([torch.rand(1, 3, 24, 24) for _ in range(5)], torch.rand(1, 3, 24, 24))
    bad = window.frames[2].radiance.clone()
    bad[0, 0, 5, 5], bad[0, 1, 9, 9] = torch.nan, torch.inf
    frames = (*window.frames[:2], replace(window.frames[2], radiance=bad), *window.frames[3:])
    spoiled = window.estimates[2].clone()
    spoiled[0, 2, 7, 7] = torch.nan
    estimates = (*window.estimates[:2], spoiled, *window.estimates[3:])
    for halves in ((), tuple(frame.radiance for frame in frames)):
        combined = Shrinkage().combine(Window(frames, estimates, halves))
        assert combined.image.isfinite().all() and combined.confidence.isfinite().all()
        assert (combined.image >= 0).all()


def test_the_deep_combiner_in_strips_is_the_whole(monkeypatch):
    network, window = DeepCombiner().eval(), window_of(SMALL["ours"])
    with torch.no_grad():
        whole = network.combine(window).image
        monkeypatch.setattr("rtdenoise.baselines.deep_combiner.STRIP", 8)
        torch.testing.assert_close(network.combine(window).image, whole, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("softmax", [False, True])
def test_weights_of_the_deep_combiner_tell_how_they_were_trained(softmax, tmp_path):
    network, window = DeepCombiner(softmax), window_of(SMALL["ours"])
    network.save(tmp_path / "dc.safetensors")
    with torch.no_grad():
        assert torch.equal(
            DeepCombiner.load(tmp_path / "dc.safetensors").combine(window).image, network.combine(window).image
        )
        network.layers[2].bias[0] = math.nan
    network.save(tmp_path / "dc.safetensors")
    with pytest.raises(InputError, match="not finite"):
        DeepCombiner.load(tmp_path / "dc.safetensors")


def test_a_corrected_method_looks_ahead_and_ends_with_the_shot(tmp_path):
    save(create(SMALL["ours"]), tmp_path / "small.safetensors")
    (method,) = choose([f"svgf+{tmp_path / 'small.safetensors'}"])
    assert (method.name, method.delay) == ("svgf+small", 2)
    frames = make_frames(7, H=16, W=16)
    images = [output.image for output in outputs(method.step(), frames, method.delay, cuts=[4, 6])]
    estimates = [output.image for output in outputs(choose(["svgf"])[0].step(), frames, cuts=[4, 6])]
    model = load_combiner(tmp_path / "small.safetensors")
    for i, shot in ((1, range(4)), (3, range(4)), (4, range(4, 6)), (5, range(4, 6)), (6, range(6, 7))):
        places = [p if p in shot else None for p in range(i - 2, i + 3)]
        window = Window(*(tuple(None if p is None else part[p] for p in places) for part in (frames, estimates)))
        assert torch.equal(images[i], model.combine(window).image)
    with pytest.raises(InputError, match="is no combiner"):
        choose(["svgf+fast"])
