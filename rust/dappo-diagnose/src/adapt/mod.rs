//! Episodes with mid-episode damage: a controller compared with the same policy with fixed damage codes and
//! with a policy without damage code, such as PPO-Unaware.

mod class;
mod outcome;
mod summary;
#[cfg(test)]
mod tests;
mod text;
mod trace;

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::Result;
use dappo_learn::walk::{Agent, Encoding, KnownClasses, MeanActions, Trial, Walks};

use crate::controller::Controller;

pub use class::{AssumedClass, ClassOutcome, Tracking};
pub use summary::{AdaptationSummary, DecisionTime};
pub use trace::trace;

/// The walks of all agents of one trial.
pub struct Contest {
    /// The controller's.
    pub adapted: Walks,
    /// Those of the policy with the code of the active damage, where there is one.
    pub oracle: Walks,
    /// Those of the policy with the code of a healthy robot.
    pub no_adaptation: Walks,
    /// Those of a policy without damage code, such as PPO-Unaware.
    pub unaware: Option<Walks>,
}

impl Contest {
    /// Runs the episodes of a trial with all agents; `None` once `stop` returns true.
    ///
    /// `unaware` is a policy that observes no damage code, and the envs as it observes them.
    pub fn run(
        trial: &Trial,
        controller: &mut Controller,
        unaware: Option<(&dyn MeanActions, &dyn EnvFactory)>,
        classes: &KnownClasses,
        (config, factory): (&Config, &dyn EnvFactory),
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Self>> {
        let run = |mut agent: Agent<'_>| trial.run(&mut agent, config, factory, stop);
        let Some(adapted) = run(Agent::Onboard(controller))? else { return Ok(None) };
        let policy = controller.policy();
        let encoded = |encoding| Agent::Encoded(policy, classes, encoding);
        let Some(oracle) = run(encoded(Encoding::True))? else { return Ok(None) };
        let Some(no_adaptation) = run(encoded(Encoding::Zero))? else { return Ok(None) };
        let unaware = match unaware {
            None => None,
            Some((policy, factory)) => match trial.run(&mut Agent::Unaware(policy), config, factory, stop)? {
                None => return Ok(None),
                walks => walks,
            },
        };
        Ok(Some(Self { adapted, oracle, no_adaptation, unaware }))
    }
}
