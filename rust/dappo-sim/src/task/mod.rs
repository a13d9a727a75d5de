//! Tasks: what a robot is asked to do, and what a learner sees of it.
//!
//! A backend fills [`Signals`] after an env step; a [`Task`] turns actions into controls and signals into observation,
//! reward and the end of an episode. The definitions are shared by all backends, so that they can differ in their
//! physics alone. What a task remembers of an env is a row of numbers, which the backend keeps with the env's state.
//!
//! ```text
//! begin ─ command, events
//! act ─ controls ─ physics ─ signals ─ outcome ─ reward, failure ─ observe
//! ```

mod action;
mod anatomy;
mod command;
mod events;
mod memory;
mod observation;
mod reward;
mod signals;
mod termination;

use crate::backend::{Layout, Reset};
use crate::error::SimError;
use crate::rng::{Purpose, Stream};
use crate::robot::{ObservationTerms, ResetNoise, Robot};

pub use action::{ActionKind, Actions, Scale};
pub use anatomy::{ActuatorParts, Anatomy, Foot, FootHinge, FootLink, JointParts};
pub use command::{Commands, Curriculum, Ramp, VelocityCommand};
pub use events::{Delay, Events, Offset, Push, Scaling, Tilt, Variation};
pub use observation::{ObservationTerm, Quantity};
pub use reward::{Measure, RewardTerm};
pub use signals::Signals;
pub use termination::{ContactLimit, PythonFailures, Terminations, TiltLimit};

use action::ActuatorAction;
use anatomy::{apply_inverse, root_rotation};
use command::COMMAND;
use events::{Drawn, steps};
use memory::{Clock, FootRow, Slots};
use observation::ObservationGroup;
use termination::Limits;

/// Everything that turns physics into what a learner sees.
#[derive(Debug, Clone)]
pub struct Task {
    /// Physics substeps an env step.
    pub frame_skip: usize,
    /// Noise of the initial state.
    pub reset: ResetNoise,
    starts_at_keyframe: bool,
    actions: Vec<ActuatorAction>,
    command: Option<VelocityCommand>,
    /// How the ranges of the commands grow, in training.
    ramp: Option<Ramp>,
    events: Events,
    drawn: Drawn,
    policy: ObservationGroup,
    /// What the value net is given besides.
    critic: Option<ObservationGroup>,
    rewards: Vec<RewardTerm>,
    limits: Limits,
    python_failures: Vec<String>,
    /// Whether a term follows from the motion of the feet.
    needs_feet: bool,
    slots: Slots,
    layout: Layout,
}

/// How a step ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Sum of all terms of the reward.
    pub reward: f64,
    /// Whether the episode has failed.
    pub terminated: bool,
}

/// One env as the terms see it.
pub(crate) struct Scene<'a> {
    signals: &'a Signals<'a>,
    layout: &'a Layout,
    /// What the task remembers of the env.
    row: &'a [f64],
    slots: &'a Slots,
    drawn: &'a Drawn,
    /// Duration of an env step, s.
    dt: f64,
    /// Unit vector of gravity in the root's frame.
    gravity: [f64; 3],
    /// Linear velocity of the root in its frame.
    lin_vel: [f64; 3],
}

impl Task {
    /// The task of `robot` with the reward of this name (the robot's default for `None`). In training, what the critic is
    /// given besides follows the policy's observation, and the curriculum holds.
    pub fn new(
        robot: &Robot,
        layout: &Layout,
        reward: Option<&str>,
        training: bool,
    ) -> Result<Self, SimError> {
        let bad = |why: String| SimError::Config(format!("robot `{}`: {why}", robot.name));
        let rewards = robot.reward(reward)?.terms.clone();
        check(robot, layout, &rewards).map_err(bad)?;
        let actions = robot.actions.of_actuators(layout.nu, &layout.anatomy).map_err(bad)?;
        let limits = Limits::new(&robot.terminations, layout).map_err(bad)?;
        let (mut slots, events) = (Slots::default(), robot.events.clone());
        let drawn = events.layout(layout.nu, &mut slots);
        let group = |terms: &ObservationTerms| ObservationGroup::new(&terms.terms, layout, drawn.shown_len());
        let policy = group(&robot.observation.policy);
        let critic = robot.observation.critic.as_ref().filter(|_| training).map(group);
        let groups = || [&policy].into_iter().chain(&critic);
        let needs_feet = groups().any(ObservationGroup::needs_feet)
            || rewards.iter().any(|term| term.measure.needs_feet());
        let observes = |wanted: fn(&Quantity) -> bool| {
            groups().flat_map(ObservationGroup::blocks).any(|(term, _)| wanted(&term.quantity))
        };
        let needs_actions = observes(|quantity| *quantity == Quantity::LastAction)
            || rewards.iter().any(|term| term.measure == Measure::ActionRateSquared);
        let command = robot.commands.velocity;
        let ramp = robot.curriculum.commands.filter(|_| training && command.is_some());
        let needs_clock = command.is_some()
            || groups().any(ObservationGroup::is_noisy)
            || events.push.is_some()
            || observes(|quantity| matches!(quantity, Quantity::Clock { .. }));
        let room = |wanted: bool, length: usize| if wanted { length } else { 0 };
        slots.episode = slots.take(room(needs_clock, Clock::LENGTH));
        slots.command = slots.take(room(command.is_some(), COMMAND + 1));
        slots.total = slots.take(room(ramp.is_some(), 1));
        slots.actions = slots.take(room(needs_actions, 2 * layout.nu));
        slots.waiting = slots.take(events.longest_delay() * layout.nu);
        let feet = layout.anatomy.feet.first().map_or(0, Vec::len);
        slots.feet = slots.take(room(needs_feet, feet * FootRow::LENGTH));
        Ok(Self {
            frame_skip: robot.frame_skip,
            reset: robot.reset.noise(),
            starts_at_keyframe: robot.reset.keyframe.is_some(),
            actions,
            command,
            ramp,
            events,
            drawn,
            policy,
            critic,
            rewards,
            limits,
            python_failures: robot
                .terminations
                .python
                .iter()
                .flat_map(|python| python.functions.clone())
                .collect(),
            needs_feet,
            slots,
            layout: layout.clone(),
        })
    }

    /// Sizes and parts of the compiled robot.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Length of the observation, privileged entries included, without a damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.policy.len() + self.privileged()
    }

    /// Number of entries at the end of the observation that the value net alone is given.
    #[must_use]
    pub fn privileged(&self) -> usize {
        self.critic.as_ref().map_or(0, ObservationGroup::len)
    }

    /// The controls of the actuators, as (name, offset, scale): ctrl = offset + scale · clip(action, ±1).
    pub fn controls(&self) -> impl Iterator<Item = (&str, f64, f64)> {
        let names = self.layout.anatomy.actuators.iter().map(|actuator| actuator.name.as_str());
        names.zip(&self.actions).map(|(name, action)| (name, action.offset, action.scale))
    }

    /// The factor of ctrl = factor · clip(action, ±1), where this holds for all actuators alike.
    #[must_use]
    pub fn action_scale(&self) -> Option<f64> {
        let first = self.actions.first()?;
        (first.offset == 0.0 && self.actions.iter().all(|action| action == first)).then_some(first.scale)
    }

    /// Number of terms of the reward, at least 1.
    #[must_use]
    pub fn reward_len(&self) -> usize {
        self.rewards.len()
    }

    /// Names of the terms of the reward, in their order.
    pub fn reward_names(&self) -> impl Iterator<Item = &str> {
        self.rewards.iter().map(|term| term.name.as_str())
    }

    /// The term of the reward that says how well commanded linear velocities are tracked, from 0 to 1 without its weight:
    /// its index and its weight.
    #[must_use]
    pub fn tracking(&self) -> Option<(usize, f64)> {
        tracking(&self.rewards).map(|(index, term)| (index, term.weight))
    }

    /// What this term would be for a robot at rest with this command, without its weight.
    ///
    /// # Shapes
    /// command `[command_len]`
    #[must_use]
    pub fn tracking_at_rest(&self, command: &[f64]) -> Option<f64> {
        match tracking(&self.rewards)?.1.measure {
            Measure::TrackLinVel { std } => {
                let squares: f64 = command.iter().take(2).map(|velocity| velocity.powi(2)).sum();
                Some((-squares / (std * std)).exp())
            }
            _ => None,
        }
    }

    /// Terms of the observation that Python functions compute: the function, and which entries it writes.
    pub fn python_observations(&self) -> impl Iterator<Item = (&str, std::ops::Range<usize>)> {
        let critic = self.critic.iter().flat_map(ObservationGroup::blocks);
        let critic = critic
            .map(|(term, block)| (term, block.start + self.policy.len()..block.end + self.policy.len()));
        self.policy.blocks().chain(critic).filter_map(|(term, block)| match &term.quantity {
            Quantity::Python { function, .. } => Some((function.as_str(), block)),
            _ => None,
        })
    }

    /// Terms of the reward that Python functions compute: the function, the index of the term, and its weight.
    pub fn python_rewards(&self) -> impl Iterator<Item = (&str, usize, f64)> {
        self.rewards.iter().enumerate().filter_map(|(index, term)| match &term.measure {
            Measure::Python { function } => Some((function.as_str(), index, term.weight)),
            _ => None,
        })
    }

    /// Python functions that return failures.
    #[must_use]
    pub fn python_failures(&self) -> &[String] {
        &self.python_failures
    }

    /// Numbers in the command of an env; 0 for a task without commands.
    #[must_use]
    pub fn command_len(&self) -> usize {
        if self.command.is_some() { COMMAND } else { 0 }
    }

    /// The command of an env, `[command_len]`.
    #[must_use]
    pub fn command<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        &row[self.slots.command.clone()][..self.command_len()]
    }

    /// Names of what the events draw for an episode.
    #[must_use]
    pub fn event_names(&self) -> Vec<String> {
        let joints = self.layout.anatomy.actuators.iter().filter_map(|actuator| actuator.joint.as_ref());
        self.drawn.names(joints.map(|joint| joint.name.as_str()))
    }

    /// What the events have drawn for the episode of an env, in the order of their names.
    #[must_use]
    pub fn events<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        self.drawn.shown(&row[self.slots.events.clone()])
    }

    /// Numbers that the task remembers of an env.
    #[must_use]
    pub fn memory_len(&self) -> usize {
        self.slots.len
            + self.policy.frames_len()
            + self.critic.as_ref().map_or(0, ObservationGroup::frames_len)
    }

    /// Duration of an env step, s.
    #[must_use]
    pub fn dt(&self) -> f64 {
        self.layout.timestep * self.frame_skip as f64
    }

    /// The positions of the keyframe with which an episode begins; `None` if it begins as its damage class does.
    pub(crate) fn start(&self) -> Option<&[f64]> {
        self.starts_at_keyframe.then_some(&self.layout.anatomy.start)
    }

    /// The positions with which an episode begins, given those of its damage class.
    pub(crate) fn start_or<'a>(&'a self, of_class: &'a [f64]) -> &'a [f64] {
        self.start().unwrap_or(of_class)
    }

    /// Starts an episode: draws its first command and everything that is random about the robot.
    ///
    /// # Shapes
    /// - `row`: `[memory_len]`
    pub fn begin(&self, row: &mut [f64], reset: &Reset) {
        let total = row.get(self.slots.total.start).copied().unwrap_or_default();
        row.fill(0.0);
        row[self.slots.total.clone()].fill(total);
        if !self.slots.episode.is_empty() {
            let clock = Clock { step: 0, key: reset.key, episode: reset.episode };
            clock.write(&mut row[self.slots.episode.clone()]);
        }
        let mut stream = Stream::new(reset.key, reset.episode, Purpose::Events);
        self.events.draw(&self.drawn, &mut stream, self.dt(), &mut row[self.slots.events.clone()]);
        self.draw_command(row);
    }

    /// How the physics of an env differs from that of its damage class; `None` if that of no env does.
    #[must_use]
    pub fn variation(&self, row: &[f64]) -> Option<Variation> {
        self.drawn.variation(&row[self.slots.events.clone()])
    }

    /// Whether the physics of envs with the same damage class can differ.
    #[must_use]
    pub fn varies(&self) -> bool {
        self.events.varies()
    }

    /// A sudden change of the root's velocities before this step, linear along the world's axes, angular along its own.
    #[must_use]
    pub fn push(&self, row: &mut [f64]) -> Option<[f64; 6]> {
        let push = self.events.push?;
        let clock = Clock::read(&row[self.slots.episode.clone()]);
        let at = self.drawn.next_push(&mut row[self.slots.events.clone()])?;
        if clock.step < *at as u64 {
            return None;
        }
        let mut stream = clock.stream(Purpose::Push);
        *at += steps(events::within(&mut stream, push.every), self.dt()) as f64;
        Some(push.draw(&mut stream))
    }

    /// Turns the action of an env into controls.
    ///
    /// # Shapes
    /// - `row`: `[memory_len]`; `action`, `ctrl`: `[nu]`
    pub fn act(&self, row: &mut [f64], action: &[f32], ctrl: &mut [f64]) {
        let clipped = action.iter().map(|action| f64::from(action.clamp(-1.0, 1.0)));
        for (ctrl, action) in ctrl.iter_mut().zip(clipped) {
            *ctrl = action;
        }
        if !self.slots.actions.is_empty() {
            let actions = &mut row[self.slots.actions.clone()];
            actions.copy_within(..ctrl.len(), ctrl.len());
            actions[..ctrl.len()].copy_from_slice(ctrl);
        }
        if !self.slots.waiting.is_empty() {
            self.delay(row, ctrl);
        }
        for (ctrl, action) in ctrl.iter_mut().zip(&self.actions) {
            *ctrl = action.offset + action.scale * *ctrl;
        }
        // A servo holds the position that its encoder reads.
        for ((ctrl, actuator), bias) in
            ctrl.iter_mut().zip(&self.layout.anatomy.actuators).zip(self.encoder_bias(row))
        {
            if actuator.is_position {
                *ctrl -= bias;
            }
        }
    }

    /// Replaces an action with the one that arrives now.
    fn delay(&self, row: &mut [f64], action: &mut [f64]) {
        let (nu, delay) = (action.len(), self.drawn.action_delay(&row[self.slots.events.clone()]));
        let waiting = &mut row[self.slots.waiting.clone()];
        // The newest waits at the end.
        let newest = waiting.len() - nu;
        let arrived = (delay > 0).then(|| waiting[waiting.len() - delay * nu..][..nu].to_vec());
        waiting.copy_within(nu.., 0);
        waiting[newest..].copy_from_slice(action);
        if let Some(arrived) = arrived {
            action.copy_from_slice(&arrived);
        }
    }

    fn encoder_bias<'a>(&self, row: &'a [f64]) -> &'a [f64] {
        self.drawn.encoder_bias(&row[self.slots.events.clone()])
    }

    /// What a step has brought. Afterwards the task is at the next step, with the command that holds there.
    ///
    /// # Shapes
    /// - `row`: `[memory_len]`; `terms`: `[terms of the reward]`, their values with weights
    pub fn outcome(&self, row: &mut [f64], signals: &Signals<'_>, terms: &mut [f64]) -> Outcome {
        self.move_feet(row, signals, self.dt());
        let scene = self.scene(row, signals);
        let terminated = self.limits.are_exceeded(&scene);
        let mut reward = 0.0;
        for (value, term) in terms.iter_mut().zip(&self.rewards) {
            *value = term.weight * term.measure.value(&scene, terminated);
            reward += *value;
        }
        if !self.slots.episode.is_empty() {
            let clock = Clock::read(&row[self.slots.episode.clone()]);
            Clock { step: clock.step + 1, ..clock }.write(&mut row[self.slots.episode.clone()]);
            row[self.slots.total.clone()].iter_mut().for_each(|total| *total += 1.0);
            self.draw_command(row);
        }
        Outcome { reward, terminated }
    }

    /// Draws the command if it is time to.
    fn draw_command(&self, row: &mut [f64]) {
        let Some(velocity) = self.command else { return };
        let clock = Clock::read(&row[self.slots.episode.clone()]);
        if clock.step < row[self.slots.command.clone()][COMMAND] as u64 {
            return;
        }
        let share = self.ramp.map_or(1.0, |ramp| ramp.at(row[self.slots.total.start]));
        let slot = &mut row[self.slots.command.clone()];
        let (command, duration) = velocity.draw(&mut clock.stream(Purpose::Command), share);
        slot[..COMMAND].copy_from_slice(&command);
        slot[COMMAND] = (clock.step + steps(duration, self.dt())) as f64;
    }

    fn move_feet(&self, row: &mut [f64], signals: &Signals<'_>, dt: f64) {
        if !self.needs_feet {
            return;
        }
        let feet = &self.layout.anatomy.feet[signals.class];
        for (row, foot) in row[self.slots.feet.clone()].chunks_exact_mut(FootRow::LENGTH).zip(feet) {
            let (position, velocity) = foot.motion(signals.qpos, signals.qvel);
            let [x, y, z] = signals.contact_force(foot.body);
            FootRow::update(row, position, velocity, (x * x + y * y + z * z).sqrt(), dt);
        }
    }

    /// Writes the observation after [`outcome`](Self::outcome) into `out`, `[obs_dim]`.
    pub fn observe(&self, row: &mut [f64], signals: &Signals<'_>, out: &mut [f32]) {
        self.write(row, signals, false, out);
    }

    /// Writes an observation without a past, after a reset or in a state that was set, into `out`, `[obs_dim]`.
    pub fn observe_first(&self, row: &mut [f64], signals: &Signals<'_>, out: &mut [f32]) {
        self.move_feet(row, signals, 0.0);
        self.write(row, signals, true, out);
    }

    fn write(&self, row: &mut [f64], signals: &Signals<'_>, is_first: bool, out: &mut [f32]) {
        let (row, frames) = row.split_at_mut(self.slots.len);
        let (own, other) = frames.split_at_mut(self.policy.frames_len());
        let scene = self.scene(row, signals);
        let (seen, privileged) = out.split_at_mut(self.policy.len());
        self.policy.write(&scene, Purpose::ObservationNoise, is_first, own, seen);
        if let Some(critic) = &self.critic {
            critic.write(&scene, Purpose::PrivilegedNoise, is_first, other, privileged);
        }
    }

    fn scene<'a>(&'a self, row: &'a [f64], signals: &'a Signals<'a>) -> Scene<'a> {
        let rotation = root_rotation(signals.qpos);
        Scene {
            signals,
            layout: &self.layout,
            row,
            slots: &self.slots,
            drawn: &self.drawn,
            dt: self.dt(),
            gravity: apply_inverse(&rotation, [0.0, 0.0, -1.0]),
            lin_vel: apply_inverse(&rotation, [signals.qvel[0], signals.qvel[1], signals.qvel[2]]),
        }
    }

    /// Reads positions and velocities back from an observation; what it leaves out (x and y of the root) becomes 0.
    /// False, with nothing written, if the observation shows no more than a part of them.
    ///
    /// # Shapes
    /// - `obs`: `[obs_dim]`, `qpos`: `[nq]`, `qvel`: `[nv]`
    pub fn read_state(&self, obs: &[f32], qpos: &mut [f64], qvel: &mut [f64]) -> bool {
        let (mut positions, mut velocities) = (None, None);
        for (term, block) in self.policy.blocks() {
            // The floor is level: a robot moves at (0, 0) as it does anywhere else.
            if term.shows_positions() {
                positions = Some(&obs[block]);
            } else if term.shows_velocities() {
                velocities = Some(&obs[block]);
            }
        }
        let (Some(positions), Some(velocities)) = (positions, velocities) else { return false };
        let (unseen, seen) = qpos.split_at_mut(self.layout.nq - positions.len());
        unseen.fill(0.0);
        for (state, shown) in [(seen, positions), (qvel, velocities)] {
            state.iter_mut().zip(shown).for_each(|(state, shown)| *state = f64::from(*shown));
        }
        true
    }

    /// Whether observations show all positions, but for x and y of the root, and all velocities.
    #[must_use]
    pub fn is_observed(&self) -> bool {
        let has = |wanted: fn(&ObservationTerm) -> bool| self.policy.blocks().any(|(term, _)| wanted(term));
        has(ObservationTerm::shows_positions) && has(ObservationTerm::shows_velocities)
    }

    /// Whether each entry of an observation is a position or a velocity, `[obs_dim]`.
    #[must_use]
    pub fn shows_state(&self) -> Vec<bool> {
        let is_state = |quantity: &Quantity| matches!(quantity, Quantity::Qpos { .. } | Quantity::Qvel);
        self.policy
            .blocks()
            .flat_map(|(term, block)| std::iter::repeat_n(is_state(&term.quantity), block.len()))
            .collect()
    }
}

impl<'a> Scene<'a> {
    fn slot(&self, range: &std::ops::Range<usize>) -> &'a [f64] {
        &self.row[range.clone()]
    }

    /// Commanded velocity: forward, to the left, rate of turn.
    fn command(&self) -> &'a [f64] {
        &self.slot(&self.slots.command)[..COMMAND]
    }

    /// The last action, clipped to ±1, `[nu]`.
    fn action(&self) -> &'a [f64] {
        &self.slot(&self.slots.actions)[..self.layout.nu]
    }

    /// The action before the last one.
    fn previous_action(&self) -> &'a [f64] {
        &self.slot(&self.slots.actions)[self.layout.nu..]
    }

    fn feet(&self) -> impl Iterator<Item = FootRow<'a>> {
        self.slot(&self.slots.feet).chunks_exact(FootRow::LENGTH).map(FootRow)
    }

    /// What the events have drawn.
    fn events(&self) -> &'a [f64] {
        self.drawn.shown(self.slot(&self.slots.events))
    }

    fn encoder_bias(&self) -> &'a [f64] {
        self.drawn.encoder_bias(self.slot(&self.slots.events))
    }

    fn clock(&self) -> Clock {
        Clock::read(self.slot(&self.slots.episode))
    }

    /// Time since the episode began, s.
    fn time(&self) -> f64 {
        self.clock().step as f64 * self.dt
    }
}

/// The first term that rewards tracking of linear velocities, and its index.
pub(crate) fn tracking(terms: &[RewardTerm]) -> Option<(usize, &RewardTerm)> {
    let is_tracking =
        |term: &RewardTerm| matches!(term.measure, Measure::TrackLinVel { .. }) && term.weight > 0.0;
    terms.iter().enumerate().find(|(_, term)| is_tracking(term))
}

/// Refuses a compiled robot that the terms cannot be computed for.
fn check(robot: &Robot, layout: &Layout, rewards: &[RewardTerm]) -> Result<(), String> {
    if layout.nq < 3 {
        return Err(format!("it has {} positions, but the third one is the height of its root", layout.nq));
    }
    if layout.nu == 0 {
        return Err("it has no actuators".into());
    }
    let anatomy = &layout.anatomy;
    let has_joints = anatomy.actuators.len() == layout.nu
        && anatomy.actuators.iter().all(|actuator| actuator.joint.is_some());
    let has_feet = anatomy.feet.first().is_some_and(|feet| !feet.is_empty());
    let needs = |what: String, joints: bool, feet: bool, command: bool| {
        if joints && !has_joints {
            return Err(format!("{what} needs a hinge behind every actuator"));
        }
        if feet && !has_feet {
            return Err(format!("{what} needs an entry `foot` in every [[limbs]]"));
        }
        if command && robot.commands.velocity.is_none() {
            return Err(format!("{what} needs [commands.velocity]"));
        }
        Ok(())
    };
    let critic = robot.observation.critic.iter().flat_map(|critic| &critic.terms);
    for (index, term) in robot.observation.policy.terms.iter().chain(critic).enumerate() {
        let quantity = &term.quantity;
        if let Quantity::Qpos { skip } = quantity
            && *skip >= layout.nq
        {
            return Err(format!(
                "the observation term `qpos` skips {skip} of {} positions; expected fewer",
                layout.nq
            ));
        }
        let joints = matches!(quantity, Quantity::JointPos | Quantity::JointVel);
        let what = format!("term {index} of the observation");
        needs(what, joints, quantity.needs_feet(), *quantity == Quantity::Command)?;
    }
    for RewardTerm { name, measure, .. } in rewards {
        let what = format!("the reward term `{name}`");
        needs(what, measure.needs_joints(), measure.needs_feet(), measure.needs_command())?;
    }
    needs("[events.encoder_bias]".into(), robot.events.encoder_bias.is_some(), false, false)
}
