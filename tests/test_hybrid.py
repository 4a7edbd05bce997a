"""Kernels and a network that writes pixels, mixed (`models.hybrid`)."""

import json
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import save as serialise
from synthetic import assert_goes_on, make_frames, write_sequence

from rtdenoise.baselines import Oidn
from rtdenoise.color import compress
from rtdenoise.constants import EVENED_NOISE, MIX_SHARES_OF_MANY, PIXELS_LIGHT
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate.demo import SAMPLE
from rtdenoise.exposure import noise_level
from rtdenoise.frame import OFF_SCREEN
from rtdenoise.models import HybridConfig, create, grow, hybrid, load, read, save
from rtdenoise.models.accumulated_kpn import AccumulatedKPN
from rtdenoise.models.footprint import footprint, footprint_of, reset_of_footprint, seen
from rtdenoise.models.past import reprojected
from rtdenoise.models.pixel_network import PixelNetwork, written
from rtdenoise.models.presets import PRESETS
from rtdenoise.models.weights import files_of, find, has_bytes
from rtdenoise.ops.around import expand_within
from rtdenoise.ops.dispatch import use
from rtdenoise.ops.glow import away_from_glow, left_by_glow
from rtdenoise.ops.lift import lower
from rtdenoise.ops.mix import mix
from rtdenoise.ops.pixels import demodulate
from rtdenoise.run.denoise import Options
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import history_motion

ROOT = Path(__file__).parent.parent
SMALL = HybridConfig(
    widths=(8, 8, 8, 8), scales=4, edge_kernel=3, detail=True, recent=3, down=(8, 12, 4), up=(12, 8), out=(8, 4)
)
CLEAN = replace(SMALL, twice=True, clean=True)
NETWORKS = {"hybrid": "balanced", "hybrid-fast": "fast", "hybrid-large": "large"}  # model -> as `begin_hybrid` has it


@pytest.fixture
def model():
    torch.manual_seed(0)
    return create(SMALL).eval().requires_grad_(False)


def shares(monkeypatch, kernels, before=0.0):
    """Set the shares of the kernels' image and of the previous picture, whatever the noisy frame tells."""

    def shared(first, other, scale, trust, _, past, held, *__):
        return mix(first, other, scale, trust, (kernels, before, kernels), past, held)

    monkeypatch.setattr(hybrid, "mix", shared)


def trusting(model, reset=-100.0):
    """The model with the reset of its kernels set by hand: a logit."""
    model.full_head.weight[:, -2] = 0
    model.full_head.bias[-2] = reset
    return model


@contextmanager
def watched(model, shown):
    """Collects the light that the network which writes pixels sees, at the exposure that it has there."""
    hook = model.pixels.register_forward_pre_hook(lambda _, inputs: shown.append(lower(inputs[0])))
    yield
    hook.remove()


def scale_of(model, frame):
    """That exposure."""
    return PIXELS_LIGHT * model.statistics(sanitise(frame))[0]


def play(model, frames):
    """The images of consecutive frames."""
    images, history = [], None
    for frame in frames:
        image, history = model.step(frame, history)
        images.append(image)
    return images


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (17, 5), (37, 41), (16, 32)])
def test_any_size_goes_in_and_comes_out(model, size):
    images = play(model, make_frames(3, *size))
    assert all(image.shape == (1, 3, *size) and image.isfinite().all() and image.min() >= 0 for image in images)


@pytest.mark.parametrize("size", [(1, 1), (17, 5), (16, 32)])
def test_with_clean_surfaces_any_size_comes_out(size):
    torch.manual_seed(0)
    images = play(create(CLEAN).eval().requires_grad_(False), make_frames(2, *size))
    assert all(image.shape == (1, 3, *size) and image.isfinite().all() and image.min() >= 0 for image in images)


@pytest.mark.parametrize("name, precision", [("hybrid", "fp32"), ("hybrid", "int8"), ("hybrid-large", "fp32")])
def test_no_surface_is_brighter_than_white(name, precision):
    """Mirrors of Cycles have an albedo of 2, and the networks know none beyond 1."""
    pixels = load(name, precision=precision).pixels
    torch.manual_seed(0)
    light, albedo, normal = (torch.rand(1, 3, 16, 32) for _ in range(3))
    albedo[..., 16:], normal[..., 16:] = 1, torch.tensor([0.0, -1.0, 1.0])[:, None, None]
    beyond = [torch.cat([x[..., :16], 2 * x[..., 16:]], dim=-1) for x in (albedo, normal)]
    assert torch.equal(pixels(light, *beyond), pixels(light, albedo, normal))


def test_light_is_written_by_clean_surfaces(monkeypatch):
    """The networks of albedo and normal see these alone, and the network of light sees what they made."""
    shares(monkeypatch, 0.0)
    model, frame = read("hybrid-large"), sanitise(open_sequence(SAMPLE)[0])
    seen = []
    monkeypatch.setattr(model.pixels, "input", lambda *layers: seen.append(layers) or PixelNetwork.input(
        model.pixels, *layers))  # fmt: skip
    model.step(frame)
    (_, albedo, normal), (clean_albedo, clean_normal) = seen[0], model.pixels.clean(frame.albedo, frame.normal)
    assert torch.equal(albedo, clean_albedo) and torch.equal(normal, clean_normal)
    assert albedo.min() >= 0 and albedo.max() <= 1 and normal.abs().max() <= 1
    bright = model.pixels.clean(frame.albedo, -frame.normal)
    assert torch.equal(bright[0], albedo) and not torch.allclose(bright[1], normal, atol=0.1)


def test_without_a_share_the_image_is_the_kernels(model, monkeypatch):
    monkeypatch.setattr("rtdenoise.models.past.outdated", lambda found, agree, frames: torch.zeros_like(agree))
    monkeypatch.setattr("rtdenoise.models.past.retextured", lambda albedo, before, found: torch.zeros_like(found) * 1.0)
    monkeypatch.setattr("rtdenoise.models.hybrid.without_fireflies", lambda light, *_: light)
    history = alone = None
    for frame in make_frames(4):
        shares(monkeypatch, 1.0)
        image, after = trusting(model).step(frame, history)
        kernels, alone, _ = AccumulatedKPN.step_and_kernels(model, frame, alone)
        torch.testing.assert_close(image, kernels, rtol=1e-4, atol=1e-5)
        for name, layer in replace(alone, footprint=None, footprint_count=None).layers().items():
            torch.testing.assert_close(after.layers()[name], layer, rtol=1e-4, atol=1e-5)
        shares(monkeypatch, 0.5)
        assert not torch.allclose(model.step(frame, history)[0], image, rtol=1e-2)
        history = after


def test_the_picture_is_history_and_is_kept(model, monkeypatch):
    """All of it, with such a share, where motion leads to it and nothing was just uncovered; not where the kernels give
    their history up."""
    for place in ("ops.mix", "ops.native.mix", "ops.triton.mix"):
        monkeypatch.setattr(f"rtdenoise.{place}.MIX_FAR", 9.0)
    monkeypatch.setattr("rtdenoise.models.hybrid.without_fireflies", lambda light, *_: light)
    shares(monkeypatch, 0.5, before=1.0)
    history = None
    for frame in make_frames(3):
        before, (image, history) = history, trusting(model).step(frame, history)
        assert torch.equal(history.radiance, image)
    past = reprojected(model.config, frame, demodulate(frame.radiance, frame.albedo, frame.depth), before)
    held = past.on_screen & ~past.uncovered
    assert held.any() and not held.all()
    same = (image - past.output).abs().amax(1, keepdim=True) < 1e-4
    assert same[held].all() and not same[~held].all()
    image, _ = trusting(model, 100.0).step(frame, before)
    shares(monkeypatch, 0.0)
    written, _ = model.step(frame, before)
    held = held.expand_as(image)
    torch.testing.assert_close(image[held], written[held], rtol=1e-4, atol=1e-5)


def test_it_sees_the_light_that_the_kernels_have_averaged(model, monkeypatch):
    """Not the frame alone: another past is another picture."""
    shares(monkeypatch, 0.0)
    *before, frame = make_frames(3)
    images = []
    for scale in (1.0, 1.2):
        history = None
        for past in before:
            _, history = model.step(replace(past, radiance=past.radiance * scale), history)
        shown = []
        with watched(model, shown):
            images.append(model.step(frame, history)[0])
        assert not torch.allclose(shown[0], scale_of(model, frame) * frame.radiance, rtol=0.05)
    assert not torch.allclose(*images)


def test_averaged_light_is_less_noisy(model):
    """What the other network sees has little more than half of the frame's squared error."""
    shown = []
    with watched(model, shown):
        play(model, frames := make_frames(4))
    scale = scale_of(model, frames[-1])
    noise, averaged = (x - frames[-1].reference for x in (frames[-1].radiance, shown[-1] / scale))
    assert averaged.square().mean() < 0.6 * noise.square().mean()


@pytest.mark.parametrize("noise", [1.0, 0.1])
def test_light_that_one_frame_has_seen_is_evened_with_the_kernels_image(model, noise):
    """Not in the first frame, where all of it is as noisy; in the second, the right half has come much nearer. In the
    third all has, and all of it is as noisy again. The less noise there is, or the less history stays, the less."""
    first, second, third = make_frames(3, H=24, W=32, noise=noise)
    right = torch.arange(32) >= 16
    second = replace(second, depth=torch.where(right, second.depth / 9, second.depth))
    third = replace(third, depth=third.depth / 99)
    shown = []
    with watched(model, shown):
        _, history = model.step(first)
        _, onward = model.step(second, history)
        model.step(third, onward)
    _, last, _ = AccumulatedKPN.step_and_kernels(model, third, onward)
    kernels, onward, found = AccumulatedKPN.step_and_kernels(model, second, history)
    light = [x / scale_of(model, frame) for x, frame in zip(shown, (first, second, third), strict=True)]
    torch.testing.assert_close(light[0], first.radiance, rtol=1e-5, atol=1e-6)
    assert (last.footprint_count == 1).all()
    torch.testing.assert_close(light[2], seen(sanitise(third), onward, last)[:, :3], rtol=1e-5, atol=1e-7)

    evened = light[1]
    count, light = onward.footprint_count, seen(sanitise(second), history, onward)[:, :3]
    assert (count[..., 18:] == 1).all() and count[..., ~right].mean() > 1.2
    _, on_screen, uncovered = history_motion(second, history, "dual")
    held = (on_screen & ~uncovered).float()
    trust = 1 - held * (1 - (1 - found.reset) * (1 + found.past.stays) / 2)
    assert torch.equal(found.trust, trust)
    share = 0.4 * trust * (2 - count).clamp(0, 1) * (count.max() - 1).clamp(0, 1)  # of the image
    noisy = noise_level(sanitise(second).radiance, second.depth) / EVENED_NOISE
    assert noisy > 1 if noise == 1 else 0.01 < noisy < 0.9
    share = share * noisy.clamp(max=1) * found.past.stays
    torch.testing.assert_close(evened, light + share * (kernels - light), rtol=1e-4, atol=1e-5)


def test_light_that_has_changed_is_not_evened(model):
    """Beside light that stays, of which many frames are known: nothing around knows that of the right half."""
    trusting(model)
    right, shown, history = torch.arange(96) >= 32, [], None
    for frame, factor in zip(make_frames(3, H=48, W=96), (1.0, 8.0, 0.5), strict=True):
        still = {"motion": 0 * frame.motion, "motion_next": 0 * frame.motion}
        frame = replace(frame, radiance=torch.where(right, factor, 1.0) * frame.radiance, **still)
        before = history
        with watched(model, shown):
            _, history = model.step(frame, before)
    _, after, found = AccumulatedKPN.step_and_kernels(model, sanitise(frame), before)
    light = seen(sanitise(frame), before, after)[:, :3]
    changed, stayed = slice(40, 96), slice(8, 24)
    assert (after.footprint_count[..., changed] == 1).all() and after.footprint_count[..., stayed].mean() > 1.5
    assert found.past.stays[..., changed].max() < 0.01
    evened = shown[-1] / scale_of(model, frame)
    torch.testing.assert_close(evened[..., changed], light[..., changed], rtol=1e-4, atol=1e-5)


def test_written_pixels_stay_within_the_light_around_them(model, monkeypatch):
    shares(monkeypatch, 0.0)
    for frame in make_frames(2, H=40, W=70):
        even = replace(frame, radiance=torch.full_like(frame.radiance, 0.3), albedo=torch.full_like(frame.albedo, 0.6))
        torch.testing.assert_close(model.step(even)[0], even.radiance, rtol=1e-5, atol=0)
        assert model.step(replace(frame, radiance=torch.zeros_like(frame.radiance)))[0].max() == 0
    light, image = torch.rand(1, 3, 40, 70), torch.rand(1, 3, 40, 70)
    light[0, :, 35, 65] = 9.0
    least, most = (expand_within(torch.full_like(light, x), light, image) for x in (0.0, 30.0))
    assert (least <= light.minimum(image)).all() and (most >= light.maximum(image)).all()
    assert (most[..., 16:, 48:] == 9).all() and most[..., :16, :].max() < 1 and most[..., :48].max() < 1


def test_light_that_a_network_cannot_write_is_the_kernels():
    """Of a network that writes 100, and can write no more."""
    exposure, radiance = torch.full((1, 1, 1, 1), 0.5), torch.full((1, 3, 8, 8), 100.0)
    for brightness, share in ((199.0, 0.0), (200 * 3**0.5, 0.5), (600.0, 1.0), (1e9, 1.0)):
        image = torch.full_like(radiance, brightness)
        found = written(lambda lit: lit.log1p(), radiance, image, exposure, greatest=100.0)
        torch.testing.assert_close(found, torch.lerp(radiance, image, share), rtol=1e-4, atol=0)
        assert torch.allclose(written(lambda lit: lit.log1p(), radiance, image, exposure), radiance, rtol=1e-4)


@pytest.mark.parametrize("config", [SMALL, CLEAN], ids=["small", "clean"])
def test_training_leaves_the_kernels_and_the_filters_of_surfaces_alone(config, monkeypatch):
    torch.manual_seed(0)
    model, history = create(config), None
    real, needs = PixelNetwork.clean, []
    monkeypatch.setattr(PixelNetwork, "clean", lambda *a: needs.append(found := real(*a)) or found)
    for frame in make_frames(2):
        image, history = model.step(frame, history)
    image.square().mean().backward()
    trained = {name for name, weight in model.named_parameters() if weight.grad is not None}
    learns = {name for name, _ in model.named_parameters() if name.startswith("pixels.") and "surfaces" not in name}
    assert trained == learns and len(needs) == (2 if config.clean else 0)
    assert not any(x.requires_grad for pair in needs for x in pair)
    assert all(weight.grad is None or weight.grad.isfinite().all() for weight in model.parameters())


@pytest.mark.parametrize(("model", "network"), NETWORKS.items())
def test_the_shipped_weights_are_those_of_default_and_of_oidns_network(model, network, tmp_path):
    """To the bit, as the tool makes them."""
    out = tmp_path / "begin.safetensors"
    subprocess.run([sys.executable, ROOT / "tools" / "begin_hybrid.py", out, network], check=True)
    assert out.read_bytes() == find(model).read_bytes()
    hybrid, kernels = (read(name).state_dict() for name in (model, "default"))
    assert read(model).config == PRESETS[model]
    assert all(torch.equal(hybrid[name], weight) for name, weight in kernels.items())


@pytest.mark.parametrize("model", NETWORKS)
def test_its_pixels_are_those_of_oidns_network(model, monkeypatch):
    """OIDN's weights in our network give its picture, at its auto-exposure."""
    shares(monkeypatch, 0.0)
    monkeypatch.setattr("rtdenoise.models.pixel_network.PIXELS_LIGHT", 0.334)
    monkeypatch.setattr("rtdenoise.ops.lift.PIXELS_GREY", 0.0)
    hybrid, kernels = read(model), read("default")
    frame = open_sequence(SAMPLE)[0]
    large = {"quality": "high", "prefilter": True}
    theirs = Oidn(**large if hybrid.config.clean else {"quality": NETWORKS[model]}).step(frame)[0]
    brightness = theirs.mean()
    error = {}
    with use("plain"):
        pixels = hybrid.step(frame)[0]
    for name, image in {"pixels": pixels, "kernels": kernels.step(frame)[0]}.items():
        difference = (image - theirs).abs() / (theirs + brightness)
        error[name] = difference.mean().item()
    assert error["pixels"] < 0.015 and error["pixels"] < 0.3 * error["kernels"], error


@pytest.mark.parametrize("of_pixels", ["hybrid", "hybrid-large"])
def test_hybrids_for_many_samples_are_of_two_models(of_pixels):
    many, pixels, both = (read(name).state_dict() for name in ("many", of_pixels, f"{of_pixels}-many"))
    for name, tensor in both.items():
        assert torch.equal(tensor, (pixels if name.startswith("pixels.") else many)[name]), name


@pytest.mark.parametrize("of_pixels", ["hybrid", "hybrid-large"])
def test_hybrids_for_many_samples_in_bytes(of_pixels):
    shipped = files_of(find(f"{of_pixels}-many"))
    assert [path.stem for path in shipped][:3] == [f"{of_pixels}-many", "many", of_pixels]
    assert files_of(shipped[1]) == shipped[1:2] and has_bytes(shipped[0]) and shipped[0].stat().st_size < 1000
    in_bytes, model = (load(f"{of_pixels}-many", precision=precision) for precision in ("int8", "fp32"))
    assert [type(part).__name__ for part in (in_bytes.unet, in_bytes.pixels)] == ["UNetInBytes", "PixelNetworkInBytes"]
    for a, b in zip(play(in_bytes, make_frames(2)), play(model, make_frames(2)), strict=True):
        assert (compress(a) - compress(b)).abs().mean() < 0.01


@pytest.mark.parametrize(("model", "precision", "light"), [
    ("hybrid-large-many", "auto", torch.float32), ("hybrid-large-many", "bf16", torch.bfloat16),
    ("hybrid-many", "auto", torch.bfloat16), ("hybrid-large", "auto", torch.bfloat16),
])  # fmt: skip
def test_light_of_many_samples_beside_clean_surfaces_is_not_rounded(model, precision, light, monkeypatch):
    """Unless asked for; the other networks are rounded, where that is faster. The weights are those that were read."""
    monkeypatch.setattr("rtdenoise.models.loading.resolve", lambda *_: torch.bfloat16)
    monkeypatch.setattr("rtdenoise.models.loading.takes_bytes", lambda *_: False)
    network, exact = load(model, precision=precision), read(model)
    assert network.full_head.weight.dtype == torch.bfloat16 and network.pixels.last.weight.dtype == light
    assert {x.dtype for x in network.pixels.surfaces.parameters()} <= {torch.bfloat16}
    same = torch.equal(network.pixels.last.weight.float(), exact.pixels.last.weight)
    assert same == (light == torch.float32) and list(network.state_dict()) == list(exact.state_dict())
    assert all(image.isfinite().all() for image in play(network, make_frames(2)))


def test_whole_weights_have_their_unit(tmp_path):
    """Weights of eight bits are multiples of it; without it, or with one of another length, the file is named."""
    path, name = tmp_path / "w.safetensors", "pixels.encoder.5.weight"
    with safe_open(find("hybrid-large"), framework="numpy") as file:
        metadata, tensors = file.metadata(), {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    whole, unit = tensors[name], tensors[f"{name}.unit"]
    assert whole.dtype == np.int8 and np.abs(whole).max() == 127
    np.testing.assert_array_equal(read("hybrid-large").state_dict()[name], whole * unit.reshape(-1, 1, 1, 1))
    for changed, told in (
        ({}, "unit"), ({f"{name}.unit": unit[:3]}, "unit"), ({f"{name}.unit": unit[:1]}, "unit"),
        ({f"{name}.unit": unit, "other.unit": unit}, "other.unit"), ({f"{name}.unit": unit * np.nan}, name),
    ):  # fmt: skip
        there = {key: x for key, x in tensors.items() if key != f"{name}.unit"} | changed
        path.write_bytes(serialise(there, metadata=metadata))
        with pytest.raises(InputError, match=told):
            read(path)


def test_weights_are_not_there_twice(tmp_path):
    """Not both in the file and in a model that it takes them of."""
    with safe_open(find("hybrid"), framework="numpy") as file:
        metadata, tensors = file.metadata(), {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    own = read("default").state_dict()["stem.bias"].numpy()
    (tmp_path / "w.safetensors").write_bytes(serialise(tensors | {"stem.bias": own}, metadata=metadata))
    with pytest.raises(InputError, match=r"holds stem\.bias, which it takes of the model default"):
        read(tmp_path / "w.safetensors")


def test_weights_of_unknown_models_are_refused(tmp_path):
    config = json.dumps(asdict(read("hybrid-many").config))
    wrong = (
        '{"kernels": "none", "pixels": "hybrid"}', '{"other": "many"}', '["many"]', "many",
        '{"kernels": ["many"], "pixels": "hybrid"}',
    )  # fmt: skip
    for parts in wrong:
        metadata = {"architecture": "hybrid", "config": config, "parts": parts}
        (tmp_path / "w.safetensors").write_bytes(serialise({}, metadata=metadata))
        with pytest.raises(InputError, match="the models whose weights it takes are none of this version"):
            load(tmp_path / "w.safetensors")
    metadata["parts"] = '{"kernels": "fast", "pixels": "hybrid"}'
    (tmp_path / "w.safetensors").write_bytes(serialise({}, metadata=metadata))
    with pytest.raises(InputError, match="weights do not fit the configuration"):
        load(tmp_path / "w.safetensors")


def test_for_many_samples_light_is_filtered_as_it_is(model, monkeypatch):
    """Neither evened nor with moving edges, and no previous picture is blended in."""
    for name in ("seen", "evened"):
        monkeypatch.setattr(hybrid, name, lambda *_, name=name: pytest.fail(name))
    told = []
    monkeypatch.setattr(hybrid, "mix", lambda *a: told.append(a[4:6]) or mix(*a))
    many = create(replace(SMALL, many=True)).eval()
    many.load_state_dict(model.state_dict())
    with torch.no_grad():
        play(many, make_frames(3))
    assert told == 3 * [(MIX_SHARES_OF_MANY, None)]


@pytest.mark.parametrize("many", [False, True])
def test_only_for_many_samples_noise_tells_how_far_lookups_off_the_pixel_count(model, many):
    """Even light has no noise: there a lookup that is half a pixel off in x and y counts 0.25, or next to nothing."""
    network = create(replace(SMALL, many=many)).eval()
    network.load_state_dict(model.state_dict())
    frames = [
        replace(f, radiance=torch.full_like(f.radiance, 0.5), albedo=torch.full_like(f.albedo, 0.5),
                motion=torch.full_like(f.motion, 0.5), motion_next=torch.full_like(f.motion, -0.5),
                normal=f.normal[..., :1, :1].expand_as(f.normal), depth=torch.ones_like(f.depth))
        for f in make_frames(2)
    ]  # fmt: skip
    network.keeps_footprint = True
    with torch.no_grad():
        history = network.step(frames[1], network.step(frames[0])[1])[1]
    others = history.footprint_count[..., :-1, :-1] - 1
    torch.testing.assert_close(others, torch.full_like(others, 0.0 if many else 0.25), atol=0.01, rtol=0)


@pytest.mark.parametrize(("clean", "mean"), [(True, True), (True, False), (False, True)])
def test_kernels_of_more_history_count_where_a_pixel_around_has_a_history(clean, mean, monkeypatch):
    """Of many samples, beside clean surfaces: in a first frame, or of a single picture, what is written shows alone."""
    trust = []
    monkeypatch.setattr(hybrid, "mix", lambda *a: trust.append(a[3]) or mix(*a))
    network = create(replace(SMALL, many=True, clean=clean)).eval()
    frames = [replace(frame, more_history=mean) for frame in make_frames(2, H=16, W=80)]
    new = torch.where(torch.arange(80) < 32, OFF_SCREEN, frames[1].motion)  # the first two cells of five
    with torch.no_grad():
        play(network, [frames[0], replace(frames[1], motion=new)])
    alone, beside = trust[1][..., :16], trust[1][..., 48:]
    assert trust[0].max() == alone.max() == (not (clean and mean)) and beside.max() > 0


@pytest.mark.parametrize(("many", "mean", "share"), [(True, True, 0.5), (True, False, 1.0), (False, True, 1.0)])
def test_half_of_the_reset_of_many_samples_counts_for_footprints_of_more_history(many, mean, share):
    frame = replace(make_frames(1)[0], more_history=mean)
    config, one = replace(SMALL, many=many), torch.ones_like(frame.depth)
    nothing, shown = reprojected(config, frame, frame.radiance, None), torch.cat(footprint_of(frame), dim=1)
    past = replace(nothing, turned=0.2 * one, footprint=shown, footprint_count=4 * one)
    said = 0.6 * one
    _, count = footprint(frame, past, reset_of_footprint(config, frame, past, said, past.giving_way(said)))
    reset = 1 - (1 - 0.6 * share) * 0.8
    torch.testing.assert_close(1 / count, one * (0.2 + 0.8 * reset))


def test_its_histories_have_footprints_if_asked():
    frame = make_frames(1)[0]
    for options, channels in (({}, None), ({"footprint": True}, 9)):
        with torch.no_grad():
            history = load("hybrid-fast", precision="fp32", **options).step(frame)[1]
        assert channels == (history.footprint if channels is None else history.footprint.shape[1])


def test_what_it_cannot_do_is_refused():
    with pytest.raises(ValueError, match="expected"):
        grow(read("default"), SMALL)
    with pytest.raises(ValueError, match="up, out: expected 2 widths"):
        replace(SMALL, up=(8, 8, 8))
    with pytest.raises(ValueError, match="down: expected 2 to 5 widths from 1 to 1024"):
        replace(SMALL, down=(8, 0, 4))
    for name in ("widths", "down", "up", "out"):
        for wrong in (8.0, True, "8"):
            with pytest.raises(ValueError, match=f"{name}: expected whole numbers, got "):
                replace(SMALL, **{name: (wrong, *getattr(SMALL, name)[1:])})
    with pytest.raises(InputError, match="not an override of model 'hybrid': down: expected whole numbers"):
        load("hybrid", down=(32.0, 48, 64, 80, 96))


def test_a_saved_network_comes_back(model, tmp_path):
    save(model, tmp_path / "w.safetensors")
    again = load(tmp_path / "w.safetensors", precision="fp32")
    for a, b in zip(play(model, make_frames(2)), play(again, make_frames(2)), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-4)


def test_an_interrupted_run_goes_on_to_the_bit(model, tmp_path):
    save(model, tmp_path / "w.safetensors")
    shot = write_sequence(tmp_path / "shot", make_frames(10))
    assert_goes_on(shot, tmp_path, Options(model=str(tmp_path / "w.safetensors"), precision="fp32", float32=True), 3)


def test_its_own_picture_as_history_neither_drifts_nor_glows():
    """Over forty frames the error stays; when the light goes out, so does the picture."""
    model, history, errors = load("hybrid", precision="fp32"), None, []
    frames = make_frames(40, H=48, W=64)
    with torch.inference_mode():
        for frame in frames:
            image, history = model.step(frame, history)
            errors.append((image - frame.reference).square().mean().item())
        assert np.mean(errors[-8:]) < 1.1 * np.mean(errors[8:16])
        for frame in make_frames(46, H=48, W=64)[40:]:
            image, history = model.step(replace(frame, radiance=torch.zeros_like(frame.radiance)), history)
        assert image.max() < 1e-3 * frames[-1].reference.mean()


def test_what_shines_by_itself_is_not_evened():
    share = torch.rand(1, 1, 9, 12)
    albedo = torch.rand(1, 3, 9, 12)
    assert away_from_glow(share, albedo) is share
    albedo[0, 1, 4, 0] = 1.5
    found = away_from_glow(share, albedo)
    assert (found[..., 2:7, :3] == 0).all() and torch.equal(found[..., 3:], share[..., 3:])
    assert torch.equal(found[..., :2, :], share[..., :2, :]) and torch.equal(found[..., 7:, :], share[..., 7:, :])


def test_a_picture_has_no_say_where_something_that_shone_has_left():
    """By motion to where it was; a GPU gives the same without looking first whether anything shone."""
    shown = torch.ones(1, 1, 9, 12, dtype=torch.bool)
    albedo, before, motion = torch.rand(1, 3, 9, 12), torch.rand(1, 3, 9, 12), torch.zeros(1, 2, 9, 12)
    assert left_by_glow(shown, albedo, before, motion) is shown
    before[0, 2, 4, 6], motion[:, 0] = 1.5, -1.0  # seen a pixel to the right now
    found = left_by_glow(shown, albedo, before, motion)
    expected = shown.clone()
    expected[..., 2:7, 5:10] = False
    assert torch.equal(found, expected)
    albedo[0, 0, 4, 7] = 2.0  # it is still there
    assert left_by_glow(shown, albedo, before, motion).all()
    assert not left_by_glow(~shown, albedo, before, motion).any()


def test_a_lamp_keeps_its_light_where_one_frame_has_seen_it(model):
    """Beside pixels that more have seen: as `test_light_that_one_frame_has_seen_is_evened_with_the_kernels_image`."""
    first, second = make_frames(2, H=24, W=32)
    right = torch.arange(32) >= 16
    second = replace(second, depth=torch.where(right, second.depth / 9, second.depth))
    lamp = second.albedo.clone()
    lamp[..., 10:14, 24:28] = 2.0
    for albedo, keeps in ((second.albedo, False), (lamp, True)):
        frame, shown = replace(second, albedo=albedo), []
        with watched(model, shown):
            _, history = model.step(first)
            model.step(frame, history)
        light, inside = shown[1] / scale_of(model, frame), (..., slice(8, 16), slice(22, 30))
        same = torch.isclose(light[inside], sanitise(frame).radiance[inside], rtol=1e-4, atol=1e-6)
        assert same.all() == keeps
