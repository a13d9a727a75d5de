//! What a contact contributes to the gradient and to the Hessian of the solver's problem: Jᵀ times the derivatives
//! of its cost, and times J.

use crate::arrow::Arrow;
use crate::cone::ConeContact;
use crate::contact::Contact;
use crate::coords::Coords;
use crate::kinematics::Kinematics;
use crate::lane::Lane;
use crate::math::{Axes, Vec3, add, cross, dot, rotate, zero3};
use crate::pyramid::Push;

/// Adds a contact's force to the gradient and its stiffness to the Hessian.
///
/// The stiffness is a symmetric 3 × 3 matrix in the contact's frame; the Jacobian carries it over.
#[inline(always)]
pub fn add_contact<T: Lane, const L: usize, const J: usize, const W: usize>(
    contact: &Contact<T, J, W>,
    push: &Push<T>,
    gradient: &mut Coords<T, L, J>,
    hessian: &mut Arrow<T, L, J, W>,
) {
    let force = contact.world(push.gradient);
    let torque = cross(contact.at, force);
    for i in 0..3 {
        gradient.root[i] += force[i];
        gradient.root[3 + i] += torque[i];
    }

    let stiffness = world_stiffness(contact.tangent, push);
    // [1; r×] W [1, −r×]: lower triangle of the root's block.
    let lower =
        [cross(contact.at, stiffness[0]), cross(contact.at, stiffness[1]), cross(contact.at, stiffness[2])];
    for i in 0..3 {
        for j in 0..i + 1 {
            hessian.root[i][j] += stiffness[i][j];
        }
        for j in 0..3 {
            hessian.root[3 + i][j] += lower[j][i];
        }
        let turned = cross(contact.at, [lower[0][i], lower[1][i], lower[2][i]]);
        for j in 0..i + 1 {
            hessian.root[3 + i][3 + j] += turned[j];
        }
    }
    let Some((limb, joints)) = contact.limb else {
        return;
    };
    for joint in 0..joints {
        let column = contact.columns[joint];
        let pushed = mul(&stiffness, column);
        gradient.limbs[limb][joint] += dot(column, force);
        add_coupling(&mut hessian.coupling[limb][joint], pushed, cross(contact.at, pushed));
        for inner in 0..joint + 1 {
            hessian.limbs[limb][joint][inner] += dot(contact.columns[inner], pushed);
        }
        for trunk in 0..contact.trunk_joints() {
            hessian.trunk[limb][joint][trunk] += dot(contact.trunk_columns[trunk], pushed);
        }
    }
    for joint in 0..contact.trunk_joints() {
        let column = contact.trunk_columns[joint];
        let pushed = mul(&stiffness, column);
        gradient.limbs[0][joint] += dot(column, force);
        add_coupling(&mut hessian.coupling[0][joint], pushed, cross(contact.at, pushed));
        for inner in 0..joint + 1 {
            hessian.limbs[0][joint][inner] += dot(contact.trunk_columns[inner], pushed);
        }
    }
}

/// Adds a force and a torque to the coupling of a joint with the root.
#[inline(always)]
fn add_coupling<T: Lane>(coupling: &mut [T; 6], force: Vec3<T>, torque: Vec3<T>) {
    for i in 0..3 {
        coupling[i] += force[i];
        coupling[3 + i] += torque[i];
    }
}

/// Adds what torsional and rolling friction contribute: with B the Hessian by force and torque and C that by
/// the torque, each joint's velocity v and axis h at the contact gain B h in force and Bᵀ v + C h in torque.
#[inline(always)]
pub fn add_turn<T: Lane, const L: usize, const J: usize, const W: usize>(
    cone: &ConeContact<T, J, W>,
    kinematics: &Kinematics<T, L, J>,
    gradient: &mut Coords<T, L, J>,
    hessian: &mut Arrow<T, L, J, W>,
) {
    let (contact, turn) = (&cone.contact, cone.turn());
    let (axes, turning_axes) = (cone.axes(), cone.turning_axes());
    let torque = rotate(&turning_axes, turn.gradient);
    let mixed = carried(&axes, &turn.mixed, &turning_axes);
    let transposed = transpose(&mixed);
    let stiffness = carried(&turning_axes, &turn.stiffness, &turning_axes);
    // r × each column of B.
    let lever = [
        cross(contact.at, transposed[0]),
        cross(contact.at, transposed[1]),
        cross(contact.at, transposed[2]),
    ];
    for i in 0..3 {
        gradient.root[3 + i] += torque[i];
        for j in 0..3 {
            hessian.root[3 + i][j] += mixed[j][i];
        }
        for j in 0..i + 1 {
            hessian.root[3 + i][3 + j] += stiffness[i][j] + (lever[i][j] + lever[j][i]);
        }
    }
    let Some((limb, joints)) = contact.limb else {
        return;
    };
    let (links, trunk_links) = (&kinematics.links[limb], &kinematics.links[0]);
    for joint in 0..joints {
        let hinge = links[joint].hinge();
        let force = mul(&mixed, hinge);
        let turned = add(mul(&transposed, contact.columns[joint]), mul(&stiffness, hinge));
        let whole = add(cross(contact.at, force), turned);
        gradient.limbs[limb][joint] += dot(hinge, torque);
        add_coupling(&mut hessian.coupling[limb][joint], force, whole);
        for inner in 0..joint + 1 {
            hessian.limbs[limb][joint][inner] +=
                dot(contact.columns[inner], force) + dot(links[inner].hinge(), turned);
        }
        for trunk in 0..contact.trunk_joints() {
            hessian.trunk[limb][joint][trunk] +=
                dot(contact.trunk_columns[trunk], force) + dot(trunk_links[trunk].hinge(), turned);
        }
    }
    for joint in 0..contact.trunk_joints() {
        let hinge = trunk_links[joint].hinge();
        let force = mul(&mixed, hinge);
        let turned = add(mul(&transposed, contact.trunk_columns[joint]), mul(&stiffness, hinge));
        let whole = add(cross(contact.at, force), turned);
        gradient.limbs[0][joint] += dot(hinge, torque);
        add_coupling(&mut hessian.coupling[0][joint], force, whole);
        for inner in 0..joint + 1 {
            hessian.limbs[0][joint][inner] +=
                dot(contact.trunk_columns[inner], force) + dot(trunk_links[inner].hinge(), turned);
        }
    }
}

/// A matrix, given as rows, times a vector.
#[inline(always)]
fn mul<T: Lane>(rows: &[Vec3<T>; 3], v: Vec3<T>) -> Vec3<T> {
    [dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)]
}

#[inline(always)]
fn transpose<T: Lane>(rows: &[Vec3<T>; 3]) -> [Vec3<T>; 3] {
    let [a, b, c] = rows;
    [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]]
}

/// Σᵢⱼ inner[i][j] · leftᵢ rightⱼᵀ: a matrix given along two sets of axes, in the world's coordinates.
#[inline(always)]
fn carried<T: Lane>(left: &Axes<T>, inner: &[Vec3<T>; 3], right: &Axes<T>) -> [Vec3<T>; 3] {
    let mut rows = [zero3(); 3];
    for i in 0..3 {
        let along = rotate(right, inner[i]);
        for row in 0..3 {
            for column in 0..3 {
                rows[row][column] = left[i][row].mul_add(along[column], rows[row][column]);
            }
        }
    }
    rows
}

/// Rows of the stiffness of a contact in the world's frame.
#[inline(always)]
fn world_stiffness<T: Lane>([x, y]: [T; 2], push: &Push<T>) -> [Vec3<T>; 3] {
    let [normal, first, second, tilt_first, tilt_second] = push.stiffness;
    let (x2, y2) = (x * x, y * y);
    let mut xx = first.mul_add(x2, second * y2);
    let mut yy = first.mul_add(y2, second * x2);
    let mut xy = (first - second) * (x * y);
    if let Some(skew) = push.skew {
        let twice = T::of(2.0) * skew * (x * y);
        xx -= twice;
        yy += twice;
        xy = skew.mul_add(x2 - y2, xy);
    }
    let xz = tilt_first * x - tilt_second * y;
    let yz = tilt_first.mul_add(y, tilt_second * x);
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, normal]]
}
