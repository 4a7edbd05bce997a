"""Frames with motion blur, and a second render without it (`data.shutter`, `run.surfaces`)."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import write_sequence
from test_combine import estimate, write_images
from test_denoise import pixels
from test_virtual_motion import SHOT

from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.shutter import _index, over_shutter
from rtdenoise.errors import InputError
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.combine import combine
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.lens_motion import with_lens
from rtdenoise.run.options import CombineOptions
from rtdenoise.run.surfaces import with_surfaces

SIZE, SIDE, TOP = (40, 80), 16, 12  # of the picture; of a square, and its highest row
SPEED = 8  # pixels a frame
OPTIONS = Options(model="fast", precision="fp32")


def picture(left, size=SIZE):
    """A bright square before a wall of two halves, with its left side at `left` (a number for each pixel, or one)."""
    y, x = np.indices(size).astype(np.float32)
    square = (x >= left - 0.5) & (x < left + SIDE - 0.5) & (y >= TOP) & (y < TOP + SIDE)
    return square, np.where(square, 0.9, np.where(x < size[1] // 2, 0.3, 0.2)).astype(np.float32)


def surfaces(number=2, speed=SPEED):
    """A frame without motion blur: numpy arrays."""
    square, albedo = picture(speed * number)
    motion = np.zeros((1, 2, *SIZE), np.float32)
    motion[0, 0, square] = -speed
    normal = np.stack([0 * albedo, square.astype(np.float32), (~square).astype(np.float32)])
    depth = np.where(square, 2, 5).astype(np.float32)
    albedo = albedo[None, None].repeat(3, 1)
    return Frame(albedo, albedo=albedo, normal=normal[None], depth=depth[None, None], motion=motion,
                 motion_next=-motion, number=number)  # fmt: skip


def blurred(number=2, shutter=0.5, samples=1, seed=0):
    """A frame whose samples show moments of a shutter that is open around its time; without vectors, as of Cycles."""
    moments = np.random.default_rng([seed, number]).uniform(-shutter / 2, shutter / 2, (samples, *SIZE))
    shown = [picture(SPEED * (number + t)) for t in moments]
    albedo = np.mean([albedo for _, albedo in shown], 0, dtype=np.float32)
    square = shown[0][0]
    albedo = albedo[None, None].repeat(3, 1)
    light = np.random.default_rng([seed, number, 1]).exponential(1, (1, 1, *SIZE)) if samples == 1 else 1
    normal = np.stack([0 * albedo[0, 0], square.astype(np.float32), (~square).astype(np.float32)])
    zero = np.zeros((1, 2, *SIZE), np.float32)
    return Frame((albedo * light).astype(np.float32), albedo=albedo, normal=normal[None],
                 depth=np.where(square, 2, 5).astype(np.float32)[None, None], motion=zero, motion_next=zero,
                 number=number)  # fmt: skip


def blur(frame, **how):
    return over_shutter(frame.albedo, frame.depth, frame.motion, frame.motion_next, **how)


def results(folder):
    return [pixels(path) for path in sorted(folder.glob("*.exr"))]


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    """Folders of four frames with motion blur, and of their surfaces."""
    folder = tmp_path_factory.mktemp("shot")
    for name, make in (("blurred", blurred), ("surfaces", surfaces)):
        write_sequence(folder / name, [make(number).map(torch.from_numpy) for number in range(1, 5)])
    return folder / "blurred", folder / "surfaces"


@pytest.mark.parametrize("shutter", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("given_next", [True, False])
def test_a_moving_square_is_seen_as_long_as_it_is_there(shutter, given_next):
    frame = surfaces()
    found = over_shutter(frame.albedo, frame.depth, frame.motion, frame.motion_next if given_next else None,
                         opens=-shutter / 2, closes=shutter / 2)  # fmt: skip
    truth = blurred(shutter=shutter, samples=2000).albedo
    assert np.abs(found - truth).max() < 0.1 and np.abs(found - truth).mean() < 0.003
    assert np.abs(frame.albedo - truth).max() > 0.15, "there is something to find"


def test_the_shutter_may_open_at_the_frame_or_close_at_it():
    frame, places = surfaces(), {}
    for name, (opens, closes) in {"start": (0, 0.5), "center": (-0.25, 0.25), "end": (-0.5, 0)}.items():
        light = blur(frame, opens=opens, closes=closes)[0, 0, TOP + 2] - picture(1000)[1][TOP + 2]
        places[name] = (light * np.arange(SIZE[1])).sum() / light.sum()
    assert places["start"] - places["center"] == pytest.approx(SPEED / 4, abs=0.3)
    assert places["center"] - places["end"] == pytest.approx(SPEED / 4, abs=0.3)


def test_what_is_near_hides_what_moves_behind_it():
    frame = surfaces()
    behind = replace(frame, depth=np.where(frame.depth == 2, 9, 5).astype(np.float32))
    assert np.abs(blur(behind) - frame.albedo).max() < 0.1, "the wall stands still, and hides the square's ways"
    assert np.abs(blur(frame) - frame.albedo).max() > 0.2


def test_it_follows_a_surface_that_speeds_up():
    """1 pixel from the frame before and 15 to the next: 8 t + 7 t²."""
    frame = surfaces()
    square = frame.motion[0, 0] != 0
    motion, after = np.zeros_like(frame.motion), np.zeros_like(frame.motion)
    motion[0, 0, square], after[0, 0, square] = -1, 15
    found = over_shutter(frame.albedo, frame.depth, motion, after, 0, 1)
    moments = (np.arange(2000) + 0.5) / 2000
    truth = np.mean([picture(2 * SPEED + 8 * t + 7 * t * t)[1] for t in moments], 0)
    assert np.abs(found[0, 0] - truth).mean() < 0.004


@pytest.mark.parametrize("speed", [10, 39])
def test_the_streak_of_a_single_pixel_has_no_gaps(speed):
    y, x = np.indices(SIZE).astype(np.float32)
    image = np.full((1, 1, *SIZE), 0.1, np.float32)
    image[..., 20, 40] = 100
    motion = np.stack([0 * x - speed, 0 * y])[None]
    lit = np.nonzero(over_shutter(image, 0 * image + 3, motion, None, -0.5, 0.5)[0, 0, 20] > 1)[0]
    assert len(lit) >= speed and (np.diff(lit) == 1).all()


def test_what_has_no_motion_stays_as_it_is():
    frame = surfaces()
    still = replace(frame, motion=0 * frame.motion, motion_next=0 * frame.motion)
    assert blur(still) is still.albedo
    slow = replace(frame, motion=frame.motion / 50, motion_next=None)
    assert blur(slow) is slow.albedo, "less than half a pixel"
    sky = replace(frame, depth=0 * frame.depth)
    assert blur(sky) is sky.albedo


def test_unknown_motion_and_broken_pixels_count_for_nothing():
    frame = surfaces()
    for bad in (OFF_SCREEN, np.nan, np.inf):
        motion, after = frame.motion.copy(), frame.motion_next.copy()
        motion[:] = bad
        assert np.allclose(blur(replace(frame, motion=motion)), blur(frame), atol=1e-6), "the other way tells"
        after[:] = bad
        assert np.allclose(blur(replace(frame, motion=motion, motion_next=after)), frame.albedo)
    albedo, depth = frame.albedo.copy(), frame.depth.copy()
    albedo[..., TOP + 4, 20], depth[..., TOP + 8, 24] = np.nan, np.nan
    found = blur(replace(frame, albedo=albedo, depth=depth))
    assert np.isfinite(found).all() and np.abs(found - blur(frame)).mean() < 0.01
    for column in (2 * SPEED, 2 * SPEED + SIDE - 1):  # at the edges, too
        depth = frame.depth.copy()
        depth[..., TOP + 4, column] = np.nan
        assert np.abs(blur(replace(frame, depth=depth)) - blur(frame)).max() < 0.2


def test_a_surface_that_comes_nearer_has_no_cracks():
    """It grows by 40 % while the shutter is open, so that no pixel of it moves to some."""
    y, x = np.indices(SIZE).astype(np.float32)
    square = (np.abs(x - 40) < 14) & (np.abs(y - 20) < 12)
    motion = np.where(square, np.stack([-0.4 * (x - 40), -0.4 * (y - 20)]), 0)[None].astype(np.float32)
    depth = np.where(square, 2, 5).astype(np.float32)[None, None]
    found = over_shutter(square[None, None].astype(np.float32), depth, motion, None, 0, 1)
    assert found[0, 0][(np.abs(x - 40) < 13) & (np.abs(y - 20) < 11)].min() > 0.97


def test_the_seam_of_a_panorama_is_no_motion():
    """Pixels that pass it cross the picture by their vectors."""
    x = np.indices(SIZE)[1].astype(np.float32)
    image = (x / SIZE[1])[None, None]
    motion = np.stack([np.full(SIZE, -2), 0 * x])[None].astype(np.float32)
    motion[0, 0, :, :2] += SIZE[1]
    found = over_shutter(image, 0 * image + 3, motion, None)
    assert np.abs(found - image)[..., 4:-4].max() < 0.05


def test_holes_are_filled_from_as_far_as_things_move():
    """A small thing that is fast makes no others wide."""
    frame = surfaces()
    motion, depth = frame.motion.copy(), frame.depth.copy()
    depth[..., 2, 2], motion[0, 0, 2, 2] = 1, -36
    depth[..., 4:TOP, 2 * SPEED : 2 * SPEED + 3] = 9  # a gap in the wall above the square, with another colour
    albedo = np.where(depth == 9, 0, frame.albedo).astype(np.float32)
    found = over_shutter(albedo, depth, motion, None)[0, 0]
    expected = over_shutter(frame.albedo, frame.depth, frame.motion, None)[0, 0]
    assert np.allclose(found[TOP + 8], expected[TOP + 8], atol=0.06)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 5)])
def test_any_size_and_speed(size):
    draw = np.random.default_rng(0)
    image, depth = draw.random((1, 6, *size), np.float32), draw.random((1, 1, *size), np.float32)
    motion = (2000 * draw.standard_normal((1, 2, *size))).astype(np.float32)
    found = over_shutter(image, depth, motion, None, -1, 1)
    assert found.shape == image.shape and found.dtype == image.dtype
    assert (found >= image.min() - 1e-6).all() and (found <= image.max() + 1e-6).all()


def test_pixels_of_large_pictures_are_told_apart():
    """Of 8K: float32 has no odd numbers there."""
    rows, columns = np.float32([4319, 4319, 0]), np.float32([7678, 7679, 1])
    assert _index(rows, columns, 7680).tolist() == [33177598, 33177599, 1]


def test_frames_take_the_layers_of_the_second_render(shot):
    noisy, second = shot
    chosen = open_chosen(str(noisy), replace(OPTIONS, surfaces=str(second)))[0]
    frame, sharp, own = chosen.read(1), open_sequence(second).read(1), open_sequence(noisy).read(1)
    for layer in ("depth", "motion", "motion_next"):
        assert np.array_equal(getattr(frame, layer), getattr(sharp, layer)), layer
    for layer in ("albedo", "normal"):
        truth = over_shutter(getattr(sharp, layer), sharp.depth, sharp.motion, sharp.motion_next)
        assert np.allclose(getattr(frame, layer), truth, atol=1e-6), layer
    assert np.array_equal(frame.radiance, own.radiance)
    few = chosen.only({"radiance", "depth"}).read(1)
    assert few.albedo is None and few.motion is None and np.array_equal(few.depth, sharp.depth)


def test_denoised_frames_are_those_of_these_layers_and_nearer_to_the_truth(shot, tmp_path):
    noisy, second = shot
    options = replace(OPTIONS, surfaces=str(second))
    summary = denoise(str(noisy), tmp_path / "found", options)
    assert not any("motion blur" in note for note in summary.notes)
    chosen = open_chosen(str(noisy), options)[0]
    made = write_sequence(tmp_path / "made", [chosen[i] for i in range(len(chosen))])
    denoise(str(made), tmp_path / "same", OPTIONS)
    found, same = results(tmp_path / "found"), results(tmp_path / "same")
    assert np.allclose(found, same, atol=2e-3) and len(found) == 4
    notes = denoise(str(noisy), tmp_path / "without", OPTIONS).notes
    assert any("against its motion vectors" in note for note in notes)
    truth = blurred(4, samples=2000).albedo[0]
    errors = [np.square(pictures[-1] - truth).mean() for pictures in (found, results(tmp_path / "without"))]
    assert errors[0] < 0.7 * errors[1]


def test_without_them_a_moving_picture_is_denoised_frame_by_frame(tmp_path):
    """Its vectors are zero, and would smear it."""
    depth = (2 + 3 * torch.rand(1, 1, 5, 10)).repeat_interleave(8, 2).repeat_interleave(8, 3)
    frames = [replace(blurred(n).map(torch.from_numpy), depth=depth.roll(4 * n, -1)) for n in range(1, 5)]
    source = write_sequence(tmp_path / "shot", frames)
    summary = denoise(str(source), tmp_path / "out", OPTIONS)
    assert summary.cuts == [2, 3, 4]
    assert sum("most frames are denoised alone: was motion blur on?" in note for note in summary.notes) == 1
    assert not any("most frames find other surfaces" in note for note in summary.notes)


@pytest.mark.parametrize("model", ["fast", "auto"])
def test_layers_that_the_blurred_frames_lack_are_there(shot, tmp_path, model):
    """Blender 5 leaves the pass out where motion blur is on."""
    options = replace(OPTIONS, surfaces=str(shot[1]), model=model)
    frames = [blurred(number).map(torch.from_numpy) for number in range(1, 5)]
    noisy = write_sequence(tmp_path / "shot", frames, without=("motion", "motion_next", "normal"))
    chosen = open_chosen(str(noisy), options)[0]
    assert chosen.has("motion") and chosen.require("normal") is chosen
    assert chosen.read(0).motion.any() and chosen.read(0).motion_next.any()
    assert denoise(str(noisy), tmp_path / "out", options).notes == []


def test_zeros_of_the_blurred_frames_do_not_stand_in_for_motion_next(shot, tmp_path):
    frames = [surfaces(number).map(torch.from_numpy) for number in range(1, 5)]
    second = write_sequence(tmp_path / "second", frames, without=("motion_next",))
    chosen = open_chosen(str(shot[0]), replace(OPTIONS, surfaces=str(second)))[0]
    assert chosen.read(1).motion_next is None and not chosen.has("motion_next") and chosen.has("motion")
    without = write_sequence(tmp_path / "without", frames, without=("albedo",))
    chosen = open_chosen(str(shot[0]), replace(OPTIONS, surfaces=str(without)))[0]
    assert chosen.has("albedo") and np.array_equal(chosen.read(1).albedo, open_sequence(shot[0]).read(1).albedo)


def test_the_second_render_is_read_as_the_first_and_its_edges_are_left(shot, tmp_path):
    for folder in ("noisy", "second"):
        shutil.copytree(SHOT, tmp_path / folder)
    for blurs in (True, False):
        given = {"surfaces": str(tmp_path / "second")} if blurs else {}
        chosen = open_chosen(str(tmp_path / "noisy"), Options(model="fast", samples=1, **given))[0]
        assert chosen.soft_edges == (not blurs)
    assert not chosen.surfaces
    chosen = open_chosen(str(tmp_path / "noisy"), Options(model="fast", samples=1, surfaces=str(tmp_path / "second")))
    second = chosen[0].surfaces.sequence
    assert second.virtual_motion and second.fog and second.few_samples


@pytest.mark.parametrize(("position", "opens", "closes"), [("start", 0, 0.8), ("center", -0.4, 0.4), ("end", -0.8, 0)])
def test_positions_are_blenders(shot, position, opens, closes):
    options = replace(OPTIONS, surfaces=str(shot[1]), shutter=0.8, shutter_position=position)
    found = open_chosen(str(shot[0]), options)[0].surfaces
    assert (found.opens, found.closes) == pytest.approx((opens, closes))


def test_frames_may_be_missing_in_both(shot, tmp_path):
    for folder in shot:
        for path in sorted(folder.glob("*.exr"))[:1] + sorted(folder.glob("*.exr"))[2:]:
            (tmp_path / folder.name).mkdir(exist_ok=True)
            shutil.copy(path, tmp_path / folder.name)
    options = replace(OPTIONS, surfaces=str(tmp_path / "surfaces"), allow_gaps=True)
    assert denoise(str(tmp_path / "blurred"), tmp_path / "out", options).written == 3


def test_the_second_render_is_never_written_to(shot, tmp_path):
    second = tmp_path / "second"
    shutil.copytree(shot[1], second)
    with pytest.raises(InputError, match="never written to"):
        denoise(str(shot[0]), second, replace(OPTIONS, surfaces=str(second)), overwrite=True)


def test_several_shots_have_a_second_render_each(shot, tmp_path, capsys):
    for name in ("one", "two"):
        shutil.copytree(shot[0], tmp_path / "shots" / name)
        frames = [surfaces(n, speed=SPEED if name == "one" else 4).map(torch.from_numpy) for n in range(1, 5)]
        write_sequence(tmp_path / "second" / name, frames)
    main(["denoise", str(tmp_path / "shots" / "*"), "--out", str(tmp_path / "out"), "--model", "fast", "--precision",
          "fp32", "--surfaces", str(tmp_path / "second"), "--workers", "1"])  # fmt: skip
    for name in ("one", "two"):
        options = replace(OPTIONS, surfaces=str(tmp_path / "second" / name))
        denoise(str(shot[0]), tmp_path / "single" / name, options)
        assert np.array_equal(results(tmp_path / "out" / name), results(tmp_path / "single" / name))
    assert not np.array_equal(results(tmp_path / "out" / "one"), results(tmp_path / "out" / "two"))


@pytest.mark.parametrize("layout", ["plain", "source"])
@pytest.mark.parametrize("how", [{}, {"offline": True, "model": "auto"}, {"shutter": 1.0, "shutter_position": "end"}])
def test_a_picture_without_blur_gets_it_when_it_is_denoised(shot, tmp_path, how, layout):
    options = replace(OPTIONS, layout=layout, float32=True, **how)
    sequence, found = open_sequence(shot[1]), []
    for name, blurs in (("sharp", False), ("blurred", True)):
        plain = {} if blurs else {"shutter": 0.5, "shutter_position": "center"}
        denoise(str(shot[1]), tmp_path / name, replace(options, motion_blur=blurs, **plain))
        found.append(results(tmp_path / name))
    opens, closes = (-1, 0) if "shutter" in how else (-0.25, 0.25)
    for frame, sharp, soft in zip(map(sequence.read, range(4)), *found, strict=True):
        expected = over_shutter(sharp[None], frame.depth, frame.motion, frame.motion_next, opens, closes)[0]
        assert np.allclose(soft, expected, atol=1e-5) and np.abs(soft - sharp).max() > 0.05


def test_alpha_is_blurred_as_the_picture(shot, tmp_path):
    sequence = open_sequence(shot[1])
    for i, path in enumerate(sequence.paths):
        channels = read_channels(path, sequence.header.channels.keys())
        covered = (sequence.read(i).depth[0, 0] == 2).astype(np.float32)
        (tmp_path / "shot").mkdir(exist_ok=True)
        write_layers(tmp_path / "shot" / path.name, channels | {"A": covered}, dtypes={"color": "float"})
    options = replace(OPTIONS, motion_blur=True, alpha="rendered")
    denoise(str(tmp_path / "shot"), tmp_path / "out", options)
    path = sorted((tmp_path / "out").glob("*.exr"))[1]
    alpha, frame = read_channels(path, ("A",))["A"], sequence.read(1)
    covered = (frame.depth == 2).astype(np.float32)
    expected = over_shutter(covered, frame.depth, frame.motion, frame.motion_next)[0, 0]
    assert np.allclose(alpha, expected, atol=1e-3) and ((alpha > 0.1) & (alpha < 0.9)).any()


def test_what_does_not_go_with_blur_is_refused_in_one_line(shot, tmp_path):
    for words, how in {
        "without --recombine": {"signal": "indirect"},
        "--surfaces for frames that have it": {"surfaces": str(shot[0])},
        "expected more than 0": {"shutter": -1.0},
    }.items():
        with pytest.raises(InputError, match=words):
            denoise(str(shot[1]), tmp_path / "out", replace(OPTIONS, motion_blur=True, **how))
    still = [surfaces(n).map(torch.from_numpy) for n in range(1, 3)]
    with pytest.raises(InputError, match="no layer 'depth'"):
        denoise(str(write_sequence(tmp_path / "flat", still, without=("depth",))), tmp_path / "out",
                replace(OPTIONS, motion_blur=True))  # fmt: skip


@pytest.mark.parametrize("how", [{"offline": True, "model": "auto"}, {"lookahead": 2}, {"lens": True}])
def test_every_mode_takes_them(shot, tmp_path, how):
    options = replace(OPTIONS, surfaces=str(shot[1]), **how)
    assert denoise(str(shot[0]), tmp_path / "out", options).written == 4


def test_combine_takes_them(shot, tmp_path):
    frames = [blurred(number).map(torch.from_numpy) for number in range(1, 5)]
    denoised = write_images(tmp_path / "denoised", [estimate(frame) for frame in frames], first=1)
    found = []
    for name, given in (("with", str(shot[1])), ("without", "")):
        options = CombineOptions(model="shrinkage", samples=4, surfaces=given)
        combine(str(shot[0]), str(denoised), tmp_path / name, options)
        found.append(results(tmp_path / name))
    assert not np.array_equal(*found)


def test_indirect_light_keeps_its_own_albedo(shot):
    """By which it was divided."""
    sequence = open_sequence(shot[0])
    given = with_surfaces(sequence, replace(OPTIONS, surfaces=str(shot[1]))).surfaces
    assert given.has("albedo")
    options = replace(OPTIONS, surfaces=str(shot[1]), signal="indirect")
    own = open_sequence(shot[0], signal="indirect")
    assert with_surfaces(own, options).surfaces.has("albedo"), "of the native layout, where it was not divided"
    own = replace(own, layout=replace(own.layout, demodulated=frozenset({"indirect"})))
    chosen = with_surfaces(own, options)
    assert chosen.has("albedo") and np.array_equal(chosen.read(1).albedo, own.read(1).albedo)
    assert chosen.read(1).motion.any()


def test_with_the_lens_there_is_no_motion_to_the_next_frame(shot):
    sequence = with_surfaces(open_sequence(shot[0]), replace(OPTIONS, surfaces=str(shot[1])))
    assert sequence.has("motion_next") and not with_lens(sequence).has("motion_next")
    assert with_lens(sequence).read(1).motion_next is None and with_lens(sequence).read(1).motion.any()


def test_a_finished_run_knows_its_surfaces(shot, tmp_path):
    options = replace(OPTIONS, surfaces=str(shot[1]))
    denoise(str(shot[0]), tmp_path / "out", options)
    assert denoise(str(shot[0]), tmp_path / "out", options).skipped == 4
    assert not any("--shutter" in note for note in denoise(str(shot[0]), tmp_path / "plain", OPTIONS).notes)
    unused = denoise(str(shot[0]), tmp_path / "plain", replace(OPTIONS, shutter=0.3))
    assert unused.skipped == 4, "it is not used"
    assert "--shutter, --shutter-position: change nothing without --motion-blur or --surfaces" in unused.notes
    corrected = CombineOptions(model="shrinkage", shutter_position="end")
    notes = combine(str(shot[0]), str(tmp_path / "plain"), tmp_path / "better", corrected).notes
    assert "--shutter, --shutter-position: change nothing without --surfaces" in notes
    for spelling in (f"{shot[1]}/", f"{shot[1]}/*.exr"):
        assert denoise(str(shot[0]), tmp_path / "out", replace(options, surfaces=spelling)).skipped == 4
    with pytest.raises(InputError, match=re.escape("shutter 0.5, now 0.4")):
        denoise(str(shot[0]), tmp_path / "out", replace(options, shutter=0.4))
    other = write_sequence(tmp_path / "other", [surfaces(n).map(torch.from_numpy) for n in range(1, 5)])
    denoise(str(shot[0]), tmp_path / "b", replace(OPTIONS, surfaces=str(other)))
    write_sequence(other, [surfaces(n, speed=7).map(torch.from_numpy) for n in range(1, 5)])
    with pytest.raises(InputError, match="another input"):
        denoise(str(shot[0]), tmp_path / "b", replace(OPTIONS, surfaces=str(other)))


def test_bad_surfaces_are_refused_in_one_line(shot, tmp_path):
    noisy, second = shot

    def no(words, given=second, **how):
        with pytest.raises(InputError, match=words) as caught:
            denoise(str(noisy), tmp_path / "out", replace(OPTIONS, surfaces=str(given), **how))
        assert "\n" not in str(caught.value)

    frames = [surfaces(number).map(torch.from_numpy) for number in range(1, 5)]
    no("was named twice", noisy)
    no("does not exist", tmp_path / "nothing")
    no("has no frame 4", write_sequence(tmp_path / "short", frames[:3]))
    no("no layer 'motion'", write_sequence(tmp_path / "still", frames, without=("motion",)))
    small = [frame.map(lambda x: x[..., :-8]) for frame in frames]
    no("is 72×40, the frames are 80×40", write_sequence(tmp_path / "small", small))
    no("--shutter: expected more than 0", shutter=0.0)
    no("--shutter: expected more than 0", shutter=float("nan"))
    no("--shutter: expected more than 0", "", shutter=-3.0)
    no("--shutter-position: expected start, center, end", shutter_position="middle")
