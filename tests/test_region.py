"""A render region of Blender in frames that are not cropped to it (`data.region`)."""

from pathlib import Path

import numpy as np
import pytest

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.region import Region, find_region
from rtdenoise.run.denoise import denoise
from rtdenoise.run.inspect import inspect
from rtdenoise.run.options import Options

SHOT = Path(__file__).parent / "data" / "cycles"
FIRST = sorted(SHOT.glob("*.exr"))[0]
H, W = read_header(FIRST).height, read_header(FIRST).width
INSIDE = np.s_[H // 4 : H - 4, 6 : W - W // 4]


def write_region(folder, whole):
    """Frames of the shot of which only INSIDE was rendered: `whole`, or cropped to it."""
    folder.mkdir()
    for path in sorted(SHOT.glob("*.exr"))[:3]:
        planes = read_channels(path, list(read_header(path).channels))
        for name, plane in planes.items():
            empty = np.full_like(plane, 1e11 if name.endswith(".Depth.Z") else 0)
            empty[INSIDE] = plane[INSIDE]
            planes[name] = empty if whole else plane[INSIDE]
        write_layers(folder / path.name, planes, dtypes=dict.fromkeys(planes, "float"))
    return folder


@pytest.mark.parametrize("options", [
    Options(model="default"), Options(layout="source", lights=True, model="default"), Options(offline=True),
    Options(signal="indirect", recombine=True, model="default"),
], ids=["plain", "lights", "offline", "recombine"])  # fmt: skip
def test_the_rim_is_as_in_cropped_frames(tmp_path, options):
    made = []
    for name in ("whole", "cropped"):
        denoise(str(write_region(tmp_path / name, name == "whole")), tmp_path / f"{name}-out", options)
        path = sorted((tmp_path / f"{name}-out").glob("*.exr"))[-1]
        layer = "" if options.layout == "plain" else "ViewLayer.Combined."
        made.append(read_channels(path, [f"{layer}{c}" for c in "RGBA"]))
    for (name, whole), cropped in zip(made[0].items(), made[1].values(), strict=True):
        rim = np.ones_like(cropped, bool)
        rim[2:-2, 2:-2] = False
        assert np.abs(whole[INSIDE] - cropped)[rim].mean() < 0.08 * cropped[rim].mean(), name
        whole[INSIDE] = 0
        assert not whole.any(), name


def test_alpha_and_the_outside_stay_as_rendered_where_asked(tmp_path):
    shot = write_region(tmp_path / "whole", True)
    denoise(str(shot), tmp_path / "out", Options(model="fast", alpha="rendered"))
    for path in shot.iterdir():
        (alpha,) = read_channels(path, ["ViewLayer.Combined.A"]).values()
        assert np.array_equal(read_channels(tmp_path / "out" / path.name, ["A"])["A"], alpha)


def test_what_lies_beyond_says_nothing_to_inspect(tmp_path):
    whole, cropped = (inspect(write_region(tmp_path / name, name == "whole")) for name in ("whole", "cropped"))
    assert whole.convention == cropped.convention and whole.motion == cropped.motion
    assert (whole.size, whole.faults) == ((H, W), cropped.faults)


def test_only_a_rectangle_that_is_not_all_is_a_region():
    depth = np.full((12, 16), 1e11, np.float32)
    assert find_region(depth) is None
    depth[2:9, 5:] = 3
    depth[4, 6] = 1e10  # nothing was hit
    assert find_region(depth) == Region(slice(2, 9), slice(5, 16))
    depth[0, 0] = 3
    assert find_region(depth) is None
    assert find_region(np.full((4, 4), 1e10)) is None


@pytest.mark.parametrize("there", [np.s_[2:3, 5:6], np.s_[0:12, 3:9], np.s_[4:7, 0:16]])
def test_the_region_is_mirrored_however_small(there):
    plane = np.random.default_rng(0).random((12, 16))
    rows, columns = there
    mirrored = Region(rows, columns).around(plane)
    before, after = rows.start, 12 - rows.stop
    if max(before, after) <= rows.stop - rows.start:
        expected = np.pad(plane[rows, columns], ((before, after), (0, 0)), "symmetric")
        assert np.array_equal(mirrored[:, columns], expected)
    assert np.array_equal(mirrored[there], plane[there]) and np.isin(mirrored, plane[there]).all()
