//! The state of the envs and of their running episodes, as one file.
//!
//! | array of `envs.safetensors` | shape | holds |
//! |---|---|---|
//! | `worlds` | `[N, row]` f64 | states of the backend |
//! | `classes` | `[N]` u64 | damage classes |
//! | `episodes` | `[N, 10]` u64 | state of the episodes, and their random streams |
//! | `obs` | `[N · O]` f32 | last observations |
//! | `forward`, `returns`, `lengths` | `[N]` f64 | sums over the episodes |
//! | `memory` | `[N, 2, H]` f32 | what a recurrent policy remembers; absent for others |
//!
//! JSON would not do: it has no NaN and a world may hold one.

use std::path::Path;

use dappo_nn::PolicyState;
use dappo_sim::backend::BackendSnapshot;
use dappo_sim::vector_env::VectorEnvSnapshot;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::files::{Files, write_new};
use crate::records::unreadable;

const FILE: &str = "envs.safetensors";
const MEMORY: &str = "memory";
/// The arrays of the file.
const ARRAYS: [&str; 8] = ["worlds", "classes", "episodes", "obs", "forward", "returns", "lengths", MEMORY];
/// The file of earlier versions, see [`parse_earlier`].
const EARLIER_FILE: &str = "envs.bin";
/// Far above the state of any number of envs that a computer holds, bytes.
const LONGEST: u64 = 1 << 34;
/// Numbers of an episode.
const EPISODE: usize = 10;
/// Numbers of an episode in earlier versions: without the steps of the class before, without the delay of the damage
/// code, and without duration and pause of the damage either.
const EARLIER_EPISODES: [usize; 3] = [9, 8, FIRST_EPISODE];
/// Numbers of an episode in the first version.
const FIRST_EPISODE: usize = 6;
/// "DAPPOENV" in little-endian order.
const MAGIC: u64 = u64::from_le_bytes(*b"DAPPOENV");

/// The state from which a rollout continues.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvState {
    /// The envs.
    pub envs: VectorEnvSnapshot,
    /// Sums over their running episodes.
    pub episodes: EpisodeTracker,
    /// What the policy remembers of them.
    pub memory: PolicyState,
}

impl EnvState {
    /// Writes the state into a checkpoint folder.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let (path, backend) = (folder.join(FILE), &self.envs.backend);
        let envs = backend.classes.len();
        let EpisodeTracker { forward, returns, lengths, .. } = &self.episodes;
        let sums = |sums: &[f64]| (Dtype::F64, vec![envs], bytes(sums.iter().copied(), f64::to_le_bytes));
        let episodes = self.envs.episodes.iter().flatten().copied();
        let classes = backend.classes.iter().map(|&class| class as u64);
        let mut arrays = vec![
            (
                "worlds",
                (Dtype::F64, vec![envs, backend.row], bytes(backend.rows.iter().copied(), f64::to_le_bytes)),
            ),
            ("classes", (Dtype::U64, vec![envs], bytes(classes, u64::to_le_bytes))),
            ("episodes", (Dtype::U64, vec![envs, EPISODE], bytes(episodes, u64::to_le_bytes))),
            (
                "obs",
                (
                    Dtype::F32,
                    vec![self.envs.obs.len()],
                    bytes(self.envs.obs.iter().copied(), f32::to_le_bytes),
                ),
            ),
            ("forward", sums(forward)),
            ("returns", sums(returns)),
            ("lengths", sums(lengths)),
        ];
        if self.memory.units() > 0 {
            let numbers = bytes(self.memory.numbers().iter().copied(), f32::to_le_bytes);
            arrays.push((MEMORY, (Dtype::F32, vec![envs, 2, self.memory.units()], numbers)));
        }
        let views = arrays.iter().map(|(name, (kind, shape, bytes))| {
            TensorView::new(*kind, shape.clone(), bytes).map(|view| (*name, view))
        });
        let views: std::result::Result<Vec<_>, _> = views.collect();
        let file = views.and_then(|views| safetensors::serialize(views, None));
        write_new(&path, &file.map_err(|error| unreadable(&path, error))?)
    }

    /// Reads the state from a checkpoint.
    pub fn load<F: Files + ?Sized>(files: &F) -> Result<Self> {
        let name = if files.has(EARLIER_FILE) { EARLIER_FILE } else { FILE };
        let bytes = files.read(name, LONGEST)?;
        let parsed = if name == FILE { parse(&bytes) } else { parse_earlier(&bytes) };
        let state = parsed.map_err(|reason| {
            unreadable(&files.path(name), format!("it is not an env state of this program: {reason}"))
        })?;
        let EpisodeTracker { forward, returns, lengths, .. } = &state.episodes;
        if let Some(sum) = [forward, returns, lengths].into_iter().flatten().find(|sum| !sum.is_finite()) {
            let message = format!("a sum over an episode is {sum}, expected a finite number");
            return Err(unreadable(&files.path(name), message));
        }
        Ok(state)
    }

    /// Assembles the arrays of a file.
    fn of(row: usize, rows: Vec<f64>, classes: Vec<u64>, arrays: EpisodeArrays) -> Self {
        let EpisodeArrays { episodes, obs, sums: [forward, returns, lengths], memory } = arrays;
        let mut tracker = EpisodeTracker::new(classes.len());
        (tracker.forward, tracker.returns, tracker.lengths) = (forward, returns, lengths);
        let classes = classes.into_iter().map(|class| class as usize).collect();
        let backend = BackendSnapshot { row, rows, classes };
        Self { envs: VectorEnvSnapshot { backend, episodes, obs }, episodes: tracker, memory }
    }
}

/// What a file holds of the episodes.
struct EpisodeArrays {
    episodes: Vec<[u64; EPISODE]>,
    obs: Vec<f32>,
    sums: [Vec<f64>; 3],
    memory: PolicyState,
}

fn bytes<T, const N: usize>(values: impl Iterator<Item = T>, to_bytes: fn(T) -> [u8; N]) -> Vec<u8> {
    values.flat_map(to_bytes).collect()
}

fn parse(file: &[u8]) -> std::result::Result<EnvState, String> {
    let file = SafeTensors::deserialize(file).map_err(|error| error.to_string())?;
    let (worlds, shape) = array(&file, "worlds", Dtype::F64, f64::from_le_bytes)?;
    if let Some(name) = file.names().into_iter().find(|name| !ARRAYS.contains(name)) {
        return Err(format!("`{name}` is no array of it"));
    }
    let &[envs, row] = shape.as_slice() else {
        return Err(format!("`worlds` has shape {shape:?}, expected [envs, row]"));
    };
    let sums = |name| of_shape(&file, name, Dtype::F64, &[envs], f64::from_le_bytes);
    let classes = of_shape(&file, "classes", Dtype::U64, &[envs], u64::from_le_bytes)?;
    let episodes = read_episodes(&file, envs)?;
    let arrays = EpisodeArrays {
        episodes,
        obs: array(&file, "obs", Dtype::F32, f32::from_le_bytes)?.0,
        sums: [sums("forward")?, sums("returns")?, sums("lengths")?],
        memory: read_memory(&file, envs)?,
    };
    Ok(EnvState::of(row, worlds, classes, arrays))
}

fn read_memory(file: &SafeTensors<'_>, envs: usize) -> std::result::Result<PolicyState, String> {
    if !file.names().contains(&MEMORY) {
        return Ok(PolicyState::default());
    }
    let (numbers, shape) = array(file, MEMORY, Dtype::F32, f32::from_le_bytes)?;
    match *shape.as_slice() {
        [rows, 2, units] if rows == envs && units > 0 => PolicyState::of(units, numbers)
            .ok_or_else(|| format!("`{MEMORY}` holds numbers that are not finite")),
        _ => Err(format!("`{MEMORY}` has shape {shape:?}, expected [{envs}, 2, H]")),
    }
}

/// The episodes of a file, which may be that of an earlier version.
fn read_episodes(file: &SafeTensors<'_>, envs: usize) -> std::result::Result<Vec<[u64; EPISODE]>, String> {
    let (episodes, shape) = array(file, "episodes", Dtype::U64, u64::from_le_bytes)?;
    match *shape.as_slice() {
        [rows, numbers] if rows == envs && (numbers == EPISODE || EARLIER_EPISODES.contains(&numbers)) => {
            Ok(episodes.chunks_exact(numbers).map(completed).collect())
        }
        _ => Err(format!("`episodes` has shape {shape:?}, expected [{envs}, {EPISODE}]")),
    }
}

/// An episode, perhaps of an earlier version, in which damage stays, its code is not late and each episode draws its
/// class.
fn completed(numbers: &[u64]) -> [u64; EPISODE] {
    let mut episode = [0; EPISODE];
    episode[..numbers.len()].copy_from_slice(numbers);
    episode
}

/// The numbers and the shape of an array.
fn array<T, const N: usize>(
    file: &SafeTensors<'_>,
    name: &str,
    kind: Dtype,
    from_bytes: fn([u8; N]) -> T,
) -> std::result::Result<(Vec<T>, Vec<usize>), String> {
    let array = file.tensor(name).map_err(|error| format!("`{name}`: {error}"))?;
    if array.dtype() != kind {
        return Err(format!("`{name}` holds {:?}, expected {kind:?}", array.dtype()));
    }
    let numbers = array.data().as_chunks().0.iter().map(|bytes| from_bytes(*bytes)).collect();
    Ok((numbers, array.shape().to_vec()))
}

fn of_shape<T, const N: usize>(
    file: &SafeTensors<'_>,
    name: &str,
    kind: Dtype,
    expected: &[usize],
    from_bytes: fn([u8; N]) -> T,
) -> std::result::Result<Vec<T>, String> {
    let (numbers, shape) = array(file, name, kind, from_bytes)?;
    if shape == expected {
        return Ok(numbers);
    }
    Err(format!("`{name}` has shape {shape:?}, expected {expected:?}"))
}

/// Reads the file of earlier versions, little-endian: a header of four u64 (magic, envs, row, observations), then
/// states, classes, episodes, observations and sums.
fn parse_earlier(file: &[u8]) -> std::result::Result<EnvState, String> {
    let mut reader = Reader { bytes: file };
    let state = read_earlier(&mut reader).filter(|_| reader.bytes.is_empty());
    state.ok_or_else(|| "its length is not that of its header".to_owned())
}

fn read_earlier(reader: &mut Reader) -> Option<EnvState> {
    if reader.u64()? != MAGIC {
        return None;
    }
    let (envs, row, obs) = (reader.u64()? as usize, reader.u64()? as usize, reader.u64()? as usize);
    let rows = reader.many(envs.checked_mul(row)?, Reader::f64)?;
    let classes = reader.many(envs, Reader::u64)?;
    let episodes = reader
        .many(envs, |reader| reader.many(FIRST_EPISODE, Reader::u64).map(|numbers| completed(&numbers)))?;
    let obs = reader.many(obs, |reader| reader.take().map(f32::from_le_bytes))?;
    let mut sums = || reader.many(envs, Reader::f64);
    let sums = [sums()?, sums()?, sums()?];
    Some(EnvState::of(
        row,
        rows,
        classes,
        EpisodeArrays { episodes, obs, sums, memory: PolicyState::default() },
    ))
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
    use std::fs;

    use super::*;
    use crate::files::testing::Scratch;

    /// Two envs with numbers that text would not keep.
    fn state() -> EnvState {
        let mut episodes = EpisodeTracker::new(2);
        episodes.forward = vec![1.5, f64::MIN_POSITIVE];
        EnvState {
            envs: VectorEnvSnapshot {
                backend: BackendSnapshot {
                    row: 2,
                    rows: vec![0.1, -0.0, f64::NAN, 1e300],
                    classes: vec![0, 32],
                },
                episodes: vec![[u64::MAX, 1, 2, 3, 4, 1, 10, 11, 12, 13], [5, 6, 7, 8, 9, 0, 0, 0, 0, 0]],
                obs: vec![0.25, f32::INFINITY],
            },
            episodes,
            memory: PolicyState::of(1, vec![0.5, -0.25, 1e-40, 3.0]).unwrap(),
        }
    }

    fn assert_equal(one: &EnvState, other: &EnvState) {
        let bits = |state: &EnvState| state.envs.backend.rows.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(one), bits(other));
        assert_eq!(one.envs.backend.classes, other.envs.backend.classes);
        assert_eq!((&one.envs.episodes, &one.envs.obs), (&other.envs.episodes, &other.envs.obs));
        assert_eq!((&one.episodes, &one.memory), (&other.episodes, &other.memory));
    }

    fn refuse(folder: &Scratch, name: &str, bytes: &[u8], expected: &str) {
        fs::write(folder.0.join(name), bytes).unwrap();
        let message = EnvState::load(folder.0.as_path()).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains(expected), "{message}");
    }

    #[test]
    fn an_env_state_reads_back_bit_for_bit_even_with_nan() {
        let folder = Scratch::new();
        state().save(&folder.0).unwrap();
        assert_equal(&EnvState::load(folder.0.as_path()).unwrap(), &state());
        let bytes = fs::read(folder.0.join(FILE)).unwrap();
        refuse(&folder, FILE, b"DAPPOENV", "not an env state");
        refuse(&folder, FILE, &bytes[..bytes.len() - 1], "not an env state");
        refuse(&folder, FILE, &[&bytes[..], &[0]].concat(), "not an env state");
        let with = |from: &str, to: &str| {
            let begin = bytes.windows(from.len()).position(|part| part == from.as_bytes()).unwrap();
            [&bytes[..begin], to.as_bytes(), &bytes[begin + from.len()..]].concat()
        };
        refuse(&folder, FILE, &with("\"worlds\"", "\"wurlds\""), "`worlds`");
        refuse(
            &folder,
            FILE,
            &with("[2,2,1]", "[1,2,2]"),
            "`memory` has shape [1, 2, 2], expected [2, 2, H]",
        );
        refuse(&folder, FILE, &with("[2,10]", "[10,2]"), "`episodes` has shape [10, 2], expected [2, 10]");
        let mut infinite = bytes.clone();
        let begin = bytes.windows(8).position(|part| part == 1.5_f64.to_le_bytes()).unwrap();
        infinite[begin..begin + 8].copy_from_slice(&f64::INFINITY.to_le_bytes());
        refuse(&folder, FILE, &infinite, "a sum over an episode is inf");
    }

    /// The episodes as earlier versions save them.
    fn earlier_episodes(state: &EnvState, numbers: usize) -> impl Iterator<Item = u64> {
        state.envs.episodes.iter().flat_map(move |episode| &episode[..numbers]).copied()
    }

    /// A state that an earlier version can hold.
    fn earlier_state(numbers: usize) -> EnvState {
        let mut state = state();
        state.envs.episodes[0][numbers..].fill(0);
        state.memory = PolicyState::default();
        state
    }

    #[test]
    fn episodes_of_earlier_versions_lack_what_these_versions_did_not_have() {
        for numbers in EARLIER_EPISODES {
            let episodes = bytes(earlier_episodes(&state(), numbers), u64::to_le_bytes);
            let view = TensorView::new(Dtype::U64, vec![2, numbers], &episodes).unwrap();
            let file = safetensors::serialize([("episodes", view)], None).unwrap();
            let file = SafeTensors::deserialize(&file).unwrap();
            assert_eq!(read_episodes(&file, 2).unwrap(), earlier_state(numbers).envs.episodes);
            assert!(read_episodes(&file, 3).unwrap_err().contains("expected [3, 10]"));
        }
    }

    /// The file of earlier versions.
    fn earlier(state: &EnvState) -> Vec<u8> {
        let backend = &state.envs.backend;
        let header = [MAGIC, 2, 2, state.envs.obs.len() as u64];
        let classes = backend.classes.iter().map(|&class| class as u64);
        let EpisodeTracker { forward, returns, lengths, .. } = &state.episodes;
        [
            bytes(header.into_iter(), u64::to_le_bytes),
            bytes(backend.rows.iter().copied(), f64::to_le_bytes),
            bytes(classes.chain(earlier_episodes(state, FIRST_EPISODE)), u64::to_le_bytes),
            bytes(state.envs.obs.iter().copied(), f32::to_le_bytes),
            bytes(forward.iter().chain(returns).chain(lengths).copied(), f64::to_le_bytes),
        ]
        .concat()
    }

    #[test]
    fn env_states_of_earlier_versions_are_read_and_sizes_that_no_computer_holds_take_no_memory() {
        let folder = Scratch::new();
        let bytes = earlier(&state());
        fs::write(folder.0.join(EARLIER_FILE), &bytes).unwrap();
        assert_equal(&EnvState::load(folder.0.as_path()).unwrap(), &earlier_state(FIRST_EPISODE));
        refuse(&folder, EARLIER_FILE, b"DAPPOENV", "not an env state");
        refuse(&folder, EARLIER_FILE, &bytes[..bytes.len() - 1], "not an env state");
        refuse(&folder, EARLIER_FILE, &[&bytes[..], &[0]].concat(), "not an env state");
        for (at, size) in [(8, u64::MAX), (8, 1 << 61), (16, u64::MAX), (16, 1 << 62), (24, u64::MAX)] {
            let mut large = bytes.clone();
            large[at..at + 8].copy_from_slice(&size.to_le_bytes());
            refuse(&folder, EARLIER_FILE, &large, "not an env state");
        }
    }
}
