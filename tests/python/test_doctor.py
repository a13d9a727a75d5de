"""The doctor names what is there, what is missing and what is broken."""

from __future__ import annotations

import ctypes
import importlib.metadata
import json
import sys
from pathlib import Path

import mujoco
import pytest

from dappo_batch import doctor
from dappo_batch.model import mujoco_library


def findings(capsys: pytest.CaptureFixture[str]) -> tuple[int, dict]:
    """Run the command and return its exit code and what it printed as JSON."""
    capsys.readouterr()
    code = doctor.command(json=True)
    return code, json.loads(capsys.readouterr().out)


@pytest.fixture
def without_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes seconds and is not the question."""
    monkeypatch.setattr(doctor, "_RENDERERS", {})


@pytest.mark.slow
def test_the_doctor_finds_the_core_of_this_installation_working(capsys: pytest.CaptureFixture[str]) -> None:
    code, found = findings(capsys)
    assert code == 0
    assert found["ok"] is True
    assert set(found) == {"ok", "python", "platform", "cpu", "core", "devices", "rendering", "extras"}
    assert found["python"]["executable"] == sys.executable
    assert found["cpu"]["cores"] >= 1
    assert found["core"]["mujoco"]["detail"] == mujoco.__version__
    assert mujoco.mj_versionString() in found["core"]["mujoco library"]["detail"]
    assert found["core"]["dappo-batch"]["detail"] == importlib.metadata.version("dappo-batch")
    assert "33 damage classes" in found["core"]["self test"]["detail"]
    assert {"egl", "osmesa", "films"} == set(found["rendering"])
    assert set(found["devices"]) == {"gpu", "gpu engine", "warp"}


@pytest.mark.usefixtures("without_rendering")
def test_a_library_that_cannot_be_loaded_fails_the_library_and_the_self_test(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    broken = tmp_path / "libmujoco.so"
    broken.write_text("not a library")
    monkeypatch.setattr(mujoco_library, "library_path", lambda: broken)
    code, found = findings(capsys)
    assert code == 1
    assert found["ok"] is False
    for name in ("mujoco library", "self test"):
        assert found["core"][name]["status"] == "failed", name
        assert str(broken) in found["core"][name]["detail"]
        assert "pip install" in found["core"][name]["cure"]
    assert found["core"]["numpy"]["status"] == "ok"


@pytest.mark.usefixtures("without_rendering")
def test_a_missing_extra_comes_with_its_command_and_is_no_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    extra = doctor._Extra("no-such-package", "nothing", "pip install no-such-package")
    present = doctor._Extra("numpy", "arrays", "pip install numpy")
    monkeypatch.setattr(doctor, "_EXTRAS", (extra, present))
    code, found = findings(capsys)
    assert code == 0
    assert found["extras"]["no-such-package"]["status"] == "missing"
    assert found["extras"]["no-such-package"]["cure"] == "pip install no-such-package"
    assert found["extras"]["numpy"]["status"] == "ok"
    doctor.command(json=False)
    assert "pip install no-such-package" in capsys.readouterr().out


def test_every_extra_names_the_package_that_its_command_installs() -> None:
    for extra in doctor._EXTRAS:
        assert extra.install == f"pip install {extra.package}"


def test_a_renderer_that_does_not_exist_is_missing_with_mujocos_own_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "_RENDERERS", {"nonsense": "apt-get install nonsense"})
    check = doctor._renderer("nonsense")
    assert check.status == "missing"
    assert "nonsense" in check.detail
    assert check.cure == "apt-get install nonsense"


def test_a_renderer_that_hangs_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_RENDER", "import time; time.sleep(60)")
    monkeypatch.setattr(doctor, "_RENDER_TIMEOUT", 0.2)
    check = doctor._renderer("egl")
    assert check.status == "missing"
    assert "timed out" in check.detail


def test_a_black_picture_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_RENDER", "print('brightest pixel', 0)")
    assert doctor._renderer("egl").status == "missing"


def test_films_need_their_packages_and_one_opengl_that_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.opengl, "choices", lambda: ["egl", "osmesa"])
    monkeypatch.setattr(doctor.film, "lacking", list)
    assert doctor._films(["osmesa"]).status == "ok"
    assert "osmesa" in doctor._films(["osmesa"]).detail
    without = doctor._films([])
    assert without.status == "missing"
    assert all(cure in without.cure for cure in doctor._RENDERERS.values())
    monkeypatch.setattr(doctor.film, "lacking", lambda: ["av"])
    unpacked = doctor._films(["egl"])
    assert (unpacked.status, unpacked.detail) == ("missing", "not installed: av")
    assert unpacked.cure == "pip install 'dappo-batch[video]'"


def test_without_driver_and_tool_the_gpu_is_missing_and_nothing_crashes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    monkeypatch.setattr(ctypes.util, "find_library", lambda _: "libno_such_driver.so")
    assert doctor._gpu().status == "missing"


def test_the_extra_for_gpus_is_missing_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.devices.importlib.util, "find_spec", lambda _: None)
    check = doctor._warp()
    assert (check.status, check.cure) == ("missing", "pip install dappo-batch[gpu]")
    assert "warp and mujoco_warp missing" in check.detail
    found = doctor.diagnose(rendering=False) | {"devices": {check.name: check.as_dict()}}
    assert doctor._text(found).count("dappo-batch[gpu]") == 1


def test_warp_is_reported_with_its_devices_and_why_no_gpu_can_be_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    warp = pytest.importorskip("warp")
    monkeypatch.setattr(doctor.devices, "_has_driver", lambda: False)
    check = doctor._warp()
    assert check.status == "missing"
    assert check.detail.startswith(f"Warp {warp.__version__}, built with CUDA ")
    assert "cpu" in check.detail
    assert "there is no NVIDIA driver" in check.detail


def test_a_gpu_is_reported_as_its_tool_names_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tool = tmp_path / "nvidia-smi"
    tool.write_text("#!/bin/sh\necho 'Some GPU, 580.1, 1024 MiB'\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    check = doctor._gpu()
    assert check.status == "ok"
    assert check.detail == "Some GPU, 580.1, 1024 MiB"
