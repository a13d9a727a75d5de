"""`dappo-batch view --browser`: a page with a walk, which needs no screen."""

from __future__ import annotations

import re
import signal
import socket
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viser import ViserServer

import dappo_batch
from dappo_batch import MissingExtraError, render
from dappo_batch.render import RenderError, Walk
from dappo_batch.render.browser import Player
from dappo_batch.render.camera import view
from dappo_batch.render.scene import RED

from .command_line import TINY, start
from .command_line import dappo_batch as run

ONSET, STATES = 2, 5


@pytest.fixture
def walk() -> Walk:
    """Let an Ant slide along, a limb of which breaks on the way."""
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    qpos = np.tile(table.models[0].qpos0, (STATES, 1))
    qpos[:, 0] = np.arange(STATES)
    return Walk(table, qpos, "missing_toe@0", ONSET)


@pytest.fixture
def server() -> Iterator[ViserServer]:
    server = ViserServer(host="localhost", port=0)
    yield server
    server.stop()


def test_the_robot_on_the_page_moves_and_breaks(
    walk: Walk, server: ViserServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: dict[str, Any] = {}
    add = server.scene.add_batched_meshes_trimesh

    def noted(name: str, mesh: Any, **options: Any) -> Any:  # noqa: ANN401
        handle = add(name, mesh, **options)
        sent[name] = (mesh, handle)
        return handle

    monkeypatch.setattr(server.scene, "add_batched_meshes_trimesh", noted)
    player = Player(walk, server)

    def red() -> set[str]:
        colour = np.array(RED) * 255
        return {
            name.split("/")[2]
            for name, (mesh, _) in sent.items()
            if np.allclose(mesh.visual.vertex_colors, colour, atol=1)
        }

    def length_of_the_toe() -> float:
        (mesh,) = [mesh for name, (mesh, _) in sent.items() if "/front_left_toe/" in name]
        return float(mesh.extents.max())

    assert red() == set()
    assert "healthy" in player.caption.content
    whole = length_of_the_toe()

    sent.clear()
    player.show(ONSET)
    assert "**damage: missing toe (front left)**" in player.caption.content
    assert red() == {"front_left_limb", "front_left_toe"}
    assert length_of_the_toe() < 0.5 * whole

    # The world has moved so that the visitor looks at the robot.
    positions = np.vstack([handle.batched_positions for _, handle in sent.values()])
    lookat = view(walk.table, walk.states, walk.step_seconds, damage_class=1).lookat[ONSET]
    torso = walk.states[ONSET][:3] - lookat
    assert np.isclose(positions, torso, atol=1e-6).all(axis=1).any()


def test_a_visitor_who_moves_the_slider_sees_that_step(walk: Walk, server: ViserServer) -> None:
    player = Player(walk, server)
    assert player.step.max == STATES - 1
    player.step.value = 3

    class Seen(Exception):
        pass

    def show(step: int) -> None:
        raise Seen(step)

    player.show = show  # type: ignore[method-assign]
    with pytest.raises(Seen, match="3"):
        player.play()


def test_a_page_is_served_until_ctrl_c(tmp_path: Path) -> None:
    run("train", *TINY, "--steps", "64", "--run", tmp_path / "ant")
    process = start("view", tmp_path / "ant", "--steps", "3", "--browser", "--port", "0")
    assert process.stderr is not None
    address = ""
    for line in process.stderr:
        if found := re.search(r"(http://localhost:\d+) shows the episode until Ctrl-C", line):
            address = found[1]
            break
    with urllib.request.urlopen(address, timeout=60) as answer:
        assert answer.status == 200
        assert answer.read(15).lower() == b"<!doctype html>"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130


def test_a_page_that_cannot_be_served_is_an_error_before_the_episode(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(RenderError, match=r"no page can be served at 192\.0\.2\.1:8080"):
        render.check_browser("192.0.2.1")
    with socket.create_server(("localhost", 0)) as other:
        render.check_browser("localhost", other.getsockname()[1])
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"mjviser is not installed.*dappo-batch\[viewer\]"):
        render.check_browser()
