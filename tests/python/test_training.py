"""`dappo-batch train`: what a run leaves behind, and that stopping it at any moment changes nothing."""

from __future__ import annotations

import csv
import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dappo_batch._core import DamageSpace

from .burnpack import checkpoint_contents
from .command_line import ITERATION, TINY, dappo_batch, metrics, read_lines, start

STEPS = 8 * ITERATION
METRICS = (
    *("iteration", "env_steps", "forward_reward", "episode_return", "episode_length", "policy_loss"),
    *("value_loss", "kl", "kl_coef", "learning_rate", "entropy", "explained_variance", "stage"),
    *("rollout_seconds", "update_seconds"),
)


def assert_same_result(run: Path, expected: Path) -> None:
    """Compare metrics and newest checkpoints of two runs bit for bit."""
    assert metrics(run) == metrics(expected)
    newest, other = (max((folder / "checkpoints").glob("0*")) for folder in (run, expected))
    assert newest.name == other.name
    assert checkpoint_contents(newest) == checkpoint_contents(other)


@pytest.fixture(scope="module", params=["lanes", "mujoco"])
def backend(request: pytest.FixtureRequest) -> str:
    """Run the test once with each backend."""
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, backend: str) -> tuple[Path, str, str]:
    """Train once, unbroken: the run folder and what the command printed."""
    run = tmp_path_factory.mktemp("finished") / "run"
    arguments = ("--backend", backend, "--run", run, "--steps", str(STEPS), *TINY)
    return run, *dappo_batch("train", *arguments)


def test_a_run_folder_contains_everything_that_is_documented(finished: tuple[Path, str, str]) -> None:
    run, _, _ = finished
    assert {path.name for path in run.iterdir()} == {
        *("config.toml", "meta.json", "robot", "checkpoints", "eval", "lock"),
        *("metrics.jsonl", "metrics.csv", "events.out.tfevents.metrics"),
    }
    assert sorted(path.name for path in (run / "checkpoints").iterdir()) == ["00000006", "00000008"]
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == list(range(1, 9))
    assert [line["env_steps"] for line in lines] == [ITERATION * number for number in range(1, 9)]
    assert all(set(METRICS) <= line.keys() for line in lines)
    meta = json.loads((run / "meta.json").read_text())
    assert meta["command"][:2] == ["dappo-batch", "train"]
    assert {"version", "mujoco", "reward", "threads", "platform"} < meta.keys()
    assert {"backend", "precision", "device", "physics"} < meta.keys()


def test_the_first_line_has_the_preset_and_the_settings_that_differ_from_it(
    finished: tuple[Path, str, str],
) -> None:
    _, _, err = finished
    assert " · PPO preset batch, changed: ppo.hidden = [8] · 4 envs" in err.splitlines()[0]


def test_the_evaluation_has_a_row_for_every_class_in_canonical_order(finished: tuple[Path, str, str]) -> None:
    run, out, _ = finished
    with (run / "eval" / "per_class.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    classes = DamageSpace(4, ["jammed_joint", "missing_toe"], 1).classes
    assert [(int(row["class"]), row["name"], row["group"]) for row in rows] == [
        (damage.id, damage.name, damage.group) for damage in classes
    ]
    assert all(float(row["episode_length"]) <= 20 and row["episodes"] == "1" for row in rows)
    table = out.splitlines()
    assert [line.split()[1] for line in table[1:10]] == [damage.name for damage in classes]
    assert table[-1] == f"run folder: {run}"


def test_the_configuration_of_a_run_reads_back_as_itself(finished: tuple[Path, str, str]) -> None:
    config = finished[0] / "config.toml"
    out, _ = dappo_batch("config", "--config", config)
    assert out == config.read_text()
    read = tomllib.loads(out)
    assert (read["total_steps"], read["env"]["num_envs"], read["ppo"]["hidden"]) == (STEPS, 4, [8])


def test_results_depend_neither_on_threads_nor_on_the_output(
    finished: tuple[Path, str, str], tmp_path: Path, backend: str
) -> None:
    run = tmp_path / "run"
    settings = ("--backend", backend, "--steps", str(STEPS), *TINY, "env.threads=2")
    out, _ = dappo_batch("train", "--json", "--run", run, *settings)
    assert read_lines(out) == metrics(run)
    assert tomllib.loads((run / "config.toml").read_text())["env"]["threads"] == 2
    assert_same_result(run, finished[0])
    assert (run / "eval/per_class.csv").read_bytes() == (finished[0] / "eval/per_class.csv").read_bytes()


def test_evaluations_during_a_training_do_not_change_it_and_the_last_one_is_that_at_its_end(
    finished: tuple[Path, str, str], tmp_path: Path, backend: str
) -> None:
    run = tmp_path / "run"
    settings = ("--backend", backend, "--steps", str(STEPS), *TINY, "evaluation.every=4")
    dappo_batch("train", "--run", run, *settings)
    evaluated = ("evaluation_forward_reward", "evaluation_forward_velocity", "evaluation_fall_rate")
    lines = metrics(run)
    found = [[line.pop(key) for key in evaluated] for line in lines]
    before = metrics(finished[0])
    for line in before:
        assert [line.pop(key) for key in evaluated] == [None] * 3
    assert lines == before
    assert [row[0] is not None for row in found] == [False, False, False, True] * 2
    end = json.loads((run / "eval" / "evaluation.json").read_text())["groups"][-1]
    expected = [end["forward_reward"], end["forward_velocity"], end["falls"] / end["episodes"]]
    assert found[-1] == expected
    assert found[3] != expected


def test_half_a_run_and_its_extension_equal_a_complete_run(
    finished: tuple[Path, str, str], tmp_path: Path, backend: str
) -> None:
    run = tmp_path / "run"
    # 5 iterations: the end of the first half is no multiple of checkpoint.every.
    first = ("--backend", backend, "--run", run, "--steps", str(5 * ITERATION), *TINY)
    dappo_batch("train", *first)
    dappo_batch("train", "--resume", run, "--steps", str(STEPS), "--threads", "2")
    assert_same_result(run, finished[0])
    assert (run / "config.toml").read_bytes() == (finished[0] / "config.toml").read_bytes()


def test_a_run_that_was_stopped_before_its_first_checkpoint_starts_again(
    finished: tuple[Path, str, str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    (run / "checkpoints" / ".new.tmp").mkdir(parents=True)
    (run / "checkpoints" / ".new.tmp" / "policy.bpk").write_bytes(b"half")
    shutil.copy(finished[0] / "config.toml", run)
    dappo_batch("train", "--resume", run)
    assert_same_result(run, finished[0])
    assert not (run / "checkpoints" / ".new.tmp").exists()


def wait_for(process: subprocess.Popen[str], run: Path, iterations: int) -> None:
    """Wait until a run has done some iterations or has ended."""
    path = run / "metrics.jsonl"
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        if path.exists() and path.read_bytes().count(b"\n") >= iterations:
            return
        time.sleep(0.002)


LONG = 30


@pytest.fixture(scope="module")
def long_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train for 30 iterations, unbroken."""
    run = tmp_path_factory.mktemp("long") / "run"
    dappo_batch("train", "--run", run, "--steps", str(LONG * ITERATION), *TINY, "checkpoint.every=2")
    return run


@pytest.mark.slow
def test_kills_at_random_moments_leave_a_run_that_ends_the_same(long_run: Path, tmp_path: Path) -> None:
    chance = random.Random(20)
    run = tmp_path / "run"
    first = ("--run", run, "--steps", str(LONG * ITERATION), *TINY, "checkpoint.every=2")
    kills = 0
    for begin in (1, 9, 18):
        # With a checkpoint every other iteration, much of the time is spent in saving.
        process = start("train", "--json", *(first if begin == 1 else ("--resume", run)))
        wait_for(process, run, begin + chance.randrange(6))
        time.sleep(chance.uniform(0, 0.02))
        process.kill()
        process.communicate()
        kills += process.returncode == -signal.SIGKILL
    assert kills >= 2, "the trainings ended before they could be killed"
    dappo_batch("train", "--resume", run)
    assert_same_result(run, long_run)


@pytest.fixture
def react_to() -> Iterator[Callable[[int, signal.Handlers], object]]:
    """Say how processes that are started from now on react to a signal, as `signal.signal` does."""
    before = signal.getsignal(signal.SIGHUP)
    yield signal.signal
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_saves_and_exits_with_130(
    number: int, long_run: Path, tmp_path: Path, react_to: Callable[[int, signal.Handlers], object]
) -> None:
    react_to(signal.SIGHUP, signal.SIG_DFL)
    run = tmp_path / "run"
    settings = ("--steps", str(LONG * ITERATION), *TINY, "checkpoint.every=1000", "checkpoint.keep=2")
    process = start("train", "--run", run, *settings)
    wait_for(process, run, 3)
    process.send_signal(number)
    if number == signal.SIGHUP:
        # A closing terminal may send it twice, by its shell and by the kernel.
        process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert f"--resume {run}" in err
    assert "Traceback" not in err
    done = len(metrics(run))
    assert 3 <= done < LONG
    assert max((run / "checkpoints").iterdir()).name == f"{done:08}"
    if number == signal.SIGINT:
        dappo_batch("train", "--resume", run)
        assert_same_result(run, long_run)


def test_a_run_that_ignores_the_end_of_its_terminal_continues(
    tmp_path: Path, react_to: Callable[[int, signal.Handlers], object]
) -> None:
    react_to(signal.SIGHUP, signal.SIG_IGN)
    run = tmp_path / "run"
    process = start("train", "--run", run, "--steps", str(LONG * ITERATION), *TINY)
    wait_for(process, run, 3)
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert len(metrics(run)) == LONG


def test_ctrl_c_during_the_imports_leaves_no_traceback(tmp_path: Path) -> None:
    # Sent by the process itself, as it begins to import MuJoCo.
    (tmp_path / "sitecustomize.py").write_text(
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(name, path=None, target=None):\n"
        "        if name == 'mujoco':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder)\n"
    )
    script = Path(sys.executable).with_name("dappo-batch")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [script, "doctor"], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_pythons_handler_of_ctrl_c_is_restored_after_the_imports(tmp_path: Path) -> None:
    # As the processes of a sweep, which have the name of the command but do not begin in its function.
    script = tmp_path / "dappo-batch"
    script.write_text(
        "import signal, dappo_batch\nassert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_second_signal_ends_the_program_at_once(tmp_path: Path) -> None:
    run = tmp_path / "run"
    # One iteration takes minutes.
    settings = (*TINY, "env.num_envs=64", "horizon=100000", "env.max_episode_steps=1000")
    process = start("train", "--run", run, "--steps", "6400000", *settings)
    deadline = time.monotonic() + 60
    while not (run / "checkpoints" / "00000000").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=5)
    assert process.returncode == 130
    assert "Traceback" not in err


def damage_classes(checkpoint: Path) -> tuple[int, ...]:
    """Read the damage classes in force from the env state."""
    data = (checkpoint / "envs.safetensors").read_bytes()
    begin = 8 + struct.unpack_from("<Q", data)[0]
    entry = json.loads(data[8:begin])["classes"]
    first, last = (begin + offset for offset in entry["data_offsets"])
    return struct.unpack(f"<{entry['shape'][0]}Q", data[first:last])


def test_class_draws_follow_the_stages_and_the_stage_survives_a_resume(tmp_path: Path) -> None:
    run = tmp_path / "run"
    # An episode lasts one iteration, so that a new stage shows at the end of its first iteration.
    curriculum = (
        "curriculum=[{name='I healthy',mix='healthy'},{name='II single',mix={single=1.0}},"
        "{name='III last',mix='missing_toe@3'}]"
    )
    stages = ("env.max_episode_steps=16", curriculum, "checkpoint.every=1", "checkpoint.keep=20")
    dappo_batch("train", "--run", run, "--steps", str(9 * ITERATION), *TINY, *stages)
    names = ["I healthy"] * 3 + ["II single"] * 3 + ["III last"] * 3
    assert [line["stage"] for line in metrics(run)] == names
    drawn = [damage_classes(run / "checkpoints" / f"{number:08}") for number in range(10)]
    assert drawn[:4] == [(0, 0, 0, 0)] * 4
    assert all(1 <= damage <= 8 for classes in drawn[4:7] for damage in classes)
    assert len({damage for classes in drawn[4:7] for damage in classes}) > 1
    assert drawn[7:] == [(8, 8, 8, 8)] * 3

    resumed = tmp_path / "resumed"
    shutil.copytree(run, resumed)
    for number in (6, 7, 8, 9):
        shutil.rmtree(resumed / "checkpoints" / f"{number:08}")
    dappo_batch("train", "--resume", resumed)
    assert_same_result(resumed, run)


def test_an_unaware_policy_never_observes_the_damage_code(
    finished: tuple[Path, str, str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    dappo_batch("train", "--unaware", "--run", run, "--steps", str(ITERATION), *TINY)
    learners = [
        tomllib.loads((max((folder / "checkpoints").iterdir()) / "learner.toml").read_text())
        for folder in (run, finished[0])
    ]
    assert [learner["obs_dim"] for learner in learners] == [111, 119]


def test_a_robot_that_no_code_knows_is_trained_and_evaluated(tmp_path: Path) -> None:
    shutil.copytree(Path(__file__).parent / "robots", tmp_path / "robots")
    robot = Path("robots/tripod.toml")
    run = tmp_path / "run"
    dappo_batch("train", "--robot", robot, "--run", run, "--steps", str(ITERATION), *TINY, cwd=tmp_path)
    learner = tomllib.loads((run / "checkpoints" / "00000001" / "learner.toml").read_text())
    # 11 positions, 12 velocities, 3 touch signals and a damage code of 3 x 2; 6 actions.
    assert (learner["obs_dim"], learner["action_dim"]) == (32, 6)
    # From another working directory: the run knows where its robot file lies.
    out, _ = dappo_batch("evaluate", run, "--json", cwd=Path(os.sep))
    names = [entry["name"] for entry in json.loads(out)["runs"][0]["classes"]]
    assert names == [damage.name for damage in DamageSpace(3, ["missing_toe", "jammed_joint"], 1).classes]
