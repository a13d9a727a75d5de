//! Collecting pairs: Algorithm 1 of Verma et al. (2019), all damage classes of several rollouts at once; and robots without
//! twins.

mod acting;
mod alone;
mod pairs;

use std::path::Path;

use dappo_learn::envs::EnvFactory;
use dappo_learn::error::{LearnError, Result};
use dappo_learn::faults::Faults;
use dappo_learn::fleet::Fleet;
use dappo_sim::memory::Bytes;
use dappo_sim::rng::env_keys;
use dappo_sim::{Backend, Severity};

use super::dataset::{DatasetHeader, Part, Record, Shard, check_piece};
use super::{Protocol, Subject, Timing};
pub use acting::ActingPolicy;
use alone::Alone;
use pairs::Pairs;

/// Robots simulated at once, about.
const ENVS: usize = 1024;

/// What to collect.
#[derive(Debug, Clone)]
pub struct CollectConfig {
    /// Number of rollouts over all shards.
    pub rollouts: usize,
    /// Steps in a window.
    pub timesteps: usize,
    /// Seed of the rollouts.
    pub seed: u64,
    /// Onset of the damage, and mode of the twin.
    pub protocol: Protocol,
    /// The piece to collect.
    pub shard: Shard,
    /// Severity of the damage, as the class table has it.
    pub severity: Severity,
}

/// Observer of a collection.
pub trait CollectObserver {
    /// Called once before the first block, with the room that the missing rollouts will take on the disk; an error
    /// ends the collection.
    fn begin(&mut self, missing: usize, bytes: u64) -> Result<()>;

    /// Called after every block of rollouts: how many are done, those of earlier commands included.
    fn collected(&mut self, done: usize, total: usize);

    /// Whether to stop after the current block.
    fn should_stop(&self) -> bool;
}

/// How a collection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Collected {
    /// Rollouts of this shard in the folder.
    pub rollouts: usize,
    /// Robots whose physics diverged in this command; each went on from its reference pose.
    pub diverged: u64,
    /// Whether the observer stopped it before the end.
    pub interrupted: bool,
}

/// Simulates the robots of several rollouts at once.
trait Recorder: Send {
    /// Simulates the robots.
    fn backend(&self) -> &dyn Backend;

    /// Divergences so far.
    fn diverged(&self) -> u64;

    /// One record for each of the rollouts with these random keys, as many as the block has.
    fn simulate_block(&mut self, keys: &[u64]) -> Result<Vec<Record>>;
}

/// The header of the dataset that a collection makes.
fn header(
    config: &CollectConfig,
    factory: &dyn EnvFactory,
    expert: &ActingPolicy<'_>,
    policy: Option<&ActingPolicy<'_>>,
    backend: &dyn Backend,
) -> DatasetHeader {
    let task = backend.task();
    DatasetHeader {
        format: DatasetHeader::format(),
        subject: Subject::new(&factory.robot().name, factory.space()),
        severity: config.severity,
        seed: config.seed,
        timesteps: config.timesteps,
        obs_dim: task.obs_dim(),
        action_dim: task.layout().nu,
        timing: config.protocol.timing,
        twin: config.protocol.twin,
        expert: expert.id().clone(),
        policy: policy.unwrap_or(expert).id().clone(),
        backend: backend.physics().backend().into(),
        precision: backend.physics().precision().into(),
    }
}

/// Fails if a collection cannot be made: for settings outside their range, and if it needs twins that start mid-episode but
/// the observation does not determine the state. [`collect`] checks the same; a caller that writes files before it
/// checks first.
pub fn check(
    config: &CollectConfig,
    factory: &dyn EnvFactory,
    policy: Option<&ActingPolicy<'_>>,
) -> Result<()> {
    config.check()?;
    if config.protocol.twin.is_none() && policy.is_some() {
        return Err(LearnError::Invalid(
            "without a twin, one policy walks before and during the recording; leave out `policy`".into(),
        ));
    }
    if config.protocol.synchronises_twins() {
        Fleet::new(factory.backend(1, None, factory.evaluation_physics())?).check_twins()?;
    }
    Ok(())
}

/// Collects the rollouts of a shard that `folder` does not hold yet. `policy` is the policy before the window; the
/// expert for `None`.
///
/// Rollout r starts from a state drawn from (seed, r) alone, so the records depend neither on the shards nor on the
/// number of threads.
pub fn collect(
    config: &CollectConfig,
    factory: &dyn EnvFactory,
    expert: &ActingPolicy<'_>,
    policy: Option<&ActingPolicy<'_>>,
    folder: &Path,
    observer: &mut dyn CollectObserver,
) -> Result<Collected> {
    check(config, factory, policy)?;
    let classes = factory.space().classes().len();
    let range = config.shard.range(config.rollouts);
    Bytes::of(range.end, 2 * size_of::<u64>()).require(&format!("the seeds of {} rollouts", range.end))?;
    let keys = &env_keys(config.seed, range.end)[range.clone()];
    let block = (ENVS / classes).clamp(1, keys.len().max(1));
    let mut recorder = recorder(config, factory, expert, policy, block)?;
    let header = header(config, factory, expert, policy, recorder.backend());
    // Two blocks at a time, and the bytes of one.
    Bytes::of(3 * block, header.record_bytes() as usize)
        .require(&format!("{block} rollouts of {classes} damage classes with {} steps", config.timesteps))?;
    header.write_or_match(folder)?;
    if range.is_empty() {
        // With more pieces than rollouts some have none, and no file.
        return Ok(Collected { rollouts: 0, diverged: 0, interrupted: false });
    }
    check_piece(folder, &header, &range)?;
    let mut part = Part::open(folder, &header, range.start)?;
    let missing = keys.len().saturating_sub(part.count());
    observer.begin(missing, (missing as u64).saturating_mul(header.record_bytes()))?;
    let mut ready = Vec::new();
    // An earlier command may have collected more than this one requests.
    for next in keys.get(part.count()..).unwrap_or_default().chunks(block) {
        // The disk takes one block while the next is simulated.
        let (simulated, appended) =
            rayon::join(|| simulate(recorder.as_mut(), block, next), || part.append(&ready));
        appended?;
        ready = simulated?;
        observer.collected(part.count(), keys.len());
        if observer.should_stop() {
            break;
        }
    }
    part.append(&ready)?;
    observer.collected(part.count(), keys.len());
    let interrupted = part.count() < keys.len();
    Ok(Collected { rollouts: part.count(), diverged: recorder.diverged(), interrupted })
}

/// What simulates `block` rollouts at once.
fn recorder<'a>(
    config: &CollectConfig,
    factory: &dyn EnvFactory,
    expert: &'a ActingPolicy<'a>,
    policy: Option<&'a ActingPolicy<'a>>,
    block: usize,
) -> Result<Box<dyn Recorder + 'a>> {
    let robots =
        factory.backend(block * factory.space().classes().len(), None, factory.evaluation_physics())?;
    for one in [expert, policy.unwrap_or(expert)] {
        one.check(&factory.robot().name, robots.task().obs_dim())?;
    }
    Ok(match config.protocol.twin {
        Some(twin) => {
            Box::new(Pairs::new(config, twin, factory, [expert, policy.unwrap_or(expert)], robots)?)
        }
        None => Box::new(Alone::new(config, factory.space(), expert, robots)),
    })
}

/// One record for each of the rollouts with these random keys, at most as many as the block has.
fn simulate(recorder: &mut dyn Recorder, block: usize, keys: &[u64]) -> Result<Vec<Record>> {
    // A block that is not full is filled up with the first rollout again.
    let mut records = recorder.simulate_block(&[keys, &vec![keys[0]; block - keys.len()]].concat())?;
    records.truncate(keys.len());
    Ok(records)
}

impl CollectConfig {
    fn check(&self) -> Result<()> {
        self.protocol.timing.check()?;
        let mut faults = Faults::default();
        for (key, value) in [("rollouts", self.rollouts), ("timesteps", self.timesteps)] {
            faults.count(key, value as u64, i32::MAX as u64);
        }
        let Timing { onset, delay } = self.protocol.timing;
        let shortest = u64::from(onset.first) + u64::from(delay.first);
        if self.protocol.twin.is_none() {
            let expected = "at least 1: a window must show the damage";
            faults.rule("delay", delay.first, expected, delay.first > 0);
            let expected =
                format!("at most {shortest}, the first onset and delay together, where a window may end");
            faults.rule("timesteps", self.timesteps, &expected, self.timesteps as u64 <= shortest);
        }
        Ok(faults.end()?)
    }
}
