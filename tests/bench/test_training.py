"""The benchmark of training counts operations, reports missing trainers, and compares within a round."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from dappo_batch import ConfigError, SimulationError
from dappo_batch.bench.simulators import Unavailable

from . import matmul, rounds, training
from .commands import TrainingFailed, TrainingRun
from .limits import limited_to, thread_limits
from .training import bound, envpool_torch, report, trainers
from .training.__main__ import main
from .training.task import Task, pass_flops
from .training.trainers import Sample
from .worker import Worker, WorkerFailed

TINY = Task(threads=1, num_envs=2, horizon=16)


def counted_product(
    left: NDArray[np.float64], right: NDArray[np.float64], counts: list[int]
) -> NDArray[np.float64]:
    """Return left @ right, computed entry by entry, and count every multiplication and addition."""
    out = np.zeros((left.shape[0], right.shape[1]))
    for row, inner in np.ndindex(*left.shape):
        out[row] += left[row, inner] * right[inner]
        counts.append(2 * right.shape[1])
    return out


@pytest.mark.parametrize("sizes", [[3, 2], [4, 5, 2], [7, 3, 4, 1]])
def test_a_pass_takes_the_operations_of_the_products_of_backpropagation(sizes: list[int]) -> None:
    rng, rows = np.random.default_rng(0), 6
    weights = [rng.standard_normal(shape) for shape in pairwise(sizes)]
    counts: list[int] = []
    layers = [rng.standard_normal((rows, sizes[0]))]
    for weight in weights:
        layers.append(np.tanh(counted_product(layers[-1], weight, counts)))
    gradient, found = np.ones((rows, sizes[-1])), []
    for index in reversed(range(len(weights))):
        gradient = gradient * (1.0 - layers[index + 1] ** 2)
        found.append(counted_product(layers[index].T, gradient, counts))
        if index > 0:
            gradient = counted_product(gradient, weights[index].T, counts)
    assert sum(counts) == rows * pass_flops(sizes)

    # Check that these products are those of the gradient.
    def output(first: float) -> float:
        value, (top, *others) = layers[0], weights
        top = top.copy()
        top[0, 0] += first
        for weight in (top, *others):
            value = np.tanh(value @ weight)
        return float(value.sum())

    assert found[-1][0, 0] == pytest.approx((output(1e-6) - output(-1e-6)) / 2e-6, rel=1e-5)


def write_run(folder: Path, rows: list[dict[str, object]]) -> None:
    (folder / "config.toml").write_text(
        "horizon = 8\n[env]\nnum_envs = 4\n[ppo]\nepochs = 10\nvalue_epochs = 3\n"
    )
    (folder / "metrics.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    for iteration in ("00000000", "00000003"):
        (folder / "checkpoints" / iteration).mkdir(parents=True)
        (folder / "checkpoints" / iteration / "learner.toml").write_text(
            "obs_dim = 5\nhidden = [6, 7]\naction_dim = 2\n"
        )


def metrics(iteration: int, epochs: int, rollout: float, update: float) -> dict[str, object]:
    return {
        "iteration": iteration,
        "env_steps": 32 * iteration,
        "epochs_run": epochs,
        "rollout_seconds": rollout,
        "update_seconds": update,
    }


def test_a_run_folder_is_summarised_without_its_first_iteration(tmp_path: Path) -> None:
    write_run(tmp_path, [metrics(1, 10, 9.0, 9.0), metrics(2, 10, 0.5, 1.0), metrics(3, 7, 0.25, 2.0)])
    sample = trainers.sample_of(TrainingRun.read(tmp_path))
    assert (sample.iterations, sample.env_steps) == (2, 64)
    assert (sample.rollout_seconds, sample.update_seconds) == (0.75, 3.0)
    assert sample.rate == pytest.approx(64 / 3.75)
    # 17 epochs of 32 rows for the policy; twice three epochs of two batches of 32 rows for the value net.
    policy, value = pass_flops([5, 6, 7, 2]), pass_flops([5, 6, 7, 1])
    assert sample.update_flops == 17 * 32 * policy + 2 * 3 * 64 * value


def test_a_run_of_one_iteration_is_an_error(tmp_path: Path) -> None:
    write_run(tmp_path, [metrics(1, 10, 1.0, 1.0)])
    with pytest.raises(TrainingFailed, match="only one iteration"):
        trainers.sample_of(TrainingRun.read(tmp_path))


def test_a_metric_that_a_run_lacks_is_in_the_error(tmp_path: Path) -> None:
    write_run(tmp_path, [{"iteration": 1, "env_steps": 32}, {"iteration": 2, "env_steps": 64}])
    with pytest.raises(TrainingFailed, match="epochs_run"):
        trainers.sample_of(TrainingRun.read(tmp_path))


class Pretended(trainers.Trainer):
    """Returns a given duration."""

    key = "pretended"
    about = "pretends"

    def __init__(self, task: Task, seconds: float = 1.0) -> None:
        super().__init__(task)
        self._batch, self._seconds = task.batch, seconds
        self.trained: list[int] = []

    def train(self, amount: int) -> Sample:
        self.trained.append(amount)
        return Sample(amount, amount * self._batch, self._seconds, 3.0 * self._seconds, 6e9)


class PretendedPeer(Pretended):
    key = trainers.StableBaselines.key


def rates(sgemm: float, mj_step: float) -> bound.Rates:
    return bound.Rates(sgemm, {"mj_step": mj_step, "lanes f32": 40.0 * mj_step})


def test_ratios_and_bounds_are_those_of_the_same_round() -> None:
    ours, peer = Pretended(TINY), PretendedPeer(TINY)
    turns = []
    # The machine gets slower from round to round, which does not change the ratios.
    for slowness in (1.0, 2.0, 8.0):
        samples = {
            "pretended": Sample(2, 64, 1.0 * slowness, 3.0 * slowness, 6e9),
            "sb3": Sample(2, 64, 10.0 * slowness, 10.0 * slowness, 5e9),
        }
        turns.append(report.Round(rates(3e9 / slowness, 64.0 / slowness), samples))
    own, other = report.results(turns, [ours, peer])
    assert asdict(own.ratios["sb3"]) == {"median": 5.0, "low": 5.0, "high": 5.0}
    assert "envpool + torch" not in own.ratios
    assert (other.ratios["sb3"].low, other.ratios["sb3"].high) == (1.0, 1.0)
    assert asdict(own.rate) == {"median": 8.0, "low": 2.0, "high": 16.0}
    assert (own.rollout_seconds.low, own.update_seconds.low) == (0.5, 1.5)  # of one iteration
    # 32 env steps at 64 a second, and 3 Gflop at 3 Gflop/s: 1.5 s at best, of which 2 s were taken.
    assert (own.bound_rollout_seconds.low, own.bound_update_seconds.low) == (0.5, 1.0)
    assert asdict(own.over_bound) == pytest.approx({"median": 2.0 / 1.5, "low": 2.0 / 1.5, "high": 2.0 / 1.5})


class Absent(trainers.StableBaselines):
    key = "absent"
    packages: ClassVar[dict[str, str]] = {"no_such_module_a": "a-package", "no_such_module_b": "b-package"}


class Machine:
    """Rates without measuring."""

    note = "pretended BLAS"

    def __init__(self, task: Task) -> None:
        self.closed = False

    def measure(self, seconds: float) -> bound.Rates:
        return rates(1e9, 100.0)

    def close(self) -> None:
        self.closed = True


def test_missing_packages_are_reported_with_their_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "TRAINERS", (Pretended, Absent))
    monkeypatch.setattr(training, "Machine", Machine)
    found = training.run(num_envs=2, horizon=8, threads=1, iterations=3, rounds=2)
    assert [one.key for one in found.results] == ["pretended"]
    assert found.results[0].rate.median == pytest.approx(3 * 16 / 4.0)
    (missing,) = found.missing
    assert missing.reason == "a-package and b-package are not installed"
    assert missing.install == "pip install a-package b-package"
    text = found.text()
    assert "not measured: absent: a-package and b-package are not installed; to install it: pip" in text
    assert "pretended BLAS" in text
    assert json.loads(json.dumps(found.to_dict()))["settings"]["epochs"] == 10


def test_rounds_rotate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rounds, "_PAUSE", 0.0)
    messages: list[str] = []
    both = [Pretended(TINY), PretendedPeer(TINY)]
    found = rounds.measure_rounds(Machine(TINY).measure, both, 3, 2, 0.1, messages.append)
    assert [line.split(": ")[1] for line in messages if "machine" not in line] == [
        *("pretended", "sb3"),
        *("sb3", "pretended"),
    ]
    assert both[0].trained == [3, 3]
    assert set(found[1].samples) == {"pretended", "sb3"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "envs must be at least 1"),
        ({"horizon": 0}, "horizon must be at least 1"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"seconds": float("inf")}, "seconds must be above 0"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        training.run(**arguments)


def test_the_command_line_has_the_arguments_of_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(training, "TRAINERS", (Pretended, Absent))
    monkeypatch.setattr(training, "Machine", Machine)
    options = ["--envs", "2", "--horizon", "8", "--threads", "1", "--iterations", "3", "--rounds", "1"]
    main([*options, "--seconds", "0.5", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (
        found["settings"] | {"num_envs": 2, "horizon": 8, "threads": 1, "iterations": 3} == found["settings"]
    )
    assert found["settings"] | {"rounds": 1, "seconds": 0.5} == found["settings"]
    assert [one["key"] for one in found["missing"]] == ["absent"]


def test_advantages_are_discounted_sums_of_errors_within_an_episode() -> None:
    rng, steps, envs = np.random.default_rng(1), 6, 3
    rollout = envpool_torch.Rollout.empty(steps, envs, 1, 1)
    rollout.rewards[:] = rng.standard_normal((steps, envs))
    rollout.values[:] = rng.standard_normal((steps + 1, envs))
    rollout.terminated[:] = False
    rollout.terminated[2, 1] = True  # a fall
    rollout.ended[:] = rollout.terminated
    rollout.ended[3, 2] = True  # the time limit
    gamma, lambda_ = 0.9, 0.7
    found = envpool_torch.advantages(rollout, gamma, lambda_)
    for step, env in np.ndindex(steps, envs):
        expected = 0.0
        for later in range(step, steps):
            continues = not rollout.terminated[later, env]
            error = rollout.rewards[later, env] - rollout.values[later, env]
            error += gamma * continues * rollout.values[later + 1, env]
            expected += (gamma * lambda_) ** (later - step) * error
            if rollout.ended[later, env]:
                break
        assert found[step, env] == pytest.approx(expected, rel=1e-5, abs=1e-6)


PROGRAM = """
import sys
class Doubler:
    def __init__(self, task):
        print("chatter of a library")
        self.note = f"{task.num_envs} envs"
    def answer(self, number):
        print("more chatter")
        if number < 0:
            sys.exit("cannot continue")
        return {"twice": 2 * number}
    def close(self):
        pass
class Broken:
    def __init__(self, task):
        raise ImportError("libmissing.so: cannot open shared object file")
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Write a module that a worker can import."""
    (tmp_path / "programs_of_a_test.py").write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    return "programs_of_a_test"


def test_a_worker_answers_and_its_other_output_is_not_part_of_the_answer(program: str) -> None:
    worker = Worker(f"{program}:Doubler", TINY)
    assert worker.note == "2 envs"
    assert worker.ask(3) == {"twice": 6.0}
    assert worker.ask(4) == {"twice": 8.0}
    with pytest.raises(WorkerFailed, match=r"(?s)exit code 1.*cannot continue") as caught:
        worker.ask(-1)
    assert "chatter" in str(caught.value)
    worker.close()


def test_a_peer_that_cannot_start_is_unavailable_and_one_that_fails_is_an_error(
    program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class OfATest(trainers.StableBaselines):
        packages: ClassVar[dict[str, str]] = {}

    monkeypatch.setattr(OfATest, "program", f"{program}:Broken")
    with pytest.raises(Unavailable, match=r"libmissing\.so"):
        OfATest(TINY)
    monkeypatch.setattr(OfATest, "program", f"{program}:Doubler")
    monkeypatch.setattr(trainers, "Sample", dict)  # the answer of this program is not a sample
    peer = OfATest(TINY)
    with pytest.raises(SimulationError, match=r"(?s)sb3: .*cannot continue"):
        peer.train(-1)


def test_operations_of_matrix_multiplications_are_counted() -> None:
    found = matmul.Sgemm(matmul.Threads(1))
    assert 1e8 < found.answer(0.05)["flops"] < 1e14
    assert np.__version__ in found.note
    np.testing.assert_allclose(found._out, found._left @ found._right, atol=1e-3)


def test_cores_are_limited_temporarily_and_thread_pools_by_variables() -> None:
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("this system does not bind processes to cores")
    before = os.sched_getaffinity(0)
    with limited_to(1):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
    assert thread_limits(3)["OPENBLAS_NUM_THREADS"] == thread_limits(3)["OMP_NUM_THREADS"] == "3"


def check(sample: Sample, task: Task, inputs: int) -> None:
    """Check a sample of two iterations that skipped nothing."""
    assert sample.iterations == 2
    assert sample.env_steps == 2 * task.batch
    assert sample.rollout_seconds > 0.0
    assert sample.update_seconds > 0.0
    row = pass_flops([inputs, *task.hidden, 8]) + pass_flops([inputs, *task.hidden, 1])
    assert sample.update_flops == 2 * task.epochs * task.batch * row


@pytest.mark.slow
@pytest.mark.parametrize("kind", [trainers.Lanes, trainers.Mujoco])
def test_our_training_does_the_work_of_the_task(kind: type[trainers.Ours]) -> None:
    trainer = kind(TINY)
    check(trainer.train(2), TINY, inputs=119)  # the Ant's 111 numbers and the damage code


def test_as_configured_has_the_sizes_of_the_configuration() -> None:
    trainer = trainers.AsConfigured(TINY)
    assert (trainer.num_envs, trainer.horizon) == (1024, 32)


@pytest.mark.slow
@pytest.mark.interop
def test_stable_baselines_does_the_work_of_the_task() -> None:
    pytest.importorskip("stable_baselines3")
    trainer = trainers.StableBaselines(TINY)
    check(trainer.train(2), TINY, inputs=105)
    assert "VecEnv, as the faster one" in trainer.note
    trainer.close()


@pytest.mark.slow
@pytest.mark.interop
def test_envpool_with_torch_does_the_work_of_the_task() -> None:
    pytest.importorskip("torch")
    pytest.importorskip("envpool")
    trainer = trainers.EnvPoolTorch(TINY)
    sample = trainer.train(2)
    assert 0 <= 2 * TINY.batch - sample.env_steps <= 4  # calls that only reset are not counted
    row = pass_flops([105, *TINY.hidden, 8]) + pass_flops([105, *TINY.hidden, 1])
    assert sample.update_flops == sample.env_steps * TINY.epochs * row
    trainer.close()


@pytest.mark.slow
def test_a_benchmark_of_the_training_of_this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "TRAINERS", (trainers.Lanes,))
    monkeypatch.setattr(bound, "_LANE_ENVS", 64)
    found = training.run(num_envs=2, horizon=16, threads=1, iterations=1, rounds=1, seconds=0.05)
    (own,) = found.results
    assert own.ratios == {}
    assert own.over_bound.median > 0.0
    assert set(found.physics) == {"mj_step", "lanes f32"}
    assert "time / bound" in found.text()
