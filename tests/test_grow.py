"""Grown networks compute the outputs of the old ones, and their new channels can learn."""

from dataclasses import replace

import pytest
import torch

from rtdenoise.errors import InputError
from rtdenoise.frame import Frame
from rtdenoise.glsl import Pipeline
from rtdenoise.models import PRESETS, create, grow, read, save
from rtdenoise.models.presets import with_settings
from rtdenoise.run.tiles import Tiled

FEATURES = PRESETS["fast"].features
WIDE = replace(PRESETS["fast"], widths=(20, 24, 40, 50, 70))


@pytest.fixture(scope="module")
def small():
    return read("fast")


def test_a_grown_network_predicts_the_same(small):
    torch.manual_seed(0)
    inputs = torch.rand(2, FEATURES, 48, 80)
    before, after = small.predict(inputs), grow(small, WIDE).predict(inputs)
    for name in ("temporal", "alpha_temporal", "reset", "sharp"):
        torch.testing.assert_close(getattr(after, name), getattr(before, name))
    for a, b in zip(before.spatial + before.alpha, after.spatial + after.alpha, strict=True):
        torch.testing.assert_close(b, a)


def test_new_channels_learn(small):
    """Weights that read a new channel have a gradient at once; weights that make it, as soon as it is read."""
    torch.manual_seed(0)
    model = grow(small, WIDE)
    inputs = torch.rand(1, FEATURES, 32, 32)

    def loss():
        heads = model.predict(inputs)
        return sum(x.float().square().mean() for x in (*heads.spatial, *heads.alpha, heads.temporal))

    loss().backward()
    assert (model.full_head.weight.grad[16:].abs().amax((1, 2, 3)) > 0).all()
    with torch.no_grad():
        for parameter in model.parameters():
            parameter -= 0.1 * parameter.grad
    model.zero_grad()
    loss().backward()
    assert (model.stem.weight.grad[16:].abs().amax((1, 2, 3)) > 0).all()


EDGE, PICK = {"edge_kernel": 3}, {"pick_kernel": 3}


@pytest.mark.parametrize("had", [{}, EDGE, PICK, EDGE | PICK], ids=str)
def test_edge_and_pick_kernels_are_kept_or_begin_as_the_same_everywhere(had):
    torch.manual_seed(0)
    small = create(replace(PRESETS["fast"], **{"edge_kernel": 1, "pick_kernel": 1} | had)).eval().requires_grad_(False)
    for name, parameter in small.named_parameters():
        if "head" in name:
            parameter.normal_(std=0.3)
    inputs = torch.rand(2, FEATURES, 48, 80)
    before, after = small.predict(inputs), grow(small, replace(WIDE, **EDGE, **PICK)).predict(inputs)
    for name in ("temporal", "alpha_temporal", "reset", "sharp"):
        torch.testing.assert_close(getattr(after, name), getattr(before, name))
    for a, b in zip(before.spatial + before.alpha, after.spatial + after.alpha, strict=True):
        torch.testing.assert_close(b, a)
    if "edge_kernel" in had:
        torch.testing.assert_close(after.edge, before.edge)
    else:
        assert before.edge is None and same_everywhere(after.edge.softmax(3))[4] > 0.6
    assert len(after.picks) == small.config.scales - 1
    if "pick_kernel" in had:
        torch.testing.assert_close(after.picks, before.picks)
    else:
        assert before.picks == []
        for logits, share in after.picks:
            assert same_everywhere(logits.softmax(-3))[4] > 0.4 and 0 < same_everywhere(share)[0] < 0.2


def same_everywhere(values):
    """The channels of one pixel, which are those of every other."""
    first, *others = values.movedim(-3, -1).flatten(0, -2)
    assert all(torch.equal(first, other) for other in others)
    return first


def test_the_same_widths_are_a_copy(small):
    again = grow(small, small.config)
    assert all(torch.equal(a, b) for a, b in zip(again.parameters(), small.parameters(), strict=True))


NARROWER, SHALLOWER = (12, 24, 40, 50, 70), (20, 24, 40, 50)


@pytest.mark.parametrize(
    "wanted",
    [
        PRESETS["paper"], PRESETS["default"], replace(WIDE, widths=NARROWER), replace(WIDE, widths=SHALLOWER, scales=4),
        replace(WIDE, edge_kernel=5), replace(WIDE, edge_kernel=1, pick_kernel=3),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(small, wanted):
    with pytest.raises(ValueError, match="wider at any level"):
        grow(small, wanted)


@pytest.mark.parametrize("wanted", [1, 5])
def test_a_pick_kernel_of_another_size_is_refused(wanted):
    with pytest.raises(ValueError, match="or with new heads"):
        grow(create(replace(WIDE, **PICK)), replace(WIDE, pick_kernel=wanted))


def test_a_network_of_another_kind_does_not_grow():
    with pytest.raises(ValueError, match="wider"):
        grow(read("paper"), create(WIDE).config)


def test_guided_attention_begins_as_nothing_and_learns(small):
    """The very same picture at step 0, though it is another network: its last convolution is 0, and has a gradient."""
    torch.manual_seed(0)
    wanted = replace(small.config, guided=True)
    model, inputs = grow(small, wanted), torch.rand(2, FEATURES, 52, 80)
    before, after = small.predict(inputs), model.predict(inputs)
    for a, b in zip(before.spatial + before.alpha, after.spatial + after.alpha, strict=True):
        assert torch.equal(b, a)
    frame = Frame(*(torch.rand(1, n, 45, 70) for n in (3, 3, 3, 1)))
    with torch.no_grad():
        assert torch.equal(model.step(frame)[0], small.step(frame)[0])
    after.spatial[2].square().mean().backward()
    assert model.refine.out.weight.grad.abs().max() > 0
    with torch.no_grad():
        model.refine.out.weight.normal_(std=0.1)
    again = grow(model, replace(wanted, widths=(20, 24, 40, 50, 70))).predict(inputs)
    for a, b in zip(model.predict(inputs).spatial, again.spatial, strict=True):
        torch.testing.assert_close(b, a)
    with pytest.raises(ValueError, match="or wider at any level"):
        grow(model, replace(wanted, widths=(20, 32, 40, 50, 70)))


def test_guided_attention_in_tiles_is_the_whole(assert_images_close):
    torch.manual_seed(0)
    model = create(replace(PRESETS["fast"], widths=(8, 16, 8), scales=3, guided=True)).eval().requires_grad_(False)
    model.refine.out.weight.normal_(std=0.3)
    frame = Frame(*(torch.rand(1, n, 200, 460) for n in (3, 3, 3, 1)))
    with torch.inference_mode():
        whole, _ = model.step(frame)
        tiled, _ = Tiled(model, tile=64).step(frame)
        model.refine.out.weight.zero_()
        assert not torch.allclose(whole, model.step(frame)[0])
    assert_images_close(tiled.numpy(), whole.numpy(), "float32 tiles")


def test_a_guided_network_has_no_shaders(tmp_path):
    path = tmp_path / "guided.safetensors"
    save(create(replace(WIDE, guided=True)), path)
    with pytest.raises(InputError, match="no shaders for networks of the kind 'accumulated_kpn' that are guided"):
        Pipeline.load(path)
    with pytest.raises(ValueError, match="guided: expected 3 scales or more and a second width"):
        replace(WIDE, widths=(20, 25, 40, 50, 70), guided=True)


ONWARD = ("fast", ()), ("default", ()), ("default", ("widths=64,72,72,88,104",)), ("default", ("guided=true",))


@pytest.mark.parametrize(("model", "settings"), ONWARD)
def test_training_goes_on_from_what_ships(model, settings):
    """As docs/use/training.md says: `train --model default --set widths=64,72,72,88,104 --init default`."""
    wanted = with_settings(PRESETS[model], settings)
    assert grow(read(model), wanted).config == wanted
