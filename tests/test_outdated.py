"""Light that changes at once, as a lamp that flickers or a shadow that moves: what was seen before is outdated
(`ops.agrees`, `ops.outdated`)."""

from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, thin

from rtdenoise import Denoiser, glsl, models, ops
from rtdenoise.constants import OUTDATED_CELL, OUTDATED_FRAMES, OUTDATED_RIM
from rtdenoise.frame import Known
from rtdenoise.models import past
from rtdenoise.ops.agrees import agrees
from rtdenoise.ops.outdated import flashed, outdated

KINDS = ["default", "fast", "hybrid-fast", "many"]


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def noisy(light, share=0.25, size=(64, 96)):
    """Light of which a share of the pixels sees all."""
    return light * (torch.rand(1, 1, *size) < share).expand(1, 3, -1, -1) / share


def everywhere(size=(64, 96)):
    return torch.ones(1, 1, *size, dtype=torch.bool)


def test_noise_is_no_change(choice):
    torch.manual_seed(0)
    mean = torch.stack([noisy(2.0) for _ in range(8)]).mean(0)
    assert agrees(noisy(2.0), mean, everywhere()).mean() > 0.95
    assert agrees(noisy(2.0), noisy(2.0), everywhere()).mean() > 0.95  # of one frame


@pytest.mark.parametrize("factor", [0.0, 0.4, 2.0])
def test_changed_light_is_told_from_noise(choice, factor):
    """In one half of the picture alone; cells beside it see some of both."""
    torch.manual_seed(0)
    light = noisy(1.0)
    light[..., 48:] *= factor
    found = agrees(light, torch.ones(1, 3, 64, 96), everywhere())
    assert found[..., :32].mean() > 0.95 and found[..., 64:].mean() < 0.1


def test_a_change_of_colour_is_one(choice):
    """Red gives way to as much blue."""
    torch.manual_seed(0)
    red, blue = (torch.tensor(c).view(1, 3, 1, 1) for c in ([1.0, 0.2, 0.2], [0.2, 0.2, 1.0]))
    assert agrees(blue * noisy(1.0), red.expand(1, 3, 64, 96), everywhere()).mean() < 0.1


def test_without_a_mean_nothing_disagrees(choice):
    assert (agrees(noisy(1.0), torch.full((1, 3, 64, 96), 50.0), ~everywhere()) == 1).all()


def test_sizes_must_fit():
    image = torch.zeros(1, 3, 8, 9)
    for mean, found in ((image[..., 1:], image[:, :1]), (image[:, :1], image[:, :1]), (image, image)):
        with pytest.raises(ValueError, match="expected two images"):
            agrees(image, mean, found > 0)


def by_hand(found, agree, frames):
    """The formula of `outdated`, cell by cell. The last cells are cut off by the border."""
    few, (H, W) = min(frames, OUTDATED_FRAMES), agree.shape

    def share(side, i, j, enough):
        there = slice(side * i, side * (i + 1)), slice(side * j, side * (j + 1))
        return max(0.0, 1 - agree[there].max().item() / enough) if found[there].any() else 0.0

    cells = [(i, j) for i in range(-(-H // OUTDATED_CELL)) for j in range(-(-W // OUTDATED_CELL))]
    whole = {cell: share(OUTDATED_CELL, *cell, 1) for cell in cells}

    def around(cell):
        return [(cell[0] + y, cell[1] + x) for y in (-1, 0, 1) for x in (-1, 0, 1)]

    sure = {c: whole[c] * min(1, sum(whole.get(k, 0) for k in around(c)) - whole[c]) for c in cells}
    expected, scale = torch.zeros(H, W), OUTDATED_CELL // OUTDATED_RIM
    for i in range(-(-H // OUTDATED_RIM)):
        for j in range(-(-W // OUTDATED_RIM)):
            cell = i // scale, j // scale
            rim = min(max(sure.get(k, 0) for k in around(cell)), share(OUTDATED_RIM, i, j, few))
            there = slice(OUTDATED_RIM * i, OUTDATED_RIM * (i + 1)), slice(OUTDATED_RIM * j, OUTDATED_RIM * (j + 1))
            expected[there] = max(whole[cell], rim)
    return expected


@pytest.mark.parametrize("frames", [1, 2, 8])
def test_the_share_that_is_outdated_is_that_of_the_formula(frames):
    generator = torch.Generator().manual_seed(frames)
    cells = 0.3 * torch.rand(13, 17, generator=generator).sub(0.75).clamp(min=0).mul(60).round()
    cells[4:9, 5:12] = 0  # a shadow
    agree = cells.repeat_interleave(OUTDATED_RIM, 0).repeat_interleave(OUTDATED_RIM, 1)[:-1, :-2]
    found = torch.rand(agree.shape, generator=generator) < 0.02
    expected = by_hand(found, agree, frames)
    assert ((expected > 0) & (expected < 1)).any() and (expected == 0).any() and (expected == 1).any()
    assert torch.allclose(outdated(found[None, None], agree[None, None], frames)[0, 0], expected, atol=1e-5)


def test_beside_light_that_has_changed_more_frames_must_agree():
    agree = torch.full((1, 1, 4 * OUTDATED_CELL, 6 * OUTDATED_CELL), 2.0)
    agree[..., OUTDATED_CELL : 2 * OUTDATED_CELL, OUTDATED_CELL : 2 * OUTDATED_CELL] = 0
    found = torch.ones_like(agree, dtype=torch.bool)
    share = outdated(found, agree, 8)
    assert torch.equal(share, (agree == 0).float()), "one cell may be chance"
    agree[..., OUTDATED_CELL : 2 * OUTDATED_CELL, 2 * OUTDATED_CELL : 3 * OUTDATED_CELL] = 0
    share = outdated(found, agree, 8)
    assert torch.allclose(share[..., : 3 * OUTDATED_CELL, : 4 * OUTDATED_CELL][agree[..., :24, :32] > 0],
                          torch.tensor(1 - 2 / OUTDATED_FRAMES))  # fmt: skip
    assert not share[..., 3 * OUTDATED_CELL :, :].any() and not share[..., 4 * OUTDATED_CELL :].any()
    assert torch.equal(outdated(found, agree, 2), (agree == 0).float()), "all that were asked agree"


def test_a_flash_is_one_where_cells_that_touch_fail():
    side = OUTDATED_CELL
    agree, found = torch.ones(1, 1, 6 * side, 9 * side), torch.ones(1, 1, 6 * side, 9 * side, dtype=torch.bool)
    agree[..., : 2 * side, : 4 * side] = 0  # at the border
    agree[..., 3 * side :, 5 * side : 8 * side] = 0.25
    agree[..., 4 * side : 5 * side, : 3 * side] = 0  # no body
    expected = 1 - agree
    expected[..., 4 * side : 5 * side, : 3 * side] = 0
    assert torch.equal(flashed(found, agree), expected)
    found[..., 4 * side :, 6 * side] = False  # cells in part
    assert torch.equal(flashed(found, agree), expected)
    found[..., 3 * side :, 5 * side :] = False  # nothing was there before
    expected[..., 3 * side :, 5 * side :] = 0
    assert torch.equal(flashed(found, agree), expected)


def flickering(light, still=False):
    """A shot whose light is another in each frame; the noise is small."""
    size = {"H": 48, "W": 64, "noise": 0.4}
    frames = make_frames(len(light), **size)
    if still:
        frames = [make_frames(1, seed=i, **size)[0] for i in range(len(light))]
        frames = [replace(f, motion=0 * f.motion, motion_next=0 * f.motion) for f in frames]
    return [
        replace(frame, radiance=frame.radiance * of, reference=frame.reference * of)
        for frame, of in zip(frames, (torch.tensor(c).view(1, 3, 1, 1) for c in light), strict=True)
    ]


def shaded(count):
    """A shot in which a slanted shadow moves on by ten pixels a frame."""
    x, y = torch.arange(96), torch.arange(48)[:, None] // 2
    frames = []
    for i, frame in enumerate(make_frames(count, H=48, W=96)):
        light = torch.where((x + y > 10 * i + 3) & (x + y < 10 * i + 43), 0.1, 1.0)
        frames.append(replace(frame, radiance=frame.radiance * light, reference=frame.reference * light))
    return frames


def turning(count):
    """A shot in which a lamp flickers and plain surfaces turn."""
    shot = flickering([(1.0,) * 3, (3.0,) * 3, (1.0,) * 3, (3.0,) * 3][:count])
    angles = [torch.tensor(0.1 * i) for i in range(count)]
    normals = [torch.stack([a.sin(), 0 * a, a.cos()]).view(1, 3, 1, 1) for a in angles]
    grey = torch.full_like(shot[0].albedo, 0.5)
    return [replace(f, albedo=grey, normal=n.expand_as(f.normal).contiguous())
            for f, n in zip(shot, normals, strict=True)]  # fmt: skip


def error(image, frame):
    return ((image - frame.reference) / frame.reference.mean()).square().mean().sqrt().item()


@torch.inference_mode()
@pytest.mark.parametrize("still", [False, True], ids=["moves", "still"])
@pytest.mark.parametrize("name", KINDS)
def test_a_lamp_that_flickers_leaves_nothing_behind(name, still):
    """Whether it becomes brighter, darker or another colour: the picture is as good as one without history."""
    network, history = models.load(name, precision="fp32"), None
    shot = flickering([(1.0,) * 3, (1.0,) * 3, (4.0,) * 3, (0.5,) * 3, (2.0, 0.4, 0.4), (0.4, 0.4, 2.0)], still)
    for i, frame in enumerate(shot):
        image, history = network.step(frame, history, Known(still=still and i > 0))
        alone = network.step(frame)[0]
        if i >= 2:
            assert error(image, frame) < 1.15 * error(alone, frame), i


@torch.inference_mode()
def test_a_strobe_leaves_nothing_behind_with_frames_ahead():
    """Frames ahead agree with each frame but one, as frames before do: their light counts, and the previous picture
    does not. The last frames have none ahead."""
    shot = flickering([(1.0,) * 3, (0.4, 1.0, 4.0)] * 3, still=True)
    denoiser = Denoiser("default", precision="fp32", lookahead=2, detect_exposure=False)
    layers = "albedo", "normal", "depth", "motion", "motion_next"
    images = [denoiser(f.radiance, **{layer: getattr(f, layer) for layer in layers}) for f in shot][2:]
    network = models.load("default", precision="fp32")
    for i, (image, frame) in enumerate(zip(images + denoiser.flush(), shot, strict=True)):
        assert error(image, frame) < 0.95 * error(network.step(frame)[0], frame), i


@torch.inference_mode()
def test_a_shadow_that_moves_on_leaves_no_trail():
    network, history, shot = models.load("hybrid-fast", precision="fp32"), None, shaded(5)
    for i, frame in enumerate(shot):
        image, history = network.step(frame, history)
        if i >= 2:
            changed = ((frame.reference - shot[i - 1].reference).abs().sum(1, keepdim=True) > 0.3).expand_as(image)
            both = image, network.step(frame)[0]
            errors = [(x - frame.reference)[changed].square().mean().sqrt() for x in both]
            assert errors[0] < 1.16 * errors[1], i


@torch.inference_mode()
def test_where_surfaces_turn_history_gives_way_to_that_alone():
    """What they reflect always changes."""
    config, (before, frame) = models.PRESETS["default"], turning(2)
    _, history = models.create(config).step(before)
    found = past.reprojected(config, frame, frame.radiance / 2, history)
    whole = past.reprojected(config, replace(frame, normal=before.normal), frame.radiance / 2, history).outdated
    assert found.turned.max() > 0.5 and torch.allclose(found.outdated, whole * (1 - found.turned), atol=1e-4)


@torch.inference_mode()
def test_frames_ahead_agree_in_the_place_of_those_before():
    """Light that has just changed, and stays so: the mean is that of the frames after."""
    before, *ahead = flickering([(0.2,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 3])
    config = models.PRESETS["default"]
    _, history = models.create(config).step(before)
    frame, ahead = ahead[0], tuple(ahead[1:])
    alone, both = (past.reprojected(config, frame, frame.radiance / 2, history, Known(ahead=a)) for a in ((), ahead))
    wall = (..., slice(24, 48), slice(None))  # the square is above
    assert (alone.outdated[wall] == 1).all() and not both.outdated[wall].any()
    assert not alone.on_screen[wall].any() and not both.on_screen[wall].any()  # the picture before is outdated anyway
    assert torch.equal(alone.output[wall], frame.radiance[wall])


@torch.inference_mode()
@pytest.mark.parametrize(
    "shot",
    [flickering([(1.0,) * 3, (4.0,) * 3, (4.0, 0.5, 0.5), (1.0,) * 3]), shaded(4), turning(4)],
    ids=["lamp", "shadow", "turning"],
)
@pytest.mark.parametrize("name", KINDS)
def test_outdated_light_is_that_of_torch_in_the_shaders(name, shot, gl, weights, assert_images_close):
    path = weights(thin(name))
    network, pipeline = models.read(path), glsl.Pipeline.load(path)
    history = resident = None
    for i, frame in enumerate(shot):
        frame = frame.map(lambda t: t[..., 8:56, 16:80].contiguous())  # three cells by four
        known = Known(still=i == 3)
        if i >= 2:  # in the last one nothing moves
            frame = replace(frame, motion=frame.motion * (i == 2), motion_next=0 * frame.motion)
        image, history = network.step(frame, history, known)
        found, resident = pipeline.step(frame.map(lambda t: t.numpy()), resident, known)
        assert_images_close(found, image, "frame")
