//! Trials as text.

use dappo_learn::text_table::table;
use dappo_learn::walk::{Event, EventKind, KnownClasses, Trial};

use super::{AdaptationSummary, ClassOutcome, Contest, DecisionTime};

impl AdaptationSummary {
    /// The events and numbers of a single damage class, or the tables of all classes. `control_period` is the length
    /// of a step, s.
    #[must_use]
    pub fn text(
        &self,
        trial: &Trial,
        known: &KnownClasses,
        contest: &Contest,
        control_period: f64,
    ) -> String {
        let found = if let [only] = self.classes.as_slice() {
            let first = contest.adapted.episodes.first();
            let events = first.map_or(&[][..], |episode| episode.events.as_slice());
            events_text(events, trial, &known.known_names) + &only.text(trial, control_period)
        } else {
            self.diagnoses() + &self.walks() + &self.means()
        };
        found + &self.decision_ms.text()
    }

    /// The diagnoses of every class.
    fn diagnoses(&self) -> String {
        let headers = [
            "<damage",
            "false alarms",
            "detected",
            "after steps",
            "first diagnosis correct",
            "code correct at the end",
        ];
        let rows = self.classes.iter().map(|c| {
            let of_damage = |count| if c.class == 0 { "–".to_owned() } else { c.share_of_episodes(count) };
            [
                c.name.clone(),
                c.share_of_episodes(c.false_alarms),
                of_damage(c.detected),
                steps(c.median_delay),
                of_damage(c.correct_first),
                c.share_of_episodes(c.correct_last),
            ]
        });
        table(headers, rows)
    }

    /// How the robots of every class walked on. The speed, or tracking, kept is that over the last 200 steps.
    fn walks(&self) -> String {
        let headers = [
            "<damage",
            "recovered",
            "stood still",
            "fell",
            if self.has_commands() { "kept tracking" } else { "kept m/s" },
            "of before",
            "of oracle",
            "adapted",
            "oracle",
            "no adaptation",
            "without code",
        ];
        let reward = |reward: Option<f64>| reward.map_or_else(String::new, |reward| format!("{reward:.1}"));
        let rows = self.classes.iter().map(|c| {
            let is_comparable = c.class != 0 && c.oracle.is_some();
            [
                c.name.clone(),
                if is_comparable { c.share_of_episodes(c.recovered) } else { "–".to_owned() },
                c.share_of_episodes(c.stood_still),
                c.share_of_episodes(c.falls),
                format!("{:.2}", c.kept()),
                percent(share(c.kept(), Some(c.before()))),
                percent(share(c.kept(), c.oracle_kept())),
                reward(Some(c.adapted)),
                reward(c.oracle),
                reward(Some(c.no_adaptation)),
                reward(c.unaware),
            ]
        });
        table(headers, rows)
    }

    fn has_commands(&self) -> bool {
        self.classes.iter().any(ClassOutcome::has_commands)
    }

    /// The means over all classes.
    fn means(&self) -> String {
        let (speed, reward) =
            if self.has_commands() { ("tracking", "tracking") } else { ("speed", "forward reward") };
        let left_out = match self.classes.iter().map(|class| class.ended_before_onset).sum() {
            0_usize => String::new(),
            some => format!("episodes left out, which ended before the damage: {some}\n"),
        };
        let unaware = self
            .unaware_share
            .map_or_else(String::new, |share| format!(", without damage code {}", percent(Some(share))));
        [
            format!("healthy episodes without a false alarm: {}\n", percent(self.healthy_without_alarm)),
            left_out,
            format!(
                "damage that costs more than half of the {speed}: {} of {} episodes detected, \
                 after {} steps (median)\n",
                percent(self.severe_detected),
                self.severe_episodes,
                steps(self.severe_median_delay)
            ),
            format!(
                "first diagnosis correct: {}; damage code correct at the end: {}\n",
                percent(self.correct_first),
                percent(self.correct_last)
            ),
            format!(
                "{speed} over the last 200 steps: {} of the oracle's, {} of that before the damage\n",
                percent(self.kept_of_oracle),
                percent(self.kept_of_healthy)
            ),
            format!(
                "episodes with damage: recovered {}, stood still at the end {}, fell {}\n",
                percent(self.recovered),
                percent(self.stood_still),
                percent(self.fell)
            ),
            format!(
                "{reward} after the damage, as a share of the oracle's: adapted {}, \
                 no adaptation {}{unaware}\n",
                percent(self.adapted_share),
                percent(self.no_adaptation_share)
            ),
        ]
        .concat()
    }
}

impl ClassOutcome {
    /// The numbers of a single class.
    fn text(&self, trial: &Trial, control_period: f64) -> String {
        let of = |count: usize| format!("{count} of {}", self.episodes);
        let (what, unit, sums) = if self.has_commands() {
            ("tracking of the commands", "", "tracking, summed over the steps")
        } else {
            ("forward velocity", " m/s", "forward reward and distance")
        };
        let left_out = match self.ended_before_onset {
            0 => String::new(),
            some => format!("  left out, ended before the damage: {some}\n"),
        };
        let of_oracle = self.oracle_kept().map_or_else(String::new, |oracle| {
            format!(", {} of the oracle's", percent(share(self.kept(), Some(oracle))))
        });
        let recovered = if self.class != 0 && self.oracle.is_some() {
            format!(
                "  recovered (diagnosed, and at least 80 % of the oracle's {} at the end): {}, \
                 after {} steps (median)\n",
                if self.has_commands() { "tracking" } else { "speed" },
                of(self.recovered),
                steps(self.median_recovery)
            )
        } else {
            String::new()
        };
        let rewards = [
            ("adapted", Some(self.adapted)),
            ("oracle (given the damage code at once)", self.oracle),
            ("no adaptation (code of a healthy robot)", Some(self.no_adaptation)),
            ("policy without damage code", self.unaware),
        ];
        let rewards = rewards.into_iter().filter_map(|(name, reward)| {
            reward.map(|reward| {
                let meters = format!(" {:>8.1} m", reward * control_period);
                let meters = if self.has_commands() { "" } else { &meters };
                format!("  {reward:>10.1}{meters}  {name}\n")
            })
        });
        [
            format!("{}, {} episodes\n", self.name, self.episodes),
            left_out,
            self.diagnosis(),
            format!(
                "  {what} before step {}: {:.2}{unit}; over the last 200 steps: {:.2}{unit}, \
                 {} of that before{of_oracle}\n",
                trial.course.onset.first,
                self.before(),
                self.kept(),
                percent(share(self.kept(), Some(self.before())))
            ),
            recovered,
            format!("  stood still at the end: {}; fell: {}\n", of(self.stood_still), of(self.falls)),
            format!("  {sums} from step {} on:\n", trial.course.onset.first),
            rewards.collect(),
        ]
        .concat()
    }

    /// The diagnoses of the controller.
    fn diagnosis(&self) -> String {
        let of = |count: usize| format!("{count} of {}", self.episodes);
        if self.class == 0 {
            return format!("  false alarms: {}\n", of(self.false_alarms));
        }
        let assumed: Vec<String> =
            self.assumed.iter().map(|assumed| format!("{} ({})", assumed.name, assumed.episodes)).collect();
        [
            format!(
                "  damage detected: {}, after {} steps (median); false alarms before: {}\n",
                of(self.detected),
                steps(self.median_delay),
                of(self.false_alarms)
            ),
            format!(
                "  first diagnosis correct: {}; damage code correct at the end: {}\n",
                of(self.correct_first),
                of(self.correct_last)
            ),
            format!("  damage codes at the end, with episodes: {}\n", assumed.join(", ")),
        ]
        .concat()
    }

    fn share_of_episodes(&self, count: usize) -> String {
        format!("{:.0} %", 100.0 * count as f64 / self.episodes as f64)
    }
}

impl DecisionTime {
    fn text(&self) -> String {
        let Self { robots, median, p99, longest } = self;
        format!(
            "time of a decision for {robots} robots: {median:.2} ms (median), {p99:.2} ms (99th percentile), \
             {longest:.2} ms (longest)\n"
        )
    }
}

/// The events of the first episode; `names` are those of the controller's damage classes.
fn events_text(events: &[Event], trial: &Trial, names: &[String]) -> String {
    let header = format!("episode 1 of {}, damage at step {}\n", trial.episodes, trial.course.onset.first);
    if events.is_empty() {
        return header + "  no damage suspected\n";
    }
    let line = |event: &Event| format!("  step {:>4}  {}\n", event.step, event_text(&event.kind, names));
    header + &events.iter().map(line).collect::<String>()
}

fn event_text(event: &EventKind, names: &[String]) -> String {
    let name = |class: usize| names.get(class).map_or("", String::as_str);
    match event {
        EventKind::Suspected { forward_velocity, expected, residual } => {
            let residual = residual.map_or_else(String::new, |residual| format!(", residual {residual:.3}"));
            format!("damage suspected: {forward_velocity:.2} m/s, expected {expected:.2} m/s{residual}")
        }
        EventKind::Diagnosed { class, confidence, accepted } => {
            let rejected = if *accepted { "" } else { ", rejected" };
            format!("diagnosis: {} ({:.0} %{rejected})", name(*class), 100.0 * confidence)
        }
        EventKind::Adapted { class } => format!("damage code of the policy: {}", name(*class)),
        EventKind::Withdrawn { class, residual, healthy } => format!(
            "diagnosis withdrawn: {} (residual of its twin {residual:.3}, of the healthy twin {healthy:.3})",
            name(*class)
        ),
        EventKind::ObservationInvalid { entries } => format!("observation: {entries} entries are not finite"),
        EventKind::ObservationValid => "observation: all entries are finite again".to_owned(),
    }
}

/// A part of a whole that must be above 0.
fn share(part: f64, whole: Option<f64>) -> Option<f64> {
    whole.filter(|whole| *whole > 0.0).map(|whole| part / whole)
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), |share| format!("{:.1} %", 100.0 * share))
}

fn steps(median: Option<f64>) -> String {
    median.map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}"))
}

#[cfg(test)]
mod tests;
