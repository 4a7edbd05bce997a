"""Saved histories: written and read back; whatever else is in the file is refused in one line."""

from __future__ import annotations

import os
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import save_file

from rtdenoise.data.stored import CHANNELS, FOUND, read_history, write_history
from rtdenoise.errors import InputError
from rtdenoise.frame import SEVERAL, History

H, W = 4, 6


def make_history():
    return {name: np.full((1, count, H, W), 0.5, np.float32) for name, count in CHANNELS.items()}


def message(path) -> str:
    with pytest.raises(InputError) as caught:
        read_history(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    return str(caught.value)


def test_the_fields_are_those_of_a_history():
    assert {*CHANNELS, FOUND, *(prefix.rstrip(".") for prefix in SEVERAL)} == {field.name for field in fields(History)}


@pytest.mark.parametrize("history", [{}, make_history(), {"radiance": np.ones((2, 3, 1, 1), np.float32)}])
def test_there_and_back(tmp_path, history):
    history = history | ({"hidden.0": np.ones((1, 7, 2, 3), np.float32)} if len(history) > 1 else {})
    write_history(tmp_path / "a", history, {"done": "3"})
    found, metadata = read_history(tmp_path / "a")
    assert metadata == {"done": "3"} and found.keys() == history.keys()
    assert all(np.array_equal(found[name], history[name]) for name in history)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"weight": np.ones(3)}, "not a history of this version: it holds depth, "),
        ({"hidden.x": np.ones(3)}, "not a history of this version: it holds depth, "),
        ({"depth": np.ones((1, 1, H, W))}, "depth is float64, expected float32"),
        ({"depth": np.ones((1, 1, H, W), np.int8)}, "depth is int8, expected float32"),
        ({"depth": np.ones((1, 1, H, W + 1), np.float32)}, "depth is (1, 1, 4, 7), expected (1, 1, 4, 6)"),
        ({"normal": np.ones((1, 1, H, W), np.float32)}, "normal is (1, 1, 4, 6), expected (1, 3, 4, 6)"),
        ({"radiance": np.ones((3, H, W), np.float32)}, " is "),
        ({"radiance": np.ones((), np.float32)}, " is "),
        ({"radiance": np.ones((1, 3, 0, W), np.float32)}, " is "),
        ({"hidden.0": np.ones((2, 3, H, W), np.float32)}, "hidden.0 is (2, 3, 4, 6), expected (1, 'C', 'h', 'w')"),
        *(({"mean": np.full((1, 3, H, W), bad, np.float32)}, "mean holds values") for bad in (np.nan, -np.inf, 1e30)),
        ({"motion_next": np.full((1, 2, H, W), np.nan, np.float32)}, "motion_next holds values that no denoiser"),
    ],
)
def test_what_is_no_history(tmp_path, changed, expected):
    save_file(make_history() | changed, tmp_path / "a")
    assert expected in message(tmp_path / "a")


def test_motion_may_be_any_finite_number(tmp_path):
    """Frames may hold such motion: it leads off the screen."""
    write_history(tmp_path / "a", make_history() | {"motion_next": np.full((1, 2, H, W), 1e30, np.float32)}, {})
    assert read_history(tmp_path / "a")[0]["motion_next"].max() == np.float32(1e30)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a")
    assert message(tmp_path / "a").endswith("cannot be read: not a regular file")


def test_a_type_that_numpy_lacks(tmp_path):
    import torch
    from safetensors.torch import save_file as save_tensors

    save_tensors({"radiance": torch.ones(1, 3, H, W, dtype=torch.bfloat16)}, tmp_path / "a")
    message(tmp_path / "a")


@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(places=st.lists(st.tuples(st.integers(0, 900), st.integers(0, 255)), min_size=1, max_size=4))
def test_damaged_bytes_are_refused_or_harmless(tmp_path, places):
    write_history(tmp_path / "a", make_history(), {"done": "3"})
    damaged = bytearray((tmp_path / "a").read_bytes())
    for place, value in places:
        damaged[place] = value
    (tmp_path / "a").write_bytes(damaged)
    try:
        found, _ = read_history(tmp_path / "a")
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert all(np.isfinite(array).all() and array.ndim == 4 for array in found.values())
