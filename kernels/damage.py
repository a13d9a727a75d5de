"""The class table on the device: a damage class acts by copying its row into the fields of a world's model.

MuJoCo's compiler has derived every number of every class. Nothing is scaled or patched here, so no derived
field can be forgotten: all that differ among the compiled models are copied together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import NDArray

__all__ = ["DamageFields", "class_rows"]

wp.set_module_options({"enable_backward": False})

# Fields that all worlds share and in which classes may differ, with the reason; touch sites are checked
# separately.
_UNREAD = {"dof_length": "read only by sleeping, which no captured step uses"}
_WORD = np.dtype(np.int32)
_ALIGNMENT = 4  # words; vectors of four floats are then aligned as in an array of their own


@wp.kernel
def gather_rows(
    # Model:
    row_in: wp.array2d[wp.int32],
    # In:
    mask_in: wp.array[wp.bool],
    class_in: wp.array[wp.int32],
    # Out:
    fields_out: wp.array2d[wp.int32],
) -> None:
    worldid, word = wp.tid()
    if mask_in[worldid]:
        fields_out[worldid, word] = row_in[class_in[worldid], word]


@dataclass(frozen=True)
class ClassRows:
    """The entries in which the compiled models differ, one row of 32-bit words a class.

    Attributes
    ----------
    words : array of shape [D, W]
        The rows; floats and integers as their bits.
    columns : dict of str to slice
        The columns of each field of ``mjw.Model``.
    """

    words: NDArray[np.int32]
    columns: dict[str, slice]


def class_rows(
    model: mjw.Model, models: Sequence[mujoco.MjModel], disabled_sites: Sequence[frozenset[int]]
) -> ClassRows:
    """Collect the fields in which the compiled models differ.

    Parameters
    ----------
    model : mjw.Model
        The healthy model on the device; it defines names, shapes and types of the fields.
    models : sequence of mujoco.MjModel
        The compiled models of all damage classes, [D].
    disabled_sites : sequence of frozenset of int
        Per class, the sites whose touch signal is not read.

    Returns
    -------
    ClassRows
        The rows.

    Raises
    ------
    ValueError
        If the models differ in a field that mujoco_warp shares among all worlds.
    """
    _check_options(models)
    columns: dict[str, slice] = {}
    blocks: list[NDArray[np.int32]] = []
    width = 0
    for field in dataclasses.fields(mjw.Model):
        values = _values(models, field.name)
        if values is None or all(np.array_equal(value, values[0]) for value in values):
            continue
        if not _is_batched(field.type):
            _check_shared(field.name, values, disabled_sites)
            continue
        array = getattr(model, field.name)
        scalar = array.numpy().dtype
        if scalar.itemsize != _WORD.itemsize:
            raise ValueError(f"damage classes differ in {field.name}, whose entries are not of 32 bits")
        block = np.stack([value.astype(scalar).ravel() for value in values]).view(_WORD)
        columns[field.name] = slice(width, width + block.shape[1])
        block = np.pad(block, ((0, 0), (0, -block.shape[1] % _ALIGNMENT)))
        blocks.append(block)
        width += block.shape[1]
    return ClassRows(np.concatenate(blocks, axis=1) if blocks else np.zeros((len(models), 0), _WORD), columns)


def _values(models: Sequence[mujoco.MjModel], name: str) -> list[NDArray[Any]] | None:
    if not isinstance(getattr(models[0], name, None), np.ndarray):
        return None
    return [getattr(model, name) for model in models]


def _is_batched(spec: Any) -> bool:  # noqa: ANN401 - the declared type of a field, an array annotation or a class
    """Return whether a field may have a row for every world, which mujoco_warp marks with ``*``."""
    return bool(getattr(spec, "shape", ())) and spec.shape[0] == "*"


def _check_options(models: Sequence[mujoco.MjModel]) -> None:
    for name in (name for name in dir(models[0].opt) if not name.startswith("_")):
        if any(
            not np.array_equal(getattr(model.opt, name), getattr(models[0].opt, name)) for model in models
        ):
            raise ValueError(f"damage classes differ in opt.{name}, but all worlds share it")


def _check_shared(name: str, values: list[NDArray[Any]], disabled_sites: Sequence[frozenset[int]]) -> None:
    if name in _UNREAD:
        return
    for number, value in enumerate(values):
        entries = np.argwhere(value != values[0])[:, 0]
        # The zone of a touch sensor may differ if its signal is not read.
        if name == "site_size" and disabled_sites[number].issuperset(entries.tolist()):
            continue
        if entries.size:
            raise ValueError(f"damage class {number} changes {name}, but all worlds share it")


class DamageFields:
    """The fields of a model that depend on each world's damage class.

    They are stored in one block of memory, a row a world, and the model's arrays are views of it: one launch
    updates all fields of all worlds whose class changes.

    Parameters
    ----------
    model : mjw.Model
        The healthy model on the device; its fields that depend on the class are replaced, so this must happen
        before a graph is captured.
    rows : ClassRows
        The class table.
    num_worlds : int
        Number of worlds; all are healthy at first.

    Raises
    ------
    ValueError
        If mujoco_warp stores a field in another form than MuJoCo.
    """

    def __init__(self, model: mjw.Model, rows: ClassRows, num_worlds: int) -> None:
        self.num_worlds = num_worlds
        self.rows = wp.array(rows.words, dtype=wp.int32)
        self.storage = wp.array(np.tile(rows.words[:1], (num_worlds, 1)), dtype=wp.int32)
        stride = self.storage.strides[0]
        for name, columns in rows.columns.items():
            array = getattr(model, name)
            if not np.array_equal(array.numpy().ravel().view(_WORD), rows.words[0, columns]):
                raise ValueError(f"mujoco_warp stores {name} in another form than MuJoCo")
            view = wp.array(
                ptr=self.storage.ptr + columns.start * _WORD.itemsize,
                dtype=array.dtype,
                shape=(num_worlds, *array.shape[1:]),
                strides=(stride, *array.strides[1:]),
                device=self.storage.device,
            )
            setattr(model, name, view)

    def gather(self, mask: wp.array[wp.bool], classes: wp.array[wp.int32]) -> None:
        """Copy the model of their class into the selected worlds.

        Parameters
        ----------
        mask : wp.array of shape [N]
            Worlds to change.
        classes : wp.array of shape [N]
            Active damage class.
        """
        if self.rows.shape[1]:
            wp.launch(
                gather_rows,
                dim=(self.num_worlds, self.rows.shape[1]),
                inputs=[self.rows, mask, classes],
                outputs=[self.storage],
            )
