//! What a task consists of: sizes, names and numbers that do not change.

use super::command::COMMAND;
use super::dropout::Dropouts;
use super::entries::{Entry, Parts};
use super::observation::ObservationGroup;
use super::{Measure, Task, tracking};
use crate::backend::Layout;

impl Task {
    /// Sizes and parts of the compiled robot.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Length of the observation, privileged entries included, without a damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.policy.len() + self.privileged()
    }

    /// Number of entries at the end of the observation that the value net alone is given.
    #[must_use]
    pub fn privileged(&self) -> usize {
        self.critic.as_ref().map_or(0, ObservationGroup::len)
    }

    /// What each entry of the policy's observation is, privileged entries and damage code not included.
    #[must_use]
    pub fn entries(&self) -> Vec<Entry> {
        let events = self.event_names();
        let parts = Parts { layout: &self.layout, limbs: &self.limbs, events: &events };
        self.policy.blocks().flat_map(|(term, _)| term.entries(parts)).collect()
    }

    /// The controls of the actuators, as (name, offset, scale): ctrl = offset + scale · clip(action, ±1).
    pub fn controls(&self) -> impl Iterator<Item = (&str, f64, f64)> {
        let names = self.layout.anatomy.actuators.iter().map(|actuator| actuator.name.as_str());
        names.zip(&self.actions).map(|(name, action)| (name, action.offset, action.scale))
    }

    /// The factor of ctrl = factor · clip(action, ±1), where this holds for all actuators alike.
    #[must_use]
    pub fn action_scale(&self) -> Option<f64> {
        let first = self.actions.first()?;
        (first.offset == 0.0 && self.actions.iter().all(|action| action == first)).then_some(first.scale)
    }

    /// Number of terms of the reward, at least 1.
    #[must_use]
    pub fn reward_len(&self) -> usize {
        self.rewards.len()
    }

    /// Names of the terms of the reward, in their order.
    pub fn reward_names(&self) -> impl Iterator<Item = &str> {
        self.rewards.iter().map(|term| term.name.as_str())
    }

    /// The term of the reward that says how well commanded linear velocities are tracked, from 0 to 1 without its weight:
    /// its index and its weight.
    #[must_use]
    pub fn tracking(&self) -> Option<(usize, f64)> {
        tracking(&self.rewards).map(|(index, term)| (index, term.weight))
    }

    /// What this term would be for a robot at rest with this command, without its weight.
    ///
    /// # Shapes
    /// command `[command_len]`
    #[must_use]
    pub fn tracking_at_rest(&self, command: &[f64]) -> Option<f64> {
        match tracking(&self.rewards)?.1.measure {
            Measure::TrackLinVel { std } => {
                let squares: f64 = command.iter().take(2).map(|velocity| velocity.powi(2)).sum();
                Some((-squares / (std * std)).exp())
            }
            _ => None,
        }
    }

    /// Numbers in the command of an env; 0 for a task without commands.
    #[must_use]
    pub fn command_len(&self) -> usize {
        if self.command.is_some() { COMMAND } else { 0 }
    }

    /// The command of an env, `[command_len]`.
    #[must_use]
    pub fn command<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        &row[self.slots.command.clone()][..self.command_len()]
    }

    /// Names of what the events draw for an episode.
    #[must_use]
    pub fn event_names(&self) -> Vec<String> {
        let joints = self.layout.anatomy.actuators.iter().filter_map(|actuator| actuator.joint.as_ref());
        let mut names = self.drawn.names(joints.map(|joint| joint.name.as_str()), &self.layout.variants);
        names.extend(self.sensor_faults.names().cloned());
        names.extend(self.dropouts.iter().flat_map(|_| Dropouts::names()));
        names
    }

    /// What the events have drawn for the episode of an env, in the order of their names.
    pub fn events<'a>(&'a self, row: &'a [f64]) -> impl Iterator<Item = f64> + use<'a> {
        let drawn = self.drawn.shown(&row[self.slots.events.clone()]).iter().copied();
        let dropouts = self.dropouts.iter().flat_map(|dropouts| dropouts.shown(row)).copied();
        drawn.chain(self.sensor_faults.shown(row)).chain(dropouts)
    }

    /// Numbers that the task remembers of an env.
    #[must_use]
    pub fn memory_len(&self) -> usize {
        self.slots.len
            + self.policy.frames_len()
            + self.critic.as_ref().map_or(0, ObservationGroup::frames_len)
    }

    /// Duration of an env step, s.
    #[must_use]
    pub fn dt(&self) -> f64 {
        self.layout.timestep * self.frame_skip as f64
    }
}
