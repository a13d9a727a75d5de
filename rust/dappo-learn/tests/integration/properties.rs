//! What holds for every input: configurations, checkpoints, records and statistics, valid or not.

use std::path::PathBuf;

use dappo_learn::checkpoint::{Checkpoint, EnvState, Progress};
use dappo_learn::config::Layers;
use dappo_learn::episodes::EpisodeTracker;
use dappo_nn::{Normalizer, PolicyState};
use dappo_sim::backend::BackendSnapshot;
use dappo_sim::vector_env::VectorEnvSnapshot;
use proptest::collection::vec;
use proptest::prelude::*;

use crate::cases::cases;

const SMOKE: &str = include_str!("../../../../configs/smoke.toml");

fn scratch(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("dappo-properties-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Pieces of settings, and what does not belong there.
fn words() -> impl Strategy<Value = String> {
    let piece = prop_oneof![
        Just("ppo.".to_owned()),
        Just("gamma".to_owned()),
        Just("env.num_envs".to_owned()),
        Just("curriculum".to_owned()),
        Just("horizon".to_owned()),
        Just("=".to_owned()),
        Just("[{name='x',mix='uniform'}]".to_owned()),
        any::<i64>().prop_map(|number| number.to_string()),
        any::<f64>().prop_map(|number| number.to_string()),
        any::<char>().prop_map(String::from),
    ];
    vec(piece, 0..6).prop_map(|pieces| pieces.concat())
}

/// Bytes at a place of a file to be replaced, by others of another length.
fn splice() -> impl Strategy<Value = (usize, usize, Vec<u8>)> {
    let number = prop_oneof![Just(u64::MAX), Just(1_u64 << 61), Just(1_u64 << 31), 0_u64..9];
    let bytes = prop_oneof![vec(any::<u8>(), 0..9), number.prop_map(|number| number.to_le_bytes().to_vec())];
    (0_usize..1000, 0_usize..17, bytes)
}

fn replaced(source: &[u8], (start, length, bytes): (usize, usize, Vec<u8>)) -> Vec<u8> {
    let start = start % (source.len() + 1);
    let end = (start + length).min(source.len());
    [&source[..start], &bytes, &source[end..]].concat()
}

fn env_states() -> impl Strategy<Value = EnvState> {
    (1_usize..4, 0_usize..4, 0_usize..5).prop_flat_map(|(envs, row, width)| {
        let numbers = (vec(any::<f64>(), envs * row), vec(any::<f32>(), envs * width));
        (numbers, vec(0_usize..99, envs), vec(any::<[u64; 10]>(), envs)).prop_map(
            move |((rows, obs), classes, episodes)| EnvState {
                envs: VectorEnvSnapshot { backend: BackendSnapshot { row, rows, classes }, episodes, obs },
                episodes: EpisodeTracker::new(envs),
                memory: PolicyState::new(envs, width),
            },
        )
    })
}

proptest! {
    #![proptest_config(cases(200))]

    #[test]
    fn settings_give_a_configuration_that_reads_back_or_an_error(settings in vec(words(), 1..4)) {
        let mut layers = Layers::default();
        layers.set("robot", "ant").unwrap();
        let set = layers.assign(&settings.into_iter().map(Into::into).collect::<Vec<_>>());
        if let Ok(config) = set.and_then(|()| layers.resolve()) {
            let mut again = Layers::default();
            again.add_toml(&config.to_toml().unwrap(), "config.toml").unwrap();
            prop_assert_eq!(again.resolve().unwrap(), config);
        }
    }

    #[test]
    fn a_changed_configuration_reads_back_or_is_an_error(splice in splice()) {
        let text = String::from_utf8_lossy(&replaced(SMOKE.as_bytes(), splice)).into_owned();
        let mut layers = Layers::default();
        if let Ok(config) = layers.add_toml(&text, "config.toml").and_then(|()| layers.resolve()) {
            let mut again = Layers::default();
            again.add_toml(&config.to_toml().unwrap(), "config.toml").unwrap();
            prop_assert_eq!(again.resolve().unwrap(), config);
        }
    }

    #[test]
    fn an_env_state_reads_back_to_the_bit_and_a_changed_one_is_rejected_or_as_long(
        state in env_states(), splice in splice()
    ) {
        let folder = scratch("env-state");
        state.save(&folder).unwrap();
        let bits = |state: &EnvState| {
            let rows: Vec<u64> = state.envs.backend.rows.iter().map(|x| x.to_bits()).collect();
            let obs: Vec<u32> = state.envs.obs.iter().map(|x| x.to_bits()).collect();
            (state.envs.backend.row, rows, obs, state.envs.backend.classes.clone(), state.envs.episodes.clone(), state.memory.clone())
        };
        prop_assert_eq!(bits(&EnvState::load(folder.as_path()).unwrap()), bits(&state));
        let path = folder.join("envs.safetensors");
        let bytes = std::fs::read(&path).unwrap();
        let changed = replaced(&bytes, splice);
        std::fs::write(&path, &changed).unwrap();
        if let Ok(other) = EnvState::load(folder.as_path()) {
            let backend = &other.envs.backend;
            // Of each env its class, the ten numbers of its episode and three sums; two numbers of a memory take the room
            // of one.
            let numbers = backend.rows.len() + 14 * backend.classes.len() + other.memory.numbers().len() / 2;
            // The description of the arrays is behind its length.
            let begin = 8 + u64::from_le_bytes(*changed.first_chunk().unwrap()) as usize;
            prop_assert_eq!(begin + 8 * numbers + 4 * other.envs.obs.len(), changed.len());
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_checkpoint_with_a_changed_file_is_rejected_by_name(splice in splice()) {
        let folder = scratch("checkpoint");
        let progress = Progress { iteration: 1, env_steps: 10, stage: 0 };
        let content = b"the weights of a network";
        Checkpoint::write(&folder, "ant", progress, 1, |at| {
            std::fs::write(at.join("policy.bpk"), content).map_err(|source| {
                dappo_learn::LearnError::Io { path: at.to_owned(), source }
            })
        })
        .unwrap();
        let path = folder.join("00000001").join("policy.bpk");
        let changed = replaced(content, splice);
        std::fs::write(&path, &changed).unwrap();
        match Checkpoint::<Progress>::newest(&folder, "ant") {
            Ok(_) => prop_assert_eq!(&changed[..], &content[..]),
            Err(error) => prop_assert!(error.to_string().contains("policy.bpk")),
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn statistics_do_not_depend_on_how_the_rows_come(rows in vec(-100.0..100.0_f32, 2..60), cut in 0_usize..60) {
        let cut = cut % rows.len();
        let (mut together, mut apart) = (Normalizer::new(1, 0).unwrap(), Normalizer::new(1, 0).unwrap());
        together.update(&rows).unwrap();
        for part in [&rows[..cut], &rows[cut..]].into_iter().filter(|part| !part.is_empty()) {
            apart.update(part).unwrap();
        }
        let count = rows.len() as f64;
        let mean = rows.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
        let variance = rows.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / count;
        for normalizer in [&together, &apart] {
            prop_assert!((normalizer.mean()[0] - mean).abs() < 1e-9);
            prop_assert!((normalizer.variance()[0] - variance).abs() < 1e-9 * variance.max(1.0));
        }
    }
}
