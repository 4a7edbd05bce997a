"""Recorded steps give the outputs of the denoiser, and tensors in a caller's hands do not change.

CUDA graphs are recorded where there is a GPU. Elsewhere a recorder stands in that is as strict: the
tensors of a recording are written only when it is played, and playing one recording spoils those of all others.
"""

import contextlib
import importlib
import inspect
import logging
import math
from dataclasses import astuple, replace
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from synthetic import make_frames, write_sequence
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from rtdenoise import models, ops
from rtdenoise.data.exr import read_channels
from rtdenoise.errors import InputError
from rtdenoise.frame import Frame, Known
from rtdenoise.models import AccumulatedKPNConfig, TemporalKPNConfig
from rtdenoise.models.inference import prepare
from rtdenoise.ops import dispatch
from rtdenoise.run import graphs as graphed
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.graphs import Capture, Graphed
from rtdenoise.run.tiles import step_in_windows
from rtdenoise.sanitise import sanitise

SMALL = [
    TemporalKPNConfig(widths=(4, 4, 4, 4)),
    AccumulatedKPNConfig(widths=(4, 4, 4, 4), scales=4, edge_kernel=3, pick_kernel=3, detail=True),
]
DEVICES = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


class Rehearsal:
    """Records without a GPU: to play is to call the function again and copy its results into the first ones."""

    def __init__(self):
        self.written = []

    def __call__(self, function):
        warm_up, result = function(), function()
        passed_on = {id(tensor) for tensor in self._tensors(warm_up)}  # tensors that the function reads and passes on
        self.written += [tensor for tensor in self._tensors(result) if id(tensor) not in passed_on]
        self.spoil()  # a capture computes nothing

        def replay():
            again = function()
            self.spoil()  # they share their memory
            for target, tensor in zip(self._tensors(result), self._tensors(again), strict=True):
                if target is not tensor:
                    target.copy_(tensor)

        return replay, result

    def spoil(self):
        for tensor in self.written:
            tensor.fill_(math.nan if tensor.is_floating_point() else -1)

    @staticmethod
    def _tensors(result):
        image, history = result
        return [image, *history.layers().values()]


def network(config):
    """A network with random weights, always the same, that runs without gradients."""
    torch.manual_seed(1)
    return models.create(config).eval().requires_grad_(False)


@pytest.fixture(params=SMALL, ids=lambda config: config.architecture)
def denoiser(request):
    return network(request.param)


@pytest.fixture(params=DEVICES)
def device(request, monkeypatch):
    monkeypatch.setattr("rtdenoise.ops.pixels.within", lambda *_: False)  # `sanitise` writes, as on a GPU
    return request.param


def tolerance(device):
    return "exact" if device == "cpu" else "float32 network"


def recorded(denoiser, device):
    return Graphed(denoiser.to(device), Capture(torch.device(device)) if device == "cuda" else Rehearsal())


def clip():
    """Twelve frames in which every kind of step comes several times: a cut, another size, motion_next missing, what is
    known, broken pixels."""
    frames = [*make_frames(9), *make_frames(3, H=17, W=21)]
    frames[3] = replace(frames[3], motion_next=None)
    frames[6] = replace(frames[6], motion_next=None)
    broken = frames[7].radiance.clone()
    broken[..., 4, 5] = math.nan
    frames[7] = replace(frames[7], radiance=broken)
    ahead = {number: (sanitise(frames[number + 1]),) for number in (1, 4)}
    return [
        (frame, number in (0, 5, 9), Known(covered=number in (2, 4), ahead=ahead.get(number, ())))
        for number, frame in enumerate(frames)
    ]


def play(step, device, rounds=3):
    """All images and histories of some rounds of the clip, each with its content at the time."""
    held = []
    for _ in range(rounds):
        history = None
        for frame, cut, known in clip():
            history = None if cut else history
            known = replace(known, first=history is None, ahead=tuple(other.to(device) for other in known.ahead))
            if frame.number % 3 == 0:
                frame, known = sanitise(frame), replace(known, sanitised=True)
            image, history = step(frame.to(device), history, known)
            held += [(tensor, tensor.clone()) for tensor in (image, *history.layers().values())]
    return held


def test_a_recorded_sequence_is_that_of_the_denoiser(denoiser, device, assert_images_close):
    graph = recorded(denoiser, device)
    expected, held = play(denoiser.step, device), play(graph.step, device)
    for (tensor, _), (reference, _) in zip(held, expected, strict=True):
        assert_images_close(tensor.cpu(), reference.cpu(), tolerance(device))
    read = [(name, t) for recording in graph.recordings.values() for name, t in recording.read.items()]
    assert len(graph.recordings) >= 5
    assert len({id(t) for _, t in read}) == len({(name, t.shape) for name, t in read})  # of each size one for all


def test_what_a_caller_holds_stays_as_it_was(denoiser, device):
    held = play(recorded(denoiser, device).step, device)
    assert all(torch.equal(tensor, then) for tensor, then in held)


def test_what_a_caller_passed_in_stays_as_it_was_and_need_not_stay(denoiser, device, assert_images_close):
    graph, frames, owned = recorded(denoiser, device), [f.to(device) for f in make_frames(6)], []
    history = expected_history = None
    for frame in frames:
        expected, expected_history = denoiser.step(frame, expected_history)
        own = frame.map(torch.clone)
        image, history = graph.step(own, history)
        assert all(torch.equal(t, getattr(frame, name)) for name, t in own.layers())
        owned.append(own.map(lambda t: t.fill_(7.0)))
        assert_images_close(image.cpu(), expected.cpu(), tolerance(device))
    assert all((t == 7.0).all() for own in owned for _, t in own.layers())


@contextlib.contextmanager
def nothing_waits(device):
    """For the GPU, where there is one."""
    if device == "cuda":
        torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        if device == "cuda":
            torch.cuda.set_sync_debug_mode("default")


def test_what_is_passed_on_is_not_copied_and_nothing_waits(denoiser, device):
    graph, (frame, *_) = recorded(denoiser, device), make_frames(1)
    frame = frame.to(device)
    for recording in (False, True, False):
        with contextlib.nullcontext() if recording else nothing_waits(device):
            image, history = graph.step(frame, None, Known(sanitised=True))
        assert history.radiance is image and history.depth is frame.depth and history.motion_next is frame.motion_next
    assert len(graph.recordings) == 1


def test_statistics_of_a_whole_frame_are_passed_to_its_windows(denoiser, device, assert_images_close, monkeypatch):
    graph, frame = recorded(denoiser, device), make_frames(1, H=64, W=96)[0].to(device)
    graph.statistics, graph.config = denoiser.statistics, denoiser.config
    cores = [(0, 0, 32, 96), (32, 0, 64, 96)]
    monkeypatch.setattr(type(denoiser.config), "network_reach", 0)  # so that windows are smaller than the frame
    for light in (1.0, 2.0, 0.5, 3.0):
        lit = replace(frame, radiance=frame.radiance * light)
        expected, _ = step_in_windows(denoiser, lit, None, Known(), cores)
        image, _ = step_in_windows(graph, lit, None, Known(), cores)
        assert_images_close(image.cpu(), expected.cpu(), tolerance(device))
    assert len(graph.recordings) == 1


@pytest.mark.parametrize("inference", [(True, False), (False, True)], ids=str)
def test_recordings_can_be_played_in_any_mode_of_autograd(denoiser, device, inference, assert_images_close):
    graph, (frame, *_) = recorded(denoiser, device), make_frames(1)
    first, then = inference
    for _ in range(2):
        with torch.inference_mode(first):
            graph.step(frame.to(device))
    assert graph.recordings
    with torch.inference_mode(then):
        image, _ = graph.step(frame.to(device))
    assert image.is_inference() == then
    assert_images_close(image.cpu(), denoiser.step(frame.to(device))[0].cpu(), tolerance(device))


def test_a_kind_is_recorded_when_it_comes_again_and_the_idle_make_room(denoiser, monkeypatch):
    monkeypatch.setattr(graphed, "MAX_RECORDINGS", 2)
    monkeypatch.setattr(graphed, "IDLE_STEPS", 5)
    graph = Graphed(denoiser, Rehearsal())
    sizes = [make_frames(1, H=8, W=width)[0] for width in (8, 16, 24)]

    def widths():
        return [shape[3] for _, tensors in graph.recordings for name, shape, *_ in tensors if name == "frame.radiance"]

    graph.step(sizes[0])
    assert widths() == []
    for frame in (sizes[0], sizes[1], sizes[1]):
        graph.step(frame)
    assert widths() == [8, 16]
    for _ in range(3):
        graph.step(sizes[2])
    assert widths() == [8, 16]  # both were in use five steps ago
    graph.step(sizes[2])
    assert widths() == [16, 24]


def test_frames_of_another_pixel_filter_are_another_kind(device, assert_images_close):
    small = replace(HYBRID, widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, down=(8, 12, 4), up=(12, 8), out=(8, 4))
    denoiser = network(replace(small, many=True)).to(device)
    frames = [replace(f, motion=f.motion + 0.3).to(device) for f in make_frames(2, noise=0.3)]  # lookups off the pixel
    graph, (_, history) = recorded(denoiser, device), denoiser.step(frames[0])
    for mean in (False, False, True, True):
        frame = replace(frames[1], more_history=mean)
        image, _ = graph.step(frame, history)
        assert_images_close(image.cpu(), denoiser.step(frame, history)[0].cpu(), tolerance(device))
    assert len(graph.recordings) == 2


def test_large_steps_are_not_recorded(denoiser, monkeypatch):
    frame = make_frames(1)[0]
    for largest, count in ((frame.radiance[:, 0].numel(), 1), (frame.radiance[:, 0].numel() - 1, 0)):
        monkeypatch.setattr(graphed, "LARGEST", largest)
        graph = recorded(denoiser, "cpu")
        images = [graph.step(frame)[0] for _ in range(3)]
        assert len(graph.recordings) == count
        assert all(torch.equal(image, denoiser.step(frame)[0]) for image in images)


def test_what_cannot_be_recorded_runs_as_it_would_without(denoiser, caplog):
    def refuse(function):
        raise RuntimeError("operation not permitted when stream is capturing\nat line 5")

    graph, frames, histories = Graphed(denoiser, refuse), make_frames(5), [None, None]
    with caplog.at_level(logging.WARNING, "rtdenoise"):
        for frame in frames:
            image, histories[0] = graph.step(frame, histories[0])
            expected, histories[1] = denoiser.step(frame, histories[1])
            assert torch.equal(image, expected)
    assert [record.getMessage() for record in caplog.records] == [
        "rtdenoise: slower without CUDA graphs: operation not permitted when stream is capturing"
    ]


def test_a_missing_layer_is_named_as_without_recordings(denoiser, caplog):
    graph, (frame, *_) = Graphed(denoiser, Rehearsal()), make_frames(1)
    for _ in range(3):
        with pytest.raises(InputError, match="layer depth is missing"):
            graph.step(replace(frame, depth=None))
    assert not graph.recordings and not caplog.records


def on(device):
    """A stand-in for a denoiser."""
    parameter = SimpleNamespace(device=torch.device(device))
    return SimpleNamespace(parameters=lambda: iter([parameter]), step=f"its own on {device}")


def test_steps_are_recorded_on_cuda_unless_the_environment_turns_it_off(monkeypatch):
    assert isinstance(graphed.stepper(on("cuda:0")).__self__, Graphed)
    assert graphed.stepper(on("cpu")) == "its own on cpu"
    monkeypatch.setenv("RTDENOISE_GRAPHS", "off")
    assert graphed.stepper(on("cuda:0")) == "its own on cuda:0"
    monkeypatch.setenv("RTDENOISE_GRAPHS", "no")
    with pytest.raises(InputError, match="RTDENOISE_GRAPHS: expected auto or off, got 'no'"):
        graphed.stepper(on("cuda:0"))


def test_a_capture_is_made_as_pytorch_documents_it(monkeypatch):
    """Without a GPU, which stream is current, and what is called: warm-up on a side stream, capture in one pool."""
    log, streams = [], ["default"]
    signature = inspect.signature(torch.cuda.graph)

    @contextlib.contextmanager
    def stream(entered):
        streams.append(str(entered))
        yield
        streams.pop()

    class Stream(str):
        def wait_stream(self, other):
            log.append(f"{self} waits for {other}")

    def graph(*arguments, **named):
        bound = signature.bind(*arguments, **named).arguments
        log.append(f"capture in {bound['pool']}")
        return stream("capture")

    monkeypatch.setattr(torch.cuda, "device", lambda device: contextlib.nullcontext(log.append(f"on {device}")))
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device=None: Stream(streams[-1]))
    monkeypatch.setattr(torch.cuda, "Stream", lambda: Stream("side"))
    monkeypatch.setattr(torch.cuda, "stream", stream)
    monkeypatch.setattr(torch.cuda, "graph", graph)
    monkeypatch.setattr(torch.cuda, "CUDAGraph", lambda: SimpleNamespace(replay="replay"))
    monkeypatch.setattr(torch.cuda, "graph_pool_handle", lambda: f"pool made after {len(log)}")
    capture = Capture("cuda:1")
    once = ["on cuda:1", "side waits for default", *["step on side"] * 3, "default waits for side",
            "capture in pool made after 1", "step on capture"]  # fmt: skip
    for _ in range(2):
        assert capture(lambda: log.append(f"step on {streams[-1]}") or "written") == ("replay", "written")
    assert log == once * 2 and streams == ["default"]


@pytest.mark.parametrize("plan", [True, False])
def test_the_backend_records_beneath_the_plan(denoiser, plan, tmp_path, monkeypatch):
    models.save(denoiser, tmp_path / "tiny.safetensors")
    source = write_sequence(tmp_path / "shot", make_frames(8))
    options = Options(model=str(tmp_path / "tiny.safetensors"), device="cpu", precision="fp32", plan=plan)
    denoise(source, tmp_path / "without", options)
    made = []
    monkeypatch.setattr(graphed, "stepper", lambda d: made.append(Graphed(d, Rehearsal())) or made[0].step)
    summary = denoise(source, tmp_path / "with", options)
    assert summary.written == 8 and made[0].recordings
    for file in sorted((tmp_path / "without").glob("*.exr")):
        image, expected = (read_channels(p, ("R", "G", "B")) for p in (tmp_path / "with" / file.name, file))
        assert all((image[channel] == expected[channel]).all() for channel in "RGB")


def test_the_benchmark_times_what_was_recorded(denoiser, monkeypatch):
    latency, (frame, *_) = importlib.import_module("bench.latency.methods"), make_frames(1)
    image, history = denoiser.step(frame)
    expected = denoiser.step(frame, history)[0]
    method = latency.Method("tiny", partial(denoiser.step, frame, history), denoiser, "plain")
    monkeypatch.setattr(latency, "Capture", lambda device: Rehearsal())
    (again,) = latency.recorded(method, expected.double().numpy(), "float32")
    assert (again.name, again.ops, again.model) == ("tiny, graph", "plain", None)
    assert torch.equal(again.step()[0], expected)
    with pytest.raises(SystemExit, match="tiny, graph"):
        latency.recorded(method, image.double().numpy(), "float32")


class Capturable(TorchDispatchMode):
    """Refuse operations that a CUDA graph cannot hold. Meta tensors have no values: operations that read one raise."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        if function in (torch.ops.aten.index.Tensor, torch.ops.aten.index_put_.default):
            raise RuntimeError("indices or masks come from the host, or are counted there")
        result = function(*args, **(kwargs or {}))
        if any(t.device.type == "cpu" for t in tree_leaves((args, kwargs, result)) if isinstance(t, torch.Tensor)):
            raise RuntimeError(f"{function} has a tensor on the host")
        return result


class NothingFromTheHost(TorchFunctionMode):
    """Refuses tensors made of Python's numbers, which are copied to the device."""

    MAKERS = (torch.tensor, torch.as_tensor, torch.from_numpy, torch.Tensor.new_tensor)

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function in self.MAKERS:
            raise RuntimeError(f"{function} copies from the host")
        return function(*args, **(kwargs or {}))


@contextlib.contextmanager
def capturable():
    with torch.no_grad(), NothingFromTheHost(), Capturable():
        yield


def meta(*shape):
    return torch.empty(1, *shape, device="meta")


def every_kind_of_step(denoiser, H=37, W=50):
    """A step of each kind, on tensors without values."""
    layers = {"albedo": 3, "normal": 3, "depth": 1, "motion": 2, "motion_next": 2, "components": 6}
    frame = Frame(meta(3, H, W), **{layer: meta(channels, H, W) for layer, channels in layers.items()})
    window = Known(sanitised=True, exposure=meta(1, 1, 1), distance=meta(1, 1, 1))
    for known in (Known(), Known(first=True), replace(window, first=True)):
        _, history = denoiser.step(frame, None, known)
    for known in (Known(), window, Known(covered=True), Known(covered=True, still=True)):
        denoiser.step(frame, history, known)
    _, later = denoiser.step(frame, replace(history, motion_next=None))
    denoiser.step(frame, later)
    if history.recent:
        denoiser.step(frame, None, Known(ahead=(frame,)))
        denoiser.step(frame, history, Known(ahead=(frame, frame)))


def _branches(config):
    """What a configuration says but for its numbers: models that differ in these alone take the same steps."""
    return type(config), *(value if isinstance(value, bool | str) else bool(value) for value in astuple(config))


# A model of each kind: "hybrid" stands for "hybrid-fast", "mltd" for "mltd-small".
KINDS = {_branches(models.PRESETS[name]): name for name in sorted(models.PRESETS, reverse=True)}
FEWER = {"kernel": 3, "temporal_kernel": 3, "blocks": (1,) * 8}  # the plain ops take a step for each tap


@pytest.mark.parametrize("name", KINDS.values())
def test_no_step_waits_for_the_gpu_or_copies_from_the_host(name):
    """Of any kind of model, made ready. No fused op exists for meta tensors: the plain ones run."""
    preset = models.PRESETS[name]
    config = replace(preset, **{key: value for key, value in FEWER.items() if getattr(preset, key, 0)})
    assert _branches(config) == _branches(preset)
    model = prepare(models.create(config).eval().requires_grad_(False), torch.bfloat16).to("meta")
    with capturable():
        every_kind_of_step(model)


HYBRID = models.PRESETS["hybrid"]


@pytest.mark.parametrize("config", [*SMALL, HYBRID, replace(HYBRID, many=True)], ids=lambda c: c.architecture)
def test_no_fused_op_waits_for_the_gpu_or_copies_from_the_host(config, monkeypatch):
    """The Python around Triton's kernels, which are not launched. Of features, whose layout tensors without values do
    not keep, none is called."""
    launched = set()
    kernels = {
        "apply_kernel": "_forward", "compose": "_compose", "downsample": "_downsample", "fetch": "_fetch",
        "reproject": "_reproject", "soften": "_soften", "warp": "_warp", "recall": "_compare _sum",
        "over": "_over", "keep": "_keep", "history_motion": "_history_motion", "around": "_bounds _within",
        "mix": "_told _mix", "off_pixel": "_off_pixel", "unchanged": "_stays", "shares": "_shares",
        "pixels": "_demodulate _modulate _accumulate _joined _nearness", "features": "_features",
        "blend_history": "_blend_history", "evened": "_greatest _evened _tells", "compressed": "_compressed",
        "displacement_sums": "_sums _solve", "light_shift": "_blocks _near _beside _shift _surfaces",
        "picture": "_counts _moved", "even_sky": "_blocks _even_sky", "dim": "_dim",
        "fireflies": "_without_fireflies",
        "block_luminance": "_block_luminance", "window_noise": "_window_noise", "mean_distance": "_mean _sums",
        "replace_invalid": "_replace", "ranks": "_kth_greatest _exposure_of _median",
        "lift": "_lift _lower", "turned": "_turns _gives_way", "agrees": "_compare _spread",
        "relit": "_sum_cells _sum_quarters _brighter _gain _relit",
    }  # fmt: skip

    class Kernel:
        def __init__(self, name):
            self.name = name

        def __getitem__(self, grid):
            return lambda *arguments, **named: launched.add(self.name)

    for file, names in kernels.items():
        for name in names.split():
            monkeypatch.setattr(importlib.import_module(f"rtdenoise.ops.triton.{file}"), name, Kernel(f"{file}.{name}"))
    monkeypatch.setattr(dispatch, "backend", lambda _: ("triton", None))
    model = prepare(models.create(config).eval().requires_grad_(False), torch.bfloat16).to("meta")
    with capturable(), ops.use("auto"):
        every_kind_of_step(model)
    every = {f"{file}.{name}" for file, names in kernels.items() for name in names.split()}
    of_few, of_many = {"over", "evened._evened", "fireflies"}, {"off_pixel"}
    if config.recent:
        left_out = {"agrees"} | (of_few if config.many else of_many)
    else:
        left_out = {"recall", "keep", "around", "mix", "evened", "pixels._joined", "lift"} | of_few | of_many
        left_out |= {"window_noise", "ranks._median"}
    if not isinstance(model, models.AccumulatedKPN):
        left_out |= {"reproject", "soften", "shares", "features", "blend_history", "compressed", "displacement_sums"}
        left_out |= {"light_shift", "picture", "turned", "agrees", "unchanged", "relit"}
        left_out |= {"pixels._demodulate", "pixels._modulate", "pixels._accumulate"}
    assert launched == {name for name in every if not {name, name.partition(".")[0]} & left_out}


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x.sum().item(),
        lambda x: bool((x > 0).all()),
        lambda x: x.tolist(),
        lambda x: x.cpu(),
        lambda x: x.nonzero(),
        lambda x: x[x > 0],
        lambda x: x[:, [0, 1]],
        lambda x: x.masked_select(x > 0),
        lambda x: x.new_tensor([1.0, 2.0]),
        lambda x: torch.tensor([1.0], device=x.device),
        lambda x: x * torch.ones(3, 8, 8),
    ],
)
def test_what_cannot_be_captured_would_be_found(wait):
    with pytest.raises((RuntimeError, NotImplementedError)), capturable():
        wait(meta(3, 8, 8))
