//! Worlds are independent: a result is a function of the world's own state, class and controls.

#![allow(clippy::unwrap_used, reason = "helpers of a test may fail loudly, as tests do")]

use dappo_lanes::model::{
    Actuator, Cone, Inertia, Integrator, Link, Model, Point, RimPlace, Softness, Surface,
};
use dappo_lanes::{Engine, Group, Precision, Readout, Simd};

const LIMBS: usize = 4;
const JOINTS: usize = 2;
const NV: usize = 6 + LIMBS * JOINTS;
const NQ: usize = NV + 1;
const SOFTNESS: Softness = Softness {
    stiffness: 2500.0,
    damping: 100.0,
    impedance: [0.9, 0.95],
    width: 0.001,
    midpoint: 0.5,
    power: 2,
};

/// A quadruped of round numbers; `heavier` and `narrower` are its damage.
fn quadruped(heavier: f64, narrower: f64, integrator: Integrator) -> Model {
    let body = |mass: f64, x: f64| Inertia {
        mass,
        com: [x, 0.0, 0.0],
        tensor: [1e-3 * mass, 2e-3 * mass, 3e-3 * mass, 0.0, 1e-4 * mass, 0.0],
        compensated: 0.0,
        compensated_com: [0.0; 3],
    };
    let link = |limb: usize, joint: usize| {
        let angle = std::f64::consts::FRAC_PI_2 * (limb as f64 + 0.5);
        let (sin, cos) = angle.sin_cos();
        let hip = joint == 0;
        Link {
            offset: if hip { [0.2 * cos, 0.2 * sin, 0.0] } else { [0.2, 0.0, 0.0] },
            axes: if hip {
                [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
            } else {
                [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
            },
            zero: 0.0,
            inertia: if limb == 0 && !hip { body(0.2 * heavier, 0.15) } else { body(0.2, 0.1) },
            armature: 0.02,
            damping: 0.1,
            stiffness: 0.0,
            spring_reference: 0.0,
            friction_loss: 0.0,
            friction_softness: SOFTNESS,
            actuator_range: [f64::NEG_INFINITY, f64::INFINITY],
            range: if limb == 1 && hip { [-narrower, narrower] } else { [-0.8, 0.8] },
            margin: 0.0,
            limit: SOFTNESS,
            inverse_weight: 3.0,
            dof: 6 + JOINTS * limb + joint,
            actuator: Some(Actuator {
                index: JOINTS * limb + joint,
                gear: 1.0,
                gain: 5.0,
                bias: [0.0, -5.0, -0.2],
                ctrl_range: [-1.0, 1.0],
                force_range: [-3.0, 3.0],
            }),
        }
    };
    let foot = |limb: usize| Point {
        link: Some((limb, 1)),
        surface: Surface::Ball,
        position: [0.3, 0.0, 0.0],
        size: [0.03, 0.0, 0.0],
        tangent: Some([1.0, 0.0, 0.0]),
        margin: 0.001,
        softness: SOFTNESS,
        dimensions: 3,
        friction: [0.9, 0.005, 0.0001],
        inverse_weight: 2.0,
        body: 2 + limb,
        touch: Some(limb),
    };
    Model {
        timestep: 0.005,
        integrator,
        cone: Cone::Pyramidal,
        impedance_ratio: 1.0,
        gravity: [0.0, 0.0, -9.81],
        floor: 0.0,
        mean_inertia: 0.5,
        root: body(2.0, 0.0),
        root_armature: 0.0,
        root_damping: 0.0,
        parents: vec![None; LIMBS],
        limbs: (0..LIMBS).map(|limb| (0..JOINTS).map(|joint| link(limb, joint)).collect()).collect(),
        points: (0..LIMBS).map(foot).collect(),
        bodies: 2 + LIMBS,
        touch_sensors: LIMBS,
        actuators: LIMBS * JOINTS,
    }
}

const RK4: Integrator = Integrator::Rk4 { rotation_correction: true };
const IMPLICIT_FAST: Integrator = Integrator::ImplicitFast { clamped_without_derivative: true };
const EULER: Integrator = Integrator::Euler { implicit_damping: true };

fn classes(integrator: Integrator) -> Vec<Model> {
    [(1.0, 0.8), (0.1, 0.8), (1.0, 0.01), (3.0, 0.2)].map(|(m, r)| quadruped(m, r, integrator)).to_vec()
}

/// The same robots with every other feature of the engine.
fn featured(cone: Cone) -> Vec<Model> {
    let mut classes = classes(IMPLICIT_FAST);
    for class in &mut classes {
        (class.cone, class.impedance_ratio) = (cone, 10.0);
        (class.root_armature, class.root_damping) = (0.1, 0.3);
        (class.root.compensated, class.root.compensated_com) = (0.5, [0.01, 0.0, 0.0]);
        for link in class.limbs.iter_mut().flatten() {
            (link.stiffness, link.spring_reference, link.friction_loss) = (2.0, 0.1, 0.3);
            link.actuator_range = [-2.0, 1.5];
        }
        // Limbs of unequal length.
        class.limbs[3].truncate(1);
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for (limb, point) in class.points.iter_mut().enumerate() {
            point.dimensions = [1, 3, 4, 6][limb];
            point.size = [0.05, 0.03, 0.04];
            point.surface = match limb {
                0 => Surface::Ball,
                1 => Surface::Rim { axes, place: RimPlace::Lowest },
                2 => Surface::Rim { axes, place: RimPlace::Left },
                _ => Surface::Ellipsoid { axes },
            };
        }
        class.points[3].link = Some((3, 0));
    }
    classes
}

/// Robots with all features and integrators, by name.
fn robots() -> Vec<(&'static str, Vec<Model>)> {
    vec![
        ("RK4", classes(RK4)),
        ("Euler", classes(EULER)),
        ("implicitfast", classes(IMPLICIT_FAST)),
        ("explicit damping", classes(Integrator::Euler { implicit_damping: false })),
        ("pyramidal cones, all features", featured(Cone::Pyramidal)),
        ("elliptic cones, all features", featured(Cone::Elliptic)),
    ]
}

/// A fixed sequence of numbers in [−1, 1) for each world (a linear congruential generator).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn fill<const N: usize>(&mut self, scale: f64) -> [f64; N] {
        std::array::from_fn(|_| scale * self.next())
    }
}

/// Everything a world shows.
#[derive(Debug, Clone, PartialEq)]
struct Shown {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    cfrc_ext: Vec<f64>,
    touch: Vec<f64>,
}

fn show(group: &dyn Group, lane: usize) -> Shown {
    let mut shown = Shown {
        qpos: vec![0.0; NQ],
        qvel: vec![0.0; NV],
        cfrc_ext: vec![0.0; 6 * (2 + LIMBS)],
        touch: vec![0.0; LIMBS],
    };
    group.read(
        lane,
        Readout {
            qpos: &mut shown.qpos,
            qvel: &mut shown.qvel,
            cfrc_ext: &mut shown.cfrc_ext,
            touch: &mut shown.touch,
        },
    );
    shown
}

fn place(group: &mut dyn Group, lane: usize, world: u64) {
    let mut noise = Noise(world);
    let mut qpos = [0.0; NQ];
    qpos[2] = 0.2 + 0.1 * noise.next();
    qpos[3] = 1.0;
    for (entry, noise) in qpos[3..].iter_mut().zip(noise.fill::<{ NQ - 3 }>(0.4)) {
        *entry += noise;
    }
    group.set_class(lane, (world % 4) as usize);
    group.set_state(lane, &qpos, &noise.fill::<NV>(1.0));
}

fn act(group: &mut dyn Group, lane: usize, world: u64, step: u64) {
    group.set_ctrl(lane, &Noise(1000 * world + step).fill::<{ LIMBS * JOINTS }>(1.2));
}

/// Simulates worlds 0 to 31 for some steps, world w in lane `lane_of(w)` of its group.
fn simulate(
    precision: Precision,
    simd: Simd,
    classes: &[Model],
    lane_of: impl Fn(usize, usize) -> usize,
) -> Vec<Shown> {
    let engine = Engine::new(classes.to_vec(), precision, simd).unwrap();
    let width = engine.width();
    assert_eq!(width, simd.worlds(precision));
    let mut shown = vec![];
    for first in (0..32).step_by(width) {
        let mut group = engine.group();
        for index in 0..width {
            place(&mut *group, lane_of(index, width), (first + index) as u64);
        }
        for step in 0..12 {
            for index in 0..width {
                act(&mut *group, lane_of(index, width), (first + index) as u64, step);
            }
            group.step(u32::MAX, 3);
        }
        shown.extend((0..width).map(|index| show(&*group, lane_of(index, width))));
    }
    shown
}

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

#[test]
fn a_world_does_not_depend_on_its_lane_or_its_neighbours() {
    for precision in PRECISIONS {
        for simd in Simd::available() {
            for (robot, classes) in robots() {
                let straight = simulate(precision, simd, &classes, |index, _| index);
                let shifted = simulate(precision, simd, &classes, |index, width| (index + 3) % width);
                assert_eq!(straight, shifted, "{precision:?} {simd:?} {robot}");
                assert!(straight.iter().any(|world| world.touch.iter().any(|&force| force > 0.0)));
            }
        }
    }
}

#[test]
fn all_instruction_sets_compute_the_same_bits() {
    for precision in PRECISIONS {
        for (robot, classes) in robots() {
            let reference = simulate(precision, Simd::Portable, &classes, |index, _| index);
            for simd in Simd::available() {
                let other = simulate(precision, simd, &classes, |index, _| index);
                assert_eq!(reference, other, "{precision:?} {simd:?} {robot}");
            }
        }
    }
}

#[test]
fn worlds_outside_the_mask_stay_as_they_are() {
    for simd in Simd::available() {
        let engine = Engine::new(classes(RK4), Precision::F64, simd).unwrap();
        let mut group = engine.group();
        for lane in 0..engine.width() {
            place(&mut *group, lane, lane as u64);
        }
        group.step(u32::MAX, 2);
        let before: Vec<Shown> = (0..engine.width()).map(|lane| show(&*group, lane)).collect();
        group.step(0b0101, 2);
        group.forward(0b0001);
        for (lane, before) in before.iter().enumerate() {
            let moved = lane == 0 || lane == 2;
            assert_eq!(show(&*group, lane) != *before, moved, "lane {lane}");
        }
    }
}

#[test]
fn a_saved_row_goes_on_as_if_nothing_had_happened() {
    for precision in PRECISIONS {
        let engine = Engine::new(classes(RK4), precision, Simd::Portable).unwrap();
        let (mut group, mut other) = (engine.group(), engine.group());
        place(&mut *group, 1, 5);
        group.step(0b0010, 20);
        let mut row = vec![0.0; group.row()];
        group.save(1, &mut row);
        other.set_class(3, 1);
        other.load(3, &row);
        for step in 0..20 {
            act(&mut *group, 1, 5, step);
            act(&mut *other, 3, 5, step);
            group.step(0b0010, 3);
            other.step(0b1000, 3);
        }
        assert_eq!(show(&*group, 1), show(&*other, 3));
        assert_eq!(group.evaluated_x(1), other.evaluated_x(3));
    }
}

#[test]
fn a_diverged_world_leaves_its_neighbours_alone() {
    for precision in PRECISIONS {
        for simd in Simd::available() {
            let engine = Engine::new(classes(RK4), precision, simd).unwrap();
            let (mut healthy, mut mixed) = (engine.group(), engine.group());
            for lane in 0..engine.width() {
                place(&mut *healthy, lane, lane as u64);
                place(&mut *mixed, lane, lane as u64);
            }
            mixed.set_state(1, &[f64::NAN; NQ], &[f64::INFINITY; NV]);
            healthy.step(u32::MAX, 10);
            mixed.step(u32::MAX, 10);
            assert!(show(&*mixed, 1).qpos.iter().any(|entry| entry.is_nan()));
            for lane in (0..engine.width()).filter(|&lane| lane != 1) {
                assert_eq!(show(&*healthy, lane), show(&*mixed, lane), "{precision:?} {simd:?} lane {lane}");
            }
        }
    }
}

#[test]
fn what_damage_may_not_change_is_named() {
    let refusal = |change: fn(&mut Model)| {
        let mut classes = classes(RK4);
        change(&mut classes[2]);
        Engine::new(classes, Precision::F64, Simd::Portable).err().unwrap().to_string()
    };
    assert!(refusal(|class| class.floor = 1.0).contains("damage class 2 changes the floor"));
    assert!(refusal(|class| class.limbs[0][0].zero = 1.0).contains("the axis of a joint"));
    assert!(refusal(|class| class.points.truncate(1)).contains("the number of contact points"));
    assert!(refusal(|class| class.points[0].softness.width = 1.0).contains("the softness of a contact"));
    assert!(refusal(|class| class.limbs[1].truncate(1)).contains("the number of joints"));
    let mut many = classes(RK4);
    many.iter_mut().for_each(|class| class.limbs.extend(class.limbs.clone()));
    let message = Engine::new(many, Precision::F64, Simd::Portable).err().unwrap().to_string();
    assert!(message.contains("8 limbs of up to 2 joints"), "{message}");
}

/// Speed that the only moving joint of a robot in the air loses in a step of implicitfast, to an actuator with
/// damping d whose torque τ is clamped at the joint. Its inertia A is almost that of the rotor alone.
fn loss_of_speed(clamped_without_derivative: bool) -> f64 {
    let mut model = quadruped(1.0, 0.8, Integrator::ImplicitFast { clamped_without_derivative });
    model.gravity = [0.0; 3];
    for link in model.limbs.iter_mut().flatten() {
        (link.armature, link.damping, link.actuator_range) = (1e6, 0.0, [-1.0, 1.0]);
        if let Some(actuator) = &mut link.actuator {
            (actuator.bias, actuator.force_range) = ([0.0, 0.0, -1e8], [-1e9, 1e9]);
        }
    }
    let mut group = Engine::new(vec![model], Precision::F64, Simd::Portable).unwrap().group();
    let (mut qpos, mut qvel) = ([0.0; NQ], [0.0; NV]);
    (qpos[2], qpos[3], qvel[6]) = (5.0, 1.0, 0.1);
    group.set_state(0, &qpos, &qvel);
    group.step(1, 1);
    0.1 - show(&*group, 0).qvel[6]
}

#[test]
fn a_clamped_actuator_is_implicit_in_velocity_only_if_its_derivative_is_kept() {
    // h τ / A, and h τ / (A + h d), with h = 0.005, τ = 1, A = 1e6 and d = 1e8.
    let (without, kept) = (5e-9, 0.005 / 1.5e6);
    assert!((loss_of_speed(true) / without - 1.0).abs() < 1e-3);
    assert!((loss_of_speed(false) / kept - 1.0).abs() < 1e-3);
}

#[test]
fn a_joint_may_have_limits_in_one_class_and_none_in_another() {
    let mut classes = classes(RK4);
    for link in classes[1].limbs.iter_mut().flatten() {
        link.range = [f64::NEG_INFINITY, f64::INFINITY];
    }
    for world in simulate(Precision::F64, Simd::Portable, &classes, |index, _| index) {
        assert!(world.qpos.iter().chain(&world.qvel).all(|value| value.is_finite()));
    }
}
