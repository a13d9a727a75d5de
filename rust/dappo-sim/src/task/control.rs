//! From actions to controls.

use super::Task;
use super::draws::{steps, within};
use super::memory::Clock;
use crate::rng::Purpose;

impl Task {
    /// A sudden change of the root's velocities before this step, linear along the world's axes, angular along its own.
    #[must_use]
    pub fn push(&self, row: &mut [f64]) -> Option<[f64; 6]> {
        let push = self.events.push?;
        let clock = Clock::read(&row[self.slots.episode.clone()]);
        let at = self.drawn.next_push(&mut row[self.slots.events.clone()])?;
        if clock.step < *at as u64 {
            return None;
        }
        let mut stream = clock.stream(Purpose::Push);
        *at += steps(within(&mut stream, push.every), self.dt()) as f64;
        Some(push.draw(&mut stream))
    }

    /// Turns the action of an env into controls.
    ///
    /// # Shapes
    /// - `row`: `[memory_len]`; `action`, `ctrl`: `[nu]`
    pub fn act(&self, row: &mut [f64], action: &[f32], ctrl: &mut [f64]) {
        let clipped = action.iter().map(|action| f64::from(action.clamp(-1.0, 1.0)));
        for (ctrl, action) in ctrl.iter_mut().zip(clipped) {
            *ctrl = action;
        }
        if !self.slots.actions.is_empty() {
            let actions = &mut row[self.slots.actions.clone()];
            actions.copy_within(..ctrl.len(), ctrl.len());
            actions[..ctrl.len()].copy_from_slice(ctrl);
        }
        if !self.slots.waiting.is_empty() {
            self.delay(row, ctrl);
        }
        if let Some(dropouts) = &self.dropouts {
            dropouts.hold(row, ctrl);
        }
        for (ctrl, action) in ctrl.iter_mut().zip(&self.actions) {
            *ctrl = action.offset + action.scale * *ctrl;
        }
        // A servo holds the position that its encoder reads.
        for ((ctrl, actuator), bias) in
            ctrl.iter_mut().zip(&self.layout.anatomy.actuators).zip(self.encoder_bias(row))
        {
            if actuator.is_position {
                *ctrl -= bias;
            }
        }
    }

    /// Replaces an action with the one that arrives now.
    fn delay(&self, row: &mut [f64], action: &mut [f64]) {
        let (nu, delay) = (action.len(), self.drawn.action_delay(&row[self.slots.events.clone()]));
        let waiting = &mut row[self.slots.waiting.clone()];
        // The newest waits at the end.
        let newest = waiting.len() - nu;
        let arrived = (delay > 0).then(|| waiting[waiting.len() - delay * nu..][..nu].to_vec());
        waiting.copy_within(nu.., 0);
        waiting[newest..].copy_from_slice(action);
        if let Some(arrived) = arrived {
            action.copy_from_slice(&arrived);
        }
    }

    fn encoder_bias<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        self.drawn.encoder_bias(&row[self.slots.events.clone()])
    }
}
