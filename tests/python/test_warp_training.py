"""`dappo-batch train --device warp-cpu`: the path of a GPU, from the command to the run folder."""

from __future__ import annotations

import json
import math
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import warp as wp

import dappo_batch
from dappo_batch import ConfigError, SimulationError, devices
from dappo_batch._core import run_cli

from .. import processes
from .burnpack import checkpoint_contents
from .command_line import ITERATION, interrupt_when, metrics

# Episodes of at most 20 steps reach over rollouts of 16. Commands run in this process, which has loaded Warp.
TINY = (
    *("--device", "warp-cpu", "--physics", "euler", "--threads", "1", "--envs", "4", "--set"),
    *("horizon=16", "env.max_episode_steps=20", "ppo.hidden=[8]", "evaluation.episodes=1"),
    *("damage.max_damaged_limbs=1", "damage.onset={first=0,last=9}", "checkpoint.every=100"),
    "curriculum=[{name='first',mix='healthy'},{name='second',mix='uniform'}]",
)
STEPS = 4 * ITERATION


def train(run: Path, steps: int) -> None:
    """Train into a new run folder."""
    assert run_cli(["train", "--run", str(run), "--steps", str(steps), *TINY]) == 0


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train once, unbroken."""
    run = tmp_path_factory.mktemp("finished") / "run"
    train(run, STEPS)
    return run


def test_all_results_of_a_run_contain_backend_and_device(finished: Path) -> None:
    named = {"backend": "warp", "precision": "f32", "device": "warp-cpu", "physics": "euler"}
    assert named.items() <= json.loads((finished / "meta.json").read_text()).items()
    lines = metrics(finished)
    assert all(named.items() <= line.items() for line in lines)
    assert [line["stage"] for line in lines] == ["first", "first", "second", "second"]
    assert [line["diverged"] for line in lines] == [0, 0, 0, 0]
    config = tomllib.loads((finished / "config.toml").read_text())
    # Results of all devices are compared on the CPU.
    assert (config["env"]["device"], config["evaluation"]["device"]) == ("warp-cpu", "cpu")
    header, row, *_ = (finished / "eval" / "per_class.csv").read_text().splitlines()
    assert header.endswith(",backend,precision,device,physics")
    assert row.endswith(",lanes,f64,cpu,euler")


def test_episodes_are_summed_over_rollouts(finished: Path) -> None:
    lines = metrics(finished)
    # 256 env steps in episodes of at most 20, of which 4 have not ended.
    assert sum(line["episodes"] for line in lines) >= 12
    lengths = [line["episode_length"] for line in lines if line["episodes"]]
    assert all(1 <= length <= 20 for length in lengths)
    assert all(line["forward_reward"] is not None for line in lines if line["episodes"])


def test_a_resumed_run_equals_an_uninterrupted_one(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    arguments = ["train", "--run", str(run), "--steps", str(STEPS), *TINY]
    assert run_cli([*arguments, "checkpoint.every=1", "checkpoint.keep=4"]) == 0
    for name in ("00000003", "00000004"):  # as if it had been killed in the second stage
        shutil.rmtree(run / "checkpoints" / name)
    assert run_cli(["train", "--resume", str(run)]) == 0
    assert metrics(run) == metrics(finished)
    newest, other = (max((folder / "checkpoints").glob("0*")) for folder in (run, finished))
    assert newest.name == other.name == "00000004"
    assert checkpoint_contents(newest) == checkpoint_contents(other)


def test_an_evaluation_on_the_device_contains_its_name(
    finished: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = str(finished)
    assert run_cli(["evaluate", run, "--json", "--device", "warp-cpu", "--backend", "mujoco"]) == 0
    (found,) = json.loads(capfd.readouterr().out)["runs"]
    assert (found["backend"], found["precision"], found["device"]) == ("warp", "f32", "warp-cpu")
    assert [entry["episodes"] for entry in found["classes"]] == [1] * 9
    assert all(entry["episode_length"] == 20 or entry["falls"] for entry in found["classes"])
    assert all(math.isfinite(entry["forward_reward"]) for entry in found["classes"])


def test_too_little_room_for_contacts_is_an_error_with_the_number_to_set(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    settings = [*TINY, "env.njmax=8"]
    assert run_cli(["train", "--run", str(tmp_path / "run"), "--steps", str(STEPS), *settings]) == 1
    err = capfd.readouterr().err
    assert "had no room for all constraints of a world (NEFC" in err
    assert "njmax = 8" in err
    assert "--njmax 16, or njmax=16 in Python" in err


def stand_up(**sizes: int) -> None:
    """Let two healthy Ants fall on their feet."""
    envs = dappo_batch.make_vec(
        "ant", 2, device="warp-cpu", physics="euler", max_damaged_limbs=0, seed=0, **sizes
    )
    try:
        envs.reset()
        for _ in range(40):
            envs.step(np.zeros((2, 8), np.float32))
    finally:
        envs.close()


def test_views_of_an_env_of_a_device_are_host_memory_that_warp_shares_through_dlpack() -> None:
    envs = dappo_batch.make_vec(
        "ant", 2, device="warp-cpu", physics="euler", max_damaged_limbs=0, seed=0, copy=False
    )
    try:
        obs, _ = envs.reset()
        shared = wp.from_dlpack(obs)
        assert (shared.shape, shared.dtype, shared.ptr) == (obs.shape, wp.float32, obs.ctypes.data)
        new = envs.step(np.full((2, 8), 0.5, np.float32))[0]
        np.testing.assert_array_equal(shared.numpy(), new)
        assert new.__dlpack_device__() == (1, 0)
    finally:
        envs.close()


def test_an_env_accepts_the_size_in_its_error() -> None:
    with pytest.raises(SimulationError, match=r"\(NEFC; njmax = 2\).*--njmax 4, or njmax=4 in Python"):
        stand_up(njmax=2)
    with pytest.raises(SimulationError, match=r"nconmax = 1\b.*--nconmax 2, or nconmax=2 in Python"):
        stand_up(nconmax=1)
    stand_up(njmax=200, nconmax=50)


@pytest.mark.parametrize("name", ["njmax", "nconmax"])
@pytest.mark.parametrize("value", [0, -1, 2**31, 1.5, "many"])
def test_a_size_that_is_none_is_rejected(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"{name} must be"):
        dappo_batch.make_vec("ant", 1, max_damaged_limbs=0, **{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("flags", [["--njmax", "8"], ["--njmax=8", "--nconmax=100"]])
def test_commands_that_read_a_run_take_sizes_of_their_own(
    flags: list[str], finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    device = ["--device", "warp-cpu", "--threads", "1"]
    collect = ["diagnose", "collect", str(finished), "--out", str(tmp_path / "data"), "--rollouts", "1"]
    for command in (
        ["evaluate", str(finished)],
        [*collect, "--timesteps", "10", "--preset", "runtime"],
        ["render", str(finished), "--out", str(tmp_path / "walk.png"), "--steps", "40"],
    ):
        assert run_cli([*command, *device, *flags]) == 1
        assert "njmax = 8" in capfd.readouterr().err
    with pytest.raises(SimulationError, match="njmax = 8"):
        dappo_batch.evaluate(finished, device="warp-cpu", threads=1, njmax=8)


def test_sizes_hold_for_every_run_of_an_evaluation(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = shutil.copytree(finished, tmp_path / "other")
    made: list[int | None] = []
    opened = devices.open_stepper

    def open_stepper(*arguments: object, **options: Any) -> object:  # noqa: ANN401 - passed on as it is
        made.append(options["nconmax"])
        return opened(*arguments, **options)

    monkeypatch.setattr(devices, "open_stepper", open_stepper)
    dappo_batch.evaluate(finished, compare=[other], episodes=1, device="warp-cpu", threads=1, nconmax=77)
    assert made == [77, 77]


def test_sizes_of_a_training_are_flags_too(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(run, ITERATION)
    assert run_cli(["train", "--resume", str(run), "--steps", str(2 * ITERATION), "--nconmax", "77"]) == 0
    assert tomllib.loads((run / "config.toml").read_text())["env"]["nconmax"] == 77
    resumed = dappo_batch.resume(run, total_steps=3 * ITERATION, nconmax=78)
    assert resumed.config["env"]["nconmax"] == 78


def test_a_checkpoint_of_another_device_is_rejected(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    config = run / "config.toml"
    text = config.read_text()
    assert text.count('device = "warp-cpu"') == 1
    config.write_text(text.replace('device = "warp-cpu"', 'device = "cpu"'))
    arguments: list[Any] = ["train", "--resume", str(run), "--steps", str(2 * STEPS)]
    assert run_cli(arguments) == 1


def test_what_the_kernels_lack_is_refused_by_name(tmp_path: Path) -> None:
    course = {"damage.duration": {"first": 2, "last": 3}}
    with pytest.raises(
        ConfigError, match=r"does not support damage that ends \(damage.duration\); use --device cpu"
    ):
        dappo_batch.train(tmp_path / "run", device="warp-cpu", num_envs=2, set={"horizon": 4, **course})
    with pytest.raises(
        ConfigError, match="the observation term `joint_pos`, the observation term `joint_vel`"
    ):
        dappo_batch.make_vec("go1", 2, device="warp-cpu", max_damaged_limbs=0)
    robot = dappo_batch.load_robot("ant")
    text = robot.toml_text.replace('term = "qvel"', 'term = "qvel", noise = 0.1')
    (tmp_path / "ant.toml").write_text(text)
    (tmp_path / "ant.xml").write_text(robot.mjcf_path.read_text())
    with pytest.raises(
        ConfigError, match="the observation term `qvel` with noise, clip, scale, delay or history; use"
    ):
        dappo_batch.make_vec(tmp_path / "ant.toml", 2, device="warp-cpu", max_damaged_limbs=0)


@pytest.mark.slow
def test_a_vector_env_that_was_not_closed_does_not_keep_a_program_from_ending() -> None:
    program = (
        "import dappo_batch; envs = dappo_batch.make_vec('ant', 2, device='warp-cpu', physics='euler');"
        "envs.reset()"
    )
    done = processes.run([sys.executable, "-c", program], timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_ctrl_c_stops_after_the_iteration_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    lines = run / "metrics.jsonl"
    err = interrupt_when(
        lambda: lines.exists() and lines.read_bytes().count(b"\n") >= 2,
        *("train", "--run", run, "--steps", str(1000 * ITERATION), *TINY),
    )
    assert f"--resume {run}" in err
    assert "Traceback" not in err
    done = len(metrics(run))
    assert max((run / "checkpoints").iterdir()).name == f"{done:08}"
