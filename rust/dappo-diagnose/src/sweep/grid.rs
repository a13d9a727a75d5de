//! The cells of a sweep.

use serde::{Deserialize, Serialize};

use crate::{DiagnoserConfig, Method};

/// Bounds of the epochs of a cell, whatever the budget of samples.
const EPOCHS: (usize, usize) = (2, 50);

/// All combinations of some settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grid {
    /// Time steps of a window.
    pub timesteps: Vec<usize>,
    /// What the network sees.
    pub methods: Vec<Method>,
    /// Rollouts trained and validated on.
    pub rollouts: Vec<usize>,
    /// Number of seeds, from 0.
    pub seeds: u64,
    /// Samples that a cell is trained on, about, counting each time it is seen.
    pub samples: usize,
}

/// One combination.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Time steps of a window.
    pub timesteps: usize,
    /// What the network sees.
    pub method: Method,
    /// Rollouts trained and validated on.
    pub rollouts: usize,
    /// Seed of the split, the weights and the order of samples.
    pub seed: u64,
}

impl Grid {
    /// All cells, those of one seed after the other: a sweep that is stopped early has the whole table of some.
    #[must_use]
    pub fn cells(&self) -> Vec<Cell> {
        let mut cells = Vec::new();
        for seed in 0..self.seeds {
            for &rollouts in &self.rollouts {
                for &timesteps in &self.timesteps {
                    cells.extend(self.methods.iter().map(|&method| Cell {
                        timesteps,
                        method,
                        rollouts,
                        seed,
                    }));
                }
            }
        }
        cells
    }
}

impl Cell {
    /// Name of its folder.
    #[must_use]
    pub fn name(&self) -> String {
        let Self { timesteps, method, rollouts, seed } = self;
        format!("T{timesteps}-{}-{rollouts}-seed{seed}", method.name())
    }

    /// Its settings; those that the cell does not fix are those of `base`.
    #[must_use]
    pub fn config(&self, base: &DiagnoserConfig, grid: &Grid, classes: usize) -> DiagnoserConfig {
        let trained = (1.0 - base.validation_fraction) * (self.rollouts * classes) as f64;
        let epochs = (grid.samples as f64 / trained).round() as usize;
        DiagnoserConfig {
            timesteps: self.timesteps,
            method: self.method,
            rollouts: Some(self.rollouts),
            seed: self.seed,
            epochs: epochs.clamp(EPOCHS.0, EPOCHS.1),
            ..base.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid {
            timesteps: vec![10, 30, 50],
            methods: vec![Method::A, Method::B],
            rollouts: vec![1000, 2000, 7000],
            seeds: 2,
            samples: 1_000_000,
        }
    }

    #[test]
    fn a_table_has_18_cells_a_seed_with_names_of_their_own() {
        let mut names: Vec<String> = grid().cells().iter().map(Cell::name).collect();
        assert_eq!(names[0], "T10-A-1000-seed0");
        assert!(names[..18].iter().all(|name| name.ends_with("seed0")));
        names.sort();
        names.dedup();
        assert_eq!(names.len(), 2 * 18);
    }

    #[test]
    fn every_cell_is_trained_on_about_as_many_samples() {
        let base = DiagnoserConfig::default();
        let epochs = |rollouts| {
            let cell = Cell { timesteps: 50, method: Method::B, rollouts, seed: 3 };
            cell.config(&base, &grid(), 33).epochs
        };
        // 10⁶ / (0.8 · rollouts · 33), within 2 and 50.
        assert_eq!([100, 1000, 2000, 7000, 70_000].map(epochs), [50, 38, 19, 5, 2]);
    }
}
