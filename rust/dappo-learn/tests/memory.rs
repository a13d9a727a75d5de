//! The memory of a learner does not grow with its updates. Alone in its program, as its
//! allocator counts for all of it.

#![allow(clippy::unwrap_used, missing_docs)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicIsize, Ordering};

use burn::tensor::Device;
use dappo_learn::Sizes;
use dappo_learn::{Ppo, PpoConfig, Rollout, gae};
use dappo_nn::PolicyState;
use dappo_sim::rng::{Purpose, Stream};

/// The system's allocator with a count of what is in use.
struct Counting;

static BLOCKS: AtomicIsize = AtomicIsize::new(0);
static BYTES: AtomicIsize = AtomicIsize::new(0);

fn count(blocks: isize, bytes: isize) {
    BLOCKS.fetch_add(blocks, Ordering::Relaxed);
    BYTES.fetch_add(bytes, Ordering::Relaxed);
}

// SAFETY: every call is forwarded to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(1, layout.size() as isize);
        // SAFETY: the caller keeps to the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-1, -(layout.size() as isize));
        // SAFETY: the caller keeps to the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn in_use() -> (isize, isize) {
    (BLOCKS.load(Ordering::Relaxed), BYTES.load(Ordering::Relaxed))
}

fn config() -> PpoConfig {
    PpoConfig {
        hidden: vec![16, 16],
        minibatch_size: 64,
        value_minibatch_size: 64,
        epochs: 2,
        value_epochs: 1,
        ..PpoConfig::default()
    }
}

/// One update on a rollout whose rewards favour small actions.
fn update(ppo: &mut Ppo) {
    let (horizon, envs) = (4, 32);
    let mut stream = Stream::new(11, ppo.updates(), Purpose::ActionNoise);
    let mut normals = |count: usize| -> Vec<f32> { (0..count).map(|_| stream.normal() as f32).collect() };
    let networks = ppo.frozen().unwrap();
    let mut rollout = Rollout::new(horizon, envs, 2, networks.transform().clone());
    for step in 0..horizon {
        let (obs, noise) = (normals(envs * 3), normals(envs * 2));
        let decision = networks.act(&obs, &noise, &mut PolicyState::default()).unwrap();
        let rewards: Vec<f64> =
            decision.actions.chunks_exact(2).map(|action| -f64::from(action[0] * action[1]).abs()).collect();
        rollout.record_decision(step, &obs, &decision).unwrap();
        rollout.record_outcome(step, &rewards, &[false; 32], &[false; 32]).unwrap();
    }
    let targets = gae(&rollout, 0.9, 0.9).unwrap();
    ppo.update(&rollout, &targets, 0.0).unwrap();
}

fn learner() -> Ppo {
    Ppo::new(
        &config(),
        Sizes { obs_dim: 3, privileged: 0, code_length: 1, action_dim: 2 },
        7,
        &Device::flex(),
    )
    .unwrap()
}

fn save_and_load(folder: &Path) {
    std::fs::create_dir(folder).unwrap();
    learner().save(folder).unwrap();
    Ppo::load(folder, &config(), &Device::flex()).unwrap();
    std::fs::remove_dir_all(folder).unwrap();
}

/// What is in use after `work` has been done `times` times, and after as many times more.
fn twice(times: usize, mut work: impl FnMut()) -> [(isize, isize); 2] {
    [0, 1].map(|_| {
        (0..times).for_each(|_| work());
        in_use()
    })
}

#[test]
fn neither_updates_nor_loading_keep_memory() {
    // One thread, in which nothing else allocates meanwhile.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let folder = std::env::temp_dir().join(format!("dappo-learn-memory-{}", std::process::id()));
    let (updates, loads) = pool.install(|| {
        let mut ppo = learner();
        (twice(100, || update(&mut ppo)), twice(20, || save_and_load(&folder)))
    });
    for [before, after] in [updates, loads] {
        assert_eq!(after, before, "blocks and bytes in use");
    }
}
