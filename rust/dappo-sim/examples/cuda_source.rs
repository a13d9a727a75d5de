//! The kernel of the GPU engine for a robot as CUDA C++: `cuda_source ROBOT.json KERNEL.cu`.
//!
//! `tests/gpu/cuda_source.py` writes the robot, a compiled class table, and compiles the kernel.

use std::collections::HashMap;
use std::error::Error;

use dappo_sim::backend::lanes::{LaneTable, ModelArrays, ModelReader, Rules};
use serde::Deserialize;

/// A compiled class table.
#[derive(Deserialize)]
struct Table {
    models: Vec<Fields>,
    main_body: usize,
    touch_addresses: Vec<usize>,
    disabled_touch: Vec<Vec<bool>>,
    rotation_correction: Option<bool>,
    clamped_without_derivative: bool,
}

/// All numbers of a compiled model, by the names of their fields.
#[derive(Deserialize)]
struct Fields(HashMap<String, Vec<f64>>);

impl ModelReader for Fields {
    type Error = String;

    fn size(&self, name: &str) -> Result<usize, String> {
        Ok(self.reals(name)?.first().map_or(0, |&size| size as usize))
    }

    fn reals(&self, name: &str) -> Result<Vec<f64>, String> {
        self.0.get(name).cloned().ok_or_else(|| format!("the model has no field `{name}`"))
    }

    fn integers(&self, name: &str) -> Result<Vec<i32>, String> {
        Ok(self.reals(name)?.into_iter().map(|number| number as i32).collect())
    }

    fn optional(&self, name: &str) -> Result<Option<Vec<f64>>, String> {
        Ok(self.0.get(name).cloned())
    }

    fn names(&self) -> Result<Vec<u8>, String> {
        Ok(self.reals("names")?.into_iter().map(|byte| byte as u8).collect())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let [robot, kernel] = <[String; 2]>::try_from(std::env::args().skip(1).collect::<Vec<_>>())
        .map_err(|_| "usage: cuda_source ROBOT.json KERNEL.cu")?;
    let table: Table = serde_json::from_str(&std::fs::read_to_string(robot)?)?;
    let rules = Rules {
        rotation_correction: table.rotation_correction,
        clamped_without_derivative: table.clamped_without_derivative,
    };
    let read = |model| ModelArrays::read(model, rules);
    let models = table.models.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let table = LaneTable::compile(&models, table.main_body, &table.touch_addresses, table.disabled_touch)?;
    let source = dappo_gpu::cuda_source::advance(table.models())?;
    Ok(std::fs::write(kernel, source)?)
}
