//! Pointers into MuJoCo's memory, handed over by whoever compiled the models.

use std::any::Any;

use super::library::{Data, Model};
use crate::error::SimError;

/// The compiled models of all damage classes.
pub struct ModelTable {
    models: Vec<Model>,
    muted_touch: Vec<Vec<bool>>,
    /// `mjtState` bits of everything that the next step depends on.
    pub(super) state_spec: u32,
    _owner: Box<dyn Any + Send + Sync>,
}

// SAFETY: libmujoco reads an mjModel and never writes it while stepping, and `_owner` keeps it alive.
unsafe impl Send for ModelTable {}
// SAFETY: as above; shared reads only.
unsafe impl Sync for ModelTable {}

impl ModelTable {
    /// A table of `mjModel*` addresses, one a damage class, and the limbs whose touch signal each class mutes.
    ///
    /// # Safety
    /// Every address must be a valid `mjModel` for as long as `owner` lives, all of equal sizes.
    pub unsafe fn new(
        models: &[usize],
        muted_touch: Vec<Vec<bool>>,
        state_spec: u32,
        owner: Box<dyn Any + Send + Sync>,
    ) -> Result<Self, SimError> {
        if models.is_empty() || models.len() != muted_touch.len() {
            return Err(SimError::Config(format!(
                "a class table needs one model and one touch mask a class, got {} and {}",
                models.len(),
                muted_touch.len()
            )));
        }
        let models = models.iter().map(|&address| address as Model).collect();
        Ok(Self { models, muted_touch, state_spec, _owner: owner })
    }

    /// Number of classes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.models.len()
    }

    /// Whether the table has no class; never true.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.models.is_empty()
    }

    pub(super) fn model(&self, class: usize) -> Model {
        self.models[class]
    }

    pub(super) fn muted_touch(&self, class: usize) -> &[bool] {
        &self.muted_touch[class]
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

/// One `mjData` and the addresses of the arrays that a worker reads and writes.
pub struct WorkerFields {
    pub(super) data: Data,
    pub(super) qpos: Field,
    pub(super) qvel: Field,
    pub(super) ctrl: Field,
    pub(super) cfrc_ext: Field,
    pub(super) sensordata: Field,
    pub(super) main_body_xpos: Field,
    /// Addresses of the counters (`int`) of states that were beyond bounds.
    pub(super) divergences: [usize; 3],
    pub(super) _owner: Box<dyn Any + Send + Sync>,
}

impl WorkerFields {
    /// Wraps the addresses of an `mjData` made from class 0 of a [`ModelTable`].
    ///
    /// # Safety
    /// `data` must be a valid `mjData` that nobody else uses while this value lives, the fields must be its
    /// arrays of that name (`main_body_xpos`: the three entries of the main body's `xpos`), `divergences` the
    /// addresses of `number` of its warnings `BADQPOS`, `BADQVEL` and `BADQACC`, and all of it must stay where it is
    /// for as long as `owner` lives.
    #[must_use]
    pub unsafe fn new(
        data: usize,
        fields: [Field; 6],
        divergences: [usize; 3],
        owner: Box<dyn Any + Send + Sync>,
    ) -> Self {
        let [qpos, qvel, ctrl, cfrc_ext, sensordata, main_body_xpos] = fields;
        Self {
            data: data as Data,
            qpos,
            qvel,
            ctrl,
            cfrc_ext,
            sensordata,
            main_body_xpos,
            divergences,
            _owner: owner,
        }
    }
}
