//! Trained diagnosers on records that they have not seen.

mod text;

use std::path::{Path, PathBuf};

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::{LearnError, Result};
use dappo_learn::walk::MeanActions;
use serde::Serialize;

use crate::cost::{Cost, cost};
use crate::dataset::Dataset;
use crate::{Diagnoser, DiagnosisSummary, PairSource, TrainingFolder};

pub use text::text;

/// A diagnoser on a dataset.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluated {
    /// Folder of the diagnoser's training.
    pub model: String,
    /// Folder of the dataset.
    pub data: String,
    /// The summary of the report.
    pub summary: DiagnosisSummary,
    /// What the mistakes cost a policy, if one was given.
    pub cost: Option<Cost>,
    /// Names of the damage classes.
    pub classes: Vec<String>,
    /// Accuracy on each class, 0 to 1.
    pub class_accuracy: Vec<f64>,
}

/// A policy that has the code of every diagnosis, with the configuration and the envs of its run.
pub struct Follower<'a> {
    /// The policy.
    pub policy: &'a dyn MeanActions,
    /// How it is evaluated.
    pub config: &'a Config,
    /// Simulates its robot.
    pub factory: &'a dyn EnvFactory,
}

/// Evaluates every diagnoser on every dataset, in this order, and writes the reports into the folders of the
/// trainings. With a follower, the cost of the mistakes is measured, too. `None` once `stop` returns true.
pub fn evaluate(
    models: &[PathBuf],
    data: &[PathBuf],
    follower: Option<&Follower<'_>>,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<Evaluated>>> {
    let open = |folder: &PathBuf| {
        TrainingFolder::open(folder).and_then(|(folder, _)| Ok((Diagnoser::load(&folder.model())?, folder)))
    };
    // All are opened before the first one is evaluated: a mistake shows at once.
    let diagnosers: Vec<_> = models.iter().map(open).collect::<Result<_>>()?;
    let datasets: Vec<Dataset> = data.iter().map(|data| Dataset::open(data)).collect::<Result<_>>()?;
    let mut evaluated = Vec::new();
    for (diagnoser, folder) in &diagnosers {
        for (dataset, path) in datasets.iter().zip(data) {
            if stop() {
                return Ok(None);
            }
            check_subject(diagnoser, dataset, folder, path)?;
            let report = diagnoser.evaluate(dataset, &(0..dataset.rollouts()).collect::<Vec<_>>())?;
            let cost = match follower {
                None => None,
                Some(Follower { policy, config, factory }) => {
                    match cost(&report, *policy, config, *factory, stop)? {
                        None => return Ok(None),
                        cost => cost,
                    }
                }
            };
            let name =
                path.file_name().map_or_else(|| "data".into(), |name| name.to_string_lossy().into_owned());
            report.write(&folder.eval(), &name)?;
            evaluated.push(Evaluated {
                model: folder.root().display().to_string(),
                data: path.display().to_string(),
                summary: report.summary(),
                cost,
                class_accuracy: report.class_accuracy(),
                classes: report.class_names,
            });
        }
    }
    Ok(Some(evaluated))
}

fn check_subject(diagnoser: &Diagnoser, data: &Dataset, folder: &TrainingFolder, path: &Path) -> Result<()> {
    let (known, found) = (&diagnoser.description().subject, &data.header().subject);
    if known == found {
        return Ok(());
    }
    Err(LearnError::Invalid(format!(
        "the diagnoser in {} has {} damage classes of robot `{}`, the records in {} are of {} classes of `{}`; \
         they must be the same",
        folder.root().display(),
        known.classes(),
        known.robot,
        path.display(),
        found.classes(),
        found.robot
    )))
}
