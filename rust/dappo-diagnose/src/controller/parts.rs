//! The parts of a controller on disk: runs and the training of a diagnoser.

use std::path::PathBuf;

use dappo_learn::RunPolicy;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::{LearnError, Result};
use dappo_learn::evaluate::MeanVelocities;
use dappo_learn::run_folder::RunFolder;

use super::{Controller, ControllerConfig, Skills};
use crate::export::{DiagnoserSource, RunSource, Sources, last_name};
use crate::{Diagnoser, TrainingFolder};

/// The parts of a controller that the run of its policy does not hold.
pub struct Parts {
    /// Run of the expert with its configuration; the policy itself with the code of a healthy robot for `None`.
    pub expert: Option<(RunFolder, Config)>,
    /// Folder of the diagnoser's training.
    pub diagnoser: PathBuf,
}

impl Parts {
    /// Reads all parts, and where they come from; `config` and `factory` are those of the policy's run `folder`.
    pub fn load(
        &self,
        folder: &RunFolder,
        config: &Config,
        factory: &dyn EnvFactory,
    ) -> Result<(Skills, Sources)> {
        let names: Vec<String> = factory.space().classes().iter().map(|class| class.name.clone()).collect();
        let policy = RunPolicy::stateless(folder, config, factory)?;
        let policy_source = RunSource::of(folder, &policy)?;
        let (expert, expert_source) = match &self.expert {
            None => (policy.policy.clone(), None),
            Some((folder, config)) => {
                let expert = RunPolicy::stateless(folder, config, factory)?;
                let source = RunSource::of(folder, &expert)?;
                (expert.policy, Some(source))
            }
        };
        let model = TrainingFolder::open(&self.diagnoser)?.0.model();
        let diagnoser = Diagnoser::load(&model)?;
        let velocities = MeanVelocities::read(folder)?;
        let baselines = match (velocities, diagnoser.description().twin) {
            (Some(velocities), Some(_)) => Some(velocities.of(&names)?),
            (None, Some(_)) => {
                let root = folder.root().display();
                return Err(LearnError::Invalid(format!(
                    "{root} has no table of mean velocities; `dappo-batch evaluate {root}` writes it"
                )));
            }
            // They are only compared with those of robots with twins.
            (_, None) => None,
        };
        if let (None, Some((expert, _))) = (diagnoser.description().twin, &self.expert) {
            return Err(LearnError::Invalid(format!(
                "the expert {} would never act: without a twin there is no diagnosis window, and the policy itself walks; \
                 leave out the expert",
                expert.root().display()
            )));
        }
        let sources = Sources {
            policy: policy_source,
            expert: expert_source,
            diagnoser: Some(DiagnoserSource {
                folder: last_name(&self.diagnoser),
                fingerprint: Diagnoser::fingerprint(&model)?,
            }),
        };
        Ok((Skills { policy: policy.policy, expert, diagnoser, baselines }, sources))
    }

    /// A controller of `robots` robots made of these parts.
    pub fn assemble(
        &self,
        folder: &RunFolder,
        config: &Config,
        factory: &dyn EnvFactory,
        settings: ControllerConfig,
        robots: usize,
    ) -> Result<Controller> {
        let (skills, _) = self.load(folder, config, factory)?;
        Controller::new(skills, settings, robots, || {
            Ok(factory.backend(robots, None, factory.evaluation_physics())?)
        })
    }
}
