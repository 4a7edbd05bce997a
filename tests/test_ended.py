"""Dots in mirrors: samples whose path ended there (`data.ended`)."""

from dataclasses import replace

import numpy as np
import pytest
from test_virtual_motion import GLASS, H, W, curved, cycles, pane, still

from rtdenoise.data.ended import MOST, with_seen_albedo
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.virtual_depth import seen_behind
from rtdenoise.data.virtual_motion import with_virtual_motion
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

SEEN = 0.5  # albedo of what the mirror shows, and of all else


def where(*pixels):
    mask = np.zeros((H, W), bool)
    mask[tuple(np.array(pixels).T)] = True
    return mask


def mirror(ended, albedo=0.01):
    """A mirror in a wall, in which paths of the pixels that have ended have this albedo."""
    frame, paths, _ = pane()
    colours = frame.albedo.copy()
    colours[0][:, ended] = albedo
    paths[0, 0, ended] = pane(behind=3.5)[1][0, 0, ended]
    return replace(frame, albedo=colours), paths


SCATTERED = np.zeros((H, W), bool)
SCATTERED[18:62:3, 34:94:4] = True
TOUCHING = where((20, 40), (21, 41), (30, 50), (30, 51), (40, 60), (41, 60), (42, 61), (50, 70), (50, 71), (51, 70))
CORNERS = where((16, 32), (63, 95), (16, 60))  # of the mirror


@pytest.mark.parametrize("dots", [SCATTERED, TOUCHING], ids=["scattered", "touching"])
@pytest.mark.parametrize("albedo", [0.01, 0.2])
def test_dots_have_the_albedo_of_what_is_seen_around(dots, albedo):
    frame, paths = mirror(dots, albedo)
    before = frame.albedo.copy()
    found = with_virtual_motion(frame, paths)
    assert (found.albedo == np.float32(SEEN)).all()
    assert np.array_equal(frame.albedo, before), "what was given stays as it is"
    assert found.radiance is frame.radiance and found.depth is frame.depth


def test_of_several_colours_that_of_most():
    frame, paths = mirror(where((30, 50)))
    frame.albedo[0, :, 29:32, 49] = 0.9
    frame.albedo[0, 2] *= 0.5
    assert with_virtual_motion(frame, paths).albedo[0, :, 30, 50] == pytest.approx([SEEN, SEEN, SEEN / 2])


def moves(frame, paths):
    return replace(frame, motion=frame.motion + np.float32(2) * GLASS), paths


@pytest.mark.parametrize("case", [still, moves, curved])
def test_also_where_motion_stays(case):
    frame, paths = case(*mirror(SCATTERED))
    found = with_virtual_motion(frame, paths)
    assert (found.albedo == np.float32(SEEN)).all()
    assert np.array_equal(found.motion, frame.motion) and np.array_equal(found.motion_next, frame.motion_next)


LEVEL = where(*((30, x) for x in range(40, 70)))
STEEP = where(*((20 + y, 40 + y // 4) for y in range(40)))
SHALLOW = where(*((20 + x // 3, 40 + x) for x in range(40)))
DIAGONAL = where(*((20 + x, 40 + x) for x in range(MOST + 1)))  # the shortest that is one
UNEVEN = LEVEL | where((31, 45), (31, 46), (29, 55), (31, 60))
CHECKER = GLASS & (np.add.outer(np.arange(H), np.arange(W)) % 2 == 0)
TILES = GLASS & (np.add.outer(np.arange(H) // 2, np.arange(W) // 2) % 2 == 0)
GRID = GLASS & ((np.arange(H)[:, None] % 4 == 0) | (np.arange(W) % 4 == 0))
BOX = where(*((y, x) for y in range(30, 40) for x in range(50, 62)))
DISC = np.hypot(np.arange(H)[:, None] - 40, np.arange(W) - 60) < 7.3
STAYS = dict(level=LEVEL, steep=STEEP, shallow=SHALLOW, diagonal=DIAGONAL, uneven=UNEVEN, checker=CHECKER, tiles=TILES,
             grid=GRID, box=BOX, disc=DISC)  # fmt: skip


@pytest.mark.parametrize("name", STAYS)
def test_dark_lines_textures_and_objects_stay(name):
    frame, paths = mirror(STAYS[name])
    assert np.array_equal(with_virtual_motion(frame, paths).albedo, frame.albedo)


def test_a_line_stays_amid_dots_that_go():
    dots = SCATTERED & ~np.logical_or.reduce([np.roll(SHALLOW, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    frame, paths = mirror(SHALLOW | dots)
    found = with_virtual_motion(frame, paths).albedo
    assert np.array_equal(found[..., SHALLOW], frame.albedo[..., SHALLOW]) and (found[..., dots] == SEEN).all()


def nothing_darker(frame, paths):
    return mirror(SCATTERED, 0.3)


def brighter(frame, paths):
    return mirror(SCATTERED, 1.2)


def lost(frame, paths):
    return mirror(SCATTERED, 0.0)


def before_the_mirror(frame, paths):
    depth = np.where(SCATTERED, np.float32(0.8), np.float32(1)) * frame.depth
    return replace(frame, depth=depth), np.where(SCATTERED, np.float32(0.8), np.float32(1)) * paths


def seen_in_it(frame, paths):
    return still(frame, pane()[1])  # paths go on, and end at what is dark


def beside_it(frame, paths):
    albedo = np.full_like(frame.albedo, SEEN)
    albedo[:, :, 2:12:3, 20:100:3] = albedo[:, :, 70:90:3, 20:100:3] = 0.01
    return replace(frame, albedo=albedo), paths


def nowhere(frame, paths):
    return frame, pane(behind=3.5)[1]


def at_its_corners(frame, paths):
    """Where too few around show what is seen."""
    return mirror(CORNERS & where((16, 32), (63, 95)))


@pytest.mark.parametrize(
    "case", [nothing_darker, brighter, lost, before_the_mirror, seen_in_it, beside_it, nowhere, at_its_corners]
)
def test_other_pixels_stay(case):
    frame, paths = case(*mirror(SCATTERED))
    assert np.array_equal(with_virtual_motion(frame, paths).albedo, frame.albedo)


def test_dots_at_the_edges_of_mirror_and_picture():
    frame, paths = mirror(CORNERS)
    assert with_virtual_motion(frame, paths).albedo[0, 0, 16, 60] == SEEN
    seen = seen_behind(frame.depth[0, 0], paths[0, 0])
    everywhere = np.ones((H, W), bool)
    dots = where((0, 50), (H - 1, 20), (40, 0), (60, W - 1), (61, 0))
    colours = np.where(dots, np.float32(0.01), np.float32(SEEN)).repeat(3, 0).reshape(H, 3, W).transpose(1, 0, 2)[None]
    seen = seen._replace(through=everywhere & ~dots, ended=dots, depth=np.ones((H, W), np.float32))
    found = with_seen_albedo(replace(frame, albedo=np.ascontiguousarray(colours)), seen)
    assert (found.albedo == np.float32(SEEN)).all() and found.albedo.flags.c_contiguous


def test_nothing_is_copied_where_there_are_no_dots():
    for ended in (np.zeros((H, W), bool), LEVEL):
        frame, paths = mirror(ended)
        assert with_seen_albedo(frame, seen_behind(frame.depth[0, 0], paths[0, 0])) is frame


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38])
def test_broken_values_count_for_nothing(value):
    frame, paths = mirror(where((30, 50), (40, 60)))
    frame.albedo[0, :, 29, 50] = frame.albedo[0, 1, 30, 51] = frame.albedo[0, :, 41, 61] = value
    frame.depth[0, 0, 40, 59] = np.nan
    found = with_virtual_motion(frame, paths).albedo
    assert (found[0, :, [30, 40], [50, 60]] == SEEN).all()


def test_frames_of_cycles_are_read_so(tmp_path):
    frame, paths = mirror(SCATTERED)
    frame, paths = still(frame, paths)
    cycles(tmp_path / "frame.0001.exr", frame, paths)
    assert np.array_equal(open_sequence(tmp_path).read(0).albedo, frame.albedo), "as written"
    read = lambda **options: open_chosen(str(tmp_path), Options(model="fast", **options))[0].read(0).albedo  # noqa: E731
    assert (read() == np.float32(SEEN)).all() and (read(samples=4) == np.float32(SEEN)).all()
    assert np.array_equal(read(virtual_motion=False), frame.albedo)
    assert np.array_equal(read(samples=16), frame.albedo), "they are means then"


def test_files_without_paths_are_read_as_they_are(tmp_path):
    frame, paths = mirror(SCATTERED)
    cycles(tmp_path / "frame.0001.exr", frame, paths)
    path = tmp_path / "frame.0001.exr"
    channels = read_channels(path, read_header(path).channels.keys())
    del channels["ViewLayer.Denoising Depth.Z"]
    write_layers(path, channels, dtypes=dict.fromkeys(channels, "float"))
    found = open_chosen(str(tmp_path), Options(model="fast", samples=1))[0].read(0)
    assert np.array_equal(found.albedo, frame.albedo) and np.array_equal(found.motion, frame.motion)
