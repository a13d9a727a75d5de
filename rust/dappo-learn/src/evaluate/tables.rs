//! The tables of an evaluation: one row a damage class, and one row a group of classes.

use std::fmt::Write as _;

use serde::Serialize;

use super::encoding::Encoding;
use crate::error::{LearnError, Result};
use crate::simulator::Simulator;

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
    /// Mean of Σ reward.
    pub episode_return: f64,
    /// Mean number of steps.
    pub episode_length: f64,
    /// Episodes that ended in failure.
    pub falls: usize,
    /// Episodes among them that ended because the physics diverged.
    pub diverged: usize,
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
    /// classes; NaN for a single episode a class. It says nothing about the spread between classes.
    pub standard_error: f64,
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
    /// What the policy was told about the damage.
    pub encoding: Encoding,
    /// What simulated.
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

    /// Mean forward reward over all classes.
    #[must_use]
    pub fn mean_forward_reward(&self) -> f64 {
        mean(self.classes.iter().map(|class| class.forward_reward))
    }

    /// The table of the classes as CSV with a header line.
    #[must_use]
    pub fn class_table(&self) -> String {
        let mut text = format!(
            "class,name,group,episodes,forward_reward,standard_error,episode_return,episode_length,falls,\
             diverged,{}\n",
            Simulator::COLUMNS
        );
        let simulator = self.simulator.cells();
        for c in &self.classes {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{:.4},{},{:.4},{:.2},{},{},{simulator}",
                c.class,
                c.name,
                c.group,
                c.episodes,
                c.forward_reward,
                empty_if_nan(c.standard_error),
                c.episode_return,
                c.episode_length,
                c.falls,
                c.diverged
            );
        }
        text
    }

    /// The table of the groups as CSV with a header line.
    #[must_use]
    pub fn group_table(&self) -> String {
        let mut text = format!(
            "group,classes,episodes,forward_reward,standard_error,falls,diverged,{}\n",
            Simulator::COLUMNS
        );
        let simulator = self.simulator.cells();
        for g in &self.groups {
            let _ = writeln!(
                text,
                "{},{},{},{:.4},{},{},{},{simulator}",
                g.group,
                g.classes,
                g.episodes,
                g.forward_reward,
                empty_if_nan(g.standard_error),
                g.falls,
                g.diverged
            );
        }
        text
    }
}

/// Mean forward velocity of every class, m/s, from a table that [`Evaluation::class_table`] wrote. The classes must be
/// those of `names`, in this order.
pub fn mean_velocities(table: &str, names: &[String]) -> Result<Vec<f64>> {
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<&str>>());
    let header = lines.next().unwrap_or_default();
    let column = |name: &str| {
        header.iter().position(|column| *column == name).ok_or_else(|| {
            LearnError::Invalid(format!(
                "the table of the evaluation has no column `{name}`; evaluate the run again"
            ))
        })
    };
    let (class, reward, length) = (column("name")?, column("forward_reward")?, column("episode_length")?);
    let rows: Vec<Vec<&str>> = lines.collect();
    let found: Vec<&str> = rows.iter().filter_map(|row| row.get(class)).copied().collect();
    if found != names.iter().map(String::as_str).collect::<Vec<_>>() {
        return Err(LearnError::Invalid(format!(
            "the table of the evaluation has {} damage classes, expected the {} of the robot in their order; evaluate \
             the run again",
            found.len(),
            names.len()
        )));
    }
    let number = |row: &[&str], column: usize| {
        row.get(column)
            .and_then(|text| text.parse::<f64>().ok())
            .filter(|number| number.is_finite())
            .ok_or_else(|| {
                LearnError::Invalid(format!(
                    "the table of the evaluation is broken at `{}`; evaluate the run again",
                    row.join(",")
                ))
            })
    };
    // So few digits come back from any text as they were written; the table's own tell no more.
    let rounded = |velocity: f64| (velocity * 1e6).round() / 1e6;
    rows.iter().map(|row| Ok(rounded(number(row, reward)? / number(row, length)?.max(1.0)))).collect()
}

fn empty_if_nan(value: f64) -> String {
    if value.is_nan() { String::new() } else { format!("{value:.4}") }
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
    let variance: f64 = classes.iter().map(|class| class.standard_error.powi(2)).sum();
    GroupResult {
        group: name.to_owned(),
        classes: classes.len(),
        episodes: classes.iter().map(|class| class.episodes).sum(),
        forward_reward: mean(classes.iter().map(|class| class.forward_reward)),
        standard_error: variance.sqrt() / classes.len() as f64,
        falls: classes.iter().map(|class| class.falls).sum(),
        diverged: classes.iter().map(|class| class.diverged).sum(),
    }
}

pub(super) fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn simulator() -> Simulator {
        let [backend, precision, device, physics] = ["lanes", "f64", "cpu", "rk4"].map(str::to_owned);
        Simulator { backend, precision, device, physics }
    }

    pub fn class(class: usize, group: &str, forward_reward: f64, standard_error: f64) -> ClassResult {
        ClassResult {
            class,
            name: format!("class {class}"),
            group: group.into(),
            episodes: if standard_error.is_nan() { 1 } else { 4 },
            forward_reward,
            standard_error,
            episode_return: 0.5,
            episode_length: 20.0,
            falls: class,
            diverged: class / 2,
        }
    }

    fn evaluation(errors: [f64; 4]) -> Evaluation {
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
    fn velocities_read_back_from_a_table_are_rewards_a_step_and_other_tables_are_refused() {
        let table = evaluation([1.0; 4]).class_table();
        let names: Vec<String> = (0..4).map(|class| format!("class {class}")).collect();
        // Forward rewards of 10, 4, 7 and -1 in 20 steps.
        assert_eq!(mean_velocities(&table, &names).unwrap(), [0.5, 0.2, 0.35, -0.05]);
        let refuse = |table: &str, names: &[String]| mean_velocities(table, names).unwrap_err().to_string();
        assert!(refuse(&table, &names[..3]).contains("has 4 damage classes, expected the 3"));
        assert!(refuse(&table.replace("episode_length", "length"), &names).contains("`episode_length`"));
        assert!(refuse(&table.replace("10.0000", "fast"), &names).contains("broken at `0,class 0"));
        assert!(refuse("", &names).contains("no column `name`"));
    }

    #[test]
    fn a_group_weighs_its_classes_equally_and_the_last_one_holds_them_all() {
        // D1: (4 + 7) / 2 = 5.5, √(3² + 4²) / 2 = 2.5. All: 20 / 4 = 5, √(2² + 3² + 4² + 6²) / 4 = √65 / 4 = 2.0156.
        let expected = "\
            group,classes,episodes,forward_reward,standard_error,falls,diverged,backend,precision,device,physics\n\
            none,1,4,10.0000,2.0000,0,0,lanes,f64,cpu,rk4\n\
            D1,2,8,5.5000,2.5000,3,1,lanes,f64,cpu,rk4\n\
            D1_1 A,1,4,-1.0000,6.0000,3,1,lanes,f64,cpu,rk4\n\
            all,4,16,5.0000,2.0156,6,2,lanes,f64,cpu,rk4\n";
        let evaluation = evaluation([2.0, 3.0, 4.0, 6.0]);
        assert_eq!(evaluation.group_table(), expected);
        assert_eq!(evaluation.mean_forward_reward(), 5.0);
    }

    #[test]
    fn a_single_episode_a_class_has_no_standard_error() {
        let evaluation = evaluation([f64::NAN; 4]);
        let rows: Vec<String> = evaluation.group_table().lines().skip(1).map(ToOwned::to_owned).collect();
        assert_eq!(rows[1], "D1,2,2,5.5000,,3,1,lanes,f64,cpu,rk4");
        assert_eq!(rows[3], "all,4,4,5.0000,,6,2,lanes,f64,cpu,rk4");
        let row = evaluation.class_table().lines().nth(3).map(ToOwned::to_owned).unwrap();
        assert_eq!(row, "2,class 2,D1,1,7.0000,,0.5000,20.00,2,1,lanes,f64,cpu,rk4");
    }
}
