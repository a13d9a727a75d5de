//! Training: collect, estimate, update, report — and what surrounds it.

mod session;

use std::time::Instant;

use dappo_nn::Policy;
use dappo_sim::curriculum::stage_at;

use crate::checkpoint::{Checkpoint, Progress};
use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};
use crate::gae::gae;
use crate::metrics::{EvaluationMeans, Metrics};
use crate::ppo::PpoConfig;
use crate::robot_files::RobotFiles;
use crate::run_folder::LockedRun;

use session::Session;

/// Observer of a training run.
pub trait Observer {
    /// Called after every iteration.
    fn iteration(&mut self, metrics: &Metrics);

    /// Whether to save and stop after the current iteration.
    fn should_stop(&self) -> bool;
}

/// How a training run ended.
pub struct TrainingOutcome {
    /// The trained policy.
    pub policy: Policy,
    /// Progress of the run.
    pub progress: Progress,
    /// Whether the observer stopped it before its budget was spent.
    pub interrupted: bool,
}

/// What the folder of a resumed run holds from now on.
pub struct Resumption {
    /// Its configuration.
    pub config: Config,
    /// The robot, if it is another than the run has kept.
    pub robot: Option<RobotFiles>,
}

/// Trains until the budget is spent. A run resumes from its newest checkpoint when `resume` is given; one
/// that was stopped before its first checkpoint starts again.
pub fn train(
    config: &Config,
    factory: &dyn EnvFactory,
    run: &LockedRun,
    resume: Option<&Resumption>,
    observer: &mut dyn Observer,
) -> Result<TrainingOutcome> {
    let mut session = Session::new(config, factory)?;
    let is_fresh = !run.has_metrics() && !Checkpoint::any(&run.checkpoints())?;
    if resume.is_some() && !is_fresh {
        session.load(run, config)?;
    } else {
        session.save(run)?;
    }
    if let Some(Resumption { config, robot }) = resume {
        // Only now, when it is certain that the run can be resumed.
        if let Some(robot) = robot {
            run.keep_robot(robot)?;
        }
        run.change(config, session.progress)?;
    }
    let mut interrupted = false;
    while session.progress.env_steps < config.total_steps && !interrupted {
        let mut metrics = iterate(&mut session, config, factory)
            .map_err(|error| with_advice(error, config, run, session.progress.iteration + 1))?;
        if config.evaluation.every.is_some_and(|every| metrics.iteration.is_multiple_of(every))
            && let Some(evaluation) = session.evaluate(config, factory, &|| observer.should_stop())?
        {
            metrics.evaluation = EvaluationMeans::from(&evaluation);
        }
        run.append_metrics(&metrics)?;
        observer.iteration(&metrics);
        interrupted = observer.should_stop();
        let finished = session.progress.env_steps >= config.total_steps;
        if interrupted || finished || session.progress.iteration.is_multiple_of(config.checkpoint.every) {
            session.save(run)?;
        }
    }
    Ok(TrainingOutcome { progress: session.progress, policy: session.ppo.frozen()?.policy, interrupted })
}

/// Adds to the error of a diverged training how to resume it: nothing of it has been saved since the newest
/// checkpoint.
fn with_advice(error: LearnError, config: &Config, run: &LockedRun, iteration: u64) -> LearnError {
    let LearnError::Diverged { what, got, .. } = error else { return error };
    let PpoConfig { learning_rate, value_learning_rate, .. } = config.ppo;
    let advice = format!(
        "resume from the newest checkpoint with smaller steps, for example with half the learning rates: dappo-batch \
         train --resume {} --set ppo.learning_rate={:?} ppo.value_learning_rate={:?}; if it diverges again, remove the \
         newest folder in checkpoints/ to resume from the one before",
        run.root().display(),
        learning_rate / 2.0,
        value_learning_rate / 2.0
    );
    LearnError::Diverged { what: format!("in iteration {iteration} the {what}"), got, advice }
}

/// One iteration.
fn iterate(session: &mut Session, config: &Config, factory: &dyn EnvFactory) -> Result<Metrics> {
    let done = session.progress.env_steps as f64 / config.total_steps as f64;
    session.enter_stage(stage_at(&config.curriculum, done), config, factory)?;

    let start = Instant::now();
    let rollout = session.collect()?;
    let collected = Instant::now();
    let targets = gae(&rollout, config.ppo.gamma, config.ppo.gae_lambda)?;
    let losses = session.ppo.update(&rollout, &targets, done)?;
    let updated = Instant::now();

    session.progress.iteration += 1;
    session.progress.env_steps += rollout.len() as u64;
    let reward_terms = session.reward_terms();
    Ok(Metrics {
        iteration: session.progress.iteration,
        env_steps: session.progress.env_steps,
        stage: config.curriculum[session.progress.stage].name.clone(),
        episodes: session.episodes.summarize(),
        tracking: session.tracking(&reward_terms),
        reward_terms,
        diverged: session.diverged(),
        evaluation: EvaluationMeans::default(),
        simulator: factory.simulator(factory.training_physics()),
        losses,
        rollout_seconds: (collected - start).as_secs_f64(),
        update_seconds: (updated - collected).as_secs_f64(),
    })
}
