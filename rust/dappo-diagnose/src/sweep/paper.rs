//! The numbers of the paper's Table 1.

use crate::Method;

/// Table 1 of Verma et al. (2019), in percent.
const TABLE: &str = include_str!("paper_table1.csv");

/// An accuracy as the paper gives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperResult {
    /// Share of the windows whose class was diagnosed correctly.
    pub accuracy: f64,
    /// The number after its ±.
    pub plus_minus: f64,
}

/// The paper's result for a cell, if it has it.
#[must_use]
pub fn paper_result(robot: &str, timesteps: usize, method: Method, rollouts: usize) -> Option<PaperResult> {
    let wanted = [robot, &timesteps.to_string(), method.name(), &rollouts.to_string()];
    TABLE.lines().map(|line| line.split(',').collect::<Vec<&str>>()).find_map(|fields| {
        let is_cell =
            [0, 1, 2, 4].iter().zip(&wanted).all(|(&index, wanted)| fields.get(index) == Some(wanted));
        let percent = |index: usize| fields.get(index)?.parse::<f64>().ok().map(|percent| percent / 100.0);
        is_cell.then_some(())?;
        Some(PaperResult { accuracy: percent(5)?, plus_minus: percent(6)? })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_results_are_those_that_the_paper_names() {
        for (robot, accuracy, plus_minus) in [("ant", 0.968, 0.0148), ("hexapod", 0.876, 0.0086)] {
            let best = paper_result(robot, 50, Method::B, 7000).unwrap();
            assert!((best.accuracy - accuracy).abs() < 1e-12, "{robot}: {best:?}");
            assert!((best.plus_minus - plus_minus).abs() < 1e-12, "{robot}: {best:?}");
        }
    }

    #[test]
    fn cells_that_the_paper_does_not_have_are_none() {
        assert_eq!(paper_result("ant", 50, Method::C, 7000), None);
        assert_eq!(paper_result("ant", 20, Method::B, 7000), None);
        assert_eq!(paper_result("tripod", 50, Method::B, 7000), None);
    }
}
