"""Alpha of few samples a pixel beside the denoised picture (`data.alpha`)."""

import numpy as np
import pytest
from synthetic import make_frames, write_sequence

from rtdenoise import InputError, denoise_alpha
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options

H, W = 48, 64


def disc(samples: int, colour=(0.8, 0.3, 0.1)):
    """Coverage of a disc, the same as so many samples a pixel see it, and its premultiplied radiance."""
    draw = np.random.default_rng(0)
    y, x = np.mgrid[:H, :W]

    def coverage(n: int) -> np.ndarray:
        u, v = draw.random((2, n, H, W))
        return (np.hypot(x + u - 30.3, y + v - 22.8) < 15).mean(0)

    exact = coverage(4096)
    return exact, coverage(samples), exact[..., None] * np.array(colour)


def error(a, b, where=np.s_[:]):
    return np.sqrt(np.square(a - b)[where].mean())


@pytest.mark.parametrize(("samples", "most"), [(1, 0.5), (2, 0.5), (4, 0.6), (7, 0.8)])
def test_few_samples_get_the_edge_of_the_picture(samples, most):
    exact, noisy, picture = disc(samples)
    clean = denoise_alpha(noisy, picture)
    mixed = (exact > 0) & (exact < 1)
    assert clean.dtype == np.float32 and clean.min() >= 0 and clean.max() <= 1
    assert error(clean, exact, mixed) < most * error(noisy, exact, mixed)
    background = 2.0  # over it, fringes are what a wrong alpha leaves
    over = [picture + (1 - alpha[..., None]) * background for alpha in (clean, noisy, exact)]
    assert error(over[0], over[2]) < most * error(over[1], over[2])


def test_what_is_the_same_all_around_stays_to_the_bit():
    _, noisy, picture = disc(1)
    y, x = np.mgrid[:H, :W] + 0.5
    inside = np.abs(np.hypot(x - 30.3, y - 22.8) - 15) > 6
    assert np.array_equal(denoise_alpha(noisy, picture)[inside], noisy[inside])
    assert set(np.unique(noisy[inside])) == {0, 1}


def test_a_black_object_is_smoothed_by_its_neighbours():
    exact, noisy, picture = disc(1, colour=(0, 0, 0))
    clean = denoise_alpha(noisy, picture)
    assert np.isfinite(clean).all() and error(clean, exact) < 0.8 * error(noisy, exact)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e12])
def test_exposure_changes_nothing(scale):
    _, noisy, picture = disc(1)
    assert np.allclose(denoise_alpha(noisy, scale * picture), denoise_alpha(noisy, picture), atol=1e-5)


@pytest.mark.parametrize("kind", ["many samples", "constant", "beyond", "nan", "below"])
def test_other_alpha_stays_as_rendered(kind):
    _, alpha, picture = disc(16 if kind == "many samples" else 1)
    if kind == "constant":
        alpha = np.ones_like(alpha)
    if kind in ("beyond", "nan", "below"):
        alpha[20, 30] = {"beyond": 2.0, "nan": np.nan, "below": -1.0}[kind]
    assert np.array_equal(denoise_alpha(alpha, picture), alpha.astype(np.float32), equal_nan=True)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 2)])
def test_pictures_of_a_few_pixels(size):
    alpha = np.arange(np.prod(size)).reshape(size) % 2
    clean = denoise_alpha(alpha, np.ones((*size, 3)))
    assert clean.shape == size and np.isfinite(clean).all()


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_pixels_that_are_not_finite_count_as_black(dtype):
    alpha, picture = np.random.default_rng(1).integers(0, 2, (12, 14)).astype(np.float32), np.ones((12, 14, 3), dtype)
    picture[3, 4], picture[8, 9, 1], black = np.nan, np.inf, picture.copy()
    black[3, 4], black[8, 9, 1] = 0, 0
    assert np.array_equal(denoise_alpha(alpha, picture), denoise_alpha(alpha, black))


def test_shapes_that_do_not_fit():
    with pytest.raises(InputError, match=r"expected alpha \[H, W\] and picture \[H, W, 3\], got \(4, 5\) and \(4, 5\)"):
        denoise_alpha(np.zeros((4, 5)), np.zeros((4, 5)))


@pytest.mark.parametrize(
    ("layout", "model", "keep"),
    [("plain", "fast", ()), ("plain", "fast", ("all",)), ("source", "fast", ()), ("plain", "offline", ())],
)
def test_files_get_it_unless_rendered_is_asked_for(tmp_path, layout, model, keep):
    shot = write_sequence(tmp_path / "shot", make_frames(2, H=H, W=W))
    _, alpha, _ = disc(1)
    for path in shot.iterdir():
        channels = read_header(path).channels
        layers = read_channels(path, list(channels), as_stored=True) | {"A": alpha}
        write_layers(path, layers, dtypes=channels | {"A": "half"})
    chosen = {"offline": True} if model == "offline" else {"model": model}
    for kept in ("auto", "rendered"):
        denoise(str(shot), tmp_path / kept, Options(layout=layout, alpha=kept, keep=keep, **chosen))
        out = tmp_path / kept / "frame.0001.exr"
        assert read_header(out).channels["A"] == "half"
        found, *picture = read_channels(out, "ARGB").values()
        expected = alpha if kept == "rendered" else denoise_alpha(alpha, np.stack(picture, axis=2))
        assert np.allclose(found, expected, atol=3e-3) and (kept == "auto") != np.array_equal(found, alpha)


def test_an_unknown_choice_is_refused(tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    with pytest.raises(InputError, match="unknown alpha 'none': known are auto, rendered"):
        denoise(str(shot), tmp_path / "out", Options(alpha="none"))
