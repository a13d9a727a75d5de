"""Pictures of environments that run, on machines with and without a display."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError, SimulationError
from dappo_batch.envs import DamageEnv
from dappo_batch.render import RenderError, opengl
from dappo_batch.render.live import LivePainter

from .bare_robot import quadruped

PICTURE = (480, 480, 3)


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unset the display and the choice of an OpenGL implementation."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("opengl", "no_display")
def test_an_env_gives_pictures_without_a_display_that_change_with_the_robot_and_its_damage(
    ant_table: ClassTable,
) -> None:
    env = DamageEnv(ant_table, render_mode="rgb_array")
    pictures = {}
    for damage in ("healthy", "missing_toe@0", "healthy again"):
        env.reset(seed=0, options={"damage_class": damage.split()[0]})
        pictures[damage] = env.render()
    healthy = pictures["healthy"]
    assert healthy is not None
    assert (healthy.shape, healthy.dtype) == (PICTURE, np.uint8)
    assert healthy.std() > 1.0
    assert not np.array_equal(healthy, pictures["missing_toe@0"])
    np.testing.assert_array_equal(healthy, pictures["healthy again"])
    for _ in range(3):
        env.step(np.ones(8, dtype=np.float32))
    assert not np.array_equal(healthy, env.render())
    env.close()
    with pytest.raises(SimulationError, match="closed"):
        env.render()


@pytest.mark.usefixtures("opengl", "no_display")
def test_a_vector_env_gives_a_picture_of_each_env_equal_to_that_of_the_single_env(
    ant_table: ClassTable,
) -> None:
    damages = ["healthy", "missing_toe@1"]
    envs = dappo_batch.make_vec(ant_table, 2, render_mode="rgb_array")
    envs.reset(seed=5, options={"damage_class": damages})
    pictures = envs.render()
    assert pictures is not None
    env = DamageEnv(ant_table, render_mode="rgb_array")
    for index, damage in enumerate(damages):
        env.reset(seed=5 + index, options={"damage_class": damage})
        np.testing.assert_array_equal(pictures[index], env.render())
    # The model of the damage alone looks the same as one that became it.
    painter = LivePainter(ant_table, *PICTURE[:2])
    damage_class = ant_table.space.parse(damages[1])
    np.testing.assert_array_equal(painter.draw(damage_class, env.get_state()[0]), pictures[1])
    painter.close()
    env.close()
    envs.close()


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("length", [0.3, 2.0])
def test_a_robot_of_any_size_is_in_the_middle_of_the_frame_wherever_it_is(
    length: float, tmp_path: Path
) -> None:
    envs = dappo_batch.make_vec(quadruped(tmp_path, length), 2, damage="healthy", render_mode="rgb_array")
    envs.reset(seed=0)
    qpos, qvel = envs.get_state()
    qpos[1, :2] += [30.0 * length, -20.0 * length]
    envs.set_state(qpos, qvel)
    frames = envs.render()
    assert isinstance(frames, tuple)
    assert len(frames) == 2
    for frame in frames:
        assert (frame.shape, frame.dtype) == (PICTURE, np.uint8)
        pixels = frame.astype(int)
        # The trunk has the orange of a robot without colours: neither sky, floor nor limbs are as red.
        rows, columns = np.nonzero(pixels[..., 0] > 1.5 * pixels[..., 2])
        middle = np.array([np.median(rows), np.median(columns)]) / PICTURE[:2]
        assert np.abs(middle - 0.5).max() < 0.15
        assert np.ptp(columns) > 0.25 * PICTURE[1]
        assert columns.min() > 0
        assert columns.max() < PICTURE[1] - 1
    envs.close()


def test_without_a_render_mode_there_is_no_picture_and_no_process(
    ant_table: ClassTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opengl, "start", None)
    env, envs = DamageEnv(ant_table), dappo_batch.make_vec(ant_table, 2)
    env.reset()
    envs.reset()
    assert env.render() is None
    assert envs.render() is None
    env.close()
    envs.close()
    with pytest.raises(ConfigError, match="render_mode must be None or 'rgb_array', got 'human'"):
        dappo_batch.make_vec(ant_table, 2, render_mode="human")


def test_without_a_working_opengl_the_error_contains_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "choices", lambda: ["egl", "osmesa"])
    monkeypatch.setattr(opengl, "PAINTER", ("-c", "import sys; sys.exit('no library at all')"))
    env = gymnasium.make("dappo_batch/Ant-v0", render_mode="rgb_array", max_damaged_limbs=1)
    env.reset(seed=0)
    with pytest.raises(RenderError) as caught:
        env.render()
    message = str(caught.value)
    for name in ("egl", "osmesa"):
        assert f"{name}: no library at all" in message
        assert opengl.INSTALL[name] in message
    # The env can still be stepped.
    env.step(env.action_space.sample())
    env.close()


def test_an_opengl_that_fails_in_between_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = f"sys.stdout.buffer.write(bytes({np.prod(PICTURE)})); sys.stdout.flush()"
    program = (
        f"import pickle, sys; [pickle.load(sys.stdin.buffer) for _ in 'ab']; {picture}; sys.exit('crash')"
    )
    monkeypatch.setattr(opengl, "choices", lambda: ["egl"])
    monkeypatch.setattr(opengl, "PAINTER", ("-c", program))
    env = DamageEnv("ant", max_damaged_limbs=1, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render() is not None
    with pytest.raises(RenderError, match="egl failed while drawing: crash"):
        env.render()
    env.close()
