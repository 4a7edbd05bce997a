"""A network made ready to run against the network as it was trained; memory kept, and the message when it runs out."""

import copy
import ctypes
import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from synthetic import make_frames

from rtdenoise.errors import InputError
from rtdenoise.models import available, load, read
from rtdenoise.models.fused_layers import FusedConvRelu, FusedUp, JoinedHeads, Product
from rtdenoise.models.inference import as_weights, prepare, resolve
from rtdenoise.models.unet import HeadsByCells, UNet, widened, widened_in_layout
from rtdenoise.run import memory

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("name", available())
@pytest.mark.parametrize("precision, row", [("fp32", "float32 network"), ("bf16", "bfloat16 network")])
def test_a_sequence_comes_out_as_from_the_network_that_was_trained(assert_images_close, name, precision, row):
    trained, ready, histories = read(name), load(name, precision=precision), [None, None]
    for frame in make_frames(4, H=37, W=50):
        with torch.inference_mode():
            (a, histories[0]), (b, histories[1]) = trained.step(frame, histories[0]), ready.step(frame, histories[1])
        assert_images_close(b, a, row)
    assert b.dtype == torch.float32


def test_a_ready_network_is_channels_last_with_its_relus_fused():
    for precision, dtype in (("fp32", torch.float32), ("bf16", torch.bfloat16)):
        model = load("paper", precision=precision)
        features = as_weights(torch.rand(1, 13, 32, 32), model)
        assert features.dtype == dtype and features.is_contiguous(memory_format=torch.channels_last)
        if precision == "fp32" or torch.ops.mkldnn._is_mkldnn_bf16_supported():
            assert not any(isinstance(module, torch.nn.ReLU) for module in model.unet.modules())
        assert model.state_dict().keys() == read("paper").state_dict().keys()


def test_a_cpu_without_bfloat16_computes_in_it_all_the_same(assert_images_close, monkeypatch):
    monkeypatch.setattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", lambda: False)
    trained, ready, frame = read("paper"), load("paper", precision="bf16"), make_frames(1, H=16, W=24)[0]
    assert any(isinstance(module, torch.nn.ReLU) for module in ready.unet.modules())
    with torch.inference_mode():
        assert_images_close(ready.step(frame)[0], trained.step(frame)[0], "bfloat16 network")


@pytest.mark.parametrize("size, lanes", [((1, 1), False), ((13, 22), False), ((32, 16), False), ((32, 16), True)])
def test_a_decoder_that_enlarges_nothing_is_the_one_that_was_trained(assert_images_close, size, lanes):
    """Also with `lanes` as `prepare` fills them on CUDA, of a network that is moved to a CPU then."""
    torch.manual_seed(0)
    trained, x = UNet(5, (4, 12, 20)).eval().requires_grad_(False), torch.randn(2, 5, *size)
    ready = prepare(copy.deepcopy(trained), torch.float32)
    for module in ready.modules():
        if lanes and isinstance(module, FusedConvRelu | FusedUp):
            module.fill_lanes()
    assert trained.state_dict().keys() == ready.state_dict().keys()
    for a, b in zip(trained(x, 2), ready(as_weights(x, ready), 2), strict=True):
        assert_images_close(b, a, "float32")


@pytest.mark.parametrize("layout", [torch.channels_last, torch.contiguous_format], ids=str)
@pytest.mark.parametrize(("down", "right"), [(3, 0), (0, 2), (5, 1)])
def test_a_picture_is_widened_in_its_layout(layout, down, right):
    x = torch.rand(2, 3, 4, 5).to(memory_format=layout)
    found = widened_in_layout(x, down, right)
    assert torch.equal(found, widened(x, down, right)) and found.is_contiguous(memory_format=layout)


def test_products_of_matrices_are_the_convolutions_of_heads(assert_images_close):
    """What `prepare` makes of 1×1 convolutions on CUDA: the same numbers, from matrices that tensor cores can read."""
    heads, x = HeadsByCells(5, [25, 9, 3]), torch.randn(2, 5, 4, 6)
    head, query = torch.nn.Conv2d(5, 27, 1), torch.nn.Conv2d(5, 12, 1, bias=False)
    expected = [*heads(x), head(x), query(x)]
    JoinedHeads.take(heads), Product.take(head), Product.take(query)
    for found, wanted in zip([*heads(x), head(x), query(x)], expected, strict=True):
        assert_images_close(found.detach(), wanted.detach(), "float32")
    assert heads.matrix.shape == (104 + 40 + 16, 5) and head.matrix.shape == (32, 5)


def test_an_unknown_precision_is_named():
    with pytest.raises(InputError, match="'half'; expected one of auto, fp32, bf16"):
        load("paper", precision="half")
    assert torch.float32 == resolve("fp32", "cpu") and resolve("auto", "cpu") in (torch.float32, torch.bfloat16)


def test_lack_of_memory_says_how_much_was_missing():
    with pytest.raises(InputError, match=r"f\.exr: out of memory on cpu at 7×5: 1073741824 MiB more .*tiles\.Tiled"):  # noqa: SIM117
        with memory.explained("f.exr", (5, 7), "cpu"):
            torch.empty(2**50, dtype=torch.uint8)
    with pytest.raises(RuntimeError, match="shapes"), memory.explained("f.exr", (5, 7), "cpu"):  # all else as it was
        torch.rand(2, 3) @ torch.rand(2, 3)


def test_freed_memory_is_kept_where_the_c_library_is_glibc():
    """In a process of its own: a tensor made again costs no page faults, which without it are one every 4 KiB."""
    code = """
import resource, sys, torch
import rtdenoise.models.loading  # as in a program that denoises: what else lies in the heap decides too
from rtdenoise.run.memory import keep_freed
told = keep_freed()
faults = []
for _ in range(8):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(64 * 2**20, dtype=torch.uint8)
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(told, min(faults[1:]))
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    told, faults = result.stdout.split()
    assert told == str(hasattr(ctypes.CDLL(None), "mallopt"))
    assert told == "False" or int(faults) < 1000


def test_the_latency_benchmark_runs(tmp_path):
    out = tmp_path / "l.json"
    command = [sys.executable, "bench/latency_720p.py", "--quick", "--presets", "paper", "fast", "--out", out]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    document = json.loads(out.read_text())
    methods = [row["method"] for row in document["rows"]]
    ours = ["paper eager", "paper fused fp32", "paper fused bf16"]
    ours += ["fast eager", "fast fused fp32", "fast fused bf16", "fast fused int8"]
    assert methods[: len(ours)] == ours and "oidn high" in methods
    for row in document["rows"][: len(ours)]:
        parts = sum(stage["median_ms"] for stage in row["stages"].values())
        assert parts > 0 and row["prediction_gflop"] > 0 and row["peak_mb"] > 0
        assert row["gb"]["kernel application"] > 0
    assert (tmp_path / "l.png").stat().st_size > 0 and "| paper eager |" in (tmp_path / "l.md").read_text()
