//! What one episode of a controller says.

use dappo_learn::statistics::mean;
use dappo_learn::walk::{Episode, Event, EventKind};

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
    /// The class whose code the policy had in the end, as the controller counts them.
    pub given: usize,
    /// Examinations in the episode.
    pub examinations: usize,
    /// Steps from the damage until the speed over a window, all of it after the last change of the policy's
    /// code, is at [`RECOVERED`] of the oracle's; `None` without an oracle.
    pub recovery: Option<usize>,
}

impl EpisodeOutcome {
    /// Reads the outcome from an episode with its velocities. `oracle` is the mean speed of the oracle with
    /// this damage, m/s, if it knows it.
    #[must_use]
    pub fn new(episode: &Episode, oracle: Option<f64>) -> Self {
        let onset = episode.onset;
        let is_suspicion = |event: &&Event| matches!(event.kind, EventKind::Suspected { .. });
        let after = |event: &Event| event.step as usize >= onset && episode.class != 0;
        let suspicion = episode.events.iter().filter(is_suspicion).find(|event| after(event));
        let delay = suspicion.map(|event| event.step as usize - onset);
        let first_diagnosis = episode
            .events
            .iter()
            .filter(|event| suspicion.is_some_and(|suspicion| event.step > suspicion.step))
            .find_map(|event| match event.kind {
                EventKind::Diagnosed { class, .. } => Some(class),
                _ => None,
            });
        let last_change = episode.events.iter().rev().find_map(|event| match event.kind {
            EventKind::Adapted { class } => Some((event.step as usize, class)),
            _ => None,
        });
        let (changed, given) = last_change.unwrap_or((0, 0));
        let start = changed.max(onset);
        let recovery = episode.velocities.get(start..).zip(oracle).and_then(|(velocities, oracle)| {
            let fast = |window: &[f64]| mean(window.iter().copied()) >= RECOVERED * oracle;
            velocities.windows(WINDOW).position(fast).map(|first| start + first + WINDOW - onset)
        });
        Self {
            false_alarm: episode.events.iter().filter(is_suspicion).any(|event| !after(event)),
            delay,
            first_diagnosis,
            given,
            examinations: episode.events.iter().filter(is_suspicion).count(),
            recovery,
        }
    }
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
    fn walk(class: usize, events: Vec<Event>) -> Episode {
        let velocities = [vec![1.0; 100], vec![0.2; 100], vec![0.9; 200]].concat();
        Episode { class, onset: 100, steps: 400, velocities, events, ..Episode::default() }
    }

    #[test]
    fn delay_diagnosis_and_recovery_count_from_the_damage() {
        let events = vec![
            event(120, suspected()),
            event(170, diagnosed(3)),
            event(170, EventKind::Adapted { class: 3 }),
        ];
        let outcome = EpisodeOutcome::new(&walk(3, events), Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (false, Some(20), Some(3)));
        assert_eq!((outcome.given, outcome.examinations), (3, 1));
        // The first window after step 170 with a mean of 0.8: 0.2 in 7 steps, 0.9 in 43 (0.802), up to step 243.
        assert_eq!(outcome.recovery, Some(143));
        // Above the oracle's speed of 2 m/s · 0.8 it never gets.
        assert_eq!(EpisodeOutcome::new(&walk(3, Vec::new()), Some(2.0)).recovery, None);
        // Nor is there anything to compare with where the policy does not know the damage.
        assert_eq!(EpisodeOutcome::new(&walk(3, Vec::new()), None).recovery, None);
    }

    #[test]
    fn suspicions_before_the_damage_and_of_healthy_robots_are_false_alarms() {
        let early = vec![event(60, suspected()), event(110, diagnosed(0))];
        let outcome = EpisodeOutcome::new(&walk(3, early), Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (true, None, None));
        let late = vec![event(300, suspected())];
        let outcome = EpisodeOutcome::new(&walk(0, late), Some(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay), (true, None));
    }
}
