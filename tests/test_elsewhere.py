"""Recorded steps find kept frames by their addresses (`ops.elsewhere`), and copy them where anything else would read
them. Without a GPU, ops that follow the addresses stand in for those that a CUDA graph holds."""

import ctypes
import itertools
import math
from dataclasses import replace

import pytest
import torch
from synthetic import make_frames
from test_graphed import DEVICES, network, nothing_waits, recorded, tolerance

from rtdenoise import ops
from rtdenoise.frame import RECENT, Known
from rtdenoise.models import AccumulatedKPNConfig, footprint, past
from rtdenoise.models.hybrid_config import HybridConfig
from rtdenoise.ops import dispatch
from rtdenoise.ops.elsewhere import Elsewhere, NotHere, fill, table
from rtdenoise.ops.keep import keep
from rtdenoise.ops.over import over, over_and_coverage
from rtdenoise.ops.recall import recall
from rtdenoise.ops.triton.path import stacked
from rtdenoise.sanitise import sanitise

SMALL = [
    AccumulatedKPNConfig(widths=(4, 4, 4, 4), scales=4, edge_kernel=3, recent=3),
    HybridConfig(widths=(8, 8, 8, 8), scales=4, edge_kernel=3, recent=3, down=(8, 12, 4), up=(12, 8), out=(8, 4)),
]


def elsewhere(frames):
    """What stands for frames, which the caller holds."""
    addresses = table(len(frames), frames[0].device)
    fill(addresses, frames)
    return tuple(Elsewhere(frame, addresses[i, :1]) for i, frame in enumerate(frames))


def followed(kept):
    """The frame that something on the CPU stands for."""
    if not isinstance(kept, Elsewhere):
        return kept
    memory = (ctypes.c_int32 * math.prod(kept.shape)).from_address(kept.address.item())
    return torch.frombuffer(memory, dtype=torch.int32).view(kept.shape)


def following(op):
    """`op` of kept frames wherever they lie."""

    def run(*images):
        return op(*(tuple(map(followed, group)) if isinstance(group, tuple) else group for group in images))

    return run


@pytest.fixture(params=SMALL, ids=lambda config: config.architecture)
def denoiser(request):
    return network(request.param)


@pytest.fixture(params=DEVICES)
def device(request, monkeypatch):
    monkeypatch.setattr("rtdenoise.ops.pixels.within", lambda *_: False)  # `sanitise` writes, as on a GPU
    if request.param == "cpu":
        for user, op in ((past, recall), (footprint, over), (footprint, over_and_coverage)):
            monkeypatch.setattr(user, op.__name__, following(op))
    return request.param


def play(graph, denoiser, device, check, change=lambda history: history, rounds=3):
    """Some rounds of a sequence, each step with a history of its own, which is overwritten after it."""
    for _ in range(rounds):
        history = expected_history = None
        for frame in make_frames(6):
            frame = frame.to(device)
            expected, expected_history = denoiser.step(frame, expected_history)
            given = history and change(history)
            image, history = graph.step(frame, given)
            kept = tuple(frame.clone() for frame in history.recent)
            for tensor in history.recent if given is None else (*given.recent, *history.recent):
                tensor.fill_(-1)
            history = replace(history, recent=kept)
            check(image.cpu(), expected.cpu(), tolerance(device))
            assert [tensor.shape for tensor in kept] == [tensor.shape for tensor in expected_history.recent]
    check(history.mean_albedo.cpu(), expected_history.mean_albedo.cpu(), tolerance(device))


def found_by_address(graph):
    """Of recordings with a history, how many kept frames they find by address, and how many they copy."""
    steps = [r for (_, given), r in graph.recordings.items() if any(RECENT in name for name, *_ in given)]
    return {(len(r.elsewhere), sum(RECENT in name for name in r.read)) for r in steps}


def test_kept_frames_are_not_copied_and_need_not_stay(denoiser, device, assert_images_close):
    graph = recorded(denoiser, device)
    play(graph, denoiser, device, assert_images_close)
    assert found_by_address(graph) == {(1, 0), (2, 0), (3, 0)}
    read = [(name, t) for recording in graph.recordings.values() for name, t in recording.read.items()]
    assert len({id(t) for _, t in read}) == len({(name, t.shape) for name, t in read})  # of each size one for all


def shifted(tensor):
    """A copy that begins 4 bytes after a multiple of 16."""
    return torch.cat([tensor.new_zeros(1), tensor.flatten()])[1:].view(tensor.shape)


def by_pixels(tensor):
    return tensor.clone(memory_format=torch.channels_last)


def apart(tensor):
    return torch.cat([tensor, tensor], dim=3)[..., ::2].copy_(tensor)


@pytest.mark.parametrize("layout", [shifted, by_pixels, apart])
def test_kept_frames_may_lie_in_any_way(denoiser, device, layout, assert_images_close):
    graph = recorded(denoiser, device)
    play(graph, denoiser, device, assert_images_close,
         lambda history: replace(history, recent=tuple(map(layout, history.recent))))  # fmt: skip
    assert found_by_address(graph) == {(1, 0), (2, 0), (3, 0)}


def test_kept_frames_are_passed_on_as_they_are_and_nothing_waits(denoiser, device):
    graph, history = recorded(denoiser, device), None
    frames = [frame.to(device) for frame in make_frames(7)]
    for frame in frames[:5]:
        _, history = graph.step(frame, history)
    for frame in frames[5:]:
        with nothing_waits(device):
            _, after = graph.step(frame, history)
        assert [id(kept) for kept in after.recent[1:]] == [id(kept) for kept in history.recent[:2]]
        history = after
    assert found_by_address(graph) == {(3, 0)}


def test_frames_ahead_are_copied(denoiser, device, assert_images_close):
    graph, history, frames = recorded(denoiser, device), None, [frame.to(device) for frame in make_frames(8)]
    for frame, following in itertools.pairwise(frames):
        known = Known(ahead=(sanitise(following),))
        expected, _ = denoiser.step(frame, history, known)
        image, history = graph.step(frame, history, known)
        assert_images_close(image.cpu(), expected.cpu(), tolerance(device))
    assert found_by_address(graph) == {(3, 0)}
    assert all("ahead0.radiance" in recording.read for recording in graph.recordings.values())


@pytest.mark.parametrize("device", DEVICES)  # on a CPU without ops that follow addresses
@pytest.mark.parametrize("choice", ["plain", "auto"])
def test_what_else_reads_kept_frames_has_them_copied(denoiser, device, choice, assert_images_close):
    graph = recorded(denoiser, device)
    with ops.use(choice):
        play(graph, denoiser, device, assert_images_close)
    by_address = device == "cuda" and choice == "auto"
    assert found_by_address(graph) == {(n, 0) if by_address else (0, n) for n in (1, 2, 3)}


@pytest.mark.parametrize("device", DEVICES)
def test_frames_of_another_network_are_copied(device, assert_images_close):
    """A network without footprints goes on with the history of one with them, whose frames have more channels."""
    denoiser = network(SMALL[0]).to(device)
    graph, (frame, *_) = recorded(denoiser, device), make_frames(1)
    frame = frame.to(device)
    _, history = denoiser.step(frame)
    wider = torch.cat([history.recent[0], history.recent[0][:, :3]], dim=1)
    history = replace(history, recent=(history.recent[0], wider))
    expected, _ = denoiser.step(frame, history)
    for _ in range(3):
        image, _ = graph.step(frame, history)
        assert_images_close(image.cpu(), expected.cpu(), tolerance(device))
    assert found_by_address(graph) == {(0, 2)}


@pytest.mark.parametrize(
    "read",
    [
        lambda kept: kept[:, :5],
        lambda kept: kept.contiguous(),
        lambda kept: kept.data_ptr(),
        lambda kept: kept.to("cpu"),
        lambda kept: kept.is_cuda,
        lambda kept: kept.address.new_zeros(kept.shape, dtype=torch.int32).copy_(kept),
        lambda kept: torch.cat([kept]),
        lambda kept: list(kept),
        lambda kept: kept == 0,
        lambda kept: stacked((kept, torch.zeros(1, 5, 2, 3, dtype=torch.int32))),
        lambda kept: stacked((kept, Elsewhere(torch.zeros(1, 8, 2, 3, dtype=torch.int32), kept.address))),
    ],
)
def test_a_frame_elsewhere_cannot_be_read(read):
    (kept,) = elsewhere((torch.zeros(1, 5, 2, 3, dtype=torch.int32),))
    assert kept.shape == (1, 5, 2, 3) and kept.dtype is torch.int32
    with pytest.raises(NotHere):
        read(kept)


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("B, size, count", [(1, (1, 1), 1), (2, (5, 3), 2), (1, (1, 5), 9)], ids=str)
def test_kernels_find_frames_by_their_addresses(backend, monkeypatch, B, size, count):
    """To the bit what they find by pointers, wherever the frames lie."""
    folder, device = backend
    monkeypatch.setattr(dispatch, "backend", lambda _: (folder, None))

    def frame():
        depth, motion = (3 * torch.rand(B, 1, *size)).ceil(), 0.6 * torch.randn(B, 2, *size)
        return torch.empty(B, 3, *size).exponential_(), depth, torch.rand(B, 3, *size), torch.rand(B, 1, *size), motion

    with ops.use("plain"):
        recent = tuple(shifted(keep(*frame(), torch.rand(B, 3, *size)).to(device)) for _ in range(count))
    light, depth, normal, _, motion = (layer.to(device) for layer in frame())
    uncovered, misplaced = depth > 2, depth.new_ones(1, 1, 1, 1)
    seen = torch.rand(B, 9, *size).to(device)
    with ops.use("fused"):
        of_pointers, of_addresses = (
            [
                *vars(recall(light, motion, (depth, normal), frames, uncovered, misplaced)).values(),
                *over_and_coverage(seen, seen.flip(1), motion, depth, frames),
            ]
            for frames in (recent, elsewhere(recent))
        )
    assert all(torch.equal(a, b) for a, b in zip(of_pointers, of_addresses, strict=True))
    assert max(size) == 1 or of_pointers[1].any()


def test_kernels_get_addresses_alone_and_are_compiled_once():
    frames = tuple(torch.zeros(1, 5, 2, 3, dtype=torch.int32) for _ in range(3))
    pointers, words = stacked(elsewhere(frames))
    assert {pointer.dtype for pointer in pointers} == {torch.int64} and (len(pointers), words) == (8, 5)
    assert [pointer.item() for pointer in pointers[:3]] == [frame.data_ptr() for frame in frames]
    assert len({pointer.data_ptr() % 16 for pointer in pointers}) == 1
