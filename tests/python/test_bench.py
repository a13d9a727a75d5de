"""The benchmark measures every simulator or reports it as missing, and prints tables and JSON."""

from __future__ import annotations

import itertools
import json
import time
from typing import Any

import mujoco
import numpy as np
import pytest

from dappo_batch import ConfigError, bench, machine
from dappo_batch.bench import simulators
from dappo_batch.bench.measure import Sample, Spread, align, measure_rounds
from dappo_batch.bench.simulators import SIMULATORS, Workload
from dappo_batch.robots import load_robot

from .command_line import dappo_batch

OURS = {"lanes f32", "lanes f32 damaged", "lanes f64", "mujoco"}


def workload(robot: str = "ant", num_envs: int = 3, threads: int = 2) -> Workload:
    return Workload(load_robot(robot), num_envs, threads)


@pytest.fixture(scope="module")
def report() -> bench.Report:
    """Measure a few envs for a moment."""
    return bench.run("ant", num_envs=3, threads=2, seconds=0.01, rounds=2)


def test_every_simulator_is_measured_or_reported_as_missing(report: bench.Report) -> None:
    measured = {result.key for result in report.results}
    missing = {one.key: one for one in report.missing}
    assert measured | set(missing) == set(SIMULATORS)
    assert not measured & set(missing)
    assert {"mj_step", *OURS} <= measured
    for one in missing.values():
        assert one.reason
        assert one.install.startswith("pip install")
        assert one.install in report.text()


def test_rates_and_processor_times_are_positive_and_ordered(report: bench.Report) -> None:
    for result in report.results:
        for spread in (result.rate, result.cpu_us, result.ratio):
            assert 0.0 < spread.low <= spread.median <= spread.high < float("inf"), result.key


def test_mj_step_is_the_base_of_all_ratios(report: bench.Report) -> None:
    base = next(result for result in report.results if result.key == "mj_step")
    assert (base.ratio.low, base.ratio.high) == (1.0, 1.0)


def test_the_report_contains_the_machine_and_the_settings(report: bench.Report) -> None:
    assert report.machine["mujoco"] == mujoco.__version__
    assert report.settings == {"robot": "ant", "num_envs": 3, "threads": 2, "seconds": 0.01, "rounds": 2}
    assert report.machine["flags"] == machine.cpu_flags()
    assert report.text().startswith(f"{machine.cpu_name()}, {' '.join(machine.cpu_flags())}")
    assert mujoco.__version__ in report.text()


def test_the_command_prints_the_whole_report_as_json() -> None:
    arguments = ["--robot", "hexapod", "--envs", "2", "--threads", "1", "--seconds", "0.01", "--rounds", "1"]
    found = json.loads(dappo_batch("bench", *arguments, "--json")[0])
    assert {one["key"] for one in (*found["results"], *found["missing"])} == set(SIMULATORS)
    assert (found["settings"]["robot"], found["settings"]["num_envs"], found["base"]) == (
        "hexapod",
        2,
        "mj_step",
    )
    missing = {one["key"]: one for one in found["missing"]}
    assert "hexapod" in missing["gymnasium"]["reason"]
    assert missing["gymnasium"]["install"] == ""  # nothing can be installed


def test_a_missing_envpool_is_reported_with_its_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(simulators.Unavailable, match="not installed") as caught:
        simulators.EnvPool(workload())
    assert caught.value.install == "pip install envpool"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must be at least 1"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"seconds": 0.0}, "seconds must be above 0"),
        ({"robot": "unicorn"}, "unknown robot"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        bench.run(**arguments)


class Busy(simulators.Simulator):
    """Burns 2 ms of processor time in five env steps."""

    num_envs = 5

    def __init__(self, key: str, log: list[str]) -> None:
        self._key, self._log = key, log

    def run_for(self, seconds: float, steps: int = 1) -> int:
        self._log.append(self._key if steps == 1 else f"warm {self._key}")
        end = time.process_time() + 0.002
        while time.process_time() < end:
            pass
        return 5

    def close(self) -> None: ...


def test_rounds_rotate_and_count_env_steps() -> None:
    log: list[str] = []
    samples = measure_rounds({key: Busy(key, log) for key in "abc"}, 1e-6, 3, lambda _: None)
    assert log == ["warm a", "warm b", "warm c", "a", "b", "c", "b", "c", "a", "c", "a", "b"]
    for own in samples.values():
        assert [sample.steps for sample in own] == [5, 5, 5]
        # 2 ms for 5 env steps: 400 µs each at least, and wall time is no shorter.
        assert all(sample.cpu_us >= 399.0 and sample.wall_seconds >= 0.0019 for sample in own)


def test_rates_are_compared_within_a_round() -> None:
    fast = [Sample(30, 1.0, 1.0), Sample(60, 1.0, 1.0), Sample(100, 1.0, 2.0)]
    slow = [Sample(10, 1.0, 1.0), Sample(30, 1.0, 1.0), Sample(20, 1.0, 2.0)]
    result = bench._result("fast", Busy("fast", []), fast, slow)
    assert result.ratio == Spread(3.0, 2.0, 5.0)
    assert result.rate == Spread(60.0, 30.0, 100.0)


@pytest.mark.parametrize("key", [*sorted(OURS), "mj_step", "gymnasium"])
def test_env_steps_of_all_envs_are_counted(key: str) -> None:
    try:
        simulator = SIMULATORS[key](workload())
    except simulators.Unavailable as error:
        pytest.skip(str(error))
    try:
        count = {"mj_step": 2}.get(key, 3)  # one robot a thread
        assert simulator.run_for(0.0) == count
        assert simulator.run_for(0.0, 7) == 7 * count
    finally:
        simulator.close()


def test_raw_steps_are_those_of_mujoco_with_episodes_of_the_robot() -> None:
    raw = SIMULATORS["mj_step"](workload(threads=1))
    raw.run_for(0.0, 3000)
    (data,) = raw._data  # type: ignore[attr-defined]
    raw.close()
    assert data.time <= 1000 * 5 * 0.01 + 1e-9  # at most the 1000 env steps of Gymnasium's Ant
    assert 0.2 <= data.qpos[2] <= 1.0


def test_actions_stay_in_range_and_do_not_repeat_soon() -> None:
    actions = workload().actions(4)
    batches = list(itertools.islice(actions, 998))
    assert len({batch.tobytes() for batch in batches[:997]}) == 997
    assert (batches[0].shape, batches[0].dtype) == ((4, 8), np.float32)
    assert batches[0].flags.c_contiguous
    assert max(np.abs(batch).max() for batch in batches) <= 1.0


def test_all_columns_but_the_first_are_right_aligned() -> None:
    assert align([("a", "x"), ("bcd", "123")]) == "a      x\nbcd  123"
