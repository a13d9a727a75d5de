"""`dappo-batch export`: networks in ONNX and safetensors, the folder, and what drives a robot from it."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import importlib.util
import json
import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import Controller, Policy
from dappo_batch._core import ExportedNetworks, run_cli

from .. import processes
from .command_line import dappo_batch as run
from .command_line import dappo_batch_many
from .mesh_robot import write_mesh_robot

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "drive_exported.py"
OBS, CODE, ACTIONS, CLASSES, STEPS = 111, 8, 8, 9, 20
Rows = NDArray[np.float32]


@pytest.fixture(scope="session")
def exports(parts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export the same policy with diagnosers of several methods and heads, once with another expert."""
    root = tmp_path_factory.mktemp("exports")
    small = ("--set", "epochs=1", "embedding=24", "lstm=10")
    kinds = {
        "A": ("--method", "A", *small, "hidden=[20, 12]"),
        "D": ("--method", "D", *small, "hidden=[]"),
        "limbs": ("--method", "C", "--head", "limbs", *small, "hidden=[16]"),
    }
    done = dappo_batch_many(
        *(("diagnose", "train", parts / "pairs", "--out", root / f"{k}_net", *v) for k, v in kinds.items()),
        *(("export", parts / "aware", "--diagnoser", root / f"{k}_net", "--out", root / k) for k in kinds),
        ("export", parts / "aware", "--diagnoser", parts / "diagnoser", "--out", root / "B"),
        (
            *("export", parts / "aware", "--diagnoser", parts / "diagnoser", "--expert", parts / "expert"),
            *("--trigger", "speed", "--controller", "cooldown=20", "speed_window=10", "speed_fraction=5"),
            *("--out", root / "expert"),
        ),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    return root


def header_of(folder: Path) -> dict[str, Any]:
    header: dict[str, Any] = json.loads((folder / "export.json").read_text())
    return header


def tensors_of(path: Path) -> dict[str, Rows]:
    """Read a safetensors file: the length of its header, the header in JSON, the data."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    found = {}
    for name, entry in json.loads(data[8:start]).items():
        assert entry["dtype"] == "F32"
        first, last = entry["data_offsets"]
        found[name] = np.frombuffer(data[start + first : start + last], "<f4").reshape(entry["shape"])
    return found


def onnx_outputs(path: Path, rows: Rows) -> list[Rows]:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return list(session.run(None, {session.get_inputs()[0].name: rows}))


def linear(tensors: dict[str, Rows], name: str, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return rows @ tensors[f"{name}.weight"].astype(float) + tensors[f"{name}.bias"]


def standardized(tensors: dict[str, Rows], rows: Rows, clip: float) -> NDArray[np.float64]:
    return np.clip((rows.astype(float) - tensors["input.mean"]) * tensors["input.scale"], -clip, clip)


def numpy_policy(folder: Path, part: dict[str, Any], rows: Rows) -> NDArray[np.float64]:
    tensors, tracked = tensors_of(folder / part["tensors"]), part["layers"][0] - part["code_length"]
    observed = standardized(tensors, rows[:, :tracked], part["clip"])
    h = np.concatenate([observed, rows[:, tracked:] * part["code_scale"]], axis=1)
    layers = len(part["layers"]) - 1
    for index in range(layers):
        h = linear(tensors, f"layers.{index}", h)
        h = np.tanh(h) if index < layers - 1 else h
    return h


def sigmoid(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1 / (1 + np.exp(-x))


def numpy_diagnoser(header: dict[str, Any], folder: Path, windows: Rows) -> NDArray[np.float64]:
    """Return the probabilities of the classes: embedding, LSTM, dense layers, head."""
    part = header["diagnoser"]
    tensors, width = tensors_of(folder / part["tensors"]), part["lstm"]
    embedded = linear(tensors, "embedding", standardized(tensors, windows, part["clip"]))
    h = c = np.zeros((len(windows), width))
    for step in range(part["timesteps"]):
        gates = linear(tensors, "lstm.input", embedded[:, step]) + h @ tensors["lstm.recurrent"].astype(float)
        i, f, g, o = np.split(gates, 4, axis=1)
        c = sigmoid(f) * c + sigmoid(i) * np.tanh(g)
        h = sigmoid(o) * np.tanh(c)
    for index in range(len(part["hidden"])):
        h = np.maximum(linear(tensors, f"hidden.{index}", h), 0)
    outputs = linear(tensors, "head", h)
    if part["head"] == "limbs":
        # Independent bits: how probable the code of each class is, relative to those of the others.
        codes = np.array([entry["code"] for entry in header["classes"]])
        outputs = np.stack(
            [np.log(np.where(code, sigmoid(outputs), sigmoid(-outputs))).sum(1) for code in codes], axis=1
        )
    likelihoods = np.exp(outputs - outputs.max(axis=1, keepdims=True))
    return np.asarray(likelihoods / likelihoods.sum(axis=1, keepdims=True))


def inputs_of(tensors: dict[str, Rows], shape: tuple[int, ...], rng: np.random.Generator) -> Rows:
    """Draw raw inputs like those of the training, some of them far outside."""
    scale = tensors["input.scale"]
    deviation = np.divide(1, scale, where=scale > 0, out=np.ones_like(scale))
    spread = rng.choice([0.3, 1.0, 100.0], p=[0.5, 0.45, 0.05], size=(*shape, 1))
    return (tensors["input.mean"] + spread * rng.standard_normal((*shape, len(scale))) * deviation).astype(
        "f4"
    )


@pytest.mark.parametrize("kind", ["A", "B", "D", "limbs", "expert"])
def test_every_network_is_valid_onnx(exports: Path, kind: str) -> None:
    names = sorted(path.name for path in (exports / kind).glob("*.onnx"))
    assert names == ["diagnoser.onnx", *(["expert.onnx"] if kind == "expert" else []), "policy.onnx"]
    for name in names:
        model = onnx.load(exports / kind / name)
        onnx.checker.check_model(model, full_check=True)
        assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]


@pytest.mark.parametrize("kind", ["policy", "expert"])
def test_policies_in_onnx_and_tensors_act_as_the_originals(exports: Path, kind: str) -> None:
    folder = exports / "expert"
    part, rng = header_of(folder)[kind], np.random.default_rng(0)
    obs = inputs_of(tensors_of(folder / part["tensors"]), (500,), rng)
    rows = np.concatenate([obs, rng.integers(0, 2, (500, part["code_length"]))], axis=1).astype("f4")
    expected = getattr(ExportedNetworks(folder), kind)(rows)
    action, mean_action = onnx_outputs(folder / part["onnx"], rows)
    np.testing.assert_allclose(mean_action, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(numpy_policy(folder, part, rows), expected, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(action, np.clip(mean_action, -1, 1))


def test_actions_in_onnx_end_at_their_bounds(exports: Path, tmp_path: Path) -> None:
    model = onnx.load(exports / "B" / "policy.onnx")
    bias = next(entry for entry in model.graph.initializer if entry.name == "layers.1.bias")
    shift = np.linspace(-3, 3, ACTIONS, dtype="f4")
    bias.CopyFrom(onnx.numpy_helper.from_array(shift, bias.name))
    onnx.save(model, tmp_path / "shifted.onnx")
    action, mean_action = onnx_outputs(tmp_path / "shifted.onnx", np.zeros((1, OBS + CODE), "f4"))
    assert abs(mean_action).max() > 2
    np.testing.assert_array_equal(action, np.clip(mean_action, -1, 1))


@pytest.mark.parametrize("kind", ["A", "B", "D", "limbs"])
def test_diagnosers_in_onnx_and_tensors_have_the_probabilities_of_the_originals(
    exports: Path, kind: str
) -> None:
    folder, rng = exports / kind, np.random.default_rng(1)
    header = header_of(folder)
    part = header["diagnoser"]
    windows = inputs_of(tensors_of(folder / part["tensors"]), (200, part["timesteps"]), rng)
    expected = ExportedNetworks(folder).diagnose(windows)
    assert expected.shape == (200, CLASSES)
    (found,) = onnx_outputs(folder / part["onnx"], windows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(numpy_diagnoser(header, folder, windows), expected, rtol=0, atol=1e-5)


def test_the_header_describes_everything_that_a_program_needs(exports: Path, parts: Path) -> None:
    header = header_of(exports / "D")
    space = dappo_batch.DamageSpace(4, ["jammed_joint", "missing_toe"], 1)
    assert header["format"] == "dappo-batch export 1"
    assert (header["robot"], header["control_period"]) == ("ant", 0.05)
    assert (header["obs_dim"], header["action_dim"]) == (OBS, ACTIONS)
    with contextlib.closing(dappo_batch.make_vec("ant", 1, observe_damage=False)) as env:
        names = zip(env.obs_names, env.obs_units, strict=True)
        assert header["observation"] == [{"name": name, "unit": unit} for name, unit in names]
        model = env.table.models[0]
    joints = [model.joint(model.actuator(index).trnid[0]) for index in range(ACTIONS)]
    assert [entry["name"] for entry in header["joints"]] == [joint.name for joint in joints]
    assert [entry["default"] for entry in header["joints"]] == [
        model.qpos0[joint.qposadr[0]] for joint in joints
    ]
    assert [entry["name"] for entry in header["classes"]] == [item.name for item in space.classes]
    assert [entry["code"] for entry in header["classes"]] == [item.code for item in space.classes]
    with (parts / "aware" / "eval" / "per_class.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    velocities = [float(row["forward_reward"]) / float(row["episode_length"]) for row in rows]
    np.testing.assert_allclose(
        [entry["baseline"] for entry in header["classes"]], velocities, rtol=0, atol=1e-6
    )
    diagnoser = header["diagnoser"]
    assert diagnoser["inputs"] == ["damaged", "twin - damaged", "action"]
    assert (diagnoser["method"], diagnoser["timesteps"]) == ("D", STEPS)
    twin = header["twin"]
    assert (twin["action"], twin["resync"], twin["frame_skip"], twin["integrator"]) == ("shared", 1, 5, "rk4")
    assert [term["term"] for term in twin["observation"]] == ["qpos", "qvel", "cfrc_ext"]
    assert np.count_nonzero(twin["residual_scale"]) == 27, "positions and velocities"
    assert header["controller"]["residual_threshold"] == 0.05
    assert header["sources"]["policy"]["run"] == "aware"
    assert header["sources"]["expert"] is None


def test_the_header_lists_every_file_with_its_sha_256(exports: Path) -> None:
    folder = exports / "expert"
    files = header_of(folder)["files"]
    assert {path.name for path in folder.iterdir()} == {"export.json", *files}
    for name, entry in files.items():
        data = (folder / name).read_bytes()
        assert entry == {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def test_the_robot_of_the_folder_moves_bit_identically_to_the_healthy_class(exports: Path) -> None:
    healthy = dappo_batch.compile_class_table("ant", max_damaged_limbs=1).models[0]
    model = mujoco.MjModel.from_xml_path(str(exports / "B" / "robot.xml"))
    one, other = mujoco.MjData(healthy), mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for _ in range(300):
        one.ctrl = other.ctrl = rng.uniform(-1, 1, ACTIONS)
        mujoco.mj_step(healthy, one)
        mujoco.mj_step(model, other)
    np.testing.assert_array_equal(one.qpos, other.qpos)


def walk(controllers: list[Any], damage: str, steps: int) -> list[list[NDArray[np.float32]]]:
    """Let the first controller walk a robot that breaks after 60 steps; all see what it observes."""
    robot = dappo_batch.make_vec(
        "ant", damage="healthy", observe_damage=False, max_damaged_limbs=1, seed=7, max_episode_steps=steps
    )
    obs, _ = robot.reset(options={"damage_class": damage, "onset": 60})
    velocity, taken = 0.0, []
    for _ in range(steps - 1):
        taken.append([controller.act(obs[0], velocity) for controller in controllers])
        obs, _, _, _, infos = robot.step(taken[-1][0][None])
        velocity = infos["forward_velocity"][0]
    robot.close()
    return taken


@pytest.mark.parametrize("kind", ["B", "expert"])
def test_a_controller_from_the_folder_acts_bit_identically_to_the_original(
    exports: Path, parts: Path, kind: str
) -> None:
    settings: dict[str, Any] = {}
    if kind == "expert":
        changed = {"cooldown": 20, "speed_window": 10, "speed_fraction": 5}
        settings = {"expert": parts / "expert", "trigger": "speed", "settings": changed}
    original = Controller(parts / "aware", diagnoser=parts / "diagnoser", **settings)
    exported = Controller.from_export(exports / kind)
    for one, other in walk([original, exported], "missing_toe@1", 160):
        np.testing.assert_array_equal(one, other)
    assert exported.events == original.events
    assert {"suspected", "diagnosed"} <= {event.kind for event in exported.events}
    assert exported.class_names == original.class_names


def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("drive_exported", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("kind", ["B", "D"])
def test_the_example_acts_as_the_controller_until_the_diagnosis(exports: Path, kind: str) -> None:
    controller = Controller.from_export(exports / kind)
    exported = example().Controller(exports / kind)

    class Exported:
        def act(self, obs: Rows, _: float) -> Rows:
            action: Rows = exported.act(obs)
            return action

    taken = walk([controller, Exported()], "missing_toe@1", 160)
    suspected, diagnosed = controller.events[:2]
    assert (suspected.kind, diagnosed.kind) == ("suspected", "diagnosed")
    for step, (one, other) in enumerate(taken[: diagnosed.step + 1]):
        np.testing.assert_allclose(other, np.clip(one, -1, 1), rtol=0, atol=1e-4, err_msg=str(step))
    assert [step for step, _ in exported.events[:2]] == [suspected.step, diagnosed.step]
    assert diagnosed.damage_class is not None
    name = controller.class_names[diagnosed.damage_class]
    assert exported.events[1][1] == f"diagnosis: {name}, {diagnosed.confidence:.1%} certain"
    assert exported.assumed == controller.damage_classes[0]


def test_the_example_drives_a_robot_through_damage_without_this_package(exports: Path) -> None:
    program = (
        "import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__');"
        "assert 'dappo_batch' not in sys.modules"
    )
    done = processes.run(
        [sys.executable, "-W", "error", "-c", program, EXAMPLE, exports / "B", "hip_2"], timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "suspicion, the diagnosis window begins" in done.stdout
    assert "assumed class: jammed_joint@1" in done.stdout


def test_an_export_replaces_an_earlier_one_and_nothing_else(
    exports: Path, parts: Path, tmp_path: Path
) -> None:
    def export(out: Path, *more: str | Path) -> tuple[str | Path, ...]:
        return ("export", parts / "aware", "--diagnoser", parts / "diagnoser", "--out", out, *more)

    earlier = tmp_path / "robot"
    shutil.copytree(exports / "expert", earlier)
    # What an export left behind that was killed while it wrote.
    half = tmp_path / ".robot.0123456789abcdef.tmp"
    half.mkdir()
    (half / "policy.onnx").write_bytes(b"half of")
    _, err = run(*export(earlier, "--controller", "residual_window=0"), code=1)
    assert "`residual_window` is 0" in err
    assert header_of(earlier) == header_of(exports / "expert")

    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    foreign = (tmp_path / "mine", tmp_path / "mine" / "notes.txt", parts / "aware")
    replaced, *refused = dappo_batch_many(export(earlier), *map(export, foreign))
    assert replaced[0] == 0, replaced
    assert header_of(earlier) == header_of(exports / "B")
    assert not (earlier / "expert.onnx").exists()
    for code, _, err in refused:
        assert code == 1
        assert "is neither new nor an export" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "robot"]
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep"


def test_what_is_no_whole_export_is_rejected_by_name(exports: Path, tmp_path: Path) -> None:
    def refusal(change: str, content: str | None) -> str:
        folder = tmp_path / "robot"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(exports / "B", folder)
        if content is None:
            (folder / change).unlink()
        else:
            (folder / change).write_text(content)
        with pytest.raises(dappo_batch.CheckpointError) as caught:
            Controller.from_export(folder)
        return str(caught.value)

    text = (exports / "B" / "export.json").read_text()
    assert "policy.safetensors: it has 4 bytes" in refusal("policy.safetensors", "less")
    assert "robot.xml: it cannot be read" in refusal("robot.xml", None)
    assert "this_is_new" in refusal("export.json", text.replace("{", '{"this_is_new": 1,', 1))
    assert "its format is `dappo-batch export 2`" in refusal(
        "export.json", text.replace("export 1", "export 2")
    )
    assert "export.json: it cannot be read" in refusal("export.json", None)
    assert "`confidence` is 2" in refusal(
        "export.json", text.replace('"confidence": 0.5', '"confidence": 2.0')
    )
    changed = text.replace('"timesteps": 20', '"timesteps": 0')
    assert "timesteps is 0" in refusal("export.json", changed)


def test_what_cannot_be_exported_is_rejected_and_leaves_nothing(parts: Path, tmp_path: Path) -> None:
    shutil.copytree(parts / "aware", tmp_path / "unevaluated")
    shutil.rmtree(tmp_path / "unevaluated" / "eval")
    cases = (
        (tmp_path / "nothing", parts / "diagnoser", "is not a run folder"),
        (parts / "aware", parts / "pairs", "config.toml"),
        (tmp_path / "unevaluated", parts / "diagnoser", "dappo-batch evaluate"),
    )
    out = tmp_path / "out" / "robot"
    done = dappo_batch_many(
        *(("export", aware, "--diagnoser", diagnoser, "--out", out) for aware, diagnoser, _ in cases)
    )
    for (code, _, err), (_, _, reason) in zip(done, cases, strict=True):
        assert code == 1
        assert reason in err
    assert not list(tmp_path.glob("out/*"))


def test_a_policy_alone_is_exported_and_acts_bit_identically_to_its_run(
    parts: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for run_name, evaluated in (("aware", True), ("expert", False)):
        shutil.copytree(parts / run_name, tmp_path / run_name)
        if not evaluated:
            shutil.rmtree(tmp_path / run_name / "eval")
        out = tmp_path / f"{run_name}_export"
        assert run_cli(["export", str(tmp_path / run_name), "--out", str(out)]) == 0
        assert "a policy without a diagnoser" in capfd.readouterr().out
        header = header_of(out)
        assert [header[key] for key in ("controller", "diagnoser", "expert")] == [None] * 3
        assert header["sources"]["diagnoser"] is None
        assert [header["twin"][key] for key in ("action", "resync", "residual_scale")] == [None] * 3
        assert [entry["baseline"] is not None for entry in header["classes"]] == [evaluated] * CLASSES
        original, exported = Policy.load(parts / run_name), Policy.from_export(out)
        for name in ("obs_dim", "action_dim", "observes_damage", "class_names", "env_steps"):
            assert getattr(exported, name) == getattr(original, name)
        obs = np.random.default_rng(0).normal(size=(20, OBS)).astype("f4")
        classes = np.arange(20) % CLASSES
        np.testing.assert_array_equal(
            exported.act(obs, damage_class=classes), original.act(obs, damage_class=classes)
        )
        codes = [header["classes"][index]["code"] for index in classes]
        action, mean_action = onnx_outputs(out / "policy.onnx", np.concatenate([obs, codes], 1).astype("f4"))
        np.testing.assert_array_equal(action, np.clip(mean_action, -1, 1))
        np.testing.assert_allclose(mean_action, exported.act(obs, damage_class=classes), rtol=0, atol=1e-5)
        with pytest.raises(dappo_batch.CheckpointError, match=r"holds a policy alone.*--diagnoser"):
            Controller.from_export(out)


def test_broken_evaluations_are_rejected_by_name_and_those_of_other_classes_do_not_matter_to_a_policy(
    parts: Path, tmp_path: Path
) -> None:
    shutil.copytree(parts / "aware", tmp_path / "run")
    stored = tmp_path / "run" / "eval" / "evaluation.json"
    policy, controller = (
        ("export", tmp_path / "run", "--out", tmp_path / "out"),
        ("export", tmp_path / "run", "--out", tmp_path / "out", "--diagnoser", parts / "diagnoser"),
    )
    text = stored.read_text()
    stored.write_text(text.replace("missing_toe@1", "missing_wheel@1"))
    _, err = run(*controller, code=1)
    assert f"{stored} has 9 damage classes, expected the 9 of the robot in their order" in err
    run(*policy)
    assert {entry["baseline"] for entry in header_of(tmp_path / "out")["classes"]} == {None}
    stored.write_text(text.replace("forward_velocity", "velocity"))
    _, err = run(*policy, code=1)
    assert f"{stored}: missing field `forward_velocity`" in err
    assert "evaluate the run again" in err
    stored.unlink()
    stored.mkdir()
    _, err = run(*policy, code=1)
    assert f"{stored}: it is a folder, expected a regular file" in err


def test_the_policy_of_an_export_with_a_diagnoser_can_be_taken_alone(exports: Path, parts: Path) -> None:
    obs = np.random.default_rng(1).normal(size=OBS)
    expected = Policy.load(parts / "aware").act(obs, damage_class="missing_toe@1")
    found = Policy.from_export(exports / "B").act(obs, damage_class="missing_toe@1")
    np.testing.assert_array_equal(found, expected)


def test_what_belongs_to_a_diagnoser_is_rejected_without_one(parts: Path, tmp_path: Path) -> None:
    for more in (["--expert", str(parts / "expert")], ["--controller", "cooldown=20"]):
        assert run_cli(["export", str(parts / "aware"), "--out", str(tmp_path / "out"), *more]) == 2
    assert not list(tmp_path.iterdir())


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_function_writes_what_the_command_writes_and_prints_nothing(
    parts: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    diagnoser = parts / "diagnoser"
    more = ["--diagnoser", str(diagnoser), "--controller", "cooldown=20", "--json"]
    assert run_cli(["export", str(parts / "aware"), "--out", str(tmp_path / "command"), *more]) == 0
    assert json.loads(capfd.readouterr().out) == header_of(tmp_path / "command")
    run = parts / "aware"
    out = dappo_batch.export(run, tmp_path / "function", diagnoser=diagnoser, controller={"cooldown": 20})
    assert capfd.readouterr() == ("", "")
    assert out == tmp_path / "function"
    assert files_of(out) == files_of(tmp_path / "command")
    with pytest.raises(dappo_batch.ConfigError, match="trigger cannot be used without diagnoser"):
        dappo_batch.export(parts / "aware", tmp_path / "other", trigger="speed")


def test_a_robot_of_several_files_is_exported_whole(tmp_path: Path) -> None:
    robot = write_mesh_robot(tmp_path / "robot")
    table = dappo_batch.compile_class_table(robot, max_damaged_limbs=1)
    settings = {"horizon": 4, "ppo.hidden": [4], "evaluation.episodes": 1, "damage.max_damaged_limbs": 1}
    settings["env.max_episode_steps"] = 3
    dappo_batch.train(
        tmp_path / "run", robot=str(robot), num_envs=2, total_steps=8, threads=1, unaware=True, set=settings
    )
    assert run_cli(["export", str(tmp_path / "run"), "--out", str(tmp_path / "out")]) == 0
    shutil.rmtree(tmp_path / "run")
    shutil.rmtree(tmp_path / "robot")
    out = (tmp_path / "out").rename(tmp_path / "elsewhere")
    header = header_of(out)
    assert {path.name for path in out.iterdir()} == {"export.json", *header["files"]}
    assert {"robot-hat.obj", "robot-red.png"} < header["files"].keys()
    assert not Policy.from_export(out).observes_damage
    model = mujoco.MjModel.from_xml_path(str(out / header["twin"]["mjcf"]))
    assert (model.nmesh, model.ntex) == (1, 1)
    one, other = mujoco.MjData(table.models[0]), mujoco.MjData(model)
    for step in range(50):
        one.ctrl = other.ctrl = np.sin(step + np.arange(6))
        mujoco.mj_step(table.models[0], one)
        mujoco.mj_step(model, other)
    np.testing.assert_array_equal(one.qpos, other.qpos)
