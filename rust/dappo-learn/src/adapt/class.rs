//! The outcome of one damage class.

use serde::Serialize;

use super::outcome::{EpisodeOutcome, mean};
use super::{Contest, Trial, Vocabulary, Walk, Walks};

/// The outcome of one damage class. Forward rewards are Σ forward velocity over the steps of an episode from the
/// damage on, in m/s, averaged over episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassOutcome {
    /// Damage class of the robot.
    pub class: usize,
    /// Its name.
    pub name: String,
    /// Episodes in which the damage struck; all others count for nothing here.
    pub episodes: usize,
    /// Episodes that ended before.
    pub ended_before: usize,
    /// Episodes with a suspicion before the damage (in all of the episode, if the robot stays healthy).
    pub false_alarms: usize,
    /// Episodes in which damage was suspected after it struck.
    pub detected: usize,
    /// Median number of steps from the damage to the suspicion, where there was one.
    pub median_delay: Option<f64>,
    /// Episodes whose first diagnosis after the damage was right.
    pub right_at_first: usize,
    /// Episodes in which the policy was told the right class in the end.
    pub right_at_last: usize,
    /// What the policy was told in the end, the most frequent first.
    pub told: Vec<Told>,
    /// Examinations an episode.
    pub examinations: f64,
    /// Episodes in which the robot walked as fast as the oracle, but for a fifth, some time after the diagnosis.
    pub recovered: usize,
    /// Median number of steps that this took from the damage on, where it happened.
    pub median_recovery: Option<f64>,
    /// Episodes that the controller ended in failure.
    pub falls: usize,
    /// Forward velocity before the damage, m/s.
    pub velocity_before: f64,
    /// Forward reward of the controller.
    pub adapted: f64,
    /// Forward reward of the policy that is told the truth at once; `None` for damage that it does not know.
    pub oracle: Option<f64>,
    /// Forward reward of the policy that takes the robot for healthy.
    pub unadapted: f64,
    /// Forward reward of PPO-Unaware, if there is one.
    pub unaware: Option<f64>,
}

/// A damage class that the policy was told.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Told {
    /// Its name.
    pub name: String,
    /// Episodes at whose end it was in force.
    pub episodes: usize,
}

impl ClassOutcome {
    /// The outcome of the class in row `row` of a trial, and that of each of its episodes.
    pub(super) fn new(
        trial: &Trial,
        row: usize,
        vocabulary: &Vocabulary,
        contest: &Contest,
    ) -> (Self, Vec<EpisodeOutcome>) {
        let struck = trial.struck(row, &contest.adapted);
        let after = |walks: &Walks| average(walks, &struck, |walk| reward(walk, trial));
        let class = trial.classes[row];
        let known = vocabulary.known[class];
        let oracle = known.map(|_| average(&contest.oracle, &struck, |walk| speed(walk, trial)));
        let adapted = || struck.iter().map(|&episode| &contest.adapted.episodes[episode]);
        let outcomes: Vec<EpisodeOutcome> =
            adapted().map(|walk| EpisodeOutcome::new(walk, trial.onset, oracle)).collect();
        let count = |holds: &dyn Fn(&EpisodeOutcome) -> bool| outcomes.iter().filter(|o| holds(o)).count();
        let examinations: usize = outcomes.iter().map(|outcome| outcome.examinations).sum();
        let outcome = Self {
            class,
            name: vocabulary.names[class].clone(),
            episodes: struck.len(),
            ended_before: trial.episodes - struck.len(),
            false_alarms: count(&|outcome| outcome.false_alarm),
            detected: count(&|outcome| outcome.delay.is_some()),
            median_delay: median(outcomes.iter().filter_map(|outcome| outcome.delay)),
            right_at_first: count(&|outcome| known.is_some() && outcome.first_diagnosis == known),
            right_at_last: count(&|outcome| Some(outcome.told) == known),
            told: told(&outcomes, vocabulary),
            examinations: examinations as f64 / struck.len() as f64,
            recovered: count(&|outcome| outcome.recovery.is_some()),
            median_recovery: median(outcomes.iter().filter_map(|outcome| outcome.recovery)),
            falls: adapted().filter(|walk| walk.fell).count(),
            velocity_before: average(&contest.adapted, &struck, |walk| {
                mean(&walk.velocities[..trial.onset.min(walk.velocities.len())])
            }),
            adapted: after(&contest.adapted),
            oracle: known.map(|_| after(&contest.oracle)),
            unadapted: after(&contest.unadapted),
            unaware: contest.unaware.as_ref().map(after),
        };
        (outcome, outcomes)
    }
}

/// What the policy was told in the end of several episodes, the most frequent first.
fn told(outcomes: &[EpisodeOutcome], vocabulary: &Vocabulary) -> Vec<Told> {
    let mut episodes = vec![0; vocabulary.known_names.len()];
    outcomes.iter().for_each(|outcome| episodes[outcome.told] += 1);
    let named = vocabulary.known_names.iter().zip(episodes);
    let mut told: Vec<Told> = named
        .filter(|(_, episodes)| *episodes > 0)
        .map(|(name, episodes)| Told { name: name.clone(), episodes })
        .collect();
    told.sort_by_key(|told| std::cmp::Reverse(told.episodes));
    told
}

/// Mean over some episodes; NaN for none.
pub(super) fn average(walks: &Walks, episodes: &[usize], of: impl Fn(&Walk) -> f64) -> f64 {
    episodes.iter().map(|&episode| of(&walks.episodes[episode])).sum::<f64>() / episodes.len() as f64
}

/// Σ forward velocity from the damage on.
fn reward(walk: &Walk, trial: &Trial) -> f64 {
    walk.velocities.iter().skip(trial.onset).sum()
}

/// Mean forward velocity from the damage on; 0 if the robot fell before.
pub(super) fn speed(walk: &Walk, trial: &Trial) -> f64 {
    walk.velocities.get(trial.onset..).filter(|rest| !rest.is_empty()).map_or(0.0, mean)
}

pub(super) fn median(values: impl Iterator<Item = usize>) -> Option<f64> {
    let mut sorted: Vec<usize> = values.collect();
    sorted.sort_unstable();
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        count if count % 2 == 1 => Some(sorted[half] as f64),
        _ => Some(f64::midpoint(sorted[half - 1] as f64, sorted[half] as f64)),
    }
}
