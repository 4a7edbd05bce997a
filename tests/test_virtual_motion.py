"""What is seen in flat mirrors and through panes (`data.virtual_motion`)."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rtdenoise.data.exr import read_channels, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.virtual_motion import with_virtual_motion
from rtdenoise.frame import Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options

H, W, FOCAL, NEAR = 96, 128, 110.0, 0.1  # pixels, pixels; of the depth
GLASS = np.zeros((H, W), bool)
GLASS[16:64, 32:96] = True
BEHIND = 9.0
SHOT = Path(__file__).parent / "data" / "cycles"
TURN, STEP = 0.01, np.array([0.06, 0.01, 0.02])  # of the camera, to the frame before; to the next one backwards


def seen_at(depth, sign=1):
    """The motion `[2, H, W]` of what stands still at a depth, as the camera turns and moves."""
    y, x = np.mgrid[:H, :W] + 0.5
    point = np.stack([(x - W / 2) / FOCAL, (y - H / 2) / FOCAL, np.ones((H, W))]) * depth
    c, s = np.cos(sign * TURN), np.sin(sign * TURN)
    moved = np.einsum("ij,jhw->ihw", [[c, 0, s], [0, 1, 0], [-s, 0, c]], point + sign * STEP[:, None, None])
    return np.stack([FOCAL * moved[0] / moved[2] + W / 2 - x, FOCAL * moved[1] / moved[2] + H / 2 - y])


def pane(scale=1.0, near=NEAR, behind=BEHIND):
    """A pane in a wall above a floor, and what lies behind it: frame, paths to what is seen, and motion of that."""
    y, x = np.mgrid[:H, :W] + 0.5
    floor = y > 70
    depth = np.where(floor, 1.2 * FOCAL / np.maximum(y - H / 2, 1), 3.5)
    depth = np.where(x < 12, 2.0 + 0.05 * x, depth)
    virtual = np.where(GLASS, behind, depth)
    stretch = np.sqrt(1 + ((x - W / 2) ** 2 + (y - H / 2) ** 2) / FOCAL**2)
    seen = scale * (stretch * (virtual - near))[None, None]
    shaped = lambda image, channels: np.broadcast_to(image, (channels, H, W))[None].astype(np.float32)  # noqa: E731
    frame = Frame(
        shaped(1, 3), shaped(0.5, 3), shaped(np.eye(3)[1][:, None, None], 3), shaped(scale * depth, 1),
        shaped(seen_at(depth), 2), shaped(seen_at(depth, -1), 2),
    )  # fmt: skip
    return frame, seen.astype(np.float32), [seen_at(virtual), seen_at(virtual, -1)]


def off(frame, truth):
    return [
        np.abs(motion[0] - true).max(0) for motion, true in zip((frame.motion, frame.motion_next), truth, strict=True)
    ]


@pytest.mark.parametrize(("scale", "near"), [(1.0, NEAR), (1e3, 0.0), (1e-3, NEAR)])
def test_what_a_pane_shows_moves_as_it_does_itself(scale, near):
    frame, seen, truth = pane(scale, near)
    moved = with_virtual_motion(frame, seen)
    for before, after in zip(off(frame, truth), off(moved, truth), strict=True):
        assert before[GLASS].min() > 0.5 and after[GLASS].max() < 0.02
    for name in ("motion", "motion_next"):
        assert np.array_equal(getattr(moved, name)[:, :, ~GLASS], getattr(frame, name)[:, :, ~GLASS])
    assert np.array_equal(moved.depth, frame.depth) and np.array_equal(moved.radiance, frame.radiance)
    assert np.array_equal(moved.albedo, frame.albedo)


@pytest.mark.parametrize("first", [True, False])
def test_frames_at_the_ends_of_an_animation_lack_one_of_both(first):
    frame, seen, truth = pane()
    none, there = ("motion", "motion_next")[:: 1 if first else -1]
    frame = replace(frame, **{none: 0 * frame.motion})
    moved = with_virtual_motion(frame, seen)
    assert np.array_equal(getattr(moved, none), getattr(frame, none))
    assert np.abs(getattr(moved, there)[0] - truth[first])[:, GLASS].max() < 0.02


def test_other_things_that_move_do_not_matter():
    frame, seen, truth = pane()
    motion = frame.motion.copy()
    motion[:, 0, :16] += 3
    motion[:, 1, 70:, :80] -= 2
    moved = with_virtual_motion(replace(frame, motion=motion), seen)
    assert np.abs(moved.motion[0] - truth[0])[:, GLASS].max() < 0.02


def test_a_stray_takes_what_those_around_show():
    frame, seen, truth = pane()
    strays = np.zeros((H, W), bool)
    strays[20:60:4, 36:92:4] = True
    albedo = frame.albedo.copy()
    albedo[0][:, strays], seen[0, 0, strays] = 0.1, 30.0
    moved = with_virtual_motion(replace(frame, albedo=albedo), seen)
    assert np.array_equal(moved.albedo, frame.albedo)
    assert max(apart[GLASS].max() for apart in off(moved, truth)) < 0.02


def test_a_line_is_no_stray():
    frame, seen, _ = pane()
    albedo = frame.albedo.copy()
    albedo[0, :, 30, 32:96] = 0.1
    found = with_virtual_motion(replace(frame, albedo=albedo), seen).albedo
    assert np.array_equal(found[..., 33:95], albedo[..., 33:95])  # all but its ends


def still(frame, seen):
    return replace(frame, motion=0 * frame.motion, motion_next=0 * frame.motion_next), seen


def of_paths_that_end_at_once(frame, seen):
    return frame, pane(behind=3.5)[1]


def curved(frame, seen):
    normal = frame.normal.copy()
    normal[0, 0] = np.linspace(-0.3, 0.3, W)
    return replace(frame, normal=normal), seen


def a_pane_that_moves(frame, seen):
    return replace(frame, motion=frame.motion + np.float32(2) * GLASS), seen


def in_one_plane(frame, seen):
    y, x = np.mgrid[:H, :W] + 0.5
    stretch = np.sqrt(1 + ((x - W / 2) ** 2 + (y - H / 2) ** 2) / FOCAL**2)
    motions = [seen_at(np.full((H, W), 3.5), sign)[None].astype(np.float32) for sign in (1, -1)]
    seen[0, 0] = stretch * (np.where(GLASS, BEHIND, 3.5) - NEAR)
    return replace(frame, depth=np.full_like(frame.depth, 3.5), motion=motions[0], motion_next=motions[1]), seen


def of_no_camera(frame, seen):
    motions = np.random.default_rng(1).normal(size=(2, *frame.motion.shape)).astype(np.float32)
    return replace(frame, motion=motions[0], motion_next=motions[1]), seen


def of_paths_without_sense(frame, seen):
    return frame, np.random.default_rng(1).uniform(1, 30, seen.shape).astype(np.float32)


def of_a_shifted_lens(frame, seen):
    y, x = np.mgrid[:H, :W] + 0.5
    r2 = (x - W / 2) ** 2 + (y - H / 2) ** 2
    away = np.sqrt(1 + (r2 + 40 * (x - W / 2)) / FOCAL**2 + 0.04) / np.sqrt(1 + r2 / FOCAL**2)
    return frame, (seen * away).astype(np.float32)


def of_few_pixels(frame, seen):
    few = pane(behind=3.5)[1]
    few[0, 0, 30:60:16, 40:90:16] = 9
    return frame, few


def without_normal(frame, seen):
    return replace(frame, normal=None), seen


def without_motion(frame, seen):
    return replace(frame, motion=None), seen


def broken(frame, seen):
    return frame, np.full_like(seen, np.nan)


def empty(frame, seen):
    return replace(frame, depth=0 * frame.depth), seen


@pytest.mark.parametrize(
    "case",
    [still, of_paths_that_end_at_once, curved, a_pane_that_moves, in_one_plane, of_no_camera, of_paths_without_sense,
     of_a_shifted_lens, of_few_pixels, without_normal, without_motion, broken, empty],
)  # fmt: skip
def test_other_frames_keep_their_motion(case):
    frame, seen = case(*pane()[:2])
    moved = with_virtual_motion(frame, seen)
    for name in ("motion", "motion_next", "albedo"):
        assert np.array_equal(getattr(moved, name), getattr(frame, name))


def test_broken_pixels_stay_theirs():
    frame, seen, truth = pane()
    seen[0, 0, 30, 40], seen[0, 0, 31, 41], seen[0, 0, 80, 5] = np.nan, np.inf, -1
    motion, depth = frame.motion.copy(), frame.depth.copy()
    motion[0, :, 20, 20], motion[0, :, 40, 50], depth[0, 0, 90, 9] = np.nan, np.inf, np.nan
    frame = replace(frame, motion=motion, depth=depth)
    moved = with_virtual_motion(frame, seen)
    same = [(30, 40), (31, 41), (20, 20), (40, 50), (90, 9)]
    for y, x in same:
        assert np.array_equal(moved.motion[..., y, x], frame.motion[..., y, x], equal_nan=True)
    where = GLASS.copy()
    where[tuple(np.array(same).T)] = False
    assert np.abs(moved.motion[0] - truth[0])[:, where].max() < 0.02


def cycles(path, frame, seen):
    """The frame as Blender's Cycles writes it."""
    v = np.stack([frame.motion[0, 0], -frame.motion[0, 1], -frame.motion_next[0, 0], frame.motion_next[0, 1]])
    passes = {
        "Combined": ("RGB", frame.radiance[0]), "Denoising Albedo": ("RGB", frame.albedo[0]),
        "Depth": ("Z", frame.depth[0]), "Normal": ("XYZ", frame.normal[0]), "Vector": ("XYZW", v),
        "Denoising Depth": ("Z", seen[0]),
    }  # fmt: skip
    channels = {
        f"ViewLayer.{n}.{c}": x for n, (names, image) in passes.items() for c, x in zip(names, image, strict=True)
    }
    write_layers(path, channels, dtypes=dict.fromkeys(channels, "float"))


def test_denoisers_read_the_frames_of_cycles_so(tmp_path):
    frame, seen, truth = pane()
    seen[0, 0, 40, 40], frame.albedo[0, :, 40, 40] = 30, 0.1  # a stray
    for number in (1, 2):
        cycles(tmp_path / f"frame.{number:04}.exr", frame, seen)
    as_written = open_sequence(tmp_path).read(1)
    assert np.array_equal(as_written.motion, frame.motion)
    sequence = open_chosen(str(tmp_path), Options(model="fast"))[0]
    assert max(apart[GLASS].max() for apart in off(sequence.read(1), truth)) < 0.02
    left = open_chosen(str(tmp_path), Options(model="fast", virtual_motion=False))[0]
    assert np.array_equal(left.read(1).motion, frame.motion)
    for wanted in ({"radiance", "albedo"}, {"radiance", "motion_next"}, {"radiance", "depth"}):  # as a plan wants it
        layers = dict(sequence.only(wanted).read(1).layers())
        assert layers.keys() == wanted
        assert all(np.array_equal(image, getattr(sequence.read(1), name)) for name, image in layers.items())
    assert not open_chosen(str(SHOT), Options(model="fast", signal="indirect"))[0].virtual_motion
    assert [open_chosen(str(SHOT), Options(samples=n))[0].virtual_motion for n in (1, 4, 16)] == [True, True, False]


def test_appended_frames_continue_a_run_of_one_frame(tmp_path):
    """As if all had been there at once: of a frame alone the plan reads no motion."""
    frame, seen, _ = pane()
    radiance = np.random.default_rng(2).exponential(size=(3, *frame.radiance.shape)).astype(np.float32)
    options = Options(model="fast", float32=True, detect_exposure=False)
    for number in range(3):
        cycles(tmp_path / f"frame.{number:04}.exr", replace(frame, radiance=radiance[number]), seen)
        (tmp_path / "grown").mkdir(exist_ok=True)
        shutil.copy2(tmp_path / f"frame.{number:04}.exr", tmp_path / "grown")
        if number != 1:
            denoise(str(tmp_path / "grown"), tmp_path / "appended", options)
    denoise(str(tmp_path / "grown"), tmp_path / "once", options)
    for path in (tmp_path / "grown").iterdir():
        a, b = (read_channels(tmp_path / name / path.name, ["R", "G", "B"]) for name in ("appended", "once"))
        assert all(np.array_equal(a[c], b[c]) for c in "RGB"), path.name


def test_frames_without_mirrors_are_read_as_they_are():
    for index in range(2):
        plain, read = (replace(open_sequence(SHOT), virtual_motion=way).read(index) for way in (False, True))
        assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(plain.layers(), read.layers(), strict=True))
