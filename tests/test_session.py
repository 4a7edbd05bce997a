"""`rtdenoise.Denoiser`: numpy or torch, any layout, and a sentence for whatever is wrong."""

import copy
import pickle
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import make_frames

import rtdenoise
from rtdenoise import InputError, models
from rtdenoise.glsl import Pipeline

FEATURES = ("albedo", "normal", "depth", "motion", "motion_next")


def pictures(frame, convert=lambda array: array):
    """A frame as a renderer's program has it: (color, features) of `[H, W, C]`, depth `[H, W]`."""
    planes = {name: convert(tensor[0].permute(1, 2, 0).numpy().copy()) for name, tensor in frame.layers()}
    return planes["radiance"], {name: planes[name] for name in FEATURES} | {"depth": planes["depth"][..., 0]}


def batches(frame):
    return frame.radiance, {name: getattr(frame, name) for name in FEATURES}


@pytest.fixture(scope="module")
def frames():
    return make_frames(4)


@pytest.fixture(scope="module")
def expected(frames):
    """The outputs of `step` for them, `[1, 3, H, W]` each."""
    network, history, images = models.load("fast"), None, []
    with torch.inference_mode():
        for frame in frames:
            image, history = network.step(frame, history)
            images.append(image.clone())
    return images


def play(frames, convert, model="fast", **options):
    denoiser = rtdenoise.Denoiser(model, **options)
    return [denoiser(color, **features) for color, features in map(convert, frames)]


def test_three_lines_from_numpy_to_clean_frames(frames, expected, assert_images_close):
    found = play(frames, pictures)
    assert all(image.shape == (24, 32, 3) and image.dtype == np.float32 for image in found)
    for image, wanted in zip(found, expected, strict=True):
        assert_images_close(np.moveaxis(image, 2, 0)[None], wanted, "float32 network")


@pytest.mark.parametrize("model", ["fast", "hybrid-fast"])
def test_autocast_of_the_caller_changes_nothing(frames, model):
    expected = play(frames, batches, model)
    with torch.autocast("cpu", torch.bfloat16):
        found = play(frames, batches, model)
    assert all(map(torch.equal, found, expected))


@pytest.mark.parametrize("lookahead", [0, 1])
def test_a_picture_that_fails_leaves_no_trace(frames, lookahead):
    """The next ones have their own form."""
    denoiser, broken = rtdenoise.Denoiser("fast", lookahead=lookahead), [True]
    real = denoiser._backend.denoise

    def dies(*arguments):
        if broken:
            raise InputError("no")
        return real(*arguments)

    denoiser._backend.denoise = dies
    if lookahead:
        color, features = batches(frames[0])
        assert denoiser(color, **features) is None
    with pytest.raises(InputError, match="no"):
        denoiser(frames[1].radiance, **batches(frames[1])[1])
    broken.clear()
    color, features = pictures(frames[2])
    found = [denoiser(color, **features), *denoiser.flush()]
    assert isinstance(found[-1], np.ndarray) and found[-1].shape == (24, 32, 3)
    assert not denoiser._forms


def failing_at(denoiser, *numbers):
    """`denoiser` with a backend that fails at frames of these numbers."""
    real = denoiser._backend.denoise

    def dies(frame, *more):
        if frame.number in numbers:
            raise InputError("no")
        return real(frame, *more)

    denoiser._backend.denoise = dies
    return denoiser


def test_frames_that_always_fail_do_not_stop_those_after(frames):
    """As large ones that do not fit into memory. Pictures that were ready still come."""
    denoiser = failing_at(rtdenoise.Denoiser("fast", lookahead=2), 2, 3)
    color, features = pictures(frames[0])
    assert [denoiser(color, **features) for _ in range(2)] == [None] * 2
    denoiser.reset()
    images = [denoiser(color, **features) for _ in range(2)]  # 2 and 3
    assert all(image is not None for image in images)
    for _ in range(2):  # as the picture of 2, and once more
        with pytest.raises(InputError, match="no"):
            denoiser(color, **features)
    assert denoiser(color, **features) is None
    (image,) = denoiser.flush()
    assert image.shape == color.shape and not denoiser._forms


def test_a_picture_that_waits_for_one_that_fails_still_comes(frames):
    """As that settles it (`models.settled`)."""
    denoiser = failing_at(rtdenoise.Denoiser("fast", lookahead=3), 2)
    color, features = pictures(frames[0])
    assert [denoiser(color, **features) is None for _ in range(4)] == [True, True, True, False]  # that of 0
    for _ in range(2):  # 2, for the picture of 1, and once more
        with pytest.raises(InputError, match="no"):
            denoiser(color, **features)
    assert denoiser(color, **features) is None
    images = denoiser.flush()
    assert len(images) == 2 and not denoiser._forms  # those of 1 and of the last call


@pytest.mark.parametrize("failing", ["mismatch", "denoise", "arguments"])
def test_the_frame_after_a_call_that_fails_starts_anew(frames, monkeypatch, failing):
    """Its motion leads to the frame that failed, not to the one before."""

    def dies(*_):
        raise InputError("no")

    denoiser = rtdenoise.Denoiser("fast")
    for frame in frames[:2]:
        denoiser(frame.radiance, **batches(frame)[1])
    assert not denoiser.started
    color, features = batches(frames[2])
    with monkeypatch.context() as patch, pytest.raises(InputError):
        if failing == "arguments":
            features["depth"] = features["depth"][..., 1:]
        else:
            patch.setattr(denoiser._backend, failing, dies)
        denoiser(color, **features)
    color, features = batches(frames[3])
    image = denoiser(color, **features)
    assert denoiser.started and torch.equal(image, rtdenoise.Denoiser("fast")(color, **features))


def test_a_frame_that_fails_leaves_no_plan_of_its_size(frames, monkeypatch):
    denoiser, planned = rtdenoise.Denoiser("fast"), []
    real = denoiser._backend.plan
    monkeypatch.setattr(denoiser._backend, "plan", lambda size, *more: planned.append(size) or real(size, *more))
    color, features = batches(frames[0])
    denoiser(color, **features)
    with monkeypatch.context() as patch, pytest.raises(MemoryError), pytest.warns(UserWarning, match="anew"):
        patch.setattr(denoiser._backend, "prepare", lambda frame: (_ for _ in ()).throw(MemoryError()))
        denoiser(color[..., :16, :], **{name: layer[..., :16, :] for name, layer in features.items()})
    denoiser(color, **features)
    assert planned == [(24, 32), (16, 32), (24, 32)]


def test_tensors_and_batches_come_back_as_they_are(frames, expected, assert_images_close):
    for image, wanted in zip(play(frames, batches), expected, strict=True):
        assert isinstance(image, torch.Tensor) and not image.is_inference() and image.device.type == "cpu"
        assert_images_close(image, wanted, "float32 network")
    double = play([frame.map(lambda t: torch.cat([t, t.flip(3)])) for frame in frames], batches)
    for image, wanted in zip(double, expected, strict=True):
        assert_images_close(image[:1], wanted, "float32 network")


@pytest.mark.parametrize("dtype", [np.float16, np.float64, torch.float16, torch.bfloat16, torch.float64])
def test_any_float_comes_back_as_it_went_in(frames, dtype):
    def convert(array):
        return torch.from_numpy(array).to(dtype) if isinstance(dtype, torch.dtype) else array.astype(dtype)

    color, features = pictures(frames[0], convert)
    bright = color * 10 if dtype in (np.float64, torch.float64) else color
    image = rtdenoise.Denoiser("fast")(bright, **features)
    assert image.dtype == dtype and type(image) is type(color) and image.shape == color.shape
    assert np.isfinite(np.asarray(image.float() if isinstance(image, torch.Tensor) else image)).all()


def test_doubles_beyond_float32_are_broken_pixels(recwarn):
    """Renderers write their largest number as the depth of a miss."""
    image = np.full((16, 16, 3), 0.5)
    depth, motion, image[3, 4] = np.full((16, 16), np.finfo(np.float64).max), np.full((16, 16, 2), 1e300), 1e300
    clean = rtdenoise.Denoiser("fast")(image, albedo=np.ones_like(image), depth=depth, motion=motion)
    assert np.isfinite(clean).all() and not [w for w in recwarn if w.category is RuntimeWarning]


def test_half_floats_do_not_overflow():
    color = np.full((16, 16, 3), 65504, np.float16)
    with pytest.warns(UserWarning):
        image = rtdenoise.Denoiser("fast")(color, albedo=np.ones_like(color))
    assert np.isfinite(image).all() and image.mean() > 60000


def test_without_torch_the_shaders_run(frames, assert_images_close):
    pipeline, history = Pipeline.load("fast"), None
    for frame, image in zip(frames, play(frames, pictures, backend="glsl"), strict=True):
        wanted, history = pipeline.step(frame.map(torch.Tensor.numpy), history)
        assert_images_close(np.moveaxis(image, 2, 0)[None], wanted, "float32")


@pytest.mark.parametrize("backend", ["torch", "glsl"])
def test_buffers_may_be_reused_and_results_changed(frames, backend):
    plain, denoiser = play(frames, pictures, backend=backend), rtdenoise.Denoiser("fast", backend=backend)
    color, features = pictures(frames[0])
    for frame, wanted in zip(frames, plain, strict=True):
        new, layers = pictures(frame)
        color[:] = new
        for name, array in features.items():
            array[:] = layers[name]
        image = denoiser(color, **features)
        assert np.array_equal(image, wanted)
        image[:] = np.nan
        color[:] = np.nan


def test_reset_starts_a_new_shot(frames):
    denoiser = rtdenoise.Denoiser("fast")
    first, second = pictures(frames[0]), pictures(frames[1])
    start = denoiser(first[0], **first[1])
    assert denoiser.started
    denoiser(second[0], **second[1])
    assert not denoiser.started
    denoiser.reset()
    assert np.array_equal(denoiser(first[0], **first[1]), start) and denoiser.started


def test_a_cut_starts_a_new_shot(frames):
    denoiser, kept = (rtdenoise.Denoiser("fast", detect_cuts=detect) for detect in (True, False))
    other = replace(frames[1], depth=frames[1].depth * 7)
    for frame in (frames[0], other):
        color, features = pictures(frame)
        for each in (denoiser, kept):
            each(color, **features)
    assert denoiser.started and not kept.started


def told(call):
    """The warnings of a call."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in found]


def test_missing_features_are_allowed_and_said_once(frames):
    denoiser = rtdenoise.Denoiser("fast")
    lines = [told(lambda frame=frame: denoiser(pictures(frame)[0])) for frame in frames]
    assert [line.split(":")[1] for line in lines[0]] == [" no albedo", " no normal", " no depth"]
    assert len(lines[1]) == 1 and "no motion: each frame is denoised alone" in lines[1][0]
    assert lines[2:] == [[], []]


def test_a_missing_motion_next_is_said_once_and_the_history_goes_on(frames):
    denoiser, lines = rtdenoise.Denoiser("fast"), []
    for frame in frames:
        color, features = pictures(frame)
        features.pop("motion_next")
        lines += told(lambda color=color, features=features: denoiser(color, **features))
    assert len(lines) == 1 and "approximated from motion and depth" in lines[0] and not denoiser.started


@pytest.mark.parametrize("backend", ["torch", "glsl"])
def test_another_size_starts_anew_said_once(backend):
    denoiser, lines = rtdenoise.Denoiser("fast", backend=backend), []
    for size in ((24, 32), (16, 40), (16, 40), (24, 32)):
        color, features = pictures(make_frames(1, *size)[0])
        lines.append(told(lambda color=color, features=features: denoiser(color, **features)))
        assert len(lines) == 3 or denoiser.started
    assert [len(line) for line in lines] == [0, 1, 0, 0]
    assert lines[1][0].endswith("the frame is [1, 3, 16, 40], the one before was [1, 3, 24, 32]: history starts anew")


BAD = {
    "integers": (
        {"color": np.zeros((8, 8, 3), np.uint8)},
        r"color: expected floats \(linear radiance, .*got uint8",
    ),
    "integer tensors": ({"color": torch.zeros(8, 8, 3, dtype=torch.int32)}, r"expected floats .* got int32"),
    "integer depth": ({"depth": np.ones((8, 8), int)}, r"depth: expected floats \(float16, 32 or 64\), got int64"),
    "no batch": ({"color": np.zeros((3, 8, 8), np.float32)}, r"got \[3, 8, 8\]; add the batch axis: array\[None\]"),
    "alpha": ({"color": np.zeros((8, 8, 4), np.float32)}, r"\[8, 8, 4\]; leave alpha out: array\[..., :3\]"),
    "channels last": ({"color": np.zeros((1, 8, 8, 3), np.float32)}, r"move the channels: .*transpose\(0, 3, 1, 2\)"),
    "grey": ({"color": np.zeros((8, 8), np.float32)}, r"expected \[H, W, 3\] or \[B, 3, H, W\], got \[8, 8\]"),
    "empty": ({"color": np.zeros((0, 8, 3), np.float32)}, r"color: expected .*, got an empty array \[0, 8, 3\]"),
    "motion in three": (
        {"motion": np.zeros((8, 8, 3), np.float32)},
        r"motion: expected \[H, W, 2\].* \[8, 8, 3\]",
    ),
    "another size": ({"normal": np.zeros((8, 9, 3), np.float32)}, r"normal: expected 8×8 as color .*, got 9×8"),
    "a word": ({"color": "frame.exr"}, "color: expected a numpy array or a torch tensor, got str"),
    "nothing": ({"color": None}, "color: expected a numpy array or a torch tensor, got NoneType"),
    "a sparse tensor": ({"color": torch.zeros(8, 8, 3).to_sparse()}, "color: expected a dense .*, got a sparse_"),
    "no values": ({"depth": torch.zeros(8, 8, device="meta")}, "depth: expected a dense tensor .*, got a meta one"),
    "nested": (
        {"normal": torch.nested.nested_tensor([torch.zeros(8, 3)], layout=torch.jagged)},
        "normal: expected a dense .*, got a nested one",
    ),
    "a ragged list": ({"color": [[1.0], [1.0, 2.0]]}, "color: expected a numpy array or a torch tensor, got list"),
}


@pytest.fixture(scope="module")
def denoiser():
    return rtdenoise.Denoiser("fast")


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_answered_in_one_line(denoiser, name):
    arguments, message = BAD[name]
    with pytest.raises(InputError, match=message) as error:
        denoiser(**{"color": np.zeros((8, 8, 3), np.float32)} | arguments)
    assert "\n" not in str(error.value)


def test_shaders_take_one_picture_at_a_time(frames):
    color, features = batches(frames[0].map(lambda t: torch.cat([t, t])))
    with pytest.raises(InputError, match="expected one frame at a time, got 2"):
        rtdenoise.Denoiser("fast", backend="glsl")(color, **features)


def test_the_choices_in_the_docs_are_there():
    text = (Path(__file__).parents[1] / "docs/use/python.md").read_text()
    (line,) = re.findall(r'rtdenoise\.Denoiser\("fast", backend=[^)]*\)', text)
    eval(line)


def test_a_wide_pixel_filter_is_known_to_the_network(assert_images_close):
    frames = [replace(frame, motion=frame.motion + 0.3) for frame in make_frames(2, noise=0.3)]  # lookups off the pixel
    options = {"convert": pictures, "model": "hybrid-many", "precision": "fp32"}
    wide, narrow = (play(frames, more_history=known, **options)[-1] for known in (True, False))
    network, history = models.load("hybrid-many", precision="fp32"), None
    with torch.inference_mode():
        for frame in frames:
            expected, history = network.step(replace(frame, more_history=True), history)
    assert_images_close(np.moveaxis(wide, 2, 0)[None], expected, "float32 network")
    assert not np.allclose(wide, narrow, rtol=1e-3)


def test_step_answers_what_is_no_frame(frames):
    network, pipeline = models.load("fast"), Pipeline.load("fast")
    for wrong in (np.zeros((8, 8, 3), np.float32), torch.zeros(8, 8, 3)):
        with pytest.raises(InputError, match=r"expected radiance \[B, 3, H, W\].*\(8, 8, 3\).*rtdenoise.Denoiser"):
            rtdenoise.Frame(wrong)
        with pytest.raises(InputError, match=r"step takes a rtdenoise.Frame of torch tensors.*rtdenoise.Denoiser"):
            network.step(wrong)
        with pytest.raises(InputError, match=r"step takes a rtdenoise.Frame of numpy arrays.*rtdenoise.Denoiser"):
            pipeline.step(wrong)
    with pytest.raises(InputError, match="got a Frame of ndarray"):
        network.step(frames[0].map(torch.Tensor.numpy))
    for dtype in (torch.float16, torch.float64):
        for frame in (frames[0].to(dtype), replace(frames[0], albedo=frames[0].albedo.to(dtype))):
            with pytest.raises(InputError, match=rf"is {dtype}, step takes torch\.float32.*rtdenoise\.Denoiser"):
                network.step(frame)


def test_help_states_shapes_units_and_errors():
    for name, words in {
        "Denoiser": ("[H, W, C]", "linear", "[0, 1]", "pixels", "InputError"),
        "Frame": ("[B, 3, H, W]", "linear", "pixels", "InputError"),
        "load": ("device", "precision", "InputError"),
        "open_sequence": ("folder", "signal", "float32", "InputError"),
        "screen_motion": ("[H, W, 3]", "pixels", "InputError"),
    }.items():
        public = getattr(rtdenoise, name)
        text = (public.__doc__ or "") + (public.__init__.__doc__ or "") + (public.__call__.__doc__ or "")
        assert not [word for word in words if word not in text], f"{name}: {text}"
    text = models.load("fast").step.__doc__
    assert all(word in text for word in ("[B, 3, H, W]", "history", "InputError"))


def test_frames_are_corrected_by_those_before(frames):
    """A pattern that no feature shows is blurred; from the second frame on its residuals agree."""
    pattern = 0.5 + (torch.arange(24)[:, None] + torch.arange(32)) % 2
    still = torch.zeros_like(frames[0].motion)
    frames = [replace(frames[0], radiance=pattern.expand(1, 3, 24, 32).clone(), motion=still, motion_next=still,
                      albedo=torch.ones_like(frames[0].albedo))] * 4  # fmt: skip
    plain, corrected = play(frames, batches), play(frames, batches, correct=True, samples=16)
    assert torch.equal(plain[0], corrected[0])
    before, after = ((images[3] - pattern).square().mean() for images in (plain, corrected))
    assert after < 0.5 * before
    network, history, images = models.load("fast"), None, []
    with torch.inference_mode():
        for frame in frames:
            known = replace(frame, samples=torch.full_like(frame.depth, 16))
            image, history = models.shrinkage.corrected(network.step)(known, history)
            images.append(image)
    for image, wanted in zip(corrected, images, strict=True):
        torch.testing.assert_close(image, wanted)


def test_the_correction_needs_torch_and_shaders_refuse_it():
    with pytest.raises(InputError, match="PyTorch alone; take the backend torch"):
        rtdenoise.Denoiser("fast", backend="glsl", correct=True)


def test_the_device_of_a_tensor_is_a_device(frames):
    (found,), (wanted,) = (play(frames[:1], batches, device=d) for d in (frames[0].radiance.device, "cpu"))
    assert torch.equal(found, wanted)


@pytest.mark.parametrize(("correct", "samples"), [(False, 4), (True, -1), (True, 10**9), (True, "16"), (True, None),
                                                  (True, 1.5), (True, True)])  # fmt: skip
def test_samples_with_a_model_by_name_go_with_a_correction_and_are_a_number_of_samples(correct, samples):
    with pytest.raises(InputError, match="samples"):
        rtdenoise.Denoiser("fast", correct=correct, samples=samples)


@pytest.mark.parametrize(
    ("options", "name"),
    [({}, "hybrid"), ({"samples": 3}, "hybrid"), ({"samples": 4}, "hybrid-many"), ({"backend": "glsl"}, "default"),
     ({"backend": "glsl", "samples": 8}, "many"), ({"correct": True}, "default"),
     ({"correct": True, "samples": 8}, "many")],
    ids=str,
)  # fmt: skip
def test_who_names_no_model_gets_the_best_picture(frames, options, name):
    by_name = options if "correct" in options else {key: options[key] for key in options.keys() - {"samples"}}
    convert = pictures if "backend" in options else batches
    denoiser, wanted = rtdenoise.Denoiser(**options), play(frames[:2], convert, name, **by_name)
    for (color, features), image in zip(map(convert, frames[:2]), wanted, strict=True):
        assert np.array_equal(denoiser(color, **features), image)


def test_a_pixel_that_is_not_finite_has_samples_too(frames):
    """One that is NaN is corrected as one that is 0, which it becomes."""
    broken, black = ([replace(frame, radiance=frame.radiance.clone()) for frame in frames] for _ in range(2))
    for one, other in zip(broken, black, strict=True):
        one.radiance[..., ::2, ::2], other.radiance[..., ::2, ::2] = torch.nan, 0.0
    for samples in (2, 16):
        found, wanted = (play(shot, batches, correct=True, samples=samples) for shot in (broken, black))
        assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))


@pytest.mark.parametrize("backend", ["torch", "glsl"])
@pytest.mark.parametrize("call", [pickle.dumps, copy.copy, copy.deepcopy])
def test_it_says_that_it_cannot_be_pickled_or_copied(backend, call):
    """A copy would share caches with the first; functions in them cannot be pickled."""
    denoiser = rtdenoise.Denoiser("fast", backend=backend)
    with pytest.raises(TypeError, match=r"neither pickled nor copied.*in each process its own"):
        call(denoiser)
