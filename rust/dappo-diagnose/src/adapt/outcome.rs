//! The result of one episode of a controller.

use dappo_learn::statistics::mean;
use dappo_learn::walk::{Episode, Event, EventKind};

/// A robot has recovered if it keeps this share of the oracle's speed.
pub const RECOVERED: f64 = 0.8;
/// A robot stands still if it keeps less than this share of its speed before the damage.
pub const STANDS_STILL: f64 = 0.1;
/// Steps at the end of an episode over which the speed that a robot keeps is averaged.
pub const LAST: usize = 200;
/// Steps over which the speed of a recovering robot is averaged.
const WINDOW: usize = 50;

/// The result of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeOutcome {
    /// Whether damage was suspected before there was any (in the whole episode, if the robot stays healthy).
    pub false_alarm: bool,
    /// Steps from the damage to the first suspicion.
    pub delay: Option<usize>,
    /// The class, as the controller counts them, of the first diagnosis after the onset, accepted or not.
    pub first_diagnosis: Option<usize>,
    /// The assumed class at the end, as the controller counts them.
    pub assumed: usize,
    /// Diagnosis windows in the episode.
    pub diagnosis_windows: usize,
    /// Whether the robot did not fall, but kept less than [`STANDS_STILL`] of its speed before the damage.
    pub stands_still: bool,
    /// Steps from the damage until the speed over a window, all of it after the last change of the policy's
    /// code, is at [`RECOVERED`] of the oracle's. `None` unless the robot has recovered: the policy's code changed
    /// after the damage, the robot neither fell nor stands still, and it keeps [`RECOVERED`] of the speed that the
    /// oracle keeps. `None` without an oracle, too.
    pub recovery: Option<usize>,
}

/// The speeds that a robot is compared with, m/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// The speed that the oracle [keeps](kept_speed), if the damage has a code; the mean over its episodes.
    pub oracle: Option<f64>,
    /// The robot's own before the damage; the mean over the episodes.
    pub before: f64,
}

/// The speed that a robot keeps: its mean forward velocity over the [`LAST`] steps, or all steps since the damage if
/// they are fewer, m/s; 0 if it fell.
#[must_use]
pub fn kept_speed(episode: &Episode) -> f64 {
    let steps = episode.velocities.len();
    let last = episode.velocities.get(episode.onset.max(steps.saturating_sub(LAST))..).unwrap_or_default();
    if episode.fell || last.is_empty() { 0.0 } else { mean(last.iter().copied()) }
}

impl EpisodeOutcome {
    /// Reads the outcome from an episode with its velocities.
    #[must_use]
    pub fn new(episode: &Episode, reference: Reference) -> Self {
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
        let (changed, assumed) = last_change.unwrap_or((0, 0));
        let kept = kept_speed(episode);
        let stands_still = !episode.fell && kept <= STANDS_STILL * reference.before.max(0.0);
        let enough = reference.oracle.map(|oracle| RECOVERED * oracle);
        let has_recovered = last_change.is_some() && changed >= onset && !episode.fell && !stands_still;
        let recovery = enough.filter(|&enough| has_recovered && kept >= enough).and_then(|enough| {
            let fast = |window: &[f64]| mean(window.iter().copied()) >= enough;
            let first = episode.velocities.get(changed..)?.windows(WINDOW).position(fast)?;
            Some(changed + first + WINDOW - onset)
        });
        Self {
            false_alarm: episode.events.iter().filter(is_suspicion).any(|event| !after(event)),
            delay,
            first_diagnosis,
            assumed,
            diagnosis_windows: episode.events.iter().filter(is_suspicion).count(),
            stands_still,
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
        let oracle = |speed| Reference { oracle: Some(speed), before: 1.0 };
        let adapting = walk(3, events);
        let outcome = EpisodeOutcome::new(&adapting, oracle(1.0));
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (false, Some(20), Some(3)));
        assert_eq!((outcome.assumed, outcome.diagnosis_windows), (3, 1));
        // The first window after step 170 with a mean of 0.8: 0.2 in 7 steps, 0.9 in 43 (0.802), up to step 243.
        assert_eq!((outcome.recovery, outcome.stands_still), (Some(143), false));
        assert!((kept_speed(&adapting) - 0.9).abs() < 1e-12);
        // It never exceeds 0.8 of the oracle's speed of 2 m/s.
        assert_eq!(EpisodeOutcome::new(&adapting, oracle(2.0)).recovery, None);
        // Without a code for the damage, there is no oracle to compare with.
        let unknown = Reference { oracle: None, before: 1.0 };
        assert_eq!(EpisodeOutcome::new(&adapting, unknown).recovery, None);
    }

    #[test]
    fn a_robot_has_recovered_only_if_it_was_diagnosed_and_walks_to_the_end() {
        let adapted = || vec![event(120, suspected()), event(170, EventKind::Adapted { class: 3 })];
        let reference = Reference { oracle: Some(1.0), before: 1.0 };
        let recovery = |episode: &Episode| EpisodeOutcome::new(episode, reference).recovery;
        let well = walk(3, adapted());
        assert!(recovery(&well).is_some());
        // As fast, but nothing was diagnosed, or only before the damage.
        assert_eq!(recovery(&walk(3, Vec::new())), None);
        assert_eq!(recovery(&walk(3, vec![event(60, EventKind::Adapted { class: 3 })])), None);
        // One good window, and then it stands still: of the last 200 steps, 50 at 0.9 m/s and 150 at 0.
        let velocities = [vec![1.0; 100], vec![0.2; 100], vec![0.9; 50], vec![0.0; 150]].concat();
        let stopped = Episode { velocities, ..walk(3, adapted()) };
        assert!((kept_speed(&stopped) - 0.225).abs() < 1e-12);
        assert_eq!(recovery(&stopped), None);
        // An oracle that stands still, too, makes no robot recover.
        let still = Episode { velocities: vec![0.0; 400], ..walk(3, adapted()) };
        let outcome = EpisodeOutcome::new(&still, Reference { oracle: Some(0.0), before: 1.0 });
        assert_eq!((outcome.recovery, outcome.stands_still), (None, true));
        // Nor does a robot that falls, which does not stand still either.
        let fallen = Episode { fell: true, ..walk(3, adapted()) };
        let outcome = EpisodeOutcome::new(&fallen, reference);
        assert_eq!((outcome.recovery, outcome.stands_still, kept_speed(&fallen)), (None, false, 0.0));
    }

    #[test]
    fn the_kept_speed_counts_no_step_before_the_damage() {
        // 50 steps of damage at 0.5 m/s after 100 healthy ones at 1 m/s.
        let velocities = [vec![1.0; 100], vec![0.5; 50]].concat();
        let short = Episode { class: 3, onset: 100, steps: 150, velocities, ..Episode::default() };
        assert!((kept_speed(&short) - 0.5).abs() < 1e-12);
        assert_eq!(kept_speed(&Episode { velocities: Vec::new(), ..short }), 0.0);
    }

    #[test]
    fn suspicions_before_the_damage_and_of_healthy_robots_are_false_alarms() {
        let reference = Reference { oracle: Some(1.0), before: 1.0 };
        let early = vec![event(60, suspected()), event(110, diagnosed(0))];
        let outcome = EpisodeOutcome::new(&walk(3, early), reference);
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (true, None, None));
        let late = vec![event(300, suspected())];
        let outcome = EpisodeOutcome::new(&walk(0, late), reference);
        assert_eq!((outcome.false_alarm, outcome.delay), (true, None));
    }
}
