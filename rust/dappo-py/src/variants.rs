//! Reads the compiled variants of a Python `ClassTable`, which `model/variants.py` makes.

use dappo_sim::task::{Jam, Variants};
use pyo3::prelude::*;

/// What is behind the damage classes of a Python `ClassTable`.
pub fn read(table: &Bound<'_, PyAny>) -> PyResult<Variants> {
    let found = table.getattr("variants")?;
    let of_models = found.getattr("jams")?;
    Ok(Variants {
        names: found.getattr("names")?.extract()?,
        numbers: found.getattr("numbers")?.extract()?,
        models: found.getattr("models")?.extract()?,
        jams: of_models
            .try_iter()?
            .map(|jams| jams?.try_iter()?.map(|item| jam(&item?)).collect())
            .collect::<PyResult<_>>()?,
    })
}

fn jam(item: &Bound<'_, PyAny>) -> PyResult<Jam> {
    Ok(Jam {
        joint: item.getattr("joint")?.extract()?,
        qpos: item.getattr("qpos")?.extract()?,
        dof: item.getattr("dof")?.extract()?,
        compiled_at: item.getattr("compiled_at")?.extract()?,
        range: item.getattr("range")?.extract()?,
        share: item.getattr("share")?.extract()?,
    })
}
