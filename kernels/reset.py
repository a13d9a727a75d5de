"""Resets of selected worlds: the next episode, its damage class and onset, and its initial state.

The draws are the same as in Rust (``vector_env/episode.rs`` and ``backend/mod.rs`` of ``rust/dappo-sim``).
"""

from __future__ import annotations

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

from . import philox
from .episode import Episodes
from .outcome import Outcome
from .task import Task

__all__ = ["DRAW", "EpisodeDraws", "StateReset"]

wp.set_module_options({"enable_backward": False})

DRAW = -1  # in arrays of damage classes or onsets: drawn from the world's random stream

ONE = wp.constant(wp.float64(1.0))
TWO = wp.constant(wp.float64(2.0))


@wp.func
def first_above(cumulative: wp.array[wp.float64], u: wp.float64) -> int:
    """Return the index of the first sum above `u`; their number if there is none."""
    low = int(0)
    high = int(cumulative.shape[0])
    while low < high:
        middle = (low + high) // 2
        if cumulative[middle] <= u:
            low = middle + 1
        else:
            high = middle
    return low


@wp.func
def class_at(cumulative: wp.array[wp.float64], u: wp.float64) -> int:
    """Return the class at the quantile `u` of [0, 1)."""
    last = cumulative.shape[0] - 1
    found = first_above(cumulative, u)
    if found <= last:
        return found
    # Rounding left the final sum below u: return the last class of positive weight.
    return wp.lower_bound(cumulative, cumulative[last])


@wp.kernel
def begin_episode(
    # In:
    mask_in: wp.array[wp.bool],
    key_in: wp.array[wp.uint64],
    cumulative_in: wp.array[wp.float64],
    onset_range_in: wp.array[wp.int32],
    min_class_steps_in: wp.array[wp.int32],
    fixed_class_in: wp.array[wp.int32],
    fixed_onset_in: wp.array[wp.int32],
    number_in: wp.array[wp.uint64],
    step_in: wp.array[wp.int32],
    drawn_class_in: wp.array[wp.int32],
    class_steps_in: wp.array[wp.int32],
    # Out:
    number_out: wp.array[wp.uint64],
    step_out: wp.array[wp.int32],
    drawn_class_out: wp.array[wp.int32],
    class_steps_out: wp.array[wp.int32],
    onset_out: wp.array[wp.int32],
    class_out: wp.array[wp.int32],
) -> None:
    worldid = wp.tid()
    if not mask_in[worldid]:
        return
    key = key_in[worldid]
    number = number_in[worldid] + wp.uint64(1)
    drawn = fixed_class_in[worldid]
    class_steps = class_steps_in[worldid] + step_in[worldid]
    if drawn < 0 and class_steps > 0 and class_steps < min_class_steps_in[0]:
        drawn = drawn_class_in[worldid]
    else:
        class_steps = 0
    if drawn < 0:
        drawn = class_at(cumulative_in, philox.uniform(key, number, philox.DAMAGE_CLASS, 0))
    onset = fixed_onset_in[worldid]
    if onset < 0:
        span = wp.uint32(onset_range_in[1] - onset_range_in[0] + 1)
        onset = onset_range_in[0] + wp.int32(philox.below(key, number, philox.ONSET, 0, span))
    number_out[worldid] = number
    step_out[worldid] = 0
    drawn_class_out[worldid] = drawn
    class_steps_out[worldid] = class_steps
    onset_out[worldid] = onset
    class_out[worldid] = wp.where(onset == 0, drawn, 0)


@wp.kernel
def set_reference_state(
    # Model:
    qpos0: wp.array2d[wp.float32],
    sensordata0: wp.array2d[wp.float32],
    # In:
    mask_in: wp.array[wp.bool],
    class_in: wp.array[wp.int32],
    # Out:
    time_out: wp.array[wp.float32],
    qpos_out: wp.array2d[wp.float32],
    qvel_out: wp.array2d[wp.float32],
    act_out: wp.array2d[wp.float32],
    ctrl_out: wp.array2d[wp.float32],
    qacc_warmstart_out: wp.array2d[wp.float32],
    cfrc_ext_out: wp.array2d[wp.spatial_vector],
    sensordata_out: wp.array2d[wp.float32],
) -> None:
    worldid, i = wp.tid()
    if not mask_in[worldid]:
        return
    if i == 0:
        time_out[worldid] = 0.0
    if i < qpos_out.shape[1]:
        qpos_out[worldid, i] = qpos0[worldid % qpos0.shape[0], i]
    if i < qvel_out.shape[1]:
        qvel_out[worldid, i] = 0.0
        qacc_warmstart_out[worldid, i] = 0.0
    if i < act_out.shape[1]:
        act_out[worldid, i] = 0.0
    if i < ctrl_out.shape[1]:
        ctrl_out[worldid, i] = 0.0
    if i < cfrc_ext_out.shape[1]:
        cfrc_ext_out[worldid, i] = wp.spatial_vector()
    if i < sensordata_out.shape[1]:
        sensordata_out[worldid, i] = sensordata0[class_in[worldid], i]


@wp.kernel
def add_reset_noise(
    # Model:
    qpos_noise: wp.float64,
    qvel_noise: wp.float64,
    # In:
    mask_in: wp.array[wp.bool],
    key_in: wp.array[wp.uint64],
    number_in: wp.array[wp.uint64],
    qpos_in: wp.array2d[wp.float32],
    # Out:
    qpos_out: wp.array2d[wp.float32],
    qvel_out: wp.array2d[wp.float32],
) -> None:
    worldid, i = wp.tid()
    if not mask_in[worldid]:
        return
    key = key_in[worldid]
    number = number_in[worldid]
    nq = qpos_in.shape[1]
    if i < nq:
        u = philox.uniform(key, number, philox.INITIAL_STATE, i)
        noise = qpos_noise * (TWO * u - ONE)
        qpos_out[worldid, i] = wp.float32(wp.float64(qpos_in[worldid, i]) + noise)
    if i < qvel_out.shape[1]:
        # In the stream the normals follow the uniforms.
        z = philox.normal(key, number, philox.INITIAL_STATE, nq, i)
        qvel_out[worldid, i] = wp.float32(qvel_noise * z)


@wp.kernel
def store_x(
    # Model:
    main_body: int,
    # In:
    mask_in: wp.array[wp.bool],
    xpos_in: wp.array2d[wp.vec3],
    # Out:
    x_out: wp.array[wp.float32],
) -> None:
    worldid = wp.tid()
    if mask_in[worldid]:
        x_out[worldid] = xpos_in[worldid, main_body][0]


class EpisodeDraws:
    """The distributions of damage classes and onsets.

    Parameters
    ----------
    num_worlds, num_classes : int
        Number of worlds N and of damage classes D.

    Attributes
    ----------
    cumulative : wp.array of shape [D]
        Sums of the classes' probabilities; at first uniform. Assign to it to change the distribution.
    onset_range : wp.array of shape [2]
        First and last step of the onset; (0, 0): damage from the start.
    min_class_steps : wp.array of shape [1]
        Steps for which a world has its class at least: episodes that end sooner are followed by others of the
        same class; with 0 each episode draws its class.
    """

    def __init__(self, num_worlds: int, num_classes: int) -> None:
        self.cumulative = wp.array(np.arange(1, num_classes + 1) / num_classes, dtype=wp.float64)
        self.onset_range = wp.zeros(2, dtype=wp.int32)
        self.min_class_steps = wp.zeros(1, dtype=wp.int32)
        self._free = wp.full(num_worlds, DRAW, dtype=wp.int32)

    def begin(
        self,
        episodes: Episodes,
        mask: wp.array[wp.bool],
        classes: wp.array[wp.int32] | None = None,
        onsets: wp.array[wp.int32] | None = None,
    ) -> None:
        """Begin the next episode of the selected worlds.

        Parameters
        ----------
        episodes : Episodes
            The worlds' episodes.
        mask : wp.array of shape [N]
            Worlds whose next episode begins.
        classes, onsets : wp.array of shape [N], optional
            Damage classes and onsets, `DRAW` where the world draws its own.
        """
        wp.launch(
            begin_episode,
            dim=mask.shape,
            inputs=[
                mask,
                episodes.key,
                self.cumulative,
                self.onset_range,
                self.min_class_steps,
                self._free if classes is None else classes,
                self._free if onsets is None else onsets,
                episodes.number,
                episodes.step,
                episodes.drawn_class,
                episodes.class_steps,
            ],
            outputs=[
                episodes.number,
                episodes.step,
                episodes.drawn_class,
                episodes.class_steps,
                episodes.onset,
                episodes.damage_class,
            ],
        )


class StateReset:
    """Sets the initial states of episodes.

    ``reset_data`` of mujoco_warp takes 42 launches, keeps the old contact forces, and clears overflow flags
    that the host has not read yet.

    Parameters
    ----------
    task : Task
        The robot.
    needs_forces : bool
        Whether the first observation of an episode contains forces of its initial state; otherwise only
        kinematics is computed.
    """

    def __init__(self, task: Task, needs_forces: bool) -> None:
        self._noise = [wp.float64(task.qpos_noise), wp.float64(task.qvel_noise)]
        self._main_body = task.main_body
        self._forward = mjw.forward if needs_forces else mjw.kinematics
        self._sensordata0 = wp.array(_resting_sensordata(task), dtype=wp.float32)

    def to_reference(
        self, model: mjw.Model, data: mjw.Data, mask: wp.array[wp.bool], classes: wp.array[wp.int32]
    ) -> None:
        """Set the selected worlds to the reference pose of their class [N], at rest."""
        width = max(
            array.shape[1] for array in (data.qpos, data.act, data.ctrl, data.cfrc_ext, data.sensordata)
        )
        wp.launch(
            set_reference_state,
            dim=(data.nworld, width),
            inputs=[model.qpos0, self._sensordata0, mask, classes],
            outputs=[
                data.time,
                data.qpos,
                data.qvel,
                data.act,
                data.ctrl,
                data.qacc_warmstart,
                data.cfrc_ext,
                data.sensordata,
            ],
        )

    def to_initial(
        self,
        model: mjw.Model,
        data: mjw.Data,
        mask: wp.array[wp.bool],
        episodes: Episodes,
        outcome: Outcome,
    ) -> None:
        """Set the selected worlds to the initial state of their episode: reference pose plus noise."""
        self.to_reference(model, data, mask, episodes.damage_class)
        wp.launch(
            add_reset_noise,
            dim=(data.nworld, max(data.qpos.shape[1], data.qvel.shape[1])),
            inputs=[*self._noise, mask, episodes.key, episodes.number, data.qpos],
            outputs=[data.qpos, data.qvel],
        )
        self.evaluate(model, data, mask, outcome)

    def evaluate(self, model: mjw.Model, data: mjw.Data, mask: wp.array[wp.bool], outcome: Outcome) -> None:
        """Evaluate the physics at new states, and store the x positions of the selected worlds' main bodies.

        All worlds are evaluated, as a launch for a selection costs as much. This does not change the others:
        their next step begins with an evaluation, and their observations have already been written.
        """
        self._forward(model, data)
        wp.launch(store_x, dim=mask.shape, inputs=[self._main_body, mask, data.xpos], outputs=[outcome.x])


def _resting_sensordata(task: Task) -> NDArray[np.float64]:
    """Return the sensor readings of every class in its reference pose, [D, ns]."""
    rows = []
    for model in task.models:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        rows.append(data.sensordata.copy())
    return np.array(rows)
