"""The loop that runs every method: one image a frame, in order, with shots and look-ahead."""

from dataclasses import replace
from types import SimpleNamespace
from weakref import ref

import pytest
import torch
from synthetic import make_frames

from rtdenoise.color import display_exposure
from rtdenoise.evaluate import ALL_METRICS, evaluate, outputs, sequence
from rtdenoise.evaluate.registry import Method
from rtdenoise.evaluate.sequence import Frames, exposure


def counting(frame, history):
    """An image that holds how many frames of its shot came before."""
    count = 0 if history is None else history
    return torch.full_like(frame.radiance, float(count)), count + 1


def ahead(frame, history):
    """The mean of a frame and the next one of its shot; the last frame of a shot alone. Its delay is 1."""
    if frame is None:
        return history, None
    return (None if history is None else (history + frame.radiance) / 2), frame.radiance


def ages(frames, **options):
    return [int(output.image[0, 0, 0, 0]) for output in outputs(counting, frames, **options)]


def test_history_runs_through_a_shot_and_starts_anew_at_gaps_and_cuts():
    frames = make_frames(6)
    assert ages(frames) == [0, 1, 2, 3, 4, 5]
    assert ages(frames, cuts=(2, 5)) == [0, 1, 0, 1, 2, 0]
    assert ages([*frames[:2], *frames[3:]]) == [0, 1, 0, 1, 2]
    assert ages(frames[::-1]) == [0, 1, 2, 3, 4, 5]  # backwards is no gap
    assert [output.frame.number for output in outputs(counting, frames)] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("cuts", [(), (2,), (1, 2, 3)])
def test_a_method_that_looks_ahead_sees_its_own_shot_only(cuts):
    frames = make_frames(4)
    found = list(outputs(ahead, frames, delay=1, cuts=cuts))
    assert [output.frame.number for output in found] == [0, 1, 2, 3]
    for i, output in enumerate(found):
        alone = i == 3 or i + 1 in cuts
        expected = frames[i].radiance if alone else (frames[i].radiance + frames[i + 1].radiance) / 2
        assert torch.equal(output.image, expected)


def test_a_shot_shorter_than_the_delay():
    waiting = []

    def three_ahead(frame, history):
        if frame is not None:
            waiting.append(frame.radiance)
        return (waiting.pop(0) if frame is None or len(waiting) > 3 else None), None

    frames = make_frames(2)
    found = list(outputs(three_ahead, frames, delay=3))
    assert [torch.equal(o.image, f.radiance) for o, f in zip(found, frames, strict=True)] == [True, True]


def test_a_wrong_delay_is_an_error():
    with pytest.raises(ValueError, match="its delay is 0"):
        list(outputs(ahead, make_frames(3)))
    with pytest.raises(ValueError, match="no image at the end of a shot"):
        list(outputs(lambda frame, history: (None, None), make_frames(1), delay=1))


def test_a_method_that_looks_ahead_is_measured_like_the_others(monkeypatch):
    frames = make_frames(4)
    peek = Method("peek", "the mean with the next frame", "filter", lambda device, precision: ahead, delay=1)
    monkeypatch.setattr("rtdenoise.evaluate.measure.choose", lambda names: [peek])
    (result,) = evaluate(frames, ["peek"])
    assert len(result.images) == 4 and len(result.times) == 3
    assert torch.equal(result.images[1], (frames[1].radiance + frames[2].radiance) / 2)
    (truth,) = evaluate(frames, {"it": lambda frame, history: (frame.reference, None)})
    assert truth.errors["frame"]["relmse"] == 0


def test_methods_take_turns_and_say_so():
    told = []
    steps = {"a": counting, "b": counting}
    evaluate(make_frames(2), steps, on_step=lambda label, done, total: told.append((label, done, total)))
    assert told == [("a", 1, 4), ("b", 2, 4), ("a", 3, 4), ("b", 4, 4)]


def test_what_is_kept_of_images_can_be_chosen():
    frames = make_frames(3)
    (result,) = evaluate(frames, ["noisy"], keep=lambda i, image: (i, image[..., :1, :1]))
    assert [i for i, _ in result.images] == [0, 1, 2]
    assert all(torch.equal(part, f.radiance[..., :1, :1]) for (_, part), f in zip(result.images, frames, strict=True))


def test_frames_are_read_when_they_are_asked_for(monkeypatch):
    read = []
    monkeypatch.setattr(sequence, "HELD", 2)
    frames = Frames(4, lambda i: read.append(i) or i)
    assert len(frames) == 4 and not read
    assert (frames[-1], frames[3], frames[1:3], [*frames], read) == (3, 3, [1, 2], [0, 1, 2, 3], [3, 1, 2, 0, 1, 2, 3])
    with pytest.raises(IndexError):
        frames[4]


def test_a_long_sequence_is_measured_with_few_frames_in_memory(monkeypatch):
    monkeypatch.setattr(sequence, "HELD", 2)
    made, given, alive = make_frames(8), [], []

    def read(i):
        frame = replace(made[i], radiance=made[i].radiance.clone())
        given.append(ref(frame.radiance))
        return frame

    options = {"methods": ["accumulate", "noisy"], "metrics": ALL_METRICS, "keep": lambda i, image: None}
    count = lambda *_: alive.append(sum(frame() is not None for frame in given))  # noqa: E731
    found = evaluate(Frames(8, read), on_step=count, **options)
    assert len(given) > 8 and max(alive) <= 5
    for result, expected in zip(found, evaluate(made, **options), strict=True):
        assert repr((result.errors, result.frames)) == repr((expected.errors, expected.frames))


def test_the_exposure_of_frames_is_that_of_all_references_together():
    for count, width in ((3, 50), (3, 701), (5, 1102)):
        frames = [SimpleNamespace(reference=torch.rand(1, 3, 500, width)) for _ in range(count)]
        assert exposure(frames) == display_exposure(torch.cat([frame.reference for frame in frames]))


def test_unnumbered_frames_are_one_shot():
    frames = [replace(frame, number=0) for frame in make_frames(3)]
    assert ages(frames) == [0, 1, 2]


def test_every_image_takes_as_long_where_every_frame_does(monkeypatch):
    """Looking three frames ahead, a frame takes 4 s to take in and an image 1 s to give out: 5 s each, at both ends."""
    clock = [0.0]
    monkeypatch.setattr(sequence.time, "perf_counter", lambda: clock[0])

    def slow(frame, history):
        taken = history or 0
        ready = frame is None or taken >= 3
        clock[0] += 4.0 * (frame is not None) + 1.0 * ready
        image = torch.zeros(1, 3, 8, 8) if ready else None
        return image, taken + 1

    assert [output.seconds for output in outputs(slow, make_frames(6), delay=3)] == [5.0] * 6
