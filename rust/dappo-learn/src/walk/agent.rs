//! The agents of a trial, and where the damage code of every step comes from.

use dappo_nn::{Policy, PolicyState};
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::vector_env::VectorEnv;

use super::encoding::{another_class, fair_bit};
use super::{Encoding, Event, KnownClasses};
use crate::error::Result;

/// Chooses actions from raw observations.
pub trait MeanActions {
    /// What it remembers of `robots` robots at the start of their episodes.
    fn initial_state(&self, _robots: usize) -> PolicyState {
        PolicyState::default()
    }

    /// The actions without exploration noise; what it remembers of each robot goes on by a step.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`, the damage code included if the policy observes it; the state of N robots
    /// - output: `[N, action_dim]`
    fn mean_actions(&self, obs: &[f32], state: &mut PolicyState) -> Result<Vec<f32>>;
}

impl<T: MeanActions + ?Sized> MeanActions for &T {
    fn initial_state(&self, robots: usize) -> PolicyState {
        (**self).initial_state(robots)
    }

    fn mean_actions(&self, obs: &[f32], state: &mut PolicyState) -> Result<Vec<f32>> {
        (**self).mean_actions(obs, state)
    }
}

impl MeanActions for Policy {
    fn initial_state(&self, robots: usize) -> PolicyState {
        self.initial_state(robots)
    }

    fn mean_actions(&self, obs: &[f32], state: &mut PolicyState) -> Result<Vec<f32>> {
        Ok(self.step(obs, state)?)
    }
}

/// Chooses the actions of all robots of a trial.
pub enum Agent<'a> {
    /// A policy that observes no damage code.
    Unaware(&'a dyn MeanActions),
    /// A policy whose damage code is an encoding of the active damage.
    Encoded(&'a dyn MeanActions, &'a KnownClasses, Encoding),
    /// A policy with the damage code of a given class for each row of the trial, `[rows]`.
    Given(&'a dyn MeanActions, &'a KnownClasses, &'a [usize]),
    /// A controller, which diagnoses the damage.
    Onboard(&'a mut dyn Onboard),
}

/// Chooses actions as on a real robot: from observations and velocities alone.
pub trait Onboard {
    /// The next actions of all robots.
    ///
    /// # Shapes
    /// - `obs`: `[N, O]`, without damage code; `forward_velocity`: `[N]`, m/s
    /// - output: `[N, A]`
    fn act(&mut self, obs: &[f32], forward_velocity: &[f64]) -> Result<Vec<f32>>;

    /// Its events since the last call.
    fn take_events(&mut self) -> Vec<Event>;
}

/// The damage codes behind the observations of a trial's episodes.
pub(super) struct Codes<'a> {
    /// The code of each class.
    table: &'a [Vec<f32>],
    source: Source,
}

enum Source {
    None,
    /// The active class, or the one before while the code is late.
    True,
    /// The class of each episode, `[N]`.
    Held(Vec<usize>),
    /// Fair bits from one stream an episode, `[N]`.
    Noise(Vec<Stream>),
}

impl<'a> Agent<'a> {
    /// The damage codes of episodes with these random keys and damage classes.
    ///
    /// # Shapes
    /// - `keys`: `[N]`, `classes`: `[N]`, those of a row side by side
    pub(super) fn codes(&self, keys: &[u64], classes: &[usize]) -> Codes<'a> {
        // The episodes of one key, one in each class, share their start state but not their draws.
        let streams = || {
            let one = |(&key, &class): (&u64, &usize)| Stream::new(key, class as u64, Purpose::DamageCode);
            keys.iter().zip(classes).map(one)
        };
        let (known, source) = match self {
            Self::Unaware(_) | Self::Onboard(_) => return Codes { table: &[], source: Source::None },
            Self::Encoded(_, known, encoding) => {
                let source = match encoding {
                    Encoding::True => Source::True,
                    Encoding::Zero => Source::Held(vec![0; classes.len()]),
                    Encoding::Wrong => {
                        let other = |(mut stream, &class): (Stream, &usize)| {
                            another_class(&mut stream, class, known.names.len())
                        };
                        Source::Held(streams().zip(classes).map(other).collect())
                    }
                    Encoding::Random => Source::Noise(streams().collect()),
                };
                (known, source)
            }
            Self::Given(_, known, given) => {
                let episodes = classes.len() / given.len().max(1);
                let held = given.iter().flat_map(|&class| std::iter::repeat_n(class, episodes));
                (known, Source::Held(held.collect()))
            }
        };
        Codes { table: &known.codes, source }
    }

    /// What its policy remembers of `robots` robots at the start of their episodes.
    pub(super) fn initial_state(&self, robots: usize) -> PolicyState {
        match self {
            Self::Onboard(_) => PolicyState::default(),
            Self::Unaware(policy) | Self::Encoded(policy, ..) | Self::Given(policy, ..) => {
                policy.initial_state(robots)
            }
        }
    }

    /// The actions of all robots, `[N, A]`.
    pub(super) fn act(
        &mut self,
        codes: &mut Codes<'_>,
        state: &mut PolicyState,
        env: &VectorEnv,
    ) -> Result<Vec<f32>> {
        let buffers = env.buffers();
        match self {
            Self::Onboard(controller) => controller.act(&buffers.obs, &buffers.forward_velocity),
            Self::Unaware(policy) => policy.mean_actions(&buffers.obs, state),
            Self::Encoded(policy, ..) | Self::Given(policy, ..) => {
                policy.mean_actions(&codes.append(env), state)
            }
        }
    }

    /// What has happened since the last call.
    pub(super) fn take_events(&mut self) -> Vec<Event> {
        match self {
            Self::Onboard(controller) => controller.take_events(),
            _ => Vec::new(),
        }
    }
}

impl Codes<'_> {
    /// The observations of all robots, each with its damage code behind it, `[N, O + code_length]`.
    fn append(&mut self, env: &VectorEnv) -> Vec<f32> {
        let (width, buffers) = (env.obs_dim(), env.buffers());
        let code_length = self.table.first().map_or(0, Vec::len);
        let mut rows = Vec::with_capacity(env.num_envs() * (width + code_length));
        for (index, row) in buffers.obs.chunks_exact(width).enumerate() {
            rows.extend_from_slice(row);
            match &mut self.source {
                Source::None => {}
                Source::True => rows.extend_from_slice(&self.table[env.class_of_code(index)]),
                Source::Held(classes) => rows.extend_from_slice(&self.table[classes[index]]),
                Source::Noise(streams) => {
                    rows.extend((0..code_length).map(|_| fair_bit(&mut streams[index])));
                }
            }
        }
        rows
    }
}
