//! The kernel compared with the lane engine, which is compared with MuJoCo: robots that have every feature at once,
//! as no robot of the package has. Without any device, software Vulkan included, the tests say so and end.
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used, reason = "helpers of a test may fail loudly, as tests do")]

mod robots;

use dappo_gpu::{Device, Engine, Error};
use dappo_lanes::model::{Cone, Integrator, Model};
use dappo_lanes::{Precision, Readout, Simd, WorldAccess};
use robots::{Noise, damaged, robot};

const WORLDS: usize = 21;

/// What a world shows.
#[derive(Default, Clone, PartialEq, Debug)]
struct Shown(Vec<f64>);

fn place(worlds: &mut dyn WorldAccess, lane: usize, model: &Model, world: usize) {
    let noise = &mut Noise(77 + 1000 * world as u64);
    let dofs = model.dofs();
    let mut qpos = vec![0.0; dofs + 1];
    qpos.iter_mut().for_each(|x| *x = 0.6 * noise.next());
    qpos[2] = 0.25 + 0.15 * noise.next();
    let qvel: Vec<f64> = (0..dofs).map(|_| 2.0 * noise.next()).collect();
    let ctrl: Vec<f64> = (0..model.actuators).map(|_| noise.next()).collect();
    worlds.set_state(lane, &qpos, &qvel);
    worlds.set_ctrl(lane, &ctrl);
    worlds.add_root_velocity(lane, [0.1, 0.2, -0.1, 0.3, 0.1, -0.2]);
    match world % 3 {
        0 => worlds.set_class(lane, 0),
        1 => worlds.set_class(lane, 1),
        _ => {
            let mut varied = model.clone();
            varied.gravity = [0.0, 0.5, -9.0 - 0.1 * world as f64];
            worlds.set_model(lane, &varied);
        }
    }
}

fn show(worlds: &dyn WorldAccess, lane: usize, model: &Model) -> Shown {
    let dofs = model.dofs();
    let mut qpos = vec![0.0; dofs + 1];
    let [mut qvel, mut qacc] = [vec![0.0; dofs], vec![0.0; dofs]];
    let mut cfrc_ext = vec![0.0; 6 * model.bodies];
    let mut touch = vec![0.0; model.touch_sensors];
    let mut forces = vec![0.0; model.actuators];
    worlds.accelerations(lane, &mut qacc);
    worlds.actuator_forces(lane, &mut forces);
    worlds
        .read(lane, Readout { qpos: &mut qpos, qvel: &mut qvel, cfrc_ext: &mut cfrc_ext, touch: &mut touch });
    Shown([qpos, qvel, qacc, cfrc_ext, touch, forces, vec![worlds.evaluated_x(lane)]].concat())
}

/// All worlds after an evaluation and after an env step, with the lane engine and with the kernel.
fn compare(integrator: Integrator, precision: Precision, device: &Device) -> Vec<(Shown, Shown)> {
    let healthy = robot(integrator, 0x9E37_79B9_7F4A_7C15);
    let classes = vec![healthy.clone(), damaged(&healthy)];
    let lanes = dappo_lanes::Engine::new(classes.clone(), Precision::F64, Simd::Portable).unwrap();
    let engine = Engine::new(&classes, precision, device, WORLDS).unwrap();
    let mut groups = engine.groups(8);
    let mut pairs = Vec::new();
    for substeps in [0, 5] {
        for world in 0..WORLDS {
            place(&mut groups[world / 8], world % 8, &healthy, world);
        }
        let mut all: Vec<_> = groups.iter_mut().map(|group| (group, u32::MAX)).collect();
        match substeps {
            0 => engine.forward(&mut all).unwrap(),
            _ => engine.step(&mut all, substeps).unwrap(),
        }
        for world in 0..WORLDS {
            let mut group = lanes.group();
            place(group.as_mut(), 0, &healthy, world);
            match substeps {
                0 => group.forward(1),
                _ => group.step(1, substeps),
            }
            let shown = show(&groups[world / 8], world % 8, &healthy);
            let expected = show(group.as_ref(), 0, &healthy);
            pairs.push((shown, expected));
        }
    }
    pairs
}

fn device() -> Option<Device> {
    match Device::allowing(true) {
        Ok(device) => Some(device),
        Err(error) => {
            eprintln!("skipped: {error}");
            None
        }
    }
}

/// Largest error of a world, max|Δ| / (1 + max|expected|).
fn worst(pairs: &[(Shown, Shown)]) -> f64 {
    let size = |numbers: &[f64]| numbers.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    let error = |(got, expected): &(Shown, Shown)| {
        let gaps = got.0.iter().zip(&expected.0).map(|(a, b)| (a - b).abs());
        gaps.fold(0.0, |most: f64, gap| if gap.is_nan() { f64::INFINITY } else { most.max(gap) })
            / (1.0 + size(&expected.0))
    };
    pairs.iter().map(error).fold(0.0, f64::max)
}

/// Robots with every feature move as with the lane engine.
fn moves_alike(integrator: Integrator, precision: Precision, tolerance: f64) {
    let Some(device) = device() else { return };
    let pairs = compare(integrator, precision, &device);
    eprintln!("{integrator:?} {precision:?}: largest error {:.1e}", worst(&pairs));
    assert!(worst(&pairs) < tolerance);
    let pushed = pairs.iter().filter(|(_, expected)| expected.0.iter().any(|x| x.abs() > 20.0));
    assert!(pushed.count() > WORLDS / 2);
}

#[test]
fn rk4_moves_robots_as_with_the_lane_engine() {
    for rotation_correction in [true, false] {
        moves_alike(Integrator::Rk4 { rotation_correction }, Precision::F64, 1e-10);
    }
}

#[test]
fn euler_moves_robots_as_with_the_lane_engine() {
    for implicit_damping in [true, false] {
        moves_alike(Integrator::Euler { implicit_damping }, Precision::F64, 1e-10);
    }
}

#[test]
fn implicitfast_moves_robots_as_with_the_lane_engine() {
    for clamped_without_derivative in [true, false] {
        moves_alike(Integrator::ImplicitFast { clamped_without_derivative }, Precision::F64, 1e-10);
    }
}

#[test]
fn single_precision_keeps_its_digits() {
    moves_alike(Integrator::ImplicitFast { clamped_without_derivative: true }, Precision::F32, 1e-4);
}

#[test]
fn robots_beyond_the_kernel_are_refused_with_all_reasons() {
    let Some(device) = device() else { return };
    let mut model = robot(Integrator::Rk4 { rotation_correction: true }, 5);
    model.cone = Cone::Elliptic;
    model.points[0].dimensions = 6;
    let reasons = match Engine::new(&[model], Precision::F32, &device, 1) {
        Err(Error::Unsupported(reasons)) => reasons,
        other => panic!("{:?}", other.err()),
    };
    assert!(reasons.iter().any(|why| why.contains("elliptic")), "{reasons:?}");
    assert!(reasons.iter().any(|why| why.contains("condim 6")), "{reasons:?}");
}
