//! `dappo-batch classes`: id, name, group and code of every damage class.

use dappo_learn::text_table::table;
use dappo_sim::DamageSpace;
use pyo3::prelude::*;
use serde_json::json;

use super::args::ClassesArgs;
use super::{Caller, console};
use crate::errors::OrRaise;

pub fn run(py: Python<'_>, arguments: &ClassesArgs, caller: &Caller) -> PyResult<i32> {
    let robots = py.import("dappo_batch.robots")?;
    let name = match &arguments.robot {
        Some(name) => name.clone(),
        None => robots.getattr("DEFAULT_ROBOT")?.extract()?,
    };
    let object = robots.call_method1("load_robot", (name,))?;
    let toml: String = object.getattr("toml_text")?.extract()?;
    let robot = dappo_sim::Robot::from_toml(&toml).or_raise()?;
    let types = arguments.types.clone().unwrap_or_else(|| robot.damage.types.clone());
    let max_damaged = arguments.max_damaged_limbs.unwrap_or(robot.damage.max_damaged_limbs);
    let per_limb =
        arguments.max_damages_per_limb.unwrap_or(robot.damage.max_damages_per_limb.min(types.len().max(1)));
    let space =
        DamageSpace::with_damages_per_limb(robot.limbs.len(), types, max_damaged, per_limb).or_raise()?;
    // Classes of a robot that does not exist, or whose limbs cannot break in this way, are none.
    let checked = if max_damaged > 0 { space.types() } else { &[] };
    py.import("dappo_batch.model")?.call_method1("check_damage_types", (object, checked.to_vec()))?;
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
    let rows = space.classes().iter().map(|class| {
        let bits = code(class).iter().map(ToString::to_string).collect();
        [class.id.to_string(), class.name.clone(), class.group.clone(), bits]
    });
    console::print(&table(["id", "<name", "<group", "<code"], rows));
    Ok(0)
}
