"""Diagnosis and adaptation without a twin: of the Ant, and of a Go1, whose state is not observed."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ConfigError, Controller, Diagnoser, Policy

from .command_line import TINY, dappo_batch_many
from .command_line import dappo_batch as run

CLASSES, STEPS, WINDOW, ONSET = 9, 12, 20, 60
Array = NDArray[Any]


@pytest.fixture(scope="module")
def ant(parts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record the policy of `parts` without twins, and train a diagnoser of the last observations."""
    root = tmp_path_factory.mktemp("without_twins")
    record = ("diagnose", "collect", parts / "aware", "--preset", "observation")
    windows = ("--timesteps", str(WINDOW), "--onset", "20-60", "--delay", "10-60")
    small = ("--timesteps", str(STEPS), "--onset", "15-18", "--delay", "3-30", "--backend", "mujoco")
    network = ("epochs=15", "schedule=cosine", "embedding=32", "lstm=16", "hidden=[32]")
    done = dappo_batch_many(
        (*record, *windows, "--rollouts", "1500", "--out", root / "data"),
        (*record, *small, "--rollouts", "8", "--out", root / "few"),
        ("diagnose", "train", root / "data", "--out", root / "diagnoser", "--set", *network),
        ("export", parts / "aware", "--diagnoser", root / "diagnoser", "--out", root / "export"),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    return root


@pytest.fixture(scope="module")
def go1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a Go1 that stands, and a diagnoser, both with hardly any data."""
    root = tmp_path_factory.mktemp("go1")
    sizes = [setting.replace("steps=20", "steps=90") for setting in TINY]
    windows = ("--rollouts", "2", "--timesteps", "10", "--onset", "8-12", "--delay", "5-9")
    done = dappo_batch_many(
        ("train", "--robot", "go1", *sizes, "--steps", "64", "--run", root / "run"),
        ("diagnose", "collect", root / "run", *windows, "--out", root / "data"),
        ("diagnose", "train", root / "data", "--out", root / "diagnoser", "--set", "epochs=1", "embedding=8"),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    assert "does not observe its whole state" in done[1][2]
    assert "preset observation" in done[1][2]
    return root


def records(folder: Path) -> Array:
    (path,) = folder.glob("rollouts-*.npy")
    found: Array = np.load(path)
    return found


def test_the_damage_strikes_in_the_window_where_the_record_says(ant: Path) -> None:
    models = dappo_batch.compile_class_table("ant", max_damaged_limbs=1).models
    data = records(ant / "few")
    assert data.dtype.names == ("damaged", "actions", "onset", "delay", "fallen")
    later, checked = 0, 0
    for record in data:
        for damage, model in enumerate(models):
            if record["fallen"][damage]:
                continue
            rows, actions = record["damaged"][damage], record["actions"][damage]
            for step in range(1, STEPS):
                # The window ends `delay` steps after the damage.
                is_struck = step >= STEPS - int(record["delay"])
                data_of = mujoco.MjData(model if is_struck else models[0])
                data_of.qpos[2:], data_of.qvel[:] = rows[step - 1, :13], rows[step - 1, 13:27]
                data_of.ctrl[:] = np.clip(actions[step], -1, 1)
                mujoco.mj_step(data_of.model, data_of, nstep=5)
                # The rows are f32, and contacts amplify their rounding.
                np.testing.assert_allclose(rows[step, :13], data_of.qpos[2:], atol=2e-2)
                checked += 1
                later += is_struck
    assert checked > later > 0


def test_the_policy_has_the_code_of_no_damage_and_later_perhaps_that_of_a_class(
    ant: Path, parts: Path
) -> None:
    policy = Policy.load(parts / "aware")
    data = records(ant / "data")
    given = []
    for record in data[:40]:
        for damage in range(CLASSES):
            obs, actions = record["damaged"][damage, :-1], record["actions"][damage, 1:]
            codes = np.stack([policy.act(obs, damage_class=other) for other in range(CLASSES)])
            distances = np.abs(codes - np.clip(actions, -1, 1)).max(axis=2)
            assert distances.min(axis=0).max() < 1e-4, "each action is that of some class"
            nearest = distances.argmin(axis=0)
            changes = np.flatnonzero(np.diff(nearest))
            assert len(changes) <= 1
            assert len(changes) == 0 or nearest[0] == 0
            given.append((damage, nearest[-1]))
    damage, received = np.array(given).T
    damaged = damage > 0
    # Half of the robots and a ninth of a quarter receive no damage, and others have not received any yet.
    assert 0.5 < np.mean(received[damaged] == 0) < 0.85
    assert 0.1 < np.mean(received[damaged] == damage[damaged]) < 0.35
    assert np.mean((received != damage) & (received > 0)) > 0.08


def test_damage_of_an_ant_is_recognised_without_a_twin(parts: Path, ant: Path) -> None:
    # The diagnoser is small, and never sure.
    at = ("--at", str(ONSET), "--episodes", "12", "--json", "--all-classes", "--controller", "confidence=0.5")
    out, _ = run("adapt", parts / "aware", "--diagnoser", ant / "diagnoser", *at)
    summary = json.loads(out)["summary"]
    healthy, *damaged = summary["classes"]
    # By chance, one in nine would be right.
    assert summary["correct_last"] > 0.5
    assert summary["correct_first"] > 0.4
    assert healthy["correct_last"] > 12 - healthy["false_alarms"], "a false alarm ends by itself"
    assert np.mean([row["detected"] for row in damaged]) > 8
    assert healthy["tracking_before"] is None


def controllers(parts: Path, ant: Path, num_robots: int = 1, **settings: float | str) -> Controller:
    return Controller(parts / "aware", diagnoser=ant / "diagnoser", num_robots=num_robots, settings=settings)


def walk(controller: Controller, damage: list[str], steps: int, lost: range = range(0)) -> list[Array]:
    """Walk with damage after 60 steps; observations are lost in the steps of a range."""
    envs = dappo_batch.make_vec(
        "ant", len(damage), damage="healthy", observe_damage=False, max_damaged_limbs=1, seed=7
    )
    obs, _ = envs.reset(options={"damage_class": damage, "onset": ONSET})
    taken = []
    for step in range(steps):
        taken.append(controller.act(np.full_like(obs, np.nan) if step in lost else obs))
        obs = envs.step(taken[-1])[0]
    envs.close()
    return taken


def test_robots_are_diagnosed_independently_and_again_after_a_reset(parts: Path, ant: Path) -> None:
    damage = ["missing_toe@1", "healthy", "jammed_joint@2"]
    fleet = controllers(parts, ant, 3)
    together = walk(fleet, damage, 120)
    alone = controllers(parts, ant)
    # The env of the first robot alone is that of the fleet.
    for one, all_of_them in zip(walk(alone, damage[:1], 120), together, strict=True):
        np.testing.assert_allclose(one[0], all_of_them[0], atol=1e-5)
    assert alone.events == [event for event in fleet.events if event.robot == 0]
    assert [event.kind for event in alone.events][:2] == ["diagnosed", "adapted"]
    fleet.reset([True, False, False])
    assert fleet.damage_classes[0] == 0
    fleet.reset()
    for one, other in zip(walk(fleet, damage, 30), walk(controllers(parts, ant, 3), damage, 30), strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_export_without_a_twin_acts_bit_identically(parts: Path, ant: Path) -> None:
    header = json.loads((ant / "export" / "export.json").read_text())
    assert header["controller"]["trigger"] == "observation"
    assert header["diagnoser"]["inputs"] == ["damaged"]
    assert (header["twin"]["action"], header["twin"]["resync"], header["twin"]["residual_scale"]) == (
        None,
    ) * 3
    exported = Controller.from_export(ant / "export")
    original = controllers(parts, ant)
    for one, other in zip(
        walk(exported, ["missing_toe@1"], 130), walk(original, ["missing_toe@1"], 130), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    assert exported.events == original.events != []


def test_settings_decide_how_soon_a_diagnosis_is_accepted(parts: Path, ant: Path) -> None:
    def steps(**settings: float) -> list[int]:
        controller = controllers(parts, ant, **settings)
        walk(controller, ["missing_toe@1"], 150)
        return [event.step for event in controller.events if event.kind == "adapted"]

    # The first window is full in step 19; then a class must be diagnosed 12 times in a row, every 5 steps.
    patient = steps(diagnose_every=5, agreement=12, confidence=0)
    (first, *others) = steps(diagnose_every=1, agreement=1, confidence=0)
    assert first >= WINDOW - 1
    assert len(others) + 1 > len(patient)
    assert all(step >= WINDOW - 1 + 11 * 5 for step in patient)
    assert steps(confidence=1.0, agreement=150) == []


def test_the_policy_may_be_given_the_mean_of_all_codes(parts: Path, ant: Path, tmp_path: Path) -> None:
    """Codes and actions are computed here from the diagnoser and the policy."""
    settings = {"code": "expected"}
    out = dappo_batch.export(
        parts / "aware", tmp_path / "export", diagnoser=ant / "diagnoser", controller=settings
    )
    controller = Controller.from_export(out)
    policy, diagnoser = (
        Policy.load(parts / "aware"),
        Diagnoser.load(ant / "diagnoser", expert=parts / "aware"),
    )
    space = dappo_batch.compile_class_table("ant", max_damaged_limbs=1).space
    codes = np.array([item.code for item in space.classes], np.float32)
    envs = dappo_batch.make_vec("ant", 1, observe_damage=False, max_damaged_limbs=1, seed=7)
    obs, _ = envs.reset(options={"damage_class": "missing_toe@1", "onset": ONSET})
    rows = [np.zeros_like(obs[0])]  # the one before the first step, which no window contains
    for step in range(100):
        rows = [*rows, obs[0]][-WINDOW - 1 :]
        code = codes[0]
        if step >= WINDOW - 1:
            code = diagnoser.diagnose(np.array(rows), np.zeros((WINDOW, 8))) @ codes
        action = controller.act(obs)
        np.testing.assert_allclose(action[0], policy.act(np.concatenate([obs[0], code])), atol=1e-5)
        obs = envs.step(action)[0]
    assert 0.05 < code.max() < 1
    # The assumed class is reported as with codes of assumed classes.
    assert controller.class_names[controller.damage_classes[0]] == "missing_toe@1"
    with pytest.raises(ConfigError, match="`code` is `expected`, which needs a diagnosis in every step"):
        Controller(parts / "aware", diagnoser=parts / "diagnoser", settings={"code": "expected"})
    with pytest.raises(ConfigError, match="code"):
        controllers(parts, ant, code="guessed")


def test_nothing_is_diagnosed_while_observations_are_lost(parts: Path, ant: Path) -> None:
    controller = controllers(parts, ant, diagnose_every=1, agreement=1)
    actions = walk(controller, ["missing_toe@1"], 120, lost=range(50, 120))
    assert np.isfinite(actions).all()
    assert [event.step for event in controller.events if event.kind == "observation_invalid"] == [50]
    assert all(event.step <= 50 for event in controller.events)


def test_what_needs_a_twin_is_refused_with_the_remedy(parts: Path, ant: Path, go1: Path) -> None:
    damage = ("--damage", "1", "--at", str(ONSET))
    base = ("adapt", parts / "aware", "--diagnoser", ant / "diagnoser", *damage)
    collect = ("diagnose", "collect", parts / "aware", "--preset", "observation", "--out", ant / "new")
    expected = {
        (*base, "--trigger", "residual"): "the trigger `residual` needs one with twins",
        (*base, "--expert", parts / "expert"): "would never act",
        (
            *("adapt", parts / "aware", "--diagnoser", parts / "diagnoser", *damage),
            *("--trigger", "observation"),
        ): "method B); train one with the method A",
        ("diagnose", "train", ant / "data", "--method", "B", "--out", ant / "new"): "expected A",
        (*collect, "--resync", "1"): "there is no twin with the preset observation",
        (*collect, "--policy", parts / "expert"): "leave out `policy`",
        (*collect, "--delay", "0-4"): "`delay` is 0, expected at least 1",
        (*collect, "--timesteps", "90"): "`timesteps` is 90, expected at most 55",
        (
            *("diagnose", "collect", go1 / "run", "--preset", "residual", "--out", ant / "new"),
        ): "do without a twin (preset `observation`)",
    }
    done = dappo_batch_many(*expected)
    for (code, _, err), (command, message) in zip(done, expected.items(), strict=True):
        assert code == 1, (command, err)
        assert message in err, (command, err)
    assert not (ant / "new").exists()
    twins = Controller(parts / "aware", diagnoser=parts / "diagnoser")
    with pytest.raises(ConfigError, match="needs the forward velocity"):
        twins.act(np.zeros(111))
    diagnoser = Diagnoser.load(ant / "diagnoser", expert=parts / "aware")
    with pytest.raises(ConfigError, match="has none"):
        diagnoser.twin(np.zeros((WINDOW + 1, 111)), np.zeros((WINDOW, 8)))


def test_logged_walks_are_diagnosed_without_a_twin(parts: Path, ant: Path) -> None:
    diagnoser = Diagnoser.load(ant / "diagnoser", expert=parts / "aware")
    data = records(ant / "data")
    damaged = data["damaged"][:30].reshape(-1, WINDOW, 111)
    # The observation before the first step is not part of the window.
    obs = np.concatenate([np.zeros_like(damaged[:, :1]), damaged], axis=1)
    probabilities = diagnoser.diagnose(obs, data["actions"][:30].reshape(-1, WINDOW, 8))
    np.testing.assert_allclose(probabilities.sum(axis=1), 1, atol=1e-5)
    assert np.mean(probabilities.argmax(axis=1) == np.tile(np.arange(CLASSES), 30)) > 0.4


def test_wrong_diagnoses_of_a_go1_cost_tracking(go1: Path) -> None:
    command = ("diagnose", "test", go1 / "diagnoser", "--data", go1 / "data", "--policy", go1 / "run")
    out, _ = run(*command, "--episodes", "1", "--json")
    (tested,) = json.loads(out)
    cost, names = tested["cost"], tested["classes"]
    # With the true code, the tracking is that of an evaluation.
    out, _ = run("evaluate", go1 / "run", "--episodes", "1", "--json")
    (evaluated,) = json.loads(out)["runs"]
    tracking = {each["name"]: each["tracking"] for each in evaluated["classes"]}
    assert cost["compared_by"] == "tracking"
    assert cost["true_score"] == pytest.approx(np.mean(list(tracking.values())))
    lost = 0.0
    for mistake in cost["mistakes"]:
        assert mistake["true_score"] == pytest.approx(tracking[mistake["class"]])
        assert 0 <= mistake["mistaken_score"] <= 1
        lost += mistake["share"] * (mistake["true_score"] - mistake["mistaken_score"])
    assert cost["diagnosed_score"] == pytest.approx(cost["true_score"] - lost / len(names))
    assert len(cost["mistakes"]) > 0
    text, _ = run(*command, "--episodes", "1")
    assert f"  tracking of the policy: {cost['true_score']:.3f} with the true class" in text
    assert "which changes the tracking from 0." in text
    assert "reward" not in text


def test_a_go1_adapts_and_the_outcome_is_how_it_tracks_its_commands(go1: Path, tmp_path: Path) -> None:
    log = tmp_path / "trace.csv"
    pair = (go1 / "run", "--diagnoser", go1 / "diagnoser", "--at", "20")
    settings = ("--controller", "agreement=1", "confidence=0")
    out, _ = run("adapt", *pair, *settings, "--damage", "dead_motor@1", "--episodes", "2", "--log", log)
    assert "tracking of the commands before step 20" in out
    with log.open(newline="") as file:
        rows = list(csv.DictReader(file))
    tracking = np.array([float(row["tracking"]) for row in rows])
    assert ((tracking > 0) & (tracking <= 1)).all()
    assert [row["damage"] for row in rows[19:21]] == ["healthy", "dead_motor@1"]
    out, _ = run("adapt", *pair, "--all-classes", "--episodes", "2", "--json")
    summary = json.loads(out)["summary"]
    with (go1 / "run" / "eval" / "adapt.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    for row, outcome in zip(table, summary["classes"], strict=True):
        assert float(row["tracking_before"]) == pytest.approx(outcome["tracking_before"], abs=1e-4)
        assert float(row["tracking_kept"]) == pytest.approx(outcome["tracking_kept"], abs=1e-4)
        # Commands, events and noise of an episode are the same for every damage: so is what precedes it.
        assert outcome["tracking_before"] == pytest.approx(summary["classes"][0]["tracking_before"], abs=1e-5)
    healthy = summary["classes"][0]
    if healthy["false_alarms"] == 0:
        assert healthy["adapted"] == healthy["oracle"] == healthy["no_adaptation"]
