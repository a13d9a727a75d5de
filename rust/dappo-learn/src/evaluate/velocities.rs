//! Mean forward velocities that the evaluation of a run found.

use std::path::PathBuf;

use serde::Deserialize;

use crate::error::{LearnError, Result};
use crate::run_folder::RunFolder;
use crate::walk::Encoding;

/// Mean forward velocities of a policy with the true damage code, as the evaluation of its run found them.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanVelocities {
    /// The file that they are from.
    path: PathBuf,
    classes: Vec<MeanVelocity>,
}

/// The entries that are read of a [`ClassResult`].
#[derive(Debug, Clone, PartialEq, Deserialize)]
struct MeanVelocity {
    name: String,
    forward_velocity: f64,
}

/// The entries that are read of an [`Evaluation`].
#[derive(Deserialize)]
struct StoredEvaluation {
    classes: Vec<MeanVelocity>,
}

impl MeanVelocities {
    /// Reads those of a run; `None` if its policy has not been evaluated.
    pub fn read(run: &RunFolder) -> Result<Option<Self>> {
        let (folder, name) = (run.evaluation(), Encoding::True.file_name("evaluation", "json"));
        let Some(text) = folder.read(&name)? else { return Ok(None) };
        Self::parse(&text, folder.path(&name)).map(Some)
    }

    /// Those of the damage classes of a robot, m/s, in their order; fails if the evaluation has others.
    pub fn of(self, class_names: &[String]) -> Result<Vec<f64>> {
        if self.classes.iter().map(|class| &class.name).eq(class_names) {
            return Ok(self.classes.iter().map(|class| class.forward_velocity).collect());
        }
        Err(LearnError::Invalid(format!(
            "{} has {} damage classes, expected the {} of the robot in their order; evaluate the run again",
            self.path.display(),
            self.classes.len(),
            class_names.len()
        )))
    }

    fn parse(text: &str, path: PathBuf) -> Result<Self> {
        let StoredEvaluation { classes } = serde_json::from_str(text).map_err(|error| {
            LearnError::Invalid(format!("{}: {error}; evaluate the run again", path.display()))
        })?;
        Ok(Self { path, classes })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tables::tests::evaluation;
    use super::*;

    #[test]
    fn velocities_read_back_from_an_evaluation_and_other_files_are_rejected() {
        let stored = serde_json::to_string(&evaluation([f64::NAN; 4])).unwrap();
        let names: Vec<String> = (0..4).map(|class| format!("class {class}")).collect();
        let of = |text: &str, names: &[String]| {
            MeanVelocities::parse(text, "evaluation.json".into()).and_then(|found| found.of(names))
        };
        // Forward rewards of 10, 4, 7 and -1, sixteen times as large.
        assert_eq!(of(&stored, &names).unwrap(), [0.625, 0.25, 0.4375, -0.0625]);
        let refuse = |text: &str, names: &[String]| of(text, names).unwrap_err().to_string();
        assert!(
            refuse(&stored, &names[..3]).contains("evaluation.json has 4 damage classes, expected the 3")
        );
        let other = stored.replace("forward_velocity", "velocity");
        assert!(refuse(&other, &names).contains("missing field `forward_velocity`"));
        // JSON has no NaN, so that a velocity that was none is no number.
        assert!(refuse(&stored.replace("0.625", "null"), &names).contains("evaluate the run again"));
        assert!(refuse("", &names).contains("evaluation.json: "));
    }
}
