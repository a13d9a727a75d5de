//! What a contact contributes to the gradient and to the Hessian of the solver's problem: Jᵀ times the derivatives of
//! its cost, and times J.

use cubecl::prelude::*;

use crate::arrow::Arrow;
use crate::contact::Contact;
use crate::coords::Coords;
use crate::math::V3;
use crate::pyramid::Push;
use crate::shape::{Shape, lower};

/// Adds a contact's force to the gradient and its stiffness to the Hessian; `share` is this thread's share of the
/// gradient by the root's coordinates.
///
/// The stiffness is a symmetric 3 × 3 matrix in the contact's frame; the Jacobian carries it over.
#[cube]
pub fn add_contact<F: Float>(
    contact: Contact<F>,
    columns: &Sequence<V3<F>>,
    push: Push<F>,
    share: &mut Array<F>,
    gradient: &mut Coords<F>,
    hessian: &mut Arrow<F>,
    #[comptime] slot: usize,
    #[comptime] shape: Shape,
) {
    let force = contact.world(push.gradient);
    let torque = contact.at.cross(force);
    share[0] += force.x;
    share[1] += force.y;
    share[2] += force.z;
    share[3] += torque.x;
    share[4] += torque.y;
    share[5] += torque.z;

    // Rows of the stiffness along the world's axes.
    let (x, y) = (contact.tx, contact.ty);
    let xy = (push.first - push.second) * (x * y);
    let xz = push.tilt_first * x - push.tilt_second * y;
    let yz = fma(push.tilt_first, y, push.tilt_second * x);
    let sx = V3::<F>::new(fma(push.first, x * x, push.second * (y * y)), xy, xz);
    let sy = V3::<F>::new(xy, fma(push.first, y * y, push.second * (x * x)), yz);
    let sz = V3::<F>::new(xz, yz, push.first + push.second);
    add_root::<F>(contact.at, sx, sy, sz, &mut hessian.root);

    #[unroll]
    for joint in 0..comptime!(shape.slot[slot].moved_by) {
        let column = columns[comptime!(slot * shape.joints + joint)];
        let pushed = V3::<F>::new(sx.dot(column), sy.dot(column), sz.dot(column));
        let turned = contact.at.cross(pushed);
        gradient.limb[joint] += column.dot(force);
        hessian.coupling[comptime!(6 * joint)] += pushed.x;
        hessian.coupling[comptime!(6 * joint + 1)] += pushed.y;
        hessian.coupling[comptime!(6 * joint + 2)] += pushed.z;
        hessian.coupling[comptime!(6 * joint + 3)] += turned.x;
        hessian.coupling[comptime!(6 * joint + 4)] += turned.y;
        hessian.coupling[comptime!(6 * joint + 5)] += turned.z;
        #[unroll]
        for inner in 0..comptime!(joint + 1) {
            let other = columns[comptime!(slot * shape.joints + inner)];
            hessian.block[comptime!(lower(joint, inner))] += other.dot(pushed);
        }
    }
}

/// Adds [1; r×] S [1, −r×] to the lower triangle of the root's block; S has the rows `sx`, `sy` and `sz`.
#[cube]
fn add_root<F: Float>(at: V3<F>, sx: V3<F>, sy: V3<F>, sz: V3<F>, root: &mut Array<F>) {
    let lx = at.cross(sx);
    let ly = at.cross(sy);
    let lz = at.cross(sz);
    let tx = at.cross(V3::<F>::new(lx.x, ly.x, lz.x));
    let ty = at.cross(V3::<F>::new(lx.y, ly.y, lz.y));
    let tz = at.cross(V3::<F>::new(lx.z, ly.z, lz.z));
    root[comptime!(lower(0, 0))] += sx.x;
    root[comptime!(lower(1, 0))] += sy.x;
    root[comptime!(lower(1, 1))] += sy.y;
    root[comptime!(lower(2, 0))] += sz.x;
    root[comptime!(lower(2, 1))] += sz.y;
    root[comptime!(lower(2, 2))] += sz.z;
    root[comptime!(lower(3, 0))] += lx.x;
    root[comptime!(lower(3, 1))] += ly.x;
    root[comptime!(lower(3, 2))] += lz.x;
    root[comptime!(lower(4, 0))] += lx.y;
    root[comptime!(lower(4, 1))] += ly.y;
    root[comptime!(lower(4, 2))] += lz.y;
    root[comptime!(lower(5, 0))] += lx.z;
    root[comptime!(lower(5, 1))] += ly.z;
    root[comptime!(lower(5, 2))] += lz.z;
    root[comptime!(lower(3, 3))] += tx.x;
    root[comptime!(lower(4, 3))] += ty.x;
    root[comptime!(lower(4, 4))] += ty.y;
    root[comptime!(lower(5, 3))] += tz.x;
    root[comptime!(lower(5, 4))] += tz.y;
    root[comptime!(lower(5, 5))] += tz.z;
}
