"""Wrong arguments, wrong settings, damaged files and output that cannot be written: all are typed errors."""

from __future__ import annotations

import errno
import json
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import dappo_batch
from dappo_batch import (
    ConfigError,
    DamageSpace,
    DappoError,
    ShapeError,
    SimulationError,
    render,
    report,
)
from dappo_batch._core import run_cli
from dappo_batch.commands.output import written

from .. import processes

SMALL = {
    "horizon": 32,
    "ppo.hidden": [4],
    "evaluation.episodes": 1,
    "env.max_episode_steps": 4,
    "damage.types": ["jammed_joint"],
    "damage.max_damaged_limbs": 1,
}


class Unprintable:
    """An object that is nothing."""

    def __repr__(self) -> str:
        """Fail."""
        raise RuntimeError("no text")


def _itself() -> list[Any]:
    """Return a list that holds itself."""
    nested: list[Any] = []
    nested.append(nested)
    return nested


# Nothing here is what any argument below takes.
JUNK = (
    object(),
    Unprintable(),
    b"ab",
    {1},
    1 + 2j,
    -(2**70),
    10**400,
    float("nan"),
    -float("inf"),
    "\ud800",
    "nul\0",
    "x" * 5000,  # longer than a name may be
    range(2**62),
    [[1], [1, 2]],
    _itself(),
    iter([1]),
    np.zeros((2, 3), complex),
    np.array([{}, 1.5], object),
    np.zeros((3, 2, 2, 2)),
    np.zeros(3, "V8"),
)


@pytest.fixture(scope="module")
def table() -> dappo_batch.ClassTable:
    """Compile the Ant with five damage classes."""
    return dappo_batch.compile_class_table("ant", types=["jammed_joint"], max_damaged_limbs=1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy for one iteration."""
    folder = tmp_path_factory.mktemp("errors") / "run"
    dappo_batch.train(folder, num_envs=2, total_steps=64, threads=1, set=SMALL)
    return folder


def _refuses_all(call: Callable[[Any], object], *others: object, takes: type | tuple[type, ...] = ()) -> None:
    """Check that every piece of junk but those of types that are taken is a typed error with a sentence."""
    for junk in (*(junk for junk in JUNK if not isinstance(junk, takes)), *others):
        with pytest.raises((ConfigError, ShapeError), match=r".{15}"):
            call(junk)


@pytest.mark.parametrize(
    "name",
    [
        *("robot", "num_envs", "damage", "reward", "observe_damage", "autoreset", "seed", "threads", "onset"),
        *(
            "max_episode_steps",
            "history",
            "severity",
            "max_damaged_limbs",
            "physics",
            "copy",
            "device",
            "backend",
        ),
        "precision",
    ],
)
def test_every_argument_of_the_vector_env_refuses_what_it_is_not(
    table: dappo_batch.ClassTable, name: str
) -> None:
    given: dict[str, Any] = {"robot": table, "threads": 1}
    _refuses_all(lambda junk: dappo_batch.make_vec(**(given | {name: junk})))


@pytest.mark.parametrize(
    "name", ["robot", "types", "max_damaged_limbs", "severity", "physics", "damage_options"]
)
def test_every_argument_of_the_class_table_refuses_what_it_is_not(name: str) -> None:
    given: dict[str, Any] = {"robot": "ant", "max_damaged_limbs": 1}
    _refuses_all(lambda junk: dappo_batch.compile_class_table(**(given | {name: junk})), {1: 2}, True)


@pytest.mark.parametrize("name", ["limbs", "types", "max_damaged_limbs"])
def test_every_argument_of_a_damage_space_refuses_what_it_is_not(name: str) -> None:
    given: dict[str, Any] = {"limbs": 4, "types": ["a"], "max_damaged_limbs": 1}
    _refuses_all(lambda junk: DamageSpace(**(given | {name: junk})), None, True, -1, 2**62)
    with pytest.raises(ConfigError, match="must be a class id"):
        DamageSpace(**given).parse(1.5)  # type: ignore[arg-type]


def test_steps_resets_and_states_refuse_what_they_are_not(table: dappo_batch.ClassTable) -> None:
    envs = dappo_batch.make_vec(table, 2, threads=1)
    with pytest.raises(SimulationError, match="call reset"):
        envs.step(np.zeros((2, 8)))
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((2, 8)))
    envs.reset()
    qpos, qvel = envs.get_state()
    calls: list[Callable[[Any], object]] = [
        envs.step,
        lambda junk: envs.step([[junk] * 8] * 2),
        lambda junk: envs.reset(seed=junk),
        lambda junk: envs.reset(seed=[0, junk]),
        lambda junk: envs.reset(options=junk),
        lambda junk: envs.set_state(junk, qvel),
        lambda junk: envs.set_state(qpos, junk),
    ]
    for option in ("damage_class", "onset", "reset_mask"):
        _refuses_all(lambda junk, option=option: envs.reset(options={option: junk}))  # type: ignore[misc]
    for call in calls:
        _refuses_all(call)
    for options in ("", [], 0, {1: 2, "a": 3}):
        with pytest.raises(ConfigError):
            envs.reset(options=options)  # type: ignore[arg-type]
    for wrong in (np.nan, np.inf):
        with pytest.raises(ConfigError, match=r"qpos must be finite, got .* at \[1, 7\]"):
            envs.set_state(np.where(np.arange(30).reshape(2, 15) == 22, wrong, qpos), qvel)
    with pytest.raises(ShapeError, match=r"qpos: expected shape \(2, 15\), got \(15, 2\)"):
        envs.set_state(qpos.T, qvel)
    # The state is what it was.
    assert np.array_equal(envs.get_state()[0], qpos)
    envs.close()


def test_a_policy_refuses_what_is_no_observation_and_no_class(run: Path) -> None:
    policy = dappo_batch.Policy.load(run)
    obs = np.zeros((1, policy.obs_dim))
    _refuses_all(policy.act)
    _refuses_all(lambda junk: policy.act(obs, damage_class=junk), 0.9, [0.5], True, [True], {})
    with pytest.raises(ConfigError, match=r"obs must be finite, got nan at \[0, 3\]"):
        policy.act(np.where(np.arange(policy.obs_dim) == 3, np.nan, obs))
    with pytest.raises(ShapeError):
        policy.act(obs[None])
    _refuses_all(dappo_batch.Policy.load, None, "", 5)


@pytest.mark.parametrize(
    "name",
    [
        *("robot", "config", "num_envs", "total_steps", "seed", "learner", "unaware", "healthy", "reward"),
        *(
            "history",
            "lstm",
            "damage",
            "physics",
            "set",
            "device",
            "backend",
            "precision",
            "threads",
            "callback",
            "bogus",
        ),
    ],
)
def test_every_option_of_a_training_refuses_what_it_is_not(tmp_path: Path, name: str) -> None:
    given: dict[str, Any] = {"num_envs": 2, "total_steps": 64, "threads": 1, "set": SMALL}
    _refuses_all(lambda junk: dappo_batch.train(tmp_path / "run", **(given | {name: junk})))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["ppo.gamma", "ppo.hidden", "curriculum", "damage.types", "env.reward"])
def test_settings_refuse_what_toml_has_not(tmp_path: Path, name: str) -> None:
    def train(junk: object) -> None:
        dappo_batch.train(tmp_path / "run", num_envs=2, total_steps=64, threads=1, set={**SMALL, name: junk})

    _refuses_all(train, {}, 2**63)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (dappo_batch.evaluate, ("compare", "encoding", "episodes", "seed", "threads")),
        (dappo_batch.resume, ("total_steps", "threads", "learner", "callback")),
    ],
)
def test_options_of_commands_refuse_what_they_are_not(
    tmp_path: Path, call: Callable[..., object], names: tuple[str, ...]
) -> None:
    _refuses_all(call, None, "")
    for name in names:
        _refuses_all(lambda junk, name=name: call(tmp_path / "none", **{name: junk}))  # type: ignore[misc]


def test_a_sweep_refuses_what_is_no_grid(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    _refuses_all(lambda junk: dappo_batch.sweep({}, {"seed": []}, junk), None)
    _refuses_all(lambda junk: dappo_batch.sweep({}, junk, out), {"seed": "01"}, {"seed": 1}, {1: [2]})
    _refuses_all(lambda junk: dappo_batch.sweep(junk, {"seed": [0]}, out), {"seed": object()}, {1: 2})
    _refuses_all(lambda junk: dappo_batch.sweep({}, {"seed": [0]}, out, executor=junk))
    _refuses_all(lambda junk: dappo_batch.sweep({}, {"seed": [0]}, out, callback=junk))
    assert not out.exists()


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"[", b"\x00" * 100, b"{" * 5000, b"[" * 5000])
@pytest.mark.parametrize("name", ["config.toml", "meta.json", "metrics.jsonl", "eval/per_class.csv"])
def test_files_of_a_run_that_are_damaged_are_typed_errors(
    run: Path, tmp_path: Path, name: str, content: bytes
) -> None:
    damaged = tmp_path / "run"
    for path in ("config.toml", "meta.json", "metrics.jsonl", "eval/per_class.csv"):
        target = damaged / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content + b"\n" if path == name and content else b"")
        if path != name:
            target.write_bytes((run / path).read_bytes())
    if not (content == b"" and name == "metrics.jsonl"):
        with pytest.raises(DappoError, match=Path(name).name):
            dappo_batch.load_run(damaged)
    with pytest.raises(DappoError):
        report.write([damaged], tmp_path / "none" / "page.html")
    with pytest.raises(DappoError):
        dappo_batch.Policy.load(damaged)


def test_junk_is_no_run_no_diagnoser_and_no_report(tmp_path: Path) -> None:
    _refuses_all(dappo_batch.load_run, None, "", takes=bytes)
    _refuses_all(lambda junk: report.write([junk], tmp_path / "page.html"), None, takes=bytes)
    _refuses_all(lambda junk: report.write(junk, tmp_path / "page.html"), None, "text")
    _refuses_all(lambda junk: dappo_batch.Diagnoser.load(junk, expert=tmp_path), None, takes=bytes)
    _refuses_all(lambda junk: dappo_batch.Controller(junk, diagnoser=tmp_path), None, takes=bytes)
    _refuses_all(lambda junk: dappo_batch.Controller.from_export(junk), None, takes=bytes)


def toml(value: Any) -> str:  # noqa: ANN401
    """Return a value as TOML has it; tables are those in braces."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {toml(entry)}' for key, entry in value.items())}}}"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


@pytest.mark.parametrize(
    ("setting", "part"),
    [
        ({"env.num_envs": 2**24, "horizon": 32}, "not enough memory for a training with 16777216 envs"),
        ({"ppo.hidden": [2**24, 2**24]}, "not enough memory for a training"),
        ({"evaluation.episodes": 2**24}, "not enough memory for the evaluation of 5 damage classes"),
        ({"ppo.hidden": [2**63 - 1, 8]}, "`ppo.hidden[0]` is 9223372036854775807"),
        ({"horizon": 2**63 - 1}, "`horizon` is 9223372036854775807"),
        ({"horizon": 2**30, "env.num_envs": 2**24}, "their product"),
        ({"curriculum": [{"name": "a", "mix": {"multiple": 1.0}}]}, "`multiple` has the weight 1"),
        ({"curriculum": [{"name": "a", "mix": "missing_toe@7"}]}, "`curriculum[0].mix`"),
        ({"env.reward": "nothing"}, "nothing"),
    ],
)
def test_config_refuses_what_train_refuses_before_there_is_a_run(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], setting: Mapping[str, Any], part: str
) -> None:
    settings = {**SMALL, **setting}
    with pytest.raises(ConfigError) as caught:
        dappo_batch.train(tmp_path / "run", num_envs=2, total_steps=64, threads=1, set=settings)
    assert part in str(caught.value)
    assert not (tmp_path / "run").exists()
    capfd.readouterr()
    code = run_cli(["config", "--envs", "2", "--set", *(f"{key}={toml(settings[key])}" for key in settings)])
    out, error = capfd.readouterr()
    assert (code, out, part in error) == (1, "", True), error


@pytest.fixture
def little_memory() -> Iterator[None]:
    """Leave this process 200 MB of address space."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 200_000_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.usefixtures("little_memory")
def test_envs_that_do_not_fit_the_limit_of_the_process_are_rejected(table: dappo_batch.ClassTable) -> None:
    with pytest.raises(
        ConfigError, match=r"not enough memory for 100000 envs .* needed, 0\.\d\d GB are available"
    ):
        dappo_batch.make_vec(table, 100_000, threads=1)
    dappo_batch.make_vec(table, 10, threads=1).close()


@pytest.mark.parametrize("command", [("classes",), ("classes", "--json"), ("config",), ("--help",)])
def test_output_that_cannot_be_written_is_a_failure(command: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*processes.DAPPO_BATCH, *command], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr.startswith("error: cannot write to standard output: No space left on device")


def test_more_threads_than_any_machine_has_are_an_error_of_the_configuration(tmp_path: Path) -> None:
    for call in (dappo_batch.Policy.load, dappo_batch.Policy.from_export):
        with pytest.raises(ConfigError, match="`threads` is 4097, expected a whole number from 1 to 4096"):
            call(tmp_path, threads=4097)


def test_errors_of_files_name_them(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for name, kind, number in (("missing", FileNotFoundError, errno.ENOENT), ("link", OSError, errno.EINVAL)):
        with pytest.raises(kind) as raised:
            dappo_batch._core.read_file(tmp_path / name)
        assert (raised.value.filename, raised.value.errno) == (str(tmp_path / name), number)
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError) as exists:
        dappo_batch._core.write_file(tmp_path / "file" / "inner", b"")
    assert exists.value.filename == str(tmp_path / "file")


def test_output_of_python_commands_that_cannot_be_written_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def say(text: str) -> int:
        print(text)
        return 3

    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        with pytest.raises(DappoError, match="cannot write to standard output: No space left on device"):
            written(say, text="a")
    with (tmp_path / "out").open("w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert written(say, text="a") == 3
    assert (tmp_path / "out").read_text() == "a\n"


def test_a_closed_pipe_ends_a_command_quietly() -> None:
    with subprocess.Popen(
        [*processes.DAPPO_BATCH, "classes"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as command:
        assert command.stdout is not None
        assert command.stderr is not None
        command.stdout.close()
        error = command.stderr.read()
    assert (command.returncode, error) == (0, "")


@pytest.mark.parametrize(
    "name", ["table", "qpos", "damage", "onset", "forward_velocity", "events", "known_names"]
)
def test_every_argument_of_a_walk_refuses_what_it_is_not(table: dappo_batch.ClassTable, name: str) -> None:
    given: dict[str, Any] = {"table": table, "qpos": np.tile(table.models[0].qpos0, (3, 1))}
    _refuses_all(lambda junk: render.Walk(**(given | {name: junk})))
    _refuses_all(lambda junk: render.Walk(**given, note=junk), "\ud800", takes=str)


def test_drawing_refuses_what_is_no_walk_no_file_and_no_size(
    table: dappo_batch.ClassTable, tmp_path: Path
) -> None:
    walk = render.Walk(table, table.models[0].qpos0)
    _refuses_all(lambda junk: render.write(tmp_path / "a.png", junk), None)
    _refuses_all(lambda junk: render.write(junk, walk), None, takes=bytes)
    _refuses_all(lambda junk: render.write(tmp_path / "a.png", walk, size=junk), 5, (0, 8), (8, 8, 8))
    _refuses_all(lambda junk: list(render.frames(walk, junk)), [], [1], None)
    _refuses_all(lambda junk: render.check_browser("localhost", junk), -1, 65536, None)
    _refuses_all(render.view, None)
