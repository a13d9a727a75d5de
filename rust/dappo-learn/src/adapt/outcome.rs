//! What one episode of a controller says.

use super::Walk;
use crate::controller::{Event, EventKind};

/// A robot has recovered once it walks at this share of the oracle's speed.
pub const RECOVERED: f64 = 0.8;
/// Steps over which the speed of a recovering robot is averaged.
const WINDOW: usize = 50;

/// The result of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeOutcome {
    /// Whether damage was suspected before there was any (in all of the episode, if the robot stays healthy).
    pub false_alarm: bool,
    /// Steps from the damage to the first suspicion.
    pub delay: Option<usize>,
    /// The class, as the controller counts them, of the first diagnosis after the damage, believed or not.
    pub first_diagnosis: Option<usize>,
    /// The class that the policy was told in the end, as the controller counts them.
    pub told: usize,
    /// Examinations in the episode.
    pub examinations: usize,
    /// Steps from the damage until the speed over a window, all of it after the last change of what the policy is
    /// told, is at [`RECOVERED`] of the oracle's; `None` without an oracle.
    pub recovery: Option<usize>,
}

impl EpisodeOutcome {
    /// Reads the outcome from a walk. `oracle` is the mean speed of the oracle with this damage, m/s, if it
    /// can be told.
    #[must_use]
    pub fn new(walk: &Walk, onset: usize, oracle: Option<f64>) -> Self {
        let is_suspicion = |event: &&Event| matches!(event.kind, EventKind::Suspected { .. });
        let after = |event: &Event| event.step as usize >= onset && walk.class != 0;
        let suspicion = walk.events.iter().filter(is_suspicion).find(|event| after(event));
        let delay = suspicion.map(|event| event.step as usize - onset);
        let first_diagnosis = walk
            .events
            .iter()
            .filter(|event| suspicion.is_some_and(|suspicion| event.step > suspicion.step))
            .find_map(|event| match event.kind {
                EventKind::Diagnosed { class, .. } => Some(class),
                _ => None,
            });
        let last_change = walk.events.iter().rev().find_map(|event| match event.kind {
            EventKind::Adapted { class } => Some((event.step as usize, class)),
            _ => None,
        });
        let (changed, told) = last_change.unwrap_or((0, 0));
        let start = changed.max(onset);
        let recovery = walk.velocities.get(start..).zip(oracle).and_then(|(velocities, oracle)| {
            let fast = |window: &[f64]| mean(window) >= RECOVERED * oracle;
            velocities.windows(WINDOW).position(fast).map(|first| start + first + WINDOW - onset)
        });
        Self {
            false_alarm: walk.events.iter().filter(is_suspicion).any(|event| !after(event)),
            delay,
            first_diagnosis,
            told,
            examinations: walk.events.iter().filter(is_suspicion).count(),
            recovery,
        }
    }
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(step: u64, kind: EventKind) -> Event {
        Event { robot: 0, step, kind }
    }

    fn suspected() -> EventKind {
        EventKind::Suspected { forward_velocity: 0.1, expected: 1.0, residual: None }
    }

    fn diagnosed(class: usize) -> EventKind {
        EventKind::Diagnosed { class, confidence: 0.9, accepted: true }
    }

    /// 1 m/s, 0.2 m/s from the damage at step 100, and 0.9 m/s from step 200 on.
    fn walk(class: usize, events: Vec<Event>) -> Walk {
        let velocities = [vec![1.0; 100], vec![0.2; 100], vec![0.9; 200]].concat();
        Walk { class, velocities, events, ..Walk::default() }
    }

    #[test]
    fn delay_diagnosis_and_recovery_count_from_the_damage() {
        let events = vec![
            event(120, suspected()),
            event(170, diagnosed(3)),
            event(170, EventKind::Adapted { class: 3 }),
        ];
        let outcome = EpisodeOutcome::new(&walk(3, events), 100, Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (false, Some(20), Some(3)));
        assert_eq!((outcome.told, outcome.examinations), (3, 1));
        // The first window after step 170 with a mean of 0.8: 0.2 in 7 steps, 0.9 in 43 (0.802), up to step 243.
        assert_eq!(outcome.recovery, Some(143));
        // Above the oracle's speed of 2 m/s · 0.8 it never gets.
        assert_eq!(EpisodeOutcome::new(&walk(3, Vec::new()), 100, Some(2.0)).recovery, None);
        // Nor is there anything to compare with where the policy does not know the damage.
        assert_eq!(EpisodeOutcome::new(&walk(3, Vec::new()), 100, None).recovery, None);
    }

    #[test]
    fn suspicions_before_the_damage_and_of_healthy_robots_are_false_alarms() {
        let early = vec![event(60, suspected()), event(110, diagnosed(0))];
        let outcome = EpisodeOutcome::new(&walk(3, early), 100, Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (true, None, None));
        let late = vec![event(300, suspected())];
        let outcome = EpisodeOutcome::new(&walk(0, late), 100, Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay), (true, None));
    }
}
