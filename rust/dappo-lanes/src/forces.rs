//! What contacts do to bodies and touch sensors.

use crate::contact::Contacts;
use crate::dynamics::Dynamics;
use crate::lane::Lane;
use crate::math::Vec3;
use crate::skeleton::Skeleton;

/// Forces of one evaluation.
pub struct Forces<T> {
    /// `cfrc_ext`: torque about the robot's centre of mass, then force, along the world's axes.
    pub bodies: Vec<[T; 6]>,
    /// Normal forces of the touch sensors.
    pub touch: Vec<T>,
}

impl<T: Lane> Forces<T> {
    pub fn zero(bodies: usize, touch_sensors: usize) -> Self {
        Self { bodies: vec![[T::zero(); 6]; bodies], touch: vec![T::zero(); touch_sensors] }
    }

    /// External forces on the bodies (`mj_rnePostConstraint`).
    #[inline(always)]
    pub fn set_bodies<const L: usize, const J: usize, const W: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        dynamics: &Dynamics<T, L, J, W>,
        mask: T::Mask,
    ) {
        for entry in self.bodies.as_flattened_mut() {
            *entry = T::select(mask, T::zero(), *entry);
        }
        for pyramid in &dynamics.contacts.pyramids {
            let wrench = pyramid.contact.wrench(pyramid.gradient(), dynamics.center);
            add_wrench(&mut self.bodies[skeleton.points[pyramid.contact.point].body], wrench, mask);
        }
        for cone in &dynamics.contacts.cones {
            let wrench = cone.wrench(dynamics.center);
            add_wrench(&mut self.bodies[skeleton.points[cone.contact.point].body], wrench, mask);
        }
    }

    /// Touch sensors: the sum of the normal forces they feel (documentation: XML reference, "sensor/touch").
    #[inline(always)]
    pub fn set_touch<const L: usize, const J: usize, const W: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        contacts: &Contacts<T, J, W>,
        mask: T::Mask,
    ) {
        if self.touch.is_empty() {
            return;
        }
        for touch in &mut self.touch {
            *touch = T::select(mask, T::zero(), *touch);
        }
        for pyramid in &contacts.pyramids {
            if let Some(sensor) = skeleton.points[pyramid.contact.point].touch {
                self.touch[sensor] += (-pyramid.gradient()[0]).keep(mask);
            }
        }
        for cone in &contacts.cones {
            if let Some(sensor) = skeleton.points[cone.contact.point].touch {
                self.touch[sensor] += (-cone.push().gradient[0]).keep(mask);
            }
        }
    }
}

#[inline(always)]
fn add_wrench<T: Lane>(body: &mut [T; 6], (force, torque): (Vec3<T>, Vec3<T>), mask: T::Mask) {
    for i in 0..3 {
        body[i] += torque[i].keep(mask);
        body[3 + i] += force[i].keep(mask);
    }
}
