//! `dappo-batch classes`: id, name, group and code of every damage class.

use dappo_sim::DamageSpace;
use pyo3::prelude::*;
use serde_json::json;

use super::args::ClassesArgs;
use super::{Caller, console};
use crate::errors::{Kind, from_sim, raise};

pub fn run(py: Python<'_>, arguments: &ClassesArgs, caller: &Caller) -> PyResult<i32> {
    let robots = py.import("dappo_batch.robots")?;
    let name = match &arguments.robot {
        Some(name) => name.clone(),
        None => robots.getattr("DEFAULT_ROBOT")?.extract()?,
    };
    let robot = robots.call_method1("load_robot", (name,))?;
    let toml: String = robot.getattr("toml_text")?.extract()?;
    let robot = dappo_sim::Robot::from_toml(&toml).map_err(|error| from_sim(&error))?;
    let types = arguments.types.clone().unwrap_or_else(|| robot.damage.types.clone());
    let known: Vec<String> = py
        .import("dappo_batch.damage")?
        .getattr("DAMAGE_TYPES")?
        .try_iter()?
        .map(|name| name?.extract())
        .collect::<PyResult<_>>()?;
    if let Some(unknown) = types.iter().find(|name| !known.contains(name)) {
        let known = known.join(", ");
        return Err(raise(Kind::Config, format!("unknown damage type `{unknown}`: expected one of {known}")));
    }
    let max_damaged = arguments.max_damaged_limbs.unwrap_or(robot.damage.max_damaged_limbs);
    let space = DamageSpace::new(robot.limbs.len(), types, max_damaged).map_err(|error| from_sim(&error))?;
    let code = |class: &dappo_sim::DamageClass| -> Vec<u8> {
        class.code(space.limbs(), space.types().len()).iter().map(|&bit| u8::from(bit > 0.0)).collect()
    };
    if arguments.json {
        let rows: Vec<_> = space
            .classes()
            .iter()
            .map(|class| json!({"id": class.id, "name": class.name, "group": class.group, "code": code(class)}))
            .collect();
        caller.object(&rows);
        return Ok(0);
    }
    console::print_line(&format!("{:>4}  {:<40}  {:<8}  code", "id", "name", "group"));
    for class in space.classes() {
        let bits: String = code(class).iter().map(ToString::to_string).collect();
        console::print_line(&format!("{:>4}  {:<40}  {:<8}  {bits}", class.id, class.name, class.group));
    }
    Ok(0)
}
