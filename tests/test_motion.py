"""Dual motion vectors against eq. 2 on a scene with known answers: a sphere sliding in front of a plane."""

import math

import numpy as np
import pytest
import torch

from rtdenoise.data.scene_motion import complete, motion_between
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.motion import (
    dual_motion,
    occlusion_mask,
    occlusion_weights,
    on_screen,
    same_surface,
)
from rtdenoise.splat import splat_motion_next

H, W, FOCAL = 72, 96, 80.0
PLANE, CENTRE, RADIUS, SPEED = 10.0, 5.0, 0.9, 0.35  # depths and sizes in world units, speed in units a frame along x
SPHERE, BACKGROUND = 7, 2  # object ids


def translation(x):
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


class Analytic:
    """Pinhole camera at the origin looking along +z, static plane z = PLANE, sphere at x = SPEED · number."""

    def __init__(self, pan=0.0):
        self.pan = pan  # camera translation along x a frame

    def entry(self, number):
        to_pixel = np.array([[FOCAL, 0, W / 2, 0], [0, FOCAL, H / 2, 0], [0, 0, 1, 0], [0, 0, 1, 0.0]])
        return {
            "number": number,
            "world_to_pixel": (to_pixel @ translation(-self.pan * number)).tolist(),
            "camera_origin": [self.pan * number, 0, 0],
            "object_to_world": {str(SPHERE): translation(SPEED * number).tolist()},
        }

    def scene(self, numbers):
        return {"frames": [self.entry(n) for n in numbers], "objects": {str(SPHERE): "sphere"}}

    def frame(self, number):
        """Position, id, and both motions in closed form."""
        y, x = np.meshgrid(np.arange(H) + 0.5, np.arange(W) + 0.5, indexing="ij")
        d = np.stack([(x - W / 2) / FOCAL, (y - H / 2) / FOCAL, np.ones_like(x)])
        origin = np.array([self.pan * number, 0, 0])[:, None, None]
        centre = np.array([SPEED * number, 0, CENTRE])[:, None, None] - origin
        b, c = (d * centre).sum(0), (centre**2).sum() - RADIUS**2
        discriminant = b**2 - (d**2).sum(0) * c
        hit = discriminant > 0
        z = np.where(hit, (b - np.sqrt(np.maximum(discriminant, 0))) / (d**2).sum(0), PLANE)
        speed = np.where(hit, SPEED, 0) - self.pan  # relative to the camera
        motion = np.stack([-FOCAL * speed / z, np.zeros_like(z)])

        def layer(array):
            return torch.from_numpy(np.asarray(array, np.float32))[None]

        return Frame(
            torch.ones(1, 3, H, W),
            motion=layer(motion),
            motion_next=layer(-motion),
            position=layer(d * z + origin),
            id=layer(np.where(hit, SPHERE, BACKGROUND)[None]),
            depth=layer(z[None]),
            number=number,
        )


def between(position, ids, here, there):
    """`motion_between` for tensors."""
    return torch.from_numpy(motion_between(position[0].numpy(), ids[0].numpy(), here, there))[None]


def completed(frame, scene):
    """`complete` for tensors."""
    return complete(frame.map(torch.Tensor.numpy), scene).map(torch.from_numpy)


def test_dual_motion_is_equation_2_where_the_sphere_uncovered_the_plane():
    world = Analytic()
    before, now = world.frame(0), world.frame(1)
    dual = dual_motion(now.motion, before.motion_next)
    was, is_ = before.id == SPHERE, now.id == SPHERE
    uncovered = was & ~is_
    assert uncovered.sum() > 100

    # Static plane, static camera: y = x. The sphere's point seen at y moved by FOCAL · SPEED / z(y), so dual = -(that,
    # 0).
    expected = -FOCAL * SPEED / before.depth
    torch.testing.assert_close(dual[:, :1][uncovered], expected[uncovered], atol=1e-5, rtol=1e-5)
    assert dual[:, 1:][uncovered].abs().max() == 0
    assert torch.equal(occlusion_mask(dual, now.motion) & ~is_, uncovered)

    # Where nothing was uncovered dual is the traditional motion: exactly on the plane, up to the nearest fetch on the
    # sphere.
    assert torch.equal(dual[:, :1][~was & ~is_], now.motion[:, :1][~was & ~is_])
    inside = is_ & (torch.nn.functional.avg_pool2d(is_.float(), 9, 1, 4) == 1)
    assert (dual - now.motion).abs()[inside.expand(-1, 2, -1, -1)].max() < 0.5


@pytest.mark.parametrize("pan", [0.0, 0.2])
def test_motion_from_positions_is_the_closed_form(pan):
    world = Analytic(pan)
    now = world.frame(3)
    for layer, number in (("motion", 2), ("motion_next", 4)):
        computed = between(now.position, now.id, world.entry(3), world.entry(number))
        torch.testing.assert_close(computed, getattr(now, layer), atol=1e-4, rtol=1e-5)


def test_both_sources_of_dual_motion_agree():
    world = Analytic(pan=0.1)
    before, now = world.frame(0), world.frame(1)
    scene = world.scene(range(-1, 3))
    bare = [Frame(f.radiance, position=f.position, id=f.id, number=f.number) for f in (before, now)]
    computed = [completed(frame, scene) for frame in bare]
    from_layers = dual_motion(now.motion, before.motion_next)
    from_positions = dual_motion(computed[1].motion, computed[0].motion_next)
    torch.testing.assert_close(from_positions, from_layers, atol=1e-4, rtol=1e-5)


def test_motion_from_scene_fills_only_what_is_missing_and_known():
    world = Analytic()
    frame = Frame(torch.ones(1, 3, H, W), position=world.frame(1).position, id=world.frame(1).id, number=1)
    filled = completed(frame, world.scene([0, 1]))
    assert filled.motion is not None and filled.motion_next is None
    assert completed(frame, world.scene([0])).motion is None
    given = Frame(torch.ones(1, 3, H, W), motion=torch.ones(1, 2, H, W), position=frame.position, id=frame.id, number=1)
    assert torch.equal(completed(given, world.scene([0, 1])).motion, given.motion)


def test_sky_moves_with_the_rotation_of_the_camera_only():
    angle = 0.1
    turn = np.eye(4)
    turn[0, 0] = turn[2, 2] = math.cos(angle)
    turn[0, 2], turn[2, 0] = -math.sin(angle), math.sin(angle)
    here = Analytic().entry(0)
    moved = {**here, "world_to_pixel": (np.array(here["world_to_pixel"]) @ translation(-3)).tolist()}
    turned = {**here, "world_to_pixel": (np.array(here["world_to_pixel"]) @ turn).tolist()}
    position, miss = torch.zeros(1, 3, H, W), torch.zeros(1, 1, H, W)
    assert between(position, miss, here, moved).abs().max() < 1e-5
    # The pixel in the middle looks along +z, which the turn takes to an angle of -0.1 about y.
    centre = between(position, miss, here, turned)[0, :, H // 2, W // 2]
    ray = turn[:3, :3] @ np.array([0.5 / FOCAL, 0.5 / FOCAL, 1])
    assert centre[0].item() == pytest.approx(FOCAL * ray[0] / ray[2] - 0.5, abs=1e-4)


def test_points_behind_the_other_camera_leave_the_screen():
    here = Analytic().entry(0)
    back = np.eye(4)
    back[2, 3] = -20
    there = {**here, "world_to_pixel": (np.array(here["world_to_pixel"]) @ back).tolist()}
    frame = Analytic().frame(0)
    assert not on_screen(between(frame.position, frame.id, here, there)).any()


def test_on_screen_at_the_borders():
    motion = torch.zeros(1, 2, 1, 4)
    motion[0, 0, 0] = torch.tensor([-0.5, -1.6, math.nan, 0.6])
    assert on_screen(motion).flatten().tolist() == [True, False, False, False]


def test_dual_motion_off_the_screen_is_traditional():
    motion = torch.full((1, 2, 4, 4), 10.0)
    assert torch.equal(dual_motion(motion, torch.rand(1, 2, 4, 4)), motion)


def test_occlusion_weights_of_equation_5():
    on, off = torch.ones(1, 1, 1, 1, dtype=torch.bool), torch.zeros(1, 1, 1, 1, dtype=torch.bool)
    assert occlusion_weights([on, off, off]).item() == 1
    assert occlusion_weights([off, on, off]).item() == pytest.approx(0.8)
    assert occlusion_weights([off, off, on]).item() == pytest.approx(0.6)
    assert occlusion_weights([on]).item() == pytest.approx(2.4)  # missing masks are taken as M⁰


def test_same_surface_rejects_another_depth_or_facing():
    depth, normal, still = torch.full((1, 1, 2, 2), 5.0), torch.zeros(1, 3, 2, 2), torch.zeros(1, 2, 2, 2)
    normal[:, 2] = 1
    assert same_surface(depth, normal, depth * 1.05, normal, still).all()
    assert not same_surface(depth, normal, depth * 1.5, normal, still).any()
    assert not same_surface(depth, normal, depth, -normal, still).any()
    assert not same_surface(depth, normal, depth * 0, normal, still).any()
    assert same_surface(depth * 0, normal, depth * 0, -normal, still).all()


# --- approximate dual motion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pan", [0.0, 0.2, -0.35])
def test_splat_finds_the_motion_of_what_uncovered_the_plane(pan):
    world = Analytic(pan)
    before, now = world.frame(0), world.frame(1)
    exact = dual_motion(now.motion, before.motion_next)
    approximate = dual_motion(now.motion, splat_motion_next(now.motion, now.depth, before.depth))
    masks = [occlusion_mask(dual, now.motion) & (now.id == BACKGROUND) for dual in (exact, approximate)]
    assert masks[0].sum() > 100
    assert torch.equal(*masks)
    # Inside, the occluder's motion up to the depth that differs over the sphere: it is read where it is visible now.
    assert (exact - approximate).norm(dim=1, keepdim=True)[masks[0]].max() < 0.5
    # Elsewhere on the plane nothing changes.
    still = (now.id == BACKGROUND) & ~masks[0] & on_screen(now.motion)
    torch.testing.assert_close(approximate[still.expand(-1, 2, -1, -1)], now.motion[still.expand(-1, 2, -1, -1)])


def test_splat_closes_the_cracks_of_a_surface_that_shrank():
    """A near square goes from 16 to 8 pixels: three of four old pixels receive nothing of it."""
    before, now = torch.full((1, 1, 32, 32), 9.0), torch.full((1, 1, 32, 32), 9.0)
    before[..., 8:24, 8:24] = 4.0
    now[..., 12:20, 12:20] = 4.2
    index = torch.arange(32.0)
    u = torch.where((index >= 12) & (index < 20), index - 15.5, 0.0)  # a pixel at 15.5 + u was at 15.5 + 2u
    square = (now == 4.2).float()
    motion = torch.cat([square * u, square * u[:, None]], dim=1)
    out = splat_motion_next(motion, now, before)
    hidden = (before == 4.0) & (now == 9.0)  # the background does not move: x = y
    expected = (15.5 - index).expand(1, 1, 32, 32) / 2
    assert (out[:, :1] - expected)[hidden].abs().max() < 1.5
    assert torch.equal(occlusion_mask(dual_motion(motion, out), motion) & (now == 9.0), hidden)


def test_splat_of_a_batch_is_the_splat_of_each_and_repeats():
    frames = [Analytic(pan) for pan in (0.0, 0.3)]
    motion, depth = (torch.cat([getattr(w.frame(1), n) for w in frames]) for n in ("motion", "depth"))
    before = torch.cat([w.frame(0).depth for w in frames])
    both = splat_motion_next(motion, depth, before)
    assert torch.equal(both, splat_motion_next(motion, depth, before))
    for i in range(2):
        alone = splat_motion_next(motion[i : i + 1], depth[i : i + 1], before[i : i + 1])
        assert torch.equal(both[i : i + 1], alone)


def test_splat_without_motion_depth_or_sense():
    still, hit = torch.zeros(1, 2, 4, 5), torch.ones(1, 1, 4, 5)
    assert splat_motion_next(still, hit, hit).abs().max() == 0
    assert splat_motion_next(still, hit * 0, hit * math.inf).abs().max() == 0  # sky on both
    gone = splat_motion_next(still + 1e4, hit, hit)
    assert (gone == OFF_SCREEN).all()
    assert splat_motion_next(torch.full_like(still, math.nan), hit, hit).isfinite().all()
    with pytest.raises(ValueError, match=r"expected depth_previous \(1, 1, 4, 5\)"):
        splat_motion_next(still, hit, hit[..., :3])
