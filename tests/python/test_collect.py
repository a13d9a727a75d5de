"""`dappo-batch diagnose collect`: pairs of damaged robots and healthy twins."""

from __future__ import annotations

import fcntl
import json
import os
import resource
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch as package
from dappo_batch._core import run_cli

from .. import processes
from .command_line import ITERATION, TINY, dappo_batch, dappo_batch_many, files, interrupt_when
from .numpy_policy import mean_actions

CLASSES = 9
STEPS = 6
Array = NDArray[Any]
Collected = dict[str, Path]


@pytest.fixture(scope="module")
def expert(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy for a moment: it walks badly, but on any robot in the same way."""
    run = tmp_path_factory.mktemp("expert") / "run"
    dappo_batch("train", *TINY, "--healthy", "--steps", str(ITERATION), "--run", run)
    return run


@pytest.fixture(scope="module")
def aware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy that observes the damage code for a moment."""
    run = tmp_path_factory.mktemp("aware") / "run"
    dappo_batch("train", *TINY, "--steps", str(ITERATION), "--run", run)
    return run


def arguments(expert: Path, out: Path, *more: str, rollouts: int = 5) -> tuple[str | Path, ...]:
    sizes = ("--rollouts", str(rollouts), "--timesteps", str(STEPS), "--seed", "3")
    preset = () if "--preset" in more else ("--preset", "paper")
    return ("diagnose", "collect", expert, "--out", out, *sizes, *preset, *more)


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory, expert: Path) -> Collected:
    """Collect one small dataset in each of the three ways, with libmujoco."""
    folder = tmp_path_factory.mktemp("pairs")
    names = ("paper", "runtime", "residual")
    commands = [arguments(expert, folder / name, "--preset", name, "--backend", "mujoco") for name in names]
    for code, out, err in dappo_batch_many(*commands):
        assert code == 0, err
        assert "5 rollouts" in out
    return {name: folder / name for name in names}


def records(folder: Path) -> Array:
    """Map the records of a folder into memory and put the shards together."""
    return np.concatenate([np.load(path, mmap_mode="r") for path in sorted(folder.glob("*.npy"))])


def plain_mujoco_step(model: mujoco.MjModel, obs: Array, action: Array) -> Array:
    """One env step of an Ant from the state that an observation shows; return positions and velocities."""
    data = mujoco.MjData(model)
    data.qpos[2:], data.qvel[:] = obs[:13], obs[13:27]
    data.ctrl[:] = np.clip(action, -1, 1)
    mujoco.mj_step(model, data, nstep=5)
    return np.concatenate([data.qpos[2:], data.qvel])


@pytest.mark.parametrize("way", ["paper", "runtime", "residual"])
def test_every_row_follows_from_the_one_before_by_the_expert_and_plain_mujoco(
    way: str, collected: Collected, expert: Path
) -> None:
    models = package.compile_class_table("ant", max_damaged_limbs=1).models
    data = records(collected[way])
    twins = data["twin"] if way != "paper" else data["damaged"][:, :1].repeat(CLASSES, 1)
    checked = 0
    for robot, actions, twin in zip(data["damaged"], data["actions"], twins, strict=True):
        # Actions are the expert's on the robot's own observation of the step before.
        np.testing.assert_allclose(actions[:, 1:], mean_actions(expert, robot[:, :-1]), atol=1e-5)
        own = mean_actions(expert, twin[:, :-1])
        for number, model in enumerate(models):
            for step in range(1, STEPS):
                before, action = robot[number, step - 1], actions[number, step]
                after = plain_mujoco_step(model, before, action)
                twin_before = before if way == "residual" else twin[number, step - 1]
                twin_action = action if way == "residual" else own[number, step - 1]
                twin_after = plain_mujoco_step(models[0], twin_before, twin_action)
                for got, expected in ((robot[number, step], after), (twin[number, step], twin_after)):
                    # The rows are f32, and contacts amplify their rounding; another class is off by 0.1.
                    np.testing.assert_allclose(got[:27], expected, atol=2e-2)
                    checked += 1
    assert checked == 2 * 5 * CLASSES * (STEPS - 1)


def test_numpy_maps_the_records_that_the_header_describes(collected: Collected, expert: Path) -> None:
    classes = package.DamageSpace(4, ["jammed_joint", "missing_toe"], 1).classes
    for way, folder in collected.items():
        header = json.loads((folder / "dataset.json").read_text())
        assert header["subject"]["robot"] == "ant"
        assert header["subject"]["class_names"] == [entry.name for entry in classes]
        assert header["subject"]["codes"] == [entry.code for entry in classes]
        assert header["seed"] == 3
        assert header["expert"]["run"] == str(expert)
        assert header["expert"] == header["policy"]
        assert header["backend"] == "mujoco"
        data = records(folder)
        shape = (CLASSES, STEPS, 111)
        assert data["damaged"].shape == (5, *shape)
        assert data["actions"].shape == (5, CLASSES, STEPS, 8)
        assert ("twin" in (data.dtype.names or ())) == (way != "paper")
        low, high = (0, 0) if way == "paper" else (20, 150)
        assert ((data["onset"] >= low) & (data["onset"] <= high)).all()
        assert (data["fallen"] <= 1).all()
        assert np.isfinite(data["damaged"]).all()


def test_a_re_synchronised_twin_of_a_healthy_robot_does_the_same(collected: Collected) -> None:
    for way, steps in (("runtime", 1), ("residual", STEPS)):
        data = records(collected[way])
        healthy, twin = data["damaged"][:, 0, :steps], data["twin"][:, 0, :steps]
        # Observations are f32, and contact forces amplify their rounding.
        rounding = 2e-3
        np.testing.assert_allclose(healthy[..., :27], twin[..., :27], atol=rounding)
        # A limb that the policy hardly moves in this step does not show that it is jammed.
        damaged = np.abs(data["damaged"][:, 1:, 0, :27] - data["twin"][:, 1:, 0, :27]).max(-1)
        assert np.mean(damaged > 10 * rounding) > 0.4, "most damage shows in the first step already"


def test_every_damage_class_of_a_rollout_begins_in_the_same_state(collected: Collected) -> None:
    first = records(collected["paper"])["actions"][:, :, 0]
    # A missing toe changes the first observation by its contacts alone, which a reset does not show.
    np.testing.assert_array_equal(first, first[:, :1].repeat(CLASSES, 1))
    assert len(np.unique(first[:, 0], axis=0)) == 5, "every rollout has a start of its own"


def test_shards_threads_and_extensions_do_not_change_the_records(expert: Path, tmp_path: Path) -> None:
    whole, pieces, longer = (tmp_path / name for name in ("whole", "pieces", "longer"))
    preset = ("--preset", "runtime")
    done = dappo_batch_many(
        arguments(expert, whole, *preset, "--threads", "2"),
        arguments(expert, pieces, *preset, "--shard", "1/2", "--threads", "1"),
        arguments(expert, pieces, *preset, "--shard", "0/2"),
        arguments(expert, longer, *preset, rollouts=2),
        arguments(expert, longer, *preset),
    )
    assert [code for code, _, _ in done] == [0] * 5, done
    expected = records(whole)
    assert len(expected) == 5
    assert len(list(pieces.glob("*.npy"))) == 2
    for other in (pieces, longer):
        assert records(other).tobytes() == expected.tobytes()
        assert files(other)["dataset.json"] == files(whole)["dataset.json"]


def test_data_after_the_last_complete_record_are_overwritten_after_a_kill(
    expert: Path, tmp_path: Path
) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    dappo_batch(*arguments(expert, whole))
    dappo_batch(*arguments(expert, cut, rollouts=3))
    path = cut / "rollouts-000000.npy"
    with path.open("ab") as file:
        file.write(b"half a record")
    assert len(np.load(path, mmap_mode="r")) == 3, "valid at any moment"
    dappo_batch(*arguments(expert, cut))
    assert files(cut) == files(whole)
    # A kill within the first write leaves less than a header.
    path.write_bytes(path.read_bytes()[:100])
    dappo_batch(*arguments(expert, cut))
    assert files(cut) == files(whole)


@pytest.mark.slow
def test_ctrl_c_keeps_complete_blocks_and_the_same_command_resumes(expert: Path, tmp_path: Path) -> None:
    out, reference = tmp_path / "data", tmp_path / "reference"
    command = arguments(expert, out, "--preset", "runtime", rollouts=340)
    path = out / "rollouts-000000.npy"
    err = interrupt_when(lambda: path.exists() and path.stat().st_size > 10_000, *command)
    assert "resume with the same command" in err
    assert 0 < len(records(out)) < 340
    dappo_batch(*command)
    dappo_batch(*arguments(expert, reference, "--preset", "runtime", rollouts=340))
    assert files(out) == files(reference)


def test_a_full_disk_is_an_error_and_leaves_a_valid_prefix(expert: Path, tmp_path: Path) -> None:
    whole, full = tmp_path / "whole", tmp_path / "full"
    rollouts = 200
    dappo_batch(*arguments(expert, whole, rollouts=rollouts))
    limit = (whole / "rollouts-000000.npy").stat().st_size * 3 // 4
    command = arguments(expert, full, rollouts=rollouts)
    done = processes.run(
        [*processes.DAPPO_BATCH, *command],
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 1
    assert "rollouts are safe: make room, then give the same command again" in done.stderr
    prefix = records(full)
    assert 0 < len(prefix) < rollouts
    assert prefix.tobytes() == records(whole)[: len(prefix)].tobytes()
    dappo_batch(*command)
    assert files(full) == files(whole)


def test_bad_input_is_rejected_before_anything_is_written(expert: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    hexapod = tmp_path / "hexapod"
    dappo_batch(
        "train", *TINY, "--robot", "hexapod", "--healthy", "--steps", str(ITERATION), "--run", hexapod
    )
    expected = {
        ("--onset", "9-2"): (1, "onset is 9 to 2, expected a range in ascending order"),
        ("--shard", "2/2"): (1, "shard is `2/2`, expected i/n"),
        ("--policy", str(hexapod)): (1, "belongs to robot `hexapod`, expected `ant`"),
        ("--policy", str(tmp_path)): (1, "is not a run folder"),
        ("--delay", "soon"): (2, "a range such as 20-150"),
        ("--preset", "gait"): (2, "paper, runtime, residual"),
        ("--resync", "-1"): (2, "invalid value '-1' for '--resync"),
    }
    done = dappo_batch_many(*(arguments(expert, out, *flags) for flags in expected))
    for (code, _, err), (flags, (expected_code, message)) in zip(done, expected.items(), strict=True):
        assert code == expected_code, (flags, err)
        assert message in err, (flags, err)
    assert not out.exists()


@pytest.mark.parametrize("preset", ["paper", "residual", "observation"])
def test_a_function_that_acts_as_the_policy_of_a_run_collects_the_same_records(
    preset: str, aware: Path, tmp_path: Path
) -> None:
    policy = package.Policy.load(aware)
    assert policy.observes_damage
    own, other = tmp_path / "own", tmp_path / "other"
    options: dict[str, Any] = {"preset": preset, "rollouts": 2, "timesteps": STEPS, "seed": 3, "threads": 1}
    package.collect_pairs(aware, own, **options)
    widths = set()

    def act(obs: NDArray[np.float32]) -> NDArray[np.float32]:
        widths.add(obs.shape[1])
        return policy.act(obs)

    package.collect_pairs(aware, other, act=act, **options)
    assert widths == {policy.obs_dim + policy.code_length}
    assert records(other).tobytes() == records(own).tobytes()
    header = json.loads((other / "dataset.json").read_text())
    assert header["expert"] == header["policy"] == {"run": "act", "fingerprint": "act", "env_steps": 0}
    # Records of one policy do not get into those of another.
    for another in (None, policy.act):
        with pytest.raises(package.CheckpointError, match="records with `expert`"):
            package.collect_pairs(aware, other, act=another, **options)


def test_functions_that_are_no_policies_collect_nothing(expert: Path, tmp_path: Path) -> None:
    out = tmp_path / "pairs"
    options: dict[str, Any] = {"preset": "paper", "rollouts": 2, "timesteps": STEPS}
    for act, message in (
        (lambda obs: obs[:, :3], "expected numbers of shape"),
        ("json:nothing", "the module 'json' has no function 'nothing', which act needs"),
        (3, "act must be a function"),
    ):
        with pytest.raises(package.ConfigError, match=message):
            package.collect_pairs(expert, out, act=act, **options)
    assert not any(len(np.load(path)) for path in out.glob("*.npy"))


def test_a_folder_of_other_records_is_left_alone(expert: Path, tmp_path: Path, collected: Collected) -> None:
    before = files(collected["paper"])
    for flags, name in ((("--preset", "runtime", "--backend", "mujoco"), "timing"), ((), "backend")):
        _, err = dappo_batch(*arguments(expert, collected["paper"], *flags), code=1)
        assert f"records with `{name}`" in err
        assert "choose another folder" in err
    assert files(collected["paper"]) == before
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "dataset.json").write_text("{}")
    _, err = dappo_batch(*arguments(expert, foreign), code=1)
    assert "truncated or foreign" in err


def test_collection_resumes_after_a_kill_at_its_start_and_with_any_spelling_of_the_folder(
    expert: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    relative = tmp_path / "elsewhere"
    relative.mkdir()
    monkeypatch.chdir(relative)
    runs = [os.path.relpath(expert), f"{expert}/", f"{expert}/../{expert.name}", expert]
    outs = ["../cut", f"{cut}/", f"{link}/cut", f"{cut}/../cut"]
    assert run_cli(list(map(str, arguments(expert, whole)))) == 0
    path = cut / "rollouts-000000.npy"
    expected = (whole / path.name).read_bytes()
    # A file that was given its length before its header, one without, and one with half of it.
    starts = (bytes(512), b"", expected[:100] + bytes(412), bytes(7))
    for start, run, out in zip(starts, runs, outs, strict=True):
        cut.mkdir(exist_ok=True)
        path.write_bytes(start)
        # Not a Path, which would tidy its spelling.
        command = [
            "diagnose",
            "collect",
            str(run),
            "--out",
            out,
            "--rollouts",
            "5",
            "--timesteps",
            str(STEPS),
            "--preset",
            "paper",
        ]
        assert run_cli([*command, "--seed", "3"]) == 0
        assert path.read_bytes() == expected
    path.write_bytes(b"other notes")
    with pytest.raises(package.CheckpointError, match="its header does not fit"):
        package.collect_pairs(expert, cut, preset="paper", rollouts=5, timesteps=STEPS, seed=3)
    assert path.read_bytes() == b"other notes"


def test_a_shard_that_is_being_collected_is_rejected_and_others_are_not(expert: Path, tmp_path: Path) -> None:
    out = tmp_path / "pairs"
    options: dict[str, Any] = {"preset": "paper", "rollouts": 4, "timesteps": STEPS, "seed": 3, "threads": 1}
    (first,) = package.collect_pairs(expert, out, shard="0/2", **options)
    with first.open("r+b") as file:
        # What the collecting process holds.
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(package.CheckpointError, match="another process is collecting these rollouts"):
            package.collect_pairs(expert, out, shard="0/2", **options)
        assert len(package.collect_pairs(expert, out, shard="1/2", **options)) == 2
    package.collect_pairs(expert, out, shard="0/2", **options)
    assert len(records(out)) == 4
