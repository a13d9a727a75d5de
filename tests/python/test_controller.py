"""The run-time loop: `dappo-batch adapt`, and `Controller` against robots and sensors that fail."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ConfigError, Controller, Policy

from .command_line import dappo_batch as run
from .conftest import CONTROLLER_SIZES

CLASSES = 9
ONSET = 60
EPISODES = 6
Record = dict[str, Any]


def equipment(parts: Path) -> tuple[str | Path, ...]:
    return (parts / "aware", "--diagnoser", parts / "diagnoser")


def make(parts: Path, num_robots: int = 1, **settings: float) -> Controller:
    return Controller(
        parts / "aware", diagnoser=parts / "diagnoser", num_robots=num_robots, settings=settings
    )


def kinds(controller: Controller, robot: int = 0) -> list[str]:
    return [event.kind for event in controller.events if event.robot == robot]


def assumed(controller: Controller) -> list[str]:
    return [controller.class_names[index] for index in controller.damage_classes]


class Robots:
    """Walks of robots whose damage can be changed at any time."""

    def __init__(self, damage: list[str], seed: int = 7) -> None:
        self.envs = dappo_batch.make_vec(
            "ant", len(damage), damage="healthy", observe_damage=False, max_damaged_limbs=1, seed=seed
        )
        self.damage = damage
        self.obs, _ = self.envs.reset(options={"damage_class": damage})
        self.velocity = np.zeros(len(damage))

    def become(self, damage: list[str]) -> None:
        """Change the damage; positions and velocities go on."""
        self.damage = damage
        state = self.envs.get_state()
        self.envs.reset(options={"damage_class": damage})
        self.obs = self.envs.set_state(*state)

    def walk(
        self,
        controller: Controller,
        steps: int,
        sensors: Callable[[int, NDArray[np.float32]], NDArray[np.float32]] = lambda _, obs: obs,
    ) -> None:
        """Walk under a controller that reads the observations through `sensors`."""
        for step in range(steps):
            actions = controller.act(sensors(step, self.obs), self.velocity)
            assert np.isfinite(actions).all()
            self.obs, _, terminated, _, infos = self.envs.step(actions)
            if terminated.any():
                # A robot in the field is not put back on its feet.
                self.become(self.damage)
            self.velocity = infos["forward_velocity"]


@pytest.fixture(scope="module")
def trial(parts: Path) -> Record:
    out, _ = run("adapt", *equipment(parts), "--all-classes", *at(ONSET), "--json")
    summary: Record = json.loads(out)["summary"]
    return summary


def at(onset: int, episodes: int = EPISODES) -> tuple[str, ...]:
    return ("--at", str(onset), "--episodes", str(episodes))


def test_damage_is_detected_and_diagnosed_and_healthy_robots_raise_no_alarm(trial: Record) -> None:
    healthy, *damaged = trial["classes"]
    assert len(damaged) == CLASSES - 1
    assert healthy["false_alarms"] == 0
    assert healthy["adapted"] == healthy["oracle"] == healthy["no_adaptation"]
    # Damage of a leg that a policy of so little training hardly uses may take longer to show, or not show.
    detected = np.array([row["detected"] for row in damaged])
    assert detected.min() >= EPISODES / 2
    assert detected.mean() >= 0.95 * EPISODES
    assert np.median([row["median_delay"] for row in damaged]) <= 30
    # By chance, one in nine would be right.
    assert trial["correct_first"] > 0.8
    assert trial["correct_last"] > 0.8


def test_the_table_of_all_classes_is_what_was_printed(parts: Path, trial: Record) -> None:
    with (parts / "aware" / "eval" / "adapt.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [row["name"] for row in trial["classes"]]
    for row, printed in zip(rows, trial["classes"], strict=True):
        assert float(row["adapted"]) == pytest.approx(printed["adapted"], abs=0.006)
        assert int(row["correct_first"]) == printed["correct_first"]
        assert row["median_delay"] == (
            "" if printed["median_delay"] is None else f"{printed['median_delay']:.1f}"
        )
    assert json.loads((parts / "aware" / "eval" / "adapt.json").read_text()) == trial


def test_events_of_a_single_damage_are_printed_and_logged_step_by_step(parts: Path, tmp_path: Path) -> None:
    log = tmp_path / "trace.csv"
    out, _ = run("adapt", *equipment(parts), "--damage", "missing_toe@3", *at(ONSET, 1), "--log", log)
    assert "damage suspected" in out
    assert "damage code of the policy: missing_toe@3" in out
    with log.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 200
    assert [row["damage"] for row in rows[ONSET - 1 : ONSET + 1]] == ["healthy", "missing_toe@3"]
    (suspected,) = (index for index, row in enumerate(rows) if "suspected" in row["event"])
    (adapted,) = (index for index, row in enumerate(rows) if "adapted" in row["event"])
    assert ONSET < suspected < adapted == suspected + 20, "the diagnosis follows at the end of the window"
    assert {row["assumed"] for row in rows[:adapted]} == {"healthy"}
    assert {row["assumed"] for row in rows[adapted:]} == {"missing_toe@3"}
    # Of the last 200 steps only those since the damage count.
    velocity = np.array([float(row["forward_velocity"]) for row in rows])
    before, kept = velocity[:ONSET].mean(), velocity[ONSET:].mean()
    assert f"before step {ONSET}: {before:.2f} m/s; over the last 200 steps: {kept:.2f} m/s, " in out


def test_a_fleet_is_controlled_as_its_robots_would_be_alone(parts: Path) -> None:
    damages = ["healthy", "jammed_joint@2", "jammed_joint@0"]
    fleet, robots = make(parts, 3), Robots(["healthy"] * 3)
    alone = [make(parts) for _ in damages]
    for steps, struck in ((ONSET, ["healthy"] * 3), (60, damages)):
        robots.become(struck)
        for _ in range(steps):
            actions = fleet.act(robots.obs, robots.velocity)
            for index, controller in enumerate(alone):
                action = controller.act(robots.obs[index], robots.velocity[index])
                np.testing.assert_allclose(action, actions[index], rtol=0, atol=1e-6)
            robots.obs, _, _, _, infos = robots.envs.step(actions)
            robots.velocity = infos["forward_velocity"]
    assert "adapted" in kinds(fleet, 1) + kinds(fleet, 2), "a diagnosis is part of the comparison"
    for index, controller in enumerate(alone):
        assert kinds(controller) == kinds(fleet, index)
        assert controller.damage_classes == [fleet.damage_classes[index]]


def test_another_expert_acts_only_during_a_diagnosis(parts: Path) -> None:
    def actions(expert: str | None) -> tuple[NDArray[np.float32], list[int]]:
        folders = {"diagnoser": parts / "diagnoser", "expert": parts / expert if expert else None}
        controller, robots = Controller(parts / "aware", **folders), Robots(["healthy"])
        taken = []
        for step in range(ONSET + 30):
            if step == ONSET:
                robots.become(["jammed_joint@2"])
            taken.append(controller.act(robots.obs, robots.velocity))
            # What the robot does is the same whoever controls it, so that the actions can be compared.
            robots.obs, _, _, _, infos = robots.envs.step(
                np.full((1, 8), 0.3 * np.sin(0.5 * step), np.float32)
            )
            robots.velocity = infos["forward_velocity"]
        return np.concatenate(taken), [event.step for event in controller.events]

    own, begun = actions(None)
    same, _ = actions("aware")
    other, begun_with_other = actions("expert")
    np.testing.assert_array_equal(own, same)
    first = begun[0]
    assert first == begun_with_other[0]
    np.testing.assert_array_equal(own[:first], other[:first])
    assert (own[first : first + 20] != other[first : first + 20]).any(axis=1).all()


def test_lost_observations_are_replaced_and_raise_no_suspicion(parts: Path) -> None:
    controller, robots = make(parts), Robots(["healthy"])

    def sensors(step: int, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        obs = obs.copy()
        if step in (20, 90):
            obs[:] = np.nan
        if 100 <= step < 110:
            obs[0, 5] = np.inf
        return obs

    robots.walk(controller, 150, sensors)
    assert kinds(controller) == ["observation_invalid", "observation_valid"] * 3
    assert [event.step for event in controller.events] == [20, 21, 90, 91, 100, 110]
    assert [event.entries for event in controller.events[::2]] == [111, 111, 1]
    # Lost from the first step on: nothing is known, and still there is an action.
    assert np.isfinite(make(parts).act(np.full(111, np.nan), np.nan)).all()


def test_observations_out_of_range_lead_to_finite_actions(parts: Path) -> None:
    controller = make(parts)
    for reading in (1e30, -1e30, 0.0, 1e-40):
        for _ in range(100):
            assert np.isfinite(controller.act(np.full(111, reading), reading)).all()
    assert "suspected" in kinds(controller)


def test_wrong_contact_forces_and_little_noise_raise_no_suspicion(parts: Path) -> None:
    controller, robots = make(parts), Robots(["healthy"])
    rng = np.random.default_rng(0)

    def sensors(_: int, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        noise = np.repeat([1e-4, 1e-3, 0.5], [13, 14, 84])  # of positions, velocities and contact forces
        return obs + (noise * rng.standard_normal(111)).astype(np.float32)

    robots.walk(controller, 150, sensors)
    assert kinds(controller) == []


def test_a_stuck_sensor_raises_suspicions_at_increasing_intervals(parts: Path) -> None:
    controller, robots = make(parts), Robots(["healthy"])
    stuck: list[NDArray[np.float32]] = []

    def sensors(step: int, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        if step == ONSET:
            stuck.append(obs.copy())
        # Joint velocities that never change.
        return obs if step < ONSET else np.concatenate([obs[:, :19], stuck[0][:, 19:27], obs[:, 27:]], axis=1)

    robots.walk(controller, 600, sensors)
    begun = [event.step for event in controller.events if event.kind == "suspected"]
    assert begun[0] > ONSET
    waits = np.diff(begun)
    assert len(waits) >= 2
    assert all(later > earlier for earlier, later in pairwise(waits)), begun


def test_a_second_damage_and_its_repair_are_detected_like_the_first(parts: Path) -> None:
    many = 4 * EPISODES
    controller, robots = make(parts, many), Robots(["healthy"] * many)
    robots.walk(controller, ONSET)
    for damage, steps in (("missing_toe@1", 60), ("jammed_joint@2", 70), ("healthy", 100)):
        robots.become([damage] * many)
        before = len(controller.events)
        robots.walk(controller, steps)
        suspected = {event.robot for event in controller.events[before:] if event.kind == "suspected"}
        # Robots that have fallen hardly show a change.
        assert len(suspected) >= many / 12
        # What is diagnosed of two damages may be wrong. By chance, one in nine would be right.
        if damage != "jammed_joint@2":
            assert assumed(controller).count(damage) >= many / 4


def test_damage_during_a_diagnosis_window_is_diagnosed_in_the_end(parts: Path) -> None:
    many = 2 * EPISODES
    controller, robots = make(parts, many), Robots(["healthy"] * many)
    robots.walk(controller, ONSET)
    robots.become(["missing_toe@1"] * many)
    while len(kinds(controller)) == 0:
        robots.walk(controller, 1)
    robots.walk(controller, 15)
    robots.become(["jammed_joint@2"] * many)
    # What is named after a window of two damages may be wrong, but it does not last.
    robots.walk(controller, 350)
    # A robot that lies still hardly shows a jammed joint. By chance, one in nine would be right.
    assert assumed(controller).count("jammed_joint@2") > many / 3


def test_a_diagnosis_with_low_confidence_is_not_accepted(parts: Path) -> None:
    controller, robots = make(parts, confidence=1.0), Robots(["healthy"])
    robots.walk(controller, ONSET)
    robots.become(["missing_toe@1"])
    robots.walk(controller, 60)
    assert kinds(controller) == ["suspected", "diagnosed"]
    assert controller.events[-1].accepted is False
    assert controller.damage_classes == [0]


def test_a_reset_clears_the_assumed_class_of_the_robots_in_its_mask(parts: Path) -> None:
    controller, robots = make(parts, 2), Robots(["healthy"] * 2)
    robots.walk(controller, ONSET)
    robots.become(["missing_toe@1", "missing_toe@1"])
    robots.walk(controller, 60)
    named = controller.damage_classes
    assert (named > 0).all()
    controller.reset([True, False])
    assert controller.damage_classes.tolist() == [0, named[1]]
    controller.reset()
    assert controller.damage_classes.tolist() == [0, 0]


def test_a_reset_clears_earlier_observations_of_the_robot(parts: Path) -> None:
    used, fresh = make(parts, 2), make(parts, 2)
    robots = Robots(["healthy", "healthy"])
    robots.walk(used, 3)
    lost = robots.obs.copy()
    lost[0] = np.nan
    held = used.act(lost, np.zeros(2))[0]
    used.reset([True, False])
    actions, expected = used.act(lost, np.zeros(2)), fresh.act(lost, np.zeros(2))
    np.testing.assert_array_equal(actions[0], expected[0])
    assert np.abs(actions[0] - held).max() > 1e-3, (
        "the observations of the robot before lead to other actions"
    )


def test_the_speed_trigger_needs_no_twin_and_suspects_a_robot_that_stands_still(parts: Path) -> None:
    controller = Controller(
        parts / "aware", diagnoser=parts / "diagnoser", trigger="speed", settings={"speed_window": 10}
    )
    obs = Robots(["healthy"]).obs
    with (parts / "aware" / "eval" / "per_class.csv").open(newline="") as file:
        healthy = next(csv.DictReader(file))
    expected = float(healthy["forward_reward"]) / float(healthy["episode_length"])
    for _ in range(80):
        controller.act(obs, np.array([expected - 1.0]))
    suspected = next(event for event in controller.events if event.kind == "suspected")
    assert suspected.expected == pytest.approx(expected, abs=1e-3)
    assert suspected.forward_velocity == pytest.approx(expected - 1.0)
    assert suspected.residual is None
    assert suspected.step == 50, "after the cool-down"


def test_what_cannot_be_used_is_rejected_with_the_reason(parts: Path) -> None:
    with pytest.raises(dappo_batch.ConfigError, match=r"`confidence` is 2, expected a number in \[0, 1\]"):
        make(parts, confidence=2)
    with pytest.raises(dappo_batch.ConfigError, match="trigger"):
        Controller(parts / "aware", diagnoser=parts / "diagnoser", trigger="pain")
    with pytest.raises(dappo_batch.ConfigError, match="is not a run folder"):
        Controller(parts / "nowhere", diagnoser=parts / "diagnoser")
    with pytest.raises(dappo_batch.ShapeError, match=r"\[1, 119\].*expected \[1, 111\]"):
        make(parts).act(np.zeros(119), 0.0)
    _, err = run("adapt", *equipment(parts), "--damage", "missing_toe@9", code=1)
    assert "missing_toe@9" in err
    _, err = run("adapt", *equipment(parts), "--damage", "missing_toe@1", *at(200), code=1)
    assert "strike at step 200, but an episode has 200 steps" in err
    _, err = run(
        "adapt", *equipment(parts), "--damage", "1", "--unaware", parts / "aware", *at(ONSET), code=1
    )
    assert "observes the damage" in err


def test_a_policy_without_code_walks_with_the_history_that_it_observes(parts: Path, tmp_path: Path) -> None:
    """Its healthy episodes are those of an evaluation, where it has envs of its own."""
    stacked = tmp_path / "stacked"
    sizes = (*CONTROLLER_SIZES, "env.max_episode_steps=30")
    run("train", *sizes, "--unaware", "--history", "3", "--steps", "8192", "--run", stacked)
    short = ("--at", "1", "--episodes", "2", "--set", "env.max_episode_steps=30", "--seed", "1000000")
    out, _ = run("adapt", *equipment(parts), "--damage", "healthy", "--unaware", stacked, *short, "--json")
    (healthy,) = json.loads(out)["summary"]["classes"]
    evaluated = dappo_batch.evaluate(stacked, episodes=2, threads=1).runs[0].classes[0]
    # `adapt` counts from the second step on; in the first one robots hardly move.
    assert healthy["unaware"] == pytest.approx(evaluated.forward_reward, abs=0.2)
    assert abs(healthy["unaware"] - healthy["no_adaptation"]) > 2


def test_a_policy_of_another_learner_walks_in_the_place_of_one_without_damage_code(parts: Path) -> None:
    """The policy of the controller, as a function with the code of a healthy robot, does not adapt."""
    policy = Policy.load(parts / "aware")
    seen: list[tuple[int, ...]] = []

    def act(obs: NDArray[np.float32]) -> NDArray[np.float32]:
        seen.append(obs.shape)
        return policy.act(obs)

    found = dappo_batch.adapt(
        parts / "aware",
        parts / "diagnoser",
        act=act,
        damage="missing_toe@0",
        at=20,
        episodes=2,
        threads=1,
        set={"env.max_episode_steps": 60},
        controller={"cooldown": 0},
    )
    (result,) = found.summary.classes
    assert seen == [(2, policy.obs_dim)] * 60
    assert result.unaware == result.no_adaptation
    with pytest.raises(ConfigError, match="unaware"):
        dappo_batch.adapt(parts / "aware", parts / "diagnoser", act=act, unaware=parts / "aware", damage=0)


def test_a_damage_that_the_controller_does_not_know_is_mapped_to_one_that_it_does(parts: Path) -> None:
    half = ("--set", "damage.severity=0.5")
    out, _ = run("adapt", *equipment(parts), "--damage", "missing_toe@1", *at(ONSET), *half, "--json")
    result = json.loads(out)
    assert result["summary"]["classes"][0]["detected"] == EPISODES
    names = make(parts).class_names
    first = [next(e for e in events if e["event"] == "diagnosed") for events in result["events"]]
    assert {names[event["class"]] for event in first} <= set(names)


def test_a_damage_type_that_the_policy_was_not_trained_with_has_no_oracle(parts: Path) -> None:
    dead = ("--set", 'damage.types=["weak_motor", "missing_toe"]', "damage.options.weak_motor.strength=0.0")
    out, _ = run("adapt", *equipment(parts), "--damage", "weak_motor@1", *at(ONSET), *dead, "--json")
    summary = json.loads(out)["summary"]
    (outcome,) = summary["classes"]
    assert outcome["name"] == "weak_motor@1"
    # Robots that have fallen hardly show a change.
    assert outcome["detected"] >= outcome["episodes"] / 2 > 0
    assert outcome["correct_first"] == outcome["correct_last"] == 0
    assert outcome["oracle"] is summary["adapted_share"] is outcome["median_recovery"] is None
    assert {entry["name"] for entry in outcome["assumed"]} <= set(make(parts).class_names)
    assert sum(entry["episodes"] for entry in outcome["assumed"]) == outcome["episodes"]
    # The diagnoser names a class nevertheless, and the twin with its damage shows that it is none of them.
    events = [event for episode in json.loads(out)["events"] for event in episode]
    withdrawn = [event for event in events if event["event"] == "withdrawn"]
    assert withdrawn
    for event in withdrawn:
        assert event["class"] > 0
        assert event["residual"] >= event["healthy"]
        assert {"robot": event["robot"], "step": event["step"], "event": "adapted", "class": 0} in events
    believing = (*dead, "--controller", "probation=0", "--json")
    out, _ = run("adapt", *equipment(parts), "--damage", "weak_motor@1", *at(ONSET), *believing)
    assert not [e for episode in json.loads(out)["events"] for e in episode if e["event"] == "withdrawn"]
    out, _ = run("adapt", *equipment(parts), "--damage", "weak_motor@1", *at(ONSET), *dead)
    assert "damage codes at the end, with episodes: " in out
    assert "oracle" not in out


def test_a_known_damage_keeps_its_oracle_among_unknown_ones(parts: Path, trial: Record) -> None:
    """Its class has another number in the robot's table than in the policy's."""
    other = ("--set", 'damage.types=["weak_motor", "missing_toe"]')
    out, _ = run("adapt", *equipment(parts), "--damage", "missing_toe@3", *at(ONSET), *other, "--json")
    (outcome,) = json.loads(out)["summary"]["classes"]
    known = next(row for row in trial["classes"] if row["name"] == "missing_toe@3")
    for key in ("oracle", "no_adaptation", "adapted", "correct_first", "correct_last", "median_recovery"):
        assert outcome[key] == known[key], key


def test_another_robot_than_the_policys_is_rejected(parts: Path) -> None:
    other = ("--damage", "missing_toe@1", "--set", 'robot="hexapod"')
    _, err = run("adapt", *equipment(parts), *other, code=1)
    assert "--set makes the robot `hexapod`, but the policy controls `ant`" in err
