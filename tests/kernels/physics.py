"""Random results of the physics, as NumPy and as Warp arrays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dappo_batch.kernels.task import Task

Array = NDArray[np.float32]


class Physics(NamedTuple):
    """State of N worlds after a step."""

    qpos: Array  # [N, nq]
    qvel: Array  # [N, nv]
    qacc: Array  # [N, nv]
    ctrl: Array  # [N, nu]
    cfrc_ext: Array  # [N, nbody, 6]
    sensordata: Array  # [N, ns]
    xpos: Array  # [N, nbody, 3]

    @classmethod
    def random(cls, task: Task, count: int, rng: np.random.Generator) -> Physics:
        """Draw numbers of every sign and size; half of the bodies and sensors are not in contact."""
        model = task.models[0]

        def normal(*shape: int) -> Array:
            return (3.0 * rng.normal(size=(count, *shape))).astype(np.float32)

        touched = rng.random((count, model.nbody, 1)) < 0.3
        pressed = rng.random((count, model.nsensordata)) < 0.5
        return cls(
            qpos=normal(model.nq),
            qvel=normal(model.nv),
            qacc=normal(model.nv),
            ctrl=normal(model.nu),
            cfrc_ext=np.where(touched, normal(model.nbody, 6), np.float32(0.0)),
            sensordata=np.where(pressed, np.abs(normal(model.nsensordata)), np.float32(0.0)),
            xpos=normal(model.nbody, 3),
        )

    def on_device(self) -> SimpleNamespace:
        """Return the arrays as those of ``mjw.Data``."""
        kinds = {"cfrc_ext": wp.spatial_vector, "xpos": wp.vec3}
        arrays = {
            name: wp.array(value, dtype=kinds.get(name, wp.float32)) for name, value in self._asdict().items()
        }
        return SimpleNamespace(nworld=len(self.qpos), **arrays)
