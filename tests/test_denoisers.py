"""Promises of the one-frame step for any weights."""

import math
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

from rtdenoise.baselines.accumulate import Accumulate
from rtdenoise.baselines.svgf import Svgf
from rtdenoise.color import albedo_divisor
from rtdenoise.errors import InputError
from rtdenoise.frame import Frame, geometry
from rtdenoise.models import (
    PRESETS,
    AccumulatedKPN,
    AccumulatedKPNConfig,
    TemporalKPN,
    TemporalKPNConfig,
    available,
    create,
    load,
    load_combiner,
    save,
)
from rtdenoise.ops import apply_kernel
from rtdenoise.sanitise import faults, sanitise
from rtdenoise.splat import history_motion

SMALL = {
    "temporal_kpn": TemporalKPNConfig(widths=(8, 8, 8, 8)),
    "accumulated_kpn": AccumulatedKPNConfig(widths=(8, 8, 8, 8), scales=4, edge_kernel=3, pick_kernel=3, detail=True),
}


def make_frame(H=24, W=32, seed=0):
    g = torch.Generator().manual_seed(seed)

    def rand(c):
        return torch.rand(1, c, H, W, generator=g)

    return Frame(
        radiance=rand(3) ** 4 * 8, albedo=rand(3), normal=rand(3) * 2 - 1, depth=rand(1) * 5 + 1,
        motion=rand(2) * 4 - 2, motion_next=rand(2) * 4 - 2,
    )  # fmt: skip


def lit(denoiser, frame, light):
    """The frame under light of one brightness, in the domain in which the denoiser filters."""
    texture = albedo_divisor(frame.albedo, frame.depth) if isinstance(denoiser, AccumulatedKPN) else 1.0
    return replace(frame, radiance=light * texture * torch.ones_like(frame.radiance))


@pytest.fixture(scope="module", params=SMALL)
def denoiser(request):
    torch.manual_seed(1)
    return create(SMALL[request.param]).eval().requires_grad_(False)


def test_paper_preset_has_the_papers_inputs_outputs_and_size():
    model = TemporalKPN(PRESETS["paper"])
    assert model.unet.encoder[0][0].in_channels == 13
    assert [head.out_channels for head in model.heads] == [51, 26, 26]
    assert sum(p.numel() for p in model.parameters()) <= 1_000_000


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (17, 5), (37, 41), (16, 32)])
def test_any_size_goes_in_and_comes_out(denoiser, size):
    frame = make_frame(*size)
    image, history = denoiser.step(frame)
    again, _ = denoiser.step(frame, history)
    assert image.shape == again.shape == frame.radiance.shape
    assert again.isfinite().all()


@pytest.mark.parametrize("exposure", [1e-4, 1e4])
def test_scaling_the_radiance_scales_the_output(denoiser, exposure):
    frames = [make_frame(seed=s) for s in range(3)]
    history = history_scaled = None
    for frame in frames:
        image, history = denoiser.step(frame, history)
        scaled, history_scaled = denoiser.step(replace(frame, radiance=frame.radiance * exposure), history_scaled)
    torch.testing.assert_close(scaled / exposure, image, rtol=1e-3, atol=1e-5)


def test_grey_stays_grey_and_the_output_is_not_negative(denoiser):
    grey = {k: getattr(make_frame(), k)[:, :1].expand(-1, 3, -1, -1) for k in ("radiance", "albedo")}
    image, _ = denoiser.step(replace(make_frame(), **grey))
    torch.testing.assert_close(image[:, :1].expand_as(image), image)
    assert image.min() >= 0


def test_constant_light_is_kept(denoiser):
    frame = lit(denoiser, replace(make_frame(), albedo=torch.full((1, 3, 24, 32), 0.4)), 0.3)
    image, history = denoiser.step(frame)
    torch.testing.assert_close(image, frame.radiance)
    torch.testing.assert_close(denoiser.step(frame, history)[0], frame.radiance)


def test_off_screen_history_leaves_no_trace(denoiser):
    frame = replace(make_frame(), motion=torch.full((1, 2, 24, 32), 1e3))
    _, history = denoiser.step(make_frame(seed=5))
    assert torch.equal(denoiser.step(frame, history)[0], denoiser.step(frame, None)[0])


def test_dual_and_traditional_motion_differ_only_where_something_was_uncovered():
    motion = torch.zeros(1, 2, 24, 32)
    occluder = torch.zeros(1, 2, 24, 32)
    occluder[:, 0, :, 16:] = 3.0  # the right half has moved on by three pixels
    frame = replace(make_frame(), motion=motion)
    history = geometry(replace(make_frame(seed=3), motion_next=occluder))
    assert torch.equal(history_motion(frame, history, "traditional")[0], motion)
    assert torch.equal(history_motion(frame, history, "dual")[0], -occluder)


def test_dual_motion_is_approximated_without_motion_next():
    """A nearer square moves right by three pixels; the pixels that it uncovers get their motion from the splat."""
    here, before = make_frame(), torch.full((1, 1, 24, 32), 9.0)
    now, motion = before.clone(), torch.zeros(1, 2, 24, 32)
    before[..., 8:16, 8:16] = now[..., 8:16, 11:19] = 4.0
    motion[:, 0, 8:16, 11:19] = -3.0
    uncovered = (before == 4.0) & (now == 9.0)
    history = geometry(replace(make_frame(seed=3), depth=before, motion_next=None))
    frame = replace(here, motion=motion, depth=now)
    expected = torch.where(uncovered, torch.tensor([-3.0, 0.0]).reshape(1, 2, 1, 1), motion)
    assert torch.equal(history_motion(frame, history)[0], expected)
    assert torch.equal(history_motion(frame, history, "traditional")[0], motion)


@pytest.mark.parametrize("layer", ["radiance", "albedo", "normal", "depth", "motion", "motion_next"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_bad_pixels_never_reach_output_or_history(denoiser, layer, bad):
    frame = make_frame()
    broken = getattr(frame, layer).clone()
    broken[:, :, 5, 7] = bad
    frame = replace(frame, **{layer: broken})
    kind = "NaN or negative" if layer == "depth" else "NaN or Inf"
    miss = layer == "depth" and bad == math.inf  # how renderers write it
    assert faults(frame) == ({} if miss else {f"{layer}: {kind}": 1})
    _, history = denoiser.step(frame, None)
    image, history = denoiser.step(frame, history)
    assert image.isfinite().all()
    kept = history.layers().values()
    assert all(t.isfinite().all() for t in kept)


@pytest.mark.parametrize("miss", [1e10, 3.4e38, math.inf])
def test_however_a_renderer_writes_a_miss_it_is_one(denoiser, miss):
    frame = make_frame()
    far, none = frame.depth.clone(), frame.depth.clone()
    far[:, :, :5], none[:, :, :5] = miss, 0
    images = [denoiser.step(replace(frame, depth=depth))[0] for depth in (far, none)]
    assert images[0].isfinite().all() and torch.equal(*images)


def test_the_brightest_radiance_stays_finite(denoiser):
    frame = replace(make_frame(), radiance=torch.full((1, 3, 24, 32), 3e38))
    _, history = denoiser.step(frame)
    assert denoiser.step(frame, history)[0].isfinite().all()


def test_sanitising_changes_nothing_that_is_valid():
    frame = make_frame()
    for (layer, before), (_, after) in zip(frame.layers(), sanitise(frame).layers(), strict=True):
        assert after is before, layer  # looked at, not written


def test_black_frame_stays_black(denoiser):
    frame = replace(make_frame(), radiance=torch.zeros(1, 3, 24, 32))
    image, history = denoiser.step(frame)
    assert image.max() == 0 and denoiser.step(frame, history)[0].max() == 0


@pytest.mark.parametrize("config", SMALL.values(), ids=SMALL)
def test_gradients_reach_every_parameter_through_the_recurrence(config):
    torch.manual_seed(0)
    model, history = create(config), None
    for seed in range(3):
        image, history = model.step(make_frame(seed=seed), history)
    image.square().mean().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters())
    assert any(p.grad.abs().max() > 0 for p in model.heads[0].parameters())


@pytest.mark.parametrize("layer", ["albedo", "normal", "depth"])
def test_a_missing_layer_is_named(denoiser, layer):
    with pytest.raises(InputError, match=f"layer {layer} is missing"):
        denoiser.step(replace(make_frame(), **{layer: None}))


def test_missing_motion_matters_only_with_history(denoiser):
    frame = replace(make_frame(), motion=None)
    _, history = denoiser.step(frame)
    with pytest.raises(InputError, match="layer motion is missing"):
        denoiser.step(frame, history)


def test_history_of_another_size_is_refused(denoiser):
    _, history = denoiser.step(make_frame())
    with pytest.raises(InputError, match="pass history=None"):
        denoiser.step(make_frame(16, 16), history)


def test_history_of_another_kind_of_model_is_refused(denoiser):
    torch.manual_seed(1)
    for other in map(create, SMALL.values()):
        _, history = other.step(make_frame())
        if other.config == denoiser.config:
            denoiser.step(make_frame(), history)
            continue
        with pytest.raises(InputError, match=r"history (has|lacks) 'mean': it is of another kind of model"):
            denoiser.step(make_frame(), history)


@pytest.mark.parametrize("kind", ["Tensor", "tuple", "Frame"])
def test_what_is_no_history_is_refused(kind, denoiser):
    state = {"Tensor": make_frame().radiance, "tuple": (1, 2), "Frame": make_frame()}[kind]
    for step in (denoiser.step, Svgf().step, Accumulate().step):
        with pytest.raises(InputError, match=f"step takes the history that .*, or None, got .*{kind}"):
            step(make_frame(), state)


def test_weights_round_trip(tmp_path, denoiser):
    path = tmp_path / "small.safetensors"
    save(denoiser, path)
    loaded = load(path, precision="fp32")
    assert loaded.config == denoiser.config
    torch.testing.assert_close(loaded.step(make_frame())[0], denoiser.step(make_frame())[0])
    assert load(path, motion="traditional").config.motion == "traditional"


def test_an_override_that_is_none_is_named_and_not_the_file(tmp_path, denoiser):
    path = tmp_path / "small.safetensors"
    save(denoiser, path)
    for overrides, complaint in (
        ({"motin": "dual"}, "motin: not an override of model .*; its configuration has widths, "),
        ({"motion": "sideways"}, "motion: not an override of model .*expected motion 'dual' or 'traditional', got 'si"),
        ({"widths": (8, 8, 8, 8, 8)}, "weights do not fit the configuration with widths as asked for: "),
    ):
        with pytest.raises(InputError, match=complaint):
            load(path, **overrides)


@pytest.mark.parametrize("opened, name", [(load, "fast"), (load_combiner, "combiner")])
def test_a_device_may_be_chosen(opened, name, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert next(opened(name, "auto").parameters()).device.type == "cpu"
    for device, message in (
        ("cuda", "no CUDA device was found"),
        ("cuda:1", "no CUDA device was found"),
        ("x", "unknown device 'x'; expected 'auto', 'cpu', 'cuda' or another of torch's"),
        ("xpu", "device xpu: PyTorch finds none here; take 'auto'"),
    ):
        with pytest.raises(InputError, match=message):
            opened(name, device)


def test_combiners_are_named_where_one_is_missing():
    with pytest.raises(InputError, match="no model 'nosuch': expected one of shrinkage, combiner or the path"):
        load_combiner("nosuch")
    with pytest.raises(InputError, match="no weights of 'drc' ship: train them"):
        load_combiner("drc")


def test_unusable_weights_are_named(tmp_path, denoiser):
    with pytest.raises(InputError, match="no model 'nosuch'"):
        load("nosuch")
    (tmp_path / "text.safetensors").write_text("hello, this is no weights file")
    with pytest.raises(InputError, match="not a readable safetensors file"):
        load(tmp_path / "text.safetensors")
    save_file({"x": torch.zeros(1)}, tmp_path / "bare.safetensors")
    with pytest.raises(InputError, match="no model configuration"):
        load(tmp_path / "bare.safetensors")
    state, kind = denoiser.state_dict(), {"architecture": denoiser.config.architecture}
    save_file(state, tmp_path / "other.safetensors", metadata=kind | {"config": '{"widths": [8, 8, 8, 8, 16]}'})
    with pytest.raises(InputError, match="do not fit the configuration"):
        load(tmp_path / "other.safetensors")
    save_file(state, tmp_path / "future.safetensors", metadata=kind | {"config": '{"wings": 2}'})
    with pytest.raises(InputError, match="not one of this version"):
        load(tmp_path / "future.safetensors")


def test_every_shipped_model_loads():
    for name in available():
        assert load(name).step(make_frame())[0].isfinite().all()


def test_every_fault_is_counted_once_and_gone_after_sanitising():
    frame = make_frame(32, 32)

    def put(layer, *values):
        tensor = getattr(frame, layer).clone()
        for i, value in enumerate(values):
            tensor[0, 0, 4 * i, 3] = value
        return tensor

    broken = replace(
        frame, radiance=put("radiance", math.nan, -1.0, 1e20, 1e6), albedo=put("albedo", math.inf, -1.0, 99.0),
        normal=put("normal", math.nan, 7.0), depth=put("depth", math.nan, -2.0, 1e10), motion=put("motion", math.inf),
    )  # fmt: skip
    assert faults(broken) == {
        "radiance: NaN or Inf": 1, "radiance: negative": 1, "radiance: too bright": 1, "radiance: firefly": 2,
        "albedo: NaN or Inf": 1, "albedo: negative": 1, "albedo: above 2, as of lamps": 1, "normal: NaN or Inf": 1,
        "normal: too long": 1, "depth: NaN or negative": 2, "motion: NaN or Inf": 1,
    }  # fmt: skip
    assert faults(sanitise(broken)) == {}


def test_a_static_pixel_averages_what_it_saw():
    """With the network kept from resetting, the running mean of n frames is their mean, and `length` counts them."""
    model = create(SMALL["accumulated_kpn"]).eval().requires_grad_(False)
    model.full_head.weight[:, -2], model.full_head.bias[-2] = 0.0, -50.0
    still = replace(make_frame(), motion=torch.zeros(1, 2, 24, 32), motion_next=torch.zeros(1, 2, 24, 32))
    frames = [replace(still, radiance=make_frame(seed=s).radiance) for s in range(5)]
    history = None
    for frame in frames:
        _, history = model.step(frame, history)
    mean = torch.stack([frame.radiance for frame in frames]).mean(0) / albedo_divisor(still.albedo, still.depth)
    torch.testing.assert_close(history.mean, mean)
    torch.testing.assert_close(history.mean_albedo, still.albedo)
    torch.testing.assert_close(history.length, torch.full_like(still.depth, 5.0))


def test_the_divisor_has_no_glaring_complement():
    """Gloss on a deep red is white: divided by that red it must not become so cyan that a filter would tint its
    neighbours. Textures of any darkness are taken out, as far as they stand out of the gloss; 1 where nothing was
    hit."""
    red = torch.tensor([0.8, 0.01, 0.0]).reshape(1, 3, 1, 1).expand(1, 3, 1, 2)
    hit, missed = albedo_divisor(red, torch.tensor([[[[2.0, 0.0]]]])).unbind(-1)
    torch.testing.assert_close(hit.flatten(), torch.tensor([0.88, 0.09, 0.08]))
    assert torch.equal(missed.flatten(), torch.ones(3))
    dark = torch.tensor([0.01, 0.05]).reshape(1, 1, 1, 2).expand(1, 3, 1, 2)
    found = albedo_divisor(dark, torch.ones(1, 1, 1, 2))
    assert (found[..., 1] / found[..., 0]).allclose(torch.tensor(0.13 / 0.09))


def test_textures_pass_unfiltered():
    """Even light on any albedo comes out as that albedo: the spatial filters do not blur the divided-out albedo. The
    edge kernel alone sees it."""
    model, frame = create(SMALL["accumulated_kpn"]).eval().requires_grad_(False), make_frame()
    model.full_head.weight[:, -3], model.full_head.bias[-3] = 0.0, 50.0  # the current frame alone
    frame = replace(frame, radiance=0.7 * albedo_divisor(frame.albedo, frame.depth))
    edge = torch.randn(9)
    edges = slice(-23, -14)  # of the full head's rows, before those of the pick kernel, the detail and the shares
    model.full_head.bias[edges] = edge
    smoothed = apply_kernel(frame.radiance, edge.reshape(1, 9, 1, 1).expand(1, 9, *frame.size))
    torch.testing.assert_close(model.step(frame)[0], smoothed)
    model.full_head.bias[edges] = -50 * (torch.arange(9) != 4)
    torch.testing.assert_close(model.step(frame)[0], frame.radiance)


def test_pixels_that_pick_their_own_cell_at_every_scale_show_the_coarsest():
    model, frame = create(SMALL["accumulated_kpn"]).eval().requires_grad_(False), make_frame(H=32, W=48)
    full, coarse = model.config.channels(0), model.config.channels(1)
    rows = [(model.full_head.weight.transpose(0, 1), model.full_head.bias, sum(full[:3]))]
    rows += [(head.weight, head.bias, sum(coarse[:2])) for head in model.heads[:-1]]
    for weight, bias, first in rows:
        weight[first : first + 10] = 0.0
        bias[first : first + 10] = 50.0
        bias[first : first + 9] -= 100.0 * (torch.arange(9) != 4)
    first = sum(full[:2])
    model.full_head.bias[first : first + 9] = -50.0 * (torch.arange(9) != 4)  # no smoothing of edges
    model.full_head.weight[:, -3], model.full_head.bias[-3] = 0.0, 50.0  # the current frame alone
    image, _ = model.step(replace(frame, albedo=torch.ones_like(frame.albedo)))
    side = 2 ** (model.config.scales - 1)
    assert torch.equal(image, image[:, :, ::side, ::side].repeat_interleave(side, 2).repeat_interleave(side, 3))
    assert len(image.unique()) == image.numel() // side**2


def test_history_is_kept_off_other_surfaces():
    """A wall that was lit brightly beside a dark box: no light crosses the edge between them."""
    model = create(SMALL["accumulated_kpn"]).eval().requires_grad_(False)
    model.full_head.weight[:, -2], model.full_head.bias[-2] = 0.0, -50.0
    box = torch.arange(32).expand(1, 1, 24, 32) < 16
    frame = replace(
        make_frame(), albedo=torch.ones(1, 3, 24, 32), depth=torch.where(box, 2.0, 4.0),
        radiance=torch.where(box, 0.0, 100.0).expand(1, 3, 24, 32), motion=torch.full((1, 2, 24, 32), 0.4),
        normal=torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).expand(1, 3, 24, 32),
    )  # fmt: skip
    _, history = model.step(frame)
    _, history = model.step(frame, history)
    torch.testing.assert_close(history.mean, frame.radiance / albedo_divisor(frame.albedo, frame.depth))
