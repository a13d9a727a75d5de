//! Simulating robots without twins: the windows that a controller without a twin diagnoses.

use dappo_learn::error::Result;
use dappo_learn::fleet::Fleet;
use dappo_sim::DamageSpace;
use dappo_sim::backend::{Backend, Reset};
use dappo_sim::rng::{Purpose, Stream};

use super::{ActingPolicy, CollectConfig, Recorder};
use crate::Timing;
use crate::dataset::Record;

/// The robots of `block` rollouts, one for each damage class.
///
/// The policy walks with the code of no damage until the damage has struck, and from a random step of the delay on with
/// the code of an [`assumed`] class: the diagnoser learns the windows of a robot before its diagnosis, after a correct and
/// after a wrong one.
pub(super) struct Alone<'a> {
    policy: &'a ActingPolicy<'a>,
    /// The code of every class, or none if the policy observes no damage.
    codes: Vec<Vec<f32>>,
    timing: Timing,
    timesteps: usize,
    classes: usize,
    robots: Fleet,
}

/// One robot of a block.
struct Plan {
    class: usize,
    onset: usize,
    /// The class whose code the policy has from step `change` on.
    assumed: usize,
    change: usize,
    /// The step at which the window ends.
    end: usize,
}

/// The last T rows of every robot, at (step modulo T), `[N, T, width]`.
struct History {
    rows: Vec<f32>,
    steps: usize,
    width: usize,
}

impl History {
    fn new(robots: usize, steps: usize, width: usize) -> Self {
        Self { rows: vec![0.0; robots * steps * width], steps, width }
    }

    fn put(&mut self, robot: usize, step: usize, row: &[f32]) {
        let at = (robot * self.steps + step % self.steps) * self.width;
        self.rows[at..at + self.width].copy_from_slice(row);
    }

    /// The rows before step `end`, in order.
    fn before(&self, robot: usize, end: usize) -> impl Iterator<Item = f32> {
        let of_robot = &self.rows[robot * self.steps * self.width..][..self.steps * self.width];
        let (newest, oldest) = of_robot.split_at(end % self.steps * self.width);
        oldest.iter().chain(newest).copied()
    }
}

impl<'a> Alone<'a> {
    pub fn new(
        config: &CollectConfig,
        space: &DamageSpace,
        policy: &'a ActingPolicy<'a>,
        robots: Box<dyn Backend>,
    ) -> Self {
        let (limbs, types) = (space.limbs(), space.types().len());
        let observed = space.classes().iter().filter(|_| policy.code_length() > 0);
        Self {
            policy,
            codes: observed.map(|class| class.code(limbs, types)).collect(),
            timing: config.protocol.timing,
            timesteps: config.timesteps,
            classes: space.classes().len(),
            robots: Fleet::new(robots),
        }
    }

    /// What happens to every robot of the rollouts with these keys.
    fn plans(&self, keys: &[u64]) -> Vec<Plan> {
        let plan = |env: usize| {
            let (key, class) = (keys[env / self.classes], env % self.classes);
            let (onset, delay) = self.timing.draw(key);
            let mut stream = Stream::new(key, class as u64, Purpose::DamageCode);
            Plan {
                class,
                onset: onset as usize,
                assumed: assumed(&mut stream, class, self.classes),
                change: onset as usize + stream.below(u64::from(delay) + 1) as usize,
                end: onset as usize + delay as usize,
            }
        };
        (0..keys.len() * self.classes).map(plan).collect()
    }

    /// The actions of all robots before step `step`.
    fn actions(&self, plans: &[Plan], step: usize) -> Result<Vec<f32>> {
        if self.codes.is_empty() {
            return self.policy.actions(&self.robots.obs);
        }
        let mut rows = Vec::with_capacity(self.robots.obs.len() + plans.len() * self.codes[0].len());
        for (env, plan) in plans.iter().enumerate() {
            rows.extend_from_slice(self.robots.row(env));
            rows.extend_from_slice(&self.codes[if step < plan.change { 0 } else { plan.assumed }]);
        }
        self.policy.actions(&rows)
    }

    /// The window of every robot ends as planned, or when it falls after the damage: no controller diagnoses a robot that
    /// lies on the ground.
    fn walk(&mut self, keys: &[u64], plans: &mut [Plan], fallen: &mut [bool]) -> Result<[History; 2]> {
        let task = self.robots.backend().task();
        let (width, action_dim) = (task.obs_dim(), task.layout().nu);
        let mut obs = History::new(plans.len(), self.timesteps, width);
        let mut acted = History::new(plans.len(), self.timesteps, action_dim);
        let class_at_start = |plan: &Plan| if plan.onset == 0 { plan.class } else { 0 };
        let resets: Vec<Reset> = plans
            .iter()
            .enumerate()
            .map(|(env, plan)| {
                let key = keys[env / self.classes];
                Reset { env, class: class_at_start(plan), key, episode: 0 }
            })
            .collect();
        self.robots.reset(&resets)?;
        for step in 0.. {
            let skip: Vec<bool> = plans.iter().map(|plan| step >= plan.end).collect();
            if !skip.contains(&false) {
                break;
            }
            let struck = plans.iter().enumerate().filter(|(_, plan)| step > 0 && step == plan.onset);
            let struck: Vec<(usize, usize)> = struck.map(|(env, plan)| (env, plan.class)).collect();
            self.robots.set_classes(&struck)?;
            let actions = self.actions(plans, step)?;
            self.robots.step(&actions, &skip)?;
            for (env, plan) in plans.iter_mut().enumerate().filter(|(env, _)| !skip[*env]) {
                obs.put(env, step, self.robots.row(env));
                acted.put(env, step, &actions[env * action_dim..][..action_dim]);
                let done = step + 1;
                if self.robots.fallen[env] && done > plan.onset && done >= self.timesteps {
                    fallen[env] = done < plan.end;
                    plan.end = done;
                }
            }
        }
        Ok([obs, acted])
    }
}

impl Recorder for Alone<'_> {
    fn backend(&self) -> &dyn Backend {
        self.robots.backend()
    }

    fn diverged(&self) -> u64 {
        self.robots.divergences
    }

    fn simulate_block(&mut self, keys: &[u64]) -> Result<Vec<Record>> {
        let mut plans = self.plans(keys);
        let mut fallen = vec![false; plans.len()];
        let [obs, acted] = self.walk(keys, &mut plans, &mut fallen)?;
        let rows = |history: &History, rollout: usize| -> Vec<f32> {
            let envs = rollout * self.classes..(rollout + 1) * self.classes;
            envs.flat_map(|env| history.before(env, plans[env].end)).collect()
        };
        let record = |(rollout, &key): (usize, &u64)| {
            let (onset, delay) = self.timing.draw(key);
            Record {
                damaged: rows(&obs, rollout),
                actions: rows(&acted, rollout),
                twin: Vec::new(),
                onset,
                delay,
                fallen: fallen[rollout * self.classes..][..self.classes].to_vec(),
            }
        };
        Ok(keys.iter().enumerate().map(record).collect())
    }
}

/// The class whose code the policy receives: half of the time no damage, a quarter each the right class and any other.
fn assumed(stream: &mut Stream, class: usize, classes: usize) -> usize {
    match stream.below(4) {
        0 | 1 => 0,
        2 => class,
        _ => stream.below(classes as u64) as usize,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_history_holds_the_last_rows_in_order() {
        let mut history = History::new(2, 3, 1);
        for step in 0..5 {
            history.put(1, step, &[step as f32]);
        }
        assert_eq!(history.before(1, 5).collect::<Vec<_>>(), [2.0, 3.0, 4.0]);
        assert_eq!(history.before(0, 5).collect::<Vec<_>>(), [0.0; 3]);
    }

    #[test]
    fn half_of_the_robots_are_told_no_damage_and_a_quarter_the_right_one() {
        let mut counts = [0_u32; 5];
        for key in 0..8000 {
            counts[assumed(&mut Stream::new(key, 0, Purpose::DamageCode), 3, 5)] += 1;
        }
        // 1/2 + 1/20, 1/20, 1/20, 1/4 + 1/20, 1/20 of 8000; standard deviations below 45.
        for (count, expected) in counts.into_iter().zip([4400, 400, 400, 2400, 400]) {
            assert!(count.abs_diff(expected) < 200, "{counts:?}");
        }
    }
}
