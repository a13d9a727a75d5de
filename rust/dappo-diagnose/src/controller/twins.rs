//! Diagnosis by comparison with twins: when a robot does not move as expected, the expert acts for the length of a window,
//! the diagnoser compares robot and twin, and the policy resumes with the code of the diagnosed damage.
//!
//! ```text
//! walking ── suspicion ──▶ diagnosis window (T steps, expert) ── diagnosis ──▶ walking, new assumed class
//! ```

use dappo_learn::error::Result;
use dappo_learn::fleet::Fleet;
use dappo_learn::walk::EventKind;
use dappo_nn::CLIP;
use dappo_sim::backend::{Backend, Reset};

use super::common::Common;
use super::pair::Pair;
use super::probation::{Probation, Rebuttal};
use super::suspicion::Evidence;
use super::{ControllerConfig, Skills, Trigger};
use crate::{Twin, TwinAction, Window};

/// The twins of N robots, and the evidence for their damage.
pub(super) struct Twins {
    /// How they run during a diagnosis window.
    mode: Twin,
    pairs: Vec<Pair>,
    /// What the difference between robot and twin is multiplied by, see [`Skills::compared`], `[O]`.
    scale: Vec<f32>,
    /// Forward velocity of the policy with the true code, m/s, `[C]`.
    baselines: Vec<f64>,
    fleet: Fleet,
}

impl Twins {
    /// Twins in mode `mode`; fails unless they can be set to what the robots observe.
    pub fn new(
        skills: &Skills,
        config: &ControllerConfig,
        mode: Twin,
        twins: Box<dyn Backend>,
    ) -> Result<Self> {
        let robots = twins.num_envs();
        let scale = skills.compared(twins.task())?;
        let baselines = skills.baselines()?.to_vec();
        let mut fleet = Fleet::new(twins);
        fleet.check_twins()?;
        fleet
            .reset(&(0..robots).map(|env| Reset { env, class: 0, key: 0, episode: 0 }).collect::<Vec<_>>())?;
        let pairs = (0..robots).map(|_| Pair::new(config)).collect();
        Ok(Self { mode, pairs, scale, baselines, fleet })
    }

    pub fn reset(&mut self, index: usize, config: &ControllerConfig) {
        self.pairs[index] = Pair::new(config);
    }

    /// Judges all robots by their last step, and chooses their next actions.
    pub fn step(&mut self, common: &mut Common, forward_velocity: &[f64]) -> Result<()> {
        for (index, &velocity) in forward_velocity.iter().enumerate() {
            self.judge(common, index, velocity)?;
        }
        self.choose_actions(common)?;
        self.predict(common)
    }

    /// Compares a robot with its twin: continues a diagnosis window, or checks whether one is needed.
    fn judge(&mut self, common: &mut Common, index: usize, velocity: f64) -> Result<()> {
        let pair = &mut self.pairs[index];
        let observed = common.row(index);
        let predicted =
            (pair.has_prediction && !common.robots[index].is_blind && !self.fleet.diverged[index])
                .then(|| self.fleet.row(index));
        pair.has_prediction = false;
        if let Some(window) = &mut pair.window {
            let Some(twin) = predicted else { return Ok(()) };
            window.damaged.extend(observed);
            window.twin.extend(twin);
            window.actions.extend(common.action(index));
            let full = common.skills.diagnoser.description().timesteps * common.obs_dim();
            return if window.damaged.len() == full { self.diagnose(common, index) } else { Ok(()) };
        }
        let residual = predicted.map(|twin| distance(twin, observed, &self.scale));
        if let Some((probation, residual)) = pair.probation.as_mut().zip(residual)
            && let Some(verdict) = probation.weigh(&common.config, residual)
        {
            pair.probation = None;
            if let Err(rebuttal) = verdict {
                withdraw(common, index, rebuttal);
            }
        }
        let expected = self.baselines[common.robots[index].class];
        if let Some(evidence) = pair.suspicion.weigh(&common.config, velocity, residual, expected) {
            pair.window = Some(Window::default());
            pair.probation = None;
            let Evidence { forward_velocity, residual } = evidence;
            common.event(index, EventKind::Suspected { forward_velocity, expected, residual });
        }
        Ok(())
    }

    /// Ends a diagnosis window: diagnoses the damage, and accepts the diagnosis if its probability is high
    /// enough.
    fn diagnose(&mut self, common: &mut Common, index: usize) -> Result<()> {
        let Some(window) = self.pairs[index].window.take() else { return Ok(()) };
        let (class, confidence) = common.skills.diagnoser.diagnose(&window)?;
        let accepted = common.config.accepts(confidence);
        common.event(index, EventKind::Diagnosed { class, confidence, accepted });
        let healthy = self.residuals(&window, common.obs_dim());
        let pair = &mut self.pairs[index];
        pair.suspicion.rest(&common.config);
        if accepted && class != 0 {
            pair.probation = Probation::new(&common.config, &healthy);
        }
        if accepted && class != common.robots[index].class {
            common.assume(index, class);
        }
        Ok(())
    }

    /// Residuals of the healthy twin in a diagnosis window; none unless it was re-synchronised before every step,
    /// as the twin of a walking robot is.
    fn residuals(&self, window: &Window, width: usize) -> Vec<f64> {
        let rows = window.twin.chunks_exact(width).zip(window.damaged.chunks_exact(width));
        let is_synchronised = (1..rows.len()).all(|row| self.mode.resyncs_before(row));
        rows.filter(|_| is_synchronised)
            .map(|(twin, observed)| distance(twin, observed, &self.scale))
            .collect()
    }

    /// The expert's actions for robots in a diagnosis window, those of the policy for the others.
    fn choose_actions(&self, common: &mut Common) -> Result<()> {
        let (in_window, walking): (Vec<usize>, Vec<usize>) =
            (0..self.pairs.len()).partition(|&index| self.pairs[index].window.is_some());
        common.walk(&walking)?;
        if !in_window.is_empty() {
            let rows: Vec<f32> = in_window.iter().flat_map(|&index| common.row(index)).copied().collect();
            let chosen = common.skills.expert.healthy_actions(&rows)?;
            common.act(&in_window, &chosen);
        }
        Ok(())
    }

    /// Predicts the next observations with the twins of this step.
    ///
    /// The twin of a robot in a diagnosis window is healthy and runs as in the training of the diagnoser. That of a
    /// walking robot has the damage of the assumed class, is re-synchronised before every step and takes the
    /// action of the robot.
    fn predict(&mut self, common: &Common) -> Result<()> {
        let (width, watches) = (common.obs_dim(), common.config.trigger == Some(Trigger::Residual));
        let robots = self.pairs.len();
        let mut classes = Vec::new();
        let (mut skip_sync, mut skip_step) = (vec![true; robots], vec![true; robots]);
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            let class = if pair.window.is_some() { 0 } else { common.robots[index].class };
            if class != pair.twin_class {
                pair.twin_class = class;
                classes.push((index, class));
            }
            skip_sync[index] = match &pair.window {
                Some(window) => {
                    let row = window.damaged.len() / width;
                    row > 0 && !self.mode.resyncs_before(row)
                }
                None => !watches,
            };
            skip_step[index] = pair.window.is_none() && !watches;
            pair.has_prediction = !skip_step[index];
        }
        self.fleet.set_classes(&classes)?;
        if !skip_step.contains(&false) {
            return Ok(());
        }
        if skip_sync.contains(&false) {
            self.fleet.resync(&common.obs, &skip_sync)?;
        }
        let mut actions = common.actions.clone();
        if self.mode.action == TwinAction::Own {
            let own = common.skills.expert.healthy_actions(&self.fleet.obs)?;
            let action_dim = common.action_dim();
            let rows = actions.chunks_exact_mut(action_dim).zip(own.chunks_exact(action_dim));
            for ((action, own), pair) in rows.zip(&self.pairs) {
                if pair.window.is_some() {
                    action.copy_from_slice(own);
                }
            }
        }
        self.fleet.step(&actions, &skip_step)
    }
}

/// Withdraws a diagnosis that explains the robot no better than no damage does.
fn withdraw(common: &mut Common, index: usize, Rebuttal { residual, healthy }: Rebuttal) {
    let class = common.robots[index].class;
    common.event(index, EventKind::Withdrawn { class, residual, healthy });
    common.assume(index, 0);
}

/// Root mean square of the difference between two observations over the entries whose `scale` is not 0, in standard
/// deviations, each clipped to ±[`CLIP`].
fn distance(one: &[f32], other: &[f32], scale: &[f32]) -> f64 {
    let compared = one.iter().zip(other).zip(scale).filter(|(_, scale)| **scale > 0.0);
    let (count, squares) = compared.fold((0.0, 0.0), |(count, squares), ((one, other), scale)| {
        let difference = f64::from(((one - other) * scale).clamp(-CLIP, CLIP));
        (count + 1.0, squares + difference * difference)
    });
    f64::sqrt(squares / f64::max(count, 1.0))
}
