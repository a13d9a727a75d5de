"""The camera shows any robot whole and in the middle: computed with NumPy, and found in drawn frames."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from dappo_batch import ClassTable, ConfigError
from dappo_batch.render import Walk, check_camera, frames
from dappo_batch.render.camera import View, view
from dappo_batch.render.painter import reduced
from dappo_batch.render.scene import painted, scene
from dappo_batch.render.scenery import with_scenery

from .bare_robot import LIMBS, quadruped

WIDTH, HEIGHT = 640, 480
Array = NDArray[np.float64]


def projected(seen: View, step: int, points: Array, aspect: float = WIDTH / HEIGHT) -> Array:
    """Project points, [P, 3], into a frame whose edges are at ±1, [P, 2]: a pinhole camera in NumPy."""
    azimuth, elevation = np.radians([seen.azimuth, seen.elevation])
    ahead = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    up = np.cross(right, ahead)
    rays = points - (seen.lookat[step] - seen.distance * ahead)
    half = np.tan(np.radians(seen.fovy) / 2)
    shown: Array = np.stack([rays @ right / aspect, rays @ up], axis=1) / (rays @ ahead)[:, None] / half
    return shown


def corners(length: float, place: Array) -> Array:
    """Return the corners of the trunk and the ends of the legs of a `quadruped`, m."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    trunk = signs * [0.5 * length, 0.15 * length, 0.08 * length]
    feet = np.array([[0.45 * x * length, 0.2 * y * length, -0.54 * length] for x, y in LIMBS.values()])
    return place + np.vstack([trunk, feet])


def walking(table: ClassTable, speed: float, count: int = 120) -> Array:
    states = np.tile(table.models[0].qpos0, (count, 1))
    states[:, 0] += speed * np.arange(count)
    return states


@pytest.mark.parametrize("length", [0.3, 2.0])
@pytest.mark.parametrize("camera", ["auto", "left", "right", "front", "back"])
def test_a_robot_of_any_size_is_whole_and_in_the_middle_of_the_frame_wherever_it_walks(
    length: float, camera: str, tmp_path: Path
) -> None:
    table = quadruped(tmp_path, length)
    states = walking(table, 0.05 * length)
    seen = view(table, states, 0.05, camera=camera, damage_class=1)
    for step in (0, 60, 119):
        place = states[step, :3]
        ((x, y),) = projected(seen, step, place[None])
        assert abs(x) < 0.01, "the main body is in the middle"
        assert abs(y) < 0.3
        points = projected(seen, step, corners(length, place))
        assert np.abs(points).max() < 1, "nothing is cut off"
        width, height = np.ptp(points, axis=0) / 2
        assert max(width, height) > 0.3, "the robot takes a good part of the frame"
    # A few body lengths away.
    assert 1.2 * length < seen.distance < 4 * length


@pytest.mark.parametrize("size", [(640, 480), (480, 480), (300, 600)])
def test_a_narrow_frame_shows_the_whole_robot_too(size: tuple[int, int], tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    walk = Walk(table, walking(table, 0.0, 3))
    seen = scene(walk, [0], *size).view
    points = projected(seen, 0, corners(1.0, walk.states[0, :3]), size[0] / size[1])
    assert np.abs(points).max() < 1


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("length", [0.3, 2.0])
def test_the_trunk_of_a_robot_without_colours_is_drawn_where_numpy_projects_it(
    length: float, tmp_path: Path
) -> None:
    table = quadruped(tmp_path, length)
    walk = Walk(table, walking(table, 0.1 * length, 40))
    (frame,) = frames(walk, [30], size=(WIDTH, HEIGHT), captioned=False)
    pixels = frame.astype(int)
    # Orange: much more red than blue. Neither sky, floor nor limbs are.
    rows, columns = np.nonzero(pixels[..., 0] > 1.5 * pixels[..., 2])
    seen = view(table, walk.states, walk.step_seconds)
    trunk = projected(seen, 30, corners(length, walk.states[30, :3])[:8])
    expected = (trunk * [1, -1] + 1) / 2 * [WIDTH, HEIGHT]
    assert columns.min() == pytest.approx(expected[:, 0].min(), abs=4)
    assert columns.max() == pytest.approx(expected[:, 0].max(), abs=4)
    assert rows.min() == pytest.approx(expected[:, 1].min(), abs=4)
    assert columns.max() - columns.min() > 0.25 * WIDTH
    # The floor is chequered: its lower edge has a lighter and a darker grey.
    edge = pixels[-1].mean(axis=1)
    assert edge.max() - edge.min() > 10
    # And a sky above, where MuJoCo alone shows black.
    assert pixels[0].min() > 100


@pytest.mark.parametrize("limb", list(LIMBS))
def test_the_camera_stands_on_the_side_of_the_damaged_limb(limb: str, tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    x, y = LIMBS[limb]
    damage_class = table.space.parse(f"jammed_joint@{list(LIMBS).index(limb)}")
    seen = view(table, walking(table, 0.0, 3), 0.05, damage_class=damage_class)
    azimuth = np.radians(seen.azimuth)
    backwards = -np.array([np.cos(azimuth), np.sin(azimuth)])
    towards = np.array([0.45 * x, 0.2 * y]) / np.hypot(0.45, 0.2)
    assert backwards[1] * y > 0, "on its side of the robot"
    assert 0.3 < backwards @ towards < 0.9, "near, and not so that it points at the camera"


@pytest.mark.parametrize(
    ("camera", "azimuth"), [("left", -90.0), ("right", 90.0), ("front", -180.0), ("back", 0.0)]
)
def test_a_side_is_that_of_a_robot_that_faces_x(camera: str, azimuth: float, tmp_path: Path) -> None:
    # MuJoCo's azimuth is the direction in which a camera looks: 90 is +y.
    seen = view(quadruped(tmp_path, 1.0), walking(quadruped(tmp_path, 1.0), 0.0, 2), 0.05, camera=camera)
    assert (seen.azimuth - azimuth) % 360 == 0


@pytest.mark.usefixtures("opengl")
def test_a_camera_of_the_mjcf_shows_what_it_sees(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    walk = Walk(table, walking(table, 0.1, 40))
    # From 3 m right above a trunk of 1 m by 0.3 m, with a field of view of 45 degrees.
    (frame,) = frames(walk, [30], size=(WIDTH, HEIGHT), captioned=False, camera="above")
    pixels = frame.astype(int)
    rows, columns = np.nonzero(pixels[..., 0] > 1.5 * pixels[..., 2])
    scale = HEIGHT / 2 / np.tan(np.radians(22.5)) / (3 - 0.08)
    assert np.ptp(columns) == pytest.approx(1.0 * scale, abs=4)
    assert np.ptp(rows) == pytest.approx(0.3 * scale, abs=4)
    assert columns.mean() == pytest.approx(WIDTH / 2, abs=3)


def test_a_camera_that_the_robot_does_not_have_is_rejected_with_those_that_it_has(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    with pytest.raises(
        ConfigError, match=r"camera is 'top', expected auto, left, right, front, back.*'above'"
    ):
        check_camera(table, "top")
    with pytest.raises(ConfigError, match="camera is 'top'"):
        next(frames(Walk(table, table.models[0].qpos0), [0], camera="top"))
    for name in ("auto", "left", "above"):
        check_camera(table, name)


def test_the_camera_follows_the_path_and_not_the_gait(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    walk = walking(table, 0.04, 200)
    walk[:, 2] += 0.1 * np.sin(np.arange(200))
    seen = view(table, walk, 0.05)
    np.testing.assert_allclose(np.diff(seen.lookat[:, 0]), 0.04, atol=1e-9)
    assert np.ptp(seen.lookat[:, 2]) == 0
    swaying = walk.copy()
    swaying[:, 1] = 0.2 * (-1.0) ** np.arange(200)
    assert np.ptp(view(table, swaying, 0.05).lookat[20:-20, 1]) < 0.05
    # A robot that climbs or falls far stays in the frame.
    walk[:, 2] += 0.1 * np.arange(200)
    high = view(table, walk, 0.05)
    ((_, y),) = projected(high, 150, walk[150, None, :3])
    assert abs(y) < 0.5


def test_floor_sky_light_and_colours_are_added_to_what_is_drawn_alone(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    physics = table.models[0]
    before = physics.geom_rgba.copy(), physics.geom_matid.copy(), physics.geom_size.copy()
    assert (physics.ntex, physics.nmat, physics.nlight) == (0, 0, 0)
    drawn = painted(table, 0, with_scenery(table))
    plane = drawn.geom("floor").id
    texture = drawn.mat_texid[drawn.geom_matid[plane], mujoco.mjtTextureRole.mjTEXROLE_RGB]
    assert drawn.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D
    assert (drawn.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any()
    assert drawn.nlight == 1
    assert drawn.light_castshadow[0]
    greys = np.float32([0.5, 0.5, 0.5, 1.0])
    of_robot = drawn.geom_bodyid > 0
    assert not (drawn.geom_rgba[of_robot] == greys).all(axis=1).any()
    for array, kept in zip((physics.geom_rgba, physics.geom_matid, physics.geom_size), before, strict=True):
        np.testing.assert_array_equal(array, kept)
    assert (physics.ntex, physics.nmat, physics.nlight) == (0, 0, 0)
    # Masses, places and joints are those of the simulated model.
    for name in ("body_pos", "body_mass", "jnt_range", "geom_pos", "qpos0"):
        np.testing.assert_array_equal(getattr(drawn, name), getattr(physics, name))


def test_colours_textures_and_lights_of_a_model_are_kept(tmp_path: Path) -> None:
    looks = (
        '<asset><texture name="sky" type="skybox" builtin="flat" rgb1="1 0 0" width="8" height="48"/>'
        '<texture name="t" type="2d" builtin="checker" rgb1="0 0 1" rgb2="0 1 0" width="8" height="8"/>'
        '<material name="m" texture="t"/></asset>'
        '<default><geom rgba="0.1 0.2 0.3 1"/></default>'
        '<worldbody><light name="lamp" pos="0 0 4"/></worldbody>'
    )
    table = quadruped(tmp_path, 1.0, looks, 'material="m"')
    drawn = painted(table, 0, with_scenery(table))
    physics = table.models[0]
    assert (drawn.ntex, drawn.nmat, drawn.nlight) == (2, 1, 1)
    np.testing.assert_array_equal(drawn.geom_matid, physics.geom_matid)
    np.testing.assert_array_equal(drawn.geom_rgba, physics.geom_rgba)
    np.testing.assert_array_equal(drawn.light_pos, physics.light_pos)


def test_a_floor_that_has_a_colour_alone_is_chequered_in_that_colour(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0, floor='rgba="0.2 0.6 0.2 1"')
    drawn = painted(table, 0, with_scenery(table))
    plane = drawn.geom("floor").id
    assert drawn.geom_matid[plane] >= 0
    np.testing.assert_allclose(drawn.geom_rgba[plane], [0.2, 0.6, 0.2, 1.0], atol=1e-6)


def test_a_robot_whose_file_is_gone_is_shown_as_it_was_compiled(tmp_path: Path) -> None:
    table = quadruped(tmp_path, 1.0)
    table.robot.mjcf_path.unlink()
    drawn = painted(table, 1, with_scenery(table))
    assert drawn.ntex == 0
    np.testing.assert_array_equal(drawn.jnt_range, table.models[1].jnt_range)


@pytest.mark.parametrize("camera", ["auto", "left", "right", "front", "back"])
def test_the_sun_shines_from_the_side_of_the_camera_at_the_height_that_the_model_gives(
    camera: str, tmp_path: Path
) -> None:
    sun = '<worldbody><light type="directional" dir="0.6 0.64 -1.2"/></worldbody>'
    walk = Walk(quadruped(tmp_path, 1.0, sun), walking(quadruped(tmp_path, 1.0, sun), 0.0, 2))
    shown = scene(walk, [0], WIDTH, HEIGHT, camera)
    direction = shown.models[0].light_dir[0]
    # The length of (0.6, 0.64) is 0.877, that of all three 1.486.
    assert direction[2] == pytest.approx(-1.2 / 1.486, abs=1e-3)
    assert np.sort(np.abs(direction[:2])) == pytest.approx([0.0, 0.877 / 1.486], abs=1e-3)
    azimuth = np.radians(shown.view.azimuth)
    assert direction[:2] @ [np.cos(azimuth), np.sin(azimuth)] > -1e-6


def test_smooth_frames_are_the_means_of_the_larger_ones_that_are_drawn() -> None:
    drawn = np.random.default_rng(0).integers(0, 256, (12, 18, 3), dtype=np.uint8)
    # Every pixel in four, then the means of squares of nine of those: exact areas.
    finer = drawn.astype(float).repeat(2, axis=0).repeat(2, axis=1)
    expected = finer.reshape(8, 3, 12, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(reduced(drawn), expected, atol=0.51)
