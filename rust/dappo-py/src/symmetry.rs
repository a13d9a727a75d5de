//! Reads which parts of a robot are mirror images of each other, which `model/symmetry.py` finds.

use dappo_sim::task::{Image, MirroredParts};
use pyo3::prelude::*;

/// The symmetry of the robot of a Python `ClassTable`; an error if there is none.
pub fn find(table: &Bound<'_, PyAny>) -> PyResult<MirroredParts> {
    let found = table.py().import("dappo_batch.model.symmetry")?.call_method1("find_symmetry", (table,))?;
    let images = |name: &str| -> PyResult<Vec<Image>> {
        let image = |item: Bound<'_, PyAny>| {
            Ok(Image { of: item.getattr("of")?.extract()?, sign: item.getattr("sign")?.extract()? })
        };
        found.getattr(name)?.try_iter()?.map(|item| image(item?)).collect()
    };
    Ok(MirroredParts {
        limbs: found.getattr("limbs")?.extract()?,
        bodies: found.getattr("bodies")?.extract()?,
        joints: images("joints")?,
        actuators: images("actuators")?,
    })
}
