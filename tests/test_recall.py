"""Recent frames: kept, followed along chained motion, tested for changed light, averaged (`ops.recall`); and the
network that keeps them."""

from dataclasses import replace

import pytest
import torch
from synthetic import TINY, assert_goes_on, make_frames, reset_of, write_sequence

from rtdenoise import models, ops
from rtdenoise.color import albedo_divisor
from rtdenoise.constants import GLOSS, RECALL_SAME
from rtdenoise.errors import InputError
from rtdenoise.exposure import noise_level
from rtdenoise.frame import OFF_SCREEN, Frame, History
from rtdenoise.history import load_history, resize, save_history
from rtdenoise.models import AccumulatedKPNConfig
from rtdenoise.models.past import turning
from rtdenoise.ops.keep import keep
from rtdenoise.ops.kept import edge_motion
from rtdenoise.ops.pixels import accumulate
from rtdenoise.ops.recall import FOOTPRINT, recall, unchanged, white
from rtdenoise.run.denoise import Options
from rtdenoise.run.tiles import Tiled, carried
from rtdenoise.sanitise import sanitise

SIZE = 16, 24
SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, footprint=True)


def image(*values):
    return torch.tensor(values).reshape(1, -1, 1, 1).expand(1, -1, *SIZE).clone()


WALL = image(4.0), image(0.0, 0.0, 1.0)  # depth, normal


def noisy(mean=1.0):
    return mean * torch.empty(1, 3, *SIZE).exponential_()


def kept(light, depth, normal, motion, reset=0.0, albedo=None):
    return keep(light, depth, normal, image(reset), motion, albedo)


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


@pytest.fixture(autouse=True)
def seed():
    torch.manual_seed(0)


# The op


def test_light_that_stays_is_averaged(choice):
    lights = [noisy().bfloat16().float() for _ in range(5)]
    still = image(0.0, 0.0)
    found = recall(noisy(), still, WALL, [kept(light, *WALL, still) for light in lights])
    mean, count = found.light, found.count
    assert (count > 4.5).float().mean() > 0.7
    whole = (count == 5).expand_as(mean)
    assert whole.any()
    torch.testing.assert_close(mean[whole], torch.stack(lights).mean(0)[whole])


def test_light_that_has_changed_is_left_out(choice):
    still = image(0.0, 0.0)
    frames = [kept(noisy(mean), *WALL, still) for mean in (1.0, 20.0, 0.01, 1.0)]
    found = recall(noisy(), still, WALL, frames)
    mean, count = found.light, found.count
    assert 1.5 < count.mean() <= 2.001
    assert 0.8 < mean.mean() < 1.2


def test_a_weak_change_shows_in_wide_cells(choice):
    """20 % less light: q is about 13 over wide cells, and 4 over others, which alone would leave it a quarter."""
    shape = 1, 3, 96, 96
    still, wall = torch.zeros(1, 2, 96, 96), (torch.full((1, 1, 96, 96), 4.0), torch.zeros(shape))
    wall[1][:, 2] = 1
    now, before, reset = torch.empty(shape).exponential_(), torch.empty(shape).exponential_(), torch.zeros(1, 1, 96, 96)
    count = [recall(now, still, wall, [keep(x, *wall, reset, still)]).count.mean() for x in (before, 0.8 * before)]
    assert count[0] > 0.9 and count[1] < 0.15


def test_bright_samples_do_not_hide_a_change(choice):
    still = image(0.0, 0.0)
    before, now = ((torch.rand(1, 1, *SIZE) < 0.01) * 30.0 + noisy(mean) for mean in (0.4, 1.0))
    assert recall(now, still, WALL, [kept(before, *WALL, still)]).count.mean() < 0.1


def test_strips_meet(choice):
    """Fused recall goes strip by strip of 240 columns, a strip being as any picture."""
    shape = 1, 3, 43, 503
    light, before = (torch.empty(shape).exponential_() for _ in range(2))
    before[..., 250:] *= 0.5
    depth, normal = 1 + torch.rand(1, 1, *shape[2:]).round(), torch.zeros(shape).index_fill(1, torch.tensor(2), 1)
    motion = 3 * torch.randn(1, 2, *shape[2:]).round()
    frame = keep(before, depth, normal, torch.rand(1, 1, *shape[2:]), motion, torch.rand(shape))
    uncovered = torch.zeros_like(depth, dtype=torch.bool)
    found = recall(light, motion, (depth, normal), [frame, frame], uncovered)
    with ops.use("plain"):
        expected = recall(light, motion, (depth, normal), [frame, frame], uncovered)
    for name in ("light", "count", "footprint", "footprint_count"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-4, atol=1e-4)


def test_a_reset_takes_weight_from_older_frames(choice):
    still, lights = image(0.0, 0.0), [noisy().bfloat16().float() for _ in range(4)]
    frames = [kept(light, *WALL, still, r) for light, r in zip(lights, (0.0, 0.5, 1.0, 0.0), strict=True)]
    found = recall(noisy(), still, WALL, frames)
    mean, count = found.light, found.count
    whole = (count == 2.5).expand_as(mean)
    assert whole.float().mean() > 0.5
    expected = (lights[0] + lights[1] + 0.5 * lights[2]) / 2.5
    torch.testing.assert_close(mean[whole], expected[whole])


def test_paths_add_up_before_they_are_rounded(choice):
    """0.3 pixels a frame: 0, 1, 1 after one, two and three frames."""
    motion, light = image(-0.3, 0.0), noisy().bfloat16().float()
    found = recall(noisy(), motion, WALL, [kept(light, *WALL, motion) for _ in range(3)])
    mean, count = found.light, found.count
    expected = (light + 2 * light.roll(1, dims=3)) / 3
    whole = (count == 3).expand_as(mean)
    assert whole.float().mean() > 0.5 and not whole[..., 0].any()
    torch.testing.assert_close(mean[whole], expected[whole])


@pytest.mark.parametrize("bad", [OFF_SCREEN, 1e30, -1e30, 3.4e38, float("nan"), 24.0])
def test_paths_end_off_the_screen(choice, bad):
    still, away = image(0.0, 0.0), image(bad, bad)
    frames = [kept(noisy(), *WALL, still), kept(noisy(), *WALL, away), kept(noisy(), *WALL, still)]
    found = recall(noisy(), away, WALL, frames)
    mean, count = found.light, found.count
    assert not count.any() and not mean.any()
    count = recall(noisy(), still, WALL, frames).count
    assert 1 < count.max() <= 2  # the second frame leads away from the third


def test_without_motion_a_frame_is_the_last_of_a_path(choice):
    still = image(0.0, 0.0)
    frames = [kept(noisy(), *WALL, None), kept(noisy(), *WALL, still)]
    assert recall(noisy(), still, WALL, frames).count.max() <= 1


def test_other_surfaces_are_left_out(choice):
    still, (depth, normal) = image(0.0, 0.0), WALL
    for other in ((depth * 2, normal), (depth, -normal), (depth * 0, normal)):
        assert not recall(noisy(), still, WALL, [kept(noisy(), *other, still)]).count.any()
    miss = depth * 0, normal
    assert recall(noisy(), still, miss, [kept(noisy(), *miss, still)]).count.any()  # the sky is one surface


def test_without_frames_there_is_no_mean(choice):
    found = recall(noisy(), image(0.0, 0.0), WALL, [])
    mean, count = found.light, found.count
    assert not mean.any() and not count.any()


FLOOR = image(6.0), image(0.0, 1.0, 0.0)
BEHIND = image(90.0), image(1.0, 0.0, 0.0)


def edge(left=WALL, right=FLOOR):
    """Depth and normal of a picture whose right half shows another surface."""
    pairs = [(a.clone(), b) for a, b in zip(left, right, strict=True)]
    for whole, other in pairs:
        whole[..., 12:] = other[..., 12:]
    return tuple(whole for whole, _ in pairs)


def seen(light, motion, surface, recent, uncovered=False):
    return recall(light, motion, surface, recent, torch.full_like(light[:, :1], uncovered, dtype=torch.bool))


def test_a_footprint_holds_all_surfaces_at_an_edge(choice):
    """The column at the edge showed the wall, then the floor, then something that is seen nowhere near."""
    still, light = image(0.0, 0.0), image(1.0, 1.0, 1.0)
    frames = [
        kept(light, *surface, still, albedo=image(*albedo))
        for surface, albedo in ((WALL, (1.0, 0.0, 0.5)), (FLOOR, (0.0, 0.5, 1.0)), (BEHIND, (0.25, 0.25, 0.25)))
    ]
    found = seen(light, still, edge(), frames)
    for column, walls, floors in ((10, 1, 0), (11, 1, 1), (12, 1, 1), (13, 0, 1)):
        assert (found.footprint_count[..., column] == walls + floors).all()
        albedo = torch.tensor([walls * 1.0, floors * 0.5, walls * 0.5 + floors * 1.0]) / (walls + floors)
        normal = torch.tensor([0.0, floors, walls]) / (walls + floors)
        expected = torch.cat([albedo + GLOSS, albedo, normal])
        torch.testing.assert_close(found.footprint[0, :, 4, column], expected, rtol=1e-5, atol=1e-6)
    assert (found.count == 1).all()  # the mean of light is of one surface


def test_what_was_just_uncovered_has_no_footprint(choice):
    still, light = image(0.0, 0.0), image(1.0, 1.0, 1.0)
    found = seen(light, still, WALL, [kept(light, *WALL, still, albedo=light)], uncovered=True)
    assert not found.footprint_count.any() and not found.footprint.any() and (found.count == 1).all()


@pytest.mark.parametrize("speed", [0.75, 6.0])
def test_an_edge_moves_with_what_is_in_front(choice, speed):
    """The right half of the picture, in front, moves. A wall pixel beside it is followed as the front moves, unless
    that is fast: then what was in front of the wall does not belong to the pixel."""
    front, slow = (image(2.0), image(0.0, 1.0, 0.0)), speed < 1
    depth, normal = edge(WALL, front)
    motion = torch.cat([torch.where(depth == 2, -speed, 0.0), torch.zeros_like(depth)], dim=1)
    along, distance = edge_motion(motion, depth)
    assert (along[:, 0, :, 10:13] == torch.tensor([0.0, -speed if slow else 0.0, -speed])).all()
    assert (distance[..., 10:13] == torch.tensor([4.0, 2.0 if slow else 4.0, 2.0])).all()
    light = image(1.0, 1.0, 1.0)
    frames = [kept(light, *surface, image(0.0, 0.0), albedo=light) for surface in (WALL, WALL, front)]
    found = seen(light, motion, (depth, normal), frames)
    assert (found.footprint_count[:, :, 3:-3, 11] == (3 * 0.75 if slow else 2)).all()


def test_light_of_the_sky_is_its_radiance(choice):
    still, light, miss = image(0.0, 0.0), image(2.0, 4.0, 8.0), (image(0.0), image(0.0, 0.0, 0.0))
    found = seen(light, still, miss, [kept(light, *miss, still, albedo=image(0.5, 0.5, 0.5))])
    torch.testing.assert_close(found.footprint[:, :3], light)


def test_lookups_between_pixels_count_less_in_a_footprint(choice):
    """0.25 pixels a frame in x, 0.5 in y: (0.25, 0.5 off), (0.5, 0)."""
    motion, light = image(0.25, -0.5), image(1.0, 1.0, 1.0)
    frames = [kept(light, *WALL, motion, albedo=light) for _ in range(2)]
    found = seen(light, motion, WALL, frames)
    inside = (..., slice(2, -2), slice(2, -2))
    torch.testing.assert_close(found.footprint_count[inside], torch.full_like(light[:, :1], 0.375 + 0.5)[inside])
    assert (found.count[inside] == 2).all()


def test_they_count_less_still_where_there_is_little_noise(choice):
    motion, light = image(0.25, -0.5), image(1.0, 1.0, 1.0)
    frames = [kept(light, *WALL, motion, albedo=light) for _ in range(2)]
    nothing = torch.zeros_like(light[:, :1], dtype=torch.bool)
    found = recall(light, motion, WALL, frames, nothing, torch.full((1, 1, 1, 1), 4.0)).footprint_count
    expected = 0.375 / (1 + 4 * 0.3125) + 0.5 / (1 + 4 * 0.25)
    torch.testing.assert_close(found[..., 2:-2, 2:-2], torch.full_like(found, expected)[..., 2:-2, 2:-2])


def test_the_level_of_noise_falls_with_samples_and_sees_no_edges():
    """Light of k samples, each exponential, has a relative variance of 1 / k."""
    torch.manual_seed(0)
    depth = torch.ones(1, 1, 200, 300)
    picture = torch.where(torch.arange(300) < 100, 0.2, 3.0).expand(1, 3, 200, 300)
    for samples in (4, 16, 64):
        noisy = picture * torch.empty(samples, 1, 200, 300).exponential_().mean(0)
        level = noise_level(noisy, depth)
        assert level.shape == (1, 1, 1, 1) and 0.8 < samples * level.item() < 1.1
    assert noise_level(picture, depth) == 0
    for nothing_known in ((noisy, 0 * depth), (0 * noisy, depth), (noisy[..., :2, :2], depth[..., :2, :2])):
        assert noise_level(*nothing_known).isposinf().all()


def test_changed_light_and_resets_leave_footprints(choice):
    still = image(0.0, 0.0)
    frames = [
        kept(noisy(mean), *WALL, still, r, image(0.5, 0.5, 0.5)) for mean, r in ((1.0, 0.0), (50.0, 1.0), (1.0, 0.0))
    ]
    found = seen(noisy(), still, WALL, frames)
    torch.testing.assert_close(found.footprint_count, found.count)
    assert 0.5 < found.count.mean() <= 1.001


def test_footprints_need_albedo():
    with pytest.raises(ValueError, match=r"expected kept frames of \(1, 8, 16, 24\)"):
        seen(noisy(), image(0.0, 0.0), WALL, [kept(noisy(), *WALL, None)])


def test_shapes_are_checked():
    with pytest.raises(ValueError, match="expected kept frames of"):
        recall(noisy(), image(0.0, 0.0), WALL, [torch.zeros(1, 5, 4, 4, dtype=torch.int32)])
    for words, dtype in ((5, torch.uint8), (5, torch.int64), (7, torch.int32), (9, torch.int32)):  # C would read beyond
        with pytest.raises(ValueError, match="expected kept frames of"):
            recall(noisy(), image(0.0, 0.0), WALL, [torch.zeros(1, words, *SIZE, dtype=dtype)])
    for uncovered in (torch.zeros(1, 1, 4, 4, dtype=torch.bool), torch.zeros(1, 1, *SIZE)):
        with pytest.raises(ValueError, match="expected uncovered"):
            recall(noisy(), image(0.0, 0.0), WALL, [], uncovered)


# The network


def test_resets_are_kept(network):
    frames = make_frames(3)
    _, history = run(network, frames)
    newest, middle, oldest = (reset_of(kept) for kept in history.recent)
    assert not oldest.any()  # it has none before it
    assert (newest > 0).all() and (middle > 0).all() and (newest < 0.2).all()


def test_paths_end_where_something_else_passed(network):
    """A rod before a plate, as near and facing alike, passes to the right by a column of pixels a frame."""
    here = torch.arange(SIZE[1]).expand(1, 1, *SIZE)
    shot = []
    for i in range(4):
        rod = here // 4 == i + 1
        motion = torch.where(rod, image(-4.0, 0.0), image(0.0, 0.0))
        surface = {"albedo": image(0.5, 0.5, 0.5), "normal": WALL[1], "depth": torch.where(rod, 3.9, WALL[0])}
        shot.append(Frame(noisy(), **surface, motion=motion, motion_next=-motion, number=i))
    _, history = run(network, shot)
    for age, kept in enumerate(history.recent[:2]):
        left = here // 4 == len(shot) - 1 - age  # where the rod was in the frame before that
        assert torch.equal(reset_of(kept) == 1, left)
    after = turning(*map(sanitise, shot[1:3]))
    assert torch.equal(after == 1, here // 4 == 3)  # the rod will be there


def run(model, frames, history=None):
    images = []
    with torch.inference_mode():
        for frame in frames:
            picture, history = model.step(frame, history)
            images.append(picture)
    return torch.cat(images), history


@pytest.fixture
def network():
    return models.create(SMALL).eval()


def test_the_newest_frames_are_kept(network):
    frames = make_frames(6)
    assert [len(run(network, frames[:n])[1].recent) for n in (1, 2, 5)] == [1, 2, 3]
    _, history = run(network, frames[:5])
    alone = [run(network, [frame])[1].recent[0] for frame in frames[:5]]
    but_for_resets = torch.tensor([-1, -1, -1, 0xFFFF, -1, -1, -1, -1], dtype=torch.int32).reshape(1, -1, 1, 1)
    for kept, expected in zip(history.recent, alone[:1:-1], strict=True):
        assert torch.equal(kept & but_for_resets, expected & but_for_resets)


def test_the_mean_is_of_recent_frames_and_this_one(network):
    """Lookups of a still picture mix nothing, so that its mean is as quiet as so many frames."""
    shot = [replace(f, motion=torch.zeros_like(f.motion), albedo=torch.ones_like(f.albedo)) for f in make_frames(1) * 4]
    shot = [replace(f, radiance=torch.empty_like(f.radiance).exponential_()) for f in shot]
    _, history = run(network, shot)
    expected = torch.stack([f.radiance for f in shot]).mean(0) / albedo_divisor(shot[0].albedo, shot[0].depth)
    whole = (history.length > 3.5).expand_as(history.mean)  # a fresh network resets a little
    assert whole.float().mean() > 0.5
    assert (history.mean - expected)[whole].abs().mean() < 0.25 * expected.std()


def test_footprints_are_of_recent_frames_and_this_one(network):
    shot = [replace(f, motion=torch.zeros_like(f.motion)) for f in make_frames(1) * 3]
    shot = [replace(f, radiance=torch.rand_like(f.radiance), albedo=torch.rand_like(f.albedo)) for f in shot]
    _, first = run(network, shot[:1])
    expected = torch.cat([shot[0].radiance, shot[0].albedo, shot[0].normal], dim=1)
    torch.testing.assert_close(first.footprint, expected)
    _, history = run(network, shot)
    for part, name in zip(history.footprint.split(FOOTPRINT, dim=1), ("radiance", "albedo", "normal"), strict=True):
        mean = torch.stack([getattr(f, name) for f in shot]).mean(0)
        assert (part - mean).abs().mean() < 0.05  # resets and the test of noise; one frame: 0.2
    assert run(models.create(replace(SMALL, footprint=False)).eval(), shot)[1].footprint is None


def test_a_saved_history_goes_on_to_the_bit(network, tmp_path):
    frames = make_frames(6)
    expected, _ = run(network, frames)
    _, history = run(network, frames[:4])
    save_history(tmp_path / "h.safetensors", history)
    found, _ = run(network, frames[4:], load_history(tmp_path / "h.safetensors")[0])
    assert torch.equal(found, expected[4:])


@pytest.mark.parametrize("change", ["dtype", "channels", "nan"])
def test_damaged_recent_frames_are_refused(network, tmp_path, change):
    _, history = run(network, make_frames(2))
    first, *rest = (kept.clone() for kept in history.recent)
    if change == "nan":
        first[0, 1, 3, 3] = 0x7FC0  # the low half
    else:
        first = first.float() if change == "dtype" else first[:, :4]
    save_history(tmp_path / "h.safetensors", replace(history, recent=(first, *rest)))
    with pytest.raises(InputError, match=r"recent\.0"):
        load_history(tmp_path / "h.safetensors")


def test_layers_come_back(network):
    _, history = run(network, make_frames(3))
    again = History.from_layers(history.layers())
    assert all(torch.equal(a, b) for a, b in zip(again.recent, history.recent, strict=True))
    layers = history.layers()
    del layers["recent.0"]
    with pytest.raises(ValueError, match="not the fields of a history"):
        History.from_layers(layers)


def test_another_size_starts_without_recent_frames(network):
    _, history = run(network, make_frames(3))
    larger = resize(history, (48, 64))
    assert larger.recent == () and larger.mean.shape[2:] == (48, 64)
    picture, _ = run(network, make_frames(4, H=48, W=64)[3:], larger)
    assert picture.isfinite().all()


def test_tiles_are_seamless():
    model = models.create(SMALL).eval()
    frames = [replace(f, motion=f.motion * 4) for f in make_frames(5, H=64, W=96)]
    expected, _ = run(model, frames)
    tiled = Tiled(model)
    tiled.split = lambda window: [(y, x, min(y + 32, 64), min(x + 32, 96)) for y in (0, 32) for x in (0, 32, 64)]
    found, _ = run(tiled, frames)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


def test_tiles_reach_as_far_as_paths_go():
    """Each kept frame leads on to the one before: 7.25 pixels a frame, the second one 20 where an object moves."""
    frames = [replace(f, motion=torch.full_like(f.motion, 7.25)) for f in make_frames(4, H=64, W=96)]
    frames[1].motion[:, 0, 5, 5] = -20.0
    model = models.create(SMALL).eval()
    lengths = [carried(frame, run(model, frames[:i])[1] if i else None) for i, frame in enumerate(frames)]
    assert lengths[0] is None
    reach = [tuple(length.amax((2, 3))[0].tolist()) for length in lengths[1:]]
    short = reach[0][1]  # one lookup
    assert reach[1][1] >= short + 7.25 and reach[2][1] >= short + 2 * 7.25
    assert reach[2][0] >= reach[2][1] + 20 - 7.25


@pytest.mark.parametrize("backend", ["torch", "glsl"])
def test_an_interrupted_run_goes_on_to_the_bit(tmp_path, backend):
    models.save(models.create(SMALL), tmp_path / "w.safetensors")
    shot = write_sequence(tmp_path / "shot", make_frames(8))
    options = Options(model=str(tmp_path / "w.safetensors"), precision="fp32", float32=True, backend=backend)

    def holds_no_frames(out):
        state = (out / ".rtdenoise-state.safetensors").read_bytes()
        for name in (b"recent", b"footprint"):
            assert name not in state  # they would be most of it; resets of recent frames are there

    assert_goes_on(shot, tmp_path, options, 5, holds_no_frames)


def test_it_trains():
    network = models.create(SMALL)
    frames = make_frames(3)
    _, history = network.step(frames[0])
    picture, history = network.step(frames[1], history)
    picture.mean().backward()
    assert all(parameter.grad is not None for parameter in network.unet.parameters())
    assert not any(kept.requires_grad for kept in history.recent)


@pytest.mark.parametrize("recent", [-1, 16, True, 1.5, "8"])
def test_settings_are_checked(recent):
    with pytest.raises(ValueError, match="recent: expected"):
        replace(SMALL, recent=recent)


def test_the_paper_keeps_none():
    assert TINY.recent == 0


@torch.inference_mode()
def test_even_light_without_noise_is_no_change():
    """bfloat16 rounds it in kept frames, everywhere alike."""
    frame = make_frames(1, noise=0.0)[0]
    light, surface = torch.full_like(frame.radiance, 0.3037), (frame.depth, frame.normal)
    kept = [keep(light, *surface, torch.zeros_like(frame.depth), 0 * frame.motion)] * 3
    for choice in ("plain", "fused"):
        with ops.use(choice):
            found = recall(light, 0 * frame.motion, surface, kept)
            mean, _ = accumulate(light, found.light, found.count, torch.zeros_like(frame.depth), 9.0, RECALL_SAME)
            assert (found.count == 3).all() and torch.equal(mean, light)


def test_what_is_not_white_is_no_noise():
    """Shadows of four pixels that have moved change cells as often to dark as to light, and so does the edge of one;
    noise is white."""
    H, W = 48, 64
    y, x = torch.meshgrid(torch.arange(H), torch.arange(W), indexing="ij")
    noise = torch.randn(1, 3, H, W, generator=torch.Generator().manual_seed(0))
    shadows = (((x // 4 + y // 4) % 2) * 2.0 - 1).expand(1, 3, H, W)
    edge = (x == 21).float().expand(1, 3, H, W)
    least = torch.full((1, 1, H, W), 1e-6)
    for difference, expected in ((noise, 1), (shadows, 0), (noise + 0.1 * shadows, 1), (noise + shadows, 0)):
        found = white(difference, least)
        assert found.shape == (1, 1, H, W) and (found.mean() - expected).abs() < 0.05
    assert unchanged(shadows, least).mean() > 0.5  # which their sums do not tell
    assert white(edge, least)[..., 21].max() == 0
