//! Simulating the pairs of several rollouts at once.

use dappo_learn::envs::EnvFactory;
use dappo_learn::error::Result;
use dappo_learn::fleet::Fleet;
use dappo_sim::backend::{Backend, Reset};

use super::{ActingPolicy, CollectConfig, Recorder};
use crate::dataset::Record;
use crate::{Timing, Twin, TwinAction};

/// The robots of `block` rollouts, one for each damage class, and their twins.
pub(super) struct Pairs<'a> {
    expert: &'a ActingPolicy<'a>,
    policy: &'a ActingPolicy<'a>,
    timing: Timing,
    twin: Twin,
    timesteps: usize,
    classes: usize,
    robots: Fleet,
    /// Twins of their own, where the run of class 0 is not the twin of all.
    twins: Option<Fleet>,
}

impl<'a> Pairs<'a> {
    /// `robots` simulates the robots; `expert` and `policy` act in the window and before it.
    pub fn new(
        config: &CollectConfig,
        twin: Twin,
        factory: &dyn EnvFactory,
        [expert, policy]: [&'a ActingPolicy<'a>; 2],
        robots: Box<dyn Backend>,
    ) -> Result<Self> {
        let envs = robots.num_envs();
        let twins = || factory.backend(envs, None, factory.evaluation_physics()).map(Fleet::new);
        Ok(Self {
            expert,
            policy,
            timing: config.protocol.timing,
            twin,
            timesteps: config.timesteps,
            classes: factory.space().classes().len(),
            robots: Fleet::new(robots),
            twins: config.protocol.needs_twins().then(twins).transpose()?,
        })
    }

    /// From the start of each rollout to the step at which its window begins.
    fn walk(&mut self, keys: &[u64], timings: &[(u32, u32)]) -> Result<()> {
        let classes = self.classes;
        let class_at_start = |onset: u32, class: usize| if onset == 0 { class } else { 0 };
        let resets: Vec<Reset> = (0..keys.len() * classes)
            .map(|env| {
                let (onset, _) = timings[env / classes];
                let class = class_at_start(onset, env % classes);
                Reset { env, class, key: keys[env / classes], episode: 0 }
            })
            .collect();
        self.robots.reset(&resets)?;
        let starts: Vec<u32> = timings.iter().map(|(onset, delay)| onset + delay).collect();
        for step in 0..=starts.iter().copied().max().unwrap_or(0) {
            let struck: Vec<(usize, usize)> = (0..resets.len())
                .filter(|env| step > 0 && timings[env / classes].0 == step)
                .map(|env| (env, env % classes))
                .collect();
            self.robots.set_classes(&struck)?;
            let skip: Vec<bool> = (0..resets.len()).map(|env| step >= starts[env / classes]).collect();
            if skip.contains(&false) {
                let actions = self.policy.healthy_actions(&self.robots.obs)?;
                self.robots.step(&actions, &skip)?;
            }
        }
        Ok(())
    }

    /// Synchronises every twin with its robot: with the same start at a reset, with the observed state later.
    fn begin_twins(&mut self, keys: &[u64]) -> Result<()> {
        if !self.timing.starts_at_reset() {
            return self.synchronise_twins();
        }
        let Some(twins) = &mut self.twins else { return Ok(()) };
        let classes = self.classes;
        let reset = |env: usize| Reset { env, class: 0, key: keys[env / classes], episode: 0 };
        twins.reset(&(0..keys.len() * classes).map(reset).collect::<Vec<_>>())
    }

    /// Sets every twin to the state that its robot observes.
    fn synchronise_twins(&mut self) -> Result<()> {
        let Some(twins) = &mut self.twins else { return Ok(()) };
        twins.resync(&self.robots.obs, &vec![false; self.robots.fallen.len()])
    }

    /// The steps that are recorded.
    fn record_window(&mut self, records: &mut [Record]) -> Result<()> {
        let (classes, steps, width) = (self.classes, self.timesteps, self.robots.backend().task().obs_dim());
        let action_dim = self.robots.backend().task().layout().nu;
        for record in records.iter_mut() {
            record.damaged = vec![0.0; classes * steps * width];
            record.actions = vec![0.0; classes * steps * action_dim];
            record.twin = vec![0.0; if self.twins.is_some() { classes * steps * width } else { 0 }];
        }
        let skip = vec![false; self.robots.fallen.len()];
        for step in 0..steps {
            let actions = self.expert.healthy_actions(&self.robots.obs)?;
            if self.twin.resyncs_before(step) {
                self.synchronise_twins()?;
            }
            if let Some(twins) = &mut self.twins {
                match self.twin.action {
                    TwinAction::Own => twins.step(&self.expert.healthy_actions(&twins.obs)?, &skip)?,
                    TwinAction::Shared => twins.step(&actions, &skip)?,
                }
            }
            self.robots.step(&actions, &skip)?;
            for (rollout, record) in records.iter_mut().enumerate() {
                for class in 0..classes {
                    let (env, row) = (rollout * classes + class, class * steps + step);
                    record.damaged[row * width..][..width].copy_from_slice(self.robots.row(env));
                    record.actions[row * action_dim..][..action_dim]
                        .copy_from_slice(&actions[env * action_dim..][..action_dim]);
                    if let Some(twins) = &self.twins {
                        record.twin[row * width..][..width].copy_from_slice(twins.row(env));
                    }
                }
            }
        }
        Ok(())
    }
}

impl Recorder for Pairs<'_> {
    fn backend(&self) -> &dyn Backend {
        self.robots.backend()
    }

    fn diverged(&self) -> u64 {
        self.robots.divergences + self.twins.as_ref().map_or(0, |twins| twins.divergences)
    }

    fn simulate_block(&mut self, keys: &[u64]) -> Result<Vec<Record>> {
        let timings: Vec<(u32, u32)> = keys.iter().map(|&key| self.timing.draw(key)).collect();
        self.walk(keys, &timings)?;
        let mut records: Vec<Record> = timings
            .into_iter()
            .zip(self.robots.fallen.chunks(self.classes))
            .map(|((onset, delay), fallen)| Record {
                onset,
                delay,
                fallen: fallen.to_vec(),
                ..Record::default()
            })
            .collect();
        self.begin_twins(keys)?;
        self.record_window(&mut records)?;
        Ok(records)
    }
}
