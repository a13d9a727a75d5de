"""Gymnasium's wrappers `RecordVideo` write films of single and vector envs; they need MoviePy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import av
import gymnasium
import numpy as np
import pytest

pytest.importorskip("moviepy")

from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo

import dappo_batch

# MoviePy leaves the pipes to FFmpeg to the garbage collector, and writes where it has none of its own.
pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("ignore")]

LIMIT, SIDE = 6, 480


def first(episode: int) -> bool:
    return episode == 0


def only_film(folder: Path) -> tuple[int, int, int, float]:
    """Return frames, height, width and frames a second of the film in a folder."""
    (path,) = folder.glob("*.mp4")
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        rate = float(stream.average_rate or 0)
        shapes = [frame.to_ndarray(format="rgb24").shape for frame in file.decode(video=0)]
    return len(shapes), *shapes[0][:2], rate


def test_a_single_env_is_recorded_for_an_episode(tmp_path: Path) -> None:
    env = gymnasium.make(
        "dappo_batch/Ant-v0", render_mode="rgb_array", max_damaged_limbs=1, max_episode_steps=LIMIT
    )
    recorder = RecordVideo(env, str(tmp_path), episode_trigger=first)
    recorder.reset(seed=0)
    done = False
    while not done:
        _, _, terminated, truncated, _ = recorder.step(np.zeros(8, dtype=np.float32))
        done = terminated or truncated
    recorder.close()
    # One frame after the reset and one a step, in real time: an Ant's step takes 0.05 s.
    assert only_film(tmp_path) == (LIMIT + 1, SIDE, SIDE, pytest.approx(20.0))


@pytest.mark.parametrize("make", [gymnasium.make_vec, None])
def test_a_vector_env_is_recorded_with_its_envs_side_by_side(
    make: Callable[..., gymnasium.vector.VectorEnv] | None, tmp_path: Path
) -> None:
    options = {"num_envs": 2, "render_mode": "rgb_array", "max_damaged_limbs": 1, "max_episode_steps": LIMIT}
    envs = dappo_batch.make_vec("ant", **options) if make is None else make("dappo_batch/Ant-v0", **options)
    assert envs.render_mode == "rgb_array"
    recorder = RecordVectorVideo(envs, str(tmp_path), video_aspect_ratio=(2, 1), episode_trigger=first)
    recorder.reset(seed=0)
    for _ in range(LIMIT + 2):  # the next episode begins in the step after the last
        recorder.step(np.zeros((2, 8), dtype=np.float32))
    recorder.close()
    assert only_film(tmp_path)[1:] == (SIDE, 2 * SIDE, pytest.approx(20.0))
    assert only_film(tmp_path)[0] >= LIMIT + 1
