//! What controllers with and without twins share: readings, the assumed classes, and the policy.

use dappo_learn::error::Result;
use dappo_learn::walk::{Event, EventKind};

use super::{CodeSource, ControllerConfig, Skills};

/// N robots under the damage-aware policy. O = length of an observation without damage code, A = of an action.
pub(super) struct Common {
    pub skills: Skills,
    pub config: ControllerConfig,
    /// Damage codes of all classes, `[C, code_length]`.
    codes: Vec<Vec<f32>>,
    /// The code that the policy is given of each robot, `[N]`.
    given: Vec<Vec<f32>>,
    pub robots: Vec<Robot>,
    /// Observations with the last finite value where a sensor has failed, `[N, O]`.
    pub obs: Vec<f32>,
    /// The last actions, `[N, A]`.
    pub actions: Vec<f32>,
    pub events: Vec<Event>,
}

/// What is stored of one robot.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Robot {
    /// Control steps since its start.
    pub step: u64,
    /// The assumed class.
    pub class: usize,
    /// Whether some of its last readings were not finite.
    pub is_blind: bool,
}

impl Common {
    pub fn new(skills: Skills, config: ControllerConfig, robots: usize) -> Self {
        let codes = &skills.diagnoser.description().subject.codes;
        let codes: Vec<Vec<f32>> =
            codes.iter().map(|code| code.iter().map(|&bit| f32::from(bit)).collect()).collect();
        Self {
            given: vec![codes[Robot::default().class].clone(); robots],
            codes,
            robots: vec![Robot::default(); robots],
            obs: vec![0.0; robots * skills.policy.obs_dim()],
            actions: vec![0.0; robots * skills.policy.action_dim()],
            events: Vec::new(),
            skills,
            config,
        }
    }

    /// Length of an observation without damage code, O.
    pub fn obs_dim(&self) -> usize {
        self.skills.policy.obs_dim()
    }

    /// Length of an action, A.
    pub fn action_dim(&self) -> usize {
        self.skills.policy.action_dim()
    }

    /// The observation of one robot, `[O]`.
    pub fn row(&self, index: usize) -> &[f32] {
        &self.obs[index * self.obs_dim()..][..self.obs_dim()]
    }

    /// The last action of one robot, `[A]`.
    pub fn action(&self, index: usize) -> &[f32] {
        &self.actions[index * self.action_dim()..][..self.action_dim()]
    }

    pub fn event(&mut self, index: usize, kind: EventKind) {
        self.events.push(Event { robot: index, step: self.robots[index].step, kind });
    }

    /// Assumes another class of a robot.
    pub fn assume(&mut self, index: usize, class: usize) {
        self.robots[index].class = class;
        if self.config.code == CodeSource::Assumed {
            self.given[index].clone_from(&self.codes[class]);
        }
        self.event(index, EventKind::Adapted { class });
    }

    /// Gives the policy the mean of the codes of all classes, weighted by their probabilities `[C]`.
    pub fn expect(&mut self, index: usize, probabilities: &[f32]) {
        let code = &mut self.given[index];
        code.fill(0.0);
        for (of_class, probability) in self.codes.iter().zip(probabilities) {
            code.iter_mut().zip(of_class).for_each(|(entry, bit)| *entry += probability * bit);
        }
    }

    /// Forgets everything about a robot.
    pub fn reset(&mut self, index: usize) {
        let (width, action_dim) = (self.obs_dim(), self.action_dim());
        self.robots[index] = Robot::default();
        self.given[index].clone_from(&self.codes[Robot::default().class]);
        self.obs[index * width..][..width].fill(0.0);
        self.actions[index * action_dim..][..action_dim].fill(0.0);
    }

    /// Takes in the observations, holding the last finite value of every entry.
    pub fn sense(&mut self, obs: &[f32]) {
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

    /// Lets the policy choose the actions of these robots.
    pub fn walk(&mut self, indices: &[usize]) -> Result<()> {
        if indices.is_empty() {
            return Ok(());
        }
        let coded = |&index: &usize| self.row(index).iter().chain(&self.given[index]);
        let rows: Vec<f32> = indices.iter().flat_map(coded).copied().collect();
        let chosen = self.skills.policy.mean_actions(&rows)?;
        self.act(indices, &chosen);
        Ok(())
    }

    /// Sets the actions of these robots.
    ///
    /// # Shapes
    /// chosen `[indices, A]`
    pub fn act(&mut self, indices: &[usize], chosen: &[f32]) {
        let action_dim = self.action_dim();
        for (index, action) in indices.iter().zip(chosen.chunks_exact(action_dim)) {
            self.actions[index * action_dim..][..action_dim].copy_from_slice(action);
        }
    }
}
