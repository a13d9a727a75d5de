//! What happens at the end of an episode: Gymnasium's three autoreset modes.

use super::VectorEnv;
use super::episode::EpisodeStart;
use crate::error::SimError;

/// Gymnasium's `AutoresetMode`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Autoreset {
    /// The step after the last one ignores the action and resets.
    NextStep,
    /// The last step resets at once; its own observation is kept as `final_obs`.
    SameStep,
    /// The caller resets; an env whose episode has ended stands still until then, with reward 0.
    Disabled,
}

impl VectorEnv {
    /// Envs whose episode has ended before this step: they are not stepped again.
    pub(super) fn pending_resets(&self) -> Vec<bool> {
        self.episodes.iter().map(|episode| episode.ended).collect()
    }

    /// Resets the envs according to the mode, after a step.
    pub(super) fn autoreset(&mut self, pending: &[bool]) -> Result<(), SimError> {
        match self.config.autoreset {
            Autoreset::Disabled => {
                self.mark_ended(pending);
                Ok(())
            }
            Autoreset::NextStep => {
                let due = self.mark_ended(pending);
                for &env in &due {
                    self.buffers.terminated[env] = false;
                    self.buffers.truncated[env] = false;
                    self.buffers.diverged[env] = false;
                }
                self.restart(&due)
            }
            Autoreset::SameStep => {
                let due: Vec<usize> = (0..self.num_envs())
                    .filter(|&env| self.buffers.terminated[env] || self.buffers.truncated[env])
                    .collect();
                self.buffers.final_mask.fill(false);
                for &env in &due {
                    self.keep_final(env);
                }
                self.restart(&due)
            }
        }
    }

    /// Notes which episodes ended in this step; returns the envs that had ended before it.
    fn mark_ended(&mut self, pending: &[bool]) -> Vec<usize> {
        for (env, episode) in self.episodes.iter_mut().enumerate() {
            episode.ended |= self.buffers.terminated[env] || self.buffers.truncated[env];
        }
        let before: Vec<usize> = (0..self.num_envs()).filter(|&env| pending[env]).collect();
        for &env in &before {
            self.buffers.rewards[env] = 0.0;
        }
        before
    }

    fn restart(&mut self, envs: &[usize]) -> Result<(), SimError> {
        let resets: Vec<_> =
            envs.iter().map(|&env| self.begin_episode(env, EpisodeStart::default())).collect();
        self.run_resets(&resets)
    }

    /// Saves what the reset is about to overwrite.
    fn keep_final(&mut self, env: usize) {
        let buffers = &mut self.buffers;
        let row = env * self.obs_dim..(env + 1) * self.obs_dim;
        buffers.final_obs[row.clone()].copy_from_slice(&buffers.obs[row]);
        buffers.final_mask[env] = true;
        buffers.final_damage_class[env] = buffers.damage_class[env];
        buffers.final_damage_onset[env] = buffers.damage_onset[env];
        buffers.final_forward_velocity[env] = buffers.forward_velocity[env];
    }
}
