//! Windows of trajectories that were logged.

use dappo_learn::error::Result;
use dappo_learn::fleet::Fleet;
use dappo_nn::Policy;
use dappo_nn::error::check_length;
use dappo_sim::backend::{Backend, Reset};

use super::{Twin, TwinAction, Window};

/// Logged trajectories of N robots.
#[derive(Debug, Clone, Copy)]
pub struct Trajectories<'a> {
    /// Steps, T.
    pub steps: usize,
    /// Observations before the first step and after each, without damage code, `[N, T + 1, O]`.
    pub obs: &'a [f32],
    /// Actions, `[N, T, A]`.
    pub actions: &'a [f32],
}

impl Trajectories<'_> {
    /// The windows of a diagnoser that does without twins.
    pub fn without_twins(&self, robots: usize, obs_dim: usize, action_dim: usize) -> Result<Vec<Window>> {
        check_length("obs [N, T + 1, O]", self.obs, robots * (self.steps + 1) * obs_dim)?;
        check_length("actions [N, T, A]", self.actions, robots * self.steps * action_dim)?;
        let window = |(obs, actions): (&[f32], &[f32])| Window {
            damaged: obs[obs_dim..].to_vec(),
            twin: Vec::new(),
            actions: actions.to_vec(),
        };
        let obs = self.obs.chunks_exact((self.steps + 1) * obs_dim);
        Ok(obs.zip(self.actions.chunks_exact((self.steps * action_dim).max(1))).map(window).collect())
    }

    /// Simulates a healthy twin of every robot, run as in a diagnoser's training; `twins` has N robots.
    pub fn windows(&self, mode: Twin, expert: &Policy, twins: Box<dyn Backend>) -> Result<Vec<Window>> {
        let robots = twins.num_envs();
        let (width, action_dim) = (twins.task().obs_dim(), twins.task().layout().nu);
        check_length("obs [N, T + 1, O]", self.obs, robots * (self.steps + 1) * width)?;
        check_length("actions [N, T, A]", self.actions, robots * self.steps * action_dim)?;
        let mut twins = Fleet::new(twins);
        twins.check_twins()?;
        let resets: Vec<_> = (0..robots).map(|env| Reset { env, class: 0, key: 0, episode: 0 }).collect();
        twins.reset(&resets)?;
        let everyone = vec![false; robots];
        let mut windows = vec![Window::default(); robots];
        for step in 0..self.steps {
            if step == 0 || mode.resyncs_before(step) {
                twins.resync(&rows(self.obs, self.steps + 1, step, width), &everyone)?;
            }
            let actions = rows(self.actions, self.steps, step, action_dim);
            let own =
                (mode.action == TwinAction::Own).then(|| expert.healthy_actions(&twins.obs)).transpose()?;
            twins.step(own.as_deref().unwrap_or(&actions), &everyone)?;
            let observed = rows(self.obs, self.steps + 1, step + 1, width);
            for (robot, window) in windows.iter_mut().enumerate() {
                window.damaged.extend(&observed[robot * width..][..width]);
                window.twin.extend(twins.row(robot));
                window.actions.extend(&actions[robot * action_dim..][..action_dim]);
            }
        }
        Ok(windows)
    }
}

/// Row `row` of every robot: `[N, rows, width]` → `[N, width]`.
fn rows(all: &[f32], rows: usize, row: usize, width: usize) -> Vec<f32> {
    all.chunks_exact(rows * width).flat_map(|robot| &robot[row * width..][..width]).copied().collect()
}
