"""Mirror images: which parts are those of others, and that a mirrored robot moves as in a mirror."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ConfigError
from dappo_batch.model import compile_class_table
from dappo_batch.model.symmetry import find_symmetry

from .command_line import dappo_batch as cli

ROBOTS = Path(dappo_batch.__file__).parent / "robots"
SIDES = {
    "ant": (("front_left", "front_right"), ("back_left", "back_right")),
    "go1": (("FL", "FR"), ("RL", "RR")),
    "go2": (("FL", "FR"), ("RL", "RR")),
}
EVERYTHING = """
[commands.velocity]
lin_vel_x = [0.4, 0.4]
lin_vel_y = [0.0, 0.0]
ang_vel_z = [0.0, 0.0]
resample_every = [100.0, 100.0]

[actions]
type = "joint_position"
scale = 0.5

[observation.policy]
terms = [
  { term = "qpos" },
  { term = "qvel", delay = 1 },
  { term = "cfrc_ext", clip = 1.0 },
  { term = "touch" },
  { term = "base_height" },
  { term = "base_lin_vel" },
  { term = "base_ang_vel", history = 3 },
  { term = "projected_gravity" },
  { term = "command" },
  { term = "joint_pos", scale = 2.0 },
  { term = "joint_vel" },
  { term = "last_action" },
  { term = "clock", period = 0.5 },
  { term = "foot_contact" },
  { term = "foot_vel" },
  { term = "foot_height" },
  { term = "foot_air_time" },
]

[reset]
keyframe = "home"
qpos_noise = 0.0
qvel_noise = 0.0

[rewards]
track_lin_vel = { weight = 1.0, std = 0.5 }
torque_squared = { weight = -2e-5 }
feet_slip = { weight = -0.05 }

[terminations]
tilt = { angle = 1.5 }
"""


def mirrored_name(name: str, sides: tuple[tuple[str, str], ...]) -> str:
    for pair in sides:
        for one, other in (pair, pair[::-1]):
            if name.startswith(one):
                return other + name.removeprefix(one)
    return name


@pytest.mark.parametrize("name", SIDES)
def test_limbs_and_bodies_are_matched_with_those_of_the_other_side(name: str) -> None:
    table = compile_class_table(name, max_damaged_limbs=0)
    found = find_symmetry(table)
    limbs = [limb.name for limb in table.robot.limbs]
    assert [limbs[image] for image in found.limbs] == [mirrored_name(limb, SIDES[name]) for limb in limbs]
    bodies = [table.models[0].body(index).name for index in range(table.models[0].nbody)]
    if name != "ant":  # its bodies have numbers
        assert [bodies[image] for image in found.bodies] == [
            mirrored_name(body, SIDES[name]) for body in bodies
        ]
        signs = [image.sign for image in found.joints]
        assert signs == [-1.0, 1.0, 1.0] * 4, "hips turn about x, thighs and calves about y"


def symmetric_go1() -> str:
    """Return the MJCF of the Go1 with centres of mass and axes of inertia of trunk and calves in the plane.

    Those that Unitree has published lie up to 2 mm beside it.
    """

    def centered(match: re.Match[str]) -> str:
        head, place, between, inertia, end = match.groups()
        x, _, z = place.split()
        xx, yy, zz, _, xz, _ = inertia.split()
        return f"{head}{x} 0 {z}{between}{xx} {yy} {zz} 0 {xz} 0{end}"

    mass = "|".join(("5.204", "0.195862"))
    pattern = rf'(<inertial mass="(?:{mass})" pos=")([^"]*)("\s*fullinertia=")([^"]*)(")'
    text, count = re.subn(pattern, centered, (ROBOTS / "go1.xml").read_text())
    assert count == 5
    return text


def everything(tmp_path: Path) -> Path:
    """Return the Go1 with a task that observes all terms, without noise, and in which nothing is random."""
    text = (ROBOTS / "go1.toml").read_text()
    (tmp_path / "go1.xml").write_text(symmetric_go1())
    text = re.sub(r"^task = .*$", "frame_skip = 5\nmax_episode_steps = 1000", text, flags=re.MULTILINE)
    text = text.partition("[tasks.velocity.reset]")[0]
    path = tmp_path / "everything.toml"
    path.write_text(text + EVERYTHING)
    return path


def reflected_state(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, sides: tuple[tuple[str, str], ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mirror image of a state, from the names of joints and the axes of hinges."""
    image_qpos, image_qvel = np.empty_like(qpos), np.empty_like(qvel)
    image_qpos[:7] = qpos[:7] * [1, -1, 1, 1, -1, 1, -1]
    image_qvel[:6] = qvel[:6] * [1, -1, 1, -1, 1, -1]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for joint in range(1, model.njnt):
        other = model.joint(mirrored_joint(model.joint(joint).name, sides)).id
        axis = data.xaxis[joint] @ (data.xaxis[other] * [-1, 1, -1])
        assert abs(abs(axis) - 1) < 1e-6
        image_qpos[6 + joint] = np.sign(axis) * qpos[6 + other]
        image_qvel[5 + joint] = np.sign(axis) * qvel[5 + other]
    return image_qpos, image_qvel


def mirrored_joint(name: str, sides: tuple[tuple[str, str], ...]) -> str:
    ant = {"1": "4", "2": "3", "3": "2", "4": "1"}
    if sides is SIDES["ant"]:
        return name[:-1] + ant[name[-1]]
    return mirrored_name(name, sides)


@pytest.mark.parametrize("backend", ["mujoco", "lanes"])
@pytest.mark.parametrize("name", ["ant", "go1"])
def test_a_mirrored_robot_is_observed_and_rewarded_as_in_a_mirror(
    name: str, backend: str, tmp_path: Path
) -> None:
    robot = everything(tmp_path) if name == "go1" else name
    table = compile_class_table(robot, max_damaged_limbs=1)
    classes = table.space.classes
    limbs = find_symmetry(table).limbs
    ids = [item.id for item in classes]
    images = []
    for item in classes:
        kind, _, limb = item.name.partition("@")
        images.append(table.space.parse(f"{kind}@{limbs[int(limb)]}") if limb else item.id)
    count = len(ids)
    env = dappo_batch.make_vec(
        table, 2 * count, backend=backend, precision="f64", seed=3, max_episode_steps=1000
    )
    env.reset(options={"damage_class": np.array([*ids, *images])})
    model, rng = table.models[0], np.random.default_rng(5)
    qpos, qvel = env.get_state()
    joints = slice(7, None)
    qpos[:count, joints] += rng.uniform(-0.1, 0.1, (count, model.nq - 7))
    qpos[:count, :3] += rng.uniform(-0.02, 0.02, (count, 3))
    qpos[:count, 3:7] += rng.uniform(-0.1, 0.1, (count, 4))
    qpos[:count, 3:7] /= np.linalg.norm(qpos[:count, 3:7], axis=1, keepdims=True)
    qvel[:count] += rng.uniform(-0.5, 0.5, (count, model.nv))
    for index in range(count):
        qpos[count + index], qvel[count + index] = reflected_state(
            model, qpos[index], qvel[index], SIDES[name]
        )
    obs = env.set_state(qpos, qvel)
    mirror = env.mirror()
    scale = np.abs(obs).max(axis=0) + 1e-3

    def assert_mirrored(tolerance: float) -> None:
        difference = np.abs(obs[count:] - mirror.obs(obs[:count])) / scale
        worst = np.unravel_index(difference.argmax(), difference.shape)
        assert difference.max() < tolerance, (classes[worst[0]].name, env.obs_names[worst[1]])

    assert_mirrored(1e-5)
    assert np.array_equal(mirror.obs(mirror.obs(obs)), obs)
    moved = obs
    for _ in range(6):
        actions = rng.uniform(-1, 1, (count, env.single_action_space.shape[0])).astype(np.float32)
        obs, rewards, *_ = env.step(np.concatenate([actions, mirror.actions(actions)]))
        scale = np.maximum(scale, np.abs(obs).max(axis=0))
        assert_mirrored(1e-4)
        np.testing.assert_allclose(rewards[count:], rewards[:count], rtol=1e-4, atol=1e-4)
    assert np.abs(obs - moved).max() > 0.1
    env.close()


EVENTS = """
[events]
friction = { scale = [0.5, 1.5] }
gravity = { angle = [0.0, 0.1] }
encoder_bias = { offset = [-0.01, 0.01] }
variants = 2
mass = { bodies = "FR_hip|FL_hip", scale = [0.9, 1.1] }
center_of_mass = { bodies = "trunk", offset = [-0.01, 0.01] }
imu_fault = { share = 0.5, kinds = ["biased"], onset = [0.0, 1.0], offset = { base_ang_vel = [-0.1, 0.1] } }
"""


def test_what_events_draw_is_reflected_by_its_name(tmp_path: Path) -> None:
    path = everything(tmp_path)
    text = path.read_text().replace('{ term = "clock"', '{ term = "events" },\n  { term = "clock"')
    path.write_text(text + EVENTS)
    env = dappo_batch.make_vec(path, 1, max_damaged_limbs=0)
    obs, names = env.mirror().obs, env.obs_names
    env.close()
    images = {
        name: (names[index], sign)
        for name, index, sign in zip(names, obs.index, obs.sign, strict=True)
        if name.startswith("events ")
    }
    for name, image, sign in [
        ("friction", "friction", 1),
        ("gravity x", "gravity x", 1),
        ("gravity y", "gravity y", -1),
        ("encoder_bias FR_hip_joint", "encoder_bias FL_hip_joint", -1),
        ("encoder_bias RL_calf_joint", "encoder_bias RR_calf_joint", 1),
        ("mass FR_hip|FL_hip", "mass FR_hip|FL_hip", 1),
        ("center_of_mass trunk y", "center_of_mass trunk y", -1),
        ("center_of_mass trunk z", "center_of_mass trunk z", 1),
        ("imu_fault base_ang_vel x", "imu_fault base_ang_vel x", -1),
        ("imu_fault base_ang_vel y", "imu_fault base_ang_vel y", 1),
        ("imu_fault onset", "imu_fault onset", 1),
    ]:
        assert images[f"events {name}"] == (f"events {image}", sign)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            "lin_vel_y = [0.0, 0.0]",
            "lin_vel_y = [0.0, 0.5]",
            r"lin_vel_y is \[0, 0.5\], expected a range from -x to x",
        ),
        (
            "scale = 0.5",
            'scale = { "F.*" = 0.5, "RR.*" = 0.4, "RL.*" = 0.5 }',
            "another scale or another default",
        ),
        (
            '{ term = "touch" }',
            '{ term = "python", function = "own_term:pitch", size = 1 }',
            "the term `python` is what own_term:pitch returns",
        ),
        (
            "[terminations]",
            '[terminations]\ncontact = { bodies = ["FL_thigh"] }',
            "lists the body `FL_thigh`, but not",
        ),
        (
            "[terminations]",
            '[terminations]\npython = { functions = ["own_term:fell"] }',
            "the termination `own_term:fell` is a Python function",
        ),
        ('{ term = "qpos" }', '{ term = "qpos", skip = 8 }', "`qpos` skips 8 positions, expected at most 7"),
    ],
)
def test_a_task_that_differs_between_left_and_right_is_refused(
    old: str, new: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    functions = "def pitch(batch):\n    return batch.qpos[:, 4:5]\n"
    functions += "def fell(batch):\n    return batch.qpos[:, 2] < 0.1\n"
    (tmp_path / "own_term.py").write_text(functions)
    monkeypatch.syspath_prepend(tmp_path)
    path = everything(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    env = dappo_batch.make_vec(path, 1, max_damaged_limbs=0)
    with pytest.raises(ConfigError, match=f"the task has no mirror image: .*{reason}"):
        env.mirror()
    env.close()


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            'name="RL_calf" pos="0 0 -0.213"',
            'name="RL_calf" pos="0 0 -0.23"',
            "R[LR]_calf has no mirror image",
        ),
        (
            'mass="5.204" pos="0.0223 0',
            'mass="5.204" pos="0.0223 0.05',
            "trunk has its centre of mass to one side",
        ),
        (
            '<geom name="floor"',
            '<geom name="step" type="box" pos="1 0 0" size="0.1 1 0.05"/><geom name="floor"',
            "the world has the geom step besides floors",
        ),
        (
            '<option timestep="0.004"',
            '<option gravity="0 1 -9.81" timestep="0.004"',
            "gravity or wind point to a side",
        ),
        (
            '<joint name="FR_hip_joint"',
            '<joint axis="-1 0 0" range="-0.1 0.863" name="FR_hip_joint"',
            "F[LR]_hip_joint and F[LR]_hip_joint have different ranges",
        ),
    ],
)
def test_a_robot_that_differs_between_left_and_right_is_refused(
    old: str, new: str, reason: str, tmp_path: Path
) -> None:
    path = everything(tmp_path)
    mjcf = tmp_path / "go1.xml"
    assert old in mjcf.read_text()
    mjcf.write_text(mjcf.read_text().replace(old, new))
    with pytest.raises(ConfigError, match=f"left and right are not mirror images: .*{reason}"):
        find_symmetry(compile_class_table(path, max_damaged_limbs=0))
    report = dappo_batch.check_robot(path, max_damaged_limbs=0)
    assert report.asymmetry is not None
    assert re.search(reason, report.asymmetry)


def test_a_hinge_may_turn_the_other_way(tmp_path: Path) -> None:
    path = everything(tmp_path)
    mjcf = tmp_path / "go1.xml"
    turned = '<joint axis="-1 0 0" range="-0.863 0.863" name="FR_hip_joint"'
    mjcf.write_text(mjcf.read_text().replace('<joint name="FR_hip_joint"', turned))
    table = compile_class_table(path, max_damaged_limbs=0)
    signs = [image.sign for image in find_symmetry(table).joints]
    assert signs == [1.0, 1.0, 1.0] * 2 + [-1.0, 1.0, 1.0] * 2


SHORT = (
    "--set",
    "env.num_envs=8",
    "horizon=8",
    "evaluation.episodes=1",
    "ppo.hidden=[9]",
    "ppo.schedule=constant",
)


def symmetry_of(run: Path) -> object:
    return tomllib.loads((run / "config.toml").read_text())["ppo"]["symmetry"]


def is_symmetric(run: Path, robot: str) -> bool:
    """Return whether the policy of a run takes reflected actions for reflected observations."""
    policy = dappo_batch.Policy.load(run)
    env = dappo_batch.make_vec(robot, 32, damage="uniform", seed=1, observe_damage=policy.observes_damage)
    obs, _ = env.reset()
    for _ in range(5):
        obs, *_ = env.step(env.action_space.sample())
    mirror = env.mirror()
    env.close()
    images = policy.act(mirror.obs(obs))
    assert np.abs(images).max() > 1e-3
    return bool(np.allclose(images, mirror.actions(policy.act(obs)), atol=1e-4))


def test_the_preset_batch_finds_the_symmetry_and_a_resumed_run_keeps_it(tmp_path: Path) -> None:
    run, other = tmp_path / "run", tmp_path / "other"
    command = ("train", "--robot", "ant", *SHORT)
    cli("train", "--steps", "320", "--run", run, *command[1:])
    assert symmetry_of(run) is True
    assert is_symmetric(run, "ant")
    cli("train", "--steps", "640", "--run", other, *command[1:])
    cli("train", "--resume", run, "--steps", "640")
    assert is_symmetric(run, "ant")
    lines = [(folder / "metrics.jsonl").read_text().splitlines()[-1] for folder in (run, other)]
    losses = [json.loads(line)["policy_loss"] for line in lines]
    assert losses[0] == losses[1]
    cli("train", "--resume", run, "--steps", "960", "--set", "ppo.symmetry=false")
    _, err = cli("train", "--resume", run, "--steps", "1280", "--set", "ppo.symmetry=true", code=1)
    assert "`ppo.symmetry` cannot change in a run, from false to true" in err


def test_ordinary_networks_are_not_their_own_mirror_images(tmp_path: Path) -> None:
    cli("train", "--robot", "ant", "--steps", "320", "--run", tmp_path / "run", *SHORT, "ppo.symmetry=false")
    assert symmetry_of(tmp_path / "run") is False
    assert not is_symmetric(tmp_path / "run", "ant")


def test_a_policy_without_the_code_of_a_damage_on_one_side_is_not_symmetric(tmp_path: Path) -> None:
    one_side = ("--unaware", *SHORT, 'curriculum=[{name="a",mix="missing_toe@1"}]')
    run = tmp_path / "run"
    _, err = cli("train", "--robot", "ant", "--steps", "64", "--run", run, *one_side)
    assert (
        "without symmetry: `curriculum[0].mix` is `missing_toe@1`, which is not its own mirror image" in err
    )
    assert symmetry_of(run) is False
    _, err = cli("train", "--robot", "ant", "--steps", "64", *one_side, "ppo.symmetry=true", code=1)
    assert "`ppo.symmetry` cannot be true: `curriculum[0].mix`" in err
    cli("train", "--robot", "ant", "--steps", "64", "--run", tmp_path / "both", "--unaware", *SHORT)
    assert symmetry_of(tmp_path / "both") is True
