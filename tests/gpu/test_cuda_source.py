"""The kernels of the GPU engine, compiled for the H100 without one."""

from __future__ import annotations

from pathlib import Path

import pytest

from dappo_batch.model import Physics, compile_class_table

from . import cuda_source

ARCH = "90a"
KERNELS: tuple[tuple[str, Physics | None], ...] = (
    ("ant", "rk4"),
    ("ant", "euler"),
    ("hexapod", None),
    ("go1", None),
)
"""Robots and integrators; ``None`` is the robot's own, implicitfast of these."""
BUILD_SECONDS = 600.0


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "physics"), KERNELS)
def test_cuda_compiles_the_kernel(
    robot: str, physics: Physics | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        toolkit = cuda_source.find_toolkit()
        source = cuda_source.emit(compile_class_table(robot, physics=physics), tmp_path, BUILD_SECONDS)
    except cuda_source.Unavailable as error:
        pytest.skip(str(error))
    usage = cuda_source.compile_kernel(source, ARCH, toolkit, tmp_path)
    with capsys.disabled():
        print(f"\n{robot} {physics or 'implicitfast'}: {usage}")
    assert usage.instructions > 0


@pytest.mark.slow
def test_cuda_compiles_all_other_kernels_of_a_rollout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        toolkit = cuda_source.find_toolkit()
        sources = cuda_source.emit_rollout(tmp_path, BUILD_SECONDS)
    except cuda_source.Unavailable as error:
        pytest.skip(str(error))
    assert len(sources) == 10
    for name, source in sources.items():
        usage = cuda_source.compile_kernel(source, ARCH, toolkit, tmp_path)
        with capsys.disabled():
            print(f"\n{name}: {usage}")
        assert usage.instructions > 0
