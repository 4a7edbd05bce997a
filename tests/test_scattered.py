"""What is out of focus: one sample a pixel hits it here and there (`ops.scattered`)."""

from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, thin

from rtdenoise import glsl, models, ops
from rtdenoise.constants import DEPTH_TOLERANCE, SCATTERED_REACH
from rtdenoise.frame import Frame
from rtdenoise.models.shrinkage import edges
from rtdenoise.ops.keep import keep
from rtdenoise.ops.recall import recall
from rtdenoise.ops.scattered import scattered

SIZE, SHARE, LAMP, WALL = (48, 64), 0.2, 9.0, 0.1  # share of the samples that hit the lamp; light of both
NEAR, FAR = 3.0, 5.0  # depths


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def wall(size=SIZE):
    return torch.full((1, 1, *size), FAR)


def reach(depth):
    """The rows and columns where there is anything scattered."""
    least, greatest = scattered(depth)[0]
    there = least <= greatest
    return there.any(1).nonzero().flatten().tolist(), there.any(0).nonzero().flatten().tolist()


def test_a_lone_sample_tells_all_around_it(choice):
    depth = wall()
    assert reach(depth) == ([], []) and (scattered(depth) == torch.tensor([1.0, 0.0]).view(1, 2, 1, 1)).all()
    depth[..., 20, 30] = NEAR
    around = range(-SCATTERED_REACH, SCATTERED_REACH + 1)
    assert reach(depth) == ([20 + i for i in around], [30 + i for i in around])
    least, greatest = scattered(depth)[0, :, 20, 30].tolist()
    assert least == pytest.approx((1 - DEPTH_TOLERANCE) * NEAR) and greatest == pytest.approx(NEAR / 0.9)
    depth[..., 22, 30] = 1.4 * NEAR
    least, greatest = scattered(depth)[0, :, 21, 30].tolist()
    assert least == pytest.approx((1 - DEPTH_TOLERANCE) * NEAR) and greatest == pytest.approx(1.4 * NEAR / 0.9)
    depth[..., 22, 30] = 1.5 * FAR  # more than SCATTERED_APART times as far
    assert scattered(depth)[0, :, 21, 30].tolist() == [1, 0], "what passes between both would leave a trail"


def test_what_has_neighbours_is_not_alone(choice):
    """An edge, a wire of two pixels, a corner of the picture, and the sky."""
    for rows, columns in ((slice(10, 48), slice(0, 64)), (slice(10, 12), slice(0, 64)), (slice(0, 2), slice(0, 2))):
        depth = wall()
        depth[..., rows, columns] = NEAR
        assert reach(depth) == ([], [])
    depth = wall()
    depth[..., 20, 30] = 0
    assert reach(depth) == ([], []), "nothing was hit"
    depth = wall()
    depth[..., 0, 0] = NEAR  # repeated beyond the border
    assert reach(depth) == ([], [])


def test_the_end_of_a_line_is_not_alone(choice):
    """One sample, or two side by side, are; a spark of three and more would leave a trail where it was."""
    for length, there in ((1, 7), (2, 8), (3, 0), (9, 0)):
        depth = wall()
        for i in range(length):
            depth[..., 20 + i // 2, 30 + i] = NEAR
        assert len(reach(depth)[1]) == there


def test_compiled_code_is_the_formula():
    torch.manual_seed(0)
    for size in ((1, 1), (1, 2), (2, 1), (3, 5), (8, 7), (21, 38), (50, 300)):
        depth = (FAR - (FAR - NEAR) * (torch.rand(2, 1, *size) < 0.2).float()) * (torch.rand(2, 1, *size) > 0.05)
        with ops.use("plain"):
            plain = scattered(depth)
        with ops.use("fused"):
            torch.testing.assert_close(scattered(depth), plain, atol=0, rtol=1e-6)


def test_shapes_must_fit():
    for shape in ((1, 2, 4, 4), (4, 4)):
        with pytest.raises(ValueError, match="expected depth"):
            scattered(torch.zeros(shape))


def blurred(number, size=SIZE, speed=0, share=SHARE):
    """A lamp out of focus before a wall: each sample hits either. All moves by `speed` pixels a frame."""
    hit = torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(number)) < share
    light = torch.where(hit, LAMP, WALL).expand(1, 3, *size).contiguous()
    normal = torch.tensor([0, 0, 1.0]).view(1, 3, 1, 1).expand(1, 3, *size).contiguous()
    motion = torch.tensor([-float(speed), 0.0]).view(1, 2, 1, 1).expand(1, 2, *size).contiguous()
    truth = torch.full((1, 3, *size), share * LAMP + (1 - share) * WALL)
    return Frame(light, albedo=torch.ones_like(light), normal=normal, depth=torch.where(hit, NEAR, FAR),
                 motion=motion, motion_next=-motion, reference=truth, number=number)  # fmt: skip


@pytest.mark.parametrize("speed", [0, 1])
@pytest.mark.parametrize("share", [0.05, SHARE])
def test_what_is_out_of_focus_keeps_its_light(choice, speed, share):
    """The mean over recent frames is that of the samples; nearly so where one in twenty hits."""
    *frames, frame = (blurred(i, speed=speed, share=share) for i in range(9))
    nothing = torch.zeros_like(frame.depth)
    recent = [keep(f.radiance / 1.08, f.depth, f.normal, nothing, f.motion, f.albedo) for f in frames[::-1]]
    masks = nothing > 0, None, scattered(frame.depth)
    found = recall(frame.radiance / 1.08, frame.motion, (frame.depth, frame.normal), recent, *masks)
    inside = (..., slice(12, -12))  # what came into the picture has fewer frames
    mean = (found.footprint[:, :3] * found.footprint_count)[inside].mean() / found.footprint_count[inside].mean()
    seen = torch.stack([f.radiance for f in frames]).mean()
    assert mean == pytest.approx(seen.item(), rel=0.05 if share == SHARE else 0.2)


@torch.inference_mode()
def test_a_blurred_lamp_is_as_bright_with_history(choice):
    network, history = models.load("hybrid-fast", precision="fp32"), None
    lit, single = [], []
    for i in range(8):
        frame = blurred(i, speed=1)
        image, history = network.step(frame, history)
        lit.append(image[..., 12:-12].mean() / frame.reference.mean())
        single.append(network.step(frame)[0][..., 12:-12].mean() / frame.reference.mean())
    assert sum(lit[4:]) > 0.9 * sum(single[4:])


def test_no_two_frames_are_witnesses_of_what_is_out_of_focus():
    """The samples of one surface agree, whatever the converged pixel shows (`models.shrinkage`)."""
    assert edges(blurred(0)).float().mean() > 0.98
    assert not edges(replace(blurred(0), depth=wall())).any()


@torch.inference_mode()
def test_the_shaders_do_so_too(gl, weights, assert_images_close):
    path = weights(thin("hybrid-fast"))
    network, pipeline = models.read(path), glsl.Pipeline.load(path)
    history = resident = None
    for i, frame in enumerate(make_frames(4, H=21, W=38)):
        lone = torch.rand(1, 1, 21, 38, generator=torch.Generator().manual_seed(i)) < 0.1
        frame = replace(frame, depth=torch.where(lone, 0.5 * frame.depth, frame.depth))
        image, history = network.step(frame, history)
        found, resident = pipeline.step(frame.map(lambda t: t.numpy()), resident)
        assert_images_close(found, image, "frame")


def passing(number, size=SIZE, speed=8):
    """Thin blades here and there before a bright object that passes, and behind it; a wall behind all."""
    draw = torch.Generator().manual_seed(0)
    near, far = (torch.rand(1, 1, *size, generator=draw) < 0.05 for _ in range(2))
    x = torch.arange(size[1])
    there = ((x >= speed * number) & (x < speed * number + 16)).expand(1, 1, *size)
    depth = torch.where(near, 2.0, torch.where(there, 5.0, torch.where(far, 8.0, 12.0)))
    light = torch.where(there & ~near, 4.0, 0.4).expand(1, 3, *size).contiguous()
    motion = torch.cat([torch.where(there & ~near, -float(speed), 0.0), torch.zeros_like(depth)], dim=1)
    normal = torch.tensor([0, 0, 1.0]).view(1, 3, 1, 1).expand(1, 3, *size).contiguous()
    return Frame(light, albedo=torch.ones_like(light), normal=normal, depth=depth, motion=motion, motion_next=-motion)


def test_what_passes_between_lone_samples_leaves_no_trail(choice):
    frames = [passing(i) for i in range(5)]
    frame, nothing = frames[-1], torch.zeros_like(frames[0].depth)
    recent = [keep(f.radiance / 1.08, f.depth, f.normal, nothing, f.motion, f.albedo) for f in frames[-2::-1]]
    masks = nothing > 0, None, scattered(frame.depth)
    found = recall(frame.radiance / 1.08, frame.motion, (frame.depth, frame.normal), recent, *masks)
    trail = found.footprint[..., :24] * (found.footprint_count[..., :24] > 0)
    assert trail[:, :3].max() < 0.5
