//! The tables of an evaluation: one row a damage class, and one row a group of classes.

use serde::Serialize;

use super::score::Score;
use crate::csv_table::{number, table};
use crate::error::Result;
use crate::metrics::EvaluationMeans;
use crate::run_folder::EvaluationFolder;
use crate::simulator::Simulator;
use crate::statistics::mean;
use crate::walk::Encoding;

/// The result of one damage class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassResult {
    /// Damage class.
    pub class: usize,
    /// Its name.
    pub name: String,
    /// Its group.
    pub group: String,
    /// Episodes run.
    pub episodes: usize,
    /// Mean over episodes of Σ forward velocity, m/s.
    pub forward_reward: f64,
    /// Standard error of that mean; NaN for a single episode.
    pub standard_error: f64,
    /// Forward velocity over all steps of all episodes, m/s.
    pub forward_velocity: f64,
    /// Mean over episodes of the distance forward, m.
    pub distance: f64,
    /// Mean over episodes of how well commanded velocities were tracked, from 0 to 1: the mean of the term
    /// `track_lin_vel` over the steps of an episode, 0 after a failure. `None` where the reward does not have it.
    pub tracking: Option<f64>,
    /// Standard error of that mean; NaN for a single episode.
    pub tracking_standard_error: Option<f64>,
    /// Mean of Σ reward.
    pub episode_return: f64,
    /// Mean number of steps.
    pub episode_length: f64,
    /// Episodes that ended in failure.
    pub falls: usize,
    /// Episodes among them that ended because the physics diverged.
    pub diverged: usize,
}

impl ClassResult {
    /// What policies are compared by: tracking where there are commands, else the forward reward.
    #[must_use]
    pub fn score(&self) -> f64 {
        self.tracking.unwrap_or(self.forward_reward)
    }
}

/// The result of a group of damage classes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupResult {
    /// Name of the group, or [`ALL`].
    pub group: String,
    /// Damage classes in it.
    pub classes: usize,
    /// Episodes of all of them.
    pub episodes: usize,
    /// Mean of the classes' forward rewards, m/s. Each class has the same weight.
    pub forward_reward: f64,
    /// Standard error of that mean over episodes, √(Σ s²) / classes with s the standard errors of the
    /// classes; NaN for a single episode a class. It does not include the spread between classes.
    pub standard_error: f64,
    /// Mean of the classes' forward velocities, m/s.
    pub forward_velocity: f64,
    /// Mean of the classes' distances, m.
    pub distance: f64,
    /// Mean of the classes' tracking; `None` for a task without commands.
    pub tracking: Option<f64>,
    /// Standard error of that mean over episodes, as that of the forward reward.
    pub tracking_standard_error: Option<f64>,
    /// Episodes that ended in failure.
    pub falls: usize,
    /// Episodes among them that ended because the physics diverged.
    pub diverged: usize,
}

/// Name of the last group, which holds every class.
pub const ALL: &str = "all";

/// The results of all damage classes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// How the policy's damage code came from the damage.
    pub encoding: Encoding,
    /// The simulator.
    #[serde(flatten)]
    pub simulator: Simulator,
    /// One entry a class, in canonical order.
    pub classes: Vec<ClassResult>,
    /// One entry a group in the order of their first classes, and one for all classes.
    pub groups: Vec<GroupResult>,
}

impl Evaluation {
    /// Forms the groups over the results of all classes.
    #[must_use]
    pub fn new(encoding: Encoding, simulator: Simulator, classes: Vec<ClassResult>) -> Self {
        let groups = groups(&classes);
        Self { encoding, simulator, classes, groups }
    }

    /// Writes its tables, and everything as JSON.
    pub fn write(&self, folder: &EvaluationFolder) -> Result<()> {
        folder.write(&self.encoding.file_name("per_class", "csv"), &self.class_table())?;
        folder.write(&self.encoding.file_name("groups", "csv"), &self.group_table())?;
        folder.write_json(&self.encoding.file_name("evaluation", "json"), self)
    }

    /// The group of all classes.
    #[must_use]
    pub fn all(&self) -> &GroupResult {
        // It is the last one, and always there.
        &self.groups[self.groups.len() - 1]
    }

    /// What policies are compared by.
    #[must_use]
    pub fn score(&self) -> Score {
        if self.is_commanded() { Score::Tracking } else { Score::ForwardReward }
    }

    /// Whether the task has commands.
    #[must_use]
    pub fn is_commanded(&self) -> bool {
        self.all().tracking.is_some()
    }

    /// Mean over all classes of what policies are compared by.
    #[must_use]
    pub fn mean_score(&self) -> f64 {
        mean(self.classes.iter().map(ClassResult::score))
    }

    /// Mean forward reward over all classes.
    #[must_use]
    pub fn mean_forward_reward(&self) -> f64 {
        mean(self.classes.iter().map(|class| class.forward_reward))
    }

    /// The table of the classes as CSV with a header line.
    #[must_use]
    pub fn class_table(&self) -> String {
        let columns = [
            &[
                "class",
                "name",
                "group",
                "episodes",
                "forward_reward",
                "standard_error",
                "forward_velocity",
                "distance",
                "episode_return",
                "episode_length",
                "falls",
                "diverged",
            ],
            tracking_columns(self.is_commanded()),
            &Simulator::COLUMNS[..],
        ]
        .concat();
        let row = |c: &ClassResult| {
            let cells = [
                c.class.to_string(),
                c.name.clone(),
                c.group.clone(),
                c.episodes.to_string(),
                format!("{:.4}", c.forward_reward),
                number(c.standard_error, 4),
                format!("{:.6}", c.forward_velocity),
                format!("{:.4}", c.distance),
                format!("{:.4}", c.episode_return),
                format!("{:.2}", c.episode_length),
                c.falls.to_string(),
                c.diverged.to_string(),
            ];
            cells
                .into_iter()
                .chain(tracking_cells(c.tracking, c.tracking_standard_error))
                .chain(self.simulator.cells())
                .collect()
        };
        table(&columns, self.classes.iter().map(row))
    }

    /// The table of the groups as CSV with a header line.
    #[must_use]
    fn group_table(&self) -> String {
        let columns = [
            &[
                "group",
                "classes",
                "episodes",
                "forward_reward",
                "standard_error",
                "forward_velocity",
                "distance",
                "falls",
                "diverged",
            ],
            tracking_columns(self.is_commanded()),
            &Simulator::COLUMNS[..],
        ]
        .concat();
        let row = |g: &GroupResult| {
            let cells = [
                g.group.clone(),
                g.classes.to_string(),
                g.episodes.to_string(),
                format!("{:.4}", g.forward_reward),
                number(g.standard_error, 4),
                format!("{:.6}", g.forward_velocity),
                format!("{:.4}", g.distance),
                g.falls.to_string(),
                g.diverged.to_string(),
            ];
            cells
                .into_iter()
                .chain(tracking_cells(g.tracking, g.tracking_standard_error))
                .chain(self.simulator.cells())
                .collect()
        };
        table(&columns, self.groups.iter().map(row))
    }
}

impl From<&Evaluation> for EvaluationMeans {
    fn from(evaluation: &Evaluation) -> Self {
        let all = evaluation.all();
        Self {
            evaluation_forward_reward: Some(all.forward_reward),
            evaluation_forward_velocity: Some(all.forward_velocity),
            evaluation_tracking: all.tracking,
            evaluation_fall_rate: Some(all.falls as f64 / all.episodes as f64),
        }
    }
}

/// The columns of the tracking, which only tasks with commands have.
fn tracking_columns(is_commanded: bool) -> &'static [&'static str] {
    if is_commanded { &["tracking", "tracking_standard_error"] } else { &[] }
}

fn tracking_cells(tracking: Option<f64>, standard_error: Option<f64>) -> impl Iterator<Item = String> {
    [tracking, standard_error].into_iter().flatten().map(|share| number(share, 4))
}

fn groups(classes: &[ClassResult]) -> Vec<GroupResult> {
    let mut names: Vec<&str> = Vec::new();
    for class in classes {
        if !names.contains(&class.group.as_str()) {
            names.push(&class.group);
        }
    }
    let of_group = |name: &str| classes.iter().filter(|class| class.group == name).collect::<Vec<_>>();
    let mut groups: Vec<GroupResult> = names.into_iter().map(|name| group(name, &of_group(name))).collect();
    groups.push(group(ALL, &classes.iter().collect::<Vec<_>>()));
    groups
}

fn group(name: &str, classes: &[&ClassResult]) -> GroupResult {
    // Of the mean of independent means.
    let error = |of: Vec<f64>| of.iter().map(|error| error.powi(2)).sum::<f64>().sqrt() / of.len() as f64;
    let tracked = |of: fn(&ClassResult) -> Option<f64>| {
        classes.iter().map(|class| of(class)).collect::<Option<Vec<f64>>>()
    };
    GroupResult {
        group: name.to_owned(),
        classes: classes.len(),
        episodes: classes.iter().map(|class| class.episodes).sum(),
        forward_reward: mean(classes.iter().map(|class| class.forward_reward)),
        standard_error: error(classes.iter().map(|class| class.standard_error).collect()),
        forward_velocity: mean(classes.iter().map(|class| class.forward_velocity)),
        distance: mean(classes.iter().map(|class| class.distance)),
        tracking: tracked(|class| class.tracking).map(|shares| mean(shares.into_iter())),
        tracking_standard_error: tracked(|class| class.tracking_standard_error).map(error),
        falls: classes.iter().map(|class| class.falls).sum(),
        diverged: classes.iter().map(|class| class.diverged).sum(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use dappo_sim::{Physics, Precision};

    use super::*;

    pub fn simulator() -> Simulator {
        Simulator { physics: Physics::Lanes(Precision::F64), integrator: "rk4".into() }
    }

    pub fn class(class: usize, group: &str, forward_reward: f64, standard_error: f64) -> ClassResult {
        ClassResult {
            class,
            name: format!("class {class}"),
            group: group.into(),
            episodes: if standard_error.is_nan() { 1 } else { 4 },
            forward_reward,
            standard_error,
            // Binary fractions, whose means are exact.
            forward_velocity: forward_reward / 16.0,
            distance: forward_reward / 8.0,
            tracking: None,
            tracking_standard_error: None,
            episode_return: 0.5,
            episode_length: 20.0,
            falls: class,
            diverged: class / 2,
        }
    }

    pub fn evaluation(errors: [f64; 4]) -> Evaluation {
        let [healthy, first, second, pair] = errors;
        let classes = vec![
            class(0, "none", 10.0, healthy),
            class(1, "D1", 4.0, first),
            class(2, "D1", 7.0, second),
            class(3, "D1_1 A", -1.0, pair),
        ];
        Evaluation::new(Encoding::True, simulator(), classes)
    }

    #[test]
    fn a_group_weighs_its_classes_equally_and_the_last_one_holds_them_all() {
        // D1: (4 + 7) / 2 = 5.5, √(3² + 4²) / 2 = 2.5. All: 20 / 4 = 5, √(2² + 3² + 4² + 6²) / 4 = √65 / 4 = 2.0156.
        // Velocities are a sixteenth and distances an eighth of the rewards.
        let expected = "\
            group,classes,episodes,forward_reward,standard_error,forward_velocity,distance,falls,diverged,\
            backend,precision,device,physics\n\
            none,1,4,10.0000,2.0000,0.625000,1.2500,0,0,lanes,f64,cpu,rk4\n\
            D1,2,8,5.5000,2.5000,0.343750,0.6875,3,1,lanes,f64,cpu,rk4\n\
            D1_1 A,1,4,-1.0000,6.0000,-0.062500,-0.1250,3,1,lanes,f64,cpu,rk4\n\
            all,4,16,5.0000,2.0156,0.312500,0.6250,6,2,lanes,f64,cpu,rk4\n";
        let evaluation = evaluation([2.0, 3.0, 4.0, 6.0]);
        assert_eq!(evaluation.group_table(), expected);
        assert_eq!(evaluation.mean_forward_reward(), 5.0);
    }

    #[test]
    fn a_single_episode_a_class_has_no_standard_error() {
        let evaluation = evaluation([f64::NAN; 4]);
        let rows: Vec<String> = evaluation.group_table().lines().skip(1).map(ToOwned::to_owned).collect();
        assert_eq!(rows[1], "D1,2,2,5.5000,,0.343750,0.6875,3,1,lanes,f64,cpu,rk4");
        assert_eq!(rows[3], "all,4,4,5.0000,,0.312500,0.6250,6,2,lanes,f64,cpu,rk4");
        let row = evaluation.class_table().lines().nth(3).map(ToOwned::to_owned).unwrap();
        assert_eq!(row, "2,class 2,D1,1,7.0000,,0.437500,0.8750,0.5000,20.00,2,1,lanes,f64,cpu,rk4");
    }
}
