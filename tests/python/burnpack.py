"""Read checkpoints for comparison.

Two trainings of the same settings write the same numbers, but not the same bytes: burn names the parameters
of a network by random ids. These appear in the records of networks and optimisers, and with them vary the
order of the entries, the CRC-32 in the manifest and, rarely, a length. Here every id is replaced by the name
of its parameter; everything else is compared bit for bit.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

_HEADER = 10
"""Bytes of a burnpack header: magic, version (u16), length of the CBOR metadata (u32)."""
_ALIGNMENT = 256


def checkpoint_contents(folder: Path) -> dict[str, Any]:
    """Read a checkpoint into comparable objects, file by file."""
    contents: dict[str, Any] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".bpk":
            contents[path.name] = read_burnpack(path)
        elif path.name == "manifest.json":
            manifest = json.loads(path.read_text())
            manifest["files"] = [entry["name"] for entry in manifest["files"]]
            contents[path.name] = manifest
        else:
            contents[path.name] = path.read_bytes()
    return contents


def read_burnpack(path: Path) -> dict[str, Any]:
    """Read a burnpack file: tensors as (dtype, shape, bytes), scalars and other entries as they are."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sHI", data)
    assert (magic, version) == (b"NRUB", 1), path
    table, end = _cbor(data, _HEADER)
    assert end == _HEADER + length, path
    begin = -(-end // _ALIGNMENT) * _ALIGNMENT
    # An optimiser record lists id -> name; in a network record the names are the keys already.
    names = dict(table.get("metadata", {}))
    contents: dict[str, Any] = {}
    for key, tensor in table.pop("tensors").items():
        first, last = tensor["data_offsets"]
        value = (tensor["dtype"], tensor["shape"], data[begin + first : begin + last])
        contents[_renamed(key, names)] = value
    for section, entries in table.items():
        if section == "metadata":
            contents[section] = sorted(names.values())
        else:
            contents[section] = {_renamed(key, names): value for key, value in entries.items()}
    return contents


def _renamed(key: str, names: dict[str, str]) -> str:
    head, dot, tail = key.partition(".")
    return names.get(head, head) + dot + tail


def _cbor(data: bytes, at: int) -> tuple[Any, int]:
    """Decode one CBOR item (RFC 8949, definite lengths); return it and the position behind it."""
    major, info = data[at] >> 5, data[at] & 31
    at += 1
    if major == 7:
        if info in (20, 21, 22):
            return {20: False, 21: True, 22: None}[info], at
        width, kind = {25: (2, "e"), 26: (4, "f"), 27: (8, "d")}[info]
        return struct.unpack_from(f">{kind}", data, at)[0], at + width
    number = info
    if info >= 24:
        width = 1 << (info - 24)
        number, at = int.from_bytes(data[at : at + width], "big"), at + width
    if major in (0, 1):
        return (number if major == 0 else -1 - number), at
    if major in (2, 3):
        raw = data[at : at + number]
        return (raw if major == 2 else raw.decode()), at + number
    if major == 4:
        items = []
        for _ in range(number):
            item, at = _cbor(data, at)
            items.append(item)
        return items, at
    assert major == 5, f"CBOR major type {major}"
    table = {}
    for _ in range(number):
        key, at = _cbor(data, at)
        table[key], at = _cbor(data, at)
    return table, at
