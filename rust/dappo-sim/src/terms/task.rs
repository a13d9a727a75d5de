//! The task of a robot: its observation, reward and termination, applied to one env at a time.

use super::Signals;
use crate::backend::Layout;
use crate::error::SimError;
use crate::robot::{ResetNoise, RewardFunction, Robot, Termination};
use crate::terms::ObservationTerm;

/// Everything that turns physics into what a learner sees.
#[derive(Debug, Clone)]
pub struct Task {
    /// Physics substeps an env step.
    pub frame_skip: usize,
    /// ctrl = `action_scale` · clip(action, ±1).
    pub action_scale: f64,
    /// Noise of the initial state.
    pub reset: ResetNoise,
    observation: Vec<ObservationTerm>,
    reward: RewardFunction,
    termination: Termination,
    layout: Layout,
}

impl Task {
    /// The task of `robot` with the reward of this name (the robot's default for `None`).
    pub fn new(robot: &Robot, layout: &Layout, reward: Option<&str>) -> Result<Self, SimError> {
        check(robot, layout)?;
        Ok(Self {
            frame_skip: robot.frame_skip,
            action_scale: robot.action_scale,
            reset: robot.reset,
            observation: robot.observation.terms.clone(),
            reward: robot.reward(reward)?.clone(),
            termination: robot.termination,
            layout: layout.clone(),
        })
    }

    /// Sizes and addresses of the compiled robot.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Length of the observation, without a damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.observation.iter().map(|term| term.len(&self.layout)).sum()
    }

    /// Duration of an env step, s.
    #[must_use]
    pub fn dt(&self) -> f64 {
        self.layout.timestep * self.frame_skip as f64
    }

    /// Writes the observation into `out`, `[obs_dim]`.
    pub fn observe(&self, signals: &Signals, out: &mut [f32]) {
        let mut rest = out;
        for term in &self.observation {
            let (block, tail) = rest.split_at_mut(term.len(&self.layout));
            term.write(signals, &self.layout, block);
            rest = tail;
        }
    }

    /// Reads positions and velocities back from an observation; what it leaves out (x and y of the root) becomes 0.
    /// False, with nothing written, if the observation shows no more than a part of them.
    ///
    /// # Shapes
    /// - `obs`: `[obs_dim]`, `qpos`: `[nq]`, `qvel`: `[nv]`
    pub fn read_state(&self, obs: &[f32], qpos: &mut [f64], qvel: &mut [f64]) -> bool {
        let mut start = 0;
        let (mut positions, mut velocities) = (None, None);
        for term in &self.observation {
            let block = start..start + term.len(&self.layout);
            start = block.end;
            match term {
                // The floor is level: a robot moves at (0, 0) as it does anywhere else.
                ObservationTerm::Qpos { skip: 0..=2 } => positions = Some(&obs[block]),
                ObservationTerm::Qvel => velocities = Some(&obs[block]),
                _ => {}
            }
        }
        let (Some(positions), Some(velocities)) = (positions, velocities) else { return false };
        let (unseen, seen) = qpos.split_at_mut(self.layout.nq - positions.len());
        unseen.fill(0.0);
        for (state, shown) in [(seen, positions), (qvel, velocities)] {
            state.iter_mut().zip(shown).for_each(|(state, shown)| *state = f64::from(*shown));
        }
        true
    }

    /// Whether observations show all positions, but for x and y of the root, and all velocities.
    #[must_use]
    pub fn is_observed(&self) -> bool {
        let has = |wanted: fn(&ObservationTerm) -> bool| self.observation.iter().any(wanted);
        has(|term| matches!(term, ObservationTerm::Qpos { skip: 0..=2 }))
            && has(|term| *term == ObservationTerm::Qvel)
    }

    /// Whether each entry of an observation is a position or a velocity, `[obs_dim]`.
    #[must_use]
    pub fn shows_state(&self) -> Vec<bool> {
        let is_state =
            |term: &ObservationTerm| matches!(term, ObservationTerm::Qpos { .. } | ObservationTerm::Qvel);
        self.observation
            .iter()
            .flat_map(|term| std::iter::repeat_n(is_state(term), term.len(&self.layout)))
            .collect()
    }

    /// Whether the episode has failed: the root is too low or too high.
    #[must_use]
    pub fn terminated(&self, signals: &Signals) -> bool {
        let [low, high] = self.termination.height;
        !(low..=high).contains(&signals.qpos[2])
    }

    /// The reward of a step.
    #[must_use]
    pub fn reward(&self, signals: &Signals, terminated: bool) -> f64 {
        self.reward.terms.iter().map(|term| term.value(signals, &self.layout, terminated)).sum()
    }
}

/// Refuses a compiled robot that the terms cannot be computed for.
fn check(robot: &Robot, layout: &Layout) -> Result<(), SimError> {
    let bad = |why: String| Err(SimError::Config(format!("robot `{}`: {why}", robot.name)));
    if layout.nq < 3 {
        return bad(format!("it has {} positions, but the third one is the height of its root", layout.nq));
    }
    if layout.nu == 0 {
        return bad("it has no actuators".into());
    }
    for term in &robot.observation.terms {
        if let ObservationTerm::Qpos { skip } = term
            && *skip >= layout.nq
        {
            return bad(format!(
                "the observation term `qpos` skips {skip} of {} positions; expected fewer",
                layout.nq
            ));
        }
    }
    Ok(())
}
