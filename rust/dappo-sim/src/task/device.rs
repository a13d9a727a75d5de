//! The task as the kernels of a GPU have it.

use dappo_gpu::TaskTable;
use dappo_gpu::plan::{
    Actuator, Command, Constant, Episode, Events, FOOT_LINK, Foot, Limits, Measure as DeviceMeasure, Memory,
    Observed, Plan, Push, Quantity as DeviceQuantity, Reward,
};

use super::memory::Clock;
use super::{Foot as HostFoot, Measure, ObservationGroup, ObservationTerm, Quantity, Task, Variants};
use crate::backend::lanes::LaneTable;
use crate::damage::DamageSpace;
use crate::error::SimError;
use crate::vector_env::{StepRange, VectorEnvConfig};

/// Largest number of steps that episodes on the device count with.
const MOST_STEPS: usize = 1 << 31;

impl Task {
    /// What the kernels need to know of this task and its episodes.
    ///
    /// # Errors
    /// All that they do not know.
    pub fn on_device(
        &self,
        table: &LaneTable,
        space: &DamageSpace,
        config: &VectorEnvConfig,
    ) -> Result<TaskTable, SimError> {
        let reasons = self.refusals(config);
        if !reasons.is_empty() {
            return Err(SimError::Unsupported(reasons));
        }
        let code = if config.observe_damage { space.code_length() } else { 0 };
        let plan = self.plan(config, code)?;
        let models = table.models().len();
        let numbers = (0..models).flat_map(|model| self.model_numbers(table, model)).collect();
        Ok(TaskTable { models: numbers, classes: self.class_numbers(table, space, config), plan })
    }

    /// What the device needs to know of the damage classes, `[classes, class_len]`.
    pub(crate) fn class_numbers(
        &self,
        table: &LaneTable,
        space: &DamageSpace,
        config: &VectorEnvConfig,
    ) -> Vec<f64> {
        let code = if config.observe_damage { space.code_length() } else { 0 };
        let codes = space.codes();
        let variants = &self.layout.variants;
        let mut numbers = Vec::new();
        for (class, sum) in config.classes.cumulative().iter().enumerate() {
            numbers.push(*sum);
            let disabled = table.disabled_touch(class).iter().map(|is_off| f64::from(u8::from(*is_off)));
            let limbs = self.limbs.len();
            numbers.extend(disabled.chain(std::iter::repeat(0.0)).take(limbs));
            numbers.extend((0..variants.count()).map(|variant| variants.model(class, variant) as f64));
            numbers.extend(codes[class * space.code_length()..][..code].iter().map(|bit| f64::from(*bit)));
        }
        numbers
    }

    /// Writes the clock of an env into what the task remembers of it, `[memory_len]`.
    pub(crate) fn show_clock(&self, row: &mut [f64], clock: &dappo_gpu::Clock) {
        if !self.slots.episode.is_empty() {
            let clock = Clock { step: clock.step.into(), key: clock.key, episode: clock.number };
            clock.write(&mut row[self.slots.episode.clone()]);
        }
    }

    fn refusals(&self, config: &VectorEnvConfig) -> Vec<String> {
        let mut reasons = Vec::new();
        let mut refuse = |is_refused: bool, what: &str| {
            if is_refused {
                reasons.push(format!("the kernels do not know {what}"));
            }
        };
        let terms = || [&self.policy].into_iter().chain(&self.critic).flat_map(ObservationGroup::blocks);
        let is_python = |term: &ObservationTerm| matches!(term.quantity, Quantity::Python { .. });
        let rewards = self.rewards.iter().any(|term| matches!(term.measure, Measure::Python { .. }));
        let python = rewards || !self.python_failures.is_empty() || terms().any(|(term, _)| is_python(term));
        refuse(python, "terms in Python");
        refuse(!self.sensor_faults.is_empty(), "faults of sensors ([events] encoder_fault, imu_fault)");
        refuse(self.dropouts.is_some(), "actions that do not arrive ([events] action_dropout)");
        let has_hinges = self.layout.anatomy.actuators.iter().all(|actuator| actuator.joint.is_some());
        refuse(!has_hinges, "actuators that move something else than one hinge");
        let feet = &self.layout.anatomy.feet;
        let alike = |feet: &Vec<HostFoot>, first: &Vec<HostFoot>| {
            feet.iter().map(on_links).eq(first.iter().map(on_links))
        };
        let same = !self.needs_feet || feet.iter().all(|model| alike(model, &feet[0]));
        refuse(!same, "feet whose links differ between damage classes");
        let course = config.course;
        let ranges = [Some(course.onset), course.duration, course.pause, Some(course.code_delay)];
        let longest = ranges.into_iter().flatten().map(|range| range.last);
        let longest = longest.chain([config.max_episode_steps, config.min_class_steps]).max();
        refuse(longest >= Some(MOST_STEPS), "times of 2^31 env steps and more");
        reasons
    }

    fn plan(&self, config: &VectorEnvConfig, code: usize) -> Result<Plan, SimError> {
        let (layout, slots) = (&self.layout, &self.slots);
        let shown = self.drawn.shown_len();
        let observed = |term: &ObservationTerm| {
            Ok(Observed {
                quantity: quantity(&term.quantity)?,
                width: term.quantity.len(layout, shown),
                noise: term.noise.into(),
                clip: term.clip.map(Constant::from),
                scale: term.scale.into(),
                frames: term.frames(),
                history: term.history,
            })
        };
        let group =
            |group: &super::ObservationGroup| group.blocks().map(|(term, _)| observed(term)).collect();
        let course = config.course;
        let feet = if self.needs_feet { layout.anatomy.feet.first() } else { None };
        Ok(Plan {
            dt: self.dt().into(),
            substeps: self.frame_skip as u32,
            qpos_noise: self.reset.qpos_noise.into(),
            qvel_noise: self.reset.qvel_noise.into(),
            actuators: self.actuators(),
            bodies: layout.nbody,
            classes: config.classes.len() as u32,
            limbs: layout.limb_bodies.clone(),
            touches: layout.touch_addresses.clone(),
            feet: feet.into_iter().flatten().map(foot).collect(),
            jams: slots.jams.len(),
            variants: layout.variants.count(),
            variant_numbers: layout.variants.names.len(),
            command: self.command.map(|command| Command {
                lin_vel_x: interval(command.lin_vel_x),
                lin_vel_y: interval(command.lin_vel_y),
                ang_vel_z: interval(command.ang_vel_z),
                standing: command.standing.into(),
                resample_every: interval(command.resample_every),
                ramp: self.ramp.map(|ramp| interval([ramp.start, ramp.steps as f64])),
            }),
            events: self.drawn_on_device(),
            policy: group(&self.policy)?,
            critic: self.critic.as_ref().map_or_else(|| Ok(Vec::new()), group)?,
            code,
            rewards: self
                .rewards
                .iter()
                .map(|term| Ok(Reward { weight: term.weight.into(), measure: measure(&term.measure)? }))
                .collect::<Result<_, SimError>>()?,
            limits: Limits {
                height: interval(self.limits.height),
                cosine: self.limits.cosine.into(),
                bodies: self.limits.bodies().to_vec(),
                force: self.limits.force.into(),
            },
            memory: Memory {
                command: slots.command.clone(),
                total: slots.total.clone(),
                actions: slots.actions.clone(),
                waiting: slots.waiting.clone(),
                events: slots.events.clone(),
                variant: slots.variant.clone(),
                jams: slots.jams.clone(),
                feet: slots.feet.clone(),
                frames: slots.len,
                len: self.memory_len(),
            },
            episode: Episode {
                max_steps: config.max_episode_steps as u32,
                min_class_steps: config.min_class_steps as u32,
                onset: steps(course.onset),
                duration: course.duration.map(steps),
                pause: course.pause.map(steps),
                code_delay: steps(course.code_delay),
            },
        })
    }

    fn actuators(&self) -> Vec<Actuator> {
        let anatomy = &self.layout.anatomy;
        let with_joints = anatomy.actuators.iter().zip(&self.actions).filter_map(|(actuator, action)| {
            let joint = actuator.joint.as_ref()?;
            Some(Actuator {
                offset: action.offset.into(),
                scale: action.scale.into(),
                qpos: joint.qpos,
                dof: joint.dof,
                start: anatomy.start[joint.qpos].into(),
                range: interval(joint.range),
                is_position: actuator.is_position,
            })
        });
        with_joints.collect()
    }

    fn drawn_on_device(&self) -> Events {
        let events = &self.events;
        let scale = |scaling: Option<super::Scaling>| scaling.map(|scaling| interval(scaling.scale));
        Events {
            friction: scale(events.friction),
            motor_strength: scale(events.motor_strength),
            kp: scale(events.kp),
            kd: scale(events.kd),
            joint_damping: scale(events.joint_damping),
            joint_armature: scale(events.joint_armature),
            gravity: events.gravity.map(|tilt| interval(tilt.angle)),
            encoder_bias: events.encoder_bias.map(|bias| interval(bias.offset)),
            action_delay: events.action_delay.map(|delay| delay.steps.map(|steps| steps as u32)),
            push: events.push.map(|push| Push {
                every: interval(push.every),
                lin_vel: push.lin_vel.into(),
                ang_vel: push.ang_vel.into(),
            }),
        }
    }

    /// The numbers of a model that the task uses: initial positions, jams, its variant, feet.
    fn model_numbers(&self, table: &LaneTable, model: usize) -> Vec<f64> {
        let variants = &self.layout.variants;
        let mut numbers = self.start_or(table.start(model)).to_vec();
        let jams = variants.jams.get(model).map_or(&[][..], Vec::as_slice);
        for slot in 0..self.slots.jams.len() {
            numbers.extend(jams.get(slot).map_or([0.0; 5], |jam| {
                [jam.dof as f64, jam.share, jam.compiled_at, jam.range[0], jam.range[1]]
            }));
        }
        numbers.extend(variant_of(variants, model));
        if self.needs_feet {
            for foot in &self.layout.anatomy.feet[model] {
                for link in &foot.links {
                    let hinge = link.hinge.as_ref();
                    let start = numbers.len();
                    numbers.extend(link.position.iter().chain(&link.orientation));
                    numbers.extend(hinge.map_or([0.0; 3], |hinge| hinge.axis));
                    numbers.extend(hinge.map_or([0.0; 3], |hinge| hinge.anchor));
                    numbers.push(hinge.map_or(0.0, |hinge| hinge.reference));
                    debug_assert_eq!(numbers.len(), start + FOOT_LINK);
                }
                numbers.extend(foot.offset);
            }
        }
        numbers
    }
}

/// The numbers of the variant that a model is of.
fn variant_of(variants: &Variants, model: usize) -> Vec<f64> {
    let of_class = |models: &Vec<usize>| models.iter().position(|&other| other == model);
    let variant = variants.models.iter().find_map(of_class).unwrap_or(0);
    variants.numbers.get(variant).cloned().unwrap_or_default()
}

/// The body of a foot and the hinges that move it.
fn on_links(foot: &HostFoot) -> (usize, Vec<Option<usize>>) {
    let hinges = foot.links.iter().map(|link| link.hinge.as_ref().map(|hinge| hinge.qpos));
    (foot.body, hinges.collect())
}

fn foot(foot: &HostFoot) -> Foot {
    let (body, hinges) = on_links(foot);
    Foot { body, hinges }
}

fn interval(range: [f64; 2]) -> [Constant; 2] {
    range.map(Constant::from)
}

fn steps(range: StepRange) -> [u32; 2] {
    [range.first as u32, range.last as u32]
}

fn quantity(quantity: &Quantity) -> Result<DeviceQuantity, SimError> {
    Ok(match quantity {
        Quantity::Qpos { skip } => DeviceQuantity::Qpos { skip: *skip },
        Quantity::Qvel => DeviceQuantity::Qvel,
        Quantity::CfrcExt => DeviceQuantity::CfrcExt,
        Quantity::Touch => DeviceQuantity::Touch,
        Quantity::BaseHeight => DeviceQuantity::BaseHeight,
        Quantity::BaseLinVel => DeviceQuantity::BaseLinVel,
        Quantity::BaseAngVel => DeviceQuantity::BaseAngVel,
        Quantity::ProjectedGravity => DeviceQuantity::ProjectedGravity,
        Quantity::Command => DeviceQuantity::Command,
        Quantity::JointPos => DeviceQuantity::JointPos,
        Quantity::JointVel => DeviceQuantity::JointVel,
        Quantity::LastAction => DeviceQuantity::LastAction,
        Quantity::Clock { period } => DeviceQuantity::Clock { period: (*period).into() },
        Quantity::FootContact => DeviceQuantity::FootContact,
        Quantity::FootVel => DeviceQuantity::FootVel,
        Quantity::FootHeight => DeviceQuantity::FootHeight,
        Quantity::FootAirTime => DeviceQuantity::FootAirTime,
        Quantity::Events => DeviceQuantity::Events,
        Quantity::Python { function, .. } => return Err(unknown(function)),
    })
}

fn measure(measure: &Measure) -> Result<DeviceMeasure, SimError> {
    Ok(match measure {
        Measure::ForwardVelocity => DeviceMeasure::ForwardVelocity,
        Measure::Survive => DeviceMeasure::Survive,
        Measure::Termination => DeviceMeasure::Termination,
        Measure::LimbContacts => DeviceMeasure::LimbContacts,
        Measure::CtrlSquared => DeviceMeasure::CtrlSquared,
        Measure::ContactForcesSquared { clip } => {
            DeviceMeasure::ContactForcesSquared { clip: (*clip).into() }
        }
        Measure::LinkLoadsSquared { clip } => DeviceMeasure::LinkLoadsSquared { clip: (*clip).into() },
        Measure::TrackLinVel { std } => DeviceMeasure::TrackLinVel { std: (*std).into() },
        Measure::TrackAngVel { std } => DeviceMeasure::TrackAngVel { std: (*std).into() },
        Measure::Upright { std } => DeviceMeasure::Upright { std: (*std).into() },
        Measure::TiltSquared => DeviceMeasure::TiltSquared,
        Measure::LinVelZSquared => DeviceMeasure::LinVelZSquared,
        Measure::AngVelXySquared => DeviceMeasure::AngVelXySquared,
        Measure::BaseHeightSquared { target } => {
            DeviceMeasure::BaseHeightSquared { target: (*target).into() }
        }
        Measure::ActionRateSquared => DeviceMeasure::ActionRateSquared,
        Measure::TorqueSquared => DeviceMeasure::TorqueSquared,
        Measure::Power => DeviceMeasure::Power,
        Measure::JointLimits { soft } => DeviceMeasure::JointLimits { soft: (*soft).into() },
        Measure::PoseSquared => DeviceMeasure::PoseSquared,
        Measure::Pose { std } => DeviceMeasure::Pose { std: (*std).into() },
        Measure::StandStill => DeviceMeasure::StandStill,
        Measure::FeetAirTime { threshold } => DeviceMeasure::FeetAirTime { threshold: (*threshold).into() },
        Measure::FeetSlip => DeviceMeasure::FeetSlip,
        Measure::FeetClearance { target } => DeviceMeasure::FeetClearance { target: (*target).into() },
        Measure::Landing => DeviceMeasure::Landing,
        Measure::Python { function } => return Err(unknown(function)),
    })
}

fn unknown(function: &str) -> SimError {
    SimError::Unsupported(vec![format!("the kernels do not know terms in Python (`{function}`)")])
}
