"""Motion from positions and cameras: what a renderer without motion vectors calls."""

import numpy as np
import pytest

from rtdenoise import InputError, pinhole_camera, screen_motion
from rtdenoise.frame import OFF_SCREEN

SIZE = H, W = 24, 40
# Columns: the axes of a camera at the origin that looks along world +z with +y up, in each convention.
STANDING = {
    "mitsuba": np.eye(4),  # x left: with +z ahead and +y up, world +x is on the left
    "opengl": np.diag([-1.0, 1, -1, 1]),
    "opencv": np.diag([-1.0, -1, 1, 1]),
}


def moved(matrix, x=0.0, y=0.0, z=0.0):
    shift = np.eye(4)
    shift[:3, 3] = x, y, z
    return shift @ matrix


def wall(distance=4.0):
    """Positions that the standing camera sees on a wall across its axis."""
    focal = W / 2 / np.tan(np.radians(60) / 2)
    y, x = np.mgrid[:H, :W] + 0.5
    return np.stack([(W / 2 - x) / focal, (H / 2 - y) / focal, np.ones_like(x)], axis=2) * distance, focal


@pytest.mark.parametrize("convention", STANDING)
def test_a_point_is_seen_where_it_is(convention):
    position, _ = wall()
    camera = pinhole_camera(STANDING[convention], 60, SIZE, convention)
    seen = np.tensordot(np.concatenate([position, np.ones((H, W, 1))], axis=2), camera, (2, 1))
    y, x = np.mgrid[:H, :W] + 0.5
    np.testing.assert_allclose(seen[..., :2] / seen[..., 2:], np.stack([x, y], axis=2), atol=1e-9)


def test_a_camera_that_steps_aside_moves_the_near_more_than_the_far():
    position, focal = wall(4.0)
    position[: H // 2] *= 2
    here, before = (pinhole_camera(moved(STANDING["mitsuba"], x=x), 60, SIZE) for x in (0.0, -0.5))
    motion = screen_motion(position, here, before)
    assert motion.shape == (H, W, 2) and motion.dtype == np.float32
    np.testing.assert_allclose(motion[H // 2 :, :, 0], -0.5 * focal / 4, rtol=1e-6)  # x points left: so does the shift
    np.testing.assert_allclose(motion[: H // 2, :, 0], -0.5 * focal / 8, rtol=1e-6)
    np.testing.assert_allclose(motion[..., 1], 0, atol=1e-5)


def test_objects_move_by_their_poses_and_the_sky_by_rotation_alone():
    position, focal = wall(4.0)
    ids = np.zeros(SIZE)
    ids[:, :10], position[:, 30:] = 7, 0.0  # an object on the left, sky on the right
    camera = pinhole_camera(STANDING["mitsuba"], 60, SIZE)
    poses = {7: np.eye(4)}, {7: moved(np.eye(4), x=0.2, y=0.1)}
    motion = screen_motion(position, camera, camera, ids=ids, poses=poses[0], other_poses=poses[1])
    np.testing.assert_allclose(motion[:, :10], np.broadcast_to([-0.2, -0.1], (H, 10, 2)) * focal / 4, rtol=1e-5)
    np.testing.assert_allclose(motion[:, 10:], 0, atol=1e-5)
    aside = pinhole_camera(moved(STANDING["mitsuba"], x=3.0), 60, SIZE)
    np.testing.assert_allclose(screen_motion(position, camera, aside)[:, 30:], 0, atol=1e-4)


def test_there_and_back_cancel_out():
    position, _ = wall(5.0)
    here, there = (pinhole_camera(moved(STANDING["mitsuba"], x=x, z=x), 60, SIZE) for x in (0.0, 0.3))
    forward = screen_motion(position, here, there)
    assert abs(forward).max() > 0.5
    four = np.insert(here, 2, [0, 0, 0, 1], axis=0), np.insert(there, 2, [0, 0, 0, 1], axis=0)  # with a row for depth
    assert np.array_equal(screen_motion(position, *four), forward)


def test_points_behind_the_other_camera_are_off_the_screen():
    position, _ = wall(2.0)
    here, there = (pinhole_camera(moved(STANDING["mitsuba"], z=z), 60, SIZE) for z in (0.0, 5.0))
    assert (screen_motion(position, here, there) == OFF_SCREEN).all()


def orthographic(to_world):
    """4 units wide; `[4, 4]`, axes as OpenGL's."""
    to_pixel = np.array([[W / 4, 0, 0, W / 2], [0, -W / 4, 0, H / 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    return to_pixel @ np.linalg.inv(to_world)


def test_an_orthographic_camera_moves_all_surfaces_alike_and_no_sky():
    position, _ = wall(4.0)
    position[: H // 2] *= 2
    position[:, 30:] = 0
    motion = screen_motion(position, orthographic(np.eye(4)), orthographic(moved(np.eye(4), x=-0.5, z=1)))
    np.testing.assert_allclose(motion[:, :30], np.broadcast_to([0.5 * W / 4, 0], (H, 30, 2)), atol=1e-5)
    assert (motion[:, 30:] == 0).all()


@pytest.mark.parametrize("camera, world", [(1e-9, 1), (1e9, 1), (1, 1e-7), (1, 1e7)])
def test_the_scale_of_cameras_and_world_means_nothing(camera, world):
    position, _ = wall(4.0)
    position[:, 30:] = 0

    def motion(camera, world):
        here, there = (
            pinhole_camera(moved(STANDING["mitsuba"], x=x * world, z=z * world), 60, SIZE)
            for x, z in ((0, 0), (0.3, -0.1))
        )
        return screen_motion(position * world, here * camera, there * camera)

    assert (motion(1, 1) != OFF_SCREEN).all()
    np.testing.assert_allclose(motion(camera, world), motion(1, 1), atol=1e-4)


def test_wrong_arguments_are_named():
    position, camera, ids = np.ones((H, W, 3)), np.eye(4), np.ones(SIZE)
    flat, shifted = np.diag([1.0, 1, 0, 1]), moved(np.eye(4), x=1.0)

    def posed(pose, other=camera, keys=(1,)):
        poses = dict.fromkeys(keys, pose), dict.fromkeys(keys, other)
        return lambda: screen_motion(position, camera, camera, ids=ids, poses=poses[0], other_poses=poses[1])

    for call, message in (
        (lambda: screen_motion(np.ones((3, H, W)), camera, camera), r"position: expected \[H, W, 3\], got \(3,"),
        (lambda: screen_motion(position, camera, np.eye(3)), r"other: expected a matrix \[3, 4\] or \[4, 4\], got"),
        (lambda: screen_motion(position, camera, camera, poses={1: camera}), "object 1 has a pose in one of"),
        (lambda: screen_motion(position, camera, camera, poses={1: camera}, other_poses={1: camera}), "poses need ids"),
        (lambda: screen_motion(position, camera, camera, ids=np.ones((2, 2))), r"ids: expected \(24, 40\) as position"),
        (lambda: pinhole_camera(camera, 60, SIZE, "maya"), "unknown camera convention 'maya'; expected one of mitsuba"),
        (lambda: screen_motion("x", camera, camera), "position: expected numbers, got str"),
        (lambda: posed(camera, keys=("7", 1))(), "poses: expected numbers of objects as in ids, got '7'"),
        (lambda: screen_motion(position, camera, camera, ids=ids, poses=[camera]), "poses: expected object numbers"),
        (lambda: pinhole_camera(camera, "45", SIZE), "fov: expected numbers, got str"),
        (lambda: pinhole_camera(camera, 45, ("24", "40")), "size: expected numbers, got tuple"),
        (lambda: screen_motion(position, flat[[0, 1, 2, 2]], camera), "camera: the matrix is singular or not finite"),
        (lambda: screen_motion(position, camera, camera * np.nan), "other: the matrix is singular or not finite"),
        (posed(camera[:3]), r"pose of object 1: expected a matrix \[4, 4\], got \(3, 4\)"),
        (posed(flat), "pose of object 1: the matrix is singular or not finite"),
        (posed(camera, shifted.T), "pose of object 1: expected a last row of 0, 0, 0, 1; is it transposed"),
        (posed("x"), "pose of object 1: expected numbers, got str"),
        (lambda: pinhole_camera(shifted.T, 60, SIZE), "to_world: expected a last row of 0, 0, 0, 1; is it transposed"),
        (lambda: pinhole_camera(flat, 60, SIZE), "to_world: the matrix is singular or not finite"),
        (lambda: pinhole_camera(np.full((4, 4), np.nan), 60, SIZE), "to_world: expected a last row"),
        (lambda: pinhole_camera(camera, 180, SIZE), "fov: expected degrees between 0 and 180, got 180"),
        (lambda: pinhole_camera(camera, np.nan, SIZE), "fov: expected degrees between 0 and 180, got nan"),
        (lambda: pinhole_camera(camera, "60°", SIZE), "fov: expected numbers, got str"),
        (lambda: pinhole_camera(camera, 60, (0, 9)), r"size: expected \(H, W\) of 1 or more, got \(0, 9\)"),
        (lambda: pinhole_camera(camera, 60, 9), r"size: expected 2 numbers, got an array \(\)"),
        (lambda: pinhole_camera(np.eye(3), 60, SIZE), r"to_world: expected a matrix \[4, 4\], got \(3, 3\)"),
    ):
        with pytest.raises(InputError, match=message):
            call()
