"""What films show and when, without drawing: captions, colours and schedule."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ClassTable, ConfigError, Event, ShapeError
from dappo_batch.render import Walk
from dappo_batch.render.captions import captions, findings, readable
from dappo_batch.render.scene import RED, painted, scene
from dappo_batch.render.scenery import with_scenery
from dappo_batch.render.schedule import evenly, schedule

NAMES = ("healthy", "jammed_joint@0", "missing_toe@0")


@pytest.fixture(scope="module", params=["ant", "hexapod"])
def table(request: pytest.FixtureRequest) -> ClassTable:
    return dappo_batch.compile_class_table(request.param, max_damaged_limbs=1)


def states(table: ClassTable, count: int) -> NDArray[np.float64]:
    """Return the reference pose, `count` times."""
    return np.tile(table.models[0].qpos0, (count, 1))


def event(step: int, kind: str, **more: Any) -> Event:  # noqa: ANN401
    return Event.from_dict({"robot": 0, "step": step, "event": kind, **more})


def diagnosed(step: int, damage_class: int, confidence: float, accepted: bool = True) -> Event:
    return event(step, "diagnosed", **{"class": damage_class}, confidence=confidence, accepted=accepted)


def test_the_caption_follows_the_events_of_the_controller() -> None:
    events = [
        event(2, "suspected"),
        diagnosed(4, 2, 0.97),
        event(4, "adapted", **{"class": 2}),
        event(6, "suspected"),
        diagnosed(7, 1, 0.31, accepted=False),
        event(8, "observation_invalid", entries=3),
        event(9, "observation_valid"),
        event(10, "withdrawn", **{"class": 2}, residual=0.4, healthy=0.2),
        event(10, "adapted", **{"class": 0}),
        event(11, "suspected"),
        diagnosed(12, 0, 0.9),
    ]
    assert findings(events, NAMES, ["left hind"], 13) == [
        *(["no damage suspected"] * 2),
        *(["damage suspected, diagnosing"] * 2),
        *(["diagnosed as missing toe (left hind), confidence 97 %, policy adapted"] * 2),
        "damage suspected, diagnosing",
        "no diagnosis: jammed joint (left hind), confidence 31 %",
        "no diagnosis: jammed joint (left hind), confidence 31 %, observation invalid",
        "no diagnosis: jammed joint (left hind), confidence 31 %",
        "diagnosis withdrawn: missing toe (left hind), policy reset to healthy",
        "damage suspected, diagnosing",
        "diagnosed as healthy, confidence 90 %",
    ]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("healthy", "healthy"),
        ("missing_toe@1", "missing toe (hind limb)"),
        ("weak_motor@0+jammed_joint@1", "weak motor (front) + jammed joint (hind limb)"),
        ("missing_toe@7", "missing toe (limb 7)"),
    ],
)
def test_damage_is_shown_in_words_with_the_names_of_the_limbs(name: str, expected: str) -> None:
    assert readable(name, ["front", "hind_limb"]) == expected


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        ({"step": 1}, "an event has no step or no kind"),
        ({"event": "suspected"}, "an event has no step or no kind"),
        ({"step": "1", "event": "suspected"}, "an event: step is '1', expected a value of type int"),
        ({"step": 1, "event": "adapted", "class": True}, "an event: class is True"),
        ({"step": 1, "event": "adapted", "class": 3}, "has damage class 3, expected one from 0 to 2"),
        ({"step": 1, "event": "adapted", "class": -1}, "has damage class -1"),
        (5, "an event must be a mapping"),
    ],
)
def test_an_event_that_is_none_is_rejected(table: ClassTable, odd: Any, message: str) -> None:  # noqa: ANN401
    with pytest.raises(ConfigError, match=message):
        Walk(table, states(table, 3), events=[odd], known_names=NAMES)
    assert Walk(table, states(table, 3), events=[event(1, "adapted", **{"class": 2})], known_names=NAMES)


def test_the_caption_shows_the_damage_from_its_onset_on_and_the_speed_of_the_last_second(
    table: ClassTable,
) -> None:
    dt = table.models[0].opt.timestep * table.robot.spec["frame_skip"]
    second = round(1 / dt)
    velocities = np.concatenate([np.full(second, 1.0), np.full(second, 3.0)])
    walk = Walk(
        table, states(table, 2 * second + 1), "missing_toe@1", 5, forward_velocity=velocities, note="a note"
    )
    said = captions(walk)
    assert len(said) == 2 * second + 1
    limb = table.robot.limbs[1].name.replace("_", " ")
    assert [caption.damage for caption in said[4:6]] == ["healthy", f"damage: missing toe ({limb})"]
    assert [caption.damaged for caption in said[4:6]] == [False, True]
    assert {caption.finding for caption in said} == {"a note"}
    assert said[0].time == "0.0 s   step 0"
    assert said[second].time == f"{second * dt:.1f} s   step {second}   1.00 m/s"
    assert said[-1].time.endswith("3.00 m/s")
    halfway = said[second + second // 2].time
    assert 1.0 < float(halfway.split()[-2]) < 3.0


def test_a_walk_without_velocities_and_controller_is_captioned_with_time_and_damage_alone(
    table: ClassTable,
) -> None:
    (caption,) = captions(Walk(table, table.models[0].qpos0))
    assert (caption.time, caption.damage, caption.finding) == ("0.0 s   step 0", "healthy", "")


@pytest.mark.parametrize("step_seconds", [0.05, 0.015, 0.004, 1.0])
@pytest.mark.parametrize(("fastest", "unit"), [(30.0, None), (20.0, 0.01)])
def test_pictures_show_the_state_of_their_time_and_never_come_too_fast(
    step_seconds: float, fastest: float, unit: float | None
) -> None:
    plan = schedule(301, step_seconds, fastest=fastest, unit=unit)
    assert plan.seconds >= 1 / fastest - 1e-12
    if unit is not None:
        assert plan.seconds / unit == pytest.approx(round(plan.seconds / unit))
    assert plan.states[0] == 0
    late = np.arange(len(plan.states)) * plan.seconds - np.array(plan.states) * step_seconds
    assert (late > -1e-9).all()
    assert (late < step_seconds + 1e-9).all()
    if unit is None:
        assert len(set(np.diff(plan.states))) == 1, "the robot moves evenly"
    # The film is as long as the walk.
    assert 300 * step_seconds - len(plan.states) * plan.seconds < plan.seconds


@pytest.mark.parametrize(
    ("states", "frames", "expected"),
    [(401, 4, [0, 133, 267, 400]), (401, 1, [400]), (3, 8, [0, 1, 2]), (1, 4, [0]), (401, 2, [0, 400])],
)
def test_a_strip_goes_from_the_first_state_to_the_last(states: int, frames: int, expected: list[int]) -> None:
    assert evenly(states, frames) == expected


def test_limbs_turn_red_with_their_damage_and_all_else_keeps_its_colour(table: ClassTable) -> None:
    damage_class = table.space.parse("missing_toe@1")
    untouched = table.models[damage_class].geom_rgba.copy(), table.models[damage_class].geom_matid.copy()
    model = painted(table, damage_class, with_scenery(table))
    of_limb = np.isin(model.geom_bodyid, table.limb_bodies[1])
    assert of_limb.any()
    assert (model.geom_rgba[of_limb] == np.float32(RED)).all()
    assert (model.geom_matid[of_limb] == -1).all()
    np.testing.assert_array_equal(model.geom_matid[~of_limb], table.models[0].geom_matid[~of_limb])
    np.testing.assert_array_equal(model.geom_rgba[~of_limb], table.models[0].geom_rgba[~of_limb])
    healthy = painted(table, 0, with_scenery(table))
    np.testing.assert_array_equal(healthy.geom_matid, table.models[0].geom_matid)
    np.testing.assert_array_equal(table.models[damage_class].geom_rgba, untouched[0])
    np.testing.assert_array_equal(table.models[damage_class].geom_matid, untouched[1])


def test_a_scene_changes_to_the_damaged_robot_at_the_onset(table: ClassTable) -> None:
    damage_class = table.space.parse("jammed_joint@2")
    walk = Walk(table, states(table, 10), damage_class, 4)
    shown = scene(walk, [0, 3, 4, 9], 64, 48)
    assert shown.damage_classes == [0, 0, damage_class, damage_class]
    assert set(shown.models) == {0, damage_class}
    assert shown.qpos.shape == (4, table.models[0].nq)
    # The damage is that of the class, not paint alone.
    joints = shown.models[damage_class].jnt_range, table.models[damage_class].jnt_range
    np.testing.assert_array_equal(*joints)


def test_the_floor_has_no_end_and_tiles_as_large_as_before(table: ClassTable) -> None:
    before, after = table.models[0], painted(table, 0, with_scenery(table))
    (plane,) = np.flatnonzero(before.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    material = before.geom_matid[plane]
    assert (after.geom_size[plane, :2] == 0).all()
    # MuJoCo counts repeats along the whole plane, and those of an endless one per metre.
    per_metre = before.mat_texrepeat[material] / (2 * before.geom_size[plane, :2])
    np.testing.assert_allclose(after.mat_texrepeat[material], per_metre, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"damage": "missing_toe@9"}, ConfigError, "missing_toe@9"),
        ({"onset": -1}, ConfigError, "onset must be at least 0, got -1"),
        ({"qpos": np.zeros((3, 4))}, ShapeError, r"qpos has shape \(3, 4\), expected \[T \+ 1, 15\]"),
        ({"qpos": np.zeros((0, 15))}, ShapeError, r"qpos has shape \(0, 15\)"),
        ({"qpos": np.full((3, 15), np.nan)}, ShapeError, "not finite"),
        ({"forward_velocity": np.zeros(3)}, ShapeError, r"shape \(3,\), expected \[2\]"),
    ],
)
def test_a_walk_that_fits_together_badly_is_rejected(
    change: dict[str, Any], error: type[Exception], message: str
) -> None:
    ant = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    fitting: dict[str, Any] = {"qpos": states(ant, 3), "forward_velocity": np.zeros(2)}
    with pytest.raises(error, match=message):
        Walk(ant, **(fitting | change))
