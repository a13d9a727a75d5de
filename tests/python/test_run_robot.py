"""A run knows its robot: what happens when the robot file changes, goes away, or belongs to another run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ConfigError, DappoError, Policy
from dappo_batch._core import run_cli

from .mesh_robot import write_mesh_robot

STEPS = 64
SETTINGS: dict[str, Any] = {
    "horizon": 16,
    "env.max_episode_steps": 20,
    "ppo.hidden": [8],
    "evaluation.episodes": 1,
    "damage.max_damaged_limbs": 1,
}
GEAR = ("tripod.xml", 'joint="west_knee"/>', 'joint="west_knee" kp="9"/>')
REWARD = ("tripod.toml", "weight = -0.01", "weight = -0.02")
ORDER = ("tripod.toml", '["missing_toe", "jammed_joint"]', '["jammed_joint", "missing_toe"]')
LIMBS = ("tripod.toml", 'name = "north"', 'name = "nord"')
MESH = ("looks/shapes/hat.obj", "v 0 0 0.1", "v 0 0 0.2")
Edit = tuple[str, str, str]


def edit(robot: Path, change: Edit) -> None:
    path = robot.parent / change[0]
    text = path.read_text()
    assert text.count(change[1]) == 1
    path.write_text(text.replace(change[1], change[2]))


def train(run: Path, robot: Path | str, **options: Any) -> Path:  # noqa: ANN401
    options.setdefault("total_steps", STEPS)
    dappo_batch.train(run, robot=str(robot), num_envs=4, threads=1, set=SETTINGS, **options)
    return run


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train policies and a diagnoser on a robot of several files."""
    root = tmp_path_factory.mktemp("robots")
    robot = write_mesh_robot(root / "robot")
    train(root / "aware", robot)
    train(root / "unaware", robot, unaware=True)
    train(root / "expert", robot, healthy=True)
    dappo_batch.collect_pairs(
        root / "aware", root / "pairs", rollouts=4, timesteps=6, preset="residual", threads=1
    )
    small = {"epochs": 1, "embedding": 8, "lstm": 4, "hidden": []}
    dappo_batch.train_diagnoser(root / "pairs", root / "diagnoser", set=small, threads=1)
    return root


@pytest.fixture
def place(trained: Path, tmp_path: Path) -> Path:
    """Copy everything; the runs name the robot of the copy, as if it had been trained there."""
    root = tmp_path / "place"
    shutil.copytree(trained, root)
    for run in ("aware", "unaware", "expert"):
        config = root / run / "config.toml"
        config.write_text(config.read_text().replace(str(trained), str(root)))
    return root


def refusal(call: Callable[[], Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (GEAR, "tripod.xml:"),
        (REWARD, "tripod.toml: reward.paper.terms[1].weight: -0.01 → -0.02"),
        (ORDER, 'tripod.toml: damage.types: ["missing_toe", "jammed_joint"] →'),
        (LIMBS, 'tripod.toml: limbs[0].name: "north" → "nord"'),
        (MESH, "hat.obj: SHA-256"),
    ],
)
def test_a_changed_robot_file_is_an_error_with_the_differences(
    change: Edit, expected: str, place: Path
) -> None:
    edit(place / "robot" / "tripod.toml", change)
    for call in (
        lambda: dappo_batch.evaluate(place / "aware", threads=1),
        lambda: dappo_batch.resume(place / "aware", total_steps=2 * STEPS, threads=1),
    ):
        message = refusal(call)
        assert message.startswith(
            f"{place / 'aware'}: its robot {place / 'robot' / 'tripod.toml'} has changed"
        )
        assert expected in message
        assert "--robot-changed use-run" in message
        assert "use-file" in message
    assert len((place / "aware" / "metrics.jsonl").read_text().splitlines()) == 1


def test_every_command_that_reads_a_run_finds_out(place: Path, tmp_path: Path) -> None:
    edit(place / "robot" / "tripod.toml", GEAR)
    aware, diagnoser = place / "aware", place / "diagnoser"
    calls: list[Callable[[], Any]] = [
        lambda: Policy.load(aware),
        lambda: dappo_batch.Controller(aware, diagnoser=diagnoser),
        lambda: dappo_batch.Diagnoser.load(diagnoser, expert=aware),
        lambda: dappo_batch.adapt(aware, diagnoser, damage="missing_toe@0", threads=1),
        lambda: dappo_batch.collect_pairs(aware, tmp_path / "pairs", rollouts=1, timesteps=2),
        lambda: dappo_batch.evaluate_diagnoser(diagnoser, data=[place / "pairs"], policy=aware),
        lambda: dappo_batch.evaluate(aware, compare=[place / "unaware"]),
    ]
    for call in calls:
        assert "has changed since the training" in refusal(call)
    assert run_cli(["export", str(aware), "--out", str(tmp_path / "export")]) == 1
    assert run_cli(["render", str(aware), "--out", str(tmp_path / "film.gif")]) == 1
    assert list(tmp_path.iterdir()) == [place]


def test_with_use_run_everything_is_as_it_was_and_with_use_file_as_the_file_is(place: Path) -> None:
    aware = place / "aware"

    def rewards(**options: Any) -> list[float]:  # noqa: ANN401
        found = dappo_batch.evaluate(aware, threads=1, **options).runs[0].classes
        return [entry.forward_reward for entry in found]

    before = rewards()
    edit(place / "robot" / "tripod.toml", GEAR)
    assert rewards(robot_changed="use-run") == before
    changed = rewards(robot_changed="use-file")
    assert changed != before
    # The same as if the policy had never known another robot.
    shutil.rmtree(aware / "robot")
    assert rewards() == changed
    obs = np.zeros(Policy.load(aware).obs_dim)
    np.testing.assert_array_equal(
        Policy.load(aware, robot_changed="use-file").act(obs), Policy.load(aware).act(obs)
    )
    assert "robot_changed must be one of 'use-run', 'use-file'" in refusal(
        lambda: Policy.load(aware, robot_changed="neither")  # type: ignore[arg-type]
    )


def test_a_run_that_cannot_use_the_changed_file_keeps_its_own_robot(place: Path) -> None:
    run = train(place / "run", place / "robot" / "tripod.toml", backend="mujoco")
    kept = (run / "robot" / "robot.xml").read_text()
    # Observations and actions stay as they are, the states of the checkpoint do not fit any more.
    filtered = '<general joint="west_knee" dyntype="filter" dynprm="0.1" gainprm="15"/>'
    edit(
        place / "robot" / "tripod.toml", (GEAR[0], '<position name="west_knee" joint="west_knee"/>', filtered)
    )
    with pytest.raises(DappoError, match="its envs are not those of this run"):
        dappo_batch.resume(run, total_steps=2 * STEPS, threads=1, robot_changed="use-file")
    assert (run / "robot" / "robot.xml").read_text() == kept
    dappo_batch.resume(run, total_steps=2 * STEPS, threads=1, robot_changed="use-run")


def test_a_run_resumed_with_the_changed_file_keeps_a_copy_of_it(place: Path) -> None:
    aware = place / "aware"
    edit(place / "robot" / "tripod.toml", GEAR)
    kept = (aware / "robot" / "robot.xml").read_text()
    dappo_batch.resume(aware, total_steps=2 * STEPS, threads=1, robot_changed="use-run")
    assert (aware / "robot" / "robot.xml").read_text() == kept
    # The file has changed on one side alone.
    changed = {"total_steps": 3 * STEPS, "threads": 1, "robot_changed": "use-file"}
    assert "ppo.symmetry=false" in refusal(lambda: dappo_batch.resume(aware, **changed))
    dappo_batch.resume(aware, **changed, set={"ppo.symmetry": False})
    assert 'kp="9"' in (aware / "robot" / "robot.xml").read_text()
    dappo_batch.evaluate(aware, threads=1)
    assert "--robot-changed" in (
        refusal(lambda: dappo_batch.evaluate(aware, compare=[place / "unaware"], threads=1))
    )


def test_a_run_whose_robot_file_is_gone_uses_its_own_copy(place: Path, tmp_path: Path) -> None:
    moved = (place / "aware").rename(tmp_path / "moved")
    shutil.rmtree(place / "robot")
    evaluation = dappo_batch.evaluate(moved, threads=1)
    assert len(evaluation.runs[0].classes) == 7
    dappo_batch.resume(moved, total_steps=2 * STEPS, threads=1)
    assert "robot" in refusal(lambda: dappo_batch.evaluate(moved, robot_changed="use-file"))


def test_a_robot_file_that_cannot_be_read_any_more_is_no_obstacle_to_use_run(place: Path) -> None:
    (place / "robot" / "tripod.toml").write_text("name = ")
    assert "can no longer be read" in refusal(lambda: dappo_batch.evaluate(place / "aware"))
    dappo_batch.evaluate(place / "aware", threads=1, robot_changed="use-run")


def test_a_run_of_an_earlier_version_is_used_with_a_note_and_gets_its_copy_when_resumed(
    place: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    aware = place / "aware"
    shutil.rmtree(aware / "robot")
    dappo_batch.evaluate(aware, threads=1)
    assert f"{aware} keeps no copy of its robot" in capfd.readouterr().err
    assert not (aware / "robot").exists()
    dappo_batch.resume(aware, total_steps=2 * STEPS, threads=1)
    capfd.readouterr()
    edit(place / "robot" / "tripod.toml", GEAR)
    assert "has changed since the training" in refusal(lambda: dappo_batch.evaluate(aware))
    assert "keeps no copy" not in capfd.readouterr().err


def test_a_configuration_that_gives_the_code_another_meaning_is_rejected(place: Path) -> None:
    config = place / "aware" / "config.toml"
    config.write_text(config.read_text().replace("severity = 1.0", "severity = 0.5"))
    message = refusal(lambda: dappo_batch.evaluate(place / "aware"))
    assert "config.toml changes the meaning of the damage code" in message
    assert "damage.severity: 1.0 → 0.5" in message


def test_parts_that_were_made_with_another_version_of_the_robot_are_rejected(
    place: Path, tmp_path: Path
) -> None:
    edit(place / "robot" / "tripod.toml", GEAR)
    for run in ("newer", "newer_unaware"):
        train(place / run, place / "robot" / "tripod.toml", unaware=run.endswith("unaware"))
    newer, old = place / "newer", place / "diagnoser"
    # The old runs have no copy to compare with the file, so the difference is between folders.
    for run in ("aware", "unaware", "expert"):
        config = place / run / "config.toml"
        config.write_text(config.read_text().replace(str(place / "robot"), str(place / "gone")))
    calls: dict[str, Callable[[], Any]] = {
        "diagnoser": lambda: dappo_batch.adapt(newer, old, damage="missing_toe@0", threads=1),
        "expert": lambda: dappo_batch.Controller(newer, diagnoser=old, expert=place / "expert"),
        "unaware": lambda: dappo_batch.evaluate(newer, compare=[place / "unaware"], threads=1),
        "pairs": lambda: dappo_batch.collect_pairs(
            newer, place / "pairs", rollouts=5, timesteps=6, preset="residual"
        ),
    }
    for name, call in calls.items():
        message = refusal(call)
        assert f"{place / name} was created with another version of the robot than {newer}" in message
        assert 'kp="9"' in message
    assert run_cli(["export", str(newer), "--diagnoser", str(old), "--out", str(tmp_path / "export")]) == 1
    # Without the difference everything goes together.
    dappo_batch.Controller(place / "aware", diagnoser=old, expert=place / "expert")
    dappo_batch.evaluate(newer, compare=[place / "newer_unaware"], threads=1)


def test_a_reward_sets_no_two_runs_apart(place: Path) -> None:
    edit(place / "robot" / "tripod.toml", REWARD)
    train(place / "newer", place / "robot" / "tripod.toml", unaware=True)
    config = place / "aware" / "config.toml"
    config.write_text(config.read_text().replace(str(place / "robot"), str(place / "gone")))
    dappo_batch.evaluate(place / "aware", compare=[place / "newer"], threads=1)


def test_the_copy_is_a_robot_of_its_own(place: Path) -> None:
    for folder in ("aware", "pairs", "diagnoser"):
        copy = place / folder / "robot"
        assert {path.name for path in copy.iterdir()} == {
            *("robot.toml", "robot.xml", "robot.json", "robot-hat.obj", "robot-red.png")
        }
        assert json.loads((copy / "robot.json").read_text())["damage"]["types"][0] == "missing_toe"
    shutil.rmtree(place / "robot")
    table = dappo_batch.compile_class_table(place / "pairs" / "robot" / "robot.toml", max_damaged_limbs=1)
    assert len(table.models) == 7
