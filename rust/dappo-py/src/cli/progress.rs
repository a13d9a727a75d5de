//! What a person or a program sees of a running training.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dappo_learn::config::Config;
use dappo_learn::episodes::EpisodeSummary;
use dappo_learn::metrics::Metrics;
use dappo_learn::train::Observer;
use indicatif::{ProgressBar, ProgressStyle};

use super::Caller;
use crate::cli::console::note;

/// A progress bar, unless it is to be hidden.
pub fn bar(length: u64, is_shown: bool) -> ProgressBar {
    let bar = if is_shown { ProgressBar::new(length) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{bar:24} {percent:>3}%  {msg}  {elapsed} < {eta}") {
        bar.set_style(style);
    }
    bar
}

/// Shows iterations and passes Ctrl-C on.
pub struct Display<'a> {
    bar: ProgressBar,
    /// Gets one object an iteration, instead of a person a progress bar.
    objects: Option<&'a Caller>,
    interrupted: Arc<AtomicBool>,
    iterations: u64,
    steps_an_iteration: u64,
    control_period: f64,
    last_walked: String,
    diverged: u64,
}

impl<'a> Display<'a> {
    /// A progress bar on a terminal, or one JSON object an iteration. `control_period` is the length of an env step, s.
    pub fn new(
        config: &Config,
        control_period: f64,
        objects: Option<&'a Caller>,
        interrupted: Arc<AtomicBool>,
    ) -> Self {
        let bar = bar(config.total_steps, objects.is_none());
        let steps_an_iteration = (config.env.num_envs * config.horizon) as u64;
        Self {
            bar,
            objects,
            interrupted,
            iterations: config.total_steps.div_ceil(steps_an_iteration),
            steps_an_iteration,
            control_period,
            last_walked: "–".to_owned(),
            diverged: 0,
        }
    }

    /// Removes the bar, and says what went wrong on the way.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
        if self.diverged > 0 && self.objects.is_none() {
            note!(
                "divergences of the physics: {}; each ended its episode, and `diverged` in metrics.jsonl says when",
                self.diverged
            );
        }
    }
}

impl Observer for Display<'_> {
    fn iteration(&mut self, metrics: &Metrics) {
        self.diverged += metrics.diverged;
        if let Some(caller) = self.objects {
            caller.object(metrics);
            return;
        }
        let EpisodeSummary { forward_reward, episode_length, .. } = metrics.episodes;
        if let Some((reward, length)) = forward_reward.zip(episode_length) {
            let (velocity, distance) = (reward / length, reward * self.control_period);
            self.last_walked = format!("{reward:.0} ({velocity:.2} m/s, {distance:.1} m)");
        }
        let rate = self.steps_an_iteration as f64 / (metrics.rollout_seconds + metrics.update_seconds);
        let message = format!(
            "iteration {}/{} · {} · forward reward {} · {:.1} k steps/s (rollout {:.2} s, update {:.2} s)",
            metrics.iteration,
            self.iterations,
            metrics.stage,
            self.last_walked,
            rate / 1000.0,
            metrics.rollout_seconds,
            metrics.update_seconds
        );
        self.bar.set_position(metrics.env_steps);
        if self.bar.is_hidden() {
            // Not a terminal: one line now and then.
            if metrics.iteration.is_multiple_of(20) || metrics.iteration == self.iterations {
                note!("{}", message);
            }
        } else {
            self.bar.set_message(message);
        }
    }

    fn should_stop(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }
}
