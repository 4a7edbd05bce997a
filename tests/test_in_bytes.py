"""Networks in bytes (`models.in_bytes`, `tools/weights_in_bytes.py`)."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from scripts import imported
from synthetic import make_frames
from torch.nn import functional as F

from rtdenoise import ops
from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError, NotCompiled
from rtdenoise.evaluate.demo import SAMPLE
from rtdenoise.metrics import psnr
from rtdenoise.models import AccumulatedKPNConfig, HybridConfig, create, load, read, save
from rtdenoise.models.bytes_layout import made_for, shapes
from rtdenoise.models.in_bytes import Convolution, PixelNetworkInBytes, ToBytes, UNetInBytes, phases, rounded
from rtdenoise.models.pixel_network import PixelNetwork, as_color
from rtdenoise.models.presets import PRESETS, STILLS
from rtdenoise.models.weights import bytes_of, find
from rtdenoise.ops.convolve_bytes import convolve_bytes, multiplies_bytes, packed, unpacked
from rtdenoise.ops.feature_bytes import CHANNELS, feature_bytes
from rtdenoise.ops.to_bytes import to_bytes

SMALL = HybridConfig(
    widths=(8, 8, 8, 8), scales=4, edge_kernel=3, detail=True, recent=3, down=(16, 12, 20), up=(12, 8), out=(16, 4)
)
TOOL = Path(__file__).parent.parent / "tools" / "weights_in_bytes.py"


@pytest.fixture(scope="module")
def tool():
    module = imported(TOOL)
    module.FRAMES = 2  # with history and without
    return module


@pytest.fixture(scope="module")
def small(tool, tmp_path_factory):
    """A file of random weights, and that of the same in bytes, made from the bundled sequence."""
    return made(SMALL, tool, tmp_path_factory)


@pytest.fixture(scope="module")
def clean(tool, tmp_path_factory):
    """As `small`, with networks that filter albedo and normal."""
    return made(replace(SMALL, clean=True), tool, tmp_path_factory)


def made(config, tool, tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("small") / "small.safetensors"
    save(create(config), path)
    tool.main(str(path), str(bytes_of(path)), str(SAMPLE))
    return path


def inputs(H=48, W=80):
    torch.manual_seed(1)
    radiance, albedo, normal = torch.rand(3, 1, 3, H, W).unbind()
    smooth = F.avg_pool2d(radiance, 9, stride=1, padding=4)
    return 100 * smooth, albedo, F.normalize(2 * normal - 1, dim=1)


# --- operations -------------------------------------------------------------------------------------------------------


def test_packed_weights_unpack():
    parts = [torch.randint(-127, 128, shape, dtype=torch.int8) for shape in ((40, 8, 2, 2), (40, 12, 3, 3))]
    weights = packed(parts)
    assert weights.shape == (8 + 27, 64, 4) and not weights[:, 40:].any()
    for part, expected in zip(unpacked(weights, (8, 12), (2, 3), 40), parts, strict=True):
        assert torch.equal(part, expected)


def test_it_is_a_convolution_and_relu():
    x, weight = torch.randint(0, 256, (1, 8, 5, 7), dtype=torch.uint8), torch.randint(-9, 10, (6, 8, 3, 3))
    y = convolve_bytes(x, packed([weight.to(torch.int8)])[None], torch.full((1, 6), 0.01), torch.full((1, 6), -2.0))
    expected = F.conv2d(x.double(), weight.double(), padding=1) * 0.01 - 2
    assert (y - expected.clamp(0, 255)).abs().max() <= 0.5001


def test_phases_enlarge_and_join():
    """Weights, split into those of phases, convolve the enlarged picture."""
    weight = torch.randint(-5, 6, (6, 12, 3, 3)).double()
    below, x = (
        torch.randint(0, 256, (1, 8, 3, 4), dtype=torch.uint8),
        torch.randint(0, 256, (1, 4, 6, 8), dtype=torch.uint8),
    )
    weights = [packed([part.to(torch.int8) for part in parts]) for parts in phases(weight, (8, 4))]
    y = convolve_bytes(x, torch.stack(weights), torch.full((4, 6), 0.01), torch.zeros(4, 6), below)
    joined = torch.cat([F.interpolate(below.double(), scale_factor=2, mode="nearest"), x.double()], dim=1)
    expected = F.conv2d(joined, weight, padding=1) * 0.01
    assert (y - expected.clamp(0, 255)).abs().max() <= 0.5001


def test_weights_need_not_lie_together():
    x = torch.randint(0, 256, (1, 4, 6, 8), dtype=torch.uint8).contiguous(memory_format=torch.channels_last)
    weight = packed([torch.randint(-9, 10, (6, 4, 3, 3), dtype=torch.int8)])[None]
    apart = torch.stack([weight, weight], dim=-1)[..., 0]
    factor, bias = torch.full((1, 1), 0.01).expand(1, 6), torch.zeros(1, 6)
    expected = convolve_bytes(x, weight, factor.contiguous(), bias)
    assert not apart.is_contiguous() and torch.equal(convolve_bytes(x, apart, factor, bias), expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": (1, 6, 6, 8)}, r"expected x \[B, C, H, W\], C a multiple of 4, got \(1, 6, 6, 8\)"),
        ({"below": (1, 8, 3, 3)}, r"expected below \[1, C, 6 / 2, 8 / 2\]"),
        ({"x": (1, 4, 7, 8)}, r"expected below \[1, C, 7 / 2, 8 / 2\]"),
        ({"below": None}, r"expected factor and bias \[1, O\]"),
        ({"bias": (4, 5)}, r"got \(4, 6\) and \(4, 5\)"),
        ({"x": (1, 8, 6, 8)}, r"expected weight \(4, 26, 32, 4\), got \(4, 17, 32, 4\)"),
        ({"weight": (4, 17, 4, 4)}, r"expected weight \(4, 17, 32, 4\)"),
        ({"factor": (4, 33), "bias": (4, 33)}, r"expected weight \(4, 17, 64, 4\)"),
        ({"dtype": torch.float32}, "expected a result of uint8 or bfloat16"),
    ],
)
def test_bytes_that_do_not_fit_are_refused(change, message):
    """Compiled code would read beyond them."""
    shapes = {"x": (1, 4, 6, 8), "weight": (4, 17, 32, 4), "factor": (4, 6), "bias": (4, 6), "below": (1, 8, 3, 4)}
    types = {"weight": torch.int8, "factor": torch.float32, "bias": torch.float32}

    def call(**options):
        tensors = {
            name: value if value is None or name == "dtype" else torch.zeros(value, dtype=types.get(name, torch.uint8))
            for name, value in {**shapes, **options}.items()
        }
        return convolve_bytes(**tensors)

    assert call().shape == (1, 6, 6, 8)
    with pytest.raises(ValueError, match=message):
        call(**change)


def test_steps_need_not_be_one_for_each_channel():
    """Compiled code reads as many as there are channels, of the type of x."""
    x = torch.rand(1, 24, 4, 6).contiguous(memory_format=torch.channels_last)
    expected = to_bytes(x, torch.full((24, 1, 1), 100.0))
    for scale in (torch.full((1, 1, 1), 100.0), torch.full((24, 1, 6), 100.0)):
        assert torch.equal(to_bytes(x, scale), expected)


def test_features_have_their_channels():
    light, albedo, normal = inputs(4, 6)
    light[..., 0, 0] = 1e9
    x = feature_bytes(light, albedo, normal).double()
    assert x.shape == (1, CHANNELS, 4, 6) and (x[:, :6, 0, 0] == 255).all()
    compressed = (1 + light).log().clamp(max=510 / 40)
    torch.testing.assert_close((x[:, :3] + x[:, 3:6]) / 40, compressed.double(), rtol=0, atol=0.51 / 40)
    surfaces = torch.cat([albedo, as_color(normal)], dim=1).double()
    torch.testing.assert_close(x[:, 6:] / 255, surfaces, rtol=0, atol=0.51 / 255)


# --- weights ----------------------------------------------------------------------------------------------------------


def test_rounding_makes_up_for_its_errors(tool):
    """What a layer makes of inputs that are alike is ten times closer than with weights that are rounded alone."""
    torch.manual_seed(0)
    inputs = 40 + 20 * torch.randn(4000, 30) @ torch.randn(30, 90) / 5  # 90 numbers that 30 make
    weight, bias = torch.randn(8, 90).double(), torch.randn(8).double()
    weight[:, :5] *= 20
    x = torch.cat([inputs, torch.ones(4000, 1)], dim=1).double()
    whole, factor, new_bias = tool.rounded_with_care(weight, bias, x.T @ x)
    assert whole.dtype == torch.int8 and whole.abs().max() <= 127
    expected = x[:, :-1] @ weight.T + bias
    careful = x[:, :-1] @ (whole * factor[:, None]).T + new_bias
    unit = weight.abs().amax(1, keepdim=True) / 127
    plain = x[:, :-1] @ ((weight / unit).round() * unit).T + bias
    assert (careful - expected).square().mean() < 0.1 * (plain - expected).square().mean()


def test_rounded_layers_keep_their_steps():
    """A layer of bytes with steps gives what the layer gives of their numbers, in steps of its own."""
    torch.manual_seed(0)
    layer, steps, made = torch.nn.Conv2d(12, 6, 3, padding=1), (torch.rand(8) + 0.1, torch.rand(4) + 0.1), torch.rand(6)
    made = made + 1
    below, x = (
        torch.randint(0, 256, (1, 8, 5, 4), dtype=torch.uint8),
        torch.randint(0, 256, (1, 4, 10, 8), dtype=torch.uint8),
    )
    y = convolve_bytes(x, **rounded(layer, steps, made), below=below)
    numbers = [picture * step.view(-1, 1, 1) for picture, step in zip((below, x), steps, strict=True)]
    joined = torch.cat([F.interpolate(numbers[0], scale_factor=2, mode="nearest"), numbers[1]], dim=1)
    expected = (layer(joined) / made.view(-1, 1, 1)).clamp(0, 255)
    assert (y - expected).abs().max() < 2 and (expected > 50).any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_numbers_become_bytes(dtype):
    step = torch.tensor([0.5, 0.01])
    x = torch.tensor([[0.0, 0.24, 1.0, 1e9], [0.0, 0.024, 1.0, 2.5]]).view(1, 2, 2, 2).to(dtype)
    assert ToBytes(step)(x).flatten(2).tolist() == [[[0, 0, 2, 255], [0, 2, 100, 250]]]
    whole = torch.arange(256).view(1, 1, 16, 16)
    assert torch.equal(ToBytes(torch.ones(1))(whole.to(dtype)), whole.to(torch.uint8))


@pytest.mark.parametrize("size", [(1, 1), (7, 13), (48, 80)], ids=str)
@pytest.mark.parametrize("model", ["small", "clean"])
def test_a_small_network_in_bytes_is_close(request, model, size):
    small, images = request.getfixturevalue(model), []
    with torch.inference_mode():
        for precision in ("fp32", "int8"):
            model, history = load(small, precision=precision), None
            for frame in make_frames(3, *size):
                image, history = model.step(frame, history)
            images.append(image)
    expected, image = images
    assert image.isfinite().all() and image.shape == (1, 3, *size)
    assert (image - expected).abs().mean() < 0.02 * expected.mean()


@pytest.mark.parametrize("name", ["default", "fast", "many", "hybrid", "hybrid-fast", "hybrid-large"])
def test_what_ships_keeps_the_picture(name):
    """0.1 dB of error at most on the bundled sequence, and 40 dB from the picture in float32."""
    frames = list(open_sequence(SAMPLE, signal="indirect", layers=("reference", "reference_half")))[:4]
    scale, errors, images = display_exposure(frames[-1].reference), {}, {}
    with torch.inference_mode():
        for precision in ("fp32", "int8"):
            model, history = load(name, precision=precision), None
            for frame in frames:
                images[precision], history = model.step(frame, history)
            errors[precision] = psnr(images[precision], frames[-1].reference, scale)
    assert errors["int8"] > errors["fp32"] - 0.1
    assert psnr(images["int8"], images["fp32"], scale) > 40


@pytest.mark.parametrize("name", ["default", "hybrid"])
def test_even_light_stays_even_and_extreme_light_finite(name):
    model = load(name, precision="int8")
    (frame,) = make_frames(1, H=40, W=70)
    with torch.inference_mode():
        for light in (0.0, 0.3, 3e4):
            given = frame.radiance * 0 + light
            image, _ = model.step(
                frame.__class__(**(vars(frame) | {"radiance": given, "albedo": frame.albedo * 0 + 0.6}))
            )
            torch.testing.assert_close(image, given, rtol=1e-5, atol=0)
        frame.radiance[0, :, 3, 4] = 6e4
        assert model.step(frame)[0].isfinite().all()


# --- bad input --------------------------------------------------------------------------------------------------------


def test_models_without_such_weights_are_named(tmp_path):
    with pytest.raises(InputError, match="networks of the form temporal_kpn have no weights in bytes"):
        load("paper", precision="int8")
    path = tmp_path / "mine.safetensors"
    for config in (STILLS["afgsa-small"], PRESETS["mltd-small"]):
        save(create(config), path)
        with pytest.raises(InputError, match=f"networks of the form {config.architecture} have no weights in bytes"):
            load(path, precision="int8")
    save(read("hybrid-fast"), path)
    with pytest.raises(InputError, match="there is no mine"):
        load(path, precision="int8")


def test_a_copy_without_the_bytes_of_its_pixels_has_its_kernels_in_bytes(monkeypatch, tmp_path):
    """Its part `default` has some; those of the pixels stayed behind."""
    monkeypatch.setattr("rtdenoise.models.loading.takes_bytes", lambda precision, _: precision in ("auto", "int8"))
    path = shutil.copy(find("hybrid"), tmp_path / "mine.safetensors")
    for precision in ("auto", "int8"):
        model = load(path, precision=precision)
        assert isinstance(model.unet, UNetInBytes) and type(model.pixels) is PixelNetwork
    shutil.copy(bytes_of(find("hybrid")), bytes_of(path))
    assert isinstance(load(path).pixels, PixelNetworkInBytes)


def test_kernels_of_ones_own_with_the_pixels_of_a_model_that_ships_have_no_bytes(monkeypatch, tmp_path):
    monkeypatch.setattr("rtdenoise.models.loading.takes_bytes", lambda precision, _: precision in ("auto", "int8"))
    hybrid, path = read("hybrid"), tmp_path / "mine.safetensors"
    kernels = {name: x.contiguous() for name, x in hybrid.state_dict().items() if not name.startswith("pixels.")}
    described = {"config": json.dumps(asdict(hybrid.config)), "parts": '{"pixels": "hybrid"}'}
    save_file(kernels, path, {"architecture": "hybrid"} | described)
    assert not isinstance(load(path).unet, UNetInBytes)
    with pytest.raises(InputError, match="there is no mine"):
        load(path, precision="int8")


@pytest.mark.parametrize("width", [10, 260])
def test_widths_come_in_fours_and_have_a_bound(tool, tmp_path, width):
    path = tmp_path / "odd.safetensors"
    save(create(AccumulatedKPNConfig(widths=(8, width, 8), scales=3)), path)
    with pytest.raises(InputError, match=rf"multiples of 4 up to 256; unet.encoder.1.2 reads {width}"):
        tool.main(str(path), str(bytes_of(path)), str(SAMPLE))


def test_filters_of_albedo_and_normal_in_bytes_are_close(clean):
    _, albedo, normal = inputs()
    with torch.inference_mode():
        plain, in_bytes = (load(clean, precision=p).pixels.clean(albedo, normal) for p in ("fp32", "int8"))
    for expected, found in zip(plain, in_bytes, strict=True):
        assert (found - expected).abs().mean() < 0.02 * expected.std()


def test_weights_are_kept_where_rounding_them_would_be_seen(clean):
    """Of the network of light at full and half size; others are rounded as they are loaded, from steps."""
    stored = load_file(bytes_of(clean))
    assert {name: tuple(x.shape) for name, x in stored.items()} == shapes(replace(SMALL, clean=True))
    kept = {name.removesuffix(".weight") for name in stored if name.endswith(".weight")}
    light = ("encoder.0", "encoder.1", "encoder.2", "decoder.0.0", "decoder.0.2", "decoder.1.0", "decoder.1.2")
    assert kept == {f"pixels.{name}" for name in light}


def test_damaged_files_are_named(small, tmp_path):
    config, good = SMALL, load_file(bytes_of(small))
    assert {name: tuple(x.shape) for name, x in good.items()} == shapes(config)
    path = tmp_path / "small.safetensors"
    save(read(small), path)
    for change, told in (
        ({"pixels.encoder.1.bias": None}, "pixels.encoder.1.bias is missing"),
        ({"pixels.encoder.1.bias": good["pixels.encoder.1.bias"][:, :3]}, "expected finite float32"),
        ({"pixels.encoder.1.factor": good["pixels.encoder.1.factor"] * torch.nan}, "expected finite float32"),
        ({"pixels.encoder.1.weight": good["pixels.encoder.1.weight"].float()}, "expected finite int8"),
        ({"unet.encoder.1.0.step": good["unet.encoder.1.0.step"][:3]}, "expected finite float32"),
        ({"other": torch.zeros(1)}, "other is"),
    ):
        tensors = {name: x.contiguous() for name, x in (good | change).items() if x is not None}
        save_file(tensors, bytes_of(path), made_for(path))
        with pytest.raises(InputError, match=told):
            load(path, precision="int8")
    bytes_of(path).write_bytes(b"not weights")
    with pytest.raises(InputError, match="not a readable safetensors file"):
        load(path, precision="int8")


def test_files_made_for_other_weights_are_named(small, tmp_path, monkeypatch, caplog):
    """As after training on; `auto` goes on without them."""
    trained = read(small)
    trained.stem.bias += 0.1
    path = tmp_path / "small.safetensors"
    save(trained, path)
    shutil.copy(bytes_of(small), bytes_of(path))
    told = "small.int8: was made for other weights than small.safetensors has; make it anew"
    with pytest.raises(InputError, match=told):
        load(path, precision="int8")
    monkeypatch.setattr("rtdenoise.models.loading.takes_bytes", lambda *_: True)
    assert not isinstance(load(path).unet, UNetInBytes) and told in caplog.text
    assert isinstance(load(small).unet, UNetInBytes)


def test_another_device_has_all_tensors_of_the_same_type(small):
    """`prepare` changes those of the rest, in type and layout."""
    network = load(small, precision="int8")
    layers = [module for module in network.modules() if isinstance(module, Convolution)]
    for change in ({"dtype": torch.float64}, {"memory_format": torch.channels_last}, {"device": "meta"}):
        network.to(**change)
        for layer in layers:
            assert (layer.weight.dtype, layer.factor.dtype) == (torch.int8, torch.float32)
            assert layer.weight.is_contiguous()
    held = [x for module in network.modules() for x in vars(module).values() if isinstance(x, torch.Tensor)]
    assert layers and not held and all(tensor.is_meta for tensor in (*network.parameters(), *network.buffers()))


def test_gpus_have_none():
    with pytest.raises(InputError, match="int8 is for the CPU"):
        load("hybrid", device="cuda", precision="int8")


@pytest.mark.parametrize(
    ("multiplies", "choice", "expected"), [(True, "auto", True), (False, "auto", False), (True, "plain", False)]
)
def test_auto_takes_bytes_where_a_cpu_multiplies_them(monkeypatch, tmp_path, multiplies, choice, expected):
    monkeypatch.setattr("rtdenoise.ops.native.convolve_bytes.multiplies", lambda: multiplies)
    save(read("fast"), tmp_path / "mine.safetensors")
    with ops.use(choice):
        assert isinstance(load("fast").unet, UNetInBytes) == expected
        for name, many in (("hybrid", False), ("hybrid-many", True)):  # whose steps of light would show
            model = load(name)
            assert isinstance(model.unet, UNetInBytes) == expected
            assert isinstance(model.pixels, PixelNetworkInBytes) == (expected and not many)
        assert not any(isinstance(load(name).unet, UNetInBytes) for name in ("paper", tmp_path / "mine.safetensors"))
        assert not isinstance(load("fast", precision="fp32").unet, UNetInBytes)


def test_without_a_compiler_no_cpu_multiplies_bytes(monkeypatch):
    def fails():
        raise NotCompiled("no space left")

    with monkeypatch.context() as patch:
        patch.setattr("rtdenoise.ops.native.convolve_bytes.multiplies", fails)
        assert not multiplies_bytes()
    monkeypatch.setattr("rtdenoise.ops.convolve_bytes.compiled", lambda _: False)
    assert not multiplies_bytes()


@pytest.mark.parametrize("precision", ["bf16", "int8"])
def test_networks_without_their_weights_are_not_saved(small, tmp_path, precision):
    path = tmp_path / "mine.safetensors"
    with pytest.raises(InputError, match=r"take it from models\.read") as error:
        save(load(small, precision=precision), path)
    assert not path.exists() and "\n" not in str(error.value)
    save(load(small, precision="fp32"), path)
    for name, tensor in read(small).state_dict().items():
        assert torch.equal(read(path).state_dict()[name], tensor), name


def test_it_has_no_gradients(small):
    model = load(small, precision="int8")
    assert isinstance(model.pixels, PixelNetworkInBytes) and isinstance(model.unet, UNetInBytes)
    assert model.step(make_frames(1)[0])[0].grad_fn is None
