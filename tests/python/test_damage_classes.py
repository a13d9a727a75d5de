"""Damage classes against the reference tables of the paper's reproduction, and `dappo-batch classes`."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from dappo_batch import load_robot
from dappo_batch._core import ConfigError, DamageSpace, run_cli

PAPER = Path(__file__).parents[1] / "paper"
TRIPOD = Path(__file__).parent / "robots" / "tripod.toml"
TYPES = ["jammed_joint", "missing_toe"]


def read(name: str) -> list[dict[str, str]]:
    with (PAPER / name).open(newline="") as file:
        return list(csv.DictReader(file))


def oracle(robot: str) -> list[dict[str, Any]]:
    """Read the reference classes; the table abbreviates the names of the damage types."""
    return [
        {
            "id": int(row["id"]),
            "name": row["name"].replace("jam@", "jammed_joint@").replace("toe@", "missing_toe@"),
            "group": row["group"],
            "code": [int(row[key]) for key in row if key.startswith("e")],
        }
        for row in read(f"damage_classes_{robot}.csv")
    ]


def classes_as_json(capfd: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    assert run_cli(["classes", "--json", *arguments]) == 0
    listed: list[dict[str, Any]] = json.loads(capfd.readouterr().out)
    return listed


@pytest.mark.parametrize(("robot", "count"), [("ant", 33), ("hexapod", 73)])
def test_the_command_lists_the_reference_classes(
    robot: str, count: int, capfd: pytest.CaptureFixture[str]
) -> None:
    listed = classes_as_json(capfd, "--robot", robot)
    assert len(listed) == count
    assert listed == oracle(robot)


@pytest.mark.parametrize(("robot", "limbs"), [("ant", 4), ("hexapod", 6)])
def test_the_damage_space_of_a_robot_is_the_reference(robot: str, limbs: int) -> None:
    damage = load_robot(robot).spec["damage"]
    space = DamageSpace(limbs, damage["types"], damage["max_damaged_limbs"])
    expected = oracle(robot)
    assert [(c.id, c.name, c.group, c.code) for c in space.classes] == [
        (c["id"], c["name"], c["group"], c["code"]) for c in expected
    ]
    n_damages = [int(row["n_damages"]) for row in read(f"damage_classes_{robot}.csv")]
    assert [len(c.damages) for c in space.classes] == n_damages
    for damage_class in space.classes:
        reversed_name = "+".join(reversed(damage_class.name.split("+")))
        assert space.parse(damage_class.name) == space.parse(reversed_name) == damage_class.id


def test_the_groups_of_the_hexapod_have_the_papers_sizes() -> None:
    # none 1, one damage 6 + 6; pairs of two jams, of both types and of two toes, by ring distance.
    groups = Counter(row["group"] for row in classes_of(6, 2, 2))
    assert groups == {
        **{"none": 1, "D1": 6, "D2": 6},
        **{"D1_1 A": 6, "D1_2 A": 12, "D2_2 A": 6},
        **{"D1_1 S": 6, "D1_2 S": 12, "D2_2 S": 6},
        **{"D1_1 O": 3, "D1_2 O": 6, "D2_2 O": 3},
    }


def classes_of(limbs: int, types: int, damaged: int) -> list[dict[str, Any]]:
    space = DamageSpace(limbs, [*TYPES, "another"][:types], damaged)
    return [{"group": c.group, "code": c.code} for c in space.classes]


@pytest.mark.parametrize(
    ("limbs", "types", "damaged", "count"), [(4, 2, 2, 33), (6, 2, 2, 73), (6, 2, 3, 233), (6, 3, 6, 4096)]
)
def test_the_number_of_classes_is_the_papers_formula(
    limbs: int, types: int, damaged: int, count: int
) -> None:
    classes = classes_of(limbs, types, damaged)
    assert len(classes) == count
    assert len({tuple(c["code"]) for c in classes}) == count, "codes must differ"


def test_the_command_takes_other_types_and_numbers_of_damaged_limbs(
    capfd: pytest.CaptureFixture[str],
) -> None:
    listed = classes_as_json(capfd, "--robot", "hexapod", "--max-damaged-limbs", "3")
    assert len(listed) == 233
    listed = classes_as_json(capfd, "--types", "missing_toe", "--max-damaged-limbs", "1")
    assert [c["name"] for c in listed] == ["healthy", *(f"missing_toe@{limb}" for limb in range(4))]
    assert [c["code"] for c in listed[:2]] == [[0, 0, 0, 0], [1, 0, 0, 0]]


def test_classes_of_your_own_robot_file_follow_its_order_of_types(
    capfd: pytest.CaptureFixture[str],
) -> None:
    listed = classes_as_json(capfd, "--robot", str(TRIPOD))
    # Σ 2^j C(3, j) for j = 0..3 = 27.
    assert len(listed) == 27
    assert [c["name"] for c in listed[:3]] == ["healthy", "missing_toe@0", "jammed_joint@0"]
    assert listed[1]["code"] == [1, 0, 0, 0, 0, 0]
    assert listed[-1]["code"] == [0, 1, 0, 1, 0, 1]


def test_the_printed_table_contains_the_same_as_the_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_cli(["classes"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[0].split() == ["id", "name", "group", "code"]
    for line, expected in zip(lines[1:], oracle("ant"), strict=True):
        code = "".join(map(str, expected["code"]))
        assert line.split() == [str(expected["id"]), expected["name"], *expected["group"].split(), code]


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("jam@0", "not a damage type of this robot"),
        ("jammed_joint@4", "limbs are 0 to 3"),
        ("33", "the classes are 0 to 32"),
        ("jammed_joint@0+missing_toe@0", "2 damages of limb 0; a limb has at most 1"),
        ("jammed_joint@0+jammed_joint@1+jammed_joint@2", "at most 2"),
    ],
)
def test_a_damage_that_does_not_exist_is_rejected(spec: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        DamageSpace(4, TYPES, 2).parse(spec)


def test_the_mirror_image_of_a_damage_is_on_the_other_side() -> None:
    space = DamageSpace(4, TYPES, 2)
    swapped = [3, 2, 1, 0]
    for spec, image in (
        ("healthy", "healthy"),
        ("missing_toe@1", "missing_toe@2"),
        ("jammed_joint@0+missing_toe@2", "missing_toe@1+jammed_joint@3"),
        ("missing_toe@0+missing_toe@3", "missing_toe@0+missing_toe@3"),
    ):
        assert space.mirror_image(spec, swapped) == space.parse(image)
        assert space.mirror_image(space.parse(image), swapped) == space.parse(spec)
    for limbs in ([3, 2], [0, 0, 0, 0], "3210", [-1, 2, 1, 0], None):
        with pytest.raises(ConfigError, match="limb"):
            space.mirror_image("jammed_joint@0+jammed_joint@2", limbs)  # type: ignore[arg-type]


def test_table_1_of_the_paper_is_whole_and_fits_the_damage_spaces() -> None:
    rows = read("paper_table1.csv")
    cells = {
        (r["env"], int(r["timesteps"]), r["method"], int(r["rollouts"])): float(r["accuracy_pct"])
        for r in rows
    }
    assert len(cells) == len(rows) == 36
    for row in rows:
        classes = len(oracle(row["env"]))
        assert int(row["classes"]) == classes
        assert float(row["chance_pct"]) == pytest.approx(100 / classes, abs=0.005)
    pairs = [(env, steps, rollouts) for env, steps, method, rollouts in cells if method == "A"]
    assert len(pairs) == 18
    assert all(cells[env, steps, "B", n] >= cells[env, steps, "A", n] for env, steps, n in pairs)
    best = {env: max(value for key, value in cells.items() if key[0] == env) for env in ("ant", "hexapod")}
    assert best == {"ant": 96.8, "hexapod": 87.6}
