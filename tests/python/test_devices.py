"""Devices: which one a wish means, and that one which cannot be used is an error that says what to do."""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError, devices
from dappo_batch._core import gpu_device, run_cli

from .command_line import ITERATION, TINY


def fake_warp(driver: tuple[int, int] | None, gpus: int) -> SimpleNamespace:
    """Return a Warp on a machine with this driver and so many GPUs."""
    return SimpleNamespace(
        __version__="1.19.0",
        get_cuda_driver_version=lambda: driver,
        get_cuda_toolkit_version=lambda: (13, 1),
        is_cuda_available=lambda: gpus > 0,
    )


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Any:  # noqa: ANN401
    """Pretend to be on another machine."""

    def pretend(
        *, extra: bool = True, has_driver: bool = True, driver: tuple[int, int] = (13, 0), gpus: int = 1
    ) -> None:
        found = importlib.util.find_spec("numpy") if extra else None
        monkeypatch.setattr(devices.importlib.util, "find_spec", lambda _: found)
        monkeypatch.setattr(devices, "_has_driver", lambda: has_driver)
        monkeypatch.setattr(devices, "load_warp", lambda: fake_warp(driver, gpus))

    return pretend


# What the machine is like, and what the message must say.
UNUSABLE: dict[str, tuple[dict[str, Any], str]] = {
    "no extra": ({"extra": False}, r"extra `gpu` is not installed .*pip install dappo-batch\[gpu\]"),
    "no driver": ({"has_driver": False}, "there is no NVIDIA driver"),
    "old driver": ({"driver": (12, 9)}, r"driver is too old: it is one for CUDA 12\.9.* CUDA 13\.0 \(R580"),
    "no GPU": ({"gpus": 0}, "finds no GPU"),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_a_gpu_that_cannot_be_used_is_rejected_with_the_reason_and_auto_takes_the_cpu(
    case: str,
    machine: Any,  # noqa: ANN401
) -> None:
    options, message = UNUSABLE[case]
    machine(**options)
    with pytest.raises(ConfigError, match=message):
        devices.resolve("cuda")
    assert devices.resolve("auto") == "cpu"


@pytest.mark.parametrize("driver", [(13, 0), (13, 4), (14, 0)])
def test_auto_takes_a_gpu_that_can_be_used(driver: tuple[int, int], machine: Any) -> None:  # noqa: ANN401
    machine(driver=driver)
    assert devices.resolve("auto") == "cuda"
    assert devices.resolve("cuda") == "cuda"


def test_the_kernels_on_the_cpu_need_the_extra_but_no_driver(machine: Any) -> None:  # noqa: ANN401
    machine(has_driver=False)
    assert devices.resolve("warp-cpu") == "warp-cpu"
    machine(extra=False)
    with pytest.raises(ConfigError, match="the device warp-cpu cannot be used: the extra `gpu`"):
        devices.resolve("warp-cpu")


def test_a_training_on_a_device_that_is_not_there_fails_and_leaves_nothing_behind(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    machine: Any,  # noqa: ANN401
) -> None:
    machine(extra=False)
    assert run_cli(["train", "--device", "cuda", "--run", str(tmp_path / "run"), *TINY]) == 1
    assert "error: the device cuda cannot be used: the extra `gpu`" in capfd.readouterr().err
    settings = ["--set", "evaluation.device=warp-cpu"]
    assert run_cli(["train", "--run", str(tmp_path / "run"), *TINY, *settings]) == 1
    assert "the device warp-cpu cannot be used" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert run_cli(["train", "--device", "tpu"]) == 2
    with pytest.raises(ConfigError, match="the device cuda cannot be used"):
        dappo_batch.make_vec("ant", device="cuda")


@pytest.mark.parametrize("flags", [("--backend", "lanes"), ("--precision", "f64")])
def test_who_asks_for_what_only_the_cpu_has_gets_the_cpu(
    flags: tuple[str, ...],
    tmp_path: Path,
    machine: Any,  # noqa: ANN401
) -> None:
    machine()
    run = tmp_path / "run"
    assert run_cli(["train", *flags, "--run", str(run), "--steps", str(ITERATION), *TINY]) == 0
    assert tomllib.loads((run / "config.toml").read_text())["env"]["device"] == "cpu"


def test_unknown_devices_are_rejected_with_the_known_ones(ant_table: ClassTable) -> None:
    expected = "device must be one of 'auto', 'cpu', 'gpu', 'cuda', 'warp-cpu', got 'tpu'"
    with pytest.raises(ConfigError, match=expected):
        dappo_batch.make_vec(ant_table, device="tpu")


def test_the_device_gpu_is_refused_with_the_reason_where_it_cannot_be_used(
    ant_table: ClassTable,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.delenv("DAPPO_GPU_SOFTWARE", raising=False)
    try:
        pytest.skip(f"this machine has {gpu_device()}")
    except ConfigError as error:
        reason = str(error)
    assert reason.startswith("the device gpu cannot be used: ")
    with pytest.raises(ConfigError, match="the device gpu cannot be used: "):
        dappo_batch.make_vec(ant_table, device="gpu")
    assert run_cli(["train", "--device", "gpu", "--run", str(tmp_path / "run"), *TINY]) == 1
    assert reason in capfd.readouterr().err


class PhysicsOverflowError(RuntimeError):
    """Named as that of the kernels, which cannot be imported without the extra."""

    def __init__(self, **sizes: int) -> None:
        super().__init__("no room")
        self.sizes = sizes


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            RuntimeError("Failed to allocate 99 bytes on device 'cuda:0'"),
            "the device has too little memory: Failed to allocate 99 bytes on device 'cuda:0'; use fewer",
        ),
        (
            PhysicsOverflowError(njmax=40),
            "no room; raise the sizes, for example --njmax 80, or njmax=80 in Python",
        ),
        (
            PhysicsOverflowError(njmax=40, nconmax=9),
            "no room; raise the sizes, for example --njmax 80 --nconmax 18,"
            " or njmax=80, nconmax=18 in Python",
        ),
        (PhysicsOverflowError(), "no room; --device cpu simulates every robot"),
        (FloatingPointError("9 numbers"), "the training has diverged: 9 numbers; try a smaller"),
        (NotImplementedError("no wheels"), "the backend warp failed: no wheels; --device cpu"),
        (RuntimeError("CUDA error 700"), "RuntimeError: CUDA error 700"),
        (ConfigError("known error"), "known error"),
    ],
)
def test_errors_of_the_device_contain_a_remedy(error: Exception, message: str) -> None:
    assert devices.explain(error).startswith(message)


@pytest.mark.parametrize("learner", [("--learner", "gpu"), ("--set", "ppo.device=wgpu")])
def test_a_learner_that_this_build_lacks_is_rejected_before_there_is_a_run_folder(
    learner: tuple[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Runs of earlier versions name it wgpu."""
    run = tmp_path / "run"
    assert run_cli(["train", "--run", str(run), *learner]) == 1
    assert "build with the feature `gpu`" in capfd.readouterr().err
    assert not run.exists()
