//! The outcome of one damage class.

use dappo_learn::statistics::{mean, median};
use dappo_learn::walk::{Episode, KnownClasses, Trial, Walks};
use serde::Serialize;

use super::Contest;
use super::outcome::{EpisodeOutcome, Reference, kept, scores};

/// The outcome of one damage class. Scores are those of the steps of an episode from the damage on, summed: the forward
/// velocity, m/s, or the tracking of commands, from 0 to 1 a step; averaged over episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassOutcome {
    /// Damage class of the robot.
    pub class: usize,
    /// Its name.
    pub name: String,
    /// Episodes in which the damage struck; all others count for nothing here.
    pub episodes: usize,
    /// Episodes that ended before.
    pub ended_before_onset: usize,
    /// Episodes with an alarm before the onset (in the whole episode, if the robot stays healthy): a suspicion, or
    /// without a twin a diagnosis.
    pub false_alarms: usize,
    /// Episodes with an alarm after the damage struck.
    pub detected: usize,
    /// Median number of steps from the damage to the alarm, where there was one.
    pub median_delay: Option<f64>,
    /// Episodes whose first diagnosis after the onset was correct.
    pub correct_first: usize,
    /// Episodes whose assumed class was correct at the end.
    pub correct_last: usize,
    /// The assumed classes at the end of the episodes, the most frequent first.
    pub assumed: Vec<AssumedClass>,
    /// Mean number of diagnosis windows in an episode; without a twin, of changes of the assumed class.
    pub diagnosis_windows: f64,
    /// Episodes in which the robot recovered: it was diagnosed, and keeps four fifths of the oracle's score to the end.
    pub recovered: usize,
    /// Median number of steps from the onset to the recovery, where there was one.
    pub median_recovery: Option<f64>,
    /// Episodes in which the adapted robot fell.
    pub falls: usize,
    /// Episodes at whose end it stood still: at less than a tenth of the speed before the onset; or, other than
    /// commanded, with a tracking hardly above that of a robot at rest.
    pub stood_still: usize,
    /// Forward velocity before the damage, m/s.
    pub velocity_before: f64,
    /// Forward velocity over the last 200 steps, m/s; a fallen robot has 0.
    pub velocity_kept: f64,
    /// The same of the oracle; `None` for damage without a code of its own.
    pub oracle_velocity_kept: Option<f64>,
    /// How commands were tracked.
    #[serde(flatten)]
    pub tracking: Tracking,
    /// Score of the controller.
    pub adapted: f64,
    /// Score of the policy with the code of the active damage; `None` for damage without a code.
    pub oracle: Option<f64>,
    /// Score of the policy with the code of a healthy robot.
    pub no_adaptation: f64,
    /// Score of the policy without damage code, if there is one.
    pub unaware: Option<f64>,
}

/// How commands were tracked, from 0 to 1; nothing for a task without commands.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Tracking {
    /// Before the damage.
    #[serde(rename = "tracking_before")]
    pub before: Option<f64>,
    /// Over the last 200 steps; a fallen robot has 0.
    #[serde(rename = "tracking_kept")]
    pub kept: Option<f64>,
    /// The same of the oracle; `None` for damage without a code of its own, too.
    #[serde(rename = "oracle_tracking_kept")]
    pub oracle_kept: Option<f64>,
}

/// An assumed class.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AssumedClass {
    /// Its name.
    pub name: String,
    /// Episodes at whose end it was assumed.
    pub episodes: usize,
}

/// A number that every step of an episode has.
type Series = fn(&Episode) -> &[f64];

impl ClassOutcome {
    /// Whether the scores are trackings.
    #[must_use]
    pub fn has_commands(&self) -> bool {
        self.tracking.before.is_some()
    }

    /// Score before the damage, a step.
    #[must_use]
    pub fn before(&self) -> f64 {
        self.tracking.before.unwrap_or(self.velocity_before)
    }

    /// Score over the last 200 steps, a step; a fallen robot has 0.
    #[must_use]
    pub fn kept(&self) -> f64 {
        self.tracking.kept.unwrap_or(self.velocity_kept)
    }

    /// The same of the oracle.
    #[must_use]
    pub fn oracle_kept(&self) -> Option<f64> {
        if self.has_commands() { self.tracking.oracle_kept } else { self.oracle_velocity_kept }
    }

    /// The outcome of the class in row `row` of a trial, and that of each of its episodes.
    pub(super) fn new(
        trial: &Trial,
        row: usize,
        classes: &KnownClasses,
        contest: &Contest,
    ) -> (Self, Vec<EpisodeOutcome>) {
        let struck = struck(trial, row, &contest.adapted);
        let after = |walks: &Walks| average(walks, &struck, reward);
        let class = trial.classes[row];
        let known = classes.known[class];
        let series = |of: Series| {
            let before = |episode: &Episode| mean(of(episode).iter().take(episode.onset).copied());
            let keeps = |episode: &Episode| kept(episode, of(episode));
            let kept = average(&contest.adapted, &struck, keeps);
            let oracle = known.map(|_| average(&contest.oracle, &struck, keeps));
            (average(&contest.adapted, &struck, before), kept, oracle)
        };
        let has_commands = contest.adapted.episodes.iter().any(|episode| !episode.trackings.is_empty());
        let (velocity, score) = (series(|episode| &episode.velocities), series(scores));
        let (before, kept, oracle_kept) = score;
        let reference = Reference { oracle: oracle_kept, before };
        let tracking = Tracking { before: Some(before), kept: Some(kept), oracle_kept };
        let adapted = || struck.iter().map(|&episode| &contest.adapted.episodes[episode]);
        let outcomes: Vec<EpisodeOutcome> =
            adapted().map(|episode| EpisodeOutcome::new(episode, reference)).collect();
        let count = |holds: &dyn Fn(&EpisodeOutcome) -> bool| outcomes.iter().filter(|o| holds(o)).count();
        let steps = |of: fn(&EpisodeOutcome) -> Option<usize>| {
            outcomes.iter().filter_map(of).map(|steps| steps as f64)
        };
        let diagnosis_windows: usize = outcomes.iter().map(|outcome| outcome.diagnosis_windows).sum();
        let outcome = Self {
            class,
            name: classes.names[class].clone(),
            episodes: struck.len(),
            ended_before_onset: trial.episodes - struck.len(),
            false_alarms: count(&|outcome| outcome.false_alarm),
            detected: count(&|outcome| outcome.delay.is_some()),
            median_delay: median(steps(|outcome| outcome.delay)),
            correct_first: count(&|outcome| known.is_some() && outcome.first_diagnosis == known),
            correct_last: count(&|outcome| Some(outcome.assumed) == known),
            assumed: assumed(&outcomes, classes),
            diagnosis_windows: diagnosis_windows as f64 / struck.len() as f64,
            recovered: count(&|outcome| outcome.recovery.is_some()),
            median_recovery: median(steps(|outcome| outcome.recovery)),
            falls: adapted().filter(|episode| episode.fell).count(),
            stood_still: count(&|outcome| outcome.stands_still),
            velocity_before: velocity.0,
            velocity_kept: velocity.1,
            oracle_velocity_kept: velocity.2,
            tracking: if has_commands { tracking } else { Tracking::default() },
            adapted: after(&contest.adapted),
            oracle: known.map(|_| after(&contest.oracle)),
            no_adaptation: after(&contest.no_adaptation),
            unaware: contest.unaware.as_ref().map(after),
        };
        (outcome, outcomes)
    }
}

/// The episodes of the class in row `row` that did not end before its damage struck; all of healthy robots.
pub(super) fn struck(trial: &Trial, row: usize, walks: &Walks) -> Vec<usize> {
    let is_struck = |episode: &Episode| episode.class == 0 || episode.steps > episode.onset;
    let of_class = row * trial.episodes..(row + 1) * trial.episodes;
    of_class.filter(|&episode| is_struck(&walks.episodes[episode])).collect()
}

/// The assumed classes at the end of several episodes, the most frequent first.
fn assumed(outcomes: &[EpisodeOutcome], classes: &KnownClasses) -> Vec<AssumedClass> {
    let mut episodes = vec![0; classes.known_names.len()];
    outcomes.iter().for_each(|outcome| episodes[outcome.assumed] += 1);
    let named = classes.known_names.iter().zip(episodes);
    let mut assumed: Vec<AssumedClass> = named
        .filter(|(_, episodes)| *episodes > 0)
        .map(|(name, episodes)| AssumedClass { name: name.clone(), episodes })
        .collect();
    assumed.sort_by_key(|assumed| std::cmp::Reverse(assumed.episodes));
    assumed
}

/// Mean over some episodes; NaN for none.
pub(super) fn average(walks: &Walks, episodes: &[usize], of: impl Fn(&Episode) -> f64) -> f64 {
    mean(episodes.iter().map(|&episode| of(&walks.episodes[episode])))
}

/// Σ score from the damage on.
fn reward(episode: &Episode) -> f64 {
    scores(episode).iter().skip(episode.onset).sum()
}

/// Mean score from the damage on; 0 if the robot fell before. A robot that falls tracks no command for the rest of the
/// `steps` of an episode.
pub(super) fn pace(episode: &Episode, steps: usize) -> f64 {
    let Some(rest) = scores(episode).get(episode.onset..).filter(|rest| !rest.is_empty()) else { return 0.0 };
    let counted =
        if episode.trackings.is_empty() { rest.len() } else { rest.len().max(steps - episode.onset) };
    rest.iter().sum::<f64>() / counted as f64
}
