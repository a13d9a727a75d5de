//! `dappo-batch diagnose train`.

use dappo_diagnose::dataset::Dataset;
use dappo_diagnose::train::{EpochMetrics, EpochProgress, Observer, train};
use dappo_diagnose::{DiagnoserConfig, LockedTraining, Method, PairSource, Split, TrainingFolder};
use dappo_learn::config::Assignment;
use dappo_learn::robot_files::keep;
use dappo_learn::{LearnError, Result};
use pyo3::prelude::*;

use crate::cli::args::{Threads, TrainDiagnoserArgs};
use crate::cli::console::{note, print_line};
use crate::cli::progress::Watch;
use crate::cli::{Caller, INTERRUPTED};
use crate::errors::OrRaise;
use crate::keywords::Flags;
use crate::pool::Pool;
use crate::run_robot::RobotCopy;

pub fn run(py: Python<'_>, arguments: &TrainDiagnoserArgs, caller: &Caller) -> PyResult<i32> {
    let pool = Pool::new(arguments.threads.map(Threads::count))?;
    let data = Dataset::open(&arguments.data).or_raise()?;
    let subject = &data.header().subject;
    let robot = RobotCopy::read(py, &arguments.data)?;
    if let (Some(robot), Some(folder)) = (&robot, &arguments.resume)
        && let Some(kept) = RobotCopy::read(py, folder)?
    {
        robot.check_same(py, &arguments.data, (folder, &kept), true)?;
    }
    let (folder, config) = open(arguments, &data).or_raise()?;
    // A kill may have left a training without one.
    if let (Some(robot), None) = (&robot, RobotCopy::read(py, folder.root())?) {
        keep(folder.root(), &robot.to_keep(py)?).or_raise()?;
    }
    if !arguments.json {
        note!("{}", describe(&config, &data, &folder));
    }
    let watch = Watch::new(1000 * config.epochs as u64, arguments.json, caller)?;
    let mut display = Display { watch, last: String::new() };
    let resume = arguments.resume.is_some();
    let outcome = pool.run(py, || -> Result<_> {
        let outcome = train(&config, subject, &data, &folder, resume, &mut display)?;
        if let (false, Some((_, diagnoser))) = (outcome.interrupted, &outcome.best) {
            let validation = Split::of(&config, &data).validation;
            diagnoser.evaluate(&data, &validation)?.write(&folder.eval(), "validation")?;
        }
        Ok(outcome)
    });
    display.watch.finish();
    let outcome = outcome?;
    let root = folder.root().display();
    if outcome.interrupted {
        note!(
            "interrupted after {} epochs; resume with: dappo-batch diagnose train {} --resume {root}",
            outcome.epochs,
            arguments.data.display()
        );
        return Ok(INTERRUPTED);
    }
    if let (false, Some((best, _))) = (arguments.json, outcome.best) {
        print_line!(
            "accuracy on the validation rollouts: {:.2} % of {} classes, epoch {} of {}",
            100.0 * best.validation_accuracy,
            subject.classes(),
            best.epoch,
            outcome.epochs
        );
        print_line!("folder of the training: {root}");
    }
    Ok(0)
}

/// A new training, or an earlier one with its settings.
fn open(arguments: &TrainDiagnoserArgs, data: &Dataset) -> Result<(LockedTraining, DiagnoserConfig)> {
    if let Some(folder) = &arguments.resume {
        let (folder, config) = TrainingFolder::open(folder)?;
        return Ok((folder.lock()?, config));
    }
    let subject = &data.header().subject;
    let class = |name: &String| subject.class(name).map(|class| toml::Value::from(class as i64));
    let held_out: Vec<_> = arguments.held_out.iter().map(class).collect::<Result<_>>()?;
    let mut of_data = vec![
        Assignment::Value("timesteps".into(), (data.timesteps() as i64).into()),
        Assignment::Value("held_out".into(), held_out.into()),
    ];
    if data.twin().is_none() {
        of_data.push(Assignment::Value("method".into(), Method::A.name().into()));
    }
    let settings = [&of_data[..], &arguments.flags(), &arguments.set].concat();
    let config = DiagnoserConfig::with(&settings)?;
    config.check_source(data, subject)?;
    let Some(out) = &arguments.out else {
        return Err(LearnError::Invalid("the folder of the training is missing; give it with --out".into()));
    };
    Ok((TrainingFolder::create(out, &config)?, config))
}

fn describe(config: &DiagnoserConfig, data: &Dataset, folder: &TrainingFolder) -> String {
    format!(
        "{} · method {} · {} steps · {} of {} rollouts × {} classes · preset {} → {}",
        data.header().subject.robot,
        config.method.name(),
        config.timesteps,
        config.rollouts.unwrap_or(data.rollouts()),
        data.rollouts(),
        data.classes(),
        data.header().protocol().name(),
        folder.root().display()
    )
}

/// Shows epochs.
struct Display<'a> {
    watch: Watch<'a>,
    last: String,
}

impl Observer for Display<'_> {
    fn progress(&mut self, progress: &EpochProgress) {
        let EpochProgress { epoch, epochs, samples, samples_per_epoch, samples_per_second, train_loss } =
            progress;
        let (rate, last) = (samples_per_second / 1000.0, &self.last);
        let message = format!("epoch {epoch}/{epochs} · loss {train_loss:.3} · {rate:.1} k samples/s{last}");
        self.watch.step(1000 * (epoch - 1) + 1000 * samples / samples_per_epoch, message);
    }

    fn epoch(&mut self, metrics: &EpochMetrics) {
        if self.watch.object(metrics) {
            return;
        }
        self.last = format!(" · validated {:.2} %", 100.0 * metrics.validation_accuracy);
        self.watch.line(&format!(
            "epoch {} · loss {:.3} · {:.1} k samples/s{}",
            metrics.epoch,
            metrics.train_loss,
            metrics.samples_per_second / 1000.0,
            self.last
        ));
    }

    fn should_stop(&self) -> bool {
        self.watch.is_interrupted()
    }
}
