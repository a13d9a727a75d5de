//! Robots that have every feature at once.

use dappo_lanes::model::{
    Actuator, Cone, Inertia, Integrator, Link, Model, Point, RimPlace, Softness, Surface, Vector,
};

/// Numbers between −1 and 1.
pub struct Noise(pub u64);

impl Noise {
    /// The next number.
    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn vector(&mut self, scale: f64) -> Vector {
        [0; 3].map(|_| scale * self.next())
    }

    /// Axes of a rotated frame.
    pub fn axes(&mut self) -> [Vector; 3] {
        let normalised = |v: Vector| v.map(|x| x / v.iter().map(|x| x * x).sum::<f64>().sqrt());
        let cross = |a: Vector, b: Vector| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let z = normalised(self.vector(1.0));
        let x = normalised(cross(z, self.vector(1.0)));
        [x, cross(z, x), z]
    }

    fn inertia(&mut self, mass: f64) -> Inertia {
        let moment = 0.004 * mass;
        let off = |noise: &mut Self| 0.2 * moment * noise.next();
        Inertia {
            mass,
            com: self.vector(0.05),
            tensor: [moment, 1.2 * moment, 1.1 * moment, off(self), off(self), off(self)],
            compensated: 0.3 * mass,
            compensated_com: self.vector(0.03),
        }
    }

    fn softness(&mut self, power: u8) -> Softness {
        Softness {
            stiffness: 2500.0,
            damping: 100.0 + 5.0 * self.next(),
            impedance: [0.9, 0.95],
            width: 0.01,
            midpoint: 0.4,
            power,
        }
    }
}

fn link(noise: &mut Noise, dof: usize, actuator: Option<usize>) -> Link {
    Link {
        offset: noise.vector(0.2),
        axes: noise.axes(),
        zero: 0.1 * noise.next(),
        inertia: noise.inertia(0.4),
        armature: 0.02,
        damping: 0.3,
        stiffness: 1.5,
        spring_reference: 0.2 * noise.next(),
        friction_loss: 0.2,
        friction_softness: noise.softness(2),
        actuator_range: [-2.0, 2.0],
        range: [-0.4, 0.5],
        margin: 0.02,
        limit: noise.softness(3),
        inverse_weight: 3.0,
        dof,
        actuator: actuator.map(|index| Actuator {
            index,
            gear: 1.3,
            gain: 12.0,
            bias: [0.1, -12.0, -0.6],
            ctrl_range: [-0.6, 0.6],
            force_range: [-4.0, 4.0],
        }),
    }
}

fn point(
    noise: &mut Noise,
    link: Option<(usize, usize)>,
    surface: Surface,
    size: Vector,
    body: usize,
) -> Point {
    Point {
        link,
        surface,
        position: noise.vector(0.1),
        size,
        tangent: (surface == Surface::Ball && body.is_multiple_of(2)).then(|| noise.axes()[0]),
        margin: 0.001,
        softness: noise.softness(if link.is_none() { 1 } else { 2 }),
        dimensions: 3,
        friction: [0.8, 0.005, 0.0001],
        inverse_weight: 1.5,
        body,
        touch: link.map(|(limb, _)| limb),
    }
}

/// A robot of three limbs with three, two and one joints, all features, and points of every kind.
pub fn robot(integrator: Integrator, seed: u64) -> Model {
    let noise = &mut Noise(seed);
    let mut dof = 6;
    let limbs: Vec<Vec<Link>> = [3, 2, 1]
        .into_iter()
        .map(|joints| {
            (0..joints)
                .map(|_| {
                    dof += 1;
                    link(noise, dof - 1, (dof != 9).then_some(dof - 7))
                })
                .collect()
        })
        .collect();
    let cylinder = noise.axes();
    let mut points: Vec<Point> = (0..4)
        .map(|_| {
            let way = noise.vector(1.0);
            point(noise, None, Surface::Corner, way, 1)
        })
        .collect();
    points.push(point(noise, None, Surface::Ball, [0.1, 0.0, 0.0], 2));
    let center = noise.vector(0.1);
    for place in [RimPlace::Lowest, RimPlace::OtherEnd, RimPlace::Left, RimPlace::Right] {
        let surface = Surface::Rim { axes: cylinder, place };
        let rim = point(noise, Some((0, 1)), surface, [0.05, 0.12, 0.0], 3);
        points.push(Point { position: center, ..rim });
    }
    let axes = noise.axes();
    points.push(point(noise, Some((1, 1)), Surface::Ellipsoid { axes }, [0.05, 0.09, 0.12], 4));
    points.push(point(noise, Some((0, 2)), Surface::Ball, [0.06, 0.0, 0.0], 5));
    points.push(point(noise, Some((2, 0)), Surface::Ball, [0.06, 0.0, 0.0], 6));
    Model {
        timestep: 0.004,
        integrator,
        cone: Cone::Pyramidal,
        impedance_ratio: 1.0,
        gravity: [0.4, -0.3, -9.7],
        floor: 0.05,
        mean_inertia: 0.5,
        root: noise.inertia(3.0),
        root_armature: 0.1,
        root_damping: 0.2,
        parents: vec![None; limbs.len()],
        limbs,
        points,
        bodies: 7,
        touch_sensors: 3,
        actuators: 6,
    }
}

/// A damaged robot: all that a class may change.
pub fn damaged(healthy: &Model) -> Model {
    let mut model = healthy.clone();
    for link in model.limbs.iter_mut().flatten() {
        link.inertia.mass *= 0.7;
        link.damping *= 2.0;
        link.range = [-0.05, 0.05];
        if let Some(actuator) = &mut link.actuator {
            actuator.gain *= 0.5;
        }
    }
    for point in &mut model.points {
        point.friction[0] *= 0.5;
        point.size = point.size.map(|size| 0.9 * size);
    }
    model
}
