"""Philox4x32-10: random numbers as a pure function of (key, episode, purpose, index).

The streams are those of ``rust/dappo-sim/src/rng.rs``, so that every backend draws the same damage classes,
start states and exploration noise. Rust reads a stream in order; a thread here
computes the number at an index, so that the entries of a vector are drawn in parallel.

Source of the generator: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

import math

import warp as wp

wp.set_module_options({"enable_backward": False})

# Purposes of streams (`Purpose` in Rust); the streams depend on these numbers.
INITIAL_STATE = wp.constant(wp.uint32(0))
DAMAGE_CLASS = wp.constant(wp.uint32(1))
ONSET = wp.constant(wp.uint32(2))
ACTION_NOISE = wp.constant(wp.uint32(3))

ROUNDS = wp.constant(10)
MULTIPLIER_0 = wp.constant(wp.uint64(0xD2511F53))
MULTIPLIER_1 = wp.constant(wp.uint64(0xCD9E8D57))
WEYL_0 = wp.constant(wp.uint32(0x9E3779B9))
WEYL_1 = wp.constant(wp.uint32(0xBB67AE85))
WORD = wp.constant(wp.uint64(32))  # bits of a word
LOW = wp.constant(wp.uint64(0xFFFFFFFF))

ONE = wp.constant(wp.float64(1.0))
TWO = wp.constant(wp.float64(2.0))
TAU = wp.constant(wp.float64(math.tau))
ULP_OF_ONE = wp.constant(wp.float64(2.0**-53))


@wp.func
def philox4x32(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Return one block of four random words."""
    c0, c1, c2, c3 = counter[0], counter[1], counter[2], counter[3]
    k0, k1 = key[0], key[1]
    for _ in range(ROUNDS):
        p0 = MULTIPLIER_0 * wp.uint64(c0)
        p1 = MULTIPLIER_1 * wp.uint64(c2)
        c0 = wp.uint32(p1 >> WORD) ^ c1 ^ k0
        c1 = wp.uint32(p1 & LOW)
        c2 = wp.uint32(p0 >> WORD) ^ c3 ^ k1
        c3 = wp.uint32(p0 & LOW)
        k0 += WEYL_0
        k1 += WEYL_1
    return wp.vec4ui(c0, c1, c2, c3)


@wp.func
def bits(key: wp.uint64, episode: wp.uint64, purpose: wp.uint32, index: int) -> wp.uint64:
    """Return the 64 random bits at `index` of a stream; a block holds two of them."""
    block = philox4x32(
        wp.vec4ui(wp.uint32(index // 2), purpose, wp.uint32(episode & LOW), wp.uint32(episode >> WORD)),
        wp.vec2ui(wp.uint32(key & LOW), wp.uint32(key >> WORD)),
    )
    if index % 2 == 0:
        return wp.uint64(block[0]) | (wp.uint64(block[1]) << WORD)
    return wp.uint64(block[2]) | (wp.uint64(block[3]) << WORD)


@wp.func
def uniform(key: wp.uint64, episode: wp.uint64, purpose: wp.uint32, index: int) -> wp.float64:
    """Return a uniform number of [0, 1) with 53 random bits."""
    return wp.float64(bits(key, episode, purpose, index) >> wp.uint64(11)) * ULP_OF_ONE


@wp.func
def below(key: wp.uint64, episode: wp.uint64, purpose: wp.uint32, index: int, bound: wp.uint32) -> wp.uint32:
    """Return a uniform integer of [0, `bound`): the upper half of its product with 64 random bits."""
    draw = bits(key, episode, purpose, index)
    carry = ((draw & LOW) * wp.uint64(bound)) >> WORD
    return wp.uint32(((draw >> WORD) * wp.uint64(bound) + carry) >> WORD)


@wp.func
def normal(key: wp.uint64, episode: wp.uint64, purpose: wp.uint32, first: int, index: int) -> wp.float64:
    """Return standard normal `index` of those that begin at the bits `first` (Box and Muller, 1958)."""
    at = first + index // 2 * 2
    # 1 - u lies in (0, 1], so that the logarithm is finite.
    radius = wp.sqrt(-TWO * wp.log(ONE - uniform(key, episode, purpose, at)))
    angle = TAU * uniform(key, episode, purpose, at + 1)
    if index % 2 == 0:
        return radius * wp.cos(angle)
    return radius * wp.sin(angle)
