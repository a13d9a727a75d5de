//! Philox4x32-10: the host's random numbers, as a pure function of (key, episode, purpose, index).
//!
//! Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011. Words have 32 bits, as on every GPU.

use cubecl::prelude::*;

use crate::math::{copied_in_kernels, is_double, lit, natural_logarithm, sin_cos};

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: u32 = 10;

/// What a stream is for: numbers that the host counts them by.
pub mod purpose {
    pub const INITIAL_STATE: u32 = 0;
    pub const DAMAGE_CLASS: u32 = 1;
    pub const ONSET: u32 = 2;
    pub const ACTION_NOISE: u32 = 3;
    pub const EVENTS: u32 = 14;
    pub const COMMAND: u32 = 15;
    pub const PUSH: u32 = 16;
    pub const OBSERVATION_NOISE: u32 = 17;
    pub const PRIVILEGED_NOISE: u32 = 18;
    pub const DAMAGE_DURATION: u32 = 22;
    pub const VARIANT: u32 = 24;
    pub const CODE_DELAY: u32 = 26;
}

/// The streams of one env and episode, or of one env and step.
#[derive(CubeType, Clone, Copy)]
pub struct Stream {
    pub key_low: u32,
    pub key_high: u32,
    pub episode_low: u32,
    pub episode_high: u32,
}

/// 64 random bits.
#[derive(CubeType, Clone, Copy)]
pub struct Bits {
    pub low: u32,
    pub high: u32,
}
copied_in_kernels!(plain: StreamExpand, BitsExpand);

#[cube]
impl Stream {
    /// Draw `index` of the stream for a purpose.
    pub fn bits(self, #[comptime] purpose: u32, index: u32) -> Bits {
        let mut a = index / 2u32;
        let mut b = comptime!(purpose).runtime();
        let mut c = self.episode_low;
        let mut d = self.episode_high;
        let mut key_low = self.key_low;
        let mut key_high = self.key_high;
        for _ in 0..comptime!(ROUNDS) {
            let first = a * comptime!(MULTIPLIERS[0]);
            let second = c * comptime!(MULTIPLIERS[1]);
            let first_high = a.mul_hi(comptime!(MULTIPLIERS[0]));
            let second_high = c.mul_hi(comptime!(MULTIPLIERS[1]));
            a = second_high ^ b ^ key_low;
            b = second;
            c = first_high ^ d ^ key_high;
            d = first;
            key_low += comptime!(WEYL[0]);
            key_high += comptime!(WEYL[1]);
        }
        // A block has two draws of two words.
        let odd = index % 2u32 == 1u32;
        let low = select(odd, c, a);
        let high = select(odd, d, b);
        Bits { low, high }
    }

    /// Uniform in [0, 1): 53 random bits in double precision, 24 in single precision.
    pub fn uniform<F: Float>(self, #[comptime] purpose: u32, index: u32) -> F {
        let bits = self.bits(purpose, index);
        let double = is_double::<F>();
        if comptime!(double) {
            let high = F::cast_from(bits.high) * lit::<F>(2_097_152.0);
            (high + F::cast_from(bits.low >> 11u32)) * lit::<F>(1.0 / 9_007_199_254_740_992.0)
        } else {
            F::cast_from(bits.high >> 8u32) * lit::<F>(1.0 / 16_777_216.0)
        }
    }

    /// Uniform integer in [0, `bound`).
    pub fn below(self, #[comptime] purpose: u32, index: u32, bound: u32) -> u32 {
        let bits = self.bits(purpose, index);
        // The upper 64 bits of 64 × 32 bits.
        let middle = bits.high * bound;
        let carried = middle + bits.low.mul_hi(bound);
        bits.high.mul_hi(bound) + select(carried < middle, 1u32, 0u32)
    }

    /// Standard normal by Box and Muller: number `index` of those that begin at draw `first`.
    pub fn normal<F: Float>(self, #[comptime] purpose: u32, first: u32, index: u32) -> F {
        let pair = first + (index / 2u32) * 2u32;
        let square =
            lit::<F>(-2.0) * natural_logarithm::<F>(lit::<F>(1.0) - self.uniform::<F>(purpose, pair));
        let angle = lit::<F>(std::f64::consts::TAU) * self.uniform::<F>(purpose, pair + 1u32);
        let direction = sin_cos::<F>(angle);
        square.sqrt() * select(index % 2u32 == 1u32, direction.sin, direction.cos)
    }
}

/// Uniform between two numbers.
#[cube]
pub fn within<F: Float>(
    stream: Stream,
    #[comptime] purpose: u32,
    index: u32,
    #[comptime] range: [f64; 2],
) -> F {
    let uniform = stream.uniform::<F>(purpose, index);
    lit::<F>(comptime!(range[0])) + lit::<F>(comptime!(range[1] - range[0])) * uniform
}

/// A time in env steps, at least 1.
#[cube]
pub fn steps<F: Float>(time: F, #[comptime] dt: f64) -> u32 {
    // Half away from zero, as on the host.
    let whole = (time / lit::<F>(dt) + lit::<F>(0.5)).floor();
    u32::cast_from(max(whole, lit::<F>(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Device, THREADS};
    use crate::math::exponential;

    /// Writes the words of two draws of each stream.
    ///
    /// # Shapes
    /// - `streams`: `[n, 5]`, key, episode and the index of the first draw; `words`: `[n, 4]`
    #[cube(launch_unchecked)]
    fn words(streams: &[u32], words: &mut [u32], count: usize, #[comptime] purpose: u32) {
        if ABSOLUTE_POS < count {
            let at = 5 * ABSOLUTE_POS;
            let stream = Stream {
                key_low: streams[at],
                key_high: streams[at + 1],
                episode_low: streams[at + 2],
                episode_high: streams[at + 3],
            };
            let first = stream.bits(purpose, streams[at + 4]);
            let second = stream.bits(purpose, streams[at + 4] + 1u32);
            words[4 * ABSOLUTE_POS] = first.low;
            words[4 * ABSOLUTE_POS + 1] = first.high;
            words[4 * ABSOLUTE_POS + 2] = second.low;
            words[4 * ABSOLUTE_POS + 3] = second.high;
        }
    }

    #[cube(launch_unchecked)]
    fn functions<F: Float>(x: &[F], exponentials: &mut [F], logarithms: &mut [F], count: usize) {
        if ABSOLUTE_POS < count {
            exponentials[ABSOLUTE_POS] = exponential::<F>(-x[ABSOLUTE_POS]);
            logarithms[ABSOLUTE_POS] = natural_logarithm::<F>(x[ABSOLUTE_POS]);
        }
    }

    fn device() -> Option<Device> {
        Device::allowing(true).inspect_err(|why| eprintln!("skipped: {why}")).ok()
    }

    fn word_vector(client: &cubecl::client::Client, stream: [u32; 5], purpose: u32) -> Vec<u32> {
        let streams = client.create_from_slice(u32::as_bytes(&stream));
        let out = client.empty(4 * size_of::<u32>());
        // SAFETY: the lengths are those of the buffers, and the kernel has no loop.
        unsafe {
            words::launch_unchecked(
                client,
                CubeCount::Static(1, 1, 1),
                CubeDim::new_1d(THREADS as u32),
                BufferArg::from_raw_parts(streams, 5),
                BufferArg::from_raw_parts(out.clone(), 4),
                1,
                purpose,
            );
        }
        u32::from_bytes(&client.read_one_unchecked(out)).to_vec()
    }

    #[test]
    fn philox_equals_the_vectors_published_with_random123() {
        let Some(device) = device() else { return };
        let client = device.client();
        // kat_vectors of Random123, lines "philox4x32 10".
        assert_eq!(word_vector(&client, [0; 5], 0), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        let digits = [0xa409_3822, 0x299f_31d0, 0x1319_8a2e, 0x0370_7344, 2 * 0x243f_6a88];
        assert_eq!(
            word_vector(&client, digits, 0x85a3_08d3),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn exponentials_and_logarithms_are_good_to_rounding() {
        let Some(device) = device() else { return };
        let client = device.client();
        let x: Vec<f64> =
            (0..=54).map(|k| (-f64::from(k)).exp2()).chain((1..400).map(|k| f64::from(k) / 400.0)).collect();
        let handle = client.create_from_slice(f64::as_bytes(&x));
        let (exponentials, logarithms) = (client.empty(8 * x.len()), client.empty(8 * x.len()));
        // SAFETY: the lengths are those of the buffers, and the kernel has no loop.
        unsafe {
            functions::launch_unchecked::<f64>(
                &client,
                CubeCount::Static(x.len().div_ceil(THREADS) as u32, 1, 1),
                CubeDim::new_1d(THREADS as u32),
                BufferArg::from_raw_parts(handle, x.len()),
                BufferArg::from_raw_parts(exponentials.clone(), x.len()),
                BufferArg::from_raw_parts(logarithms.clone(), x.len()),
                x.len(),
            );
        }
        let exponentials = client.read_one_unchecked(exponentials);
        let logarithms = client.read_one_unchecked(logarithms);
        for ((x, exponential), logarithm) in
            x.iter().zip(f64::from_bytes(&exponentials)).zip(f64::from_bytes(&logarithms))
        {
            assert!((exponential / (-x).exp() - 1.0).abs() < 4e-16, "exp(-{x}) = {exponential}");
            assert!((logarithm - x.ln()).abs() <= 4e-16 * x.ln().abs(), "ln {x} = {logarithm}");
        }
    }
}
