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
mod check;
mod command;
mod control;
mod description;
#[cfg(feature = "gpu")]
mod device;
mod draws;
mod dropout;
mod entries;
mod events;
mod faults;
mod memory;
mod observation;
mod python;
mod reward;
mod scene;
mod signals;
mod state;
mod symmetry;
mod termination;
mod variants;

use crate::backend::{Layout, Reset};
use crate::error::SimError;
use crate::rng::{Purpose, Stream};
use crate::robot::{ObservationTerms, ResetNoise, Robot};

pub use action::{ActionKind, Actions, Scale};
pub use anatomy::{ActuatorParts, Anatomy, Foot, FootHinge, FootLink, JointParts};
pub use command::{Commands, Curriculum, Ramp, VelocityCommand};
pub use dropout::ActionDropout;
pub use entries::Entry;
pub use events::{Delay, Events, Offset, Push, Scaling, Tilt, Variation};
pub use faults::{EncoderFault, FaultCourse, ImuFault, ImuOffset, SensorFaultKind};
pub use observation::{ObservationTerm, Quantity};
pub use reward::{Measure, RewardTerm};
pub use signals::Signals;
pub use symmetry::{Image, MirroredParts, Reflection, Reflections};
pub use termination::{ContactLimit, PythonFailures, Terminations, TiltLimit};
pub use variants::{BodyEvent, BodyEvents, Jam, Variants};

use action::ActuatorAction;
use anatomy::Frame;
use check::check;
use command::COMMAND;
use draws::steps;
use dropout::Dropouts;
use events::Drawn;
use faults::SensorFaults;
use memory::{Clock, FootRow, Slots};
use observation::ObservationGroup;
use scene::Scene;
use termination::Limits;

/// Everything that turns physics into what a learner sees.
#[derive(Debug, Clone)]
pub struct Task {
    /// Physics substeps an env step.
    pub frame_skip: usize,
    /// Noise of the initial state.
    pub reset: ResetNoise,
    starts_at_keyframe: bool,
    /// Names of the limbs.
    limbs: Vec<String>,
    actions: Vec<ActuatorAction>,
    command: Option<VelocityCommand>,
    /// How the ranges of the commands grow, in training.
    ramp: Option<Ramp>,
    events: Events,
    drawn: Drawn,
    sensor_faults: SensorFaults,
    dropouts: Option<Dropouts>,
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
        let drawn = events.layout(layout.nu, &layout.variants, &mut slots);
        let sensor_faults =
            SensorFaults::new(&events, &layout.anatomy, &robot.observation.policy.terms, &mut slots)
                .map_err(bad)?;
        let dropouts = events.action_dropout.map(|dropout| Dropouts::new(dropout, layout.nu, &mut slots));
        let shown = drawn.shown_len()
            + sensor_faults.names().count()
            + dropouts.iter().count() * Dropouts::names().len();
        let group = |terms: &ObservationTerms| ObservationGroup::new(&terms.terms, layout, shown);
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
            || !sensor_faults.is_empty()
            || dropouts.is_some()
            || observes(|quantity| matches!(quantity, Quantity::Clock { .. }));
        let room = |wanted: bool, length: usize| if wanted { length } else { 0 };
        slots.episode = slots.take(room(needs_clock, Clock::LENGTH));
        slots.command = slots.take(room(command.is_some(), COMMAND + 1));
        slots.total = slots.take(room(ramp.is_some(), 1));
        slots.actions = slots.take(room(needs_actions, 2 * layout.nu));
        slots.waiting = slots.take(events.longest_delay() * layout.nu);
        let feet = layout.anatomy.feet.first().map_or(0, Vec::len);
        slots.feet = slots.take(room(needs_feet, feet * FootRow::LENGTH));
        slots.variant = slots.take(room(layout.variants.count() > 1, 1));
        slots.jams = slots.take(layout.variants.most_jams());
        Ok(Self {
            frame_skip: robot.frame_skip,
            reset: robot.reset.noise(),
            starts_at_keyframe: robot.reset.keyframe.is_some(),
            limbs: robot.limbs.iter().map(|limb| limb.name.clone()).collect(),
            actions,
            command,
            ramp,
            events,
            drawn,
            sensor_faults,
            dropouts,
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
        let mut stream = Stream::new(reset.key, reset.episode, Purpose::Variant);
        let variant = stream.below(self.layout.variants.count() as u64) as usize;
        row[self.slots.variant.clone()].fill(variant as f64);
        let compiled = self.layout.variants.numbers.get(variant).map_or(&[][..], Vec::as_slice);
        let mut stream = Stream::new(reset.key, reset.episode, Purpose::Events);
        let numbers = &mut row[self.slots.events.clone()];
        self.events.draw(&self.drawn, &mut stream, self.dt(), compiled, numbers);
        let mut stream = Stream::new(reset.key, reset.episode, Purpose::SensorFaults);
        self.sensor_faults.draw(&mut stream, self.dt(), row);
        if let Some(dropouts) = &self.dropouts {
            dropouts.begin(Clock::read(&row[self.slots.episode.clone()]), self.dt(), row);
        }
        self.draw_command(row);
    }

    /// The compiled model of an env with this damage class.
    #[must_use]
    pub fn model(&self, row: &[f64], class: usize) -> usize {
        let variant = row.get(self.slots.variant.clone()).and_then(<[f64]>::first).copied();
        self.layout.variants.model(class, variant.unwrap_or_default() as usize)
    }

    /// Whether joints of damage classes jam where they are at the onset.
    #[must_use]
    pub fn jams(&self) -> bool {
        !self.slots.jams.is_empty()
    }

    /// Lets the joints of a damage class jam that becomes active at `qpos`, `[nq]`.
    pub fn jam(&self, row: &mut [f64], class: usize, qpos: &[f64]) {
        if self.jams() {
            let model = self.model(row, class);
            self.layout.variants.jam(model, qpos, &mut row[self.slots.jams.clone()]);
        }
    }

    /// The jammed joints of a model, and by how much their limits have moved, rad.
    pub fn jammed<'a>(&'a self, row: &'a [f64], model: usize) -> impl Iterator<Item = (&'a Jam, f64)> {
        let jams = self.layout.variants.jams.get(model).into_iter().flatten();
        jams.zip(row[self.slots.jams.clone()].iter().copied())
    }

    /// How the physics of an env differs from that of its compiled model; `None` if that of no env does.
    #[must_use]
    pub fn variation(&self, row: &[f64]) -> Option<Variation> {
        let drawn = self.events.variation(&self.drawn, &row[self.slots.events.clone()]);
        drawn.or_else(|| self.jams().then_some(Variation::NONE))
    }

    /// Whether the physics of envs with the same compiled model can differ.
    #[must_use]
    pub fn varies(&self) -> bool {
        self.events.varies() || self.jams()
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
        let feet = &self.layout.anatomy.feet[self.model(row, signals.class)];
        let root = Frame::of_root(signals.qpos, signals.qvel);
        for (row, foot) in row[self.slots.feet.clone()].chunks_exact_mut(FootRow::LENGTH).zip(feet) {
            let (position, velocity) = foot.motion(&root, signals.qpos, signals.qvel);
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

    /// Advances what is faulty to the present step.
    fn follow_faults(&self, row: &mut [f64], signals: &Signals<'_>) {
        if let Some(dropouts) = &self.dropouts {
            dropouts.advance(Clock::read(&row[self.slots.episode.clone()]), self.dt(), row);
        }
        if !self.sensor_faults.is_empty() {
            let scene = self.scene(row, signals);
            let (step, encoder) =
                (scene.clock().step, scene.encoder(self.sensor_faults.faulty_actuator(row)));
            let imu = scene.imu();
            self.sensor_faults.sense(step, encoder, imu, row);
        }
    }

    fn write(&self, row: &mut [f64], signals: &Signals<'_>, is_first: bool, out: &mut [f32]) {
        self.follow_faults(row, signals);
        let (row, frames) = row.split_at_mut(self.slots.len);
        let (own, other) = frames.split_at_mut(self.policy.frames_len());
        let scene = self.scene(row, signals);
        let (seen, privileged) = out.split_at_mut(self.policy.len());
        self.policy.write(&scene, Purpose::ObservationNoise, is_first, own, seen);
        if let Some(critic) = &self.critic {
            let scene = Scene { has_faults: false, ..scene };
            critic.write(&scene, Purpose::PrivilegedNoise, is_first, other, privileged);
        }
    }
}

/// The first term that rewards tracking of linear velocities, and its index.
pub(crate) fn tracking(terms: &[RewardTerm]) -> Option<(usize, &RewardTerm)> {
    let is_tracking =
        |term: &RewardTerm| matches!(term.measure, Measure::TrackLinVel { .. }) && term.weight > 0.0;
    terms.iter().enumerate().find(|(_, term)| is_tracking(term))
}
