"""Compiled robots shared by all tests, and an exact comparison of results of environments."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable

from . import processes

TOGETHER = (
    r"^tests/(kernels|gpu)/|/test_warp_",  # two processes that need a kernel at once both compile it
    r"/test_(controller|export|without_twins)\.py$",  # the fixture `parts`
)
"""Patterns of test files that run in one process."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:  # noqa: ANN401
    """Run tests with the same expensive fixtures in one process."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class ByCost(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file: str = super()._split_scope(nodeid)
            return next((pattern for pattern in TOGETHER if re.search(pattern, file)), file)

    return ByCost(config, log)


@pytest.fixture(autouse=True, scope="session")
def _warp_on_one_device() -> Iterator[None]:
    """If Warp is imported, select its device and reduce its log.

    It is the CPU, which runs what a GPU would, unless ``DAPPO_WARP_DEVICE`` names another one, as ``cuda:0``.
    """
    if "warp" not in sys.modules:
        yield
        return
    wp = sys.modules["warp"]
    wp.config.log_level = wp.LOG_WARNING
    with wp.ScopedDevice(os.environ.get("DAPPO_WARP_DEVICE", "cpu")):
        yield


@pytest.fixture(autouse=True, scope="session")
def _ctrl_c_reaches_processes() -> None:
    """Restore the handler of Ctrl-C, which is ignored in background jobs of a shell, for child processes."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _no_process_outlives_its_test() -> Iterator[None]:
    """End the processes that a failed test has started."""
    yield
    processes.end_all()


@pytest.fixture(scope="session")
def ant_table() -> ClassTable:
    """Compile all 33 classes of the Ant."""
    return dappo_batch.compile_class_table("ant")


@pytest.fixture(scope="session")
def hexapod_table() -> ClassTable:
    """Compile all 73 classes of the Hexapod."""
    return dappo_batch.compile_class_table("hexapod")


@pytest.fixture(params=["ant", "hexapod"])
def table(request: pytest.FixtureRequest) -> ClassTable:
    """Run the test once with each built-in robot."""
    compiled: ClassTable = request.getfixturevalue(f"{request.param}_table")
    return compiled


@pytest.fixture(scope="session")
def nervous_tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ClassTable]:
    """Compile both robots with a narrow range of heights, so that many episodes terminate."""
    folder = tmp_path_factory.mktemp("robots") / "nervous"
    shutil.copytree(Path(dappo_batch.load_robot("ant").path).parent, folder)
    tables = {}
    for name, height, noise in (("ant", "[0.5, 0.85]", "0.1"), ("hexapod", "[0.185, 0.215]", "0.01")):
        robot = folder / f"{name}.toml"
        text = robot.read_text()
        # Episodes begin within the allowed height.
        for key, value in (("height", height), ("qpos_noise", noise)):
            text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
            assert count == 1
        robot.write_text(text)
        tables[name] = dappo_batch.compile_class_table(robot)
    return tables


@pytest.fixture(scope="session")
def assert_identical() -> Callable[..., None]:
    """Return the exact comparison."""
    return _assert_identical


def _assert_identical(left: Any, right: Any, where: str = "") -> None:  # noqa: ANN401
    """Check that nested tuples, dicts and arrays are bit-identical, including types and shapes."""
    if isinstance(left, dict):
        assert isinstance(right, dict), where
        assert sorted(left) == sorted(right), where
        for key in left:
            _assert_identical(left[key], right[key], f"{where}[{key!r}]")
    elif isinstance(left, tuple):
        assert len(left) == len(right), where
        for index, (one, other) in enumerate(zip(left, right, strict=True)):
            _assert_identical(one, other, f"{where}[{index}]")
    elif isinstance(left, np.ndarray):
        assert isinstance(right, np.ndarray), where
        assert (left.dtype, left.shape) == (right.dtype, right.shape), where
        if left.dtype == object:
            for index, (one, other) in enumerate(zip(left, right, strict=True)):
                _assert_identical(one, other, f"{where}[{index}]")
        else:
            np.testing.assert_array_equal(left, right, err_msg=where)
    else:
        assert type(left) is type(right), where
        assert left == right, where
