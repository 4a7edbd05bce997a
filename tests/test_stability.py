"""Every promise of the two tables of cases, for the shipped models in every mode and for every backend."""

import pytest
import stability_cases
import stability_ops
import torch
from stability_cases import CASES, MODES, Subject, modes_of
from synthetic import make_frames

from rtdenoise.exposure import exposure, noise_level
from rtdenoise.models import available
from rtdenoise.models.weights import read_config

# Promises that a model breaks, and how far: docs/reference/models/hybrid-many.md says why.
UNEVEN = "paper's failure case: fast object, dark to light"
BROKEN = {("hybrid-many", UNEVEN): 1.7, ("hybrid-large-many", UNEVEN): 1.4}


def models_in(mode: str) -> list[str]:
    """The shipped models in a mode: all in float32; elsewhere one of each kind, from which others differ in widths and
    weights, and in training, which takes long, one of each architecture. bench/stability.py tries all of them."""
    names = [name for name in available() if mode in modes_of(name)]
    if mode == "float32":
        return names
    kind = _architecture if mode == "training" else _kind
    return list({kind(name): name for name in reversed(names)}.values())


def _architecture(name: str) -> str:
    return read_config(name).architecture


def _kind(name: str) -> tuple[str, bool, bool]:
    config = read_config(name)
    return config.architecture, getattr(config, "many", False), getattr(config, "clean", False)


MODELS = {mode: models_in(mode) for mode in MODES}
FRAMES = {"float32": 50}  # of long sequences, elsewhere 30; bench/stability.py takes 10,000


@pytest.fixture(scope="module")
def subjects(mode):
    """Of the models in a mode; `mode` changes once all cases are through, so no more than one mode's is remembered."""
    frames = {name: FRAMES.get(mode, 30) for name in MODELS[mode]}
    if mode == "float32":
        frames["paper"] = 100  # the last to reach its fixed point
    return {name: Subject.of(name, mode, frames[name]) for name in frames}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("mode", MODES, scope="module")
def test_promises_of_the_denoiser(subjects, case, mode):
    for name, subject in subjects.items():
        subject.non_finite = 0
        value = case.measure(subject)
        assert subject.non_finite == 0, f"{name}: {subject.non_finite} values are not finite"
        limit = BROKEN.get((name, case.name), case.limit(mode))
        assert value <= limit, f"{name}: {value:g}, promised {limit:g} ({case.promise})"


@pytest.mark.parametrize("case", stability_ops.OP_CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("backend", stability_ops.BACKENDS)
def test_promises_of_the_operations(case, backend):
    assert case.measure(stability_ops.backend(backend)) <= case.bound, case.promise


def test_the_tables_have_no_case_twice():
    for cases in (CASES, stability_ops.OP_CASES):
        assert len({case.name for case in cases}) == len(cases)


def test_a_subject_counts_what_is_not_finite():
    """A table in which nothing can fail would be worth nothing."""
    fast = Subject.of("fast", "float32").denoiser

    class Poisoned:
        def step(self, frame, history):
            image, history = fast.step(frame, history)
            return image / 0, history

        def parameters(self):
            return iter(())

        def requires_grad_(self, _):
            return self

    subject, frames = Subject(Poisoned()), stability_cases.scene()
    subject.step(frames[0])
    once = subject.non_finite
    assert once > 0
    for _ in range(2):  # also in what is remembered
        subject.non_finite = 0
        subject.play(frames[:1])
        assert subject.non_finite == once


@pytest.mark.parametrize("mode", ["float32", "training"])
def test_what_a_subject_remembers_is_what_the_denoiser_gives(mode):
    frames, subject = stability_cases.scene(4), Subject.of("fast", mode)
    other = stability_cases.broken(frames[1], "radiance", 5.0)
    for run in (frames[:2], frames, frames[:3], [frames[0], other, *frames[2:]], frames[1:]):
        expected = Subject(subject.denoiser, mode).play(run)
        assert all(map(torch.equal, subject.play(run), expected))
    assert len(subject.played) == 4 + 3 + 3


def test_light_below_the_limit_counts_as_black():
    """As docs/reference/stability.md says: the exposure follows the light down to 10⁻⁸, noise down to 10⁻¹⁵."""
    (frame,) = make_frames(1, H=96, W=128)
    at_one, noise = exposure(frame.radiance), noise_level(frame.radiance, frame.depth)
    torch.testing.assert_close(exposure(frame.radiance * 2e-8) * 2e-8, at_one)
    for scale in (1e-9, 1e-16):
        assert exposure(frame.radiance * scale).item() == pytest.approx(1e8)
    torch.testing.assert_close(noise_level(frame.radiance * 1e-14, frame.depth), noise)
    assert noise_level(frame.radiance * 1e-16, frame.depth) == 0
