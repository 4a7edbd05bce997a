"""Guided self-attention for single frames: its description, any size, windows, training, and the command line."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file
from synthetic import make_frames, write_clips, write_sequence

from rtdenoise.color import albedo_divisor, compress
from rtdenoise.data.clip_file import clip_path, read_layers, write_clip
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate.registry import choose
from rtdenoise.exposure import exposure
from rtdenoise.frame import Frame, Known
from rtdenoise.glsl import Pipeline
from rtdenoise.models import STILLS, GuidedAttentionConfig, create, load, save
from rtdenoise.models.inference import prepare
from rtdenoise.models.presets import from_stored
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.run.tiles import Tiled
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.loop import train
from rtdenoise.training.validate import validate

SMALL = GuidedAttentionConfig(width=8, blocks=2, attention_heads=2)
KINDS = {
    "guided": SMALL,
    "concatenated": replace(SMALL, guide="concatenated"),
    "none": replace(SMALL, guide="none"),
    "kernel": replace(SMALL, output="kernel", kernel=5),
    "no halo": replace(SMALL, halo=0),
    "zeros": replace(SMALL, mirrored=False),
    "control": replace(SMALL, unet=(8, 8, 8)),
}


def make_frame(H=24, W=32, seed=0):
    g = torch.Generator().manual_seed(seed)
    rand = lambda c: torch.rand(1, c, H, W, generator=g)  # noqa: E731
    return Frame(rand(3) ** 4 * 8, albedo=rand(3), normal=rand(3) * 2 - 1, depth=rand(1) * 5 + 1)


def made(config):
    """A network whose heads are no longer near zero, as after training."""
    torch.manual_seed(1)
    model = create(config).eval().requires_grad_(False)
    for head in model.heads:
        torch.nn.init.xavier_uniform_(head.weight)
    return model


@pytest.fixture(scope="module", params=KINDS)
def model(request):
    return made(KINDS[request.param])


def test_the_published_network_has_its_published_size():
    """9,282,691 parameters and 9.77 million multiplications a pixel."""
    config = STILLS["afgsa"]
    assert sum(math.prod(shape) for shape in config.shapes.values()) == 9_282_691
    assert config.multiplications == pytest.approx(9.77e6, rel=1e-3)
    assert (config.blocks, config.block, config.halo, config.attention_heads) == (5, 8, 3, 4)
    assert config.reach == 48


@pytest.mark.parametrize("config", [*KINDS.values(), STILLS["afgsa-small"]], ids=[*KINDS, "afgsa-small"])
def test_the_description_is_what_torch_builds(config):
    built = create(config).state_dict()
    assert {name: tuple(tensor.shape) for name, tensor in built.items()} == config.shapes
    assert from_stored(config.architecture, json.loads(json.dumps(asdict(config)))) == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 10}, "expected a width in 2 heads of an even number each, got 10"),
        ({"width": 4096}, "width: expected 1 to 1024, got 4096"),
        ({"blocks": 0}, "blocks: expected 1 to 16, got 0"),
        ({"halo": 1.5}, "expected whole numbers"),
        ({"kernel": 4}, "kernel: expected an odd size"),
        ({"guide": "both"}, "expected a guide 'guided', 'concatenated' or 'none', got 'both'"),
        ({"mirrored": 1}, "mirrored: expected true or false, got 1"),
        ({"output": "picture"}, "expected an output 'residual' or 'kernel', got 'picture'"),
        ({"unet": (8,)}, "unet: expected 2 to 6 widths"),
    ],
)
def test_impossible_networks_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SMALL, **change)


@pytest.mark.parametrize("size", [(1, 1), (2, 9), (7, 5), (37, 41)])
def test_any_size_goes_in_and_comes_out(model, size):
    image, history = model.step(make_frame(*size))
    assert image.shape == (1, 3, *size) and image.isfinite().all() and image.min() >= 0
    assert torch.equal(model.step(make_frame(*size), history)[0], image)  # history leaves no trace


@pytest.mark.parametrize("config", KINDS.values(), ids=KINDS)
def test_windows_are_the_whole_frame(config, monkeypatch, assert_images_close):
    model, frame = made(config), make_frame(136, 232)
    whole, _ = model.step(frame)
    side = 2 * config.reach + 40
    monkeypatch.setattr("rtdenoise.models.afgsa.MAX_FEATURES", config.width * side**2)
    sizes = []
    filtered = model._filtered
    monkeypatch.setattr(model, "_filtered", lambda x, light: sizes.append(x.shape[2:]) or filtered(x, light))
    with torch.no_grad():
        assert_images_close(model.step(frame)[0].numpy(), whole.numpy(), "float32 tiles")
    assert len(sizes) > 2 and all(side**2 >= H * W for H, W in sizes)


@pytest.mark.parametrize("name", ["guided", "kernel"])
def test_tiles_with_the_statistics_of_the_whole_are_the_whole(name, assert_images_close):
    model, frame = made(KINDS[name]), make_frame(150, 260)
    with torch.inference_mode():
        image, _ = Tiled(model, tile=64).step(frame)
        assert_images_close(image.numpy(), model.step(frame)[0].numpy(), "float32 tiles")


@pytest.mark.parametrize("name", ["guided", "no halo", "kernel", "control"])
def test_nothing_beyond_the_reach_counts(name):
    """From the edge of a window of the grid; and pixels just within do count, so the reach is not idle."""
    config = KINDS[name]
    model, frame = made(config).double(), make_frame(64, 320).to(torch.float64)
    known = Known(sanitised=True, exposure=torch.ones(1, 1, 1, 1), distance=torch.ones(1, 1, 1, 1))
    before, _ = model.step(frame, None, known)
    changed = frame.radiance.clone()
    edge = 160
    changed[..., edge + config.reach :] += 3.0
    after, _ = model.step(replace(frame, radiance=changed), None, known)
    assert torch.equal(after[..., :edge], before[..., :edge])
    assert not torch.equal(after[..., : edge + config.reach], before[..., : edge + config.reach])


def test_scaling_the_radiance_scales_the_output(model):
    frame = make_frame()
    image, _ = model.step(frame)
    for scale in (1e-4, 1e4):
        scaled, _ = model.step(replace(frame, radiance=frame.radiance * scale))
        torch.testing.assert_close(scaled / scale, image, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("layer", ["radiance", "albedo", "normal", "depth"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 3e38])
def test_broken_pixels_never_reach_the_output(model, layer, bad):
    frame = make_frame()
    broken = getattr(frame, layer).clone()
    broken[:, :, 5, 7] = bad
    assert model.step(replace(frame, **{layer: broken}))[0].isfinite().all()


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_constant_features_and_black_frames_are_fine(model, value):
    frame = make_frame()
    flat = {layer: torch.full_like(getattr(frame, layer), value) for layer in ("albedo", "normal", "depth")}
    assert model.step(replace(frame, **flat))[0].isfinite().all()
    assert model.step(replace(frame, radiance=torch.zeros_like(frame.radiance)))[0].isfinite().all()


@pytest.mark.parametrize("layer", ["albedo", "normal", "depth"])
def test_a_missing_layer_is_named(model, layer):
    with pytest.raises(InputError, match=f"layer {layer} is missing; needed are albedo, normal, depth"):
        model.step(replace(make_frame(), **{layer: None}))


def test_features_leave_no_trace_in_values():
    """Where light is even, guided attention has only even values to average, whatever the features show: the picture
    stays even between the borders' reach, but for the extractor of light, which sees light alone."""
    model = made(SMALL)
    frame = make_frame()
    even = replace(frame, radiance=torch.ones_like(frame.radiance))
    torch.testing.assert_close(model.step(even)[0], model.step(replace(even, albedo=1 - frame.albedo))[0])
    joined = made(KINDS["concatenated"])
    assert not torch.allclose(joined.step(even)[0], joined.step(replace(even, albedo=1 - frame.albedo))[0])


def test_kernels_keep_even_light_on_any_texture():
    model, frame = made(KINDS["kernel"]), make_frame()
    lit = replace(frame, radiance=0.3 * albedo_divisor(frame.albedo, frame.depth))
    torch.testing.assert_close(model.step(lit)[0], lit.radiance)


def test_border_rows_are_no_darker():
    """Even light stays even: attention takes the same mean at borders as within."""
    model = made(SMALL)
    frame = replace(make_frame(40, 48), radiance=torch.ones(1, 3, 40, 48))
    values = []
    hooks = [block.register_forward_hook(lambda _m, _i, out: values.append(out)) for block in model.blocks]
    image, _ = model.step(frame)
    for hook in hooks:
        hook.remove()
    for value in (*values, image):
        torch.testing.assert_close(value, value[..., 20:21, 24:25].expand_as(value))


@pytest.mark.parametrize("config", KINDS.values(), ids=KINDS)
def test_gradients_reach_every_parameter(config):
    torch.manual_seed(0)
    model, frame = create(config), replace(make_frame(), reference=make_frame(seed=1).radiance)
    image, _ = model.step(frame)
    loss = model.loss(image, frame, None, None, exposure(frame.reference), 0.0)
    loss.total.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters())
    expected = (
        compress(image * exposure(frame.reference)) - compress(frame.reference * exposure(frame.reference))
    ).abs()
    torch.testing.assert_close(loss.total, expected.mean()[None])
    assert loss.temporal == loss.occlusion == 0


def test_made_ready_to_run_it_computes_the_same(assert_images_close):
    for config in KINDS.values():
        plain, frame = made(config), make_frame(30, 41)
        expected = plain.step(frame)[0]
        ready = prepare(plain, torch.float32)
        assert_images_close(ready.step(frame)[0].numpy(), expected.numpy(), "float32 network")
    low = prepare(made(SMALL), torch.bfloat16).step(frame)[0]
    assert_images_close(low.numpy(), made(SMALL).step(frame)[0].numpy(), "bfloat16 network")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "still.safetensors"
    save(made(SMALL), path)
    return path


def test_a_still_and_a_sequence_from_the_command_line(tmp_path, weights):
    """A sequence needs no motion, and one line says that nothing is carried."""
    shot = write_sequence(tmp_path / "shot", make_frames(3), without=("motion", "motion_next"))
    summary = denoise(str(shot), tmp_path / "out", Options(model=str(weights), float32=True, precision="fp32"))
    assert summary.written == 3 and not summary.cuts and not any(summary.left_out.values())
    assert summary.notes == [f"{weights} denoises each frame alone: nothing is carried from frame to frame"]
    still = shot / "frame.0002.exr"
    alone = denoise(str(still), tmp_path / "still", Options(model=str(weights), float32=True, precision="fp32"))
    assert alone.written == 1 and not alone.notes
    images = [open_sequence(tmp_path / out / "frame.0002.exr")[0].radiance for out in ("out", "still")]
    assert torch.equal(*images)
    model = load(weights, precision="fp32")
    expected, _ = model.step(open_sequence(still)[0])
    torch.testing.assert_close(images[0], expected, rtol=1e-4, atol=1e-5)


def test_moving_frames_are_no_cut_and_runs_resume(tmp_path, weights):
    shot = write_sequence(tmp_path / "shot", make_frames(4))
    options = Options(model=str(weights))
    denoise(str(shot), tmp_path / "whole", options)
    for frame in sorted(shot.glob("*.exr"))[2:]:
        frame.rename(tmp_path / frame.name)
    denoise(str(shot), tmp_path / "parts", options)
    for frame in tmp_path.glob("*.exr"):
        frame.rename(shot / frame.name)
    resumed = denoise(str(shot), tmp_path / "parts", options)
    assert (resumed.written, resumed.skipped, resumed.cuts) in ((2, 2, []), (4, 0, []))
    for name in ("frame.0000.exr", "frame.0003.exr"):
        pair = [open_sequence(tmp_path / out / name)[0].radiance for out in ("whole", "parts")]
        assert torch.equal(*pair)


def test_shaders_are_refused_in_one_line(weights):
    with pytest.raises(
        InputError, match="there are no shaders for networks of the kind 'afgsa'; use the backend torch"
    ):
        Pipeline.load(weights)


def test_it_is_a_row_of_evaluations(weights):
    (method,) = choose([f"still={weights}"])
    image, _ = method.step("cpu", "fp32")(make_frame(), None)
    torch.testing.assert_close(image, load(weights, precision="fp32").step(make_frame())[0])


def test_it_trains_on_single_frames_of_clips(tmp_path):
    data, out = write_clips(tmp_path / "clips", seeds=(1, 2)), tmp_path / "run"
    sizes = "width=8", "blocks=1", "attention_heads=2"
    options = TrainConfig(
        (data,), out, model="afgsa-small", set=sizes, signal="color", steps=60, batch=2, frames=1, size=16, lr=2e-2,
        warmup=1, amp=False,
    )  # fmt: skip
    losses = []
    path = train(options, lambda step, steps, loss: losses.append(loss))
    assert np.mean(losses[-8:]) < 0.9 * np.mean(losses[1:9])
    assert load(path).config == GuidedAttentionConfig(width=8, blocks=1, attention_heads=2)


def test_stills_are_validated_on_clips_of_one_frame(tmp_path):
    stored = ClipDataset(write_clips(tmp_path / "clips", seeds=(1,)))
    (tmp_path / "stills").mkdir()
    layers = {name: layer[0].transpose(1, 2, 0) for name, layer in read_layers(stored.paths[0]).items()}
    write_clip(clip_path(tmp_path / "stills", 0), [layers], {"seed": 1, "generator": 1})
    options = TrainConfig((tmp_path / "clips",), tmp_path / "run", signal="color", amp=False)
    found = validate(made(SMALL), ClipDataset(tmp_path / "stills"), options)
    assert math.isfinite(found["noisy"]) and math.isfinite(found["denoised"])


def test_without_weights_one_line_says_what_to_do():
    with pytest.raises(InputError, match=r"no weights of 'afgsa-small' ship: train them \(rtdenoise train"):
        load("afgsa-small")


def test_weights_of_another_width_are_named(tmp_path):
    path = tmp_path / "wrong.safetensors"
    tensors = {name: np.zeros(shape, np.float32) for name, shape in SMALL.shapes.items()}
    wrong = asdict(replace(SMALL, width=16))
    save_file(tensors, path, {"architecture": "afgsa", "config": json.dumps(wrong)})
    with pytest.raises(InputError, match=r"weights do not fit the configuration: blocks\.0\.columns is"):
        load(path)
