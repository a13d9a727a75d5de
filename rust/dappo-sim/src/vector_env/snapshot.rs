//! The complete state of a vector env, for checkpoints that resume exactly.

use super::episode::Episode;
use super::{Autoreset, VectorEnv};
use crate::backend::BackendSnapshot;
use crate::error::{SimError, expect_len};

/// Everything that the rest of a run depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct VectorEnvSnapshot {
    /// Physics.
    pub backend: BackendSnapshot,
    /// Key, number, step, class, onset, "ended", duration and pause of the damage, delay of its code and steps of the
    /// class before, of every episode, `[N, 10]`.
    pub episodes: Vec<[u64; 10]>,
    /// Current observations, `[N, obs_dim]`.
    pub obs: Vec<f32>,
}

impl VectorEnv {
    /// The state between two steps.
    pub fn snapshot(&self) -> Result<VectorEnvSnapshot, SimError> {
        let pack = |e: &Episode| {
            let whole = |steps: usize| steps as u64;
            let (step, class, onset, ended) =
                (whole(e.step), whole(e.class), whole(e.onset), u64::from(e.ended));
            let (duration, pause, code_delay) = (whole(e.duration), whole(e.pause), whole(e.code_delay));
            let class_steps = whole(e.class_steps);
            [e.key, e.number, step, class, onset, ended, duration, pause, code_delay, class_steps]
        };
        Ok(VectorEnvSnapshot {
            backend: self.backend.snapshot()?,
            episodes: self.episodes.iter().map(pack).collect(),
            obs: self.buffers.obs.clone(),
        })
    }

    /// Goes back to a snapshot of an env of the same configuration.
    pub fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<(), SimError> {
        expect_len("saved episodes", snapshot.episodes.len(), self.num_envs())?;
        expect_len("saved observations", snapshot.obs.len(), self.buffers.obs.len())?;
        let classes = self.config.classes.len();
        if let Some(episode) = snapshot.episodes.iter().find(|episode| episode[3] >= classes as u64) {
            return Err(SimError::Snapshot(format!(
                "an episode has damage class {}, the classes are 0 to {}",
                episode[3],
                classes - 1
            )));
        }
        let waits = snapshot.episodes.iter().any(|episode| episode[5] != 0);
        if waits && self.config.autoreset == Autoreset::SameStep {
            let message =
                "an episode waits for its reset, which no episode does where envs reset in the same step";
            return Err(SimError::Snapshot(message.into()));
        }
        self.backend.restore(&snapshot.backend)?;
        self.buffers.obs.copy_from_slice(&snapshot.obs);
        for (env, &[key, number, step, class, onset, ended, duration, pause, code_delay, class_steps]) in
            snapshot.episodes.iter().enumerate()
        {
            let episode = Episode {
                key,
                number,
                step: step as usize,
                class: class as usize,
                class_steps: class_steps as usize,
                onset: onset as usize,
                duration: duration as usize,
                pause: pause as usize,
                code_delay: code_delay as usize,
                ended: ended != 0,
            };
            self.episodes[env] = episode;
            self.buffers.damage_class[env] = snapshot.backend.classes[env] as i64;
            self.buffers.damage_onset[env] = episode.onset as i64;
            self.buffers.episode_step[env] = episode.step as i64;
        }
        self.started = true;
        self.show_task();
        Ok(())
    }
}
