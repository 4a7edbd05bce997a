"""Two defects of a Blender scene: faint outlines in an even sky, and backends apart on albedo far above 1."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import write_sequence

from rtdenoise import models, open_sequence, ops
from rtdenoise.data.exr import read_channels
from rtdenoise.frame import Frame
from rtdenoise.glsl import Pipeline
from rtdenoise.ops.even_sky import even_sky
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options

SKY = torch.tensor([0.5, 0.7, 1.0]).reshape(1, 3, 1, 1)
H, W = 40, 56


def ball_in_the_sky(count=3, seed=0, sky=SKY):
    """A disc with noisy light moves to the right before a sky of one colour."""
    g = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.arange(H), torch.arange(W), indexing="ij")
    for number in range(count):
        ball = ((x - 20 - 3 * number) ** 2 + (y - 20) ** 2 < 100)[None, None]
        light = torch.empty(1, 3, H, W).exponential_(generator=g)
        speed = torch.tensor([3.0, 0.0]).reshape(1, 2, 1, 1) * ball
        yield Frame(
            radiance=torch.where(ball, 0.4 * light, sky),
            albedo=0.6 * ball.expand(1, 3, H, W),
            normal=torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1) * ball,
            depth=3.0 * ball,
            motion=-speed,
            motion_next=speed,
            number=number,
        )


def open_sky(frame, beside=1):
    """Pixels farther than `beside` from anything that was hit."""
    hit = (frame.depth > 0).float()
    return (torch.nn.functional.max_pool2d(hit, 2 * beside + 1, 1, beside) == 0).expand(1, 3, H, W)


def shows_sky(frame):
    """Pixels that hit nothing, nor do the four at their sides."""
    hit = (frame.depth > 0).float()
    pool = torch.nn.functional.max_pool2d
    sides = pool(hit, (3, 1), 1, (1, 0)).maximum(pool(hit, (1, 3), 1, (0, 1)))
    return (sides == 0).expand(1, 3, H, W)


def through_torch(model, frames, precision="fp32"):
    denoiser, history = models.load(model, precision=precision), None
    with torch.inference_mode():
        for frame in frames:
            image, history = denoiser.step(frame, history)
            yield image


def through_shaders(model, frames):
    pipeline, history = Pipeline.load(model), None
    for frame in frames:
        image, history = pipeline.step(frame.map(torch.Tensor.numpy), history)
        yield torch.from_numpy(image)


@pytest.mark.parametrize("model", ["default", "paper"])
@pytest.mark.parametrize("run", [through_torch, through_shaders])
def test_an_even_sky_has_no_outlines(run, model):
    frames = list(ball_in_the_sky())
    for frame, image in zip(frames, run(model, frames), strict=True):
        kept = shows_sky(frame)
        assert (kept & ~open_sky(frame)).any(), "a pixel with a silhouette at a corner alone"
        assert torch.equal(image[kept], frame.radiance[kept])
        assert not torch.equal(image[~kept], frame.radiance[~kept])


def test_the_offline_mode_keeps_an_even_sky(tmp_path):
    frames = list(ball_in_the_sky())
    shot = write_sequence(tmp_path / "shot", frames)
    denoise(str(shot), tmp_path / "out", Options(offline=True, float32=True))
    for frame, path in zip(open_sequence(shot), sorted((tmp_path / "out").glob("*.exr")), strict=True):
        image = torch.from_numpy(np.stack(list(read_channels(path, "RGB").values())))[None]
        kept = shows_sky(frame)
        assert torch.equal(image[kept], frame.radiance[kept])
        assert not torch.equal(image[~kept], frame.radiance[~kept])


@pytest.mark.parametrize("model", ["default", "paper"])
def test_torch_and_shaders_agree_on_a_sky(assert_images_close, model):
    frames = list(ball_in_the_sky())
    for expected, found in zip(through_torch(model, frames), through_shaders(model, frames), strict=True):
        assert_images_close(found, expected, "frame")


def test_edges_gradients_and_sparse_light_are_left_to_the_filter():
    (frame,) = ball_in_the_sky(1)
    filtered = torch.zeros_like(frame.radiance)
    gradient = SKY * torch.linspace(1, 2, W)
    sparse = torch.where(torch.rand(1, 1, H, W, generator=torch.Generator().manual_seed(1)) < 0.03, 8.0, 0.0)
    for light in (gradient, sparse.expand(1, 3, H, W)):
        assert torch.equal(even_sky(filtered, light.expand_as(filtered), torch.zeros_like(frame.depth)), filtered)
    beside = ~shows_sky(frame)
    assert torch.equal(even_sky(filtered, frame.radiance, frame.depth)[beside], filtered[beside])
    assert even_sky(filtered, frame.radiance, torch.ones_like(frame.depth)) is filtered


def test_a_pixel_of_another_colour_is_filtered_with_its_neighbourhood():
    sky = SKY.expand(1, 3, H, W).clone()
    sky[0, :, 4, 4] *= 1.002  # beyond the tolerance
    filtered, nothing = torch.zeros_like(sky), torch.zeros(1, 1, H, W)
    kept = (even_sky(filtered, sky, nothing) != 0)[0, 0]
    assert not kept[:16, :16].any() and kept[16:].all() and kept[:, 16:].all()


@pytest.mark.parametrize("choice", ["plain", "fused"])
def test_a_gap_without_open_sky_around_it_is_filtered(choice):
    """Sky between leaves: nothing tells whether it is even."""
    y, x = torch.meshgrid(torch.arange(H), torch.arange(W), indexing="ij")
    leaves = ((x % 2 == 0) & (y % 2 == 0)).float()[None, None]
    filtered, sky = torch.zeros(1, 3, H, W), SKY.expand(1, 3, H, W).contiguous()
    with ops.use(choice):
        assert torch.equal(even_sky(filtered, sky, leaves), filtered)
        mixed = sky.clone()
        mixed[..., 20, 20] *= 0.9  # partly covered, by a leaf at a corner
        far = torch.zeros(1, 1, H, W)
        far[..., 21, 21] = 1.0
        kept = (even_sky(filtered, mixed, far) != 0)[0, 0]
    assert not kept[20:22, 20].any() and not kept[20, 21] and not kept[21, 21]
    assert kept[22, 22] and kept[22, 20] and kept[20, 22] and kept[:19].all()


@pytest.mark.parametrize("size", [(1, 1), (3, 9), (17, 8)])
def test_a_frame_of_sky_alone(size):
    light = torch.full((2, 3, *size), 0.25)
    assert torch.equal(even_sky(torch.zeros_like(light), light, torch.zeros(2, 1, *size)), light)


def with_mirror(frames):
    """The disc with an albedo between 0 and 41 in every pixel, as Cycles writes it for a mirror."""
    for frame in frames:
        g = torch.Generator().manual_seed(frame.number)
        yield replace(frame, albedo=torch.empty(1, 3, H, W).uniform_(0, 41, generator=g) * (frame.depth > 0))


def test_albedo_of_a_mirror_leaves_backends_and_precisions_together(assert_images_close):
    frames = list(with_mirror(ball_in_the_sky()))
    single, half = (list(through_torch("default", frames, p)) for p in ("fp32", "bf16"))
    for expected, found, rounded in zip(single, through_shaders("default", frames), half, strict=True):
        assert_images_close(found, expected, "frame")
        error = np.asarray((rounded - expected).abs() / (expected + 1e-2))
        assert error.max() < 0.03, "bfloat16 is far from float32"
