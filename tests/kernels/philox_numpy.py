"""Philox4x32-10 in plain Python and NumPy, written from the paper: the reference for the kernels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

MASK = 0xFFFFFFFF


def philox4x32(counter: tuple[int, int, int, int], key: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return a block of four words (Salmon et al., 2011, section 4.3)."""
    left_0, right_0, left_1, right_1 = counter[1], counter[0], counter[3], counter[2]
    k0, k1 = key
    for _ in range(10):
        product_0, product_1 = 0xD2511F53 * right_0, 0xCD9E8D57 * right_1
        right_0, left_0, right_1, left_1 = (
            (product_1 >> 32) ^ left_0 ^ k0,
            product_1 & MASK,
            (product_0 >> 32) ^ left_1 ^ k1,
            product_0 & MASK,
        )
        k0, k1 = (k0 + 0x9E3779B9) & MASK, (k1 + 0xBB67AE85) & MASK
    return right_0, left_0, right_1, left_1


class Stream:
    """The stream of one key, episode and purpose, read from its beginning."""

    def __init__(self, key: int, episode: int, purpose: int) -> None:
        self._key = (key & MASK, key >> 32)
        self._episode = (episode & MASK, episode >> 32)
        self._purpose = purpose
        self._words: list[int] = []
        self._block = 0

    def bits(self) -> int:
        """Return the next 64 bits."""
        if not self._words:
            self._words = list(philox4x32((self._block, self._purpose, *self._episode), self._key))
            self._block += 1
        low, high = self._words.pop(0), self._words.pop(0)
        return low | high << 32

    def uniform(self) -> float:
        """Return a number in [0, 1)."""
        return (self.bits() >> 11) / 2**53

    def uniforms(self, count: int) -> NDArray[np.float64]:
        """Return numbers in [0, 1)."""
        return np.array([self.uniform() for _ in range(count)])

    def below(self, bound: int) -> int:
        """Return an integer in [0, bound)."""
        return (self.bits() * bound) >> 64

    def normals(self, count: int) -> NDArray[np.float64]:
        """Return standard normals."""
        pairs = []
        for _ in range((count + 1) // 2):
            radius = math.sqrt(-2.0 * math.log(1.0 - self.uniform()))
            angle = math.tau * self.uniform()
            pairs += [radius * math.cos(angle), radius * math.sin(angle)]
        return np.array(pairs[:count])
