"""One description of every network: torch builds what configurations describe; impossible ones are refused."""

import json
from dataclasses import asdict

import numpy as np
import pytest
import torch
from reach import light_reach, network_reach
from safetensors.numpy import save_file
from synthetic import TINY

from rtdenoise.errors import InputError
from rtdenoise.frame import Frame, History
from rtdenoise.models import PRESETS, AccumulatedKPNConfig, TemporalKPNConfig, create, load
from rtdenoise.models.presets import from_stored, with_settings

CONFIGS = {
    **PRESETS,
    "four levels": TemporalKPNConfig(widths=(4,) * 4, kernel=3),
    "six levels": TemporalKPNConfig(widths=(2,) * 6),
    "large kernel": TemporalKPNConfig(widths=(4,) * 4, kernel=7),
    "two scales": AccumulatedKPNConfig(widths=(4, 4), scales=2, kernel=3),
    "large kernels": AccumulatedKPNConfig(widths=(4,) * 3, scales=2, kernel=7, temporal_kernel=5),
    "pick": AccumulatedKPNConfig(widths=(4,) * 5, pick_kernel=3, edge_kernel=3),
    "guided": AccumulatedKPNConfig(widths=(4, 8, 4, 4, 4), guided=True),
    "detail": AccumulatedKPNConfig(widths=(4,) * 5, detail=True),
    "large pick": AccumulatedKPNConfig(widths=(4,) * 5, kernel=3, pick_kernel=5, edge_kernel=5),
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
def test_the_description_is_what_torch_builds(config):
    model = create(config)
    assert {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()} == config.shapes
    assert from_stored(config.architecture, json.loads(json.dumps(asdict(config)))) == config


@pytest.mark.parametrize(
    "name", ["paper", "default", "four levels", "two scales", "large kernels", "large pick", "detail"]
)
def test_reaches_are_those_found_by_experiment(name):
    torch.manual_seed(0)
    model = create(CONFIGS[name]).eval()
    assert model.config.network_reach == network_reach(model)
    assert model.config.light_reach == light_reach(model)


def test_carried_fields_are_those_of_the_history():
    frame = Frame(
        torch.rand(1, 3, 32, 32), *(torch.rand(1, n, 32, 32) for n in (3, 3, 1)), motion_next=torch.zeros(1, 2, 32, 32)
    )
    for config in (TINY, CONFIGS["two scales"]):
        _, history = create(config).step(frame)
        assert history.layers().keys() - {"motion_next", "depth", "normal", "noisy"} == set(config.carries)


def test_settings_change_fields():
    changed = with_settings(
        PRESETS["default"], ["widths=8,16,24", "scales=3", "longest=24", "motion=traditional", "detail=true"]
    )
    assert changed == AccumulatedKPNConfig(
        (8, 16, 24), 3, edge_kernel=3, detail=True, longest=24.0, motion="traditional"
    )


@pytest.mark.parametrize(
    "setting, message",
    [
        ("widths", "expected NAME=VALUE"),
        ("width=3", "expected NAME=VALUE with a NAME of widths, scales"),
        ("widths=a,b", "expected a value like 32,56,72,88,104"),
        ("kernel=4", "expected an odd size"),
        ("kernel=1e9", "expected a value like 5"),
        ("detail=maybe", "expected a value like true"),
        ("widths=8,99999999,8,8,8", "expected 2 to 5 widths from 1 to 1024"),
    ],
)
def test_impossible_settings_are_refused(setting, message):
    with pytest.raises(InputError, match=message) as error:
        with_settings(PRESETS["default"], [setting])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "values",
    [
        {"widths": [10**12] * 5}, {"widths": [8.5] * 5}, {"widths": "88888"}, {"widths": 8}, {"widths": [True] * 5},
        {"kernel": 10**9 + 1}, {"kernel": "5"}, {"kernel": None}, {"scales": 10**9}, {"longest": "long"},
        {"longest": float("nan")}, {"motion": 3}, {"no_such_field": 1}, {"widths": [8] * 9},
    ],
    ids=str,
)  # fmt: skip
def test_absurd_stored_configurations_are_refused(values, tmp_path):
    path = tmp_path / "absurd.safetensors"
    save_file({"x": np.zeros(1, np.float32)}, path, {"architecture": "accumulated_kpn", "config": json.dumps(values)})
    with pytest.raises(InputError, match="its configuration is not one of this version") as error:
        load(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_damaged_weights_are_refused(value, tmp_path):
    tensors = {name: np.zeros(shape, np.float32) for name, shape in TINY.shapes.items()}
    tensors["heads.0.weight"].flat[3] = value
    path = tmp_path / "damaged.safetensors"
    save_file(tensors, path, {"architecture": TINY.architecture, "config": json.dumps(asdict(TINY))})
    with pytest.raises(InputError, match=r"heads\.0\.weight holds values that are not finite or beyond"):
        load(path)


def test_hidden_features_are_fields_of_a_history():
    image = torch.rand(1, 3, 8, 8)
    history = History(image, None, None, None, hidden=(torch.rand(1, 4, 4, 4), torch.rand(1, 8, 2, 2)))
    layers = history.layers()
    assert list(layers) == ["radiance", "hidden.0", "hidden.1"]
    again = History.from_layers(layers)
    assert again.radiance is image and all(a is b for a, b in zip(again.hidden, history.hidden, strict=True))
    with pytest.raises(ValueError, match=r"not the fields of a history: hidden\.1, radiance"):
        History.from_layers({"radiance": image, "hidden.1": image})
    with pytest.raises(ValueError, match="not the fields of a history"):
        History.from_layers({"radiance": image, "colour": image})


def test_components_come_in_threes():
    image = torch.rand(1, 3, 8, 8)
    assert Frame(image, components=torch.rand(1, 6, 8, 8), samples=torch.ones(1, 1, 8, 8)).components.shape[1] == 6
    with pytest.raises(ValueError, match=r"expected components \(1, '3K', 8, 8\), got \(1, 5, 8, 8\)"):
        Frame(image, components=torch.rand(1, 5, 8, 8))
