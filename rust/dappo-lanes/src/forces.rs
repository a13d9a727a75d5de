//! What contacts do to bodies and touch sensors.

use crate::constants::Skeleton;
use crate::contact::{Contact, wrench};
use crate::dynamics::Dynamics;
use crate::lane::Lane;

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
    pub fn set_bodies<const L: usize, const J: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        dynamics: &Dynamics<T, L, J>,
        mask: T::Mask,
    ) {
        for entry in self.bodies.as_flattened_mut() {
            *entry = T::select(mask, T::zero(), *entry);
        }
        for contact in &dynamics.contacts {
            let (force, torque) = wrench(contact, dynamics.center);
            let body = &mut self.bodies[skeleton.points[contact.point].body];
            for i in 0..3 {
                body[i] += torque[i].keep(mask);
                body[3 + i] += force[i].keep(mask);
            }
        }
    }

    /// Touch sensors: the sum of the normal forces they feel (documentation: XML reference, "sensor/touch").
    #[inline(always)]
    pub fn set_touch<const L: usize, const J: usize>(
        &mut self,
        skeleton: &Skeleton<T, L, J>,
        contacts: &[Contact<T, J>],
        mask: T::Mask,
    ) {
        if self.touch.is_empty() {
            return;
        }
        for touch in &mut self.touch {
            *touch = T::select(mask, T::zero(), *touch);
        }
        for contact in contacts {
            if let Some(sensor) = skeleton.points[contact.point].touch {
                self.touch[sensor] += (-contact.push().gradient[0]).keep(mask);
            }
        }
    }
}
