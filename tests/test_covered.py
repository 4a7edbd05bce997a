"""Edges that move, as one pass of the offline mode saw them: what the frame itself bears out (`run.covered`)."""

from dataclasses import replace

import pytest
import torch
from test_over import BEHIND, EDGE, FRONT, SIZE, SPEED, kept, motion, picture, seen_now

from rtdenoise.frame import Frame, History
from rtdenoise.run.covered import agrees, as_covered

EDGES = (torch.arange(48) % 8 < 2).expand(1, 1, 48, 48)  # stripes


def coverage(now, share, weight=8.0):
    """Of stripes: whether the front is seen now, and its share of other frames."""
    known = EDGES.float()
    return torch.cat([known * now, known * share * weight, known * weight], dim=1)


def random(share):
    return (torch.rand(1, 1, 48, 48, generator=torch.Generator().manual_seed(0)) < share).float()


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_a_frame_that_sees_the_front_as_often_agrees(share):
    found = agrees(coverage(random(share), share))
    assert not found[~EDGES].any() and found[EDGES].float().mean() > 0.75
    border = torch.ones_like(EDGES)
    border[..., 6:-6, 6:-6] = False
    assert found[EDGES & border].float().mean() > 0.75


@pytest.mark.parametrize(("now", "share"), [(0.0, 0.5), (0.5, 1.0), (1.0, 0.0)])
def test_one_that_sees_it_otherwise_does_not(now, share):
    """As at the silhouette of an object that turns."""
    assert agrees(coverage(random(now), share))[EDGES].float().mean() < 0.05


def test_where_nothing_else_was_seen_nothing_is_known():
    assert not agrees(coverage(random(0.5), 0.5, weight=0.05)).any()


def passed(own_edge, edges, count=2.0, samples=None):
    """`as_covered` of a frame whose front ends at one column, with frames before that saw it end at others. The columns
    next to it: footprint and frames."""
    seen, depth = seen_now(), picture(EDGE)
    frame = Frame(seen[:, :3], seen[:, 3:6], seen[:, 6:], picture(own_edge), motion(own_edge), samples=samples)
    history = History(seen[:, :3], motion(), depth, seen[:, 6:], recent=tuple(kept(edge) for edge in edges))
    after = replace(history, footprint=seen, footprint_count=torch.full_like(depth, count))
    footprint, frames = as_covered(frame, history, after)
    return footprint[0, :, 4], frames[0, 0, 4]


def test_edges_are_composed_and_count_the_frames_that_looked_there():
    at = [EDGE - SPEED * k for k in range(1, 4)]
    footprint, frames = passed(EDGE, [at[0] + 1, at[1], at[2] - 1])
    beside = torch.zeros(SIZE[1], dtype=torch.bool)
    beside[[EDGE - 1, EDGE]] = True
    assert torch.equal(frames, torch.where(beside, 4.0, 2.0))
    assert torch.equal(footprint[:, ~beside], seen_now()[0, :, 4][:, ~beside])
    torch.testing.assert_close(footprint[3:, EDGE - 1], torch.full((6,), (FRONT + 2 + BEHIND) / 4), rtol=1e-2, atol=0)
    torch.testing.assert_close(footprint[3:, EDGE], torch.full((6,), (3 * BEHIND + 1) / 4), rtol=1e-2, atol=0)


def test_what_the_frame_does_not_bear_out_stays_as_it_was():
    """The frames before saw the front two pixels farther than its motion leads."""
    footprint, frames = passed(EDGE, [EDGE - SPEED * k + 2 for k in range(1, 4)])
    assert torch.equal(footprint, seen_now()[0, :, 4]) and (frames == 2).all()


def test_frames_of_many_samples_show_both_sides_already():
    at = [EDGE - SPEED * k for k in range(1, 4)]
    for samples, frames in ((2, 4), (4, 2)):
        _, found = passed(EDGE, [at[0] + 1, at[1], at[2] - 1], samples=torch.full((1, 1, *SIZE), float(samples)))
        assert found[EDGE] == frames


def test_a_pass_that_begins_has_the_frame_alone():
    frame = Frame(*seen_now().split(3, dim=1), picture(EDGE))
    after = History(frame.radiance, motion(), frame.depth, frame.normal, footprint=seen_now(),
                    footprint_count=torch.ones_like(frame.depth))  # fmt: skip
    footprint, count = as_covered(frame, None, after)
    assert footprint is after.footprint and count is after.footprint_count
