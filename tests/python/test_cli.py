"""The command line: usage, help, configuration and evaluation."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import pytest

import dappo_batch as package
from dappo_batch import load_run
from dappo_batch._core import DamageSpace, run_cli

from .. import processes
from .command_line import ITERATION, TINY, dappo_batch, dappo_batch_many

CONFIGS = Path(__file__).parents[2] / "configs"
TRIPOD = str(Path(__file__).parent / "robots" / "tripod.toml")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train once."""
    run = tmp_path_factory.mktemp("cli") / "run"
    dappo_batch("train", "--run", run, "--steps", str(ITERATION), *TINY)
    return run


@pytest.mark.parametrize(
    "command", ["train", "evaluate", "report", "sweep", "classes", "config", "bench", "doctor"]
)
def test_every_command_has_a_help_text(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run_cli([command, "--help"]) == 0
    out, err = capfd.readouterr()
    assert "usage" in out.lower()
    assert err == ""
    assert run_cli(["--help"]) == 0
    assert f"  {command} " in capfd.readouterr().out


def test_the_version_is_that_of_the_package(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_cli(["--version"]) == 0
    assert capfd.readouterr().out == f"dappo-batch {package.__version__}\n"


def test_the_package_runs_as_a_module() -> None:
    module = [sys.executable, "-m", "dappo_batch"]
    done = processes.run([*module, "--version"], timeout=60)
    assert (done.returncode, done.stdout) == (0, f"dappo-batch {package.__version__}\n")
    done = processes.run([*module, "fly"], timeout=60)
    assert done.returncode == 2
    assert "'fly'" in done.stderr


# Arguments, exit code, and what the message must hold: what was wrong and what is expected.
BAD_USAGE = [
    ((), 2, ["Usage: dappo-batch"]),
    (("fly",), 2, ["'fly'", "--help"]),
    (("train", "--bogus"), 2, ["'--bogus'", "--help"]),
    (("train", "--envs", "0"), 2, ["'0'", "--envs", "at least 1"]),
    (("train", "--envs", "-3"), 2, ["'-3'", "--envs", "at least 1"]),
    (("train", "--steps", "0"), 2, ["'0'", "--steps", "at least 1"]),
    (("train", "--seed", "-1"), 2, ["'-1'", "--seed", "at least 0"]),
    (("train", "--threads", "0"), 2, ["'0'", "--threads", "at least 1"]),
    (("train", "--device", "tpu"), 2, ["'tpu'", "--device", "auto, cpu, gpu, cuda, warp-cpu"]),
    (("train", "--physics", "verlet"), 2, ["'verlet'", "rk4", "euler"]),
    (("train", "--backend", "brax"), 2, ["'brax'", "--backend", "auto, lanes, mujoco"]),
    (("train", "--precision", "f16"), 2, ["'f16'", "--precision", "f32, f64"]),
    (("train", "--resume", "somewhere", "--envs", "8"), 2, ["--resume", "--envs"]),
    (("train", "--resume", "somewhere", "--backend", "mujoco"), 2, ["--resume", "--backend"]),
    (("train", "--resume", "somewhere", "--precision", "f64"), 2, ["--resume", "--precision"]),
    (("evaluate", "somewhere", "--backend", "brax"), 2, ["'brax'", "--backend"]),
    (("evaluate", "somewhere", "--precision", "f16"), 2, ["'f16'", "--precision"]),
    (("evaluate", "somewhere", "--episodes", "0"), 2, ["'0'", "--episodes", "at least 1"]),
    (("evaluate", "somewhere", "--encoding", "lie"), 2, ["'lie'", "true, zero, wrong, random"]),
    (("evaluate", "somewhere", "--compare"), 2, ["--compare", "<OTHER>"]),
    (("evaluate", "--compare", "somewhere"), 2, ["<RUN>"]),
    (("evaluate",), 2, ["<RUN>"]),
    (("bench", "--rounds", "0"), 2, ["'0'", "--rounds", "at least 1"]),
    (("bench", "--seconds", "inf"), 2, ["'inf'", "--seconds", "above 0"]),
    (("bench", "--robot", "unicorn"), 1, ["'unicorn'", "ant", "hexapod"]),
    (("doctor", "--bogus"), 2, ["'--bogus'", "--help"]),
    (("report",), 2, ["<PATH>"]),
    (("sweep",), 2, ["--out <DIR>"]),
    (("sweep", "--out", "sweep", "--jobs", "0"), 2, ["'0'", "--jobs", "at least 1"]),
    (("sweep", "--out", "sweep", "--grid", "seed"), 2, ["`seed` is not an assignment", "seed=0,1,2"]),
    (("train", "--robot", "unicorn"), 1, ["'unicorn'", "ant", "hexapod", ".toml"]),
    (("train", "--config", "nowhere.toml"), 1, ["nowhere.toml", "No such file"]),
    (("train", "--set", "ppo.gama=0.9"), 1, ["`ppo.gama`", "`ppo.gamma`"]),
    (("train", "--set", "num_envs=8"), 1, ["`num_envs` is not a setting", "did you mean `env.num_envs`?"]),
    (("train", "--steps", "1.5"), 2, ["'1.5'", "--steps", "whole number"]),
    (("train", "--steps", "1e17"), 2, ["'1e17'", "--steps"]),
    (("train", "--seed", "nan"), 2, ["'nan'", "--seed"]),
    (("train", "--set", "sead=1"), 1, ["`sead`", "`seed`"]),
    (("train", "--set", "seed=x"), 1, ['"x"', "`seed`"]),
    (("train", "--set", "seed"), 1, ["`seed` is not an assignment", "key=value"]),
    (("train", "--set", "damage.severity=2"), 1, ["`damage.severity` is 2", "at most 1"]),
    (("train", "--set", "total_steps=0"), 1, ["`total_steps` is 0", "at least 1"]),
    (("train", "--set", "env.backend=brax"), 1, ["`brax`", "`auto`, `lanes`, `mujoco`"]),
    (("train", "--set", "env.precision=f16"), 1, ["`f16`", "`f32` or `f64`"]),
    (("train", "--set", "evaluation.precision=f16"), 1, ["`f16`", "`f32` or `f64`"]),
    (
        ("train", "--robot", TRIPOD, "--backend", "lanes"),
        1,
        ["lane engine cannot simulate", "tendon `belt` has a spring"],
    ),
    (("train", "--set", "ppo.preset=papre"), 1, ["papre", "paper", "batch"]),
    (("train", "--set", "damage.max_damaged_limbs=5"), 1, ["5", "4 limbs"]),
    (("train", "--reward", "gold"), 1, ["`gold`", "gym", "paper"]),
    (
        ("train", "--set", "curriculum=[{name='a',mix='healthy'},{name='b',mix='jam@0'}]"),
        1,
        ["`jam@0`", "jammed_joint"],
    ),
    (
        ("train", "--resume", "nowhere"),
        1,
        ["nowhere is not a run folder", "config.toml", "`dappo-batch train`"],
    ),
    (("evaluate", "nowhere"), 1, ["nowhere is not a run folder", "config.toml"]),
    (("classes", "--robot", "unicorn"), 1, ["'unicorn'", "ant", "hexapod"]),
    (("classes", "--types", "rust"), 1, ["'rust'", "jammed_joint"]),
    (("classes", "--max-damaged-limbs", "5"), 1, ["5", "4 limbs"]),
    (("config", "--robot", "unicorn"), 1, ["'unicorn'", "ant", "hexapod"]),
]


@pytest.mark.parametrize(("arguments", "code", "parts"), BAD_USAGE, ids=lambda value: str(value)[:60])
def test_bad_usage_is_explained_and_makes_no_run(
    arguments: tuple[str, ...],
    code: int,
    parts: list[str],
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_cli(list(arguments)) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert "Traceback" not in err
    for part in parts:
        assert part in err
    assert list(tmp_path.iterdir()) == [], "a run that cannot begin must leave nothing behind"


def test_a_folder_that_holds_a_run_is_not_overwritten(run: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = (run / "config.toml").read_bytes()
    assert run_cli(["train", "--run", str(run), *TINY]) == 1
    err = capfd.readouterr().err
    assert f"{run} already holds a run" in err
    assert "--resume" in err
    assert (run / "config.toml").read_bytes() == before


def test_a_run_folder_that_cannot_be_created_is_in_the_error(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert run_cli(["train", "--run", str(tmp_path / "file" / "run"), *TINY]) == 1
    assert str(tmp_path / "file" / "run") in capfd.readouterr().err
    assert run_cli(["train", "--run", str(tmp_path / "file"), *TINY]) == 1
    assert str(tmp_path / "file") in capfd.readouterr().err


def test_the_exit_code_leaves_the_process() -> None:
    script = Path(sys.executable).with_name("dappo-batch")
    done = processes.run([script, "fly"], timeout=60)
    assert done.returncode == 2
    assert done.stdout == ""


def config(capfd: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert run_cli(["config", *arguments]) == 0
    return tomllib.loads(capfd.readouterr().out)


def test_later_sources_of_a_setting_win(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("seed = 1\ntotal_steps = 1000\n[env]\nnum_envs = 8\n")
    found = config(capfd, "--config", str(file), "--seed", "2", "--steps", "2000", "--set", "seed=3")
    assert (found["seed"], found["total_steps"]) == (3, 2000)
    env = found["env"]
    assert isinstance(env, dict)
    assert (env["num_envs"], env["observe_damage"]) == (8, True)


def test_large_numbers_may_be_written_with_an_exponent(capfd: pytest.CaptureFixture[str]) -> None:
    assert config(capfd, "--steps", "1.5e6")["total_steps"] == 1_500_000
    assert config(capfd, "--total-steps", "2E3", "--num-envs", "1e1")["total_steps"] == 2000


@pytest.mark.parametrize("robot", ["ant", "hexapod"])
def test_the_built_in_configurations_have_the_documented_values(
    robot: str, capfd: pytest.CaptureFixture[str]
) -> None:
    own = config(capfd, "--robot", robot)
    assert own["robot"] == robot
    assert config(capfd, "--config", str(CONFIGS / f"{robot}.toml")) == own
    unaware = config(capfd, "--config", str(CONFIGS / f"{robot}_unaware.toml"))
    assert unaware == config(capfd, "--robot", robot, "--unaware")
    assert isinstance(own["env"], dict)
    assert unaware == {**own, "env": {**own["env"], "observe_damage": False}}


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_what_the_code_makes_possible_is_off_without_it(
    robot: str, capfd: pytest.CaptureFixture[str]
) -> None:
    def damage(*arguments: str) -> dict[str, object]:
        section = config(capfd, "--robot", robot, *arguments)["damage"]
        assert isinstance(section, dict)
        return section

    assert damage()["min_class_steps"] == 1000
    assert "min_class_steps" not in damage("--unaware")
    assert damage("--unaware", "--set", "damage.min_class_steps=7")["min_class_steps"] == 7


def test_a_configuration_of_the_hexapod_has_the_four_stages_of_the_paper(
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = Path(__file__).parents[2] / "configs" / "hexapod_curriculum.toml"
    stages = config(capfd, "--config", str(path))["curriculum"]
    assert isinstance(stages, list)
    # Verma et al. (2019): healthy; 60/40; 70 % healthy and single (42 + 28, our split) and 30 %; all classes.
    strata = ("healthy", "single", "multiple")
    found = [s["mix"] if isinstance(s["mix"], str) else [s["mix"][name] for name in strata] for s in stages]
    assert found == ["healthy", [0.6, 0.4, 0.0], [0.42, 0.28, 0.3], "uniform"]
    assert {stage["budget"] for stage in stages} == {1.0}


def test_the_expert_is_trained_on_the_healthy_robot_alone(capfd: pytest.CaptureFixture[str]) -> None:
    stages = config(capfd, "--robot", "hexapod", "--healthy")["curriculum"]
    assert stages == [{"name": "healthy", "budget": 1.0, "mix": "healthy"}]


def test_a_specialist_is_trained_on_one_damage_alone(tmp_path: Path) -> None:
    run, damage = tmp_path / "run", "jammed_joint@0+missing_toe@2"
    two_limbs = ("damage.max_damaged_limbs=2", "ppo.symmetry=true")
    dappo_batch("train", *TINY, *two_limbs, "--damage", damage, "--steps", "64", "--run", run)
    assert load_run(run).config["curriculum"] == [{"name": damage, "budget": 1.0, "mix": damage}]
    _, error = dappo_batch("train", *TINY, "--damage", "missing_toe@7", "--steps", "64", code=1)
    assert "missing_toe@7" in error
    _, error = dappo_batch("train", "--damage", damage, "--healthy", code=2)
    assert "cannot be used with '--healthy'" in error


def test_the_smoke_configuration_trains(tmp_path: Path) -> None:
    out, _ = dappo_batch("train", "--config", CONFIGS / "smoke.toml", "--run", tmp_path / "run", "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["iteration"] for line in lines] == list(range(1, 9))
    assert {line["stage"] for line in lines} == {"healthy", "all"}
    assert (tmp_path / "run" / "eval" / "per_class.csv").exists()


def test_an_evaluation_is_a_function_of_its_seed(run: Path) -> None:
    command = ("evaluate", run, "--episodes", "2", "--json")
    results = dappo_batch_many(command, (*command, "--threads", "2"), (*command, "--seed", "7"))
    assert [code for code, _, _ in results] == [0, 0, 0]
    first, again, other = (out for _, out, _ in results)
    assert first == again
    assert first != other
    classes = json.loads(first)["runs"][0]["classes"]
    expected = DamageSpace(4, ["jammed_joint", "missing_toe"], 1).classes
    assert [(c["class"], c["name"], c["group"]) for c in classes] == [
        (c.id, c.name, c.group) for c in expected
    ]
    assert all(c["episodes"] == 2 and c["standard_error"] >= 0 for c in classes)
    table = (run / "eval" / "per_class.csv").read_text().splitlines()
    assert len(table) == 1 + len(expected)


def test_columns_are_as_wide_as_their_longest_cell_and_numbers_end_together(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert run_cli(["classes", "--robot", "hexapod"]) == 0
    header, *rows = capfd.readouterr().out.splitlines()
    classes = DamageSpace(6, ["jammed_joint", "missing_toe"], 2).classes
    name, group = header.index("name"), header.index("group")
    assert (header[:2], name) == ("id", 4)
    assert group == name + max(len(c.name) for c in classes) + 2
    assert [(row[:2], row[name:group].rstrip()) for row in rows] == [(f"{c.id:>2}", c.name) for c in classes]
