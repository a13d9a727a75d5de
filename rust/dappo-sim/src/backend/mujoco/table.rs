//! Pointers into MuJoCo's memory, from the code that compiled the models.

use std::any::Any;

use super::library::{Data, Model};
use super::varied::VariedModel;
use crate::error::SimError;

/// The compiled models of all damage classes and their variants.
pub struct ModelTable {
    models: Vec<Model>,
    disabled_touch: Vec<Vec<bool>>,
    /// `mjtState` bits of everything that the next step depends on.
    pub(super) state_spec: u32,
    _owner: Box<dyn Any + Send + Sync>,
}

// SAFETY: libmujoco reads an mjModel and never writes it while stepping, and `_owner` keeps it alive.
unsafe impl Send for ModelTable {}
// SAFETY: as above; shared reads only.
unsafe impl Sync for ModelTable {}

impl ModelTable {
    /// A table of `mjModel*` addresses, and the limbs whose touch signal each class disables.
    ///
    /// # Safety
    /// Every address must be a valid `mjModel` for as long as `owner` lives, all of equal sizes.
    pub unsafe fn new(
        models: &[usize],
        disabled_touch: Vec<Vec<bool>>,
        state_spec: u32,
        owner: Box<dyn Any + Send + Sync>,
    ) -> Result<Self, SimError> {
        if disabled_touch.is_empty() || models.len() < disabled_touch.len() {
            return Err(SimError::Config(format!(
                "a class table needs a model and a touch mask of each class, got {} and {}",
                models.len(),
                disabled_touch.len()
            )));
        }
        let models = models.iter().map(|&address| address as Model).collect();
        Ok(Self { models, disabled_touch, state_spec, _owner: owner })
    }

    /// Number of classes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.disabled_touch.len()
    }

    /// Whether the table has no class; never true.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.disabled_touch.is_empty()
    }

    pub(super) fn model(&self, index: usize) -> Model {
        self.models[index]
    }

    pub(super) fn disabled_touch(&self, class: usize) -> &[bool] {
        &self.disabled_touch[class]
    }
}

/// An array inside an `mjData`.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Address of the first entry.
    pub address: usize,
    /// Number of entries.
    pub len: usize,
}

/// A [`Field`] of the `mjData` of a worker, borrowed as if the worker held the numbers themselves. There is one for each
/// array, and it cannot be copied.
pub(super) struct Array(pub(super) Field);

impl Array {
    pub fn get(&self) -> &[f64] {
        if self.0.len == 0 {
            return &[];
        }
        // SAFETY: made in `WorkerFields::new` alone, whose caller vouches for the array for as long as the owner
        // next to it lives; MuJoCo aligns it. Writing it takes `&mut self`.
        unsafe { std::slice::from_raw_parts(self.0.address as *const f64, self.0.len) }
    }

    pub fn get_mut(&mut self) -> &mut [f64] {
        if self.0.len == 0 {
            return &mut [];
        }
        // SAFETY: as in `get`; `&mut self` is the only way to the array, and the arrays of a worker do not overlap.
        unsafe { std::slice::from_raw_parts_mut(self.0.address as *mut f64, self.0.len) }
    }
}

/// One `mjData` and the arrays that a worker reads and writes.
pub struct WorkerFields {
    pub(super) data: Data,
    pub(super) qpos: Array,
    pub(super) qvel: Array,
    pub(super) ctrl: Array,
    pub(super) cfrc_ext: Array,
    pub(super) sensordata: Array,
    pub(super) actuator_force: Array,
    pub(super) main_body_xpos: Array,
    /// The worker's own models where those of envs differ; empty otherwise.
    pub(super) models: Vec<VariedModel>,
    /// Addresses of the counters (`int`) of states that were beyond bounds.
    pub(super) divergences: [usize; 3],
    pub(super) _owner: Box<dyn Any + Send + Sync>,
}

impl WorkerFields {
    /// Wraps the addresses of an `mjData` made from class 0 of a [`ModelTable`].
    ///
    /// # Safety
    /// `data` must be a valid `mjData` without other users while this value lives, `models` must have the sizes of the
    /// table's, the fields must be its arrays of that name (`main_body_xpos`: the three entries of the main body's `xpos`), `divergences` the
    /// addresses of `number` of its warnings `BADQPOS`, `BADQVEL` and `BADQACC`, and all of it must stay
    /// where it is for as long as `owner` lives.
    #[must_use]
    pub unsafe fn new(
        data: usize,
        fields: [Field; 7],
        models: Vec<VariedModel>,
        divergences: [usize; 3],
        owner: Box<dyn Any + Send + Sync>,
    ) -> Self {
        let [qpos, qvel, ctrl, cfrc_ext, sensordata, actuator_force, main_body_xpos] = fields.map(Array);
        Self {
            data: data as Data,
            qpos,
            qvel,
            ctrl,
            cfrc_ext,
            sensordata,
            actuator_force,
            main_body_xpos,
            models,
            divergences,
            _owner: owner,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_read_and_write_the_memory_that_they_were_made_of() {
        let mut numbers = [[0.0_f64, 1.0], [2.0, 3.0], [4.0, 5.0], [6.0, 7.0], [8.0, 9.0]];
        let mut fields = numbers.each_mut().map(|row| Field { address: row.as_mut_ptr() as usize, len: 2 });
        fields[3].len = 0;
        let [qpos, qvel, ctrl, cfrc_ext, xpos] = fields;
        let fields =
            [qpos, qvel, ctrl, cfrc_ext, Field { address: 0, len: 0 }, Field { address: 0, len: 0 }, xpos];
        // SAFETY: the fields are rows of `numbers`, which outlives them, and no function of MuJoCo is called.
        let mut worker = unsafe { WorkerFields::new(0, fields, Vec::new(), [0; 3], Box::new(())) };
        // Two arrays can be written at a time; one cannot be borrowed twice.
        let (qpos, qvel) = (worker.qpos.get_mut(), worker.qvel.get_mut());
        qpos.swap_with_slice(qvel);
        assert_eq!((worker.qpos.get(), worker.qvel.get()), (&[2.0, 3.0][..], &[0.0, 1.0][..]));
        assert_eq!(worker.main_body_xpos.get(), [8.0, 9.0]);
        assert!(worker.cfrc_ext.get().is_empty() && worker.sensordata.get_mut().is_empty());
        drop(worker);
        assert_eq!(numbers[..2], [[2.0, 3.0], [0.0, 1.0]]);
    }
}
