"""Worker threads: how many are busy, what a forked process does, and what cannot leave a process."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ClassTable, Controller, DappoError, Diagnoser, NotPicklableError, Policy
from dappo_batch.results import DecisionTime

WORKER = "dappo-worker-"
SECONDS = 60
"""How long a forked process may take; one that hangs would take for ever."""
SIZES: dict[str, Any] = {
    "damage.max_damaged_limbs": 1,
    "env.max_episode_steps": 20,
    "evaluation.episodes": 2,
    "horizon": 16,
    "ppo.hidden": [64, 64],
}
"""A minibatch of these is large enough for several threads."""
NETWORK = {"epochs": 1, "embedding": 32, "lstm": 32, "hidden": [32], "minibatch_size": 64}


@pytest.fixture(scope="module")
def table() -> ClassTable:
    return dappo_batch.compile_class_table("ant", max_damaged_limbs=1)


def everything(root: Path, threads: int, pause: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Train, evaluate, diagnose and adapt; return what came out of it."""
    run, pairs, diagnoser = root / "run", root / "pairs", root / "diagnoser"
    trained = dappo_batch.train(run, num_envs=64, total_steps=2048, device="cpu", threads=threads, set=SIZES)
    pause()
    evaluation = dappo_batch.evaluate(run, episodes=1, threads=threads)
    pause()
    dappo_batch.collect_pairs(run, pairs, rollouts=8, timesteps=6, threads=threads)
    pause()
    epochs = dappo_batch.train_diagnoser(pairs, diagnoser, threads=threads, set=NETWORK)
    pause()
    tested = dappo_batch.evaluate_diagnoser(diagnoser, data=[pairs], policy=run, episodes=1, threads=threads)
    pause()
    adapted = dappo_batch.adapt(run, diagnoser, damage="missing_toe@0", at=5, episodes=4, threads=threads)
    return {
        "losses": [trained.metrics[key].tolist() for key in ("kl", "value_loss", "policy_loss")],
        "rewards": trained.per_class["true"]["forward_reward"].tolist(),
        "evaluation": [replace(one, run="") for one in evaluation.runs],
        "epochs": [epoch.train_loss for epoch in epochs],
        "tested": [(one.summary, one.cost) for one in tested],
        "adapted": replace(adapted.summary, decision_ms=DecisionTime(0, None, None, None)),
    }


class Threads:
    """The threads of this process, as Linux lists them."""

    def __init__(self) -> None:
        self.before = self._list()
        self.seen: dict[int, tuple[str, int]] = dict(self.before)
        self.samples: list[set[int]] = []

    def look(self) -> None:
        """Note who is there, and for how long each was busy."""
        now = self._list()
        self.seen |= now
        self.samples.append(now.keys() - self.before.keys())

    def settle(self) -> None:
        """Wait for the workers of what is over to end."""
        deadline = time.monotonic() + SECONDS
        while any(name.startswith(WORKER) for name in self._new_names()):
            assert time.monotonic() < deadline, "worker threads do not end"
            time.sleep(0.001)

    def _new_names(self) -> list[str]:
        return [name for thread, (name, _) in self._list().items() if thread not in self.before]

    def is_worker(self, thread: int) -> bool:
        # A thread has its name a moment after its start.
        return self.seen[thread][0].startswith(WORKER)

    def most(self) -> tuple[int, int]:
        """Return how many workers, and how many other new threads that were busy, there were at a time."""
        workers = [sum(map(self.is_worker, sample)) for sample in self.samples]
        busy = {
            thread for thread, (_, spent) in self.seen.items() if spent > 1 and not self.is_worker(thread)
        }
        return max(workers), max(len(sample & busy) for sample in self.samples)

    def busy_before(self) -> list[str]:
        """Return the threads, but for this one, that were there before and have been busy since."""
        here = threading.get_native_id()
        ticks = {thread: self.seen[thread][1] - spent for thread, (_, spent) in self.before.items()}
        return [self.before[thread][0] for thread, spent in ticks.items() if spent > 1 and thread != here]

    @staticmethod
    def _list() -> dict[int, tuple[str, int]]:
        """Return name and processor time, in ticks, of each thread."""
        found = {}
        for task in Path("/proc/self/task").iterdir():
            try:
                stat = (task / "stat").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue  # it has ended since
            name, fields = stat.split("(", 1)[1].rsplit(")", 1)
            spent = fields.split()[11:13]
            found[int(task.name)] = (name, sum(map(int, spent)))
        return found


@contextmanager
def watched() -> Iterator[Threads]:
    threads, done = Threads(), threading.Event()

    def watch() -> None:
        while not done.wait(0.002):
            threads.look()

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield threads
    finally:
        done.set()
        watcher.join()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, dict[str, Any], Threads]]:
    """Do everything with one thread and with two."""
    if not Path("/proc/self/task").exists():
        pytest.skip("this system does not list threads")
    results = {}
    for count in (1, 2):
        root = tmp_path_factory.mktemp(f"threads-{count}")
        with watched() as threads:
            results[count] = (root, everything(root, count, threads.settle), threads)
    return results


Done = dict[int, tuple[Path, dict[str, Any], Threads]]


@pytest.mark.parametrize("count", [1, 2])
def test_no_more_threads_work_than_requested(done: Done, count: int) -> None:
    threads = done[count][2]
    workers, others = threads.most()
    assert workers == count
    assert others <= 2, "the watcher, and the thread that gives a command"
    assert threads.busy_before() == []


def test_results_do_not_depend_on_the_number_of_threads(done: Done) -> None:
    assert done[1][1] == done[2][1]


@pytest.mark.parametrize("backend", ["lanes", "mujoco"])
def test_objects_work_in_threads_of_their_own(done: Done, table: ClassTable, backend: str) -> None:
    root = done[1][0]
    obs, actions = np.zeros((40, 7, 111), np.float32), np.zeros((40, 6, 8), np.float32)
    with watched() as threads:
        envs = dappo_batch.make_vec(table, 40, damage="uniform", seed=0, threads=2, backend=backend)
        envs.reset()
        envs.set_state(*envs.get_state())
        for _ in range(3):
            envs.step(actions[:, 0])
        threads.look()
        envs.close()
        threads.settle()
        policy = Policy.load(root / "run", threads=2)
        policy.act(obs[:, 0])
        threads.look()
        del policy
        threads.settle()
        controller = Controller(root / "run", diagnoser=root / "diagnoser", num_robots=40, threads=2)
        controller.act(obs[:, 0], np.zeros(40))
        threads.look()
        del controller
        threads.settle()
        diagnoser = Diagnoser.load(root / "diagnoser", expert=root / "run", threads=2)
        diagnoser.diagnose(obs, actions)
        threads.look()
    workers, others = threads.most()
    assert workers == 2
    assert others <= 1, "the watcher"
    assert threads.busy_before() == []


@pytest.mark.parametrize("make", [Policy.load, partial(Diagnoser.load, expert="run")])
def test_impossible_numbers_of_threads_are_rejected(make: Callable[..., object]) -> None:
    with pytest.raises(dappo_batch.ConfigError, match="threads must be at least 1, got 0"):
        make("run", threads=0)
    with pytest.raises(dappo_batch.ConfigError, match="threads must be at least 1, got 0"):
        Controller("run", diagnoser="diagnoser", threads=0)


def in_a_fork(work: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever the work returns
    """Return what `work` returns in a forked process."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)

    def child() -> None:
        try:
            there.send(work())
        except BaseException as error:
            there.send(error)

    process = context.Process(target=child)
    process.start()
    try:
        assert here.poll(SECONDS), "the forked process hangs"
        answer = here.recv()
    finally:
        process.kill()
        process.join()
    if isinstance(answer, BaseException):
        raise answer
    return answer


pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("backend", ["lanes", "mujoco"])
def test_an_env_continues_in_a_forked_process_as_in_its_own(
    table: ClassTable, backend: str, threads: int
) -> None:
    envs = dappo_batch.make_vec(table, 5, damage="uniform", seed=0, threads=threads, backend=backend)
    envs.reset()
    actions = np.full((5, 8), 0.5, np.float32)
    envs.step(actions)

    def walk() -> tuple[NDArray[Any], ...]:
        envs.set_state(*envs.get_state())
        steps = [envs.step(actions) for _ in range(3)]
        others = dappo_batch.make_vec(table, 2, damage="healthy", seed=1, threads=threads, backend=backend)
        return (*(step[0] for step in steps), steps[-1][1], others.reset()[0])

    for there, here in zip(in_a_fork(walk), walk(), strict=True):
        np.testing.assert_array_equal(there, here)
    # And in a process that was forked from a forked one.
    child, grandchild = in_a_fork(lambda: (walk(), in_a_fork(walk)))
    for theirs in (child, grandchild):
        np.testing.assert_array_equal(theirs[0], walk()[0])


def test_a_device_is_rejected_in_a_forked_process(table: ClassTable) -> None:
    pytest.importorskip("mujoco_warp")
    envs = dappo_batch.make_vec(table, 2, damage="healthy", seed=0, device="warp-cpu")
    envs.reset()
    with pytest.raises(dappo_batch.SimulationError, match=r"before this process was forked.*`spawn`"):
        in_a_fork(envs.get_state)
    assert np.isfinite(envs.get_state()[0]).all()


def test_networks_work_in_a_forked_process_as_in_their_own(done: Done) -> None:
    root = done[1][0]
    policy = Policy.load(root / "run", threads=2)
    diagnoser = Diagnoser.load(root / "diagnoser", expert=root / "run", threads=2)
    controller = Controller(root / "run", diagnoser=root / "diagnoser", num_robots=3, threads=2)
    rng = np.random.default_rng(0)
    obs = rng.standard_normal((3, 7, 111)).astype(np.float32)
    actions = rng.uniform(-1, 1, (3, 6, 8)).astype(np.float32)

    def work() -> list[NDArray[np.float32]]:
        controller.reset()
        return [
            policy.act(obs[:, 0], damage_class=1),
            controller.act(obs[:, 0], np.zeros(3)),
            controller.act(obs[:, 1], np.zeros(3)),
            diagnoser.twin(obs[:, :5], actions[:, :4]),
            diagnoser.diagnose(obs, actions),
        ]

    here = work()
    for there, expected in zip(in_a_fork(work), here, strict=True):
        np.testing.assert_array_equal(there, expected)


def test_commands_work_in_a_forked_process_after_its_parent_gave_some(done: Done, tmp_path: Path) -> None:
    assert in_a_fork(lambda: everything(tmp_path, 2)) == done[2][1]


def test_objects_that_live_in_native_memory_refuse_to_be_pickled_or_copied(
    done: Done, table: ClassTable
) -> None:
    root = done[1][0]
    objects = {
        "get_state and set_state": dappo_batch.make_vec(table, 2),
        "functions that create envs": gymnasium.make("dappo_batch/Ant-v0", robot=table),
        "same folders": Controller(root / "run", diagnoser=root / "diagnoser"),
        "its run folder": Policy.load(root / "run"),
        "its folders": Diagnoser.load(root / "diagnoser", expert=root / "run"),
    }
    refused = (NotPicklableError, DappoError, TypeError)
    for advice, item in objects.items():
        name = type(item.unwrapped if isinstance(item, gymnasium.Env) else item).__name__
        for act in (pickle.dumps, copy.deepcopy):
            with pytest.raises(TypeError, match=f"a {name} cannot be pickled or copied.*{advice}") as caught:
                act(item)
            assert all(isinstance(caught.value, kind) for kind in refused)
    envs = objects["get_state and set_state"]
    with pytest.raises(NotPicklableError):
        copy.copy(envs)
    assert envs.reset()[0].shape == (2, 119), "it is as it was"
