"""The renderer: radiance against Mitsuba's own integrator, motion against the pictures, clips on disk."""

import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest

from rtdenoise.cli.main import main
from rtdenoise.data.clip_file import FEATURES, RADIANCE, clip_path, read_facts
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.errors import InputError
from rtdenoise.files import lock
from rtdenoise.frame import OFF_SCREEN
from rtdenoise.render import stage
from rtdenoise.render.card import write_card
from rtdenoise.render.clips import render_clips
from rtdenoise.render.draw import MIN_UNCOVERED, probe
from rtdenoise.render.frames import (
    RenderOptions,
    describe_frame,
    features,
    motion_between,
    radiance,
    render_frame,
    uncovered,
)
from rtdenoise.render.options import ClipOptions
from rtdenoise.render.scene_clips import render_group
from rtdenoise.render.scenes import meshes, procedural, textures
from rtdenoise.render.scenes.motions import CameraPath, Motion, look_at
from rtdenoise.render.scenes.named import open_scene
from rtdenoise.render.scenes.sample import sample
from rtdenoise.render.scenes.scene import Material, Object, Scene, Sun
from rtdenoise.render.sequence import render_sequence, write_scene_json
from rtdenoise.render.stage import Stage, find_llvm, start_mitsuba
from rtdenoise.render.streams import NOISY

SIZE = (64, 96)
OPTIONS = RenderOptions(size=SIZE, reference_spp=64, seed=3)


def small_room() -> Scene:
    """All kinds of material, a lamp, the sky through the missing right wall, two moving objects and a moving camera."""
    rng = np.random.default_rng(0)
    painted = Material(0.1 + 0.8 * textures.fractal(rng)[..., None] * np.float32([1, 0.7, 0.4]))
    grey = Material(textures.plain(0.6))
    shapes = [
        ("floor", meshes.quad((-2, 0, 0), (4, 0, 0), (0, 0, -4)).scale_uv(0.4), painted, {}),
        ("back", meshes.quad((-2, 0, -4), (4, 0, 0), (0, 3, 0)).scale_uv(0.3), painted, {}),
        ("left", meshes.quad((-2, 0, 0), (0, 0, -4), (0, 3, 0)), Material(textures.plain((0.7, 0.1, 0.1))), {}),
        ("ceiling", meshes.quad((-2, 3, -4), (4, 0, 0), (0, 0, 4)), grey, {}),
        ("lamp", meshes.quad((-0.6, 2.95, -2.6), (1.2, 0, 0), (0, 0, 1.2)), grey, {"emission": (9.0, 8.0, 6.0)}),
        ("glass ball", _at(meshes.sphere(0.3), (-1, 0.3, -3)), Material(textures.plain(1), "glass"), {}),
        ("metal ball", _at(meshes.sphere(0.35), (1.1, 0.35, -3.2)), Material(textures.plain(0.8), "metal"), {}),
        ("box", _at(meshes.box((0.35, 0.35, 0.35)), (-0.3, 1.1, -2)), Material(textures.plain((0.2, 0.5, 0.8))),
         {"motion": Motion(pivot=(-0.3, 1.1, -2), velocity=(0.14, 0.02, 0.0), axis=(0.2, 1, 0), spin=4)}),
        ("ring", _at(meshes.torus(0.35, 0.12), (0.9, 1.6, -2.6)), Material(textures.plain(0.6), "plastic"),
         {"motion": Motion(pivot=(0.9, 1.6, -2.6), swing=(0.1, 0.1, 0), axis=(1, 0, 0), spin=6)}),
    ]  # fmt: skip
    objects = tuple(Object(i, name, mesh, material, **more) for i, (name, mesh, material, more) in enumerate(shapes, 1))
    camera = CameraPath((0.1, 1.4, 0.2), (0, 1.2, -3), fov=62, velocity=(0.03, 0.0, 0.02), pan=1.3)
    return Scene("small room", objects, camera, textures.sky(rng, sun=True))


def _at(mesh, place):
    return mesh.transform(Motion(velocity=place)(1.0))


@pytest.fixture(scope="module")
def room() -> Stage:
    return Stage(small_room())


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    """(folder, scene.json, [layers of frame 4, layers of frame 5]) as a sequence on disk holds them."""
    folder = tmp_path_factory.mktemp("shot")
    paths = render_sequence(small_room(), folder, 2, OPTIONS, first=4, progress=lambda line: None)
    return folder, json.loads((folder / "scene.json").read_text()), [_read(path) for path in paths]


def _read(path) -> dict[str, np.ndarray]:
    """Layers [H, W, C] of an EXR file, components in the order of their meaning."""
    names = read_header(path).channels
    channels = read_channels(path, list(names))
    layers: dict[str, dict[str, np.ndarray]] = {}
    for name, plane in channels.items():
        layer, _, component = name.rpartition(".")
        layers.setdefault(layer or "color", {})[component] = plane
    return {k: np.stack([v[c] for c in "RGBXYZI" if c in v], -1) for k, v in layers.items()}


def _warp(image, motion):
    """(bilinear image at x + motion(x), where that is inside)."""
    height, width = image.shape[:2]
    y, x = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    x, y = x + motion[..., 0], y + motion[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    i, j = np.clip(np.floor(y), 0, height - 2).astype(int), np.clip(np.floor(x), 0, width - 2).astype(int)
    v, u = np.clip(y - i, 0, 1)[..., None], np.clip(x - j, 0, 1)[..., None]
    top, bottom = image[i, j] * (1 - u) + image[i, j + 1] * u, image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
    return top * (1 - v) + bottom * v, inside


def _inner(id):
    """Pixels whose 3×3 neighbourhood is one object."""
    same = np.ones(id.shape[:2], bool)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            same &= np.roll(id[..., 0], (dy, dx), (0, 1)) == id[..., 0]
    return same


# --- light ------------------------------------------------------------------------------------------------------------


def test_radiance_agrees_with_mitsubas_path_integrator(room):
    mi = start_mitsuba()
    room.at(4)
    camera = room.scene.camera(4)
    flipped = camera.to_world * [-1, -1, 1, 1]  # Mitsuba's camera has x to the left and y up
    sensor = mi.load_dict({
        "type": "perspective", "fov": camera.fov, "to_world": mi.ScalarTransform4f(flipped),
        "film": {"type": "hdrfilm", "width": SIZE[1], "height": SIZE[0], "rfilter": {"type": "box"}},
    })  # fmt: skip
    beauty, indirect = radiance(room, 4, SIZE, 256, 1, 1, max_depth=6)

    def path(max_depth):
        integrator = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 100})
        return np.array(mi.render(room.mitsuba, sensor=sensor, integrator=integrator, spp=256))[..., :3]

    everything, one_bounce = path(6), path(2)
    for ours, theirs, what in ((beauty, everything, "beauty"), (beauty - indirect, one_bounce, "direct"),
                               (indirect, everything - one_bounce, "indirect")):  # fmt: skip
        assert ours.mean() == pytest.approx(theirs.mean(), rel=0.015), what
        a, b = (image.reshape(8, 8, 12, 8, 3).mean((1, 3)) for image in (ours, theirs))
        assert np.abs(a - b).mean() < 0.05 * theirs.mean(), what  # over blocks of 8×8 pixels
    assert indirect.mean() > 0.15 * beauty.mean()


def test_a_picture_of_more_pixels_than_rays_in_flight_is_the_same(room, monkeypatch):
    whole = radiance(room, 4, SIZE, 1, 1, 0, max_depth=3)
    monkeypatch.setattr("rtdenoise.render.frames.MAX_RAYS", SIZE[0] * SIZE[1] - 1)
    for one, other in zip(whole, radiance(room, 4, SIZE, 1, 1, 0, max_depth=3), strict=True):
        assert np.array_equal(one, other)


def test_light_and_features_share_their_rays_also_in_pieces(room, monkeypatch):
    """Light that nothing has reflected is what the surfaces of the features emit."""
    monkeypatch.setattr("rtdenoise.render.frames.MAX_RAYS", 3 * SIZE[0] * SIZE[1])
    emitted, _ = radiance(room, 4, SIZE, 8, 1, NOISY, max_depth=1)
    seen = features(room, 4, SIZE, 8, 1)["emission"]
    assert emitted.std() > 0.05 and np.allclose(seen, emitted, rtol=1e-4, atol=1e-6)


def test_noisy_frame_is_an_unbiased_view_of_the_reference(shot):
    for layers in shot[2]:
        for noisy, clean in (("color", "reference"), ("indirect", "indirect_reference")):
            assert layers[noisy].mean() == pytest.approx(layers[clean].mean(), rel=0.06)
            second = 2 * layers[clean] - layers[f"{clean}_half"]
            noise = np.abs(second - layers[f"{clean}_half"]).mean()
            assert 0 < noise < layers[clean].mean()
            assert second.mean() == pytest.approx(layers[f"{clean}_half"].mean(), rel=0.03)


def test_features_have_the_ranges_of_the_conventions(shot):
    layers = shot[2][0]
    hit = layers["id"][..., 0] > 0
    assert 0.02 < (~hit).mean() < 0.5  # the sky is in view
    assert layers["albedo"].min() >= 0 and layers["albedo"].max() <= 1
    assert np.allclose(np.linalg.norm(layers["normal"][hit], axis=-1), 1, atol=2e-3)
    assert (layers["depth"][hit] > 0).all() and (layers["depth"][~hit] == 0).all()
    origin = np.array(shot[1]["frames"][1]["camera_origin"])
    assert np.allclose(np.linalg.norm(layers["position"] - origin, axis=-1)[hit], layers["depth"][hit, 0], rtol=1e-4)
    names = {int(k): v for k, v in shot[1]["objects"].items()}
    seen = {names[i] for i in np.unique(layers["id"][hit]).astype(int)}
    assert {"floor", "back", "box", "ring", "metal ball", "glass ball"} <= seen
    albedo = {name: layers["albedo"][layers["id"][..., 0] == i].mean(0) for i, name in names.items() if name in seen}
    assert albedo["box"] == pytest.approx([0.2, 0.5, 0.8], abs=0.01)
    assert albedo["metal ball"] == pytest.approx([0.8] * 3, abs=0.01)
    assert albedo["glass ball"] == pytest.approx([1.0] * 3)


# --- motion -----------------------------------------------------------------------------------------------------------


def test_features_of_many_samples_have_less_noise_and_samples_of_their_own(room):
    frame = render_frame(room, 4, replace(OPTIONS, reference_spp=0, feature_spp=16))
    truth = features(room, 4, SIZE, 64, seed=99)
    for name in ("albedo", "normal"):
        error = [np.square(layer - truth[name]).mean() for layer in (frame[name], frame[f"{name}_reference"])]
        assert error[1] < 0.2 * error[0]


def test_warping_by_motion_reproduces_the_next_reference(shot):
    before, now = shot[2]

    def tone(image):
        return image / (image + before["reference"].mean())

    covered = uncovered(now["motion"], before["motion_next"])
    moving = (now["id"][..., 0] == 8) & _inner(now["id"]) & ~covered  # the box
    still = (now["id"][..., 0] > 0) & ~np.isin(now["id"][..., 0], [8, 9]) & _inner(now["id"]) & ~covered
    noise = np.abs(tone(now["reference"]) - tone(now["reference_half"])).mean()
    error = {}
    for sign in (1, 0, -1):
        warped, inside = _warp(tone(before["reference"]), sign * now["motion"])
        error[sign] = np.abs(warped - tone(now["reference"])).mean(-1)[still & inside].mean()
    assert error[1] < 2 * noise
    assert error[1] < 0.85 * error[0] and error[1] < 0.85 * error[-1]
    warped, inside = _warp(before["position"], now["motion"])
    travelled = np.linalg.norm(warped - now["position"], axis=-1)[moving & inside]
    assert np.median(travelled) == pytest.approx(np.hypot(0.14, 0.02), rel=0.25)


def test_motion_lands_on_the_same_object(shot):
    before, now = shot[2]
    height, width = SIZE
    y, x = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    covered = uncovered(now["motion"], before["motion_next"])
    moving = np.isin(now["id"][..., 0], [8, 9]) & _inner(now["id"]) & ~covered
    hits = {}
    for sign in (1, -1):
        column = np.floor(x + 0.5 + sign * now["motion"][..., 0]).astype(int)
        row = np.floor(y + 0.5 + sign * now["motion"][..., 1]).astype(int)
        there = before["id"][np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        hits[sign] = (there == now["id"])[moving].mean()
    assert hits[1] > 0.97 and hits[-1] < 0.9


def test_scene_json_gives_the_motion_that_was_written(shot):
    _, document, (before, now) = shot
    assert document["format"] == "rtdenoise-scene-1"
    assert (document["width"], document["height"]) == (SIZE[1], SIZE[0])
    frames = {f["number"]: f for f in document["frames"]}
    assert sorted(frames) == [3, 4, 5, 6]
    assert set(frames[4]["object_to_world"]) == {"8", "9"}
    for number, layers in ((4, before), (5, now)):
        for layer, other in (("motion", number - 1), ("motion_next", number + 1)):
            again = motion_between(layers["position"], layers["id"], frames[number], frames[other])
            assert np.abs(again - layers[layer]).max() < 1e-3, layer


def test_position_projects_into_its_own_pixel(shot):
    _, document, (layers, _) = shot
    height, width = SIZE
    hit = layers["id"][..., 0] > 0
    points = (
        np.concatenate([layers["position"], np.ones((height, width, 1))], -1)
        @ np.array(document["frames"][1]["world_to_pixel"]).T
    )
    pixel = points[..., :2] / points[..., 3:]
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    offset = (pixel - np.stack([x, y], -1))[hit]
    assert offset.min() > -1e-3 and offset.max() < 1 + 1e-3
    assert offset.mean() == pytest.approx(0.5, abs=0.02) and offset.std() == pytest.approx(12**-0.5, abs=0.02)


def test_a_window_is_that_part_of_the_picture(tmp_path):
    options = ["--width", "64", "--height", "40", "--frames", "1", "--reference-spp", "64"]
    main(["render", "sample", *options, "--out", f"{tmp_path}/whole"])
    main(["render", "sample", *options, "--window", "24", "8", "32", "24", "--out", f"{tmp_path}/part"])
    whole, part = (_read(tmp_path / name / "frame.0000.exr") for name in ("whole", "part"))
    whole = {name: image[8:32, 24:56] for name, image in whole.items()}
    assert part["color"].shape == (24, 32, 3)
    same = _inner(whole["id"]) & (part["id"] == whole["id"])[..., 0]
    assert same.mean() > 0.5
    for layer, bound in (("motion", 0.01), ("position", 0.05)):  # other points of the same pixels
        assert np.median(np.abs(part[layer] - whole[layer])[same]) < bound
    assert part["reference"].mean() == pytest.approx(whole["reference"].mean(), rel=0.05)


@pytest.mark.parametrize("window", [("-1", "0", "8", "8"), ("60", "0", "8", "8"), ("0", "0", "8", "0")])
def test_a_window_beyond_the_picture(window, tmp_path, capsys):
    command = ["render", "sample", "--width", "64", "--height", "40", "--window", *window, "--out", str(tmp_path)]
    with pytest.raises(SystemExit, match="2"):
        main(command)
    told = capsys.readouterr().err
    assert told == f"rtdenoise: --window {' '.join(window)}: expected LEFT TOP WIDTH HEIGHT, a part of 64×40 pixels\n"


def test_motion_next_is_undone_by_the_next_frames_motion(shot):
    before, now = shot[2]
    height, width = SIZE
    y, x = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    column = np.floor(x + 0.5 + before["motion_next"][..., 0]).astype(int)
    row = np.floor(y + 0.5 + before["motion_next"][..., 1]).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    same = inside & (now["id"][row, column] == before["id"])[..., 0] & _inner(before["id"])
    error = np.linalg.norm(before["motion_next"] + now["motion"][row, column], axis=-1)[same]
    assert same.mean() > 0.5 and np.quantile(error, 0.95) < 0.3


def test_sky_moves_as_the_camera_turns():
    camera = CameraPath((0, 1, 0), (0, 1, -5), fov=60, pan=1.0)
    scene = Scene("sky", (), camera)
    frames = [describe_frame(scene, n, (40, 60)) for n in (0, 1)]
    nothing = np.zeros((40, 60, 3)), np.zeros((40, 60, 1))
    motion = motion_between(*nothing, frames[1], frames[0])
    focal = 30 / np.tan(np.radians(30))
    assert motion[20, 30] == pytest.approx([-focal * np.tan(np.radians(1)), 0], abs=0.02)  # the camera turns left
    dolly = Scene("sky", (), replace(camera, pan=0.0, velocity=(0.3, 0.1, 0.2)))
    assert np.abs(motion_between(*nothing, *(describe_frame(dolly, n, (40, 60)) for n in (0, 1)))).max() < 1e-4


def test_what_was_behind_the_camera_is_off_screen():
    scene = Scene("dive", (), CameraPath((0, 0, 0), (0, 0, -1), velocity=(0, 0, -4)))
    position = np.full((1, 1, 3), (0.0, 0.0, -2.0))
    motion = motion_between(position, np.ones((1, 1, 1)), *(describe_frame(scene, n, (1, 1)) for n in (0, 1)))
    assert (motion == OFF_SCREEN).all()


# --- files ------------------------------------------------------------------------------------------------------------


def test_sequence_resumes_where_it_stopped(shot, tmp_path):
    source = shot[0]
    kept = tmp_path / "frame.0004.exr"
    kept.write_bytes((source / "frame.0004.exr").read_bytes())
    stamp = kept.stat().st_mtime_ns
    written = []
    render_sequence(small_room(), tmp_path, 2, replace(OPTIONS, reference_spp=0), first=4, progress=written.append)
    assert kept.stat().st_mtime_ns == stamp and len(written) == 1
    again, once = _read(tmp_path / "frame.0005.exr"), shot[2][1]
    assert "reference" not in again
    for layer in ("color", "indirect", "albedo", "normal", "depth", "motion"):
        assert np.array_equal(again[layer], once[layer]), f"{layer} depends on what was rendered before"
    visible = sorted(p.name for p in tmp_path.iterdir() if p.name[0] != ".")
    assert visible == ["frame.0004.exr", "frame.0005.exr", "scene.json"]


def test_frames_of_other_options_are_not_mixed(shot, tmp_path):
    """Of every option that changes pixels; a run with the same ones goes on."""
    folder = shutil.copytree(shot[0], tmp_path / "shot")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    sun = Sun((0.0, 1.0, 0.0), (1.0, 1.0, 1.0))
    file = tmp_path / "room.xml"
    file.write_text(XML)
    room = small_room()
    for scene, options, complaint in (
        (room, {"spp": 4}, f"spp {OPTIONS.spp}, now 4;"),
        (room, {"reference_spp": 0}, f"reference-spp {OPTIONS.reference_spp}, now 0;"),
        (room, {"max_depth": 3, "seed": 7}, f"max-depth {OPTIONS.max_depth}, now 3, seed {OPTIONS.seed}, now 7;"),
        (room, {"size": (24, 40)}, "width 96, now 40, height 64, now 24;"),
        (replace(room, sun=sun), {}, "scene small room, now small room, with a sun;"),
        (replace(room, file=file), {}, "scene small room, now room.xml with SHA-256 "),
        (replace(room, facts={"pictures": {"folder": "tiles"}}), {}, "textures None, now tiles;"),
    ):
        for first in (4, 6):  # the same frames, and others
            with pytest.raises(InputError, match="holds frames rendered with other options: ") as caught:
                render_sequence(scene, folder, 2, replace(OPTIONS, **options), first, progress=None)
            assert complaint in str(caught.value) and str(caught.value).startswith(f"{folder}: ")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert len(render_sequence(room, folder, 2, OPTIONS, first=4, progress=None)) == 2  # nothing is rendered


def test_options_without_a_frame_bind_nobody(tmp_path):
    for spp in (4, 2):
        write_scene_json(small_room(), tmp_path / "scene.json", range(4, 6), replace(OPTIONS, spp=spp), begun=False)
    assert json.loads((tmp_path / "scene.json").read_text())["rendered"]["spp"] == 2


@pytest.mark.parametrize("content, complaint", [(b"junk", "frame.0004.exr: "), (None, "is 4×4, expected 96×64")])
def test_a_kept_frame_is_one_of_this_run(shot, tmp_path, content, complaint):
    path = tmp_path / "frame.0004.exr"
    path.write_bytes(content) if content else write_layers(path, {"color": np.zeros((4, 4, 3), np.float32)})
    with pytest.raises(InputError, match=complaint):
        render_sequence(small_room(), tmp_path, 2, OPTIONS, first=4, progress=None)


@pytest.mark.parametrize("number", ["x", None])
def test_a_scene_json_whose_frames_have_no_order_is_one_line(tmp_path, number):
    room, path = small_room(), tmp_path / "scene.json"
    write_scene_json(room, path, range(2), OPTIONS, begun=False)
    document = json.loads(path.read_text())
    document["frames"].append({"number": number})
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=f"^{path}: damaged"):
        write_scene_json(room, path, range(2), OPTIONS, begun=True)


def test_two_runs_do_not_render_into_one_folder(tmp_path):
    with lock(tmp_path), pytest.raises(InputError, match="another run is writing there"):
        render_sequence(small_room(), tmp_path, 1, OPTIONS)


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize(
    "content", ["[]", "{}", '{"frames": 3}', '{"frames": [1]}', "{", '{"rendered": 3}', '{"rendered": {"spp": [{}]}}']
)
def test_a_damaged_scene_json_of_an_earlier_run_is_one_line(tmp_path, content, begun):
    (tmp_path / "scene.json").write_text(content)
    if begun:
        (tmp_path / "frame.0000.exr").touch()
    with pytest.raises(InputError, match=f"^{tmp_path}") as caught:
        render_sequence(small_room(), tmp_path, 1, OPTIONS)
    assert "\n" not in str(caught.value) and (tmp_path / "scene.json").read_text() == content


TINY = ClipOptions(count=1, size=(16, 24), frames=3, seed=2, reference_spp=4, workers=1, generator=1)


def test_clip_is_determined_by_its_seed(tmp_path):
    facts = []
    for name, seed in (("a", 2), ("b", 2), ("other", 11)):
        (tmp_path / name).mkdir()
        facts += render_group(tmp_path / name, 0, replace(TINY, seed=seed))
    a, b, other = (ClipDataset(tmp_path / name).load(0) for name in ("a", "b", "other"))
    for first, second, third in zip(a, b, other, strict=True):
        for name, tensor in first.layers():
            assert tensor.equal(getattr(second, name)), name
        assert not first.radiance.equal(third.radiance)
    assert facts[0] | {"seconds": 0} == facts[1] | {"seconds": 0}
    assert read_facts(clip_path(tmp_path / "a", 0)) == facts[0]


def test_a_clip_of_one_frame_uncovers_nothing(tmp_path):
    """Seed 3 draws a scene that uncovers background from the second frame on."""
    (facts,) = render_group(tmp_path, 0, replace(TINY, seed=3, frames=1))
    assert (facts["kind"], facts["uncovered"]) == ("uncovering", 0.0)
    assert write_card(tmp_path, "")["uncovered_share"]["mean"] == 0


def test_clips_are_resumed_and_described(tmp_path):
    lines = []

    def progress(done, total, line):
        lines.append((done, total))

    card = render_clips(tmp_path, TINY, progress)
    stamp = clip_path(tmp_path, 0).stat().st_mtime_ns
    assert lines == [(0, 1), (1, 1)] and card["clips"] == 1
    render_clips(tmp_path, TINY, progress)
    assert lines[2:] == [(0, 0)] and clip_path(tmp_path, 0).stat().st_mtime_ns == stamp
    assert json.loads((tmp_path / "dataset.json").read_text())["seeds"] == [2, 2]
    assert "samples a pixel" in (tmp_path / "DATA.md").read_text()

    data = ClipDataset(tmp_path)
    window = data.load(0, signal="indirect", size=8, frames=2, rng=np.random.default_rng(1))
    assert [f.radiance.shape for f in window] == [(1, 3, 8, 8)] * 2
    whole = data.load(0, signal="indirect")
    start = window[0].number
    places = [(y, x) for y in range(9) for x in range(17) if whole[start].crop(y, x, 8, 8).depth.equal(window[0].depth)]
    assert places and all(getattr(whole[0], name) is not None for name in (*FEATURES, "reference", "reference_half"))
    with pytest.raises(InputError, match="expected at least 4 frames"):
        data.load(0, frames=4)
    with pytest.raises(InputError, match="unknown signal"):
        data.load(0, signal="beauty")
    clip_path(tmp_path, 0).write_bytes(b"cut short")
    with pytest.raises(InputError, match="not a readable clip"):
        data.load(0)
    with pytest.raises(InputError, match="no clips"):
        ClipDataset(tmp_path / "nowhere")
    assert len(RADIANCE) == 6


def test_llvm_is_found_and_its_absence_is_told(tmp_path, monkeypatch):
    for name in ("libLLVM-14.so.1", "libLLVM-15.so", "libLLVM-17.so", "libLLVM.so.19.1"):
        (tmp_path / name).touch()
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)) == str(tmp_path / "libLLVM.so.19.1")
    (tmp_path / "libLLVM.so.19.1").unlink()
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)) == str(tmp_path / "libLLVM-17.so")
    (tmp_path / "libLLVM-17.so").unlink()
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)) is None

    start_mitsuba()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(stage, "find_llvm", lambda: None)
    monkeypatch.setattr("mitsuba.variant", lambda: None)
    monkeypatch.setattr("drjit.has_backend", lambda backend: False)
    with pytest.raises(InputError, match=r"apt install libllvm19, or name the library .* DRJIT_LIBLLVM_PATH"):
        start_mitsuba()
    taken = []
    monkeypatch.setattr("mitsuba.set_variant", taken.append)
    monkeypatch.setattr("drjit.has_backend", lambda backend: backend.name == "LLVM")
    with pytest.raises(InputError, match="LLVM 16 or newer"):  # what Mitsuba itself finds may be older
        start_mitsuba()
    monkeypatch.setattr(sys, "platform", "darwin")  # where it looks in other places than we do
    start_mitsuba()
    assert taken == ["llvm_ad_rgb"]
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(InputError, match=r"pip install 'rtdenoise\[render\]'"):
        start_mitsuba()


# --- scenes -----------------------------------------------------------------------------------------------------------


def test_many_procedural_clips_uncover_background():
    facts = []
    for seed in range(8):
        loaded = Stage(procedural.procedural(seed))
        facts.append(loaded.scene.facts | probe(loaded, 4))
    assert np.mean([f["uncovered"] > MIN_UNCOVERED for f in facts]) >= 0.3
    assert all(0 <= f["uncovered"] < 0.5 and f["sky"] < 1 for f in facts)


def test_procedural_scenes_differ_and_repeat():
    a, again, b = procedural.procedural(5), procedural.procedural(5), procedural.procedural(6)
    assert [o.name for o in a.objects] == [o.name for o in again.objects] and a.facts == again.facts
    assert np.array_equal(a.objects[0].material.texture, again.objects[0].material.texture)
    assert [o.name for o in a.objects] != [o.name for o in b.objects]
    assert procedural.procedural(5, attempt=1).facts["kind"] == a.facts["kind"]
    kinds = [procedural.procedural(seed).facts["kind"] for seed in range(60)]
    assert kinds.count("uncovering") > 25 and "static" in kinds


def test_meshes_face_outwards():
    rng = np.random.default_rng(2)
    solids = [meshes.box((1, 2, 3)), meshes.sphere(), meshes.sphere(1, rng, 0.4), meshes.torus(), meshes.cylinder(),
              meshes.prism(1, 1, 4, 2.0), meshes.bars(2, 1, 4, 0.05), meshes.bars(2, 1, 4, 0.05, True)]  # fmt: skip
    for mesh in solids:
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.einsum("fi,fi->", corners[:, 0], cross) > 0  # six times the volume
        area = np.linalg.norm(cross, axis=1)
        agree = np.einsum("fi,fi->f", cross, mesh.normals[mesh.faces].mean(1))
        assert (agree[area > 1e-6] > 0).all()
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)


XML = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="60"/>
    <transform name="to_world"><lookat origin="0, 1, 4" target="0, 0.5, 0" up="0, 1, 0"/></transform></sensor>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="5"/><rotate x="1" angle="-90"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
  <shape type="cube" id="crate_wood">
    <transform name="to_world"><scale value="0.4"/><translate y="0.5"/></transform></shape>
  <shape type="sphere" id="ball"><float name="radius" value="0.2"/></shape>
  <emitter type="constant"/>
</scene>"""
TOML = """brightness = 0.5
[camera]
velocity = [0.0, 0.1, 0.0]
[[object]]
name = "crate"
shapes = ["crate_*"]
pivot = [0.0, 0.5, 0.0]
velocity = [0.2, 0.0, 0.0]
"""


@pytest.mark.parametrize(("origin", "up"), [((0, 9, 0), (0, 0, -1)), ((0, -9, 0), (0, 0, -1)), ((0, 0, 9), (0, 1, 0))])
def test_a_camera_may_look_straight_down(origin, up):
    axes = look_at(np.array(origin, float), np.zeros(3), 40.0).to_world[:3, :3]
    assert np.allclose(axes.T @ axes, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
    assert np.allclose(axes[:, 1], np.negative(up))  # the second axis points down the picture


def test_a_camera_that_looks_at_its_own_place_is_refused():
    with pytest.raises(InputError, match="looks at its own place"):
        look_at(np.ones(3), np.ones(3), 40.0)


def test_mitsuba_file_is_set_in_motion(tmp_path):
    file, motion = tmp_path / "scene.xml", tmp_path / "motion.toml"
    file.write_text(XML)
    motion.write_text(TOML)
    scene = open_scene(str(file), motion)
    assert [(o.name, o.shapes) for o in scene.objects] == [
        ("crate", ("crate_wood",)), ("floor", ("floor",)), ("ball", ("ball",)),
    ]  # fmt: skip
    assert scene.camera(0).fov == pytest.approx(60) and scene.camera(3).to_world[1, 3] == pytest.approx(1.3)
    loaded = Stage(scene)
    beauty, _ = radiance(loaded, 0, (24, 32), 32, 0, 0, 6)
    before, now = (features(loaded, n, (24, 32)) for n in (0, 1))
    lit = before["id"][..., 0] > 0
    assert beauty[lit].mean() == pytest.approx(0.5, rel=0.1)
    columns = [np.nonzero(layers["id"][..., 0] == 1)[1].mean() for layers in (before, now)]
    step = 0.2 * 16 / np.tan(np.radians(30)) / 4
    assert columns[1] - columns[0] == pytest.approx(step, abs=0.4)
    assert before["motion_next"][before["id"][..., 0] == 1, 0].mean() == pytest.approx(step, rel=0.2)

    for text, complaint in (("[[object]]\nshapes = ['car_*']", "no shape of the scene matches"),
                            ("[[object]]\nspeed = 1", "unknown key 'speed'"), ("[camera]\nsensor = 3", "sensor 3"),
                            ("[camera]\nvelocity = 0.1", "velocity = 0.1: expected 3 number"),
                            ("[camera]\npan = '1'", "pan = '1': expected 1 number"),
                            ("brightness = 'x'", "brightness = 'x': expected 1 number"),
                            ("brightness = nan", "brightness = nan: expected 1 number"),
                            ("brightness = 0", "brightness = 0: expected more than 0"),
                            ("camera = 3", "camera = 3: expected a table"), ("object = 3", "expected tables"),
                            ("cut = [3]", "expected tables"), ("[camera]\nkeys = [3]", "expected tables"),
                            ("[camera]\nsensor = 0.5", "sensor 0.5"), ("[camera]\norbit = 1e308", "of at most"),
                            ("[camera]\naperture = -1", "aperture = -1: expected 0 or more"),
                            ("[[object]]\nshapes = 'ball'", "expected a list of names"),
                            ("[[object]]\nshapes = ['crate_*']\nperiod = 0", "period = 0: expected more than 0"),
                            ("[[object]]\nshapes = ['crate_*']\naxis = [0, 0, 0]", "expected a direction"),
                            ("[[object]]\nshapes = ['ball']\nkeys = [{frame = 0}]\nhold = 'no'",
                             "hold = 'no': expected true or false"),
                            ("[camera]\nframe = 3", "camera: unknown key 'frame'; expected one of aperture"),
                            ("[[cut]]\nframe = 3\nspeed = 1", "cut: unknown key 'speed'; expected one of aperture"),
                            ("[camera]\npan = true", "pan = True: expected 1 number"),
                            ("[camera]\nsensor = false", "sensor False asked for"),
                            ("[[extra]]\nsize = 0", "size = 0: expected more than 0"),
                            ("[[extra]]\nroughness = 3", "roughness = 3: expected 0 to 1"),
                            ("[[object]]\nshapes = ['ball']\nname = 2026-01-01", "object: name = .*: expected text"),
                            ("[[extra]]\nname = [1]", r"extra: name = \[1\]: expected text"),
                            ("brightness = " + 5000 * "9", "not valid TOML"),
                            ("brightness = " + 5000 * "[", "not valid TOML: nested too deeply"),
                            ("brightness = ", "not valid TOML"), ("# \udcff", "not valid TOML")):  # fmt: skip
        motion.write_text(text, encoding="utf-8", errors="surrogateescape")
        with pytest.raises(InputError, match=complaint):
            open_scene(str(file), motion)
    motion.write_text("[[object]]\nshapes = ['ball']")
    with pytest.raises(InputError, match="only meshes can move"):
        Stage(open_scene(str(file), motion))
    with pytest.raises(InputError, match="no such scene file"):
        open_scene("nowhere.xml")
    with pytest.raises(InputError, match="goes with a Mitsuba XML"):
        open_scene("sample", motion)


def test_scenes_are_found_by_name():
    assert open_scene("sample").name == "sample"
    speeds = [np.linalg.norm(o.motion.velocity) for o in sample().objects if o.motion]
    assert len(speeds) == 3 and min(speeds) > 0
    with pytest.raises(InputError, match="procedural:SEED"):
        open_scene("cornell")
