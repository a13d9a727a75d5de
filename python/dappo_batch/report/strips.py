"""Film strips: a few moments of an episode of each policy, drawn by `dappo_batch.render`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dappo_batch._core import DappoError
from dappo_batch.envs import make_vec
from dappo_batch.policy import Policy
from dappo_batch.render import RenderError, Walk, frames
from dappo_batch.report.learners import Learner
from dappo_batch.report.page import Frame, Note, Strip, Text
from dappo_batch.report.robots import class_table
from dappo_batch.report.words import rounded
from dappo_batch.runs import Run

__all__ = ["strips"]

_STEPS = 200
"""Env steps of an episode that is drawn: 10 s of the Ant."""
_FRAMES = 6
_MOST = 4
"""Maximum number of learners for each robot: each takes about two seconds."""
_SIZE = (320, 240)


@dataclass(frozen=True)
class _Episode:
    """An episode, its forward velocities, m/s, its first command, and whether the robot fell.

    The command is forwards and to the left, m/s, and the rate of turn, rad/s; None without commands.
    """

    walk: Walk
    velocities: list[float]
    command: NDArray[np.float64] | None
    fell: bool


def strips(learners: Sequence[Learner]) -> list[Text | Strip | Note]:
    """Draw an episode of each learner's first seed with one damage class, the same for all.

    If an episode cannot be drawn, a note contains the reason.

    Parameters
    ----------
    learners : sequence of Learner
        Of one robot, with the same damage classes and the same score.
    """
    score = learners[0].score
    damage = _typical(learners)
    drawn: list[Strip] = []
    notes: list[Note] = []
    for learner in learners[:_MOST]:
        try:
            drawn.append(_strip(learner, damage))
        except DappoError as error:
            notes.append(Note(f"There is no film strip of {learner.name}: {error}"))
            if isinstance(error, RenderError):
                break  # the next one would fail, too
    if len(learners) > _MOST:
        notes.append(Note(f"Film strips show the first {_MOST} of {len(learners)} learners."))
    shown, same = ("time, and distance along x", "Damage class and start state")
    if not score.is_distance:
        shown, same = "time", "Damage class, start state and commands"
    about = Text(
        f"The first {_STEPS} env steps of an episode with {damage} from the start on: {shown}. {same} "
        f"are the same for all learners; the class has the median {score.name} of all damage classes, mean "
        "over the learners. The damaged limbs are red."
    )
    return [*([about] if drawn else []), *drawn, *notes]


def _typical(learners: Sequence[Learner]) -> str:
    """Return the damage class whose score, mean over learners, is the median of all damage."""
    scores = [learner.scores() for learner in learners]
    means = np.mean([each.values.mean(axis=0) for each in scores], axis=0)
    damaged = [index for index, name in enumerate(scores[0].names) if name != "healthy"] or [0]
    order = sorted(damaged, key=lambda index: float(means[index]))
    return scores[0].names[order[(len(order) - 1) // 2]]


def _strip(learner: Learner, damage: str) -> Strip:
    run = learner.runs[0]
    episode = _episode(run, damage)
    walk = episode.walk
    last = len(walk.states) - 1
    states = np.linspace(0, last, _FRAMES).round().astype(int).tolist()
    distances = np.concatenate([[0.0], np.cumsum(episode.velocities) * walk.step_seconds])
    # A distance along x says nothing where robots are to walk in all directions.
    has_distance = learner.score.is_distance
    pictures = [
        Frame(
            _jpeg(picture),
            f"{state * walk.step_seconds:.1f} s"
            + (f", {rounded(distances[state])} m" if has_distance else ""),
        )
        for state, picture in zip(states, frames(walk, states, size=_SIZE, captioned=False), strict=True)
    ]
    caption = f"Seed {run.seed}: " + (f"{rounded(distances[-1])} m in " if has_distance else "")
    caption += f"{last * walk.step_seconds:.1f} s" + (", then the robot fell." if episode.fell else ".")
    if episode.command is not None:
        caption += f" First command: {_commanded(episode.command)}."
    return Strip(learner.name, caption, pictures)


def _commanded(command: NDArray[np.float64]) -> str:
    """Return a command as text: forwards and to the left, m/s, and rate of turn, rad/s."""
    forwards, left, turn = (rounded(float(value), 2) for value in command)
    return f"{forwards} m/s forwards, {left} m/s to the left, turning at {turn} rad/s"


def _episode(run: Run, damage: str) -> _Episode:
    """Simulate an episode with a run's own robot, from a start state that is the same for all runs."""
    policy = Policy.load(run.path, threads=1, robot_changed="use-run")
    table = class_table(run)
    history = run.config["env"].get("history")
    robot = make_vec(table, damage=damage, observe_damage=False, history=history, threads=1)
    obs, infos = robot.reset(seed=0)
    command = np.array(infos["command"][0]) if "command" in infos else None
    positions, velocities = [_position(robot.get_state()[0])], []
    fell, state = False, policy.initial_state(1)
    code = damage if policy.observes_damage else None
    for _ in range(_STEPS):
        actions, state = policy.step(obs, state, damage_class=code)
        obs, _, terminated, truncated, infos = robot.step(actions)
        positions.append(_position(robot.get_state()[0]))
        velocities.append(float(infos["forward_velocity"][0]))
        fell = bool(terminated[0])
        if fell or truncated[0]:
            break
    return _Episode(Walk(table, np.array(positions), damage), velocities, command, fell)


def _position(qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a copy of the position of the only robot; later steps may reuse the array."""
    return np.array(qpos[0])


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=85)
    return file.getvalue()
