//! The result of one episode of a controller.

use dappo_learn::statistics::mean;
use dappo_learn::walk::{Episode, Event, EventKind};

/// A robot has recovered if it keeps this share of the oracle's score.
pub const RECOVERED: f64 = 0.8;
/// A robot stands still if it keeps less than this share of its speed before the damage, or of what walking adds to the
/// tracking of a robot at rest.
pub const STANDS_STILL: f64 = 0.1;
/// Steps at the end of an episode over which the score that a robot keeps is averaged.
pub const LAST: usize = 200;
/// Steps over which the score of a recovering robot is averaged.
const WINDOW: usize = 50;
/// A robot at rest that tracks its commands this well was mostly commanded to stand.
const COMMANDED_TO_STAND: f64 = 0.9;

/// How well a robot does in every step: the tracking of its command, from 0 to 1, or its forward velocity, m/s, for a
/// task without commands.
#[must_use]
pub fn scores(episode: &Episode) -> &[f64] {
    if episode.trackings.is_empty() { &episode.velocities } else { &episode.trackings }
}

/// The result of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeOutcome {
    /// Whether there was an [alarm] before there was damage (in the whole episode, if the robot stays healthy).
    pub false_alarm: bool,
    /// Steps from the damage to the first alarm.
    pub delay: Option<usize>,
    /// The class, as the controller counts them, of the first diagnosis after the onset, accepted or not.
    pub first_diagnosis: Option<usize>,
    /// The assumed class at the end, as the controller counts them.
    pub assumed: usize,
    /// Alarms in the episode, each with a diagnosis window, unless the controller has no twin.
    pub diagnosis_windows: usize,
    /// Whether the robot did not fall, but kept less than [`STANDS_STILL`] of its speed before the damage; of a robot
    /// with commands that it does not stand still on command, but tracks them hardly better than one at rest.
    pub stands_still: bool,
    /// Steps from the damage until the score over a window, all of it after the last change of the policy's
    /// code, is at [`RECOVERED`] of the oracle's. `None` unless the robot has recovered: the policy's code changed
    /// after the damage, the robot neither fell nor stands still, and it keeps [`RECOVERED`] of the score that the
    /// oracle keeps. `None` without an oracle, too.
    pub recovery: Option<usize>,
}

/// The scores that a robot is compared with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// The score that the oracle [keeps](kept), if the damage has a code; the mean over its episodes.
    pub oracle: Option<f64>,
    /// The robot's own before the damage; the mean over the episodes.
    pub before: f64,
}

/// What a robot keeps of a number that every step of its episode has: the mean over the [`LAST`] steps, or all steps since
/// the damage if they are fewer; 0 if it fell.
#[must_use]
pub fn kept(episode: &Episode, values: &[f64]) -> f64 {
    let last = values.get(episode.onset.max(values.len().saturating_sub(LAST))..).unwrap_or_default();
    if episode.fell || last.is_empty() { 0.0 } else { mean(last.iter().copied()) }
}

/// Whether a robot that keeps this score stands still, see [`EpisodeOutcome::stands_still`].
fn stands_still(episode: &Episode, kept_score: f64, before: f64) -> bool {
    if episode.fell {
        return false;
    }
    if episode.at_rest.is_empty() {
        return kept_score <= STANDS_STILL * before.max(0.0);
    }
    let at_rest = kept(episode, &episode.at_rest);
    at_rest < COMMANDED_TO_STAND && kept_score - at_rest <= STANDS_STILL * (1.0 - at_rest)
}

/// The alarms of a controller: its suspicions; or the diagnoses of one without a twin, which suspects nothing before.
fn alarms(episode: &Episode) -> Vec<&Event> {
    let is_suspicion = |event: &&Event| matches!(event.kind, EventKind::Suspected { .. });
    let is_diagnosis = |event: &&Event| matches!(event.kind, EventKind::Diagnosed { .. });
    let suspicions: Vec<&Event> = episode.events.iter().filter(is_suspicion).collect();
    if suspicions.is_empty() { episode.events.iter().filter(is_diagnosis).collect() } else { suspicions }
}

impl EpisodeOutcome {
    /// Reads the outcome from an episode with its velocities.
    #[must_use]
    pub fn new(episode: &Episode, reference: Reference) -> Self {
        let onset = episode.onset;
        let alarms = alarms(episode);
        let after = |event: &Event| event.step as usize >= onset && episode.class != 0;
        let alarm = alarms.iter().find(|event| after(event));
        let delay = alarm.map(|event| event.step as usize - onset);
        let first_diagnosis = episode
            .events
            .iter()
            .filter(|event| alarm.is_some_and(|alarm| event.step >= alarm.step))
            .find_map(|event| match event.kind {
                EventKind::Diagnosed { class, .. } => Some(class),
                _ => None,
            });
        let last_change = episode.events.iter().rev().find_map(|event| match event.kind {
            EventKind::Adapted { class } => Some((event.step as usize, class)),
            _ => None,
        });
        let (changed, assumed) = last_change.unwrap_or((0, 0));
        let kept = kept(episode, scores(episode));
        let stands_still = stands_still(episode, kept, reference.before);
        let enough = reference.oracle.map(|oracle| RECOVERED * oracle);
        let has_recovered = last_change.is_some() && changed >= onset && !episode.fell && !stands_still;
        let recovery = enough.filter(|&enough| has_recovered && kept >= enough).and_then(|enough| {
            let is_enough = |window: &[f64]| mean(window.iter().copied()) >= enough;
            let first = scores(episode).get(changed..)?.windows(WINDOW).position(is_enough)?;
            Some(changed + first + WINDOW - onset)
        });
        Self {
            false_alarm: alarms.iter().any(|event| !after(event)),
            delay,
            first_diagnosis,
            assumed,
            diagnosis_windows: alarms.len(),
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
        assert!((kept(&adapting, &adapting.velocities) - 0.9).abs() < 1e-12);
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
        assert!((kept(&stopped, &stopped.velocities) - 0.225).abs() < 1e-12);
        assert_eq!(recovery(&stopped), None);
        // An oracle that stands still, too, makes no robot recover.
        let still = Episode { velocities: vec![0.0; 400], ..walk(3, adapted()) };
        let outcome = EpisodeOutcome::new(&still, Reference { oracle: Some(0.0), before: 1.0 });
        assert_eq!((outcome.recovery, outcome.stands_still), (None, true));
        // Nor does a robot that falls, which does not stand still either.
        let fallen = Episode { fell: true, ..walk(3, adapted()) };
        let outcome = EpisodeOutcome::new(&fallen, reference);
        assert_eq!(
            (outcome.recovery, outcome.stands_still, kept(&fallen, &fallen.velocities)),
            (None, false, 0.0)
        );
    }

    #[test]
    fn the_kept_speed_counts_no_step_before_the_damage() {
        // 50 steps of damage at 0.5 m/s after 100 healthy ones at 1 m/s.
        let velocities = [vec![1.0; 100], vec![0.5; 50]].concat();
        let short = Episode { class: 3, onset: 100, steps: 150, velocities, ..Episode::default() };
        assert!((kept(&short, &short.velocities) - 0.5).abs() < 1e-12);
        assert_eq!(kept(&short, &[]), 0.0);
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

    #[test]
    fn a_diagnosis_of_a_controller_that_suspects_nothing_before_is_the_alarm() {
        let reference = Reference { oracle: Some(1.0), before: 1.0 };
        let change = |step, class| [event(step, diagnosed(class)), event(step, EventKind::Adapted { class })];
        let outcome = EpisodeOutcome::new(&walk(3, [change(115, 2), change(125, 3)].concat()), reference);
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.first_diagnosis), (false, Some(15), Some(2)));
        assert_eq!((outcome.assumed, outcome.diagnosis_windows), (3, 2));
        let outcome = EpisodeOutcome::new(&walk(0, [change(30, 2), change(50, 0)].concat()), reference);
        assert_eq!((outcome.false_alarm, outcome.delay, outcome.assumed), (true, None, 0));
    }

    #[test]
    fn a_robot_with_commands_stands_still_if_it_tracks_them_like_one_at_rest() {
        let outcome = |tracking: f64, at_rest: f64, fell| {
            let steps = |value| vec![value; 400];
            let episode = Episode {
                trackings: steps(tracking),
                at_rest: steps(at_rest),
                fell,
                ..walk(3, vec![event(120, EventKind::Adapted { class: 3 })])
            };
            EpisodeOutcome::new(&episode, Reference { oracle: Some(0.8), before: 0.9 })
        };
        // At rest it would track 0.4, so that 0.46 is a tenth of what walking can add.
        assert!(outcome(0.45, 0.4, false).stands_still && !outcome(0.47, 0.4, false).stands_still);
        // It is commanded to stand, or has fallen.
        assert!(!outcome(0.95, 1.0, false).stands_still && !outcome(0.45, 0.4, true).stands_still);
        // Four fifths of the oracle's tracking are 0.64, in the first 50 steps after the diagnosis in step 120.
        assert_eq!(outcome(0.65, 0.4, false).recovery, Some(70));
        assert_eq!(outcome(0.63, 0.4, false).recovery, None);
    }
}
