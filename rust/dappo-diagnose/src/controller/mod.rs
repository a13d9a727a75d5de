//! The run-time loop: one trial, no reset. A robot walks under the damage-aware policy, which is given the code of the
//! assumed damage class; its damage is diagnosed while it walks.
//!
//! The inputs of a [`Controller`] are observations and velocities alone, as on a real robot; the true damage
//! class is never one of them.

mod common;
mod config;
mod observation;
mod pair;
mod parts;
mod probation;
mod skills;
mod suspicion;
mod twins;

use dappo_learn::error::{LearnError, Result};
use dappo_learn::walk::{Event, Onboard};
use dappo_nn::Policy;
use dappo_nn::error::check_length;
use dappo_sim::backend::Backend;

use common::Common;
pub use config::{CodeSource, ControllerConfig, Trigger};
use observation::Observation;
pub use parts::Parts;
pub use skills::Skills;
use twins::Twins;

/// Controls N robots independently. O = length of an observation without damage code, A = of an action.
pub struct Controller {
    common: Common,
    watch: Watch,
}

/// How damage is recognised.
enum Watch {
    Twins(Box<Twins>),
    Observation(Observation),
}

impl Controller {
    /// A controller of N robots. `twins` makes the backend that simulates a twin of each, if the trigger needs them.
    pub fn new(
        skills: Skills,
        config: ControllerConfig,
        robots: usize,
        twins: impl FnOnce() -> Result<Box<dyn Backend>>,
    ) -> Result<Self> {
        let description = skills.diagnoser.description();
        let config = config.resolved(description)?;
        skills.check()?;
        let (mode, timesteps) = (description.twin, description.timesteps);
        let watch = match mode.filter(|_| config.trigger != Some(Trigger::Observation)) {
            Some(mode) => {
                let twins = twins()?;
                skills.check_robot(twins.as_ref())?;
                Watch::Twins(Box::new(Twins::new(&skills, &config, mode, twins)?))
            }
            None => Watch::Observation(Observation::new(robots, timesteps)),
        };
        Ok(Self { common: Common::new(skills, config, robots), watch })
    }

    /// Number of robots, N.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.common.robots.len()
    }

    /// The assumed class of each robot, `[N]`.
    #[must_use]
    pub fn classes(&self) -> Vec<usize> {
        self.common.robots.iter().map(|robot| robot.class).collect()
    }

    /// The damage-aware policy.
    #[must_use]
    pub fn policy(&self) -> &Policy {
        &self.common.skills.policy
    }

    /// Names of the damage classes.
    #[must_use]
    pub fn class_names(&self) -> &[String] {
        &self.common.skills.diagnoser.description().subject.class_names
    }

    /// The events since the controller was made or its events were taken, in order.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.common.events
    }

    /// Whether it makes use of forward velocities.
    #[must_use]
    pub fn uses_velocity(&self) -> bool {
        matches!(self.watch, Watch::Twins(_))
    }

    /// Length of an observation without damage code, O.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.common.obs_dim()
    }

    /// Length of an action, A.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.common.action_dim()
    }

    /// Resets the robots marked in `mask`, all for `None`: they are assumed healthy, and earlier readings are
    /// discarded, so that a reading that is lost before its first finite value counts as 0.
    ///
    /// # Shapes
    /// mask `[N]`
    pub fn reset(&mut self, mask: Option<&[bool]>) -> Result<()> {
        mask.map_or(Ok(()), |mask| check_length("reset mask [N]", mask, self.robots()))?;
        for index in (0..self.robots()).filter(|&index| mask.is_none_or(|mask| mask[index])) {
            self.common.reset(index);
            match &mut self.watch {
                Watch::Twins(twins) => twins.reset(index, &self.common.config),
                Watch::Observation(observation) => observation.reset(index),
            }
        }
        Ok(())
    }
}

impl Onboard for Controller {
    /// The next actions. To be called once a control step, with what the robots observe and how fast they walk.
    ///
    /// Readings that are not finite are replaced by the last finite ones, so that a row of NaN marks a step
    /// whose readings were lost. The actions are always finite.
    ///
    /// # Shapes
    /// - `obs`: `[N, O]`, without damage code
    /// - `forward_velocity`: `[N]`, m/s, not finite where it was not measured; empty if it is [not
    ///   used](Controller::uses_velocity)
    /// - output: `[N, A]`
    fn act(&mut self, obs: &[f32], forward_velocity: &[f64]) -> Result<Vec<f32>> {
        check_length("obs [N, O]", obs, self.common.obs.len())?;
        if self.uses_velocity() && forward_velocity.is_empty() {
            return Err(LearnError::Invalid(
                "a controller with twins needs the forward velocity of every robot, m/s; give NaN where it is unknown"
                    .into(),
            ));
        }
        if !forward_velocity.is_empty() {
            check_length("forward_velocity [N]", forward_velocity, self.robots())?;
        }
        self.common.sense(obs);
        match &mut self.watch {
            Watch::Twins(twins) => twins.step(&mut self.common, forward_velocity)?,
            Watch::Observation(observation) => observation.step(&mut self.common)?,
        }
        for robot in &mut self.common.robots {
            robot.step += 1;
        }
        Ok(self.common.actions.clone())
    }

    fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.common.events)
    }
}
