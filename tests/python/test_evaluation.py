"""`dappo-batch evaluate`: groups of classes, encodings of the damage code, and the comparison of learners."""

from __future__ import annotations

import csv
import json
import math
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch as package

from .command_line import ITERATION, TINY, dappo_batch, dappo_batch_many, files, start

PAIRS = (*TINY, "damage.max_damaged_limbs=2", "evaluation.episodes=2")
AWARE = ("aware-1", "aware-2", "aware-3")
UNAWARE = ("unaware-1", "unaware-2")

Row = dict[str, str]
Arm = NDArray[np.float64]


def read(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def column(rows: list[Row], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])


def evaluate(*arguments: str | Path) -> tuple[dict[str, Any], str]:
    """Evaluate with ``--json``; return what was printed and the notes."""
    out, err = dappo_batch("evaluate", *arguments, "--json")
    assert out.count("\n") == 1, "one JSON object"
    return json.loads(out), err


@pytest.fixture(scope="module")
def downhill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an Ant on a slope: whatever a policy does, it gets forward, and ratios of means make sense."""
    folder = tmp_path_factory.mktemp("downhill") / "robots"
    shutil.copytree(Path(package.load_robot("ant").path).parent, folder)
    model = folder / "ant.xml"
    old = 'integrator="RK4"'
    text = model.read_text()
    assert text.count(old) == 1
    model.write_text(text.replace(old, f'{old} gravity="8 0 -9.81"'))
    return folder / "ant.toml"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, downhill: Path) -> Path:
    """Train two learners with several seeds; return the folder of their runs."""
    folder = tmp_path_factory.mktemp("runs")
    train = ("train", "--robot", downhill, "--steps", str(ITERATION))
    results = dappo_batch_many(
        *((*train, "--run", folder / name, "--seed", name[-1], *PAIRS) for name in AWARE),
        *((*train, "--run", folder / name, "--unaware", "--seed", name[-1], *PAIRS) for name in UNAWARE),
    )
    assert [code for code, _, _ in results] == [0] * 5, results
    return folder


@pytest.fixture(scope="module")
def compared(runs: Path) -> tuple[dict[str, Any], str]:
    """Compare the learners, for people and for programs; the files are left in the first run."""
    command = ("evaluate", *(runs / name for name in AWARE), "--compare", *(runs / name for name in UNAWARE))
    (code, out, _), (again, text, _) = dappo_batch_many((*command, "--json"), command)
    assert (code, again) == (0, 0)
    found: dict[str, Any] = json.loads(out)
    return found, text


def test_the_groups_are_those_of_the_table_of_classes(runs: Path) -> None:
    for name in (AWARE[0], UNAWARE[0]):
        classes = read(runs / name / "eval" / "per_class.csv")
        groups = read(runs / name / "eval" / "groups.csv")
        names = list(dict.fromkeys(row["group"] for row in classes))
        assert [row["group"] for row in groups] == [*names, "all"]
        assert len(names) == 9
        for group in groups:
            rows = [row for row in classes if group["group"] in (row["group"], "all")]
            assert int(group["classes"]) == len(rows)
            for count in ("episodes", "falls", "diverged"):
                assert int(group[count]) == sum(int(row[count]) for row in rows)
            # Both tables are rounded to four decimals.
            errors = column(rows, "standard_error")
            error = math.sqrt(sum(errors**2)) / len(rows)
            assert float(group["standard_error"]) == pytest.approx(error, abs=1.1e-4)
            mean = column(rows, "forward_reward").mean()
            assert float(group["forward_reward"]) == pytest.approx(mean, abs=1.1e-4)
            assert (group["backend"], group["precision"]) == (rows[0]["backend"], rows[0]["precision"])


def test_a_single_episode_has_no_standard_error_in_any_table(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    found, _ = evaluate(run, "--episodes", "1")
    for table in ("per_class.csv", "groups.csv"):
        assert {row["standard_error"] for row in read(run / "eval" / "episodes-1" / table)} == {""}
    assert {group["standard_error"] for group in found["runs"][0]["groups"]} == {None}


def test_every_run_gets_its_tables_and_equal_start_states(
    runs: Path, compared: tuple[dict[str, Any], str]
) -> None:
    found, _ = compared
    sides = {"runs": AWARE, "others": UNAWARE}
    for side, names in sides.items():
        assert [(run["run"], run["seed"]) for run in found[side]] == [
            (str(runs / name), int(name[-1])) for name in names
        ]
        for run in found[side]:
            rows = read(Path(run["run"]) / "eval" / "per_class.csv")
            rewards = [entry["forward_reward"] for entry in run["classes"]]
            assert column(rows, "forward_reward") == pytest.approx(rewards, abs=1e-4)


def arms(runs: Path) -> tuple[Arm, Arm]:
    """Read the forward rewards `[seeds, classes]` of both learners."""
    first, second = (
        np.stack([column(read(runs / name / "eval" / "per_class.csv"), "forward_reward") for name in names])
        for names in (AWARE, UNAWARE)
    )
    return first, second


def test_the_table_of_a_comparison_holds_means_over_seeds(
    runs: Path, compared: tuple[dict[str, Any], str]
) -> None:
    found, _ = compared
    rows = read(runs / AWARE[0] / "eval" / "comparison.csv")
    aware, unaware = (arm.mean(0) for arm in arms(runs))
    assert column(rows, "forward_reward") == pytest.approx(aware, abs=1.1e-4)
    assert column(rows, "other_forward_reward") == pytest.approx(unaware, abs=1.1e-4)
    assert column(rows, "difference") == pytest.approx(aware - unaware, abs=2.1e-4)
    assert {(row["seeds"], row["other_seeds"]) for row in rows} == {("3", "2")}
    assert [row["better"] for row in rows] == [
        "true" if better else "false" for better in column(rows, "difference") > 0
    ]
    known = read(runs / AWARE[0] / "eval" / "per_class.csv")
    assert [[row[key] for key in ("class", "name", "group")] for row in rows] == [
        [row[key] for key in ("class", "name", "group")] for row in known
    ]
    summary = found["comparison"]["summary"]
    won = sum(row["better"] == "true" for row in rows)
    assert 0 < won < len(rows)
    assert (summary["classes_won"], summary["share_won"]) == (won, pytest.approx(won / 33))
    assert summary == json.loads((runs / AWARE[0] / "eval" / "comparison.json").read_text())


RESAMPLES = 10_000
# Standard deviation of a 2.5 % quantile of 10 000 normal numbers, in their standard deviations:
# √(.025 · .975 / 10000) / scipy.stats.norm.pdf(1.96). Two bootstraps differ by √2 of it; five times that.
TOLERANCE = 5 * math.sqrt(2) * 0.0267


def resampled(arms: tuple[Arm, Arm], *, draw_seeds: bool = True) -> tuple[Arm, Arm]:
    """Return the means of both learners in resamples of classes and seeds."""
    chance = np.random.default_rng(7)
    count = arms[0].shape[1]
    classes = chance.integers(count, size=(RESAMPLES, count))
    means = []
    for arm in arms:
        seeds = np.broadcast_to(np.arange(len(arm)), (RESAMPLES, len(arm)))
        if draw_seeds:
            seeds = chance.integers(len(arm), size=seeds.shape)
        means.append(arm[seeds[:, :, None], classes[:, None, :]].mean((1, 2)))
    return means[0], means[1]


@pytest.mark.parametrize(
    ("key", "place", "count"), [("gain", "", 33), ("adjacent_pairs", " A", 16), ("opposite_pairs", " O", 8)]
)
def test_gains_and_their_intervals_equal_those_of_numpy(
    runs: Path, compared: tuple[dict[str, Any], str], key: str, place: str, count: int
) -> None:
    groups = [row["group"] for row in read(runs / AWARE[0] / "eval" / "comparison.csv")]
    chosen = [index for index, group in enumerate(groups) if group.endswith(place)]
    aware, unaware = (arm[:, chosen] for arm in arms(runs))
    found = compared[0]["comparison"]["summary"][key]
    assert found["classes"] == len(chosen) == count
    first, second = resampled((aware, unaware))
    assert second.min() > 0, "the slope moves every robot forward"
    for name, value, values in [
        ("absolute", aware.mean() - unaware.mean(), first - second),
        ("relative", aware.mean() / unaware.mean() - 1, first / second - 1),
    ]:
        estimate, deviation = found[name], values.std()
        assert estimate["value"] == pytest.approx(value, abs=1e-3 * deviation)
        low, high = np.quantile(values, [0.025, 0.975])
        assert estimate["low"] == pytest.approx(low, abs=TOLERANCE * deviation)
        assert estimate["high"] == pytest.approx(high, abs=TOLERANCE * deviation)


def test_the_seeds_widen_the_intervals_so_that_the_comparison_with_numpy_sees_them(runs: Path) -> None:
    (first, second), (still, other) = resampled(arms(runs)), resampled(arms(runs), draw_seeds=False)
    with_seeds, without = np.ptp([np.quantile(x, [0.025, 0.975]) for x in (first - second, still - other)], 1)
    assert with_seeds - without > 2 * TOLERANCE * (first - second).std()


def test_a_comparison_is_printed_as_text_too(compared: tuple[dict[str, Any], str]) -> None:
    found, text = compared
    summary = found["comparison"]["summary"]
    lines = [line.strip() for line in text.splitlines()]
    for name, side, seeds in [("RUN", "runs", "3 seeds: 1, 2, 3"), ("OTHER", "others", "2 seeds: 1, 2")]:
        # Episodes of 50 ms a step, so that metres are twentieths of the reward.
        rewards = summary[side]["forward_reward"]
        walked = (
            f"forward reward {rewards:.1f}, {summary[side]['forward_velocity']:.2f} m/s, {rewards / 20:.1f} m"
        )
        assert f"mean of {name}: {walked} an episode ({seeds})" in lines
    won = f"{summary['classes_won']} of 33 ({100 * summary['share_won']:.1f} %)"
    assert f"classes in which RUN is ahead: {won}" in lines
    for key, words in [
        ("gain", "average gain"),
        ("adjacent_pairs", "average gain on adjacent pairs (16 classes)"),
        ("opposite_pairs", "average gain on opposite pairs (8 classes)"),
    ]:
        parts = []
        for name, factor, unit in [("absolute", 1, ""), ("relative", 100, " %")]:
            value, low, high = (
                f"{factor * summary[key][name][end]:+.1f}{unit}" for end in ("value", "low", "high")
            )
            parts.append(f"{value} [{low}, {high}]")
        assert f"{words}: {', '.join(parts)}" in lines
    assert lines[-1] == "intervals: 95 % of 10000 bootstrap resamples over classes and seeds"


def test_one_seed_and_missing_pairs_are_printed(tmp_path: Path) -> None:
    # One damage at most; on level ground the mean of a policy that never learnt is somewhere around 0.
    run, other = tmp_path / "run", tmp_path / "other"
    train = ("train", "--steps", str(ITERATION))
    command = ("evaluate", run, "--compare", other)
    results = dappo_batch_many(
        (*train, "--run", run, *TINY),
        (*train, "--run", other, "--unaware", "--seed", "5", *TINY),
        (*command, "--json"),
        command,
    )
    assert [code for code, _, _ in results] == [0] * 4
    text = results[3][1]
    summary = json.loads(results[2][1])["comparison"]["summary"]
    assert (summary["adjacent_pairs"], summary["opposite_pairs"]) == (None, None)
    assert "average gain on" not in text
    assert summary["intervals_cover"] == "classes only, as each side has one seed"
    assert text.rstrip().endswith("over classes only, as each side has one seed")
    no_ratio = summary["gain"]["relative"] is None
    assert no_ratio == ("no gain in per cent" in text)
    rewards = column(read(other / "eval" / "per_class.csv"), "forward_reward")[None]
    # The lowest of 10 000 means of 9 classes is close to the lowest reward.
    assert no_ratio == bool(resampled((rewards, rewards))[1].min() <= 0)


def test_an_evaluation_with_other_settings_leaves_that_of_the_run_alone(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    names = ["evaluation.json", "groups.csv", "per_class.csv"]
    own = {name: (run / "eval" / name).read_bytes() for name in names}
    dappo_batch("evaluate", run, "--episodes", "3", "--seed", "7")
    extra = run / "eval" / "episodes-3_seed-7"
    assert sorted(path.name for path in extra.iterdir()) == names
    stored = json.loads((extra / "evaluation.json").read_text())
    assert [entry["episodes"] for entry in stored["classes"]] == [3] * 33
    rows = read(extra / "per_class.csv")
    for entry, row in zip(stored["classes"], rows, strict=True):
        assert row["name"] == entry["name"]
        assert float(row["forward_reward"]) == pytest.approx(entry["forward_reward"], abs=1e-4)
    # With the settings of the run it is the same again.
    (run / "eval" / "per_class.csv").unlink()
    dappo_batch("evaluate", run)
    assert {name: (run / "eval" / name).read_bytes() for name in names} == own


def test_several_runs_alone_are_averaged(runs: Path, tmp_path: Path) -> None:
    copies = [shutil.copytree(runs / name, tmp_path / name) for name in AWARE]
    for copy in copies:
        shutil.rmtree(copy / "eval")
    found, _ = evaluate(*copies)
    assert (found["others"], found["comparison"]) == ([], None)
    written = {"per_class.csv", "groups.csv", "evaluation.json"}
    assert {path.name for path in tmp_path.glob("*/eval/*")} == written
    text, _ = dappo_batch("evaluate", *copies)
    means = [run["groups"][-1]["forward_reward"] for run in found["runs"]]
    lengths = [[entry["episode_length"] for entry in run["classes"]] for run in found["runs"]]
    rewards = [[entry["forward_reward"] for entry in run["classes"]] for run in found["runs"]]
    mean, velocity = np.mean(means), np.mean(np.divide(rewards, lengths))
    assert text.splitlines()[-1] == (
        f"mean of 3 runs: forward reward {mean:.1f}, {velocity:.2f} m/s, {mean / 20:.1f} m an episode, "
        f"from {min(means):.1f} to {max(means):.1f} (3 seeds: 1, 2, 3)"
    )


def test_the_damage_code_changes_the_actions_of_the_policy(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    before = files(run)
    commands = [("evaluate", run, "--encoding", name, "--json") for name in ("zero", "wrong", "random")]
    results = dappo_batch_many(*commands)
    assert [code for code, _, _ in results] == [0] * 3
    assert [json.loads(out)["runs"][0]["encoding"] for _, out, _ in results] == ["zero", "wrong", "random"]
    after = files(run)
    assert {name: after[name] for name in before} == before, "the true tables stay"
    assert sorted(after.keys() - before.keys()) == sorted(
        f"eval/{table.format(name)}"
        for table in ("per_class.{}.csv", "groups.{}.csv", "evaluation.{}.json")
        for name in ("zero", "wrong", "random")
    )
    tables = {
        name: column(read(run / "eval" / f"per_class{name}.csv"), "forward_reward")
        for name in ("", ".zero", ".wrong", ".random")
    }
    # All zeros are the code of the healthy robot, class 0.
    assert (tables[".zero"] == tables[""]).tolist() == [True] + [False] * 32
    assert not (tables[".wrong"] == tables[""]).any()
    assert not (tables[".random"] == tables[""]).any()


def test_the_cost_of_a_wrong_code_is_a_comparison_of_a_run_with_itself(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    found, _ = evaluate(run, "--encoding", "wrong", "--compare", run)
    summary = json.loads((run / "eval" / "comparison.wrong.json").read_text())
    assert summary == found["comparison"]["summary"]
    assert (summary["runs"]["encoding"], summary["others"]["encoding"]) == ("wrong", "true")
    wrong, true = (
        column(read(run / "eval" / f"per_class{name}.csv"), "forward_reward") for name in (".wrong", "")
    )
    rows = read(run / "eval" / "comparison.wrong.csv")
    assert column(rows, "forward_reward") == pytest.approx(wrong)
    assert column(rows, "other_forward_reward") == pytest.approx(true)


def test_results_do_not_depend_on_the_number_of_threads(runs: Path, tmp_path: Path) -> None:
    names = (AWARE[0], AWARE[1], UNAWARE[0])
    found = []
    for threads in ("1", "2"):
        folder = tmp_path / threads
        first, second, other = (shutil.copytree(runs / name, folder / name) for name in names)
        shutil.rmtree(first / "eval")
        command = ("evaluate", first, second, "--compare", other, "--threads", threads, "--json")
        results = dappo_batch_many(
            (*command, "--encoding", "wrong"),
            ("evaluate", first, "--encoding", "random", "--threads", threads),
        )
        assert [code for code, _, _ in results] == [0, 0]
        tables = files(first / "eval")
        # It names the run folders.
        summary = json.loads(tables.pop("comparison.wrong.json"))
        for entry in (*summary["runs"]["seeds"], *summary["others"]["seeds"]):
            del entry["run"]
        found.append((tables, summary))
    assert found[0] == found[1]
    assert len(found[0][0]) == 7


def edited(run: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """Copy a run and change its configuration, as if it had been trained so by an earlier version."""
    copy = shutil.copytree(run, folder)
    shutil.rmtree(copy / "robot")
    config = copy / "config.toml"
    text = config.read_text()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    config.write_text(text)
    return copy


OTHER_SEED = ("seed = 1\n", "seed = 9\n")


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ((("max_damaged_limbs = 2", "max_damaged_limbs = 1"),), ["`damage.max_damaged_limbs` is `1`", "`2`"]),
        ((("severity = 1.0", "severity = 0.5"),), ["`damage.severity` is `0.5`", "expected `1`"]),
        (
            (("max_episode_steps = 20", "max_episode_steps = 30"),),
            ["`env.max_episode_steps` is `30`", "`20`"],
        ),
        ((("first = 0", "first = 3"), ("last = 0", "last = 5")), ["`damage.onset` is `3 to 5`", "`0 to 0`"]),
        ((("observe_damage", 'physics = "euler"\nobserve_damage'),), ["`env.physics` is `euler`", "`rk4`"]),
    ],
    ids=lambda value: value[-1][-1] if isinstance(value, tuple) else "",
)
@pytest.mark.parametrize("flag", [(), ("--compare",)], ids=["together", "compared"])
def test_runs_of_other_episodes_are_rejected(
    runs: Path, tmp_path: Path, changes: tuple[tuple[str, str], ...], parts: list[str], flag: tuple[str, ...]
) -> None:
    other = edited(runs / AWARE[0], tmp_path / "other", OTHER_SEED, *changes)
    before = files(tmp_path)
    out, err = dappo_batch("evaluate", runs / AWARE[1], *flag, other, code=1)
    assert out == ""
    assert f"{other} cannot be evaluated together with {runs / AWARE[1]}: its " in err
    for part in parts:
        assert part in err
    assert files(tmp_path) == before


def test_runs_that_cannot_be_seeds_of_one_learner_or_of_one_robot_are_rejected(
    runs: Path, tmp_path: Path, downhill: Path
) -> None:
    aware, unaware = runs / AWARE[0], runs / UNAWARE[1]
    robot = (f'robot = "{downhill}"', 'robot = "hexapod"')
    reward = ('reward = "gym"', 'reward = "paper"')
    text = (aware / "config.toml").read_text()
    hexapod = edited(
        aware, tmp_path / "hexapod", *(change for change in (robot, reward) if change[0] in text)
    )
    cases: list[tuple[tuple[str | Path, ...], list[str]]] = [
        ((aware, "--compare", hexapod), [f"{hexapod} cannot", "`robot` is `hexapod`, expected `ant`"]),
        ((aware, unaware), [f"{aware} is a run of DA-PPO and {unaware} one of PPO-Unaware", "--compare"]),
        ((aware, aware), ["both trained with seed 1", "must differ"]),
        ((aware, "--compare", unaware, unaware), ["both trained with seed 2", "must differ"]),
        ((aware, "--compare", "nowhere"), ["nowhere is not a run folder"]),
        *(
            (
                (unaware, "--encoding", name),
                [f"{unaware}: ", "does not observe the damage", f"`{name}`", "`true`"],
            )
            for name in ("zero", "wrong", "random")
        ),
    ]
    results = dappo_batch_many(*(("evaluate", *arguments) for arguments, _ in cases))
    for (code, out, err), (arguments, parts) in zip(results, cases, strict=True):
        assert (code, out) == (1, ""), arguments
        for part in parts:
            assert part in err
        assert "Traceback" not in err


def test_a_signal_ends_an_evaluation_with_130_and_keeps_the_old_tables(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    before = files(run)
    # Without the signal this takes a minute.
    process = start("evaluate", run, "--episodes", "1000", "--compare", runs / UNAWARE[0])
    assert process.stderr is not None
    assert process.stderr.readline().startswith("backend ")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert out == ""
    assert "Traceback" not in err
    assert files(run) == before


def test_a_function_takes_the_place_of_the_policy(runs: Path, tmp_path: Path) -> None:
    """It gets what the policy gets: the policy itself, called as a function, does the same."""
    run = shutil.copytree(runs / UNAWARE[0], tmp_path / "run")
    own = package.evaluate(run).runs[0]
    before = files(run)
    policy = package.Policy.load(run, threads=1)
    shapes = []

    def same(obs: NDArray[np.float32]) -> NDArray[np.float32]:
        shapes.append((obs.dtype, obs.shape))
        return policy.act(obs)

    report = package.evaluate(run, act=same, compare=[runs / AWARE[0]])
    found = report.runs[0]
    assert (found.classes, found.groups) == (own.classes, own.groups)
    assert (found.run, found.seed, found.env_steps) == ("same", None, None)
    assert report.comparison is not None
    assert [row.score for row in report.comparison.classes] == [row.forward_reward for row in own.classes]
    # An episode has 20 steps at most.
    assert shapes == [(np.dtype(np.float32), (2 * len(own.classes), policy.obs_dim))] * 20
    assert {path: text for path, text in files(run).items() if path in before} == before
    assert (run / "eval" / "act-same" / "per_class.csv").exists()
    assert (run / "eval" / "act-same" / "comparison.json").exists()


def test_a_function_of_a_module_gets_the_damage_code_that_the_run_observes(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shutil.copytree(runs / AWARE[0], tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "a_peer", raising=False)
    Path("a_peer.py").write_text(
        "from pathlib import Path\n\n"
        "from tests.python.numpy_policy import mean_actions\n\n\n"
        "class Peer:\n"
        "    resets = 0\n\n"
        "    def reset(self):\n"
        "        self.resets += 1\n\n"
        "    def __call__(self, obs):\n"
        "        assert self.resets == 1\n"
        "        return mean_actions(Path('run'), obs[:, :-CODES], obs[:, -CODES:])\n\n\n"
        "act = Peer()\n".replace("CODES", str(package.Policy.load(run).code_length))
    )
    out, _ = dappo_batch("evaluate", run, "--act", "a_peer:act", "--encoding", "wrong")
    assert out.splitlines()[0].startswith("class")
    found = column(read(run / "eval" / "act-a_peer.act" / "per_class.wrong.csv"), "forward_reward")
    dappo_batch("evaluate", run, "--encoding", "wrong")
    own = column(read(run / "eval" / "per_class.wrong.csv"), "forward_reward")
    # Single and double precision part ways within an episode, but hardly in 20 steps.
    np.testing.assert_allclose(found, own, rtol=1e-3, atol=1e-3)
    assert np.ptp(own) > 0.1


def test_functions_that_are_no_policies_are_rejected(runs: Path, tmp_path: Path) -> None:
    run = shutil.copytree(runs / UNAWARE[0], tmp_path / "run")
    before = files(run)

    def fail(obs: NDArray[np.float32]) -> NDArray[np.float32]:
        raise ZeroDivisionError("of a peer")

    robots = 2 * len(package.Policy.load(run).class_names)
    cases: list[tuple[Any, list[str]]] = [
        (
            lambda obs: obs[:, :3],
            [f"returned shape ({robots}, 3)", f"expected numbers of shape ({robots}, 8)"],
        ),
        (lambda obs: np.full((len(obs), 8), np.nan), ["not finite for env 0"]),
        (lambda obs: [["x"] * 8] * len(obs), ["expected numbers"]),
        (fail, ["the policy raised ZeroDivisionError: of a peer", "in fail"]),
        (3, ['act must be a function or "module:function", got 3']),
        ("nowhere:act", ["cannot import the module 'nowhere'"]),
        ("json:nothing", ["the module 'json' has no function 'nothing', which act needs"]),
        ("json", ["needs a function as \"module:function\", got 'json'"]),
    ]
    for act, parts in cases:
        with pytest.raises(package.ConfigError) as caught:
            package.evaluate(run, act=act)
        for part in parts:
            assert part in str(caught.value)
    with pytest.raises(package.ConfigError, match="the place of the policy of one run, got 2 runs"):
        package.evaluate(run, runs / UNAWARE[1], act=fail)
    assert files(run) == before


@pytest.mark.parametrize(
    ("key", "value", "name"),
    [
        ("severity", "0.5", "damage.severity-0.5"),
        ("max_damaged_limbs", "1", "damage.max_damaged_limbs-1"),
        ("onset", "{ first = 5, last = 9 }", "damage.onset.first-5_damage.onset.last-9"),
    ],
)
def test_episodes_may_differ_from_those_of_the_training(
    runs: Path, tmp_path: Path, key: str, value: str, name: str
) -> None:
    """As if the run had been trained with this damage: its configuration is edited for a comparison."""
    run, edited = (shutil.copytree(runs / AWARE[0], tmp_path / place) for place in ("run", "edited"))
    own = files(run / "eval")
    found, _ = evaluate(run, "--set", f"damage.{key}={value}")
    assert {path: text for path, text in files(run / "eval").items() if "/" not in path} == own
    assert (run / "eval" / name / "per_class.csv").exists()
    config = edited / "config.toml"
    lines = [line for line in config.read_text().splitlines() if not line.startswith(f"{key} =")]
    lines.insert(lines.index("[damage]") + 1, f"{key} = {value}")
    text = "\n".join(lines)
    config.write_text(text.replace("[damage.onset]\nfirst = 0\nlast = 0\n", "") if key == "onset" else text)
    expected, _ = evaluate(edited, "--robot-changed", "use-file")
    assert found["runs"][0]["classes"] == expected["runs"][0]["classes"]
    assert found["runs"][0]["classes"] != evaluate(run)[0]["runs"][0]["classes"]


def test_policies_of_other_damage_are_compared_with_the_same(
    runs: Path, tmp_path: Path, downhill: Path
) -> None:
    single = tmp_path / "single"
    train = ("train", "--robot", downhill, "--steps", str(ITERATION), "--run", single, *TINY)
    dappo_batch(*train, "evaluation.episodes=2")
    pairs = ("--set", "damage.max_damaged_limbs=2")
    found, _ = evaluate(single, "--compare", runs / UNAWARE[0], *pairs)
    names = [item.name for item in package.compile_class_table("ant", max_damaged_limbs=2).space.classes]
    assert [row["name"] for row in found["runs"][0]["classes"]] == names
    assert found["comparison"]["summary"]["gain"]["classes"] == len(names)
    # That of the other run alone, in the same episodes.
    assert found["others"][0]["classes"] == evaluate(runs / UNAWARE[0])[0]["runs"][0]["classes"]
    weak = evaluate(runs / UNAWARE[0], "--set", 'damage.types=["weak_motor"]')[0]["runs"][0]["classes"]
    assert weak[1]["name"] == "weak_motor@0"


def test_settings_that_no_episode_depends_on_are_rejected(runs: Path) -> None:
    for setting, expected in (
        ("ppo.gamma=0.9", "`ppo.gamma` cannot be set for an evaluation"),
        ("evaluation.episodes=3", "`evaluation.episodes` cannot be set for an evaluation"),
        ('damage.types=["missing_toe", "jammed_joint"]', "whose codes are those of the types"),
        ("damage.severity=7", "`damage.severity`"),
    ):
        _, error = dappo_batch("evaluate", runs / AWARE[0], "--set", setting, code=1)
        assert expected in error


def test_codes_are_as_late_as_in_an_env(runs: Path) -> None:
    seen: list[NDArray[np.float32]] = []

    def act(obs: NDArray[np.float32]) -> NDArray[np.float32]:
        seen.append(obs[:, -8:])
        return np.zeros((len(obs), 8), np.float32)

    course = {"damage.onset": {"first": 4, "last": 4}, "damage.code_delay": {"first": 3, "last": 3}}
    package.evaluate(runs / AWARE[0], act=act, set=course, episodes=1, threads=1)
    envs = package.make_vec("ant", 33, onset=4, code_delay=3, max_episode_steps=20, seed=0)
    obs, _ = envs.reset(options={"damage_class": list(range(33))})
    for code in seen:
        np.testing.assert_array_equal(code, obs[:, -8:])
        obs = envs.step(np.zeros((33, 8), np.float32))[0]
    assert [bool(code.any()) for code in seen] == [False] * 8 + [True] * (len(seen) - 8)
    # A code that never arrives is that of a healthy robot.
    never = ("--set", "damage.code_delay.first=1000", "damage.code_delay.last=1000")
    late, zero = (evaluate(runs / AWARE[0], *how)[0]["runs"][0] for how in (never, ("--encoding", "zero")))
    assert late["classes"] == zero["classes"]
