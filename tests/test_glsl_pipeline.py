"""Whole frames as compute shaders against the torch models, whose `step` is the specification."""

import json
import os
import select
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from synthetic import TINY, assert_goes_on, behind_glass, make_frames, write_sequence

from rtdenoise import glsl, models
from rtdenoise.data.exr import read_channels
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.exposure import exposure, limit_fireflies
from rtdenoise.frame import Known
from rtdenoise.glsl import GpuArray, Pipeline, ShaderError, expand
from rtdenoise.glsl.context import create_context
from rtdenoise.glsl.dispatch import dispatch
from rtdenoise.glsl.passes import SELECT_GROUP
from rtdenoise.glsl.source import shaders
from rtdenoise.history import mismatch
from rtdenoise.models import PRESETS, AccumulatedKPNConfig, HybridConfig
from rtdenoise.ops.mean_distance import mean_distance
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.plan import look
from rtdenoise.sanitise import sanitise

# That networks of full width are torch's is a test of its own.
pytestmark = pytest.mark.usefixtures("thin_filters")

# Small models, by the preset of the same architecture.
WHOLE = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, pick_kernel=3, detail=True)  # every head there is
HYBRID = HybridConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, down=(8, 12, 4), up=(12, 8), out=(8, 4))
SMALL = {"paper": TINY, "default": WHOLE, "recent": replace(WHOLE, recent=2), "hybrid": HYBRID}
NETWORKS = SMALL | {"clean": replace(HYBRID, twice=True, clean=True)}  # what history has no part in


@pytest.fixture(autouse=True)
def no_gl_error(gl):
    yield
    assert gl.error == "GL_NO_ERROR"


def arrays(frame):
    return frame.map(lambda tensor: tensor.numpy())


def both(model, frames, half=False, **overrides):
    """The frames [N, 3, H, W] of torch and of the shaders, each with its own history."""
    denoiser, pipeline = models.read(model, **overrides), Pipeline.load(model, half, **overrides)
    history, resident, expected, found = None, None, [], []
    with torch.inference_mode():
        for frame in frames:
            image, history = denoiser.step(frame, history)
            expected.append(image.numpy())
            image, resident = pipeline.step(arrays(frame), resident)
            found.append(image)
    return np.concatenate(expected), np.concatenate(found), history, resident


# Parity


@pytest.mark.parametrize("model", ["paper", PRESETS["default"]], ids=["paper", "default"])
def test_twelve_frames_are_those_of_torch(weights, assert_images_close, model):
    model = model if model == "paper" else weights(model)  # shipped weights, or random ones
    frames = make_frames(12, H=21, W=41)
    expected, found, _, _ = both(model, frames)
    assert_images_close(found, expected, "frame")


@pytest.mark.parametrize("model", ["hybrid", "hybrid-large", "hybrid-large-many"])
def test_albedo_and_normal_are_seen_as_in_torch(assert_images_close, model):
    """By trained weights: a random network of this depth hardly tells one picture from another. Some albedo is
    beyond 1, as that of mirrors is in Cycles."""
    frames = [replace(frame, albedo=2 * frame.albedo, more_history=True) for frame in make_frames(2, H=13, W=29)]
    assert all((frame.albedo > 1).float().mean() > 0.1 for frame in frames)
    expected, found, _, _ = both(model, frames)
    assert_images_close(found, expected, "frame")


def test_weights_from_before_there_were_edge_and_pick_kernels(weights, assert_images_close, tmp_path):
    """Their configuration lacks these keys."""
    with safe_open(weights(replace(SMALL["default"], edge_kernel=1, pick_kernel=1)), framework="np") as file:
        metadata = file.metadata()
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    config = json.loads(metadata["config"])
    del config["edge_kernel"], config["pick_kernel"]
    save_file(tensors, tmp_path / "old.safetensors", metadata | {"config": json.dumps(config)})
    expected, found, _, _ = both(str(tmp_path / "old.safetensors"), make_frames(3, H=24, W=40))
    assert_images_close(found, expected, "frame")


@pytest.mark.parametrize("preset", NETWORKS)
def test_float16_activations_stay_close(weights, assert_images_close, preset):
    frames = make_frames(3 if preset == "clean" else 12, H=19, W=45)  # without history nothing adds up
    expected, found, _, _ = both(weights(NETWORKS[preset]), frames, half=True)
    assert_images_close(found, expected, "frame, float16 activations")
    _, exact, _, _ = both(weights(NETWORKS[preset]), frames[:1])
    assert not np.array_equal(found[:1], exact)  # else no activation was rounded


@pytest.mark.parametrize("preset", NETWORKS)
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 5), (19, 67), (32, 64)])  # (H, W)
def test_every_size(weights, assert_images_close, preset, size):
    expected, found, _, _ = both(weights(NETWORKS[preset]), make_frames(3, *size))
    assert_images_close(found, expected, "frame")


@pytest.mark.parametrize("preset", SMALL)
def test_without_motion_next_dual_motion_is_approximated(weights, assert_images_close, preset):
    frames = [replace(frame, motion_next=None) for frame in make_frames(4, H=24, W=40)]
    frames[2] = replace(frames[2], motion=frames[2].motion * 1.3)  # lands between pixels and leaves cracks
    expected, found, _, _ = both(weights(SMALL[preset]), frames)
    assert_images_close(found, expected, "frame")
    with_layer, _, _, _ = both(weights(SMALL[preset]), make_frames(4, H=24, W=40))
    assert not np.allclose(with_layer, expected, rtol=1e-3)  # else the test shows nothing


@pytest.mark.parametrize("preset", SMALL)
def test_traditional_motion(weights, assert_images_close, preset):
    expected, found, _, _ = both(weights(SMALL[preset]), make_frames(3), motion="traditional")
    assert_images_close(found, expected, "frame")
    assert not np.allclose(both(weights(SMALL[preset]), make_frames(3))[1], found, rtol=1e-3)


def test_edges_that_move(weights, assert_images_close, monkeypatch):
    """They change the picture of a network for one sample a pixel alone."""
    frames, unknown = make_frames(4), []
    monkeypatch.setattr("rtdenoise.models.hybrid.seen", lambda frame, history, after, *_: after.footprint)
    for many in (False, True):
        model = weights(replace(HYBRID, many=many))
        unknown.append(both(model, frames)[0])
    monkeypatch.undo()
    for many, without in zip((False, True), unknown, strict=True):
        expected, found, _, _ = both(weights(replace(HYBRID, many=many)), frames)
        assert_images_close(found, expected, "frame")
        assert np.allclose(expected, without, rtol=1e-3) == many


def test_a_wide_pixel_filter(weights, assert_images_close):
    """It changes the picture of a network for many samples a pixel alone."""
    frames = make_frames(4, noise=0.3)
    frames = [replace(f, motion=f.motion + 0.3, motion_next=f.motion_next - 0.3) for f in frames]  # off the pixel
    for many in (False, True):
        model = weights(replace(HYBRID, many=many))
        narrow = both(model, frames)[0]
        expected, found, _, _ = both(model, [replace(frame, more_history=True) for frame in frames])
        assert_images_close(found, expected, "frame")
        assert np.allclose(expected, narrow, rtol=1e-3) != many


def test_little_noise(assert_images_close, monkeypatch):
    """Where there is little, light that one frame has seen is hardly evened, by trained weights."""
    frames = make_frames(3, noise=0.1)
    expected, found, _, _ = both("hybrid", frames)
    assert_images_close(found, expected, "frame")
    monkeypatch.setattr("rtdenoise.models.hybrid.EVENED_NOISE", 1e-6)
    evened = both("hybrid", frames[:2])[0]
    assert np.abs(evened - expected[:2]).max() > 0.02 * expected.mean()


@pytest.mark.parametrize("preset, noise", [("default", 0.0), ("recent", 0.0), ("recent", 0.1)])
def test_light_behind_glass_is_followed(weights, assert_images_close, preset, noise):
    """Without noise within its frame, with noise in the denoised pictures, where more can be told of it."""
    model, frames = weights(SMALL[preset]), behind_glass(5, noise=noise, H=60, W=90)
    expected, found, history, _ = both(model, frames)
    assert_images_close(found, expected, "frame")
    assert noise == 0 or any(shift.any() for shift in history.shifts)
    without = Pipeline.load(model)
    _, first = without.step(arrays(frames[0]))
    image, _ = without.step(arrays(frames[1]), first, Known(on_surfaces=True))
    assert np.allclose(image, expected[1], rtol=1e-3) == (noise > 0)


@pytest.mark.parametrize("preset", ["default", "recent"])
def test_an_interrupted_run_goes_on_to_the_bit(weights, tmp_path, preset):
    shot = write_sequence(tmp_path / "shot", behind_glass(5, H=60, W=90))
    options = Options(model=weights(SMALL[preset]), backend="glsl", precision="fp32", float32=True)
    assert_goes_on(shot, tmp_path, options, 4)


def test_a_run_that_one_backend_began_the_other_goes_on_with(weights, tmp_path, assert_images_close):
    shot, options = tmp_path / "shot", Options(model=weights(SMALL["recent"]), precision="fp32", float32=True)
    frames = behind_glass(5, H=60, W=90)
    for backend, more in (("torch", frames[:3]), ("glsl", frames[3:])):
        write_sequence(shot, more)
        denoise(str(shot), tmp_path / "both", replace(options, backend=backend))
    denoise(str(shot), tmp_path / "torch", replace(options, backend="torch"))
    for path in sorted((tmp_path / "torch").glob("*.exr")):
        assert_images_close(pixels(tmp_path / "both" / path.name), pixels(path), "frame")


def test_max_pooling(weights, assert_images_close):
    expected, found, _, _ = both(weights(replace(TINY, pool="max")), make_frames(2))
    assert_images_close(found, expected, "frame")


def with_faults(frame, faults):
    """The frame with a firefly, and in every layer one pixel for each of `faults`."""
    frame.radiance[0, :, 15, 25] = torch.tensor([900.0, 500.0, 100.0])
    for row, (_, tensor) in enumerate(frame.layers()):
        tensor[:, :, row + 3, 1 : 1 + len(faults)] = torch.tensor(faults)
    return frame


@pytest.mark.parametrize("preset", SMALL)
def test_bad_pixels_are_replaced_as_in_torch(weights, assert_images_close, preset):
    frames = [with_faults(frame, (np.nan, np.inf, -np.inf, -1.0)) for frame in make_frames(3)]
    expected, found, _, _ = both(weights(SMALL[preset]), frames)
    assert np.isfinite(found).all()
    assert_images_close(found, expected, "frame")


def test_frames_are_sanitised_as_in_torch(gl, assert_images_close):
    frame = with_faults(make_frames(1)[0], (np.nan, np.inf, -np.inf, -1.0, 1e9, 1e30, -1e30))
    layers = {name: GpuArray.upload(gl, tensor[0].numpy()) for name, tensor in frame.layers()}
    clean, pipeline = sanitise(frame), Pipeline.load("paper")
    light, surface, guide, *_ = pipeline.passes.prepare(layers)
    for image, channels in (
        (light, clean.radiance), (surface, torch.cat([clean.normal, clean.depth], 1)), (guide, clean.albedo),
        (pipeline.passes.vectors(layers), torch.cat([clean.motion, clean.motion_next], 1)),
    ):  # fmt: skip
        found = np.moveaxis(image.read(), 2, 0)[None, : channels.shape[1]]
        assert_images_close(found, channels, "float32" if image is light else "exact")


@pytest.mark.parametrize("size", [(1, 1), (24, 8), (19, 83)])
def test_exposure_and_distance_are_those_of_the_frame(gl, assert_images_close, size):
    cases = {"noise": torch.empty(1, 3, *size).exponential_(), "black": torch.zeros(1, 3, *size)}
    cases["one value"] = torch.full((1, 3, *size), 0.25)
    cases["small"] = torch.where(torch.arange(size[0])[:, None] < 8, cases["noise"], 0.0)
    cases["smaller"] = torch.where(torch.arange(size[1]) < 1, cases["small"], 0.0)
    cases["firefly"] = cases["noise"].clone()
    cases["firefly"][0, :, -1, -1] = 1e6
    depth = torch.rand(1, 1, *size) - 0.3
    pipeline = Pipeline.load("paper")
    for radiance in cases.values():
        layers = {"radiance": radiance, "albedo": radiance, "normal": radiance, "depth": depth}
        inputs = pipeline.passes.prepare({k: GpuArray.upload(gl, v[0].numpy()) for k, v in layers.items()})
        scale, distance = inputs.statistics.read()
        assert_images_close(scale, exposure(limit_fireflies(radiance)).item(), "float32")
        assert_images_close(distance, mean_distance(depth.clamp(min=0)).item(), "float32")


def test_a_negative_zero_is_not_the_greatest(gl):
    """Drivers may leave it where a shader clamps to 0."""
    maxima = GpuArray.upload(gl, np.array([-0.0, 3.0, -0.0, 2.0, 1.0], np.float32))
    usual = GpuArray.upload(gl, np.zeros(1, np.float32))
    dispatch("frame/usual", (1,), {"maxima": maxima, "usual": usual}, {"count": 5}, SELECT_GROUP)
    assert usual.read() == 2.0  # the second greatest


def test_history_of_another_kind_of_model_is_refused(weights):
    paper, default, recent, hybrid = (Pipeline.load(weights(config)) for config in SMALL.values())
    frame = arrays(make_frames(1)[0])
    for pipeline, other in ((paper, default), (default, paper), (hybrid, recent)):
        with pytest.raises(InputError, match="history is of another kind of model"):
            pipeline.step(frame, other.step(frame)[1])
    with pytest.raises(InputError, match=r"step takes the history that .*, or None, got numpy.ndarray"):
        paper.step(frame, frame.radiance)


# Whose context


@pytest.fixture
def mine(gl):
    """A program's own context, which a test may make current."""
    ctx = glsl.create_context()
    gl.__enter__()
    yield ctx
    gl.__enter__()
    ctx.release()


def test_the_context_of_a_program_stays_current_and_intact(mine, weights):
    model, frames = weights(SMALL["recent"]), [arrays(frame) for frame in make_frames(5)]
    expected = []
    pipeline, history = Pipeline.load(model), None
    for frame in frames:
        image, history = pipeline.step(frame, history)
        expected.append(image)
    mine.__enter__()
    history, buffers = None, []
    for frame, wanted in zip(frames, expected, strict=True):
        image, history = pipeline.step(frame, history)  # drops the history before
        assert np.array_equal(image, wanted)
        buffers += [mine.buffer(np.full(4096, len(buffers) + i, np.float32)) for i in range(20)]
        assert pipeline.mismatch(frame, history) < 1
        image = np.ones((1, 3, 5, 7), np.float32)
        assert np.array_equal(glsl.warp(image, np.zeros((1, 2, 5, 7), np.float32)), image)
        resident = glsl.History.upload(pipeline.ctx, history.read())
        assert np.array_equal(resident.denoised.read(), history.denoised.read())
    for i, buffer in enumerate(buffers):
        assert (np.frombuffer(buffer.read(), np.float32) == i).all()
    assert mine.error == "GL_NO_ERROR"
    assert np.array_equal(Pipeline.load(model).step(frames[0])[0], expected[0])


def test_a_renderer_shares_its_context(mine, weights):
    model, frame = weights(SMALL["paper"]), arrays(make_frames(1)[0])
    pipeline = Pipeline.load(model, ctx=mine)
    image, history = pipeline.step(frame)
    assert pipeline.ctx is history.denoised.buffer.ctx is mine
    assert np.array_equal(image, Pipeline.load(model).step(frame)[0])


def test_shaders_in_a_fork_are_refused(weights):
    """Drivers wait there for ever: for a pipeline of the process before, and for one of its own."""
    pipeline, (frame,) = Pipeline.load(weights(SMALL["paper"])), map(arrays, make_frames(1))
    pipeline.step(frame)
    reader, writer = os.pipe()
    if not (child := os.fork()):
        said = []
        for call in (lambda: pipeline.step(frame), create_context):
            try:
                call()
            except InputError as error:
                said.append(str(error))
        os.write(writer, "\n".join(said).encode())
        os._exit(0)
    try:
        assert select.select([reader], [], [], 60)[0], "the fork hangs"
        assert os.read(reader, 1000).decode().count("get_context('spawn')") == 2
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(reader)
        os.close(writer)
    assert np.isfinite(pipeline.step(frame)[0]).all()


def test_a_pipeline_of_another_thread_is_refused(weights):
    pipeline, refused = Pipeline.load(weights(SMALL["paper"])), []

    def step():
        try:
            pipeline.step(arrays(make_frames(1)[0]))
        except InputError as error:
            refused.append(str(error))

    thread = threading.Thread(target=step)
    thread.start()
    thread.join()
    assert "in the thread that made them" in refused[0]


OPENGL_43 = """
import sys
import numpy as np
from rtdenoise.frame import Frame
from rtdenoise.glsl import Pipeline, default_context

random = np.random.default_rng(0).random
frame = Frame(*(random((1, channels, 9, 13), np.float32) for channels in (3, 3, 3, 1, 2)))
for model in sys.argv[1:]:
    pipeline, history = Pipeline.load(model), None
    for _ in range(3):
        image, history = pipeline.step(frame, history)
    print(pipeline.ctx.version_code, np.isfinite(image).all(), pipeline.ctx.error)
"""


def test_it_runs_on_opengl_43(monkeypatch, weights):
    monkeypatch.undo()  # of which the other process knows nothing
    older = os.environ | {"MESA_GL_VERSION_OVERRIDE": "4.3", "MESA_GLSL_VERSION_OVERRIDE": "430"}
    command = [sys.executable, "-c", OPENGL_43, *(weights(config) for config in NETWORKS.values())]
    run = subprocess.run(command, env=older, capture_output=True, text=True)
    assert run.stdout == "430 True GL_NO_ERROR\n" * len(NETWORKS), run.stderr


def test_every_shader_expands():
    """With any constants: no shader has more buffers than OpenGL 4.3 guarantees, or includes a missing file."""
    folder = Path(str(shaders()))
    for path in folder.rglob("*.comp.glsl"):
        name = path.relative_to(folder).as_posix().removesuffix(".comp.glsl")
        with pytest.raises(ShaderError, match="missing constants") as error:
            expand(name)
        constants = str(error.value).partition("missing constants ")[2].split(", ")
        assert expand(name, **dict.fromkeys(constants, 1)).buffers


# Passes that are left out


def moved(frames, speed):
    motion = torch.tensor(speed).reshape(1, 2, 1, 1).expand_as(frames[0].motion).contiguous()
    return [replace(frame, motion=-motion, motion_next=motion) for frame in frames]


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.parametrize("speed", [(0.0, 0.0), (3.25, -1.5)], ids=["still", "pan"])
def test_what_is_left_out_changes_no_bit(weights, preset, speed, half):
    pipeline, frames = Pipeline.load(weights(SMALL[preset]), half), moved(make_frames(4, H=19, W=43), speed)
    without = [replace(f, motion_next=None) for f in frames]
    for run in (frames, without):
        history = planned = None
        for frame in map(arrays, run):
            known = look(frame, arrays(run[0]).motion_next, planned is not None)
            assert known == Known(first=True) if history is None else known.covered and known.still == (speed[0] == 0)
            image, history = pipeline.step(frame, history)
            less, planned = pipeline.step(frame, planned, known)
            assert np.array_equal(image, less)
            for name, values in history.read().items():
                assert np.array_equal(values, planned.read()[name])


@pytest.mark.parametrize("preset", SMALL)
def test_a_planned_run_is_that_of_torch(weights, tmp_path, assert_images_close, preset):
    frames = moved(make_frames(3), (0.0, 0.0)) + make_frames(6)[3:]  # at first nothing moves
    shot = write_sequence(tmp_path / "shot", frames)
    options = Options(model=weights(SMALL[preset]), precision="fp32", float32=True, lookahead=0)
    counts = {}
    for name, changed in {"torch": {"backend": "torch"}, "glsl": {}, "all": {"plan": False}}.items():
        summary = denoise(str(shot), tmp_path / name, replace(options, **({"backend": "glsl"} | changed)))
        assert any("run on the CPU" in note for note in summary.notes) == ("llvmpipe" in summary.ran["device"])
        counts[name] = {what: n for what, n in summary.left_out.items() if n}
    means = {} if preset == "paper" else {"running means": 1}
    assert counts == {"torch": counts["glsl"], "glsl": means | {"warp of history": 2, "dual motion": 2}, "all": {}}
    for path in sorted((tmp_path / "torch").glob("*.exr")):
        assert_images_close(pixels(tmp_path / "glsl" / path.name), pixels(path), "frame")
        assert np.array_equal(pixels(tmp_path / "glsl" / path.name), pixels(tmp_path / "all" / path.name))


# State


@pytest.mark.parametrize("preset", SMALL)
def test_history_is_that_of_torch_and_comes_back(gl, weights, assert_images_close, preset):
    model, frames = weights(SMALL[preset]), make_frames(4)
    _, _, history, resident = both(model, frames[:3])
    fields = resident.read()
    layers = replace(history, footprint=None, footprint_count=None).layers()  # which no step reads
    of_first = set(fields) - set(layers)  # shaders know of a first frame's shifts that they are zero
    assert of_first <= {f"shifts.{len(history.shifts)}"} and not any(fields.pop(name).any() for name in of_first)
    assert set(fields) == set(layers)
    for name, tensor in layers.items():
        if name.startswith("recent."):
            kept = torch.from_numpy(fields[name]), tensor.contiguous()
            halves = (words.view(torch.bfloat16).float() for words in kept)
            torch.testing.assert_close(*halves, rtol=0.01, atol=1e-30)  # a bit of bfloat16
        else:
            assert_images_close(fields[name], tensor, "frame")
    pipeline = Pipeline.load(model)
    again = pipeline.step(arrays(frames[3]), glsl.History.upload(gl, resident.read()))[0]
    assert np.array_equal(again, pipeline.step(arrays(frames[3]), resident)[0])


def test_a_history_may_be_used_twice(weights):
    pipeline, frames = Pipeline.load(weights(SMALL["default"])), [arrays(frame) for frame in make_frames(3)]
    _, history = pipeline.step(frames[0])
    once, _ = pipeline.step(frames[1], history)
    pipeline.step(frames[2], history)
    assert np.array_equal(pipeline.step(frames[1], history)[0], once)


def test_after_the_first_frame_only_history_is_allocated(weights):
    pipeline, frames = Pipeline.load(weights(SMALL["default"])), [arrays(frame) for frame in make_frames(4)]
    _, history = pipeline.step(frames[0])
    _, history = pipeline.step(frames[1], history)
    before = pipeline.scratch.nbytes
    pipeline.step(frames[2], history)
    assert pipeline.scratch.nbytes == before > 0


def test_stages_are_timed(gl, weights):
    pipeline, frame = Pipeline.load(weights(SMALL["default"])), arrays(make_frames(1)[0])
    pipeline.clock = glsl.Clock(gl)
    pipeline.step(frame)
    seconds = pipeline.clock.read()
    assert list(seconds) == ["upload", "features", "reprojection", "network", "kernels", "blend", "download"]
    assert min(seconds.values()) > 0 and pipeline.clock.read() == {}


@pytest.mark.parametrize("shift", [0, 5, "noise", "unmoved"])  # of the previous frame's surfaces, in pixels
def test_mismatch_is_that_of_torch(weights, shift):
    denoiser, pipeline, frames = models.read(weights(TINY)), Pipeline.load(weights(TINY)), make_frames(2)
    moved = replace(frames[1], motion=frames[1].motion + 0.3)
    if shift == "noise":  # another surface in most pixels, and the right one beside many of them
        torch.manual_seed(0)
        depth, motion = torch.rand_like(moved.depth) + 0.5, moved.motion + 4 * torch.randn_like(moved.motion)
        moved = replace(moved, depth=moved.depth * depth, motion=motion)
    elif shift == "unmoved":  # by vectors that are zero
        moved = replace(moved, depth=moved.depth.roll(3, -1), motion=0 * moved.motion)
    else:
        moved = replace(moved, depth=moved.depth.roll(shift, -1))
    _, history = denoiser.step(frames[0])
    _, resident = pipeline.step(arrays(frames[0]))
    expected = mismatch(sanitise(moved), history).item()
    assert pipeline.mismatch(arrays(moved), resident) == pytest.approx(expected)
    assert (expected > 0.1) == bool(shift)


# Refusals


def test_what_is_missing_or_does_not_fit_is_named(weights):
    pipeline, frame = Pipeline.load(weights(SMALL["paper"])), arrays(make_frames(1)[0])
    with pytest.raises(InputError, match="layer normal is missing"):
        pipeline.step(replace(frame, normal=None))
    _, history = pipeline.step(frame)
    with pytest.raises(InputError, match="layer motion is missing"):
        pipeline.step(replace(frame, motion=None), history)
    with pytest.raises(InputError, match=r"history is \(24, 32\), the frame \(16, 32\); pass history=None"):
        pipeline.step(frame.crop(0, 0, 16, 32), history)
    with pytest.raises(InputError, match=r"one frame at a time.*got 2"):
        pipeline.step(frame.map(lambda array: np.concatenate([array, array])))


def test_a_frame_that_is_too_large_is_named(weights, monkeypatch):
    pipeline, frame = Pipeline.load(weights(SMALL["paper"])), arrays(make_frames(1)[0])
    monkeypatch.setattr("rtdenoise.glsl.context.storage_limit", lambda ctx: 24 * 32 * 12)
    with pytest.raises(InputError, match=r"32×24 is too large: array \[24, 32, 4\] float32 .*--precision fp16.*tiles"):
        pipeline.step(frame)


def test_memory_that_runs_out_is_named(gl, monkeypatch):
    monkeypatch.setattr("rtdenoise.glsl.context.storage_limit", lambda ctx: 1 << 50)
    with pytest.raises(InputError, match=r"array \[1099511627776\] float32: 4398046\.5 MB more than .* has memory for"):
        GpuArray.empty(gl, (1 << 40,))


def test_weights_that_do_not_fit_are_named(weights, tmp_path):
    tensors, path = load_file(weights(TINY)), tmp_path / "wrong.safetensors"
    config = {"widths": TINY.widths, "kernel": 5, "pool": "mean", "motion": "dual"}

    def refused(architecture="temporal_kpn", **changed):
        metadata = {"architecture": architecture, "config": json.dumps(config | changed)}
        save_file(tensors, path, metadata)
        with pytest.raises(InputError) as error:
            Pipeline.load(path)
        assert "\n" not in str(error.value) and str(path) in str(error.value)
        return str(error.value)

    assert "heads.0.bias is (51,), expected (19,)" in refused(kernel=3)
    known = "temporal_kpn, accumulated_kpn, hybrid, combiner, afgsa, mltd"
    assert f"expected an architecture of {known}, got 'nosuch'" in refused("nosuch")
    assert "unknown field 'pool'" in refused("accumulated_kpn")
    assert "expected motion 'dual' or 'traditional', got 'none'" in refused(motion="none")
    with pytest.raises(InputError, match=r"sales: not an override of model 'paper'.*its configuration has widths"):
        Pipeline.load("paper", sales=3)
    with pytest.raises(InputError, match="no model 'nosuch'"):
        Pipeline.load("nosuch")


# The command line


def pixels(path):
    return np.stack(list(read_channels(path, ("R", "G", "B")).values()))


def test_the_backends_write_the_same(weights, tmp_path, assert_images_close):
    shot = write_sequence(tmp_path / "shot", make_frames())
    options = Options(model=weights(SMALL["default"]), float32=True, precision="fp32")
    for backend in ("torch", "glsl"):
        denoise(str(shot), tmp_path / backend, replace(options, backend=backend))
    for path in sorted((tmp_path / "torch").glob("*.exr")):
        assert_images_close(pixels(tmp_path / "glsl" / path.name), pixels(path), "frame")


def test_a_run_that_did_not_finish_a_frame_is_started_anew(weights, tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    options = Options(model=weights(SMALL["default"]), backend="glsl")

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        denoise(str(shot), tmp_path / "out", options, on_frame=stop)
    assert denoise(str(shot), tmp_path / "out", options).written == 2


def test_options_that_do_not_go_together_are_refused(tmp_path, weights):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    for options, message in (
        ({"backend": "vulkan"}, "unknown backend 'vulkan'; expected one of auto, torch, glsl"),
        ({"backend": "glsl", "device": "cuda"}, "device 'cuda': goes with the backend torch"),
        ({"backend": "glsl", "precision": "bf16"}, "precision 'bf16': the backend glsl has 'fp32' and 'fp16'"),
    ):
        with pytest.raises(InputError, match=message):
            denoise(str(shot), tmp_path / "out", Options(model=weights(TINY), **options))


NO_TORCH = """
import sys
from importlib.machinery import PathFinder

class WithoutTorch(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] == "torch" else super().find_spec(name, path, target)

sys.meta_path = [WithoutTorch if finder is PathFinder else finder for finder in sys.meta_path]
"""


def without_torch(code, *arguments):
    """Run `code` where torch is not installed: importing it raises ModuleNotFoundError."""
    command = [sys.executable, "-c", NO_TORCH + code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_without_torch_there_is_none():
    assert "No module named 'torch'" in without_torch("import torch").stderr


@pytest.mark.parametrize("preset", SMALL)
def test_a_sequence_is_denoised_without_torch(weights, tmp_path, assert_images_close, preset):
    shot, model = write_sequence(tmp_path / "shot", make_frames(3)), weights(SMALL[preset])
    code = "from rtdenoise.cli.main import main; main()"
    run = without_torch(code, "denoise", shot, "--out", tmp_path / "out", "--model", model, "--float32")  # auto: glsl
    assert run.returncode == 0, run.stderr
    assert "3 frames written" in run.stdout
    expected, _, _, _ = both(model, open_sequence(shot))
    for i, image in enumerate(expected):
        assert_images_close(pixels(tmp_path / "out" / f"frame.{i:04d}.exr"), image, "frame")


def test_the_pipeline_is_imported_without_torch(weights):
    code = "from rtdenoise.glsl import Pipeline; print(Pipeline.load(sys.argv[1]).config.architecture)"
    run = without_torch(code, weights(SMALL["default"]))
    assert run.stdout == "accumulated_kpn\n", run.stderr


def test_everything_around_denoising_runs_without_torch(weights, tmp_path):
    """The same files and pictures with torch and without: the denoised beauty, and the preview."""
    shot, model = write_sequence(tmp_path / "shot", make_frames(2)), weights(TINY)
    main = "from rtdenoise.cli.main import main; main()"
    common = ("--signal", "indirect", "--recombine", "--preview", "--model", model, "--float32", "--backend", "glsl")
    for name, start in (("without", NO_TORCH), ("with", "import sys\n")):
        command = [sys.executable, "-c", start + main, "denoise", shot, "--out", tmp_path / name, *common]
        run = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert (run.returncode, "preview.png" in run.stdout) == (0, True), run.stderr
    for name in ("frame.0001.exr", "preview.png"):
        assert (tmp_path / "without" / name).read_bytes() == (tmp_path / "with" / name).read_bytes()


def test_inspect_without_torch_leaves_out_the_motion(tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    run = without_torch("from rtdenoise.cli.main import main; main()", "inspect", shot)
    assert run.returncode == 0, run.stderr
    assert "not checked: it takes PyTorch; type: pip install 'rtdenoise[torch]'" in run.stdout


def test_what_needs_torch_says_so(weights, tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    for words, message in (
        (("denoise", shot, "--out", tmp_path / "out", "--model", weights(TINY), "--backend", "torch"), "backend torch"),
        (("evaluate", shot, "--out", tmp_path / "out"), "this needs PyTorch"),
        (("demo", "--out", tmp_path / "out"), "this needs PyTorch"),
    ):
        run = without_torch("from rtdenoise.cli.main import main; main()", *words)
        assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
        assert message in run.stderr and "type: pip install 'rtdenoise[torch]'" in run.stderr
