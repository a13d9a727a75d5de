"""Which backend simulates: who chooses, what is said about it, and that both keep the same promises."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError, ShapeError
from dappo_batch._core import LaneWorlds, run_cli
from dappo_batch.machine import cpu_flags, cpu_name
from dappo_batch.model.clamped_actuators import clamped_without_derivative
from dappo_batch.model.rotation_correction import rotation_correction

from .command_line import ITERATION, TINY, metrics
from .command_line import dappo_batch as command

TRIPOD = Path(__file__).parent / "robots" / "tripod.toml"


def test_the_robots_of_the_package_are_simulated_by_the_lane_engine(table: ClassTable) -> None:
    envs = dappo_batch.make_vec(table, 3)
    assert (envs.backend, envs.precision, envs.backend_note) == ("lanes", "f32", "")


@pytest.mark.parametrize("physics", ["rk4", "euler"])
def test_both_integrators_that_a_user_may_choose_are_known(physics: str) -> None:
    envs = dappo_batch.make_vec("ant", physics=physics, backend="lanes")
    assert envs.backend == "lanes"


def test_a_backend_and_a_precision_can_be_asked_for(ant_table: ClassTable) -> None:
    for backend, precision, expected in (
        ("lanes", "f32", ("lanes", "f32")),
        ("lanes", "f64", ("lanes", "f64")),
        ("mujoco", "f32", ("mujoco", "f64")),  # libmujoco has no choice
    ):
        envs = dappo_batch.make_vec(ant_table, 2, backend=backend, precision=precision)
        assert (envs.backend, envs.precision) == expected
        assert envs.backend_note == ""


def test_a_robot_that_the_lane_engine_does_not_support_falls_back_with_the_reason() -> None:
    table = dappo_batch.compile_class_table(TRIPOD, max_damaged_limbs=0)
    envs = dappo_batch.make_vec(table)
    assert envs.backend == "mujoco"
    assert "tendon `belt` has a spring" in envs.backend_note
    with pytest.raises(ConfigError, match="tendon `belt` has a spring"):
        dappo_batch.make_vec(table, backend="lanes")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backend": "brax"}, "backend must be one of 'auto', 'lanes', 'mujoco', got 'brax'"),
        ({"precision": "f16"}, "precision must be one of 'f32', 'f64', got 'f16'"),
    ],
)
def test_unknown_names_are_rejected_with_the_known_ones(
    ant_table: ClassTable, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        dappo_batch.make_vec(ant_table, **options)
    with pytest.raises(ConfigError, match=message):
        dappo_batch.DamageEnv(ant_table, **options)


def test_the_gymnasium_ids_take_backend_and_precision() -> None:
    env = gymnasium.make("dappo_batch/Ant-v0", backend="lanes", precision="f64")
    assert env.unwrapped._core.backend == "lanes"
    envs = gymnasium.make_vec("dappo_batch/Ant-v0", num_envs=2, backend="mujoco")
    assert envs.backend == "mujoco"


def test_episodes_begin_in_the_same_state_on_every_backend(table: ClassTable) -> None:
    starts = {}
    for backend, precision in (("mujoco", "f64"), ("lanes", "f64"), ("lanes", "f32")):
        envs = dappo_batch.make_vec(table, 40, backend=backend, precision=precision, seed=3, onset=(0, 4))
        obs, infos = envs.reset()
        starts[backend, precision] = (obs, infos, *envs.get_state())
    obs, infos, *state = starts["mujoco", "f64"]
    for key, tolerance in ((("lanes", "f64"), 0.0), (("lanes", "f32"), 1e-6)):
        other_obs, other_infos, *other_state = starts[key]
        np.testing.assert_allclose(other_obs, obs, rtol=0.0, atol=max(tolerance, 1e-7))
        for one, two in zip(other_state, state, strict=True):
            np.testing.assert_allclose(one, two, rtol=0.0, atol=tolerance)
        for name, values in infos.items():
            np.testing.assert_array_equal(other_infos[name], values)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_no_env_depends_on_its_neighbours_in_a_register(
    assert_identical: Callable[..., None], ant_table: ClassTable, precision: str
) -> None:
    options: dict[str, Any] = {"backend": "lanes", "precision": precision, "autoreset": "same_step"}
    many = dappo_batch.make_vec(ant_table, 37, seed=5, max_episode_steps=9, **options)
    few = dappo_batch.make_vec(ant_table, 4, seed=5 + 30, max_episode_steps=9, **options)
    first, second = many.reset()[0], few.reset()[0]
    assert_identical(first[30:34], second)
    rng = np.random.default_rng(0)
    for step in range(30):
        actions = rng.uniform(-1, 1, (37, 8)).astype(np.float32)
        obs, rewards, *_ = many.step(actions)
        other_obs, other_rewards, *_ = few.step(actions[30:34])
        assert_identical(obs[30:34], other_obs, f"step {step}")
        assert_identical(rewards[30:34], other_rewards, f"step {step}")


def test_the_instruction_set_can_be_forced(ant_table: ClassTable, monkeypatch: pytest.MonkeyPatch) -> None:
    classes = np.zeros(1, dtype=np.int64)
    fastest = LaneWorlds(ant_table, classes)
    monkeypatch.setenv("DAPPO_SIMD", "portable")
    portable = LaneWorlds(ant_table, classes, "f32")
    assert (portable.simd, portable.precision) == ("portable", "f32")
    assert LaneWorlds(ant_table, classes, simd=fastest.simd).width == fastest.width
    assert dappo_batch.make_vec(ant_table, 2).backend == "lanes"
    monkeypatch.setenv("DAPPO_SIMD", "mmx")
    for make in (lambda: LaneWorlds(ant_table, classes), lambda: dappo_batch.make_vec(ant_table, 2)):
        with pytest.raises(ConfigError, match=r"DAPPO_SIMD is `mmx`, but this processor has .*`portable`"):
            make()
    assert dappo_batch.make_vec(ant_table, 2, backend="mujoco").backend == "mujoco"


def test_a_training_with_an_unknown_instruction_set_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DAPPO_SIMD", "mmx")
    assert run_cli(["train", "--run", str(tmp_path / "run"), *TINY]) == 1
    assert "DAPPO_SIMD is `mmx`" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_lane_worlds_refuse_what_does_not_fit(ant_table: ClassTable) -> None:
    with pytest.raises(ConfigError, match=r"classes\[1\] is 33, expected 0 to 32"):
        LaneWorlds(ant_table, np.array([0, 33]))
    worlds = LaneWorlds(ant_table, np.array([0, 1]))
    qpos, qvel, ctrl = np.zeros((2, 15)), np.zeros((2, 14)), np.zeros((2, 8))
    with pytest.raises(ShapeError, match=r"qvel has shape \[2, 13\], expected \[2, 14\]"):
        worlds.forward(qpos, qvel[:, 1:].copy(), ctrl)


def test_the_rotation_of_a_body_in_rk4_is_one_that_is_known() -> None:
    assert rotation_correction() in (True, False)


def test_implicitfast_drops_the_derivative_of_a_clamped_actuator_from_mujoco_4_on() -> None:
    assert clamped_without_derivative() == (int(mujoco.__version__.split(".")[0]) >= 4)


def test_the_metadata_of_a_run_contain_processor_and_instruction_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for name in ("portable", ""):
        monkeypatch.setenv("DAPPO_SIMD", name)
        command("train", "--run", tmp_path / f"run{name}", "--steps", str(ITERATION), *TINY)
        meta = json.loads((tmp_path / f"run{name}" / "meta.json").read_text())
        assert meta["cpu"] == cpu_name()
        found.append(meta["simd"])
    assert found[0] == "portable"
    flags = cpu_flags()
    fastest = "avx512" if "avx512f" in flags else "avx2" if "avx2" in flags else "neon"
    assert found[1] == fastest


@pytest.mark.parametrize(("backend", "precision"), [("lanes", "f32"), ("mujoco", "f64")])
def test_all_results_of_a_run_contain_its_backend(tmp_path: Path, backend: str, precision: str) -> None:
    run = tmp_path / "run"
    out, err = command("train", "--backend", backend, "--run", run, "--steps", str(ITERATION), *TINY)
    assert f"backend {backend}, {precision}" in err
    meta = json.loads((run / "meta.json").read_text())
    named = {"backend": backend, "precision": precision, "device": "cpu", "physics": "rk4"}
    assert named.items() <= meta.items()
    assert all(named.items() <= line.items() for line in metrics(run))
    assert f"(backend {backend}, f64)" in out  # evaluations compute in double precision
    header, row, *_ = (run / "eval" / "per_class.csv").read_text().splitlines()
    assert header.endswith(",backend,precision,device,physics")
    assert row.endswith(f",{backend},f64,cpu,rk4")
    out, _ = command("evaluate", run, "--json", "--backend", "lanes", "--precision", "f32")
    (found,) = json.loads(out)["runs"]
    assert (found["backend"], found["precision"], found["device"]) == ("lanes", "f32", "cpu")


def test_a_run_keeps_the_backend_that_was_chosen_for_it(tmp_path: Path) -> None:
    lanes, mujoco = tmp_path / "lanes", tmp_path / "mujoco"
    command("train", "--run", lanes, "--steps", str(ITERATION), *TINY)
    _, err = command("train", "--robot", TRIPOD, "--run", mujoco, "--steps", str(ITERATION), *TINY)
    assert "backend mujoco, f64: the lane engine cannot simulate this robot: tendon `belt`" in err
    found = [tomllib.loads((run / "config.toml").read_text())["env"]["backend"] for run in (lanes, mujoco)]
    assert found == ["lanes", "mujoco"]


def test_the_configuration_has_precisions_for_training_and_evaluation(
    capfd: pytest.CaptureFixture[str],
) -> None:
    def config(*arguments: str) -> tuple[str, str, str]:
        assert run_cli(["config", *arguments]) == 0
        found = tomllib.loads(capfd.readouterr().out)
        return found["env"]["backend"], found["env"]["precision"], found["evaluation"]["precision"]

    assert config() == ("auto", "f32", "f64")
    assert config("--backend", "lanes", "--precision", "f64") == ("lanes", "f64", "f64")
    assert config("--set", "evaluation.precision=f32") == ("auto", "f32", "f32")
