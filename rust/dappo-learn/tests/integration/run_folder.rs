//! Processes that use the same run folder.

use std::path::{Path, PathBuf};
use std::sync::Barrier;
use std::thread;

use dappo_learn::Simulator;
use dappo_learn::checkpoint::Progress;
use dappo_learn::config::{Config, change};
use dappo_learn::run_folder::{LockedRun, Meta, RunFolder};
use dappo_sim::Physics;

const RIVALS: u64 = 8;

pub fn scratch(name: &str) -> PathBuf {
    let root = std::env::temp_dir().join(format!("dappo-run-folder-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&root);
    root
}

/// A run that is identified by its seed.
pub fn create(root: &Path, seed: u64) -> Result<LockedRun, String> {
    let meta = Meta {
        version: "0".into(),
        mujoco: "0".into(),
        simulator: Simulator { physics: Physics::Mujoco, integrator: "rk4".into() },
        reward: "gym".into(),
        threads: 1,
        platform: "test".into(),
        cpu: "test".into(),
        simd: "test".into(),
        command: Vec::new(),
    };
    let config = Config { robot: "ant".into(), seed, ..Config::default() };
    RunFolder::create(root, &config, &meta, &Vec::new()).map_err(|error| error.to_string())
}

#[test]
fn of_many_that_begin_at_once_one_makes_the_run() {
    for round in 0..20 {
        let root = scratch(&round.to_string());
        let start = Barrier::new(RIVALS as usize);
        let rivals: Vec<_> = thread::scope(|scope| {
            let rival = |seed| {
                let (root, start) = (&root, &start);
                scope.spawn(move || {
                    start.wait();
                    create(root, seed)
                })
            };
            let threads: Vec<_> = (0..RIVALS).map(rival).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let winners: Vec<_> = (0..RIVALS).filter(|&seed| rivals[seed as usize].is_ok()).collect();
        assert_eq!(winners.len(), 1, "{rivals:?}");
        for error in rivals.iter().filter_map(|rival| rival.as_ref().err()) {
            assert!(error.contains("is being trained by another process"), "{error}");
        }
        let (_, config) = RunFolder::open(&root).unwrap();
        assert_eq!(config.seed, winners[0]);
        std::fs::remove_dir_all(&root).unwrap();
    }
}

#[test]
fn a_changed_configuration_is_written_and_noted_with_where_the_run_stood() {
    let root = scratch("changed");
    let run = create(&root, 3).unwrap();
    let (_, before) = RunFolder::open(&root).unwrap();
    let noted = || -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(root.join("meta.json")).unwrap()).unwrap()
    };
    let progress = |iteration| Progress { iteration, env_steps: 64 * iteration, stage: 0 };
    run.change(&before, progress(1)).unwrap();
    assert!(noted().get("changes").is_none());

    let after = change(&before, &["ppo.learning_rate=0.0001".into(), "env.threads=2".into()]).unwrap();
    run.change(&after, progress(5)).unwrap();
    run.change(&change(&after, &["ppo.learning_rate=0.00005".into()]).unwrap(), progress(7)).unwrap();
    let entry = |iteration: u64, key: &str, from: serde_json::Value, to: serde_json::Value| {
        let env_steps = 64 * iteration;
        serde_json::json!({ "iteration": iteration, "env_steps": env_steps, "key": key, "from": from, "to": to })
    };
    let expected = serde_json::json!([
        entry(5, "env.threads", serde_json::Value::Null, 2.into()),
        entry(5, "ppo.learning_rate", 3e-4.into(), 1e-4.into()),
        entry(7, "ppo.learning_rate", 1e-4.into(), 5e-5.into()),
    ]);
    assert_eq!(noted()["changes"], expected);
    assert_eq!(noted()["reward"], "gym");
    let (_, read) = RunFolder::open(&root).unwrap();
    assert_eq!((read.ppo.learning_rate, read.env.threads, read.seed), (5e-5, Some(2), 3));
    std::fs::remove_dir_all(&root).unwrap();
}

#[test]
fn a_run_is_locked_until_it_is_dropped_and_never_made_twice() {
    let root = scratch("twice");
    let run = create(&root, 0).unwrap();
    let lock = || RunFolder::open(&root).unwrap().0.lock();
    assert!(lock().unwrap_err().to_string().contains("is being trained by another process"));
    drop(run);
    assert!(create(&root, 1).unwrap_err().contains("already holds a run"));
    assert!(lock().is_ok());
    std::fs::remove_dir_all(&root).unwrap();
}
