//! The results of a sweep next to the paper's.

use std::fmt::Write as _;
use std::path::Path;

use dappo_learn::csv_table::{number, table};
use dappo_learn::error::Result;
use dappo_learn::files::write_atomically;
use dappo_learn::statistics::{mean, sample_deviation};

use super::paper::paper_result;
use super::{CellResult, Grid, PaperResult};
use crate::Method;

/// One cell over all its seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Time steps of a window.
    pub timesteps: usize,
    /// What the network sees.
    pub method: Method,
    /// Rollouts trained and validated on.
    pub rollouts: usize,
    /// Number of seeds.
    pub seeds: usize,
    /// Mean accuracy on the test rollouts.
    pub accuracy: f64,
    /// Standard deviation of the accuracy over seeds; NaN for a single one.
    pub deviation: f64,
    /// Mean accuracy on the validation rollouts.
    pub validation_accuracy: f64,
    /// The paper's result.
    pub paper: Option<PaperResult>,
}

/// The results of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Name of the robot.
    pub robot: String,
    /// The cells in the order of the paper: time steps, method, rollouts.
    pub rows: Vec<Row>,
}

impl Table {
    /// Combines the results of all cells; cells without a result are left out.
    #[must_use]
    pub fn new(robot: &str, grid: &Grid, results: &[CellResult]) -> Self {
        let mut rows = Vec::new();
        for &timesteps in &grid.timesteps {
            for &method in &grid.methods {
                for &rollouts in &grid.rollouts {
                    let of_row: Vec<&CellResult> = results
                        .iter()
                        .filter(|result| {
                            let cell = result.cell;
                            (cell.timesteps, cell.method, cell.rollouts) == (timesteps, method, rollouts)
                        })
                        .collect();
                    if of_row.is_empty() {
                        continue;
                    }
                    let accuracies: Vec<f64> = of_row.iter().map(|result| result.accuracy).collect();
                    let validation: Vec<f64> =
                        of_row.iter().map(|result| result.validation_accuracy).collect();
                    rows.push(Row {
                        timesteps,
                        method,
                        rollouts,
                        seeds: of_row.len(),
                        accuracy: mean(accuracies.iter().copied()),
                        deviation: sample_deviation(&accuracies),
                        validation_accuracy: mean(validation.iter().copied()),
                        paper: paper_result(robot, timesteps, method, rollouts),
                    });
                }
            }
        }
        Self { robot: robot.to_owned(), rows }
    }

    /// How many rows are at or above the paper's accuracy, and how many the paper has.
    #[must_use]
    pub fn at_or_above_the_paper(&self) -> (usize, usize) {
        let known = self.rows.iter().filter_map(|row| Some((row.accuracy, row.paper?.accuracy)));
        known.fold((0, 0), |(above, all), (ours, papers)| (above + usize::from(ours >= papers), all + 1))
    }

    /// Writes `table1.csv` and `table1.txt` into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_atomically(&folder.join("table1.csv"), self.csv().as_bytes())?;
        write_atomically(&folder.join("table1.txt"), self.text().as_bytes())
    }

    /// As CSV, accuracies in percent.
    #[must_use]
    pub fn csv(&self) -> String {
        let columns = [
            "robot",
            "timesteps",
            "method",
            "rollouts",
            "seeds",
            "accuracy_pct",
            "sd_pct",
            "validation_accuracy_pct",
            "paper_accuracy_pct",
            "paper_pm_pct",
        ];
        let row = |row: &Row| {
            let paper =
                |of: fn(PaperResult) -> f64| row.paper.map_or_else(String::new, |paper| percent(of(paper)));
            vec![
                self.robot.clone(),
                row.timesteps.to_string(),
                row.method.name().to_owned(),
                row.rollouts.to_string(),
                row.seeds.to_string(),
                percent(row.accuracy),
                percent(row.deviation),
                percent(row.validation_accuracy),
                paper(|paper| paper.accuracy),
                paper(|paper| paper.plus_minus),
            ]
        };
        table(&columns, self.rows.iter().map(row))
    }

    /// As text: ours and the paper's side by side.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!(
            "{:>5} {:>6} {:>8} {:>5} {:>15} {:>15} {:>7}\n",
            "steps", "method", "rollouts", "seeds", "accuracy %", "paper %", "gain"
        );
        for row in &self.rows {
            let pair = |value: f64, error: f64| {
                let error = if error.is_nan() { "–".into() } else { percent(error) };
                format!("{} ± {error}", percent(value))
            };
            let ours = pair(row.accuracy, row.deviation);
            let (papers, gain) = row.paper.map_or_else(Default::default, |paper| {
                let gain = format!("{:+.2}", 100.0 * (row.accuracy - paper.accuracy));
                (pair(paper.accuracy, paper.plus_minus), gain)
            });
            let Row { timesteps, method, rollouts, seeds, .. } = row;
            let method = method.name();
            let _ = writeln!(
                text,
                "{timesteps:>5} {method:>6} {rollouts:>8} {seeds:>5} {ours:>15} {papers:>15} {gain:>7}"
            );
        }
        text
    }
}

fn percent(share: f64) -> String {
    number(100.0 * share, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::Cell;

    fn result(method: Method, seed: u64, accuracy: f64) -> CellResult {
        CellResult {
            cell: Cell { timesteps: 50, method, rollouts: 7000, seed },
            accuracy,
            standard_error: 0.0,
            validation_accuracy: accuracy + 0.01,
            log_loss: 0.0,
            calibration_error: 0.0,
            epochs: 1,
            best_epoch: 1,
        }
    }

    #[test]
    fn a_row_is_the_mean_over_seeds_beside_the_papers_number() {
        let methods = vec![Method::A, Method::B];
        let grid = Grid { timesteps: vec![50], methods, rollouts: vec![7000], seeds: 3, samples: 1 };
        let seeds =
            [(0, 0.96), (1, 0.97), (2, 0.98)].map(|(seed, accuracy)| result(Method::B, seed, accuracy));
        let table = Table::new("ant", &grid, &[&seeds[..], &[result(Method::A, 0, 0.9)]].concat());
        // np.mean([96, 97, 98]), np.std([96, 97, 98], ddof=1); one seed has no spread.
        assert_eq!(
            table.csv().lines().collect::<Vec<_>>()[1..],
            ["ant,50,A,7000,1,90.00,,91.00,92.83,1.80", "ant,50,B,7000,3,97.00,1.00,98.00,96.80,1.48",]
        );
        assert_eq!(table.at_or_above_the_paper(), (1, 2));
        assert!(table.text().contains("97.00 ± 1.00"), "{}", table.text());
    }
}
