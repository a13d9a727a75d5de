"""The benchmark measures what it says, leaves nobody out silently, and prints tables and JSON."""

from __future__ import annotations

import json
import time

import mujoco
import numpy as np
import pytest

from dappo_batch import ConfigError, bench
from dappo_batch.bench import contenders, learner, measure, peers
from dappo_batch.bench.measure import Sample, measure_rounds, ratios
from dappo_batch.bench.report import Report
from dappo_batch.bench.workload import Episodes, Workload

ALL_KEYS = {kind.key for kind in bench.CONTENDERS}


@pytest.fixture(scope="module")
def report() -> Report:
    """Measure a few envs for a moment."""
    return bench.run("ant", num_envs=3, threads=2, seconds=0.01, rounds=2, learner=False)


def test_every_contender_is_measured_or_its_absence_explained(report: Report) -> None:
    measured = {result.key for result in report.results}
    missing = {one.key: one for one in report.missing}
    assert measured | set(missing) == ALL_KEYS
    assert not measured & set(missing)
    ours = {"lanes f32", "lanes f32 copy", "lanes f32 damaged", "lanes f64", "mujoco"}
    assert {"mj_step", "mujoco.rollout", *ours} <= measured
    for one in missing.values():
        assert one.reason
        assert one.install.startswith("pip install")
        assert one.install in report.text()


def test_rates_and_processor_times_are_positive_and_ordered(report: Report) -> None:
    for result in report.results:
        for spread in (result.rate, result.cpu_us, result.rate_ratio, result.cpu_ratio):
            assert 0.0 < spread.low <= spread.median <= spread.high < float("inf"), result.key


def test_raw_mj_step_is_the_measure_of_all_ratios(report: Report) -> None:
    base = next(result for result in report.results if result.key == "mj_step")
    assert (base.rate_ratio.low, base.rate_ratio.high) == (1.0, 1.0)


def test_the_report_names_the_machine_and_the_settings(report: Report) -> None:
    assert report.machine["mujoco"] == mujoco.__version__
    assert report.machine["cores"] >= 1
    assert report.settings == {"robot": "ant", "num_envs": 3, "threads": 2, "seconds": 0.01, "rounds": 2}
    assert mujoco.__version__ in report.text()


def test_a_whole_process_takes_more_memory_than_an_interpreter_and_less_than_all_of_it(
    report: Report,
) -> None:
    assert report.memory_mb is not None
    assert 20.0 < report.memory_mb < 2000.0


def test_memory_is_that_of_the_child_not_of_its_parent() -> None:
    ballast = np.ones(60_000_000)  # 480 MB, resident
    assert measure.own_peak_memory_mb() > 480.0
    assert measure.peak_memory_mb("ant", 1, 1) < 480.0
    assert ballast[-1] == 1.0


def test_json_holds_the_whole_report(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--robot", "hexapod", "--envs", "2", "--threads", "1", "--seconds", "0.01"]
    assert bench.main([*arguments, "--rounds", "1", "--no-learner", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {result["key"] for result in found["results"]} | {
        one["key"] for one in found["missing"]
    } == ALL_KEYS
    assert found["settings"]["robot"] == "hexapod"
    assert found["learner"] is None
    missing = {one["key"]: one for one in found["missing"]}
    assert "hexapod" in missing["gymnasium"]["reason"]
    assert missing["gymnasium"]["install"] == ""  # nothing to install would change it


def test_the_list_names_every_contender_without_measuring(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["--list", "--json"]) == 0
    rows = {row["key"]: row for row in json.loads(capsys.readouterr().out)}
    assert set(rows) == ALL_KEYS
    assert rows["mj_step"]["available"] is True
    assert all(row["available"] or row["reason"] for row in rows.values())


def test_an_absent_envpool_is_missing_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(contenders.Unavailable, match="not installed") as caught:
        peers.EnvPoolAnt(Workload.of("ant", 2, 1))
    assert caught.value.install == "pip install envpool"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "envs must be at least 1"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"seconds": 0.0}, "seconds must be above 0"),
        ({"robot": "unicorn"}, "unknown robot"),
    ],
)
def test_wrong_arguments_are_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        bench.run(**arguments)  # type: ignore[arg-type]


class Busy(contenders.Contender):
    """Burns 2 ms of processor time an env step."""

    key = "busy"

    def __init__(self, key: str, log: list[str]) -> None:
        self.key = key  # type: ignore[misc]
        self.num_envs = 1
        self._log = log

    def warm_up(self) -> None:
        self._log.append(f"warm {self.key}")

    def advance(self) -> int:
        self._log.append(self.key)
        end = time.process_time() + 0.002
        while time.process_time() < end:
            pass
        return 5


def test_rounds_rotate_and_count_what_was_done() -> None:
    log: list[str] = []
    samples = measure_rounds([Busy("a", log), Busy("b", log), Busy("c", log)], 1e-6, 3)
    assert log == ["warm a", "warm b", "warm c", "a", "b", "c", "b", "c", "a", "c", "a", "b"]
    for own in samples.values():
        assert [sample.steps for sample in own] == [5, 5, 5]
        # 2 ms for 5 env steps: 400 µs each at least, and wall time is no shorter.
        assert all(sample.cpu_us >= 399.0 and sample.wall_seconds >= 0.0019 for sample in own)


def test_ratios_compare_within_a_round() -> None:
    fast = [Sample(30, 1.0, 1.0), Sample(60, 1.0, 1.0), Sample(100, 1.0, 2.0)]
    slow = [Sample(10, 1.0, 1.0), Sample(30, 1.0, 1.0), Sample(20, 1.0, 2.0)]
    spread = ratios(fast, slow, lambda sample: sample.rate)
    assert (spread.median, spread.low, spread.high) == (3.0, 2.0, 5.0)


@pytest.mark.parametrize("kind", [contenders.MujocoBatch, contenders.MujocoRollout])
def test_mujocos_own_pools_step_as_mj_step_does(kind: type[contenders.Contender]) -> None:
    workload = Workload.of("ant", 3, 2)
    try:
        pool = kind(workload)
    except contenders.Unavailable as reason:
        pytest.skip(str(reason))
    assert pool.advance() == 3
    (qpos, qvel), actions = workload.states(3), workload.actions(3, np.float64).next()
    for env in range(3):
        data = mujoco.MjData(workload.model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[env], qvel[env], actions[env]
        mujoco.mj_step(workload.model, data, nstep=5)
        np.testing.assert_array_equal(pool._qpos[env], data.qpos)
        np.testing.assert_array_equal(pool._qvel[env], data.qvel)
    pool.close()


def test_all_contenders_meet_the_same_states_on_the_ground() -> None:
    workload = Workload.of("ant", 64, 1)
    qpos, qvel = workload.states(64)
    np.testing.assert_array_equal(qpos, Workload.of("ant", 64, 1).states(64)[0])
    assert ((qpos[:, 2] >= 0.2) & (qpos[:, 2] <= 1.0)).all()
    data, touching = mujoco.MjData(workload.model), 0
    for index in range(64):
        data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
        mujoco.mj_forward(workload.model, data)
        touching += data.ncon > 0
    assert touching > 16  # at the start of an episode nobody touches the floor


def test_episodes_end_by_height_by_time_and_by_not_a_number() -> None:
    workload = Workload.of("ant", 3, 1)
    episodes = Episodes(workload, 3)
    assert list(episodes.ended(np.array([0.5, 0.1, np.nan]))) == [1, 2]
    for _ in range(998):
        assert episodes.ended(np.array([0.5, 0.5, 0.5])).size == 0
    assert list(episodes.ended(np.array([0.5, 0.5, 0.5]))) == [0]


def test_actions_stay_in_range_and_do_not_repeat_soon() -> None:
    actions = Workload.of("ant", 4, 1).actions(4)
    seen = {actions.next().tobytes() for _ in range(997)}
    assert len(seen) == 997
    batch = actions.next()
    assert (batch.shape, batch.dtype) == ((4, 8), np.float32)
    assert batch.flags.c_contiguous
    assert np.abs(batch).max() <= 1.0


def test_a_training_that_fails_says_what_it_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learner, "_PROGRAM", "import sys; sys.exit('no such robot')")
    share = learner.learner_share("ant", 1)
    assert "exit code 1" in share.error
    assert "no such robot" in share.error
    assert share.share == 0.0


def test_a_run_without_metrics_is_an_error_not_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learner, "_PROGRAM", "pass")
    assert "config.toml" in learner.learner_share("ant", 1).error


@pytest.mark.slow
def test_the_learners_share_comes_from_a_real_training_run() -> None:
    settings = ("env.num_envs=4", "horizon=16", "env.max_episode_steps=8")
    share = learner.learner_share("ant", 2, steps=192, settings=settings)
    assert share.error == ""
    assert (share.num_envs, share.horizon, share.iterations) == (4, 16, 2)
    assert 0.0 < share.share < 1.0
