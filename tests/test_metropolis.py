"""Metropolis sampling: against path tracing, against a target in one dimension, its components, bad input."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from rendering import render_here

from rtdenoise.cli.main import main
from rtdenoise.data.clip_file import clip_path, read_facts, read_layers
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import read_channels
from rtdenoise.errors import InputError
from rtdenoise.render.frames import RenderOptions, radiance, render_frame
from rtdenoise.render.metropolis import MetropolisOptions, chains_of, metropolis, unseen_lamps
from rtdenoise.render.options import ClipOptions
from rtdenoise.render.scenes import meshes, textures
from rtdenoise.render.scenes.caustic import caustic
from rtdenoise.render.scenes.motions import CameraPath
from rtdenoise.render.scenes.scene import Material, Object, Scene, Spot
from rtdenoise.render.sequence import render_sequence
from rtdenoise.render.stage import Stage, start_mitsuba
from rtdenoise.render.streams import stream_seed

SIZE, DEPTH, BLOCK = (24, 24), 5, 8
CHAINS = MetropolisOptions(chains=256)


def room(brightness: float = 1.0, lamp: bool = True, spots: tuple[Spot, ...] = ()) -> Scene:
    """A glass ball between a floor and a wall, a lamp above it."""
    white = Material(textures.plain(0.7))
    objects = [
        Object(1, "floor", meshes.quad((-2, 0, 1), (4, 0, 0), (0, 0, -4)), white),
        Object(2, "wall", meshes.quad((-2, 0, -3), (4, 0, 0), (0, 3, 0)), Material(textures.plain((0.6, 0.3, 0.2)))),
        Object(3, "ball", meshes.sphere(0.5).transform(_at(0.2, 0.6, -1.6)), Material(textures.plain(1.0), "glass")),
    ]
    if lamp:
        light = meshes.quad((-0.5, 2.5, -2.0), (1, 0, 0), (0, 0, 1))
        objects.append(Object(4, "lamp", light, white, emission=(4 * brightness, 3 * brightness, 2 * brightness)))
    return Scene("room", tuple(objects), CameraPath((0, 1.2, 1.8), (0, 0.9, -2), fov=60), spots=spots)


def _at(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage(room())


def test_neighbouring_inputs_of_the_hash_give_independent_numbers():
    mi = start_mitsuba()
    from rtdenoise.render.primary_samples import CHOICE, hashed

    count, worst = 1 << 13, 0.0
    for step in range(3):
        key = mi.UInt32(stream_seed(3, step))
        numbers = np.array(hashed(mi.UInt32(np.arange(4 * count)), key)[0]).reshape(4, count)
        choice = np.array(hashed(mi.UInt32(np.arange(count)) + CHOICE, key)[0])
        for a, b in ((numbers[0], numbers[1]), (numbers[0, :-1], numbers[0, 1:]), (choice, numbers[0])):
            cells = np.histogram2d(a, b, 16, ((0, 1), (0, 1)))[0]
            worst = max(worst, (((cells - cells.mean()) ** 2 / cells.mean()).sum() - 255) / np.sqrt(2 * 255))
    assert worst < 4


def test_numbers_stay_in_the_unit_interval():
    mi = start_mitsuba()
    from rtdenoise.render.primary_samples import mutated, replay, wrapped

    awkward = np.float32([-1e-20, -1e-9, -0.25, 0.0, 1.0, 1.75, np.nextafter(np.float32(1), np.float32(0))])
    found = np.array(wrapped(mi.Float(awkward)))
    assert ((found >= 0) & (found < 1)).all()
    np.testing.assert_allclose(found[[2, 5]], [0.75, 0.75])
    u, index = mi.Float(np.tile([0.0, 1 - 2**-24], 5000)), mi.UInt32(np.arange(10000))
    for large in (True, False):
        moved = np.array(mutated(u, index, mi.UInt32(9), mi.Bool(large)))
        assert ((moved >= 0) & (moved < 1)).all()
    step = np.abs(moved - np.array(u))
    step = np.minimum(step, 1 - step)  # on the circle
    assert step.min() > 0.9 / 1024 and step.max() < 1.1 / 64
    assert (moved[::2] < 0.5).mean() == pytest.approx(0.5, abs=0.03)  # from 0, half of the steps go below

    sampler = replay(lambda dimension: mi.Float(dimension) * 0.125, 2, True)  # more numbers than the path has
    sampler.start()
    beyond = [float(sampler.next_1d()[0]) for _ in range(3)]
    assert all(0 <= value < 1 for value in beyond) and len(set(beyond)) == 3


@dataclass
class Strip:
    """A picture whose paths have one number, and whose light is a function of it."""

    height: int = 1
    width: int = 16
    pixels: int = 16
    dimensions: int = 1


def test_chains_keep_to_a_target_in_one_dimension(monkeypatch):
    """Their states are distributed as the target, and the picture is its integral over every pixel."""
    mi = start_mitsuba()
    import drjit as dr

    from rtdenoise.render import chains

    def light(picture, number):
        u = number(mi.UInt32(0))
        value = dr.select(u < 0.25, 0, 1 + 30 * u * u * u)  # dark in a quarter
        value = dr.select(u > 0.9, 200 * value, value)
        return mi.Color3f(value), mi.Color3f(0), value, mi.UInt32(u * picture.width)

    monkeypatch.setattr(chains, "light_of", light)
    middle = (np.arange(16 * 4000) + 0.5) / (16 * 4000)
    exact = np.where(middle < 0.25, 0, 1 + 30 * middle**3) * np.where(middle > 0.9, 200, 1)
    exact = exact.reshape(16, -1).mean(1)

    count, steps, runs = 4096, 60, 6
    pictures, states = [], np.zeros(16)
    for run in range(runs):
        walked, films, values, first = chains.walk(Strip(), count, steps, chains.Law(), (run,))
        large = np.array(walked.proposed, float).sum()
        b = (values.sum() + np.array(walked.total, float).sum()) / (len(values) + large)
        film = np.array(films.chains).reshape(16, 2, 3)[..., 0].sum(1) * b / first
        pictures.append((film + np.array(films.large).reshape(16, 3)[:, 0]) / (count * steps) * 16)
        states += np.bincount((np.array(walked.u) * 16).astype(int), minlength=16)
    expected = exact / exact.sum() * states.sum()
    assert (np.abs(states - expected) <= 4 * np.sqrt(expected)).all(), (states, expected)
    mean, error = np.mean(pictures, 0), np.std(pictures, 0, ddof=1) / np.sqrt(runs)
    assert (np.abs(mean - exact) <= 4 * error + 1e-6).all(), (mean, exact, error)
    assert (error <= 0.02 * exact + 1e-9).all()


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over blocks of BLOCK × BLOCK pixels, and over the whole image."""
    height, width, _ = image.shape
    means = image.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3).mean((1, 3, 4)).ravel()
    return np.append(means, image.mean())


def test_the_mean_is_that_of_path_tracing(stage):
    """Whole, and in blocks of 8×8 pixels, within three standard errors: beauty, indirect light, proposals."""
    traced = [radiance(stage, 0, SIZE, 128, 5, stream, DEPTH) for stream in range(10)]
    walked = [metropolis(stage, 0, SIZE, 24, 7, stream, DEPTH, CHAINS)[0] for stream in range(10)]
    for names, found in ((("color", "proposals"), 0), (("indirect",), 1)):
        a = np.array([blocks(run[found]) for run in traced])
        for name in names:
            b = np.array([blocks(run[name]) for run in walked])
            error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / len(a))
            assert (np.abs(a.mean(0) - b.mean(0)) <= 3 * error).all(), (name, (a.mean(0) - b.mean(0)) / error)
            assert error[-1] < 0.06 * a.mean(), name


def test_components_add_up_and_seeds_repeat(stage):
    layers, facts = metropolis(stage, 0, SIZE, 8, 1, 0, DEPTH, CHAINS)
    assert np.array_equal(layers["large"] + layers["small"], layers["color"])
    assert min(layers[name].min() for name in layers) >= 0 and layers["small"].max() > 0 and layers["large"].max() > 0
    assert facts["chains"] == 256 and facts["mutations"] == pytest.approx(8)
    again, told = metropolis(stage, 0, SIZE, 8, 1, 0, DEPTH, CHAINS)
    assert told == facts
    for name in layers:  # films are summed in the order in which threads come
        np.testing.assert_allclose(again[name], layers[name], rtol=1e-4, atol=1e-5)
    other, _ = metropolis(stage, 0, SIZE, 8, 2, 0, DEPTH, CHAINS)
    assert np.abs(other["color"] - layers["color"]).mean() > 0.1 * layers["color"].mean()

    replaced, _ = metropolis(stage, 0, SIZE, 8, 1, 0, DEPTH, replace(CHAINS, attribution="replaced"))
    np.testing.assert_allclose(replaced["color"], layers["color"], rtol=1e-4, atol=1e-5)
    assert np.abs(replaced["large"] - layers["large"]).max() > 0.1


def test_one_seed_for_all_frames_or_one_for_each(stage):
    """Nothing moves, so the pictures of two frames differ by their random numbers alone."""
    options = RenderOptions(SIZE, 2, 4, DEPTH, 3, replace(CHAINS, seed="same"))
    first, second = (render_frame(stage, number, options) for number in (0, 1))
    np.testing.assert_allclose(first["color"], second["color"], rtol=1e-4, atol=1e-5)
    assert np.abs(first["reference_half"] - second["reference_half"]).max() > 0.01  # references are independent
    halves = first["reference_half"], 2 * first["reference"] - first["reference_half"]
    assert np.abs(halves[0] - halves[1]).max() > 0.01
    third = render_frame(stage, 1, replace(options, metropolis=replace(CHAINS, references="path")))
    assert np.abs(third["color"] - first["color"]).max() > 0.01
    traced = radiance(stage, 1, SIZE, 2, 3, 1, DEPTH)[0]
    np.testing.assert_array_equal(third["reference_half"], traced)


def test_brighter_lamps_change_no_decision(stage):
    layers, facts = metropolis(stage, 0, SIZE, 4, 1, 0, DEPTH, CHAINS)
    brighter, told = metropolis(Stage(room(10.0)), 0, SIZE, 4, 1, 0, DEPTH, CHAINS)
    assert told["accepted"] == facts["accepted"]
    for name in layers:
        np.testing.assert_allclose(brighter[name], 10 * layers[name], rtol=1e-3, atol=1e-4)


def test_no_path_reads_numbers_that_it_does_not_have(stage, capfd):
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        metropolis(stage, 0, (8, 8), 2, 1, 0, DEPTH, MetropolisOptions(chains=64))
    assert "out-of-bounds" not in capfd.readouterr().err


def test_tiny_steps_are_all_accepted(stage):
    tiny = {"smallest": 1e-8, "largest": 1e-7, "large": 0.01}
    facts = metropolis(stage, 0, SIZE, 8, 1, 0, DEPTH, CHAINS, tiny)[1]
    usual = metropolis(stage, 0, SIZE, 8, 1, 0, DEPTH, CHAINS)[1]
    assert facts["accepted"]["small"] > 0.995 > 0.95 > usual["accepted"]["small"]


def test_a_scene_that_cannot_be_recorded_is_traced_step_by_step(stage, monkeypatch):
    import drjit as dr

    expected = metropolis(stage, 0, SIZE, 2, 1, 0, DEPTH, CHAINS)[0]["color"]

    def refused(function):
        def call(*arguments):
            raise RuntimeError("record(): error")

        return call

    monkeypatch.setattr(dr, "freeze", refused)
    found = metropolis(stage, 0, SIZE, 2, 1, 0, DEPTH, CHAINS)[0]["color"]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


# --- bad input --------------------------------------------------------------------------------------------------------


def test_a_scene_without_light_is_named():
    with pytest.raises(InputError, match="room: frame 0: none of 32768 paths finds light; move the camera"):
        metropolis(Stage(room(lamp=False)), 0, SIZE, 1, 0, 0, DEPTH, CHAINS)


def test_lamps_without_area_behind_glass_are_named(stage, tmp_path):
    assert unseen_lamps(stage) == ""
    lit = room(spots=(Spot((0, 2.4, 0), (0, 0, -1.5), (9, 9, 9)),))
    lines = []
    options = RenderOptions((16, 16), 1, 0, 3, 0, CHAINS)
    render_sequence(lit, tmp_path, 1, replace(options, metropolis=MetropolisOptions(64)), progress=lines.append)
    assert lines[0].startswith("warning: room: 1 lamps without area") and "1 smooth glass" in lines[0]


def test_chains_fit_the_picture():
    assert chains_of(MetropolisOptions(), (64, 64), 1) == 1024
    assert chains_of(MetropolisOptions(), (4, 4), 1) == 16  # no more than there are mutations
    assert chains_of(MetropolisOptions(), (4000, 4000), 1) == 1 << 16
    with pytest.raises(InputError, match="--chains 300: 16×8 pixels with 2 mutations each have only 256 mutations"):
        chains_of(MetropolisOptions(300), (8, 16), 2)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("render sample --integrator pssmlt --spp 0", "--spp: expected 1 or more, got 0"),
        ("render sample --integrator pssmlt --size 16 --chains 300", "have only 256 mutations"),
        ("render sample --integrator pssmlt --chains 0", "--chains: expected 1 or more, got 0"),
        ("render sample --chains 9", "--chains: goes with --integrator pssmlt"),
        ("render sample --references path", "--references: goes with --integrator pssmlt"),
        ("clips --chains 9", "--chains: goes with --integrator pssmlt"),
        ("clips --integrator pssmlt --sun 1", "--sun: goes with --integrator path"),
        ("clips --integrator pssmlt --reference-spp 0", "need references"),
        ("clips --integrator pssmlt --reference-spp 9", "in two halves; expected an even number, got 9"),
    ],
)
def test_options_that_do_not_fit(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        main([*arguments.split(), "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and not (tmp_path / "out").exists()


# --- sequences, clips, scenes -----------------------------------------------------------------------------------------


def test_a_sequence_resumes_with_its_own_options_only(tmp_path):
    options = RenderOptions((16, 16), 2, 2, 3, 0, MetropolisOptions(64))
    paths = render_sequence(room(), tmp_path, 2, options, progress=lambda line: None)
    before = [path.read_bytes() for path in paths]
    paths[1].unlink()
    render_sequence(room(), tmp_path, 2, options, progress=lambda line: None)
    assert paths[0].read_bytes() == before[0] and paths[1].exists()
    names = [f"{layer}{c}" for layer in ("", "large.", "small.", "proposals.", "reference_half.") for c in "RGB"]
    found = read_channels(paths[0], names)
    for c in "RGB":  # half floats
        np.testing.assert_allclose(found[f"large.{c}"] + found[f"small.{c}"], found[c], rtol=2e-3, atol=1e-6)
    assert json.loads((tmp_path / "scene.json").read_text())["rendered"]["metropolis"]["chains"] == 64

    for other in (replace(options, spp=4), replace(options, metropolis=None)):
        with pytest.raises(InputError, match=r"rendered with other options: (spp 2, now 4|metropolis .*now None);"):
            render_sequence(room(), tmp_path, 2, other, progress=lambda line: None)


def test_clips_of_caustic_scenes(tmp_path):
    options = ClipOptions(1, (16, 16), 2, reference_spp=4, max_depth=4, workers=1, metropolis=MetropolisOptions())
    render_here(tmp_path, options, lambda *_: None)
    facts, layers = read_facts(clip_path(tmp_path, 0)), read_layers(clip_path(tmp_path, 0))
    assert facts["generator"] == "caustic" and facts["integrator"] == "pssmlt" and facts["chains"] in (16, 64)
    assert facts["samples"] in (1, 2, 4, 8) and (layers["samples"] == facts["samples"]).all()
    tolerance = dict(rtol=4e-3, atol=1e-4)
    np.testing.assert_allclose(layers["large"] + layers["small"], layers["color"], **tolerance)
    assert {"position", "proposals", "reference_half", "indirect_reference_half"} <= layers.keys()
    frame = ClipDataset(tmp_path).load(0)[1]
    assert frame.components.shape == (1, 6, 16, 16)
    written = clip_path(tmp_path, 0).read_bytes()
    render_here(tmp_path, options, lambda *_: None)
    assert clip_path(tmp_path, 0).read_bytes() == written
    for change in ({"spp": 4}, {"reference_spp": 8}):
        with pytest.raises(InputError, match=f"rendered with .*{next(iter(change))} = "):
            render_here(tmp_path, replace(options, count=2, **change), lambda *_: None)
    with pytest.raises(InputError, match="generator = caustic, not 3"):
        render_here(tmp_path, replace(options, metropolis=None, size=(32, 32)), lambda *_: None)


def test_caustic_scenes_have_lamps_that_paths_find():
    kinds = []
    for seed in range(40):
        scene = caustic(seed)
        kinds += [o.name.split()[0] for o in scene.objects if o.material.kind != "diffuse"]
        assert not scene.spots and scene.sun is None
        assert any(o.material.kind == "glass" for o in scene.objects)
        lamps = [o for o in scene.objects if o.emission is not None]
        assert len(lamps) == 2 and lamps[0].motion is not None
        rim = lamps[0].mesh.vertices - lamps[0].mesh.vertices.mean(0)
        assert 0.04 < np.linalg.norm(rim, axis=1).max() < 0.2
    for kind, share in (("glass", 0.5), ("plastic", 0.3), ("metal", 0.2)):
        assert kinds.count(kind) / len(kinds) == pytest.approx(share, abs=0.1)
    first, again = caustic(7), caustic(7)
    assert [o.name for o in first.objects] == [o.name for o in again.objects]
    assert np.array_equal(first.camera(3).to_world, again.camera(3).to_world)
