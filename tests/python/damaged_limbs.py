"""A robot with a limb of two segments, and comparisons of compiled models."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dappo_batch.robots import Limb

# A limb of two segments. What is put into {end} hangs on the lower one, 0.4 m long.
LIMB = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="torso" pos="0 0 1"><freejoint/><geom size="0.1"/>
  <site name="hub"/>
  <body name="limb"><joint name="hip" range="-1 1"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
    <body name="shank" pos="0.3 0 0"><joint name="knee" axis="0 1 0" range="-1 1" {joint}/>
      <geom name="toe" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03"/>
      <site name="ankle" pos="0 0 -0.4"/>{end}
    </body></body>
  <body name="other"><joint name="elbow" range="-1 1"/><geom size="0.05"/><site name="hand"/></body>
  </body></worldbody>{extra}</mujoco>"""
ONE = Limb(name="one", body="limb", joints=("hip", "knee"), toe_geom="toe")


def limb(end: str = "", extra: str = "", joint: str = "") -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(LIMB.format(end=end, extra=extra, joint=joint))


def numeric_differences(a: mujoco.MjModel, b: mujoco.MjModel) -> set[str]:
    """Return the names of the arrays that differ."""
    names = [name for name in dir(a) if isinstance(getattr(a, name), np.ndarray)]
    return {name for name in names if not np.array_equal(getattr(a, name), getattr(b, name))}


def assert_equal_models(model: mujoco.MjModel, expected: mujoco.MjModel) -> None:
    """Compare all arrays up to rounding, with quaternions up to their sign."""
    for name in numeric_differences(model, expected):
        got, want = np.asarray(getattr(model, name)), np.asarray(getattr(expected, name))
        if name.endswith("quat"):
            got, want = np.abs(got), np.abs(want)
        assert got == pytest.approx(want, rel=1e-9, abs=1e-12), name
