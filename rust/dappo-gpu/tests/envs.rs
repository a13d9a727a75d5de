//! Whole rollouts with every term and event at once: the same bits every time, and after a state is restored. That
//! they are those of the host is tested in Python, where robots are compiled (`tests/parity/test_gpu_rollouts.py`).
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used, reason = "helpers of a test may fail loudly, as tests do")]

mod robots;

use dappo_gpu::plan::{
    Actuator, Command, Constant, Episode, Events, Foot, Interval, Limits, Measure, Memory, Observed, Plan,
    Push, Quantity, Reward,
};
use dappo_gpu::{Collected, Device, Envs, Net, Networks, TaskTable};
use dappo_lanes::Precision;
use dappo_lanes::model::{Integrator, Model};
use robots::{Noise, damaged, robot};

const ENVS: usize = 11;
const HORIZON: usize = 6;
/// Joints that an actuator moves.
const ACTUATED: [usize; 5] = [6, 7, 9, 10, 11];

fn interval(low: f64, high: f64) -> Interval {
    [low.into(), high.into()]
}

fn observed(quantity: Quantity, width: usize) -> Observed {
    Observed {
        quantity,
        width,
        noise: 0.1.into(),
        clip: Some(5.0.into()),
        scale: 0.5.into(),
        frames: 3,
        history: 2,
    }
}

fn measures() -> Vec<Measure> {
    let one = Constant::from(0.7);
    vec![
        Measure::ForwardVelocity,
        Measure::Survive,
        Measure::Termination,
        Measure::LimbContacts,
        Measure::CtrlSquared,
        Measure::ContactForcesSquared { clip: one },
        Measure::LinkLoadsSquared { clip: one },
        Measure::TrackLinVel { std: one },
        Measure::TrackAngVel { std: one },
        Measure::Upright { std: one },
        Measure::TiltSquared,
        Measure::LinVelZSquared,
        Measure::AngVelXySquared,
        Measure::BaseHeightSquared { target: one },
        Measure::ActionRateSquared,
        Measure::TorqueSquared,
        Measure::Power,
        Measure::JointLimits { soft: one },
        Measure::PoseSquared,
        Measure::Pose { std: one },
        Measure::StandStill,
        Measure::FeetAirTime { threshold: one },
        Measure::FeetSlip,
        Measure::FeetClearance { target: one },
        Measure::Landing,
    ]
}

/// Where each quantity is in what an env remembers, behind five numbers of the host's clock.
fn memory(nu: usize, frames: usize) -> Memory {
    let mut end = 5;
    let mut take = |length: usize| {
        end += length;
        end - length..end
    };
    let (command, total) = (take(4), take(1));
    let (actions, waiting) = (take(2 * nu), take(2 * nu));
    let (events, variant) = (take(9 + nu + 2), take(0));
    let (jams, feet) = (take(1), take(2 * 9));
    Memory { command, total, actions, waiting, events, variant, jams, feet, frames: end, len: end + frames }
}

fn plan(model: &Model) -> Plan {
    let nu = ACTUATED.len();
    let actuator = |dof: usize| Actuator {
        offset: 0.1.into(),
        scale: 0.4.into(),
        qpos: dof + 1,
        dof,
        start: 0.05.into(),
        range: interval(-0.4, 0.5),
        is_position: true,
    };
    let policy = vec![
        observed(Quantity::Qpos { skip: 0 }, 13),
        observed(Quantity::Qvel, 12),
        observed(Quantity::CfrcExt, 6 * model.bodies),
        observed(Quantity::Touch, 3),
        observed(Quantity::BaseHeight, 1),
        observed(Quantity::BaseLinVel, 3),
        observed(Quantity::BaseAngVel, 3),
        observed(Quantity::ProjectedGravity, 3),
        observed(Quantity::Command, 3),
        observed(Quantity::JointPos, nu),
        observed(Quantity::JointVel, nu),
        observed(Quantity::LastAction, nu),
        observed(Quantity::Clock { period: 0.7.into() }, 2),
    ];
    let critic = vec![
        observed(Quantity::FootContact, 2),
        observed(Quantity::FootVel, 6),
        observed(Quantity::FootHeight, 2),
        observed(Quantity::FootAirTime, 2),
        observed(Quantity::Events, 9 + nu + 1),
    ];
    let frames = policy.iter().chain(&critic).map(|term| term.frames * term.width).sum();
    let range = Some(interval(0.8, 1.2));
    Plan {
        dt: (2.0 * model.timestep).into(),
        substeps: 2,
        qpos_noise: 0.05.into(),
        qvel_noise: 0.3.into(),
        actuators: ACTUATED.map(actuator).to_vec(),
        bodies: model.bodies,
        classes: 2,
        limbs: vec![vec![3, 5], vec![4], vec![6]],
        touches: vec![0, 1, 2],
        feet: vec![
            Foot { body: 5, hinges: vec![Some(7), Some(8), None, Some(9)] },
            Foot { body: 4, hinges: vec![Some(10), Some(11)] },
        ],
        jams: 1,
        variants: 1,
        variant_numbers: 0,
        command: Some(Command {
            lin_vel_x: interval(-1.0, 1.0),
            lin_vel_y: interval(-0.5, 0.5),
            ang_vel_z: interval(-1.0, 1.0),
            standing: 0.2.into(),
            resample_every: interval(0.01, 0.03),
            ramp: Some(interval(0.2, 9.0)),
        }),
        events: Events {
            friction: range,
            motor_strength: range,
            kp: range,
            kd: range,
            joint_damping: range,
            joint_armature: range,
            gravity: Some(interval(0.0, 0.1)),
            encoder_bias: Some(interval(-0.02, 0.02)),
            action_delay: Some([0, 2]),
            push: Some(Push { every: interval(0.01, 0.03), lin_vel: 0.5.into(), ang_vel: 0.4.into() }),
        },
        policy,
        critic,
        code: 1,
        rewards: measures().into_iter().map(|measure| Reward { weight: 0.3.into(), measure }).collect(),
        limits: Limits {
            height: interval(0.0, 2.0),
            cosine: 0.3.into(),
            bodies: vec![2],
            force: 400.0.into(),
        },
        memory: memory(nu, frames),
        episode: Episode {
            max_steps: 4,
            min_class_steps: 6,
            onset: [0, 2],
            duration: Some([1, 2]),
            pause: Some([1, 2]),
            code_delay: [0, 1],
        },
    }
}

fn table(plan: Plan, models: &[Model]) -> TaskTable {
    let noise = &mut Noise(5);
    let mut numbers = Vec::new();
    for (index, model) in models.iter().enumerate() {
        // Half a metre above the floor, upright.
        let mut start = vec![0.0; model.dofs() + 1];
        (start[2], start[3]) = (0.5, 1.0);
        numbers.extend(start);
        numbers.extend([7.0, index as f64, 0.0, -0.1, 0.1]);
        for foot in &plan.feet {
            for _ in &foot.hinges {
                numbers.extend(noise.vector(0.2).into_iter().chain([1.0, 0.0, 0.0, 0.0]));
                numbers.extend(noise.axes()[0].into_iter().chain(noise.vector(0.1)).chain([0.1]));
            }
            numbers.extend(noise.vector(0.1));
        }
    }
    let classes = vec![0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0];
    TaskTable { plan, models: numbers, classes }
}

/// Networks with random parameters, for observations with a damage code of one entry.
struct Random {
    sizes: [Vec<usize>; 2],
    parameters: [Vec<f32>; 2],
}

impl Random {
    fn new(plan: &Plan) -> Self {
        let noise = &mut Noise(9);
        let sizes = [vec![plan.policy_len() + plan.code, 7, ACTUATED.len()], vec![plan.obs_len(), 5, 6, 1]];
        let count = |sizes: &Vec<usize>| sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
        let mut parameters =
            |sizes: &Vec<usize>| (0..count(sizes)).map(|_| 0.2 * noise.next() as f32).collect();
        Self { parameters: [parameters(&sizes[0]), parameters(&sizes[1])], sizes }
    }

    fn networks(&self) -> Networks<'_> {
        let net = |index: usize| Net { sizes: &self.sizes[index], parameters: &self.parameters[index] };
        Networks {
            policy: net(0),
            value: net(1),
            log_std: &[-0.7; ACTUATED.len()],
            statistics: None,
            code_scale: 2.0,
        }
    }
}

fn envs(precision: Precision, integrator: Integrator) -> Option<Envs> {
    let device = Device::allowing(true).inspect_err(|why| eprintln!("skipped: {why}")).ok()?;
    let healthy = robot(integrator, 1);
    let models = [healthy.clone(), damaged(&healthy)];
    let keys: Vec<u64> = (0..ENVS as u64).map(|env| env << 33 | 5).collect();
    let table = table(plan(&healthy), &models);
    Some(Envs::new(&models, precision, &device, table, &keys, &keys).unwrap())
}

/// Needs no device. `DAPPO_CUDA_SOURCE` names a folder for the sources, for a compiler.
#[cfg(feature = "cuda-source")]
#[test]
fn cuda_can_express_all_kernels_of_a_rollout() {
    let healthy = robot(Integrator::Euler { implicit_damping: true }, 1);
    let models = [healthy.clone(), damaged(&healthy)];
    for (name, source) in dappo_gpu::cuda_source::rollout(&models, &plan(&healthy)).unwrap() {
        assert!(source.contains("__global__"), "{name}");
        if let Some(folder) = std::env::var_os("DAPPO_CUDA_SOURCE") {
            std::fs::write(std::path::Path::new(&folder).join(format!("{name}.cu")), source).unwrap();
        }
    }
}

fn bits(collected: &Collected) -> Vec<u32> {
    let arrays = [
        &collected.obs,
        &collected.actions,
        &collected.means,
        &collected.log_probs,
        &collected.values,
        &collected.final_values,
        &collected.last_values,
        &collected.rewards,
        &collected.forward_velocity,
    ];
    arrays.into_iter().flatten().map(|number| number.to_bits()).collect()
}

fn repeats(precision: Precision) {
    let integrator = Integrator::Euler { implicit_damping: true };
    let Some(mut first) = envs(precision, integrator) else { return };
    let networks = Random::new(first.plan());
    let networks = networks.networks();
    let begun = first.collect(&networks, HORIZON, 0).unwrap();
    assert!(begun.obs.iter().chain(&begun.rewards).chain(&begun.values).all(|number| number.is_finite()));
    assert_eq!(begun.diverged, 0);
    assert!(begun.truncated.contains(&true) && begun.truncated.contains(&false));
    assert!(begun.final_values.iter().any(|value| *value != 0.0));
    let states = first.states().unwrap();
    // Each episode lasts four steps at most.
    assert!(states.clocks.iter().all(|clock| clock.number >= 1 && clock.step < 4));
    assert!(states.clocks.iter().any(|clock| clock.class == 1));
    let continued = first.collect(&networks, HORIZON, HORIZON as u64).unwrap();

    let mut second = envs(precision, integrator).unwrap();
    assert_eq!(bits(&second.collect(&networks, HORIZON, 0).unwrap()), bits(&begun));
    let mut third = envs(precision, integrator).unwrap();
    let mut states = states;
    for clock in &mut states.clocks {
        clock.model = clock.in_force;
    }
    third.restore(&states).unwrap();
    assert_eq!(bits(&third.collect(&networks, HORIZON, HORIZON as u64).unwrap()), bits(&continued));
}

#[test]
fn rollouts_repeat_bit_for_bit_in_single_precision() {
    repeats(Precision::F32);
}

#[test]
fn rollouts_repeat_bit_for_bit_in_double_precision() {
    repeats(Precision::F64);
}
