//! Evaluations of diagnosers as text.

use dappo_learn::evaluate::Score;
use dappo_learn::text_table::table;

use super::Evaluated;
use crate::cost::{Cost, Mistake};

/// A diagnoser on a dataset with the accuracy on each class; or several with a table of their accuracies, a row a
/// diagnoser and a column each of the `datasets`.
#[must_use]
pub fn text(evaluated: &[Evaluated], datasets: usize) -> String {
    if let [only] = evaluated {
        return only.class_text() + &only.text();
    }
    evaluated.iter().map(Evaluated::text).collect::<String>() + &cross_table(evaluated, datasets)
}

impl Evaluated {
    /// The accuracy on each class.
    fn class_text(&self) -> String {
        let rows = self.classes.iter().zip(&self.class_accuracy);
        let rows = rows.map(|(name, accuracy)| [format!("{:.2}", 100.0 * accuracy), name.clone()]);
        table(["accuracy %", "<class"], rows)
    }

    fn text(&self) -> String {
        let summary = &self.summary;
        let error = if summary.standard_error.is_nan() {
            String::new()
        } else {
            format!(" ± {:.2}", 100.0 * summary.standard_error)
        };
        let held_out = summary.held_out_accuracy.map_or_else(String::new, |accuracy| {
            format!("  on classes that it was not trained on: {:.2} %\n", 100.0 * accuracy)
        });
        format!(
            "{} on {}\n  accuracy {:.2}{error} % of {} windows, {} rollouts; calibration error {:.2} %\n{held_out}{}",
            self.model,
            self.data,
            100.0 * summary.accuracy,
            summary.windows,
            summary.rollouts,
            100.0 * summary.calibration_error,
            self.cost.as_ref().map_or_else(String::new, Cost::text)
        )
    }
}

impl Cost {
    /// What the mistakes cost, and the three that cost most.
    fn text(&self) -> String {
        let (name, decimals) = (self.compared_by.name(), self.compared_by.decimals());
        let cost = format!(
            "  {name} of the policy: {:.decimals$} with the true class, {:.decimals$} with the diagnosis: \
             gait-equivalent accuracy {:.2} %\n",
            self.true_score,
            self.diagnosed_score,
            100.0 * self.gait_equivalent_accuracy
        );
        let mistakes = self.mistakes.iter().take(3).map(|mistake| mistake.text(self.compared_by));
        cost + &mistakes.collect::<String>()
    }
}

impl Mistake {
    fn text(&self, compared_by: Score) -> String {
        let (name, decimals) = (compared_by.name(), compared_by.decimals());
        format!(
            "    {:.1} % of {} are diagnosed as {}, which changes the {name} from {:.decimals$} to {:.decimals$}\n",
            100.0 * self.share,
            self.class,
            self.diagnosed,
            self.true_score,
            self.mistaken_score
        )
    }
}

/// Accuracies in per cent: a row a diagnoser, a column a dataset.
fn cross_table(evaluated: &[Evaluated], datasets: usize) -> String {
    let percent = |evaluated: &Evaluated| format!("{:>8.2}", 100.0 * evaluated.summary.accuracy);
    let row = |row: &[Evaluated]| {
        let model = row.first().map_or("", |evaluated| &evaluated.model);
        format!("{}  {model}\n", row.iter().map(percent).collect::<String>())
    };
    let rows: String = evaluated.chunks(datasets.max(1)).map(row).collect();
    let data = evaluated.iter().take(datasets).map(|evaluated| evaluated.data.as_str());
    format!("accuracy %\n{rows}columns: {}\n", data.collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DiagnosisSummary;

    fn evaluated(model: &str, data: &str, accuracy: f64) -> Evaluated {
        Evaluated {
            model: model.into(),
            data: data.into(),
            summary: DiagnosisSummary {
                rollouts: 1,
                windows: 8,
                accuracy,
                standard_error: f64::NAN,
                held_out_accuracy: None,
                log_loss: 0.5,
                calibration_error: 0.0625,
            },
            cost: None,
            classes: ["healthy", "jammed@0"].map(ToOwned::to_owned).to_vec(),
            class_accuracy: vec![1.0, 0.5],
        }
    }

    #[test]
    fn a_single_evaluation_shows_its_classes_and_its_accuracy() {
        let expected = "\
            accuracy %  class\n    \
                100.00  healthy\n     \
                 50.00  jammed@0\n\
            d0 on data/test\n  \
              accuracy 75.00 % of 8 windows, 1 rollouts; calibration error 6.25 %\n";
        assert_eq!(text(&[evaluated("d0", "data/test", 0.75)], 1), expected);
    }

    #[test]
    fn standard_error_held_out_classes_and_the_three_mistakes_that_cost_most_are_shown_where_there_are_some()
    {
        let mistake = |share| Mistake {
            class: "healthy".into(),
            diagnosed: "jammed@0".into(),
            share,
            true_score: 2000.0,
            mistaken_score: 500.0,
        };
        let mut found = evaluated("d0", "data/test", 0.75);
        (found.summary.standard_error, found.summary.held_out_accuracy) = (0.015, Some(0.5));
        found.cost = Some(Cost {
            compared_by: Score::ForwardReward,
            true_score: 2000.0,
            diagnosed_score: 1500.0,
            gait_equivalent_accuracy: 0.75,
            mistakes: [0.25, 0.125, 0.03, 0.01].map(mistake).to_vec(),
        });
        let expected = "\
            d0 on data/test\n  \
              accuracy 75.00 ± 1.50 % of 8 windows, 1 rollouts; calibration error 6.25 %\n  \
              on classes that it was not trained on: 50.00 %\n  \
              forward reward of the policy: 2000.0 with the true class, 1500.0 with the diagnosis: \
              gait-equivalent accuracy 75.00 %\n    \
                25.0 % of healthy are diagnosed as jammed@0, which changes the forward reward from 2000.0 to 500.0\n    \
                12.5 % of healthy are diagnosed as jammed@0, which changes the forward reward from 2000.0 to 500.0\n    \
                3.0 % of healthy are diagnosed as jammed@0, which changes the forward reward from 2000.0 to 500.0\n";
        assert_eq!(found.text(), expected);
    }

    #[test]
    fn mistakes_of_a_task_with_commands_cost_tracking() {
        let mut found = evaluated("d0", "data/test", 0.75);
        found.cost = Some(Cost {
            compared_by: Score::Tracking,
            true_score: 0.75,
            diagnosed_score: 0.5,
            gait_equivalent_accuracy: 2.0 / 3.0,
            mistakes: vec![Mistake {
                class: "healthy".into(),
                diagnosed: "jammed@0".into(),
                share: 0.25,
                true_score: 0.875,
                mistaken_score: 0.125,
            }],
        });
        let expected = "  tracking of the policy: 0.750 with the true class, 0.500 with the diagnosis: \
            gait-equivalent accuracy 66.67 %\n    \
            25.0 % of healthy are diagnosed as jammed@0, which changes the tracking from 0.875 to 0.125\n";
        assert!(found.text().ends_with(expected), "{}", found.text());
    }

    #[test]
    fn several_evaluations_end_in_a_table_of_diagnosers_and_datasets() {
        let all = [("d0", "a", 0.5), ("d0", "b", 1.0), ("d1", "a", 0.25), ("d1", "b", 0.125)]
            .map(|(model, data, accuracy)| evaluated(model, data, accuracy));
        let text = text(&all, 2);
        assert!(text.starts_with("d0 on a\n  accuracy 50.00 % of 8 windows, 1 rollouts;"), "{text}");
        let expected = "\
            accuracy %\n   \
               50.00  100.00  d0\n   \
               25.00   12.50  d1\n\
            columns: a, b\n";
        assert!(text.ends_with(expected), "{text}");
    }
}
