"""Random numbers of the kernels compared with published vectors and with plain Python."""

from __future__ import annotations

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch.kernels import philox

from .philox_numpy import Stream

KEYS = (0, 1, 0xDEADBEEF, 2**32, 2**64 - 1, 0x0123456789ABCDEF)
EPISODES = (0, 1, 2**32 - 1, 2**32, 2**63 + 5)
COUNT = 21


@wp.kernel
def block_kernel(
    # In:
    counter_in: wp.array[wp.vec4ui],
    key_in: wp.array[wp.vec2ui],
    # Out:
    words_out: wp.array[wp.vec4ui],
) -> None:
    i = wp.tid()
    words_out[i] = philox.philox4x32(counter_in[i], key_in[i])


@wp.kernel
def stream_kernel(
    # In:
    key_in: wp.array[wp.uint64],
    episode_in: wp.array[wp.uint64],
    purpose_in: wp.array[wp.uint32],
    bound_in: wp.array[wp.uint32],
    first: int,
    # Out:
    uniform_out: wp.array2d[wp.float64],
    normal_out: wp.array2d[wp.float64],
    below_out: wp.array2d[wp.uint32],
) -> None:
    stream, index = wp.tid()
    key, episode, purpose = key_in[stream], episode_in[stream], purpose_in[stream]
    uniform_out[stream, index] = philox.uniform(key, episode, purpose, index)
    normal_out[stream, index] = philox.normal(key, episode, purpose, first, index)
    below_out[stream, index] = philox.below(key, episode, purpose, index, bound_in[stream])


def test_philox_equals_the_vectors_published_with_random123() -> None:
    ones = 2**32 - 1
    # kat_vectors of Random123, lines "philox4x32 10".
    counters = [(0,) * 4, (ones,) * 4, (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)]
    keys = [(0,) * 2, (ones,) * 2, (0xA4093822, 0x299F31D0)]
    expected = [
        (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ]
    words = wp.full(3, wp.vec4ui(7, 7, 7, 7), dtype=wp.vec4ui)
    inputs = [
        wp.array(np.array(counters, dtype=np.uint32), dtype=wp.vec4ui),
        wp.array(np.array(keys, dtype=np.uint32), dtype=wp.vec2ui),
    ]
    wp.launch(block_kernel, 3, inputs=inputs, outputs=[words])
    np.testing.assert_array_equal(words.numpy(), np.array(expected, dtype=np.uint32))


@pytest.mark.parametrize("first", [0, 15])
def test_streams_equal_those_of_plain_python(first: int) -> None:
    names = [
        (key, episode, purpose, bound)
        for key in KEYS
        for episode in EPISODES
        for purpose, bound in zip(range(4), (1, 33, 1000, 2**32 - 1), strict=True)
    ]
    uniforms, normals = (wp.full((len(names), COUNT), np.nan, dtype=wp.float64) for _ in range(2))
    integers = wp.full((len(names), COUNT), 2**32 - 1, dtype=wp.uint32)
    inputs = [
        wp.array(list(column), dtype=kind)
        for column, kind in zip(
            zip(*names, strict=True), (wp.uint64, wp.uint64, wp.uint32, wp.uint32), strict=True
        )
    ]
    wp.launch(
        stream_kernel, (len(names), COUNT), inputs=[*inputs, first], outputs=[uniforms, normals, integers]
    )
    for row, (*name, bound) in enumerate(names):
        np.testing.assert_array_equal(uniforms.numpy()[row], Stream(*name).uniforms(COUNT))
        stream = Stream(*name)
        stream.uniforms(first)
        np.testing.assert_allclose(normals.numpy()[row], stream.normals(COUNT), rtol=1e-14, atol=1e-15)
        stream = Stream(*name)
        np.testing.assert_array_equal(integers.numpy()[row], [stream.below(bound) for _ in range(COUNT)])
