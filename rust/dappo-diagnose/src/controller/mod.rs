//! The run-time loop: one trial, no reset. A robot walks under the damage-aware policy; when it does not move
//! as expected, the expert acts for the length of a window, the diagnoser compares robot and twin, and the
//! policy resumes with the code of the diagnosed damage.
//!
//! ```text
//! walking ── suspicion ──▶ diagnosis window (T steps, expert) ── diagnosis ──▶ walking, new assumed class
//! ```
//!
//! The inputs of a [`Controller`] are observations and velocities alone, as on a real robot; the true damage
//! class is never one of them.

mod config;
mod parts;
mod probation;
mod robot;
mod skills;
mod suspicion;

use dappo_learn::error::Result;
use dappo_learn::fleet::Fleet;
use dappo_learn::walk::{Event, EventKind, Onboard};
use dappo_nn::error::check_length;
use dappo_nn::{CLIP, Policy};
use dappo_sim::backend::{Backend, Reset};

use crate::{TwinAction, Window};

pub use config::{ControllerConfig, Trigger};
pub use parts::Parts;
use probation::{Probation, Rebuttal};
use robot::Robot;
pub use skills::Skills;
use suspicion::Evidence;

/// Controls N robots independently. O = length of an observation without damage code, A = of an action.
pub struct Controller {
    skills: Skills,
    config: ControllerConfig,
    /// Damage codes of all classes, `[C, code_length]`.
    codes: Vec<Vec<f32>>,
    /// What the difference between robot and twin is multiplied by, see [`Skills::compared`], `[O]`.
    scale: Vec<f32>,
    robots: Vec<Robot>,
    /// Observations with the last finite value where a sensor has failed, `[N, O]`.
    obs: Vec<f32>,
    /// The last actions, `[N, A]`.
    actions: Vec<f32>,
    twins: Fleet,
    events: Vec<Event>,
}

impl Controller {
    /// A controller of as many robots as `twins` simulates.
    pub fn new(skills: Skills, config: ControllerConfig, twins: Box<dyn Backend>) -> Result<Self> {
        config.check()?;
        skills.check(twins.as_ref())?;
        let robots = twins.num_envs();
        let (obs_dim, action_dim) = (twins.task().obs_dim(), twins.task().layout().nu);
        let codes = &skills.diagnoser.description().subject.codes;
        let scale = skills.compared(twins.task())?;
        let mut twins = Fleet::new(twins);
        twins.check_twins()?;
        twins
            .reset(&(0..robots).map(|env| Reset { env, class: 0, key: 0, episode: 0 }).collect::<Vec<_>>())?;
        Ok(Self {
            codes: codes.iter().map(|code| code.iter().map(|&bit| f32::from(bit)).collect()).collect(),
            scale,
            robots: (0..robots).map(|_| Robot::new(&config)).collect(),
            obs: vec![0.0; robots * obs_dim],
            actions: vec![0.0; robots * action_dim],
            events: Vec::new(),
            skills,
            config,
            twins,
        })
    }

    /// Number of robots, N.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// The assumed class of each robot, `[N]`.
    #[must_use]
    pub fn classes(&self) -> Vec<usize> {
        self.robots.iter().map(|robot| robot.class).collect()
    }

    /// The damage-aware policy.
    #[must_use]
    pub fn policy(&self) -> &Policy {
        &self.skills.policy
    }

    /// Names of the damage classes.
    #[must_use]
    pub fn class_names(&self) -> &[String] {
        &self.skills.diagnoser.description().subject.class_names
    }

    /// The events since the controller was made or its events were taken, in order.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Resets the robots marked in `mask`, all for `None`: they are assumed healthy, and earlier readings are
    /// discarded, so that a reading that is lost before its first finite value counts as 0.
    ///
    /// # Shapes
    /// mask `[N]`
    pub fn reset(&mut self, mask: Option<&[bool]>) -> Result<()> {
        mask.map_or(Ok(()), |mask| check_length("reset mask [N]", mask, self.robots.len()))?;
        let (width, action_dim) = (self.obs_dim(), self.action_dim());
        for index in (0..self.robots.len()).filter(|&index| mask.is_none_or(|mask| mask[index])) {
            self.robots[index] = Robot::new(&self.config);
            self.obs[index * width..][..width].fill(0.0);
            self.actions[index * action_dim..][..action_dim].fill(0.0);
        }
        Ok(())
    }

    /// Length of an observation without damage code, O.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.scale.len()
    }

    /// Length of an action, A.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.actions.len() / self.robots.len()
    }

    fn event(&mut self, index: usize, kind: EventKind) {
        self.events.push(Event { robot: index, step: self.robots[index].step, kind });
    }

    /// Takes in the observations, holding the last finite value of every entry.
    fn sense(&mut self, obs: &[f32]) {
        let width = self.obs_dim();
        for index in 0..self.robots.len() {
            let readings = &obs[index * width..(index + 1) * width];
            let mut invalid = 0;
            for (held, reading) in self.obs[index * width..].iter_mut().zip(readings) {
                if reading.is_finite() {
                    *held = *reading;
                } else {
                    invalid += 1;
                }
            }
            if (invalid > 0) != self.robots[index].is_blind {
                self.robots[index].is_blind = invalid > 0;
                self.event(
                    index,
                    if invalid > 0 {
                        EventKind::ObservationInvalid { entries: invalid }
                    } else {
                        EventKind::ObservationValid
                    },
                );
            }
        }
    }

    /// Compares a robot with its twin: continues a diagnosis window, or checks whether one is needed.
    fn judge(&mut self, index: usize, velocity: f64) -> Result<()> {
        let (width, action_dim) = (self.obs_dim(), self.action_dim());
        let robot = &mut self.robots[index];
        let observed = &self.obs[index * width..][..width];
        let predicted = (robot.has_prediction && !robot.is_blind && !self.twins.diverged[index])
            .then(|| self.twins.row(index));
        robot.has_prediction = false;
        if let Some(window) = &mut robot.window {
            let Some(twin) = predicted else { return Ok(()) };
            window.damaged.extend(observed);
            window.twin.extend(twin);
            window.actions.extend(&self.actions[index * action_dim..][..action_dim]);
            let full = self.skills.diagnoser.description().timesteps * width;
            return if window.damaged.len() == full { self.diagnose(index) } else { Ok(()) };
        }
        let residual = predicted.map(|twin| distance(twin, observed, &self.scale));
        if let Some((probation, residual)) = robot.probation.as_mut().zip(residual)
            && let Some(verdict) = probation.weigh(&self.config, residual)
        {
            robot.probation = None;
            if let Err(rebuttal) = verdict {
                self.withdraw(index, rebuttal);
            }
        }
        let robot = &mut self.robots[index];
        let expected = self.skills.baselines[robot.class];
        if let Some(evidence) = robot.suspicion.weigh(&self.config, velocity, residual, expected) {
            robot.window = Some(Window::default());
            robot.probation = None;
            let Evidence { forward_velocity, residual } = evidence;
            self.event(index, EventKind::Suspected { forward_velocity, expected, residual });
        }
        Ok(())
    }

    /// Ends a diagnosis window: diagnoses the damage, and accepts the diagnosis if its probability is high
    /// enough.
    fn diagnose(&mut self, index: usize) -> Result<()> {
        let Some(window) = self.robots[index].window.take() else { return Ok(()) };
        let (class, confidence) = self.skills.diagnoser.diagnose(&window)?;
        let accepted = f64::from(confidence) >= self.config.confidence;
        self.event(index, EventKind::Diagnosed { class, confidence, accepted });
        let healthy = self.residuals(&window);
        let robot = &mut self.robots[index];
        robot.suspicion.rest(&self.config);
        if accepted && class != 0 {
            robot.probation = Probation::new(&self.config, &healthy);
        }
        if accepted && class != robot.class {
            robot.class = class;
            self.event(index, EventKind::Adapted { class });
        }
        Ok(())
    }

    /// Residuals of the healthy twin in a diagnosis window; none unless it was re-synchronised before every step,
    /// as the twin of a walking robot is.
    fn residuals(&self, window: &Window) -> Vec<f64> {
        let mode = self.skills.diagnoser.description().twin;
        let width = self.obs_dim();
        let rows = window.twin.chunks_exact(width).zip(window.damaged.chunks_exact(width));
        let is_synchronised = (1..rows.len()).all(|row| mode.resyncs_before(row));
        rows.filter(|_| is_synchronised)
            .map(|(twin, observed)| distance(twin, observed, &self.scale))
            .collect()
    }

    /// Withdraws a diagnosis that explains the robot no better than no damage does.
    fn withdraw(&mut self, index: usize, Rebuttal { residual, healthy }: Rebuttal) {
        let class = std::mem::take(&mut self.robots[index].class);
        self.event(index, EventKind::Withdrawn { class, residual, healthy });
        self.event(index, EventKind::Adapted { class: 0 });
    }

    /// The expert's actions for robots in a diagnosis window, those of the policy for the others.
    fn choose_actions(&mut self) -> Result<()> {
        let action_dim = self.action_dim();
        let (in_window, walking): (Vec<usize>, Vec<usize>) =
            (0..self.robots.len()).partition(|&index| self.robots[index].window.is_some());
        let row = |index: usize| &self.obs[index * self.obs_dim()..][..self.obs_dim()];
        let policy_row =
            |index: usize| row(index).iter().chain(&self.codes[self.robots[index].class]).copied();
        let mut chosen = Vec::with_capacity(self.actions.len());
        if !walking.is_empty() {
            let rows: Vec<f32> = walking.iter().flat_map(|&index| policy_row(index)).collect();
            chosen.extend(self.skills.policy.mean_actions(&rows)?);
        }
        if !in_window.is_empty() {
            let rows: Vec<f32> = in_window.iter().flat_map(|&index| row(index)).copied().collect();
            chosen.extend(self.skills.expert.healthy_actions(&rows)?);
        }
        for (index, action) in walking.iter().chain(&in_window).zip(chosen.chunks_exact(action_dim)) {
            self.actions[index * action_dim..][..action_dim].copy_from_slice(action);
        }
        Ok(())
    }

    /// Predicts the next observations with the twins of this step.
    ///
    /// The twin of a robot in a diagnosis window is healthy and runs as in the training of the diagnoser. That of a
    /// walking robot has the damage of the assumed class, is re-synchronised before every step and takes the
    /// action of the robot.
    fn step_twins(&mut self) -> Result<()> {
        let mode = self.skills.diagnoser.description().twin;
        let (width, watches) = (self.obs_dim(), self.config.trigger == Trigger::Residual);
        let mut classes = Vec::new();
        let mut skip_sync = vec![true; self.robots.len()];
        let mut skip_step = vec![true; self.robots.len()];
        for (index, robot) in self.robots.iter_mut().enumerate() {
            let class = if robot.window.is_some() { 0 } else { robot.class };
            if class != robot.twin_class {
                robot.twin_class = class;
                classes.push((index, class));
            }
            skip_sync[index] = match &robot.window {
                Some(window) => {
                    let row = window.damaged.len() / width;
                    row > 0 && !mode.resyncs_before(row)
                }
                None => !watches,
            };
            skip_step[index] = robot.window.is_none() && !watches;
            robot.has_prediction = !skip_step[index];
        }
        self.twins.set_classes(&classes)?;
        if !skip_step.contains(&false) {
            return Ok(());
        }
        if skip_sync.contains(&false) {
            self.twins.resync(&self.obs, &skip_sync)?;
        }
        let mut actions = self.actions.clone();
        if mode.action == TwinAction::Own {
            let own = self.skills.expert.healthy_actions(&self.twins.obs)?;
            let action_dim = self.action_dim();
            let rows = actions.chunks_exact_mut(action_dim).zip(own.chunks_exact(action_dim));
            for ((action, own), robot) in rows.zip(&self.robots) {
                if robot.window.is_some() {
                    action.copy_from_slice(own);
                }
            }
        }
        self.twins.step(&actions, &skip_step)
    }
}

impl Onboard for Controller {
    /// The next actions. To be called once a control step, with what the robots observe and how fast they walk.
    ///
    /// Readings that are not finite are replaced by the last finite ones, so that a row of NaN marks a step
    /// whose readings were lost. The actions are always finite.
    ///
    /// # Shapes
    /// - `obs`: `[N, O]`, without damage code; `forward_velocity`: `[N]`, m/s
    /// - output: `[N, A]`
    fn act(&mut self, obs: &[f32], forward_velocity: &[f64]) -> Result<Vec<f32>> {
        check_length("obs [N, O]", obs, self.obs.len())?;
        check_length("forward_velocity [N]", forward_velocity, self.robots.len())?;
        self.sense(obs);
        for (index, &velocity) in forward_velocity.iter().enumerate() {
            self.judge(index, velocity)?;
        }
        self.choose_actions()?;
        self.step_twins()?;
        for robot in &mut self.robots {
            robot.step += 1;
        }
        Ok(self.actions.clone())
    }

    fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }
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
