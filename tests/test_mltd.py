"""The denoiser of Metropolis renders: its paper's size, its promises, its files, its training."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import make_frames, write_clips, write_sequence
from tolerances import TOLERANCES

from rtdenoise.data.clip_file import clip_path, write_clip
from rtdenoise.data.exr import read_channels
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate import evaluate
from rtdenoise.evaluate.inputs import Source
from rtdenoise.evaluate.registry import choose
from rtdenoise.frame import NOTHING_KNOWN, Frame
from rtdenoise.glsl import Pipeline
from rtdenoise.history import load_history, resize, save_history
from rtdenoise.models import MLTDConfig, RecurrentTransformer, create, load, save, transformer
from rtdenoise.models.losses import mltd_loss, smape
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.sanitise import sanitise
from rtdenoise.training.augment import augment, relight
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

SMALL = {"width": 8, "blocks": (1,) * 8, "kernel": 3, "temporal_kernel": 3}
PAPER = {
    "components": 4, "pool": "nearest", "invalid": "black", "normalise": "clip", "position": True,
    "motion": "traditional",
}  # fmt: skip
CONFIGS = {
    "ours": MLTDConfig(**SMALL), "the paper's": MLTDConfig(**SMALL | PAPER | {"components": 2}),
    "concat": MLTDConfig(**SMALL, recurrence="concat"), "none": MLTDConfig(**SMALL, recurrence="none"),
    "summed": MLTDConfig(**SMALL, components=1),
}  # fmt: skip


def split(frame: Frame, seed: int = 0) -> Frame:
    """The frame with two components, and positions."""
    g = torch.Generator().manual_seed(seed + frame.number)
    share = torch.rand(frame.radiance.shape, generator=g)
    position = torch.rand(frame.radiance.shape, generator=g)
    parts = torch.cat([frame.radiance * share, frame.radiance * (1 - share)], dim=1)
    return replace(frame, components=parts, position=position)


def frames(count=3, H=24, W=32, **options):
    return [split(frame) for frame in make_frames(count, H=H, W=W, **options)]


def run(model, sequence):
    history, images = None, []
    for frame in sequence:
        image, history = model.step(frame, history)
        images.append(image)
    return images, history


def network(config, seed=0):
    torch.manual_seed(seed)
    return create(config).eval().requires_grad_(False)


@pytest.fixture(scope="module", params=CONFIGS)
def model(request):
    return network(CONFIGS[request.param])


@pytest.fixture(scope="module")
def ours():
    return network(CONFIGS["ours"])


def test_the_papers_network_has_the_size_of_its_authors_code():
    model = RecurrentTransformer(MLTDConfig(**PAPER))
    assert model.first.in_channels == 22
    assert [head.out_channels for head in model.heads] == [428, 432, 432, 432]
    assert sum(p.numel() for p in model.parameters()) == 20_422_876


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_the_description_is_what_torch_builds(config):
    found = {name: tuple(tensor.shape) for name, tensor in create(config).state_dict().items()}
    assert found == config.shapes


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (17, 5), (19, 33)])
def test_any_size_goes_in_and_comes_out(model, size):
    images, history = run(model, frames(2, *size))
    assert images[1].shape == (1, 3, *size) and images[1].isfinite().all()
    pictures = [tuple(t.shape[2:]) for t in history.hidden[:4]]
    assert pictures == [(-(-size[0] // 2**s), -(-size[1] // 2**s)) for s in range(4)]


@pytest.mark.parametrize("exposure", [1e-4, 1e4])
def test_scaling_the_light_scales_the_output(ours, exposure):
    sequence = frames()
    bright = [replace(f, radiance=f.radiance * exposure, components=f.components * exposure) for f in sequence]
    torch.testing.assert_close(run(ours, bright)[0][-1] / exposure, run(ours, sequence)[0][-1], rtol=2e-3, atol=1e-4)


def test_constant_light_is_kept_and_black_stays_black(model):
    for light in (0.7, 0.0):
        constant = [split(replace(f, radiance=torch.full_like(f.radiance, light))) for f in make_frames(3)]
        constant = [replace(f, components=torch.full_like(f.components, light / 2)) for f in constant]
        images, _ = run(model, constant)
        for image in images[:1] if model.config.invalid == "black" else images:  # black is mixed into later ones
            torch.testing.assert_close(image, constant[0].radiance)


def test_the_origin_of_the_world_does_not_matter():
    model = network(MLTDConfig(**SMALL, position=True))
    frame = frames(1)[0]
    sky = torch.zeros_like(frame.depth, dtype=torch.bool)
    sky[..., :6, :] = True
    frame = replace(frame, depth=frame.depth.masked_fill(sky, 0), position=frame.position.masked_fill(sky, 0))
    moved = replace(frame, position=(frame.position + 50).masked_fill(sky, 0))
    torch.testing.assert_close(model.step(moved)[0], model.step(frame)[0], rtol=1e-3, atol=1e-4)


def test_the_papers_input_fills_its_range_wherever_the_world_lies():
    model = network(CONFIGS["the paper's"])
    for shift in (-50, 0, 50):
        frame = frames(1)[0]
        frame = replace(frame, position=frame.position + shift)
        found, _ = model.features(frame, model.components(frame), None, None, NOTHING_KNOWN)
        distance, position = found[:, 6:7], found[:, 13:16]
        for x in (distance, position):
            assert x.min().item() == pytest.approx(-1, abs=1e-3) and x.max().item() == pytest.approx(1, abs=1e-3)


def test_history_off_the_screen_leaves_no_trace(ours):
    first, second, _ = frames()
    second = replace(second, motion=torch.full_like(second.motion, 1e3))
    image, _ = ours.step(second, run(ours, [first])[1])
    torch.testing.assert_close(image, ours.step(second)[0], rtol=1e-4, atol=1e-5)


def test_history_of_another_surface_leaves_no_trace_but_in_the_papers_form():
    """The paper's λ mixes the black in; ours leaves the weight to the frame."""
    first, second, _ = frames(noise=0.0)
    far = replace(first, depth=first.depth * 9)
    even = [replace(f, radiance=torch.ones_like(f.radiance), components=torch.full_like(f.components, 0.5))
            for f in (far, second)]  # fmt: skip
    least = {}
    for name in ("ours", "the paper's"):
        model = network(CONFIGS[name])
        least[name] = run(model, even)[0][1].min().item()
    assert least["ours"] == pytest.approx(1, abs=1e-4) and least["the paper's"] < 0.8


@pytest.mark.parametrize("before, now", [((24, 32), (40, 50)), ((24, 32), (17, 19)), ((25, 33), (24, 32))])
def test_a_resized_history_goes_on(model, before, now):
    _, history = model.step(frames(1, *before)[0])
    image, _ = model.step(frames(2, *now)[1], resize(history, now))
    assert image.shape[2:] == now and image.isfinite().all()


@pytest.mark.parametrize("kind", ["cross", "concat"])
def test_hidden_features_reach_the_next_frame(kind):
    model = network(MLTDConfig(**SMALL, recurrence=kind))
    sequence = frames(2)
    _, history = model.step(sequence[0])
    image, _ = model.step(sequence[1], history)
    for index in range(4, 8):
        hidden = list(history.hidden)
        hidden[index] = torch.randn(hidden[index].shape, generator=torch.Generator().manual_seed(1)).half()
        other, _ = model.step(sequence[1], replace(history, hidden=tuple(hidden)))
        assert not torch.allclose(image, other, rtol=1e-5), f"hidden.{index}"


def test_cells_are_looked_up_by_the_motion_at_their_centre(ours):
    """A picture that moves by eight pixels moves by one cell of the coarsest scale."""
    first, second, _ = frames(H=32, W=64, noise=0.0)
    still = {"normal": torch.zeros_like(first.normal), "depth": torch.ones_like(first.depth)}
    motion = torch.zeros_like(first.motion)
    motion[:, 0] = -8.0
    second = replace(second, motion=motion, **still)
    _, history = ours.step(replace(first, motion_next=-motion, **still))
    past = ours.reprojected(sanitise(second), history)
    for scale, (before, light) in enumerate(zip(history.hidden, past.light, strict=False)):
        cells = 8 // 2**scale
        torch.testing.assert_close(light[..., cells:], before[..., :-cells], rtol=1e-5, atol=1e-5)
        assert (past.valid[scale][..., :cells] == 0).all() and (past.valid[scale][..., cells:] == 1).all()
    moved = past.features(0, 0, history.hidden[4].float())
    torch.testing.assert_close(moved[..., 8:], history.hidden[4][..., :-8].float(), rtol=1e-3, atol=1e-3)


def test_strips_are_the_whole(model, monkeypatch):
    sequence = frames(3, H=45, W=37)
    with torch.no_grad():
        whole, history = run(model, sequence)
        monkeypatch.setattr(transformer, "STRIP_PIXELS", 1)  # strips of eight rows
        in_strips, other = run(model, sequence)
    relative, absolute = TOLERANCES["float32 tiles"]
    torch.testing.assert_close(in_strips[-1], whole[-1], rtol=relative, atol=absolute)
    for a, b in zip(history.hidden, other.hidden, strict=True):
        torch.testing.assert_close(a, b, rtol=2e-3, atol=2e-3)  # float16


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_gradients_reach_every_parameter_through_the_recurrence(config):
    torch.manual_seed(0)
    model, sequence = create(config), frames()
    images, _ = run(model, sequence)
    sum(image.square().mean() for image in images).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), name
    assert model.heads[3].weight.grad.abs().max() > 0


@pytest.mark.parametrize("layer", ["components", "motion", "depth", "position"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_pixels_never_reach_output_or_history(layer, bad):
    model = network(CONFIGS["the paper's" if layer == "position" else "ours"])
    broken = []
    for frame in frames(2):
        tensor = getattr(frame, layer).clone()
        tensor[..., 5, 7] = bad
        broken.append(replace(frame, **{layer: tensor}))
    images, history = run(model, broken)
    assert images[1].isfinite().all() and all(t.isfinite().all() for t in history.hidden)


def test_a_stuck_chain_keeps_its_energy(ours):
    """A bright pixel of a component is no firefly: the light that it adds to the picture is not cut off."""
    frame = frames(1, H=32, W=32)[0]
    components = frame.components.clone()
    components[:, :3, 9, 9] = 1e4
    frame = replace(frame, components=components, radiance=components[:, :3] + components[:, 3:])
    assert torch.equal(sanitise(frame).components, components)
    image, _ = ours.step(frame)
    assert image.sum() > 0.5 * components.sum()


def test_the_loss_is_smape_of_frames_and_half_that_of_differences():
    a, b, r, s = torch.rand(4, 2, 3, 5, 6).unbind(0)
    frame = Frame(a, reference=r)
    found = mltd_loss(a, frame, (b, s), None, 2.0, 0.0)
    torch.testing.assert_close(found.total, smape(a, r, 2.0) + 0.5 * smape(a - b, r - s, 2.0))
    assert mltd_loss(a, frame, None, None, 2.0, 0.0).total.equal(smape(a, r, 2.0))


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"width": 7}, "width: expected an even number from 2 to 128, got 7"),
        ({"blocks": (1, 2)}, "blocks: expected eight numbers from 1 to 16"),
        ({"components": 0}, "components: expected a number from 1 to 8"),
        ({"recurrence": "lstm"}, "recurrence: expected one of cross, concat, none, got 'lstm'"),
        ({"kernel": 4}, "kernel: expected an odd size"),
    ],
)
def test_impossible_networks_are_refused(settings, complaint):
    with pytest.raises(ValueError, match=complaint):
        MLTDConfig(**settings)


# --- files ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def weights(tmp_path_factory, ours):
    path = tmp_path_factory.mktemp("weights") / "mltd.safetensors"
    save(ours, path)
    return str(path)


def write_shot(folder, sequence):
    """As a Metropolis renderer writes it: the components as layers `large` and `small`."""
    folder.mkdir()
    write_sequence(folder, [replace(f, components=None) for f in sequence])
    for path, frame in zip(sorted(folder.iterdir()), sequence, strict=True):
        layers = dict(zip(("large", "small"), frame.components.split(3, 1), strict=True))
        add_layers(path, {name: t[0].permute(1, 2, 0).numpy() for name, t in layers.items()})
    return folder


def add_layers(path, layers):
    from rtdenoise.data.exr import write_layers

    header = open_sequence(path).header
    planes = {name: image[..., None] for name, image in read_channels(path, list(header.channels)).items()}
    planes = {name: plane[..., 0] for name, plane in planes.items()}
    planes |= {f"{name}.{c}": image[..., i] for name, image in layers.items() for i, c in enumerate("RGB")}
    write_layers(path, planes, dtypes=dict.fromkeys(planes, "float"))


def result(folder):
    return [np.stack([planes[c] for c in "RGB"]) for path in sorted(folder.glob("*.exr"))
            if (planes := read_channels(path, "RGB"))]  # fmt: skip


def refused(*arguments) -> str:
    with pytest.raises(InputError) as caught:
        denoise(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_denoise_reads_components_and_resumes_to_the_bit(tmp_path, weights):
    shot, options = write_shot(tmp_path / "shot", frames(4)), Options(model=weights, precision="fp32")
    denoise(str(shot), tmp_path / "whole", options)
    later = [path.rename(tmp_path / path.name) for path in sorted(shot.iterdir())[2:]]
    denoise(str(shot), tmp_path / "two", options)
    for path in later:
        path.rename(shot / path.name)
    summary = denoise(str(shot), tmp_path / "two", options)
    assert (summary.written, summary.skipped) == (2, 2)
    assert all(np.array_equal(a, b) for a, b in zip(*map(result, (tmp_path / "whole", tmp_path / "two")), strict=True))


def test_a_saved_history_goes_on_to_the_bit(tmp_path, weights):
    model, sequence = load(weights, precision="fp32"), frames(4)
    _, history = run(model, sequence[:2])
    save_history(tmp_path / "h.safetensors", history)
    again, _ = load_history(tmp_path / "h.safetensors")
    assert [t.dtype for t in again.hidden] == [t.dtype for t in history.hidden]
    for one, other in zip(run_from(model, sequence[2:], history), run_from(model, sequence[2:], again), strict=True):
        assert torch.equal(one, other)


def test_bfloat16_is_close(weights):
    exact, rounded = (run(load(weights, precision=p), frames())[0][-1] for p in ("fp32", "bf16"))
    relative, absolute = TOLERANCES["bfloat16 network"]
    torch.testing.assert_close(rounded, exact, rtol=relative, atol=absolute)


def run_from(model, sequence, history):
    for frame in sequence:
        image, history = model.step(frame, history)
        yield image


def test_a_cut_starts_anew(tmp_path, weights):
    before, after = frames(2), frames(2, seed=7)
    after = [replace(f, depth=f.depth * 50, number=f.number + 2) for f in after]
    options = Options(model=weights, precision="fp32")
    summary = denoise(str(write_shot(tmp_path / "both", before + after)), tmp_path / "out", options)
    denoise(str(write_shot(tmp_path / "after", after)), tmp_path / "alone", options)
    assert summary.cuts == [2]
    assert np.array_equal(result(tmp_path / "out")[2], result(tmp_path / "alone")[0])


def test_what_is_no_metropolis_render_is_said(tmp_path, weights):
    shot = write_sequence(tmp_path / "traced", [replace(f, components=None) for f in frames(2)])
    message = refused(str(shot), tmp_path / "out", Options(model=weights))
    assert "frame.0000.exr: no layer 'components'" in message and "there is nothing to split: only a Metro" in message
    split_shot = write_shot(tmp_path / "shot", frames(2))
    message = refused(str(split_shot), tmp_path / "out", Options(model=weights, signal="indirect"))
    assert "the components make up the beauty; take --signal color" in message


def test_evaluation_hands_components_to_the_networks_that_read_them(tmp_path, weights):
    shot = write_shot(tmp_path / "shot", frames(3))
    found = Source.open(shot, "color", "auto", None).frames(1)
    (method,) = choose([f"ours={weights}"])
    (result,) = evaluate(found, {"ours": method.step("cpu", "fp32")})
    assert math.isfinite(result.errors["frame"]["psnr"])


def test_components_that_do_not_add_up_are_refused(tmp_path, weights):
    wrong = [replace(f, components=f.components * 1.1) for f in frames(2)]
    message = refused(str(write_shot(tmp_path / "shot", wrong)), tmp_path / "out", Options(model=weights))
    assert "frame.0000.exr: large + small differ from the beauty in 100% of the pixels, by 2% or more" in message


def test_missing_components_and_other_counts_are_named(ours):
    frame = frames(1)[0]
    with pytest.raises(InputError, match="layer components is missing"):
        ours.step(replace(frame, components=None))
    with pytest.raises(InputError, match="expected 2 components, got 1"):
        ours.step(replace(frame, components=frame.radiance))


def test_shaders_refuse_it_in_one_line(weights):
    with pytest.raises(
        InputError, match=r"there are no shaders for networks of the kind 'mltd'; use the backend torch"
    ):
        Pipeline.load(weights)


# --- training ---------------------------------------------------------------------------------------------------------


def write_split_clips(folder, seeds, size=24):
    folder.mkdir()
    for index, seed in enumerate(seeds):
        stored = []
        for frame in frames(4, H=size, W=size, seed=seed):
            layers = {name: t[0].permute(1, 2, 0).numpy() for name, t in frame.layers()}
            layers["large"], layers["small"] = np.split(layers.pop("components"), 2, axis=2)
            layers["color"] = layers.pop("radiance")
            stored.append(layers | {"id": np.ones((size, size, 1))})
        facts = {"seed": seed, "generator": 1}
        write_clip(clip_path(folder, index), stored, facts, layers=("large", "small", "position"), signals=("color",))
    return folder


def test_augmentation_keeps_components_the_parts_of_the_light():
    for seed in range(8):
        changed = augment(frames(2), np.random.default_rng(seed))
        for frame in relight(changed, np.random.default_rng(seed)):
            torch.testing.assert_close(frame.components[:, :3] + frame.components[:, 3:], frame.radiance)


def test_training_on_components(tmp_path):
    settings = tuple(
        f"{name}={','.join(map(str, v)) if isinstance(v, tuple) else v}"
        for name, v in {**SMALL, "position": "true"}.items()
    )
    config = TrainConfig(
        data=(write_split_clips(tmp_path / "clips", range(3)),), val=write_split_clips(tmp_path / "val", (7,)),
        out=tmp_path / "run", model="mltd-small", set=settings, signal="color", steps=4, batch=2, frames=3, size=16,
        amp=False, validate_every=4, warmup=1,
    )  # fmt: skip
    path = train(config)
    trained = load(path, precision="fp32")
    assert trained.config.position and trained.step(frames(1)[0])[0].isfinite().all()
    with pytest.raises(InputError, match="signal: mltd-small splits the beauty; expected 'color', got 'indirect'"):
        train(replace(config, signal="indirect", out=tmp_path / "other"))
    traced = write_clips(tmp_path / "traced", range(2))
    with pytest.raises(InputError, match="has no layer 'large'; it has "):
        train(replace(config, data=(traced,), out=tmp_path / "other"))
