//! `dappo-batch diagnose test`.

use std::path::Path;
use std::sync::atomic::Ordering;

use dappo_diagnose::evaluate::{Follower, evaluate, text};
use dappo_learn::RunPolicy;
use dappo_learn::config::Config;
use dappo_nn::Policy;
use pyo3::prelude::*;

use crate::cli::args::{Count, TestDiagnoserArgs, Threads};
use crate::cli::{Caller, INTERRUPTED, console};
use crate::factory::TableFactory;
use crate::pool::Pool;
use crate::run_robot::{OpenRun, RobotCopy};

pub fn run(py: Python<'_>, arguments: &TestDiagnoserArgs, caller: &Caller) -> PyResult<i32> {
    let pool = Pool::new(arguments.threads.map(Threads::count))?;
    let follower = arguments.policy.as_deref().map(|run| open_follower(py, &pool, run, arguments));
    let follower = follower.transpose()?;
    check_robots(py, arguments)?;
    let interrupted = caller.watch()?;
    let evaluated = pool.run(py, || {
        let follower = follower.as_ref();
        let follower = follower.map(|(policy, config, factory)| Follower { policy, config, factory });
        let stop = || interrupted.load(Ordering::Relaxed);
        evaluate(&arguments.models, &arguments.data, follower.as_ref(), &stop)
    })?;
    let Some(evaluated) = evaluated else { return Ok(INTERRUPTED) };
    if arguments.json {
        caller.object(&evaluated);
    } else {
        console::print(&text(&evaluated, arguments.data.len()));
    }
    Ok(0)
}

/// Fails unless all diagnosers and records are of one robot; how it is damaged may differ.
fn check_robots(py: Python<'_>, arguments: &TestDiagnoserArgs) -> PyResult<()> {
    let mut first: Option<(&Path, RobotCopy)> = None;
    for folder in arguments.models.iter().chain(&arguments.data) {
        let Some(copy) = RobotCopy::read(py, folder)? else { continue };
        match &first {
            Some((root, robot)) => robot.check_same(py, root, (folder, &copy), false)?,
            None => first = Some((folder, copy)),
        }
    }
    Ok(())
}

/// The policy that has the code of every diagnosis, and what evaluates it.
fn open_follower(
    py: Python<'_>,
    pool: &Pool,
    run: &Path,
    arguments: &TestDiagnoserArgs,
) -> PyResult<(Policy, Config, TableFactory)> {
    let run = OpenRun::open(py, run, arguments.robot.robot_changed)?;
    for model in &arguments.models {
        run.check_folder(py, model)?;
    }
    let OpenRun { folder, mut config, .. } = run;
    config.env.threads = Some(pool.num_threads());
    config.evaluation.episodes = arguments.episodes.map_or(config.evaluation.episodes, Count::count);
    let factory = TableFactory::compile(py, &config)?;
    let RunPolicy { policy, .. } = pool.run(py, || RunPolicy::newest(&folder, &config, &factory))?;
    Ok((policy, config, factory))
}
