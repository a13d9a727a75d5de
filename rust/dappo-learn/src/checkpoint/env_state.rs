//! The state of the envs and of their running episodes, as one binary file.
//!
//! Little-endian: a header of four u64 (magic, envs, row, observations), then the arrays in the order written below.
//! JSON would not do: it has no NaN and a world may hold one.

use std::path::Path;

use dappo_sim::backend::BackendSnapshot;
use dappo_sim::vector_env::VectorEnvSnapshot;

use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::files::{Files, write_new};
use crate::records::unreadable;

const FILE: &str = "envs.bin";
/// Far above the state of any number of envs that a computer holds, bytes.
const LONGEST: u64 = 1 << 34;
/// "DAPPOENV" in little-endian order.
const MAGIC: u64 = u64::from_le_bytes(*b"DAPPOENV");

/// Everything a rollout goes on from.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvState {
    /// The envs.
    pub envs: VectorEnvSnapshot,
    /// Sums over their running episodes.
    pub episodes: EpisodeTracker,
}

impl EnvState {
    /// Writes the state into a checkpoint folder.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let backend = &self.envs.backend;
        let envs = backend.classes.len();
        let mut bytes = Vec::new();
        for number in [MAGIC, envs as u64, backend.row as u64, self.envs.obs.len() as u64] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(backend.rows.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend(backend.classes.iter().flat_map(|&x| (x as u64).to_le_bytes()));
        bytes.extend(self.envs.episodes.iter().flatten().flat_map(|x| x.to_le_bytes()));
        bytes.extend(self.envs.obs.iter().flat_map(|x| x.to_le_bytes()));
        for sums in [&self.episodes.forward, &self.episodes.returns, &self.episodes.lengths] {
            bytes.extend(sums.iter().flat_map(|x| x.to_le_bytes()));
        }
        write_new(&folder.join(FILE), &bytes)
    }

    /// Reads the state from a checkpoint.
    pub fn load<F: Files + ?Sized>(files: &F) -> Result<Self> {
        let bytes = files.read(FILE, LONGEST)?;
        let mut reader = Reader { bytes: &bytes };
        let state = Self::parse(&mut reader).filter(|_| reader.bytes.is_empty());
        let state =
            state.ok_or_else(|| unreadable(&files.path(FILE), "it is no env state of this program"))?;
        let EpisodeTracker { forward, returns, lengths, .. } = &state.episodes;
        if let Some(sum) = [forward, returns, lengths].into_iter().flatten().find(|sum| !sum.is_finite()) {
            let message = format!("a sum over an episode is {sum}, expected a finite number");
            return Err(unreadable(&files.path(FILE), message));
        }
        Ok(state)
    }

    fn parse(reader: &mut Reader) -> Option<Self> {
        if reader.u64()? != MAGIC {
            return None;
        }
        let (envs, row, obs) = (reader.u64()? as usize, reader.u64()? as usize, reader.u64()? as usize);
        let rows = reader.many(envs.checked_mul(row)?, Reader::f64)?;
        let classes = reader.many(envs, |reader| reader.u64().map(|class| class as usize))?;
        let episodes = reader.many(envs, |reader| {
            let fields = reader.many(6, Reader::u64)?;
            <[u64; 6]>::try_from(fields).ok()
        })?;
        let obs = reader.many(obs, |reader| reader.take().map(f32::from_le_bytes))?;
        let mut tracker = EpisodeTracker::new(envs);
        tracker.forward = reader.many(envs, Reader::f64)?;
        tracker.returns = reader.many(envs, Reader::f64)?;
        tracker.lengths = reader.many(envs, Reader::f64)?;
        Some(Self {
            envs: VectorEnvSnapshot { backend: BackendSnapshot { row, rows, classes }, episodes, obs },
            episodes: tracker,
        })
    }
}

/// Takes numbers off the front of a byte slice; `None` when it is too short.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, tail) = self.bytes.split_first_chunk::<N>()?;
        self.bytes = tail;
        Some(*head)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn many<T>(&mut self, count: usize, mut one: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        (0..count).map(|_| one(self)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_env_state_reads_back_bit_for_bit_even_with_nan() {
        let mut episodes = EpisodeTracker::new(2);
        episodes.forward = vec![1.5, f64::MIN_POSITIVE];
        let state = EnvState {
            envs: VectorEnvSnapshot {
                backend: BackendSnapshot {
                    row: 2,
                    rows: vec![0.1, -0.0, f64::NAN, 1e300],
                    classes: vec![0, 32],
                },
                episodes: vec![[u64::MAX, 1, 2, 3, 4, 1], [5, 6, 7, 8, 9, 0]],
                obs: vec![0.25, f32::INFINITY],
            },
            episodes,
        };
        let folder = std::env::temp_dir().join(format!("dappo-env-state-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        state.save(&folder).unwrap();
        let again = EnvState::load(folder.as_path()).unwrap();
        let bits = |rows: &[f64]| rows.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&again.envs.backend.rows), bits(&state.envs.backend.rows));
        assert_eq!((again.envs.episodes, again.envs.obs), (state.envs.episodes, state.envs.obs));
        assert_eq!(again.episodes, state.episodes);
        let refuse = |bytes: &[u8], expected: &str| {
            std::fs::write(folder.join(FILE), bytes).unwrap();
            let message = EnvState::load(folder.as_path()).unwrap_err().to_string();
            assert!(message.contains("envs.bin") && message.contains(expected), "{message}");
        };
        let bytes = std::fs::read(folder.join(FILE)).unwrap();
        refuse(b"DAPPOENV", "no env state");
        refuse(&bytes[..bytes.len() - 1], "no env state");
        refuse(&[&bytes[..], &[0]].concat(), "no env state");
        // Sizes that no computer holds take no memory.
        for (at, size) in [(8, u64::MAX), (8, 1 << 61), (16, u64::MAX), (16, 1 << 62), (24, u64::MAX)] {
            let mut large = bytes.clone();
            large[at..at + 8].copy_from_slice(&size.to_le_bytes());
            refuse(&large, "no env state");
        }
        let mut infinite = bytes.clone();
        let end = infinite.len();
        infinite[end - 8..].copy_from_slice(&f64::INFINITY.to_le_bytes());
        refuse(&infinite, "a sum over an episode is inf");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
