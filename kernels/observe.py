"""Observations: every entry has a source, such as an index into ``qpos``; one kernel serves all robots.

The terms are those of the robot TOML, as in ``rust/dappo-sim/src/terms/observation.rs``; the damage code
follows them where it is observed.
"""

from __future__ import annotations

import mujoco_warp as mjw
import numpy as np
import warp as wp

from .task import Task, Term

__all__ = ["Observer"]

wp.set_module_options({"enable_backward": False})

# Sources of entries.
QPOS = wp.constant(0)
QVEL = wp.constant(1)
CFRC_EXT = wp.constant(2)
TOUCH = wp.constant(3)
CODE = wp.constant(4)


@wp.kernel
def observe(
    # Model:
    source_in: wp.array[wp.int32],
    index_in: wp.array[wp.int32],
    clip_in: wp.array[wp.float32],
    touch_address_in: wp.array[wp.int32],
    disabled_touch_in: wp.array2d[wp.bool],
    code_in: wp.array2d[wp.float32],
    # In:
    mask_in: wp.array[wp.bool],
    class_in: wp.array[wp.int32],
    qpos_in: wp.array2d[wp.float32],
    qvel_in: wp.array2d[wp.float32],
    cfrc_ext_in: wp.array2d[wp.spatial_vector],
    sensordata_in: wp.array2d[wp.float32],
    # Out:
    obs_out: wp.array2d[wp.float32],
) -> None:
    worldid, entry = wp.tid()
    if not mask_in[worldid]:
        return
    source = source_in[entry]
    index = index_in[entry]
    value = wp.float32(0.0)
    if source == QPOS:
        value = qpos_in[worldid, index]
    elif source == QVEL:
        value = qvel_in[worldid, index]
    elif source == CFRC_EXT:
        value = wp.clamp(cfrc_ext_in[worldid, index // 6][index % 6], -clip_in[entry], clip_in[entry])
    elif source == TOUCH:
        pressed = sensordata_in[worldid, touch_address_in[index]] > 0.0
        if pressed and not disabled_touch_in[class_in[worldid], index]:
            value = wp.float32(1.0)
    elif source == CODE:
        value = code_in[class_in[worldid], index]
    obs_out[worldid, entry] = value


class Observer:
    """The observation of one robot.

    Parameters
    ----------
    task : Task
        The robot.
    observe_damage : bool
        Whether the damage code is appended to the robot's observation.

    Attributes
    ----------
    obs_dim : int
        Length of an observation, including the damage code.
    code_length : int
        Length of the damage code in the observation; 0 if damage is not observed.
    needs_forces : bool
        Whether the first observation of an episode contains forces of its initial state.

    Raises
    ------
    ValueError
        If the kernels do not implement an observation term.
    """

    def __init__(self, task: Task, observe_damage: bool) -> None:
        entries = [entry for term in task.observation for entry in _entries(term, task)]
        self.code_length = task.codes.shape[1] if observe_damage else 0
        entries += [(int(CODE), index, 0.0) for index in range(self.code_length)]
        self.obs_dim = len(entries)
        self.needs_forces = any(source == int(TOUCH) for source, _, _ in entries)
        sources, indices, clips = zip(*entries, strict=True)
        self._tables = [
            wp.array(sources, dtype=wp.int32),
            wp.array(indices, dtype=wp.int32),
            wp.array(clips, dtype=wp.float32),
            wp.array(np.array(task.touch_addresses, dtype=np.int32), dtype=wp.int32),
            wp.array(task.disabled_touch, dtype=wp.bool),
            wp.array(task.codes, dtype=wp.float32),
        ]

    def observe(
        self,
        data: mjw.Data,
        mask: wp.array[wp.bool],
        classes: wp.array[wp.int32],
        obs: wp.array2d[wp.float32],
    ) -> None:
        """Write the observations of the selected worlds.

        Parameters
        ----------
        data : mjw.Data
            The physics.
        mask : wp.array of shape [N]
            Worlds to observe; the rows of the others are left unchanged.
        classes : wp.array of shape [N]
            Active damage class.
        obs : wp.array of shape [N, obs_dim]
            Receives the observations.
        """
        wp.launch(
            observe,
            dim=(data.nworld, self.obs_dim),
            inputs=[*self._tables, mask, classes, data.qpos, data.qvel, data.cfrc_ext, data.sensordata],
            outputs=[obs],
        )


def _entries(term: Term, task: Task) -> list[tuple[int, int, float]]:
    """Return source, index and bound of every entry of a term."""
    model = task.models[0]
    match term["term"]:
        case "qpos":
            return [(int(QPOS), index, 0.0) for index in range(term.get("skip", 0), model.nq)]
        case "qvel":
            return [(int(QVEL), index, 0.0) for index in range(model.nv)]
        case "cfrc_ext":
            return [(int(CFRC_EXT), index, float(term["clip"])) for index in range(model.nbody * 6)]
        case "touch":
            return [(int(TOUCH), limb, 0.0) for limb in range(len(task.touch_addresses))]
        case name:
            raise ValueError(f"the kernels do not implement the observation term {name!r}")
