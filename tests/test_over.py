"""Edges that move against what is behind them, as recent frames saw them (`ops.over`), and who shows them."""

from dataclasses import replace

import pytest
import torch
from synthetic import make_frames

from rtdenoise import models, ops
from rtdenoise.constants import GLOSS, OVER_LIGHT
from rtdenoise.frame import Known
from rtdenoise.models import footprint
from rtdenoise.models.hybrid_config import HybridConfig
from rtdenoise.ops.keep import keep
from rtdenoise.ops.over import over, over_and_coverage

SIZE = 8, 24
EDGE, SPEED = 12, 3  # the front is left of this column and moves by so many pixels a frame to the right
FRONT, BEHIND = 2.0, 6.0  # depths, and values of light and surfaces


@pytest.fixture(params=["plain", "fused"], autouse=True)
def choice(request):
    with ops.use(request.param):
        yield


def picture(edge, front=FRONT, behind=BEHIND, channels=1):
    """One value left of a column, another one from there on."""
    left = (torch.arange(SIZE[1]) < edge).expand(1, channels, *SIZE)
    return torch.where(left, front, behind)


def motion(edge=EDGE, speed=-SPEED):
    """The front moves; what is behind stands still."""
    return torch.cat([picture(edge, float(speed), 0.0), torch.zeros(1, 1, *SIZE)], dim=1)


def kept(edge, reset=0.0, passing=1.0, speed=-SPEED):
    """A frame whose front had light and surfaces of 1, what was behind of 9: no longer what is there. `passing`: what
    multiplies all distances, below 1 something passed before."""
    surfaces = picture(edge, 1.0, 9.0, 3)
    light = surfaces / (surfaces + GLOSS)
    resets, moves = torch.full((1, 1, *SIZE), reset), motion(edge, speed)
    return keep(light, passing * picture(edge), surfaces, resets, moves, surfaces)


def seen_now():
    return picture(EDGE, FRONT, BEHIND, 9)


def composed(recent, seen=None, moves=None):
    now = seen_now()
    result = over(now if seen is None else seen, now, motion() if moves is None else moves, picture(EDGE), recent)
    return result[0, :, 4]  # [9, W] of a row


def values(result, column):
    """Radiance and surface there, in all channels the same."""
    light, surface = result[:3, column], result[3:, column]
    for part in (light, surface):
        torch.testing.assert_close(part, part[:1].expand_as(part), rtol=2e-2, atol=0)  # kept in bfloat16
    return light[0].item(), surface[0].item()


def test_the_front_covers_as_much_as_frames_saw():
    """The pixels beside the edge showed the front in the frame before; that left of it does now, too."""
    at = [EDGE - SPEED * k for k in range(1, 4)]
    result = composed([kept(at[0] + 1), kept(at[1] - 1), kept(at[2] - 1)])  # the last two saw what is behind
    light, surface = values(result, EDGE - 1)
    assert surface == pytest.approx((FRONT + 1 + 2 * BEHIND) / 4, rel=1e-2)
    assert light == pytest.approx(FRONT + OVER_LIGHT * (surface - FRONT), rel=1e-2)
    result = composed([kept(at[0] + 1), kept(at[1]), kept(at[2])])
    light, surface = values(result, EDGE)
    assert surface == pytest.approx((BEHIND + 1 + 2 * BEHIND) / 4, rel=1e-2)
    assert light == pytest.approx(BEHIND + OVER_LIGHT * (surface - BEHIND), rel=1e-2)
    others = [x for x in range(SIZE[1]) if x not in (EDGE - 1, EDGE)]
    assert torch.equal(result[:, others], seen_now()[0, :, 4][:, others])


@pytest.mark.parametrize("back", [-SPEED, 0, 6])
def test_a_path_goes_on_with_the_front_beside(back):
    """A camera that shakes goes the other way in the frame before, where the pixel itself saw what is behind."""
    first, there = kept(EDGE - SPEED, speed=back), EDGE - SPEED + back
    assert values(composed([first, kept(there)]), EDGE)[1] == BEHIND
    assert values(composed([first, kept(there + 1)]), EDGE)[1] == pytest.approx((2 * BEHIND + 1) / 3, rel=1e-2)


def test_a_path_ends_where_no_front_is_beside():
    """How it moved there is unknown, and a guess leads to another part of the front, such as a lamp."""
    for edge in (EDGE - 2 * SPEED + 1, SIZE[1]):
        assert values(composed([kept(EDGE - SPEED - 1), kept(edge)]), EDGE)[1] == BEHIND


def test_what_passed_before_both_leaves_nothing():
    """Such a frame does not count, and no other beyond it; one whose front was as far as now, within a surface's
    tolerance, does."""
    frames = [kept(EDGE - SPEED), kept(EDGE - 2 * SPEED), kept(EDGE - 3 * SPEED)]
    hidden = [frames[0], kept(EDGE - 2 * SPEED, passing=0.2), frames[2]]
    near = [frames[0], kept(EDGE - 2 * SPEED, passing=0.95), frames[2]]
    assert torch.equal(composed(near), composed(frames)) and not torch.equal(composed(hidden), composed(frames))
    for column in (EDGE - 1, EDGE):
        now, saw = (FRONT, 1.0) if column < EDGE else (BEHIND, BEHIND)
        assert values(composed(hidden), column)[1] == pytest.approx((now + saw) / 2, rel=1e-2)
    nothing = [kept(EDGE - SPEED * k, passing=0.2) for k in range(1, 4)]
    torch.testing.assert_close(composed(nothing), composed([kept(EDGE - SPEED, reset=1.0, passing=0.2)]))


def test_the_coverage_is_told():
    """Beside the edge: whether the front is there now, and how many of three frames saw it; the second reset the rest,
    and there the path of the right pixel ends."""
    at = [EDGE - SPEED * k for k in range(1, 4)]
    recent = [kept(at[0] + 1), kept(at[1] - 1, reset=0.75), kept(at[2] + 1)]
    composed, coverage = over_and_coverage(seen_now(), seen_now(), motion(), picture(EDGE), recent)
    assert torch.equal(composed, over(seen_now(), seen_now(), motion(), picture(EDGE), recent))
    expected = torch.zeros(3, SIZE[1])
    expected[:, EDGE - 1], expected[:, EDGE] = torch.tensor([1, 1.25, 2.25]), torch.tensor([0.0, 1, 2])
    torch.testing.assert_close(coverage, expected[None, :, None].expand(1, 3, *SIZE))


def test_behind_is_what_frames_have_seen_there():
    """`seen` beside the edge, not the noise of a single frame."""
    at = [EDGE - SPEED * k for k in range(1, 4)]
    result = composed([kept(edge) for edge in at], seen=seen_now() + 10)
    assert values(result, EDGE)[1] == pytest.approx(BEHIND + 10, rel=1e-2)
    result = composed([kept(edge - 1) for edge in at], seen=seen_now() + 10)
    assert values(result, EDGE - 1)[1] == pytest.approx((FRONT + 3 * (BEHIND + 10)) / 4, rel=1e-2)


def test_resets_and_lookups_between_pixels_count_less():
    at = [EDGE - SPEED * k for k in range(1, 3)]
    result = composed([kept(at[0] + 1, reset=0.75), kept(at[1] + 1)])
    assert values(result, EDGE)[1] == pytest.approx((BEHIND + 1 + 0.25) / 2.25, rel=1e-2)
    moves = motion(speed=-SPEED + 0.25)  # off by a quarter of a pixel
    assert values(composed([kept(at[0] + 1)], moves=moves), EDGE)[1] == pytest.approx((BEHIND + 0.75) / 1.75, rel=1e-2)


def test_without_an_edge_that_moves_footprints_stay_to_the_bit():
    recent, seen = [kept(EDGE)], seen_now() * 1.1
    for moves in (motion(speed=0.25), torch.full_like(motion(), float("nan"))):
        assert torch.equal(over(seen, seen_now(), moves, picture(EDGE), recent), seen)
    assert torch.equal(over(seen, seen_now(), motion(), picture(EDGE, 5.8, 6.0), recent), seen)  # one surface
    assert torch.equal(over(seen, seen_now(), motion(), picture(EDGE, 0.0, 0.0), recent), seen)  # nothing was hit


def test_even_light_stays_even():
    """Though kept frames are rounded."""
    seen = seen_now()
    seen[:, :3] = 1.003
    light, albedo = torch.full_like(seen[:, :3], 1.003) / (0.3 + GLOSS), torch.full_like(seen[:, :3], 0.3)
    frame = keep(light, picture(EDGE - SPEED + 1), albedo, torch.zeros_like(picture(EDGE)), motion(), albedo)
    result = over(seen, seen, motion(), picture(EDGE), [frame])
    assert torch.equal(result[:, :3], seen[:, :3]) and not torch.equal(result, seen)


def test_a_path_ends_off_the_screen():
    moves = motion(speed=-SIZE[1])
    assert values(composed([kept(EDGE)] * 2, moves=moves), EDGE - 1)[1] == FRONT
    assert values(composed([kept(EDGE)] * 2, moves=moves), EDGE)[1] == BEHIND


def test_nothing_may_be_behind():
    """The sky has no distance."""
    now, depth = seen_now(), picture(EDGE, FRONT, 0.0)
    sky = keep(
        torch.ones(1, 3, *SIZE), picture(EDGE - SPEED + 1, FRONT, 0.0), now[:, 6:], depth * 0, motion(), now[:, 3:6]
    )
    result = over(now, now, motion(), depth, [sky])[0, :, 4]
    assert result[3, EDGE].item() == pytest.approx((FRONT + BEHIND) / 2, rel=1e-2)


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"expected kept frames of \(1, 8, 8, 24\)"):
        composed([torch.zeros(1, 5, *SIZE, dtype=torch.int32)])
    with pytest.raises(ValueError, match=r"int32, got .*uint8"):
        composed([torch.zeros(1, 8, *SIZE, dtype=torch.uint8)])


def test_still_pictures_leave_it_out(monkeypatch):
    """And only they do, beside first frames."""
    asked = []
    monkeypatch.setattr(footprint, "over", lambda seen, *rest: asked.append(seen) or seen)
    torch.manual_seed(0)
    network = models.create(
        HybridConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, down=(8, 8, 8), up=(8, 8), out=(8, 8))
    ).eval()
    first, second, third = make_frames(3)
    with torch.inference_mode():
        _, history = network.step(first)
        assert not asked
        image, onward = network.step(second, history)
        assert len(asked) == 1
        network.step(replace(third, motion=third.motion * 0), onward, Known(still=True))
        assert len(asked) == 1
    assert image.isfinite().all()
